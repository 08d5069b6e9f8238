"""A baseline: what got worse, by how much, and whether by more than chance; what is the controller's is not hidden."""

from dataclasses import replace
from math import hypot, inf, nan

import numpy as np
import pytest
from bench_nouns import LIMITS
from verdict_cases import CONTROLLER, OTHER, VALUES, around, checked, line, margins

import loopshape as ls
from loopshape.loop.verdict import data_mark
from loopshape.toolbox.validation.kept.against import Baseline
from loopshape.toolbox.validation.kept.baseline import bridge, compare, same_controllers

HALF = 2.0


def one(before, now, quantity="phase_margin_deg"):
    """The change of one quantity between two margins of other data."""
    found = compare([checked({"r1": before}, data="a")], [checked({"r1": now}, data="b")])
    return next(change for change in found.margins if change.quantity == quantity)


def drawn(rng, points, truth=None):
    """Margins at several points, each its truth with a normal error that its 95 % interval fits."""
    std, made = HALF / 1.959964, {}
    for k in range(points):
        values = {name: value + rng.normal(0.0, std) for name, value in (VALUES | (truth or {})).items()}
        made[f"r{k}"] = margins(values, around(values, HALF))
    return made


@pytest.mark.long
def test_chance_alone_is_called_a_change_in_one_comparison_out_of_20():
    rng, trials = np.random.default_rng(1), 2000
    alarms = 0
    for _ in range(trials):
        found = compare([checked(drawn(rng, 3), data="a")], [checked(drawn(rng, 3), data="b")])
        assert len(found.margins) == 3 * len(LIMITS)
        alarms += found.outcome != "unchanged"
    assert 0.034 < alarms / trials < 0.064  # Bonferroni of independent errors: 4.9 %, binomial deviation 0.5 %


def test_a_change_well_beyond_the_errors_is_found_and_its_interval_holds_the_truth():
    rng, held, trials = np.random.default_rng(2), 0, 200
    for _ in range(trials):
        before, now = drawn(rng, 1), drawn(rng, 1, {"phase_margin_deg": VALUES["phase_margin_deg"] - 12.0})
        change = one(before["r0"], now["r0"])
        assert change.outcome == "worse"
        held += change.interval[0] < -12.0 < change.interval[1]
    assert held / trials > 0.98  # the intervals hold all 14 changes at once with 95 %, one with 99.6 %


def test_without_widening_one_change_has_both_reaches_in_quadrature():
    before = margins({"phase_margin_deg": 50.0}, {"phase_margin_deg": (47.0, 51.0)})
    now = margins({"phase_margin_deg": 44.0}, {"phase_margin_deg": (42.0, 48.0)})
    change = one(before, now)  # the only margin with an interval: nothing is widened
    assert change.change == pytest.approx(-6.0)
    assert change.interval == pytest.approx((-6.0 - hypot(2.0, 1.0), -6.0 + hypot(4.0, 3.0)))
    assert change.outcome == "worse"
    less = margins({"phase_margin_deg": 45.5}, {"phase_margin_deg": (43.5, 49.5)})
    assert one(before, less).outcome == "unchanged"  # -4.5 + 5 is above 0
    mirrored = margins({"phase_margin_deg": 45.5}, {"phase_margin_deg": (41.5, 47.5)})
    assert one(before, mirrored).outcome == "worse"  # -4.5 + hypot(2, 3) is below 0: the lopsided side decides


def test_a_peak_that_falls_is_better_and_a_margin_that_falls_is_worse():
    for limit in LIMITS:
        value = VALUES[limit.name]
        change = one(margins(), margins({limit.name: value - 1.0}), limit.name)
        assert change.outcome == ("worse" if limit.sense == "at_least" else "better")
        assert (change.change, change.interval, change.unit) == (pytest.approx(-1.0), None, limit.unit)


def test_on_the_same_data_no_interval_hides_what_the_controller_did():
    wide = around(VALUES, 8.0)
    fallen = margins(VALUES | {"phase_margin_deg": VALUES["phase_margin_deg"] - 0.5}, wide)
    was = checked({"r1": margins(None, wide)}, data="a")
    same = compare([was], [checked({"r1": fallen}, data="a", controller=OTHER)])
    assert [(c.quantity, c.outcome, c.common, c.interval) for c in same.of("worse")] == [
        ("phase_margin_deg", "worse", True, None)
    ]
    assert same.notes == ("loop axis: another controller, the same data",)
    other = compare([was], [checked({"r1": fallen}, data="b", controller=OTHER)])
    assert other.outcome == "unchanged"
    assert other.notes == ("loop axis: another controller, other data",)


