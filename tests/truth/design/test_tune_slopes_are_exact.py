"""Every slope that the tuner uses is that of its value: finite differences agree, for all limits and blocks."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block
from tune_plants import GAIN, LEAD, LOW_PASS, NOTCH, PI, RATE, problem_of, required, servos

import loopshape as ls
from loopshape.data.requirement import requirements
from loopshape.design.problem.disturbed import opened
from loopshape.design.problem.measures import measure
from loopshape.design.problem.problem import problem
from loopshape.loop.loops import loops_of
from loopshape.loop.margin.disturbed import disturbed

WEIGHTS = [
    {"response": name, "points": [[1.0, a], [30.0, b], [4000.0, c]]}
    for name, a, b, c in (("S", 20.0, -6.0, -6.0), ("T", -20.0, 0.0, 20.0), ("CS", -30.0, -20.0, 0.0))
] + [{"response": "PS", "points": [[1.0, -40.0], [4000.0, -30.0]]}]
LIMITS = {
    "gain_margin_db": 6.0,
    "gain_reduction_margin_db": 3.0,
    "phase_margin_deg": 40.0,
    "modulus_margin": 0.5,
    "delay_margin_s": 2e-3,
    "sensitivity_peak_db": 5.0,
    "complementary_peak_db": 3.0,
    "control_peak_db": 12.0,
    "control_high_frequency_db": 0.0,
    "control_high_frequency_from_hz": 400.0,
    "bandwidth_hz": 12.0,
    "disk_margin": 0.6,
    "process_peak_db": 30.0,
    "sensitivity_bandwidth_hz": 6.0,
    "complementary_bandwidth_hz": 15.0,
    "controller_bandwidth_hz": 300.0,
    "weighted_norm": 2.0,
    "masks": [
        {"response": name, "points": [[1.0, -20.0], [30.0, 3.0], [4000.0, -10.0]]}
        for name in ("S", "T", "CS", "PS", "L")
    ]
    + [{"response": "L", "sense": "at_least", "points": [[1.0, 20.0], [10.0, 3.0]]}],
    "weights": WEIGHTS,
}
OBJECTIVE = {"bandwidth": 1.0, "disturbance": 0.5, "disturbance_below_hz": 3.0, "weighted_norm": 1.0}
LAG = {"kind": "low_pass", "order": 1, "f_hz": {"min": 50.0, "max": 4000.0}}
FIXED = {"kind": "notch", "f1_hz": 150.0, "f2_hz": {"min": 60.0, "max": 400.0}, "damping1": 0.4, "damping2": "damping1"}
PID = {
    "kind": "pid", "gain": 1.0, "fi_hz": {"min": 0.01, "max": 5.0}, "fd_hz": {"min": 5.0, "max": 500.0},
    "ff_hz": {"min": 100.0, "max": 4000.0},
}  # fmt: skip
#: all kinds of blocks, two notches and two leads; a parameter fixed, two tied
STRUCTURE = (GAIN, LEAD, PI, NOTCH, LAG, FIXED, LEAD, LOW_PASS)
AT = [0.6, 9.0, 160.0, 15.0, 75.0, 0.3, 0.9, 900.0, 170.0, 30.0, 70.0, 300.0, 0.7]


def differences(p, x, k, step=1e-6):
    """Central differences of bandwidths, rejections, rooms and of one over the norm by the k-th parameter."""
    ahead, behind = x.copy(), x.copy()
    ahead[k] += step
    behind[k] -= step
    one, two = measure(p, ahead, {}), measure(p, behind, {})
    assert one.what == two.what
    np.testing.assert_array_equal(one.at, two.at)
    return [
        (getattr(one, n) - getattr(two, n)) / (2.0 * step) for n in ("ln_bandwidth", "rejection", "room", "smallness")
    ]


@pytest.mark.parametrize("runs", [{}, {"prewarp_hz": 70.0, "computation_delay_s": 1e-4, "added_hold": True}])
def test_slopes_agree_with_finite_differences(runs):
    p = problem_of(servos(), required(*STRUCTURE, **LIMITS, objective=OBJECTIVE), **runs)
    x = np.log(AT)
    here = measure(p, x, {})
    assert set(here.what) >= set(LIMITS) - {"control_high_frequency_from_hz", "masks", "weights"}
    every = {limit.name for limit in requirements.LIMITS}
    disturbed_ones = {limit.name for limit in requirements.LIMITS if limit.disturbed}  # the test below
    assert every - set(here.what) == {"detuning_percent", *disturbed_ones}  # by shifted copies (design/shifts.py)
    for k in range(x.size):
        bandwidth, rejection, room, smallness = differences(p, x, k)
        np.testing.assert_allclose(here.bandwidth_slopes[:, k], bandwidth, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(here.rejection_slopes[:, k], rejection, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(here.room_slopes[:, k], room, rtol=1e-4, atol=2e-5)
        np.testing.assert_allclose(here.smallness_slopes[:, k], smallness, rtol=1e-4, atol=2e-5)


@pytest.mark.parametrize("response", ["S", "T", "CS", "PS"])
def test_slopes_of_a_norm_that_is_largest_above_the_last_line(response):
    rising = [{"response": response, "points": [[1.0, -60.0], [1400.0, -60.0], [3000.0, 140.0]]}]
    asked = required(GAIN, LEAD, LOW_PASS, weights=[*WEIGHTS, *rising], objective="weighted_norm")
    p, x = problem_of(servos(), asked), np.log([0.6, 9.0, 160.0, 2000.0, 0.7])
    here = measure(p, x, {})
    assert here.norms[-1].at[here.norms[-1].value.argmin()] >= p.f.size
    assert here.norms[-1].value.min() == here.smallness.min()
    for k in range(x.size):
        *_, smallness = differences(p, x, k)
        np.testing.assert_allclose(here.smallness_slopes[:, k], smallness, rtol=1e-4, atol=2e-5)


def test_slopes_of_what_a_disturbance_makes_agree_and_their_values_are_those_of_the_check():
    f, recorded_under = np.geomspace(0.02, 3000.0, 4000), ls.Controller("one", (Block("gain", {"gain": 0.3}),), RATE)
    density = (1.0 + 0.01 / f**3) / (1.0 + (f / 8.0) ** 2)
    still = ls.Disturbance.from_spectrum(f, density, recorded_under=recorded_under, duration_s=20.0, control_mean=0.3)
    limits = {
        "error_rms": 2.0, "control_rms": 1.0, "control_peak": 9.0, "control_rate": 400.0, "saturation_percent": 2.0,
    }  # fmt: skip
    asked = required(GAIN, LEAD, LOW_PASS, modulus_margin=0.4, control_range=(-60.0, 50.0), **limits)
    loops = loops_of(servos(0.0, 800), ls.Controller("one", (Block("gain", {"gain": 1.0}),), RATE), asked)[0]
    p = problem(loops, asked, RATE, opened=[opened(loop, still, asked) for loop in loops])
    x = np.log([0.6, 9.0, 160.0, 2000.0, 0.7])
    here = measure(p, x, {})
    for name in limits:
        (mine,) = [one for one in here.rows if one.what == name]
        for loop, room in zip(loops, mine.value, strict=True):
            read = disturbed(replace(loop, controllers=p.controller(x)), still, asked.control_range).readings
            if name == "saturation_percent":  # the share turns into the rms that has it
                assert (room > 0.0) == (read[name].value < limits[name])
                continue
            assert limits[name] * np.exp(-room) == pytest.approx(read[name].value, rel=5e-3)
    for k in range(x.size):
        *_, room, _ = differences(p, x, k)
        np.testing.assert_allclose(here.room_slopes[:, k], room, rtol=1e-4, atol=2e-5)


def test_slopes_of_a_pid_agree_with_finite_differences():
    p = problem_of(servos(), required(GAIN, PID, LOW_PASS, **LIMITS))
    x = np.log([0.4, 0.3, 60.0, 700.0, 500.0, 0.7])
    here = measure(p, x, {})
    for k in range(x.size):
        bandwidth, _, room, _ = differences(p, x, k)
        np.testing.assert_allclose(here.bandwidth_slopes[:, k], bandwidth, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(here.room_slopes[:, k], room, rtol=1e-4, atol=2e-5)


def test_a_tied_parameter_moves_its_twin():
    p = problem_of(servos(), required(*STRUCTURE, **LIMITS))
    notch = p.controller(np.log(AT)).blocks[3]
    assert notch.parameters["f1_hz"] == notch.parameters["f2_hz"] == pytest.approx(75.0)
    free = [(v.block, v.name) for v in p.variables]
    assert (3, "f1_hz") in free
    assert (3, "f2_hz") not in free


def test_bandwidths_of_s_and_t_out_of_sight_still_have_slopes():
    # a gain far too low: |S| starts above -3 dB, |T| never comes up to it; the rooms must say which way to go
    p = problem_of(servos(), required(PI, GAIN, **LIMITS))
    here = measure(p, np.log([0.1, 0.02]), {})
    for name in ("sensitivity_bandwidth_hz", "complementary_bandwidth_hz", "bandwidth_hz"):
        rows = np.array([what == name for what in here.what])
        assert np.all(here.room[rows] < 0.0)
        assert name.startswith("s") or np.all(here.room_slopes[rows, 1] > 0.0)
    _, _, room, _ = differences(p, np.log([0.1, 0.02]), 1)
    np.testing.assert_allclose(here.room_slopes[:, 1], room, rtol=1e-4, atol=2e-5)


def test_tightening_a_limit_takes_just_that_room():
    p = problem_of(servos(), required(*STRUCTURE, **LIMITS))
    x, at_first = np.log(AT), np.array([0.5, 0.0, 0.0])
    free, tight = measure(p, x, {}), measure(p, x, {"phase_margin_deg": at_first})
    rows = np.array([what == "phase_margin_deg" for what in free.what])
    taken = (free.room - tight.room)[rows]
    np.testing.assert_allclose(taken, np.where(free.point[rows] == 0, np.radians(0.5), 0.0), atol=1e-12)
    np.testing.assert_array_equal(free.room[~rows], tight.room[~rows])
