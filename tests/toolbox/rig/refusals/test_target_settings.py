"""A study for a target: what is missing, unknown or without a limit is refused before anything moves."""

from math import inf, radians

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.rig.described import DescribedRig
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.target.acquisition import SampleTable
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Identity, Samples
from loopshape.toolbox.rig.target.target import configuration

STUDY = """
format = "loopshape-study/1"
rig = "target"
operating_points = [{ axis_deg = 10.0 }]
[target]
port = "tcp://127.0.0.1:4000"
on_limit = "hold"
[target.commands]
u_axis_v = { axis = 2.0 }
[limits]
axis = { low_deg = -90.0, high_deg = 90.0, rate_deg_s = 360.0 }
u_axis = { low_v = -5.0, high_v = 5.0 }
[[loop]]
name = "axis"
output = "axis_rad"
control = "z_axis_v"
controller = [{ kind = "gain", gain = 3.0 }]
[[experiment]]
name = "noise"
excites = "axis"
excitation = { kind = "sweep", f_low_hz = 1.0, f_high_hz = 10.0, duration_s = 2.0, amplitude_deg = 1.0 }
"""


@pytest.fixture
def study(tmp_path):
    def read(*changes):
        text = STUDY
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "study.toml"
        path.write_text(text)
        return read_study(path)

    return read


def identity(**changes):
    given = {
        "protocol": 1, "number": "<f8", "most_loops": 4, "most_sections": 12, "buffer_rows": 1024, "memory_ticks": 4096,
        "rate_hz": 1000.0, "pwm_hz": 0.0, "emulated": True, "fast": True, "board": "b", "version": "1",
        "sensors": ("axis_rad",), "commands": ("u_axis_v",),
    }  # fmt: skip
    return Identity(**(given | changes))


def configured(read, **changes):
    rig = DescribedRig(read.loops)
    loops = rig.loop_setups(rig.default_controllers(read.rate_hz), "controller_input")
    return configuration(identity(**changes), loops, read.target, read.rate_hz, {})


def test_what_is_written_is_read_in_stored_units(study):
    read = study()
    assert read.plant == ""
    assert read.target.limits["axis_rad"].high == pytest.approx(radians(90.0))
    assert read.target.limits["axis_rad"].rate == pytest.approx(radians(360.0))
    assert read.target.limits["u_axis_v"].rate == inf
    assert read.target.commands == {"u_axis_v": {"axis": 2.0}}
    rig = DescribedRig(read.loops)
    assert rig.setpoint({"axis_deg": 10.0}) == pytest.approx((radians(10.0),))
    wanted = configured(read)
    assert wanted.hold
    assert wanted.outputs.tolist() == [[1.0]]
    assert wanted.mixing.tolist() == [[2.0]]
    assert wanted.limits[1].tolist() == [-5.0, 5.0, inf]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('on_limit = "hold"', 'on_limit = "go on"', "on_limit is not known"),
        ('on_limit = "hold"', "watchdog_ms = 5", "watchdog_ms lies between 20 and 10000"),
        ('on_limit = "hold"', "speed = 5", "unknown key; received 'speed'"),
        ("u_axis_v = { axis = 2.0 }", "", "a target has commands; received none"),
        ("low_deg = -90.0, ", "", "a limit says low_ and high_ with their unit"),
        ("high_deg = 90.0, rate_deg_s = 360.0", "high_deg = -91.0", "a low value, a higher one and a positive rate"),
        ("rate_deg_s = 360.0", "rate_rad_s = 6.0", "unknown key; received 'rate_rad_s'"),
        ('rig = "target"', 'rig = "simulated"\nplant = "a"', 'only rig = "target" has target'),
    ],
)
def test_a_study_that_does_not_fit_is_refused(study, old, new, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence.replace("(", r"\(")):
        study((old, new))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rate_hz": 500.0}, "runs at another rate than the study; received 500 and 1000 Hz"),
        ({"sensors": ("angle_rad",)}, "the target has no such outputs; received axis_rad; it has angle_rad"),
        ({"sensors": ("axis_rad", "p_bar")}, "not all limits that the target needs; received none for p_bar"),
        ({"commands": ("u_axis_v", "u_b_v")}, "not all commands that the target needs; received none for u_b_v"),
        ({"commands": ("u_b_v",)}, "no such commands; received u_axis_v"),
        (
            {"ranges": ((-1.0, 1.0), (-9.0, 9.0))},
            "the limits of axis_rad lie beyond its range, and limit nothing",
        ),
        ({"ranges": ((-2.0, 2.0), (-5.0, 4.9))}, "write limits within -5 V to 4.9 V"),
        ({"most_loops": 0}, "closes up to 0 loops"),
        ({"most_sections": 0}, "more blocks than the target"),
    ],
)
def test_a_target_that_does_not_fit_is_refused(study, changes, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence):
        configured(study(), **changes)