def test_what_four_figures_do_not_show_is_no_change():
    for quantity, value in (("phase_margin_deg", 45.0), ("sensitivity_peak_db", 0.001), ("delay_margin_s", 1e-3)):
        tiny = 0.5e-4 * max(value, 1.0 if quantity != "delay_margin_s" else 0.0)
        for step, outcome in ((tiny, "unchanged"), (4.0 * tiny, "worse")):
            moved = value + (step if quantity == "sensitivity_peak_db" else -step)
            assert one(margins({quantity: value}), margins({quantity: moved}), quantity).outcome == outcome


def test_a_margin_without_an_interval_is_exact_and_that_is_noted():
    before = checked({"r1": margins(None, around(VALUES, 1.0))}, data="a")
    found = compare([before], [checked({"r1": margins({"bandwidth_hz": 99.0})}, data="b")])
    assert found.notes[1:] == ("1 margin lacks an interval and is compared as exact",)
    assert all(change.interval is not None for change in found.margins)  # the other side's still counts
    assert compare([before], [checked({"r1": margins()}, data="b")]).notes[1:] == ()


def test_margins_without_end():
    bounded = {"gain_margin_db": (8.0, 12.0)}
    sure, unsure = {"gain_margin_db": (inf, inf)}, {"gain_margin_db": (11.0, inf)}
    endless = margins({"gain_margin_db": inf}, sure)
    finite = margins({"gain_margin_db": 10.0}, bounded)
    assert one(endless, endless, "gain_margin_db").outcome == "unchanged"
    assert one(endless, endless, "gain_margin_db").change == 0.0
    assert one(endless, finite, "gain_margin_db").outcome == "worse"
    assert one(finite, endless, "gain_margin_db").outcome == "better"
    assert one(margins({"gain_margin_db": inf}, unsure), finite, "gain_margin_db").outcome == "unchanged"
    assert one(finite, margins({"gain_margin_db": inf}, unsure), "gain_margin_db").outcome == "unchanged"
    open_ended = margins({"gain_margin_db": 10.0}, {"gain_margin_db": (8.0, inf)})
    assert one(open_ended, margins({"gain_margin_db": 8.5}, bounded), "gain_margin_db").outcome == "unchanged"


def test_what_was_not_found_is_not_compared():
    before = margins({"disk_margin": nan, "control_high_frequency_db": -inf})
    quantities = {c.quantity for c in compare([checked({"r1": before})], [checked({"r1": margins()})]).margins}
    assert {limit.name for limit in LIMITS} - quantities == {"disk_margin", "control_high_frequency_db"}


@pytest.mark.parametrize(("before", "now", "worse"), [
    ("stable", "undecided", True), ("stable", "unstable", True), ("undecided", "unstable", True),
    ("undecided", "stable", False), ("unstable", "undecided", False),
])  # fmt: skip
def test_stability_comes_before_margins(before, now, worse):
    found = compare(
        [checked({"r1": margins(stable=before)})], [checked({"r1": margins({"bandwidth_hz": 99.0}, stable=now)})]
    )
    (change,) = found.stabilities
    assert (change.before, change.now, change.worse, change.step < 0) == (before, now, worse, not worse)
    assert found.margins == ()
    assert found.outcome == ("worse" if worse else "better")


def test_an_unstable_loop_has_no_margins_to_compare():
    point = {"r1": margins(stable="unstable")}
    assert compare([checked(point)], [checked(point)]).margins == ()


def test_lines_that_changed_are_said_worst_first_and_a_limit_that_was_moved_too():
    before = [line("bandwidth_hz", "failed"), line(outcome="passed", required=45.0), line("gain_margin_db", "passed")]
    before += [line("modulus_margin", "passed")]
    now = [line("bandwidth_hz", "passed"), line(outcome="passed", required=40.0), line("gain_margin_db", "undecided")]
    now += [line("disk_margin", "failed")]
    found = compare([checked({"r1": margins()}, before)], [checked({"r1": margins()}, now)])
    said = {x.quantity: (x.before and x.before.outcome, x.now and x.now.outcome, x.worse) for x in found.lines}
    assert found.lines[0].quantity == "gain_margin_db"
    assert said == {
        "gain_margin_db": ("passed", "undecided", True),
        "bandwidth_hz": ("failed", "passed", False),
        "phase_margin_deg": ("passed", "passed", False),
        "modulus_margin": ("passed", None, False),
        "disk_margin": (None, "failed", False),
    }
    assert found.outcome == "worse"


