"""The page of `shape` tells rms of error and plant input under each design, as `check` finds them."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import page_in_browser
import pytest
import shaped_cases

import loopshape as ls
from loopshape.toolbox.pages.shape.payload import LIMITS, controller_words

RATE_HZ = shaped_cases.RATE_HZ
OLD = ls.controller(ls.gain(1.0), rate_hz=RATE_HZ, loop="x")
DESIGNS = (
    OLD,
    ls.controller(ls.gain(3.0), ls.lead_lag(5.0, 60.0), rate_hz=RATE_HZ, loop="x"),
    ls.controller(ls.gain(2.0), ls.lead_lag(2.0, 20.0), ls.low_pass(80.0, 0.7), rate_hz=RATE_HZ, loop="x"),
)


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    with page_in_browser.browser() as browser:
        yield browser.new_context()


def disturbance(kind: str) -> ls.Disturbance:
    """A spectrum of the open loop, or a recording of it or of the closed one, with a shock in it."""
    if kind.startswith("spectrum"):
        length = {"duration_s": 20.0} if kind == "spectrum of a length" else {}
        return ls.Disturbance.from_spectrum([0.0, 1.0, 400.0], [1e-4, 1e-4, 1e-8], loop="x", **length)
    if kind == "odd recording":
        error = 1e-2 * np.random.default_rng(5).standard_normal(3001)
        return ls.Disturbance.from_arrays(error - error.mean(), RATE_HZ, loop="x")
    error = np.cumsum(np.random.default_rng(5).standard_normal(4000)) * 1e-3
    if kind == "shock":
        error[1500:1540] += 0.5 * np.hanning(40)
    return ls.Disturbance.from_arrays(error - error.mean(), RATE_HZ, recorded_under=OLD, loop="x")


@pytest.mark.parametrize("kind", ["spectrum", "recording"])
def test_rms_of_error_and_input_are_those_of_check(kind: str, context: Any, tmp_path: Path) -> None:
    frfs, known = shaped_cases.plants("lag"), disturbance(kind)
    R = ls.Requirements("x", integrators=0, unstable_poles=0, error_rms=0.05)
    file = ls.shape(frfs, OLD, R, tmp_path / "shape.html", disturbance=known)
    page = page_in_browser.opened(context, file)
    for C in DESIGNS:
        words = "c => loopshape.ask(c).then(v => v.margins.map(m => [m.disturbed.error, m.disturbed.control]))"
        found = page.evaluate(words, controller_words(C))
        wanted = [(m.error_rms, m.control_rms) for m in ls.check(frfs, C, R, disturbance=known).margins.values()]
        assert np.array(found) == pytest.approx(np.array(wanted), rel=1e-9)
    told = page.locator("#disturbed").inner_text()
    page.close()
    assert told.startswith("Error rms ")
    assert "at most 0.05 required" in told


def test_without_a_disturbance_nothing_is_told_and_too_long_a_recording_is_left_to_check(
    context: Any, tmp_path: Path
) -> None:
    frfs, R = shaped_cases.plants("lag"), ls.Requirements("x", integrators=0, unstable_poles=0)
    long = ls.Disturbance.from_arrays(np.random.default_rng(5).standard_normal(40_000), RATE_HZ, loop="x")
    for known in (None, long):
        page = page_in_browser.opened(context, ls.shape(frfs, OLD, R, tmp_path / "shape.html", disturbance=known))
        assert page.locator("#disturbed").inner_text() == ""
        page.close()


def test_an_unstable_design_has_an_error_without_bound(context: Any, tmp_path: Path) -> None:
    frfs = shaped_cases.plants("lag")
    R = ls.Requirements("x", integrators=0, unstable_poles=0)
    C, known = ls.controller(ls.gain(-2.0), rate_hz=RATE_HZ, loop="x"), disturbance("spectrum")
    page = page_in_browser.opened(context, ls.shape(frfs, C, R, tmp_path / "shape.html", disturbance=known))
    told = page.locator("#disturbed").inner_text()
    page.close()
    assert told.startswith("Error rms: without bound"), told


def test_a_disturbance_of_several_loops_is_refused(tmp_path: Path) -> None:
    f = np.arange(0.1, 20.0, 0.1)
    G = np.array([[1.0, 0.2], [0.2, 1.0]]) / (1.0 + 2j * np.pi * f)[:, None, None]
    P = ls.FRF.from_arrays(f, G, std=np.full(G.shape, 1e-3), rate_hz=RATE_HZ, loop="a+b")
    each = [ls.controller(ls.gain(1.0), rate_hz=RATE_HZ, loop=name) for name in "ab"]
    with pytest.raises(ls.errors.WrongUseError, match="take one loop alone"):
        ls.shape(P, each, None, tmp_path / "shape.html", disturbance=disturbance("spectrum"))


LIMITED = ls.Requirements(
    "x", integrators=0, unstable_poles=0, error_rms=0.05, control_rms=0.3, control_peak=1.0, control_rate=300.0
)


@pytest.mark.parametrize("kind", ["spectrum", "spectrum of a length", "recording", "odd recording", "shock"])
def test_limits_on_error_and_input_are_judged_as_check_judges_them(kind: str, context: Any, tmp_path: Path) -> None:
    """Values, intervals and outcomes, of designs that pass, are open, fail and are unstable; of plants of two bands."""
    first, second = shaped_cases.plants("lag")
    frfs, known = [first, second.between(1.0, 100.0)], disturbance(kind)
    page = page_in_browser.opened(context, ls.shape(frfs, OLD, LIMITED, tmp_path / "shape.html", disturbance=known))
    outcomes = set()
    for C in (*DESIGNS, ls.controller(ls.gain(-2.0), rate_hz=RATE_HZ, loop="x")):
        verdict = ls.check(frfs, C, LIMITED, disturbance=known)
        words = "c => loopshape.ask(c).then(v => JSON.stringify(v, (k, x) => x === Infinity ? 1e999 + '' : x))"
        found = json.loads(page.evaluate(words, controller_words(C)))
        for m, its in zip(verdict.margins.values(), found["margins"], strict=True):
            for name in ("error_rms", "control_rms", "control_peak", "control_rate"):
                mine = [getattr(m, name), *m.intervals.get(name, ())]
                other = [float(its["values"].get(name, "nan")), *its["intervals"].get(name, ())]
                assert other == pytest.approx(mine, rel=1e-6, nan_ok=True), name
        rows = [(row["quantity"], row["outcome"]) for row in found["rows"]]
        assert rows == [(line.quantity, line.outcome) for line in verdict.lines]
        assert found["outcome"] == verdict.outcome
        outcomes |= {outcome for _, outcome in rows}
    badge = page.locator("#unjudged").is_hidden()
    page.close()
    assert badge
    assert len(outcomes) > 1


@pytest.mark.parametrize("name", ["saturation_percent", "control_rms"])
def test_what_is_required_and_not_judged_is_named_and_keeps_the_verdict_open(
    name: str, context: Any, tmp_path: Path
) -> None:
    """`check` fails the design by a limit that the page does not judge, for the actuator saturates: no pass."""
    frfs, known = shaped_cases.plants("lag"), disturbance("recording")
    C = ls.controller(ls.gain(3.0), rate_hz=RATE_HZ, loop="x")
    more = {"control_range": (-1e-3, 1e-3), name: 1e-9}
    R = ls.Requirements("x", integrators=0, unstable_poles=0, phase_margin_deg=1.0, **more)
    assert ls.check(frfs, C, R, disturbance=known).outcome == "failed"
    page = page_in_browser.opened(context, ls.shape(frfs, C, R, tmp_path / "shape.html", disturbance=known))
    badge, told = page.locator("#verdict-badge").inner_text(), page.locator("#unjudged").inner_text()
    strip, title = page.locator("#strip .badge").text_content(), page.title()
    before = page.evaluate("loopshape.state.outcome")
    file = ls.write(ls.Requirements("x", integrators=0, unstable_poles=0, phase_margin_deg=1.0), tmp_path / "r.toml")
    page.locator("#file").set_input_files(file)
    page_in_browser.settled(page)
    after, hidden = page.evaluate("loopshape.state.outcome"), page.locator("#unjudged").is_hidden()
    page.close()
    assert "undecided" in badge
    assert "undecided" in strip
    assert "undecided" in title
    assert before == "undecided"
    label = next(limit.label for limit in LIMITS if limit.name == name)
    assert f"Required and not judged on this page: {label}" in told
    assert "loopshape check" in told
    assert (after, hidden) == ("passed", True)


def test_a_worst_case_that_nothing_bounds_is_a_word_as_in_check(context: Any, tmp_path: Path) -> None:
    frfs = shaped_cases.plants("lag")
    R = ls.Requirements("x", integrators=0, unstable_poles=0, phase_margin_deg=1.0, sensitivity_peak_db=6.0)
    rows = [line for line in str(ls.check(frfs, OLD, R)).splitlines() if line.startswith(("phase_m", "sensitivity_p"))]
    assert [row.split()[2] for row in rows] == ["undecided", "undecided"]
    page = page_in_browser.opened(context, ls.shape(frfs, OLD, R, tmp_path / "shape.html"))
    shown = page.locator("#requirements td.number b").all_inner_texts()
    page.close()
    assert shown == ["undecided", "undecided"]
