"""The page of `shape` tunes a design for a bandwidth, offline, and what it says of it is what `check` says."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import page_in_browser
import pytest
import shaped_cases
from test_shape_page_is_check import LAGS, WANTED, asked, differences, page_on

import loopshape as ls
from loopshape.toolbox.pages.shape.payload import controller_from


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    with page_in_browser.browser() as browser:
        yield browser.new_context()


def tuned(page: Any, hz: float) -> tuple[bool, ls.Controller]:
    """What the page says of its tuning, and the controller that it shows then."""
    said = page.evaluate("hz => loopshape.tuneTo(hz)", hz)
    page_in_browser.until(page, "loopshape.state.settled")
    return said, controller_from(page.evaluate("loopshape.state.controller"))


def refused_by_check(frfs: list[ls.FRF], C: ls.Controller, R: ls.Requirements, hz: float) -> bool:
    wanted = replace(R, bandwidth_hz=hz, detuning_percent=None)
    return ls.check(frfs, C, wanted).outcome is not ls.Outcome.PASSED


@pytest.mark.parametrize("hz", [22.0, 25.0])
def test_a_gain_becomes_a_controller_of_the_bench_that_check_passes(hz: float, context: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    start = ls.controller(ls.gain(1.0), rate_hz=C.rate_hz, loop=C.loop)
    page = page_on(context, tmp_path, [P], start, R)
    said, made = tuned(page, hz)
    found = differences(ls.check([P], made, R), asked(page, made))
    page.close()
    assert said
    assert [block.kind for block in made.blocks] == ["gain", "lead_lag", "notch", "low_pass_2"]
    assert not refused_by_check([P], made, R, hz)
    assert found == []


@pytest.mark.long
@pytest.mark.parametrize("kind", ["lag", "exact", "sharp"])
def test_what_the_page_says_of_a_tuning_is_what_check_says(kind: str, context: Any, tmp_path: Path) -> None:
    """From a lead and from a gain, for bandwidths that can be reached and some that cannot."""
    frfs, said = shaped_cases.plants(kind), []
    R = replace(WANTED, detuning_percent=None, controller_bandwidth_hz=None)
    for start in (LAGS, ls.controller(ls.gain(1.0), rate_hz=shaped_cases.RATE_HZ, loop="x")):
        page = page_on(context, tmp_path, frfs, start, R)
        for hz in (6.0, 20.0, 150.0):
            met, made = tuned(page, hz)
            said.append(met)
            assert met is not refused_by_check(frfs, made, R, hz), (hz, made)
        page.close()
    assert set(said) == ({False} if kind == "sharp" else {True, False})  # stability is undecided there


def test_a_drag_of_the_bandwidth_scales_then_tunes_and_is_one_step_back(context: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    page = page_on(context, tmp_path, [P], C, R)
    page.get_by_label("Bandwidth [Hz]").scroll_into_view_if_needed()
    box = page.get_by_label("Bandwidth [Hz]").bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.72 * box["width"], box["y"] + 0.5 * box["height"])
    page.locator("#message", has_text="let go to tune").wait_for()
    scaled, wanted = (
        page.evaluate("loopshape.state.controller"),
        float(page.locator("#bandwidth ~ output").inner_text()),
    )
    page.mouse.up()
    page.locator("#message", has_text="all that is required").wait_for()
    made = controller_from(page.evaluate("loopshape.state.controller"))
    page.get_by_role("button", name="undo").click()
    back = controller_from(page.evaluate("loopshape.state.controller"))
    page.close()
    # what is scaled alone has a gain of 1 at the bandwidth, on the nearest line
    L = ls.Loop(P, controller_from(scaled)).open_loop
    assert np.abs(L.siso[np.searchsorted(L.frequency_hz, wanted)]) == pytest.approx(1.0, rel=1e-3)
    assert back.blocks == C.blocks
    assert made.blocks != C.blocks


def test_locked_numbers_stay_and_what_is_not_reached_is_told(context: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    page = page_on(context, tmp_path, [P], C, R)
    for k, block in enumerate(C.blocks[1:], 1):
        for name in block.parameters:
            page.locator(f"#lock-{k}-{name}").click()
    met, made = tuned(page, 200.0)
    words = page.locator("#message").inner_text()
    page.close()
    assert not met
    assert "not reached" in words
    assert refused_by_check([P], made, R, 200.0)
    assert made.blocks[1:] == C.blocks[1:]
