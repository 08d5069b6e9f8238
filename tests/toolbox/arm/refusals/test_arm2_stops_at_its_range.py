"""A simulation of two joints that leaves the model's range stops, says when and why, and keeps what it has recorded."""

import re

import numpy as np
import pytest
from arm2_cases import ARM, MIDDLE, QUIET, experiment

from loopshape.toolbox.arm.dynamics import closed_loop
from loopshape.toolbox.arm.dynamics.closed_loop2 import range_left2
from loopshape.toolbox.arm.parameters import Sensors

#: limits that nothing reaches, to see what would have come
FAR = {"range_angle1_deg": 90.0, "range_angle_deg": 90.0, "range_low_bar": 0.0, "range_high_bar": 100.0}


def driven(loop, volts, changes):
    injected = np.zeros((3000, 4))
    injected[:, loop] = volts
    e = experiment(MIDDLE, 3000, injection="control", injected=injected)
    return ARM.simulate([e], changes=QUIET | changes, states=True)[0]


def rows(recording):
    """As many as the sentence's time says."""
    n = len(recording.columns["t_s"])
    assert n == round(1000.0 * float(re.search(r"at ([0-9.]+) s$", recording.info.ended_early)[1]))
    return n


def test_a_pressure_out_of_range():
    stopped, free = driven(2, -0.2, {}), driven(2, -0.2, FAR)
    assert stopped.info.ended_early.startswith("a muscle's pressure left the model's range at ")
    n = rows(stopped)
    assert 100 < n < 3000
    # the rows before are those of an arm without limits, bit for bit, and the next one is out of range
    for name, values in stopped.columns.items():
        np.testing.assert_array_equal(values, free.columns[name][:n])
    p_a = free.column("true_p_a_bar")
    assert p_a[:n].min() >= 0.15 > p_a[n]


@pytest.mark.parametrize(("loop", "joint", "limit"), [(0, "theta1", 25.0), (1, "theta2", 45.0)])
def test_an_angle_out_of_range(loop, joint, limit):
    wide = {"range_low_bar": 0.0, "range_high_bar": 100.0}
    stopped, free = driven(loop, 0.5, wide), driven(loop, 0.5, FAR)
    assert stopped.info.ended_early.startswith(f"{joint} left the model's range at ")
    n = rows(stopped)
    angle = np.abs(np.degrees(free.column(f"true_{joint}_rad")))
    assert angle[:n].max() <= limit < angle[n]


REST = [1e5, 4e4, 4e4, 4e4, 4e4, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        (5, 0.43, closed_loop.COMPLETE),
        (5, 0.44, closed_loop.LEFT_THETA1),
        (5, -0.44, closed_loop.LEFT_THETA1),
        (6, 0.78, closed_loop.COMPLETE),
        (6, -0.79, closed_loop.LEFT_THETA2),
        *[(k, 1.4e4, closed_loop.LEFT_PRESSURE) for k in (1, 2, 3, 4)],
        *[(k, 1.21e5, closed_loop.LEFT_PRESSURE) for k in (1, 2, 3, 4)],
        *[(k, float("nan"), closed_loop.NOT_FINITE) for k in range(9)],
        (0, float("inf"), closed_loop.NOT_FINITE),
    ],
)
def test_each_limit_has_its_reason(place, value, why):
    sensors = Sensors(0.0, 0.0, 0.0, 0.0, np.radians(45.0), 0.15e5, 1.2e5, 4.0, 1e9, np.radians(25.0))
    state = np.array(REST)
    state[place] = value
    assert range_left2(state, sensors) == why


def test_stopping_one_does_not_stop_the_others():
    injected = np.zeros((3000, 4))
    injected[:, 2] = -0.2
    bad = experiment(MIDDLE, 3000, injection="control", injected=injected)
    good = experiment(MIDDLE, 3000)
    first, second, third = ARM.simulate([good, bad, good], threads=2)
    assert second.info.ended_early is not None
    for r in (first, third):
        assert r.info.ended_early is None
        assert len(r.columns["t_s"]) == 3000
