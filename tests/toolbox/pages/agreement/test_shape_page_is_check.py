"""The page of `shape`, in a real browser, finds what `check` finds: values, intervals, bounds, stability, verdicts."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import page_in_browser
import pytest
import several_cases
import shaped_cases
from bench_nouns import LIMITS, Block

import loopshape as ls
from loopshape.loop.predict.step_response import predict_step
from loopshape.toolbox.pages.shape.payload import controller_words
from loopshape.toolbox.pages.shape.shaping import page_of, shaped

AGREES = 1e-6
LAGS = ls.controller(ls.gain(3.0), ls.lead_lag(5.0, 60.0), rate_hz=shaped_cases.RATE_HZ, loop="x")
WANTED = ls.Requirements(
    "x", phase_margin_deg=30.0, sensitivity_peak_db=6.0, gain_margin_db=5.0, disk_margin=0.5, delay_margin_s=1e-3,
    bandwidth_hz=5.0, integrators=0, unstable_poles=0, control_high_frequency_db=30.0,
    control_high_frequency_from_hz=200.0, controller_bandwidth_hz=400.0, detuning_percent=1.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    with page_in_browser.browser() as browser:
        yield browser.new_context()


def asked(page: Any, controller: ls.Controller) -> dict[str, Any]:
    words = "c => loopshape.ask(c).then(v => JSON.stringify(v, (k, x) => Number.isFinite(x) || typeof x !== 'number'"
    text = page.evaluate(f"{words} ? x : String(x)))", controller_words(controller))
    return dict(json.loads(text))


def far(one: float, other: Any) -> float:
    other = float("nan" if other is None else str(other).replace("Infinity", "inf").replace("NaN", "nan"))
    if one == other or (np.isnan(one) and np.isnan(other)):
        return 0.0
    return float(abs(one - other) / max(abs(one), 1.0))


def differences(verdict: ls.Verdict, found: dict[str, Any], without: tuple[str, ...] = ()) -> list[str]:
    out = []
    for (name, m), other in zip(verdict.margins.items(), found["margins"], strict=True):
        if m.stable != other["stability"]["outcome"]:
            out.append(f"{name}: {m.stable} ({m.stability_reason}), and {other['stability']}")
        for limit in LIMITS:
            if limit.name in without:
                continue
            pairs = [(getattr(m, limit.name), other["values"].get(limit.name))]
            pairs += list(zip(m.intervals.get(limit.name, ()), other["intervals"].get(limit.name, ()), strict=True))
            pairs += [(m.bounds[limit.name], other["bounds"].get(limit.name))] if limit.name in m.bounds else []
            worst = max(far(a, b) for a, b in pairs)
            out += [] if worst < AGREES else [f"{name}: {limit.name} {pairs}"]
        if "detuning_percent" not in without:
            out += [f"{name}: {words}" for words in detuning_differences(m, other["detuning"])]
    rows = [(line.quantity, line.outcome) for line in verdict.lines]
    others = [(row["quantity"], row["outcome"]) for row in found["rows"]]
    out += [] if rows == others else [f"{rows} and {others}"]
    for line, row in zip(verdict.lines, found["rows"], strict=False):
        pairs = [(line.required, row["required"]), (line.slack, row["slack"])]
        out += [] if max(far(a, b) for a, b in pairs) < AGREES else [f"{line.quantity}: {pairs}"]
    return out + ([] if verdict.outcome == found["outcome"] else [f"{verdict.outcome} and {found['outcome']}"])


def detuning_differences(m: ls.Margins, found: dict[str, Any] | None) -> list[str]:
    """Where up and down of the whole plant, or of single resonances, differ."""
    if m.detuning is None or found is None:
        return [] if m.detuning is None and found is None else [f"detuning {m.detuning} and {found}"]
    alone = found["resonances"] or []
    if len(alone) != len(m.detuning.resonances):
        return [f"{len(m.detuning.resonances)} resonances and {len(alone)}"]
    out = []
    for one, other in zip((m.detuning, *m.detuning.resonances), (found, *alone), strict=True):
        for way in ("up", "down"):
            mine, its = getattr(one, way), other[way]
            pairs = [(mine.percent, its["percent"]), *zip(mine.interval_percent, its["interval"], strict=True)]
            same = (mine.breaks, mine.beyond) == (its["breaks"], its["is_bound"])
            out += [] if same and max(far(a, b) for a, b in pairs) < AGREES else [f"{way} {mine} and {its}"]
    return out


def page_on(context: Any, folder: Path, frfs: list[ls.FRF], C: ls.Controller, R: ls.Requirements) -> Any:
    file = folder / "shape.html"
    file.write_bytes(page_of([shaped(frfs, C, R, ())], "test"))
    return page_in_browser.opened(context, file)


def compared(
    context: Any, folder: Path, frfs: list[ls.FRF], C: ls.Controller, R: ls.Requirements, count: int
) -> list[str]:
    page, rng = page_on(context, folder, frfs, C, R), np.random.default_rng(3)
    out = list(page.errors)
    for controller in [C, *(shaped_cases.moved(C, rng) for _ in range(count))]:
        out += differences(ls.check(frfs, controller, R), asked(page, controller))
    page.close()
    return out


def test_the_bench_and_its_controller(context: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    assert not compared(context, tmp_path, [P], C, R, 2)


@pytest.mark.long
def test_a_crossover_below_the_first_line(context: Any, tmp_path: Path) -> None:
    f = np.arange(12.0, 60.0, 0.5)
    P = ls.FRF.from_arrays(f, 60.0 / (2j * np.pi * f), relative_std=0.01, rate_hz=shaped_cases.RATE_HZ, loop="x")
    R = ls.Requirements(
        "x", sensitivity_bandwidth_hz=5.0, complementary_bandwidth_hz=10.0, control_peak_db=20.0, process_peak_db=20.0,
        integrators=1, unstable_poles=0,
    )  # fmt: skip
    assert not compared(
        context, tmp_path, [P], ls.controller(ls.gain(1.0), rate_hz=shaped_cases.RATE_HZ, loop="x"), R, 2
    )


@pytest.mark.long
@pytest.mark.parametrize("kind", ["lag", "minus", "exact", "sharp", "hidden", "sparse", "hole"])
def test_plants_that_ask_for_every_part(kind: str, context: Any, tmp_path: Path) -> None:
    assert not compared(context, tmp_path, shaped_cases.plants(kind), LAGS, WANTED, 3)


@pytest.mark.long
def test_a_plant_whose_sign_is_reversed(context: Any, tmp_path: Path) -> None:
    frfs, R = shaped_cases.plants("reversed"), replace(WANTED, integrators=1)
    assert not compared(context, tmp_path, frfs, LAGS, R, 3)
    assert {m.stable for m in ls.check(frfs, LAGS, R).margins.values()} == {"unstable"}


@pytest.mark.long
@pytest.mark.parametrize("name", shaped_cases.CROWDS)
def test_resonances_close_together_are_followed_as_check_follows_them(name: str, context: Any, tmp_path: Path) -> None:
    """Gains at which they encircle -1, come near it, and stay clear of it."""
    P, R = shaped_cases.crowded(name), ls.Requirements("x", phase_margin_deg=30.0, integrators=1, unstable_poles=0)
    made = [ls.controller(ls.gain(g), rate_hz=shaped_cases.RATE_HZ, loop="x") for g in (1.0, 0.5, 0.1, 0.03)]
    made += [ls.controller(ls.gain(2.0), ls.notch(14.1, 0.05, 0.5), rate_hz=shaped_cases.RATE_HZ, loop="x")]
    page, verdicts = page_on(context, tmp_path, [P], made[0], R), [ls.check([P], C, R) for C in made]
    assert page.evaluate("loopshape.loop.points[0].clusters.length") == 1
    assert [differences(v, asked(page, C)) for v, C in zip(verdicts, made, strict=True)] == [[]] * len(made)
    page.close()
    assert len({m.stable for v in verdicts for m in v.margins.values()}) > 1


MASKS = (
    ls.Mask("S", ((0.5, -18.0), (6.0, 3.0))), ls.Mask("S", ((4.0, 2.0), (280.0, 6.0))),
    ls.Mask("T", ((3.0, 3.0), (450.0, -30.0))), ls.Mask("CS", ((1.0, 30.0), (400.0, 12.0))),
    ls.Mask("PS", ((0.5, 0.0), (100.0, -6.0))),
    ls.Mask("L", ((40.0, -2.0), (450.0, -20.0))), ls.Mask("L", ((0.1, 9.0), (2.0, 3.0)), "at_least"),
)  # fmt: skip
HEAVY = ls.AtPoints(
    {"load_kg": (2.0, 4.0)},
    {"phase_margin_deg": 60.0, "modulus_margin": 0.6},
    (ls.Mask("S", ((0.5, -12.0), (9.0, 4.0))),),
)
LATE = ls.AtPoints({"load_kg": (0.0, 9.0), "x_m": (0.0, 1.0)}, {"phase_margin_deg": 20.0})


@pytest.mark.long
@pytest.mark.parametrize("kind", ["minus", "sharp", "hole"])
def test_masks_and_limits_of_single_operating_points(kind: str, context: Any, tmp_path: Path) -> None:
    """One point lies in a range, one in none, and one range names a coordinate that no point has."""
    frfs = [
        replace(frf, operating_point={"load_kg": load})
        for frf, load in zip(shaped_cases.plants(kind), (1.0, 3.0), strict=True)
    ]
    R = replace(WANTED, detuning_percent=None, masks=MASKS, at=(HEAVY, LATE), sensitivity_mask_db=1.0)
    assert not compared(context, tmp_path, frfs, LAGS, R, 3)


@pytest.mark.long
def test_the_detuning_margin_of_a_mask(context: Any, tmp_path: Path) -> None:
    """A mask on |S| that a moved resonance breaks before anything else does."""
    P, R, _ = shaped_cases.bench()
    R, C = (
        replace(R, masks=(ls.Mask("S", ((50.0, 3.5), (120.0, 3.5))),), detuning_percent=1.0),
        on_the_bench(10.0, 77.5),
    )
    page, verdict = page_on(context, tmp_path, [P], C, R), ls.check([P], C, R)
    (m,) = verdict.margins.values()
    assert m.detuning is not None
    assert m.detuning.worst.breaks == "sensitivity_mask_db"
    assert differences(verdict, asked(page, C)) == []
    page.close()


PID = {"gain": 1.5, "fi_hz": 0.3, "fd_hz": 30.0, "ff_hz": 250.0}
SECTIONS = {
    "a lead": {"n0": 1.0, "n1": 0.01, "n2": 0.0, "d0": 1.0, "d1": 0.001, "d2": 0.0},
    "two integrators": {"n0": 90.0, "n1": 20.0, "n2": 1.0, "d0": 0.0, "d1": 0.0, "d2": 1.0},
    "an integrator with a pole": {"n0": 20.0, "n1": 1.0, "n2": 0.0, "d0": 0.0, "d1": 1.0, "d2": 0.002},
    "a washout": {"n0": 0.0, "n1": 1.0, "n2": 0.0, "d0": 0.5, "d1": 1.0, "d2": 0.001},
}


@pytest.mark.long
@pytest.mark.parametrize("precision", ["double", "q8.28"])
def test_blocks_of_other_programs_and_pid(precision: str, context: Any, tmp_path: Path) -> None:
    """PID and sections, with none, one or two integrators, or a zero at 0 Hz."""
    frfs, rate = shaped_cases.plants("lag"), shaped_cases.RATE_HZ
    blocks = [(Block("pid", PID), Block("notch", {"f1_hz": 50.0, "f2_hz": 50.0, "damping1": 0.02, "damping2": 0.3}))]
    blocks += [(Block("gain", {"gain": 2.0}), Block("section", coefficients)) for coefficients in SECTIONS.values()]
    controllers = [ls.Controller("x", own, rate, precision=precision) for own in blocks]
    page = page_on(context, tmp_path, frfs, controllers[0], WANTED)
    found = [differences(ls.check(frfs, C, WANTED), asked(page, C)) for C in controllers]
    page.close()
    assert found == [[]] * 5


def on_the_bench(gain: float, notch_hz: float) -> ls.Controller:
    parts = ls.gain(gain), ls.lead_lag(1.0, 50.0), ls.notch(notch_hz, 0.1, 0.6), ls.low_pass(400.0, 1.0)
    return ls.controller(*parts, rate_hz=2500.0, loop="motor")


@pytest.mark.long
@pytest.mark.parametrize("percent", [1.5, None])
def test_the_detuning_margin_moves_with_the_controller(percent: float | None, context: Any, tmp_path: Path) -> None:
    """Where it is required, with its intervals from draws, and of a plant with a fit; and where it is only told."""
    P, R, _ = shaped_cases.bench()
    fits = (ls.fit(P, "rational", numerator=2, denominator=4, delay=True),) if percent else ()
    R = replace(R, detuning_percent=percent)
    made = [on_the_bench(*x) for x in ((12.0, 77.5), (10.0, 77.5), (11.0, 79.0), (9.0, 75.0))]
    file = tmp_path / "shape.html"
    file.write_bytes(page_of([shaped([P], made[0], R, fits)], "test"))
    page = page_in_browser.opened(context, file)
    verdicts = [ls.check([P], C, R, fits=fits) for C in made]
    assert [differences(v, asked(page, C)) for v, C in zip(verdicts, made, strict=True)] == [[]] * 4
    page.close()
    found = [m.detuning_percent for v in verdicts for m in v.margins.values()]
    assert len({round(x, 3) for x in found if 0.0 < x < 20.0}) >= 3


def test_a_loop_below_1_down_to_0_hz_keeps_its_detuning_margin(context: Any, tmp_path: Path) -> None:
    """L is finite at 0 Hz and nowhere 1: shifted it is read down to there, or the peak of |S| would be open."""
    f = np.geomspace(0.5, 200.0, 200)
    P = shaped_cases.noisy(f, 1.0 / (1.0 + 1j * f / 8.0) ** 2, 0.01, "lag", seed=3)
    R = ls.Requirements("x", sensitivity_peak_db=6.0, integrators=0, unstable_poles=0, detuning_percent=2.0)
    made = [ls.controller(ls.gain(g), rate_hz=shaped_cases.RATE_HZ, loop="x") for g in (0.5, 0.8)]
    verdicts = [ls.check([P], C, R) for C in made]
    assert [v.outcome for v in verdicts] == [ls.Outcome.PASSED] * 2
    file = tmp_path / "shape.html"
    file.write_bytes(page_of([shaped([P], made[0], R, ())], "test"))
    page = page_in_browser.opened(context, file)
    assert [differences(v, asked(page, C)) for v, C in zip(verdicts, made, strict=True)] == [[]] * 2
    page.close()


def test_each_resonance_moved_alone_leaves_what_check_says(context: Any, tmp_path: Path) -> None:
    """Two resonances that a notch and the crossover meet, with and without a model that leads below the lines."""
    f = np.geomspace(0.5, 300.0, 300)
    s, w = 2j * np.pi * f, 2.0 * np.pi * np.array([60.0, 95.0])
    modes = [r * k**2 / (s**2 + 2 * d * k * s + k**2) for r, d, k in zip((8.0, 5.0), (0.02, 0.012), w, strict=True)]
    P = shaped_cases.noisy(f, 30.0 / (s * (1.0 + s / 60.0)) * (0.4 + sum(modes)), 0.005, "two modes", seed=2)
    R = ls.Requirements("x", phase_margin_deg=30.0, sensitivity_peak_db=6.0, integrators=1, unstable_poles=0)
    R = replace(R, detuning_percent=1.5)
    fit = ls.fit(P, "rational", numerator=4, denominator=6)
    made = [
        ls.controller(ls.gain(g), ls.notch(n, 0.02, 0.1), ls.notch(95.0, 0.015, 0.1), ls.low_pass(80.0, 0.7),
                      ls.lead_lag(8.0, 60.0), rate_hz=shaped_cases.RATE_HZ, loop="x")
        for g, n in ((0.2, 60.0), (0.2, 59.3), (0.205, 60.4))
    ]  # fmt: skip
    verdicts = [ls.check([P], C, R, fits=(fit,)) for C in made]
    file = tmp_path / "shape.html"
    file.write_bytes(page_of([shaped([P], made[0], R, (fit,))], "test"))
    page = page_in_browser.opened(context, file)
    assert [differences(v, asked(page, C)) for v, C in zip(verdicts, made, strict=True)] == [[]] * len(made)
    page.close()
    moved = [one for v in verdicts for m in v.margins.values() if m.detuning for one in m.detuning.resonances]
    assert {round(one.frequency_hz) for one in moved} == {60, 95}
    assert len({round(way.percent, 3) for one in moved for way in (one.up, one.down) if 0.0 < way.percent < 20.0}) >= 3


@pytest.mark.long
@pytest.mark.parametrize("coupling", [0.3, 2.0])
def test_each_loop_of_a_matrix_meets_the_plant_with_the_others_closed(
    coupling: float, context: Any, tmp_path: Path
) -> None:
    P = coupled(coupling)
    controllers = [several_cases.gain("a", 6.0), several_cases.gain("b", 4.0, several_cases.lead(3.0, 12.0))]
    wanted = [ls.Requirements(name, phase_margin_deg=30.0, sensitivity_peak_db=6.0) for name in "ab"]
    together = ls.Requirements(integrators=2, unstable_poles=0)
    file = ls.shape(P, controllers, wanted, tmp_path / "several.html", together=together)
    page, verdict = page_in_browser.opened(context, file), ls.check(P, controllers, wanted, together=together)
    for k, (one, controller) in enumerate(zip(verdict.each, controllers, strict=True)):
        page.get_by_label("Loop", exact=True).select_option(str(k))
        page.locator("#closed", has_text=f"Loop {controller.loop}, with {'ba'[k]} closed.").wait_for()
        found = asked(page, controller)
        assert differences(one, found, ("detuning_percent",)) == []
        assert found["margins"][0]["stability"]["outcome"] == "stable"
    page.close()


def coupled(coupling: float) -> ls.FRF:
    """Two coupled lags with integrators."""
    f = np.arange(0.1, 20.0, 0.1)
    s = 2j * np.pi * f
    G = np.array([[1.0, coupling], [-coupling, 1.0]]) * (4.0 / (s * (0.02 * s + 1.0)))[:, None, None]
    return several_cases.noisy(several_cases.frf_of(f, G, 0.01, loop="a+b"), np.random.default_rng(0))


def test_the_step_is_that_of_the_prediction_from_the_fit(context: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    fit = ls.fit(P, "rational", numerator=2, denominator=4, delay=True)
    file = tmp_path / "shape.html"
    file.write_bytes(page_of([shaped([P], C, R, (fit,))], "test"))
    page, step = page_in_browser.opened(context, file), predict_step(fit, C, draws=0)
    found = page.evaluate("(({timeS, y, ...read}) => ({timeS: [...timeS], y: [...y], ...read}))(loopshape.step(0))")
    page.close()
    assert step is not None
    assert step.time_s == pytest.approx(found["timeS"], rel=1e-12)
    assert step.response == pytest.approx(found["y"], abs=1e-9)
    assert step.indicators.overshoot == pytest.approx(found["overshoot"], abs=1e-9)
    assert step.indicators.settling_time_s == pytest.approx(found["settlingS"], rel=1e-9)


@pytest.mark.long
def test_fifty_controllers_on_the_bench(context: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    assert not compared(context, tmp_path, [P], C, R, 50)
