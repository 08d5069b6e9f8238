"""What the tests of the 2-DoF arm share: the plant, experiments on it, and its bare kernel."""

import numpy as np
from bench_nouns import Experiment
from simulated_machines import ARM2_PARAMETERS, Arm2, Sensors, constants2

from loopshape.toolbox.arm.dynamics import closed_loop2 as kernel
from loopshape.toolbox.arm.dynamics.closed_loop import COMPLETE, CONTROL, Inputs, Pwm, plain_controllers

ARM = Arm2()
MIDDLE = (0.0, 0.0, 0.4, 0.4)  # deg, deg, bar, bar
#: parameter changes that switch the sensors' noise and the converters off
QUIET = {"angle_noise_deg": 0.0, "pressure_noise_bar": 0.0, "converter_bits": 0.0}


def point(values):
    """An operating point by its names."""
    return dict(zip(Arm2().strategy.point_keys, values, strict=True))


def numbers(**changes):
    """The kernel's constants for named parameter changes."""
    return constants2(ARM2_PARAMETERS.vector(changes))


def experiment(start, samples, *, setpoint=None, injection="reference", controllers=None, **fields):
    """At 1 kHz, from rest at `start` (deg, deg, bar, bar), asked to hold `setpoint`."""
    settings = {
        "references": np.tile(ARM.setpoint(point(start if setpoint is None else setpoint)), (samples, 1)),
        "injected": np.zeros((samples, 4)),
        "closed_loop": injection != "control",
        "operating_point": point(start),
    } | fields
    loops = ARM.loop_setups(controllers or ARM.default_controllers(1000.0), injection)
    return Experiment("one", "none", loops, 1000.0, injection=injection, **settings)


def open_loop(c, start, z, steps=1, tick_s=1e-3, period_ticks=20):
    """The bare kernel driven by z (n, 4) in V from a state (9,), SI, without noise or limits: log (n, 23), end."""
    # no noise, no converters, a range without end
    sensors = Sensors(0.0, 0.0, 0.0, 0.0, 1e3, -1e9, 1e9, 1e3, 1e9, 1e3)
    no_controller = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
    z = np.ascontiguousarray(z, dtype=float)
    z.setflags(write=False)  # as an experiment's, so that one compiled kernel serves both
    state, out = np.array(start, dtype=float), np.empty((len(z), len(kernel.LOGGED)))
    loops, inputs = plain_controllers(*[no_controller] * 4), Inputs(np.zeros((len(z), 4)), z, CONTROL, False, 1)
    ended, n = kernel.run2(c, sensors, state, loops, inputs, Pwm(tick_s, period_ticks, 0.01), steps, out)
    assert (ended, n) == (COMPLETE, len(z))
    return out, state
