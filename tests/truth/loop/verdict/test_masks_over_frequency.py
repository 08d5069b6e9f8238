"""Masks on |S|, |T|, |L|, |CS|, |PS| over frequency, and limits of single operating points: judged and tuned to.

The truth is a delayed integrator under a gain, whose responses are written out here.
"""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import LIMIT_OF, Block
from conversions import angular, db
from run_files import requirements_of
from tune_plants import DELAY_S, DELAYED, GAIN, LEAD, LOW_PASS, RATE, frf, servos
from tune_plants import required as asking

import loopshape as ls
from loopshape.loop.verdict import check

F = np.geomspace(0.05, 100.0, 800)
GAIN_OF = 3.0
PI_LOOP = ls.Controller("one", (Block("gain", {"gain": GAIN_OF}),), RATE)
P = 2.0 * np.exp(-1j * angular(F) * DELAY_S) / (1j * angular(F))
L = GAIN_OF * P
SIZES = {
    "S": 1.0 / (1.0 + L), "T": L / (1.0 + L), "CS": GAIN_OF / (1.0 + L), "PS": P / (1.0 + L), "L": L,
}  # fmt: skip
POINTS = ((0.1, -30.0), (2.0, -3.0), (9.0, 4.0))


def required(**more):
    return requirements_of({"name": "one", "integrators": 1, "unstable_poles": 0} | more)


def checked(frfs, requirements, controller=PI_LOOP):
    return check(frfs, controller, requirements)


@pytest.mark.parametrize("response", SIZES)
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_mask_is_exceeded_by_what_its_definition_says(response, noise):
    inside = (POINTS[0][0] <= F) & (POINTS[-1][0] >= F)
    level = np.interp(np.log(F[inside]), np.log([x for x, _ in POINTS]), [y for _, y in POINTS])
    over = db(np.abs(SIZES[response][inside])) - level
    (line,) = checked([frf(DELAYED, std=noise)], required(masks=[{"response": response, "points": POINTS}])).lines
    assert line.quantity == ls.Mask(response, POINTS).quantity
    if noise:
        low, high = line.interval
        assert low - 0.1 < over.max() < high + 0.1
        assert line.slack == pytest.approx(-high)
    else:
        assert line.value == pytest.approx(over.max(), abs=1e-3)
        assert line.at_hz == pytest.approx(F[inside][over.argmax()], rel=0.02)
    assert line.outcome == ("failed" if over.max() > 0.0 else "passed")


def test_a_floor_of_the_open_loop_is_missed_where_the_loop_gain_is_too_low():
    floor = {"response": "L", "sense": "at_least", "points": [[0.1, 20.0], [0.5, 6.0]]}
    (line,) = checked([frf(DELAYED)], required(masks=[floor])).lines
    inside = (F >= 0.1) & (F <= 0.5)
    short = np.interp(np.log(F[inside]), np.log([0.1, 0.5]), [20.0, 6.0]) - db(np.abs(L[inside]))
    assert line.quantity == "loop_floor_db"
    assert line.value == pytest.approx(short.max(), abs=1e-3)


def test_a_flat_mask_on_s_is_a_limit_on_its_peak():
    both = required(sensitivity_peak_db=6.0, masks=[{"response": "S", "points": [[0.05, 6.0], [5000.0, 6.0]]}])
    peak, mask = checked([frf(DELAYED, std=0.02)], both).lines
    assert mask.slack == pytest.approx(peak.slack, abs=0.05)
    assert mask.at_hz == pytest.approx(peak.at_hz, rel=0.05)


def test_what_lies_above_the_last_frequency_is_a_bound_and_below_the_first_is_told():
    above = required(masks=[{"response": "L", "points": [[50.0, -20.0], [1000.0, -60.0]]}])
    found = checked([frf(DELAYED)], above)
    (line,) = found.lines
    assert line.outcome == "undecided"
    assert line.bound is not None
    assert line.measure_to_hz > 100.0
    below = required(masks=[{"response": "S", "points": [[0.001, -30.0], [1.0, 6.0]]}])
    warnings = checked([frf(DELAYED)], below).warnings
    assert any("begins at 0.001 Hz and is not applied below 0.05 Hz" in text for text in warnings)
    elsewhere = required(masks=[{"response": "S", "points": [[0.001, -30.0], [0.01, 6.0]]}])
    assert checked([frf(DELAYED)], elsewhere).outcome == "undecided"


MASKS = [
    {"response": "S", "points": [[0.6, -19.0], [6.0, -1.0], [60.0, 4.0], [300.0, 6.0]]},
    {"response": "CS", "points": [[1.0, 19.0], [200.0, 19.0], [4000.0, -3.0]]},
]


def test_a_tuning_honours_masks_and_comes_up_to_them():
    asked = asking(GAIN, LEAD, LOW_PASS, phase_margin_deg=35.0, masks=MASKS)
    made = ls.tune(servos(0.01), asked, starts=6)
    assert made.verdict.passed
    slack = {line.quantity: line.slack for line in made.verdict.lines}
    assert min(slack.values()) < 0.1  # something binds
    assert min(slack["sensitivity_mask_db"], slack["control_mask_db"]) < 0.1
    free = ls.tune(servos(0.01), asking(GAIN, LEAD, LOW_PASS, phase_margin_deg=35.0), starts=6)
    assert not check(servos(0.01), free.controller, asked).passed
    assert free.bandwidth_hz > made.bandwidth_hz


