"""A simulation that leaves the model's range stops, says when and why, and keeps what it has recorded."""

import re

import numpy as np
import pytest
from bench_nouns import Block

import loopshape as ls
from loopshape.toolbox.arm.dynamics import closed_loop
from loopshape.toolbox.arm.parameters import Sensors

#: limits that nothing reaches, to see what would have come
FAR = {"range_angle_deg": 90.0, "range_low_bar": 0.0, "range_high_bar": 100.0}


@pytest.fixture(scope="module")
def source_controllers(arm):
    """Table 5.1: unstable on the printed model (ARM.md, section 10)."""
    blocks = (
        Block("gain", {"gain": 55.0}),
        Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 15.0}),
        Block("notch", {"f1_hz": 6.1, "f2_hz": 6.1, "damping1": 0.05, "damping2": 5.0}),
        Block("low_pass_2", {"f_hz": 15.0, "damping": 0.7}),
    )
    return ls.Controller("theta2", blocks, 1000.0), arm.default_controllers(1000.0)[1]


def when_s(recording):
    """The time in the sentence."""
    return float(re.search(r"at ([0-9.]+) s$", recording.info.ended_early)[1])


def test_source_s_controller_drives_the_printed_model_out_of_its_range(arm, arm_experiment, source_controllers):
    e = arm_experiment((30.0, 0.8), 10_000, controllers=source_controllers)
    stopped, free = (arm.simulate([e], changes=ch, states=True)[0] for ch in ({}, FAR))
    assert stopped.info.ended_early.startswith("a muscle's pressure left the model's range at ")
    n = len(stopped.columns["t_s"])
    assert 100 < n < 2000
    assert n == round(1000.0 * when_s(stopped))
    # the rows before are those of an arm without limits, bit for bit, and the next one is out of range
    for name, values in stopped.columns.items():
        np.testing.assert_array_equal(values, free.columns[name][:n])
    pressures = np.array([free.columns[f"true_{m}_bar"] for m in ("p_a", "p_b")])
    assert pressures[:, :n].min() >= 0.15
    assert pressures[:, :n].max() <= 1.2
    assert pressures[:, n].min() < 0.15 or pressures[:, n].max() > 1.2


def test_source_s_controller_grows_from_a_push(arm, arm_experiment, quiet, source_controllers):
    """Without noise it stands in its unstable equilibrium, within the dead zone; from 1 deg beside it leaves."""
    still, pushed = arm.simulate(
        [
            arm_experiment((30.0, 0.8), 5000, controllers=source_controllers),
            arm_experiment((29.0, 0.8), 5000, setpoint=(30.0, 0.8), controllers=source_controllers),
        ],
        changes=quiet,
    )
    assert still.info.ended_early is None
    assert pushed.info.ended_early is not None


def test_angle_out_of_range(arm, arm_experiment, quiet):
    injected = np.zeros((3000, 2))
    injected[:, 0] = 0.3
    e = arm_experiment((0.0, 1.0), 3000, injection="control", injected=injected)
    stopped, free = (arm.simulate([e], changes=quiet | ch, states=True)[0] for ch in ({"range_low_bar": 0.0}, FAR))
    assert stopped.info.ended_early.startswith("the angle left the model's range at ")
    n = len(stopped.columns["t_s"])
    assert n == round(1000.0 * when_s(stopped))
    theta = np.degrees(free.columns["true_theta2_rad"])
    assert np.abs(theta[:n]).max() <= 45.0 < abs(theta[n])


def test_start_beyond_the_range_leaves_one_row(arm, arm_experiment, quiet):
    (r,) = arm.simulate([arm_experiment((60.0, 1.0), 10)], changes=quiet, states=True)
    assert r.info.ended_early == "the angle left the model's range at 0.001 s"
    assert np.degrees(r.columns["true_theta2_rad"]) == pytest.approx([60.0])


def test_stopping_one_does_not_stop_the_others(arm, arm_experiment, source_controllers):
    bad = arm_experiment((30.0, 0.8), 3000, controllers=source_controllers)
    good = arm_experiment((0.0, 1.0), 3000)
    first, second, third = arm.simulate([good, bad, good], threads=2)
    assert second.info.ended_early is not None
    for r in (first, third):
        assert r.info.ended_early is None
        assert len(r.columns["t_s"]) == 3000


@pytest.mark.parametrize(
    ("state", "why"),
    [
        ([1e5, 5e4, 5e4, 0.0, 0.0], closed_loop.COMPLETE),
        ([1e5, 5e4, 5e4, 0.786, 0.0], closed_loop.LEFT_ANGLE),
        ([1e5, 5e4, 5e4, -0.786, 0.0], closed_loop.LEFT_ANGLE),
        ([1e5, 1.4e4, 5e4, 0.0, 0.0], closed_loop.LEFT_PRESSURE),
        ([1e5, 5e4, 1.21e5, 0.0, 0.0], closed_loop.LEFT_PRESSURE),
        ([1e5, 5e4, 5e4, 0.0, float("nan")], closed_loop.NOT_FINITE),
        ([float("inf"), 5e4, 5e4, 0.0, 0.0], closed_loop.NOT_FINITE),
    ],
)
def test_each_limit_has_its_reason(state, why):
    sensors = Sensors(0.0, 0.0, 0.0, 0.0, np.radians(45.0), 0.15e5, 1.2e5, 4.0, 1e9)
    assert closed_loop.range_left(np.array(state), sensors) == why
