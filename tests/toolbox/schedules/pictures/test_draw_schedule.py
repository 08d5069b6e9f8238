"""The picture of a schedule shows the numbers it is given, with units, and twice the same."""

import numpy as np
import pytest
from bench_nouns import Block

import loopshape as ls
from loopshape.toolbox.schedules.picture import costs, distinct, ordered, parameter, schedule_page
from loopshape.toolbox.schedules.schedule import PointCost, Schedule
from loopshape.view.style import png


def controller(gain, f_hz):
    notch = {"f1_hz": f_hz, "f2_hz": f_hz, "damping1": 0.1, "damping2": 1.0}
    return ls.Controller("theta2", (Block("gain", {"gain": gain}), Block("notch", notch)), 1000.0)


def point(angle, pressure, own_hz, robust_hz, feasible=True):
    place = {"theta2_deg": angle, "p_ab_bar": pressure}
    own = controller(own_hz, 4.0 + own_hz)
    return PointCost(f"r{angle:g}-{pressure:g}", place, own, own_hz, robust_hz, 2.0 * own_hz, True, feasible)


@pytest.fixture(scope="module")
def found():
    points = [
        point(0.0, 1.2, 2.0, 0.8), point(-15.0, 0.8, 3.0, 1.5), point(15.0, 0.8, 3.1, 1.4, feasible=False),
        point(0.0, 0.8, 2.5, 1.1), point(15.0, 1.2, 2.4, 0.9),
    ]  # fmt: skip
    return Schedule("theta2", controller(1.0, 4.2), tuple(points))


def test_costs_stand_in_the_order_of_the_places(found):
    ax = costs(found)
    lines = {line.get_gid(): line for line in ax.lines if line.get_gid()}
    rising = ordered(found.points)
    assert [p.recording for p in rising] == ["r-15-0.8", "r0-0.8", "r15-0.8", "r0-1.2", "r15-1.2"]
    for name in ("own", "robust", "bound"):
        np.testing.assert_array_equal(lines[name].get_ydata(), [getattr(p, f"{name}_hz") for p in rising])
    solid = next(line for line in ax.lines if line.get_label() == "own controller")
    assert len(solid.get_xdata()) == 4  # the one that does not surely meet its requirements stays hollow
    assert ax.get_ylabel() == "bandwidth [Hz]"
    low, high = ax.get_ylim()
    assert low < 0.8
    assert high > 6.2


def test_lowest_bandwidths_are_marked(found):
    levels = {float(line.get_ydata()[0]) for line in costs(found).lines if line.get_linestyle() == "--"}
    assert levels == {2.0, 0.8}


def test_a_tied_parameter_is_drawn_once(found):
    assert list(found.parameters()) == ["1 gain gain", "2 notch f1_hz", "2 notch f2_hz"]
    assert distinct(found) == ["1 gain gain", "2 notch f1_hz"]


def test_parameters_over_the_first_quantity_a_line_for_each_of_the_second(found):
    ax = parameter(found, "2 notch f1_hz")
    lines = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(lines["0.8"].get_xdata(), [-15.0, 0.0, 15.0])
    np.testing.assert_array_equal(lines["0.8"].get_ydata(), [7.0, 6.5, 7.1])
    np.testing.assert_array_equal(lines["1.2"].get_ydata(), [6.0, 6.4])
    assert lines["robust"].get_ydata()[0] == 4.2
    assert "[Hz]" in ax.get_ylabel()


def test_the_page_is_the_same_twice(found):
    figure = schedule_page(found)
    assert len(figure.axes) == 3
    assert png(figure) == png(schedule_page(found))