def at_loads():
    """The servos of three loads, with the load as their operating point."""
    return [replace(one, operating_point={"load": load}) for one, load in zip(servos(), (0.8, 1.0, 1.5), strict=True)]


def test_a_limit_that_depends_on_the_operating_point_is_judged_there_alone():
    asked = asking(GAIN, phase_margin_deg=30.0, at=[{"where": {"load": [1.2, 2.0]}, "phase_margin_deg": 45.0}])
    frfs, low = at_loads(), ls.Controller("one", (Block("gain", {"gain": 0.2}),), RATE)
    found = check(frfs, low, asked)
    (line,) = found.lines
    slack = {name: m.phase_margin_deg - (45.0 if name == "load 1.5" else 30.0) for name, m in found.margins.items()}
    assert line.recording == min(slack, key=slack.get)
    assert line.required == (45.0 if line.recording == "load 1.5" else 30.0)
    nowhere = asking(GAIN, phase_margin_deg=30.0, at=[{"where": {"load": [5.0, 9.0]}, "phase_margin_deg": 45.0}])
    assert any("at no operating point" in text for text in check(frfs, low, nowhere).warnings)


def test_a_tuning_honours_limits_of_single_operating_points():
    own = {"where": {"load": [1.2, 2.0]}, "phase_margin_deg": 60.0, "masks": [MASKS[1]]}
    asked = asking(GAIN, LEAD, phase_margin_deg=40.0, at=[own])
    made = ls.tune(at_loads(), asked, starts=6)
    assert made.verdict.passed
    margins = made.verdict.margins
    assert margins["load 1.5"].phase_margin_deg > 60.0 - 1e-6
    assert np.isnan(margins["load 0.8"].control_mask_db)
    assert margins["load 1.5"].control_mask_db < 1e-6
    plain = ls.tune(at_loads(), asking(GAIN, LEAD, phase_margin_deg=40.0), starts=6)
    assert plain.bandwidth_hz > made.bandwidth_hz


def test_a_shift_of_the_plant_must_keep_the_mask_too():
    peak = required(sensitivity_peak_db=8.0, detuning_percent=1.0)
    mask = required(detuning_percent=1.0, masks=[{"response": "S", "points": [[0.01, 8.0], [5000.0, 8.0]]}])
    one, two = (checked([frf(DELAYED, lines=300)], x).lines[-2:] for x in (peak, mask))
    found = [next(x for x in lines if x.quantity == "detuning_percent").value for lines in (one, two)]
    assert found[1] == pytest.approx(found[0], rel=0.05)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"response": "Q", "points": POINTS}, "S, T, L, CS or PS"),
        ({"response": "S", "points": [[1.0, 2.0]]}, "two pairs"),
        ({"response": "S", "points": [[1.0, 2.0], [1.0, 3.0]]}, "strictly increasing"),
        (
            {"response": "S", "points": [[1.0, 2.0], [2.0, float("nan")]]},
            "pairs of numbers; received .* as entry 2",
        ),
        ({"response": "S", "points": "1, 2"}, "list of pairs"),
        ({"response": "S", "points": POINTS, "sense": "at_least"}, "upper limit"),
        ({"response": "S"}, "masks 1: a key is missing; received no points"),
    ],
)
def test_a_mask_without_meaning_is_refused(table, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        required(masks=[table])


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"sensitivity_mask_db": 1.0}, "needs a mask"),
        ({"at": [{"phase_margin_deg": 40.0}]}, "need where and a limit"),
        ({"at": [{"where": {"x": [1.0, 0.0]}, "phase_margin_deg": 40.0}]}, "must rise"),
        (
            {"at": [{"where": {"x": "low"}, "phase_margin_deg": 40.0}]},
            "where: x must be a pair .*; received 'low'",
        ),
        ({"at": [{"where": {"x": [0.0, 1.0]}, "detuning_percent": 1.0}]}, "cannot be limited"),
        ({"at": [{"where": {"x": [0.0, 1.0]}, "phase_margin_deg": 200.0}]}, "must not exceed"),
        (
            {"at": [{"where": {"x": [0.0, 1.0]}, "phase_margin_deg": "much"}]},
            "phase_margin_deg must be a finite number; received 'much'",
        ),
    ],
)
def test_limits_at_operating_points_without_meaning_are_refused(more, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        required(**more)


def test_a_requirements_file_with_masks_says_what_the_table_says(tmp_path):
    path = tmp_path / "r.toml"
    path.write_text(
        """format = "loopshape-requirements/1"
[[loop]]
name = "one"
phase_margin_deg = 40.0
[[loop.masks]]
response = "S"
points = [[0.1, -30.0], [2, -3.0]]
[[loop.at]]
where = { load = [1.2, 2.0], x_m = 0.5 }
phase_margin_deg = 30.0
"""
    )
    (read,) = ls.read_requirements(path)
    assert read.masks == (ls.Mask("S", ((0.1, -30.0), (2.0, -3.0))),)
    assert read.at == (ls.AtPoints({"load": (1.2, 2.0), "x_m": (0.5, 0.5)}, {"phase_margin_deg": 30.0}),)
    assert read.of({"load": 1.5, "x_m": 0.5}).phase_margin_deg == 30.0
    assert read.of({"load": 1.5}).phase_margin_deg == 40.0
    assert read.limited() == ("phase_margin_deg", "sensitivity_mask_db")
    assert all(name in LIMIT_OF for name in read.limited())
