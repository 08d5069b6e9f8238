"""The 1-DoF arm with experiments on it, for the tests of toolboxes."""

import numpy as np
import pytest
from bench_nouns import Experiment


@pytest.fixture(scope="session")
def arm():
    from simulated_machines import Arm1

    return Arm1()


@pytest.fixture(scope="session")
def quiet():
    """Parameter changes that switch the sensors' noise and the converters off."""
    return {"angle_noise_deg": 0.0, "pressure_noise_bar": 0.0, "converter_bits": 0.0}


@pytest.fixture(scope="session")
def arm_constants():
    """The kernel's constants for named parameter changes."""
    from simulated_machines import ARM1_PARAMETERS, constants

    return lambda **changes: constants(ARM1_PARAMETERS.vector(changes))


@pytest.fixture(scope="session")
def all_effects(arm):
    """Parameter changes that switch all of the arm's effects on, each by its first form at its first start."""
    first = {form.effect: form for form in reversed(arm.effects)}
    moves = [form.at(form.scale * form.free[0].starts[0]).moves for form in first.values()]
    assert len(first) == 21
    return {name: value for move in moves for name, value in move.items()}


@pytest.fixture(scope="session")
def arm_experiment(arm):
    """An experiment at 1 kHz that starts at rest at `start` (deg, bar) and is asked to hold `setpoint`."""

    def make(start, samples, *, setpoint=None, injection="reference", controllers=None, **fields):
        theta_deg, p_ab = start if setpoint is None else setpoint
        settings = {
            "references": np.tile([np.radians(theta_deg), p_ab], (samples, 1)),
            "injected": np.zeros((samples, 2)),
            "closed_loop": injection != "control",
            "operating_point": {"theta2_deg": start[0], "p_ab_bar": start[1]},
        } | fields
        loops = arm.loop_setups(controllers or arm.default_controllers(1000.0), injection)
        return Experiment("one", "none", loops, 1000.0, injection=injection, **settings)

    return make


@pytest.fixture(scope="session")
def arm_open_loop():
    """The bare kernel, driven by z (n, 2) in V from a state (7,), SI, without noise: log (n, 12) and last state.

    `m` is the memory to start with, left as the run leaves it; without one that of an arm that has long rested.
    """
    from simulated_machines import Sensors

    from loopshape.toolbox.arm.dynamics import closed_loop

    sensors = Sensors(0.0, 0.0, 0.0, 0.0, 1.5, 0.0, 1e9, 4.0, 1e9)  # no noise, no converters, a range without end
    no_controller = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])

    def run(c, start, z, *, solver=closed_loop.EDGES, steps=1, tick_s=1e-3, period_ticks=20, dead_zone=0.01, m=None):
        z = np.ascontiguousarray(z, dtype=float)
        z.setflags(write=False)  # as an experiment's, so that one compiled kernel serves both
        state, out = np.array(start, dtype=float), np.empty((len(z), len(closed_loop.LOGGED)))
        arm = closed_loop.at_rest(c, state)
        if m is not None:
            arm = arm._replace(m=m)
        loops = closed_loop.plain_controllers(no_controller, no_controller)
        inputs = closed_loop.Inputs(np.zeros((len(z), 2)), z, closed_loop.CONTROL, False, 1)
        pwm = closed_loop.Pwm(tick_s, period_ticks, dead_zone)
        ended, n = closed_loop.run(arm, sensors, loops, inputs, pwm, solver, steps, out)
        assert (ended, n) == (closed_loop.COMPLETE, len(z))
        return out, state

    return run
