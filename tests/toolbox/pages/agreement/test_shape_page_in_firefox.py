"""The page of `shape` in Firefox: what `check` finds to 1e-6, and what a person does: drag, keys, undo, save, files."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shaped_cases
from firefox import Firefox, Page, firefox
from test_shape_page_is_check import LAGS, MASKS, WANTED, differences

import loopshape as ls
from loopshape.toolbox.pages.shape.payload import controller_words
from loopshape.toolbox.pages.shape.shaping import page_of, shaped

PLAIN = "(k, x) => Number.isFinite(x) || typeof x !== 'number' ? x : String(x)"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Firefox]:
    with firefox(tmp_path_factory.mktemp("firefox")) as made:
        yield made


@pytest.fixture(scope="module")
def page(browser: Firefox, tmp_path_factory: pytest.TempPathFactory) -> Page:
    """The motor bench, one step before it passes."""
    P, R, _ = shaped_cases.bench()
    blocks = ls.gain(12.0), ls.lead_lag(1.0, 50.0), ls.notch(55.0, 0.1, 0.6), ls.low_pass(400.0, 1.0)
    C = ls.controller(*blocks, rate_hz=2500.0, loop="motor")
    return browser.opened(ls.shape(P, C, R, tmp_path_factory.mktemp("page") / "bench.html"))


def state(page: Page) -> dict[str, Any]:
    return dict(page.evaluate("loopshape.state"))


def asked(page: Page, C: ls.Controller) -> dict[str, Any]:
    words = json.dumps(controller_words(C))
    return dict(json.loads(page.evaluate(f"loopshape.ask({words}).then(found => JSON.stringify(found, {PLAIN}))")))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["sharp", "minus"])
def test_verdicts_are_those_of_check(kind: str, browser: Firefox, tmp_path: Path) -> None:
    frfs, R, rng = shaped_cases.plants(kind), replace(WANTED, masks=MASKS), np.random.default_rng(5)
    (tmp_path / "page.html").write_bytes(page_of([shaped(frfs, LAGS, R, ())], "test"))
    page = browser.opened(tmp_path / "page.html")
    controllers = [LAGS, shaped_cases.moved(LAGS, rng)]
    assert [differences(ls.check(frfs, C, R), asked(page, C)) for C in controllers] == [[], []]
    page.close()


def test_a_notch_is_dragged_until_the_loop_passes_and_undone(page: Page) -> None:
    assert state(page)["outcome"] != "passed"
    page.evaluate("document.querySelector('#magnitude').scrollIntoView({ block: 'center' })")
    wanted = "(([x, y], box) => [box.x + x, box.y + y])(loopshape.handles.N, magnitude.getBoundingClientRect())"
    x, y = page.evaluate(wanted)
    to_hz = "loopshape.screen.size.px(77.5) - loopshape.screen.size.px(55)"
    page.drag((x, y), (x + page.evaluate(to_hz), y))
    page.until("Math.abs(loopshape.state.controller.blocks[2].parameters.f1_hz - 77.5) < 0.7")
    page.until("loopshape.state.outcome === 'passed'")
    page.press("Control", "z")
    page.until("loopshape.state.controller.blocks[2].parameters.f1_hz === 55")
    page.press("Control", "y")
    page.until("loopshape.state.outcome === 'passed'")


def test_numbers_are_typed_and_stepped_and_the_file_is_saved(page: Page, browser: Firefox) -> None:
    page.fill("gain of block 1, gain", "10,5")
    page.until("loopshape.state.controller.blocks[0].parameters.gain === 10.5")
    page.press("Shift", "ArrowUp")
    page.until("Math.abs(loopshape.state.controller.blocks[0].parameters.gain - 11.55) < 1e-9")
    page.until("location.hash.slice(1) === loopshape.address")
    file = browser.downloads / "controller.toml"
    page.click("download the controller")
    page.until("message.textContent.startsWith('controller.toml downloaded')")
    for _ in range(200):
        if file.exists() and file.read_bytes().endswith(b"]\n"):
            break
        page.evaluate("new Promise(go => setTimeout(go, 25))")
    (C,) = ls.read_controllers(file)
    assert [dict(x.parameters) for x in C.blocks] == [x["parameters"] for x in state(page)["controller"]["blocks"]]


def test_a_broken_file_is_refused_in_words(page: Page, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("gain = ")
    before = state(page)["controller"]
    page.give("#file", tmp_path / "bad.toml")
    page.until("message.textContent.includes('bad.toml was not read: line 1: a value is missing')")
    assert state(page)["controller"] == before