def test_points_and_loops_that_come_or_go_are_said_and_one_that_is_gone_is_worse():
    two = checked({"r1": margins(), "r2": margins()})
    three = checked({"r1": margins(), "r3": margins()})
    found = compare([two, checked({"r1": margins()}, loop="old")], [three, checked({"r1": margins()}, loop="new")])
    assert found.gone == ("r2 of loop axis", "loop old")
    assert found.new == ("r3 of loop axis", "loop new")
    assert found.outcome == "worse"
    assert compare([checked({"r1": margins()})], [two]).outcome == "unchanged"


def test_the_largest_change_stands_for_a_quantity_and_says_how_often():
    before = checked({name: margins() for name in ("r1", "r2", "r3")})
    falls = {"r1": 1.0, "r2": 3.0, "r3": -2.0}
    value = VALUES["phase_margin_deg"]
    now = checked({name: margins({"phase_margin_deg": value - fall}) for name, fall in falls.items()})
    found = compare([before], [now]).largest()
    assert [(c.recording, c.outcome, round(c.change, 6), n) for c, n in found] == [
        ("r2", "worse", -3.0, 2),
        ("r3", "better", 2.0, 1),
    ]


def test_the_way_across_is_needed_where_controller_and_data_both_changed():
    point = {"r1": margins()}
    for controller, data, wanted in ((OTHER, "b", ("axis",)), (OTHER, "a", ()), (CONTROLLER, "b", ())):
        assert bridge([checked(point)], [checked(point, controller=controller, data=data)]) == wanted
    assert same_controllers(checked(point), checked(point, controller=replace(CONTROLLER)))
    assert not same_controllers(checked(point), checked(point, controller=replace(CONTROLLER, rate_hz=999.0)))


def test_what_differs_underneath_is_said():
    before = checked({"r1": margins(), "r2": margins()})
    fallen = checked({"r1": margins(), "r2": margins({"bandwidth_hz": 1.0})})
    assert compare([before], [before]).notes == ("loop axis: the same controller, the same data",)
    assert compare([before], [fallen]).notes == (
        "loop axis: the same controller, the same data; the program, its fits or the requirements have changed",
    )
    half = replace(before, data=before.data | {"r2": "b"}, controllers=(OTHER,))
    assert compare([before], [half]).notes == ("loop axis: another controller, other data at 1 of 2 operating points",)
    assert compare([before], [checked({"r3": margins()})]).notes == ()


def test_other_data_do_not_excuse_what_the_controller_did():
    before, now = ({"r1": margins(v, around(VALUES, 8.0))} for v in (None, VALUES | {"phase_margin_deg": 11.0}))
    whole = compare([checked(before)], [checked(now, data="b", controller=OTHER)])
    by_controller = compare([checked(before, data="b")], [checked(now, data="b", controller=OTHER)])
    assert (whole.outcome, by_controller.outcome) == ("unchanged", "worse")
    assert not Baseline(whole).worse
    assert Baseline(whole, by_controller=by_controller, by_plant=whole).worse


def frf(scale=1.0):
    f = np.geomspace(0.1, 100.0, 400)
    G = scale * np.exp(0.3j) / (1j * f) / (1.0 + 1j * f / 30.0)
    shape = (f.size, 1, 1)
    return ls.FRF(
        f, G[:, None, None], np.full(shape, 1e-9 + 0j), np.ones(f.size, bool), ("z_v",), ("y_rad",), "made up"
    )


def test_the_mark_of_data_survives_the_last_digits_and_no_more():
    rng = np.random.default_rng(4)
    other = frf()
    last_digits = 1.0 + 1e-14 * rng.standard_normal(other.response.shape)
    assert replace(other, response=other.response * last_digits).digest != other.digest
    assert data_mark(replace(other, response=other.response * last_digits)) == data_mark(other)
    assert data_mark(frf(1.0 + 1e-4)) != data_mark(frf())
    assert data_mark(replace(other, frequency_hz=other.frequency_hz * (1.0 + 1e-4))) != data_mark(other)
    assert data_mark(replace(other, response=other.response * np.exp(1e-3j))) != data_mark(other)
    real = replace(other, response=np.abs(other.response) + 0j)
    marks = {data_mark(replace(real, response=real.response * np.exp(1j * turn))) for turn in (-1e-7, 0.0, 1e-7)}
    assert len(marks) == 1  # a phase of zero has no sign
    silent = np.array(other.response)
    silent[3] = 0.0
    assert len(data_mark(replace(other, response=silent))) == 16