@pytest.mark.parametrize(
    ("point", "sentence"),
    [
        ({"axis_bar": 1.0}, "another unit than the loop's output"),
        ({}, "names each loop once"),
        ({"axis_deg": 1.0, "axis_rad": 1.0}, "names each loop once"),
        ({"axis_turns": 1.0}, "says its unit"),
    ],
)
def test_an_operating_point_that_does_not_fit_is_refused(study, point, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence):
        DescribedRig(study().loops).check_operating_point(point)


def test_a_rig_without_a_model_is_not_simulated(study):
    with pytest.raises(ls.errors.WrongUseError, match="cannot be simulated"):
        DescribedRig(study().loops).simulate([])


@pytest.mark.parametrize("port", ["tcp://10.0.0.1:4000", "tcp://0.0.0.0:4000", "tcp://example.org:4000", "tcp:4000"])
def test_tcp_beyond_this_machine_is_refused(port):
    with pytest.raises(ls.errors.WrongUseError, match="a TCP target is on this machine"):
        open_link(port, 1)


@pytest.mark.parametrize("port", ["/dev/no-such-port", "", "tcp://127.0.0.1:1"])
def test_a_port_where_nobody_is_is_said(port):
    with pytest.raises(ls.errors.RigError, match=r"no such port|no target answers there"):
        open_link(port, 1)


def samples(first, values, run=1):
    return Samples(run, first, np.asarray(values, dtype=float).reshape(-1, 1))


def test_samples_are_taken_in_order_and_a_gap_is_known():
    intake = SampleTable(1, 10, 1)
    assert intake.take(samples(0, [0, 1])).ravel().tolist() == [0, 1]
    assert intake.take(samples(4, [4, 5])).size == 0
    assert intake.lacking == 4
    assert intake.take(samples(1, [1, 2, 3])).ravel().tolist() == [2, 3]  # sent again, overlapping
    assert intake.take(samples(1, [1, 2])).size == 0  # once more
    assert intake.take(samples(4, [4, 5])).ravel().tolist() == [4, 5]
    assert intake.lacking == 0
    assert intake.table.ravel().tolist() == [0, 1, 2, 3, 4, 5]


def test_samples_of_another_run_or_beyond_the_end_are_not_taken():
    intake = SampleTable(1, 3, 1)
    assert intake.take(samples(0, [9], run=2)).size == 0
    assert intake.take(samples(2, [1, 2])).size == 0
    assert (intake.received, intake.lacking) == (0, 0)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0.0] * 30, None),
        ([0.0] * 20 + [1.1], (0, 20, 1.1, 1.0)),
        ([0.0] * 5 + [-1.2], (0, 5, -1.2, -1.0)),
        (np.arange(30) * 0.006, None),  # 6 a second: slower than 8
        (np.arange(30) * 0.009, (0, 10, 9.0, 8.0)),  # known from the tenth tick on
        ([0.0] * 20 + [0.05] * 5, None),  # a converter's step is no rate
    ],
)
def test_limits_and_rates_of_what_arrived(values, expected):
    intake = SampleTable(1, len(values), 1)
    new = len(intake.take(samples(0, values)))
    found = intake.passed(new, slice(0, 1), np.array([[-1.0, 1.0, 8.0]]), 1000.0)
    assert found == (None if expected is None else pytest.approx(expected))
