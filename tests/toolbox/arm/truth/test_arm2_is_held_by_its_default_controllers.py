"""The default controllers bring the 2-DoF arm to points about (0, 0, 0.4, 0.4) and hold it, noise and converters on."""

import numpy as np
import pytest
from arm2_cases import ARM, MIDDLE, experiment

from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS

POINTS = [
    MIDDLE, (0.0, 0.0, 0.5, 0.5), (0.0, 0.0, 0.3, 0.3), (0.0, 10.0, 0.4, 0.4), (0.0, -10.0, 0.4, 0.4),
    (3.0, 0.0, 0.4, 0.4), (-3.0, 0.0, 0.4, 0.4), (5.0, 10.0, 0.45, 0.4), (-8.0, 0.0, 0.4, 0.6),
]  # fmt: skip
#: a valve stays shut up to 0.01 V, so that a loop of this gain at DC leaves its output alone within 0.01 / gain
DEAD_ZONE_V = float(ARM2_PARAMETERS.vector()[ARM2_PARAMETERS.index("pwm_dead_zone")])
LEFT_DEG = {"theta1": np.degrees(DEAD_ZONE_V / 9.9), "theta2": np.degrees(DEAD_ZONE_V / 5.7)}
LEFT_BAR = 2.0 * DEAD_ZONE_V / 5.0  # z_p meets an angle's z of up to 0.01 V in the same valve


@pytest.fixture(scope="module")
def reached():
    """20 s from a start some degrees and 0.02 bar beside; with true states."""
    beside = np.array([1.0, 1.0, -0.02, -0.02])
    asked = [
        experiment(tuple(np.array(p) * [0.9, 0.9, 1.0, 1.0] + beside), 20_000, setpoint=p, seed=k)
        for k, p in enumerate(POINTS)
    ]
    return dict(zip(POINTS, ARM.simulate(asked, states=True), strict=True))


@pytest.mark.parametrize("point", POINTS)
def test_arm_is_brought_to_the_setpoint_and_held(reached, point):
    r = reached[point]
    assert r.info.ended_early is None
    assert r.column("t_s").size == 20_000
    for place, joint in enumerate(("theta1", "theta2")):
        late = np.degrees(r.column(f"true_{joint}_rad")[-5000:])
        assert late.mean() == pytest.approx(point[place], abs=LEFT_DEG[joint] + 0.02)
        assert np.ptp(late) < 0.2  # measured 0.1 deg at worst: ripple of single pulses, no limit cycle
    for place, name in ((2, "p_a"), (3, "p_c")):
        late = r.column(f"true_{name}_bar")[-5000:]
        assert late.mean() == pytest.approx(point[place], abs=LEFT_BAR + 0.001)


def test_without_controllers_it_would_not_stay():
    """So the above is the controllers' work: the same start with its valves shut swings on where it is."""
    start = (1.0, 1.0, 0.38, 0.38)
    (r,) = ARM.simulate([experiment(start, 20_000, setpoint=MIDDLE, injection="control")], states=True)
    assert np.degrees(r.column("true_theta2_rad")[-1]) == pytest.approx(1.0, abs=1e-6)


def test_sensor_noise_and_converters_are_as_tabled():
    """All six channels at rest: 0.02 deg and 1 mbar rms, on grids of 270 deg and 2 bar in 4096 steps."""
    still = experiment(MIDDLE, 20_000, injection="control", seed=4)
    (r,), (fine,) = (ARM.simulate([still], changes=ch, states=True) for ch in ({}, {"converter_bits": 0.0}))
    channels = {f"theta{j}_rad": (np.radians(0.02), np.radians(270.0)) for j in (1, 2)}
    channels |= {f"p_{m}_bar": (1e-3, 2.0) for m in "abcd"}
    errors = []
    for name, (rms, span) in channels.items():
        errors.append((fine.column(name) - fine.column(f"true_{name}")) / rms)
        assert errors[-1].std() == pytest.approx(1.0, abs=0.02)
        assert abs(errors[-1].mean()) < 4.0 / np.sqrt(20_000)
        codes = r.column(name) / (span / 4096)
        np.testing.assert_allclose(codes, np.round(codes), atol=1e-9)
    apart = np.corrcoef(errors) - np.eye(6)
    assert np.abs(apart).max() < 4.5 / np.sqrt(20_000)
