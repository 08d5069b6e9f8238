"""Blocks that the page adds are those of Python by formula and by file; `check` finds of them what the page finds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import page_in_browser
import pytest
import shaped_cases
from test_shape_page_is_check import asked, differences

import loopshape as ls
from loopshape.toolbox.pages.shape.payload import controller_from

TWO_PI = 2.0 * np.pi


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    with page_in_browser.browser() as browser:
        yield browser.new_context(accept_downloads=True)


@pytest.fixture
def page(context: Any, tmp_path: Path) -> Iterator[Any]:
    P, R, C = shaped_cases.bench()
    made = page_in_browser.opened(context, ls.shape(P, C, R, tmp_path / "bench.html"))
    made.set_viewport_size({"width": 1440, "height": 1000})
    yield made
    assert not made.errors
    made.close()


def added(page: Any, word: str, **numbers: float) -> dict[str, float]:
    """The parameters of a new block, its numbers typed one after the other by their labels."""
    page.get_by_label("New block").select_option(word)
    page.get_by_role("button", name="add a block of this kind").click()
    k = page.evaluate("loopshape.design.blocks.length") - 1
    page.locator(f"#on-{k}").wait_for()
    for name, value in numbers.items():
        page.locator(f"#b{k}-{name}").fill(repr(value))
        page.keyboard.press("Enter")
    return dict(page.evaluate(f"loopshape.design.blocks[{k}].parameters"))


def test_a_notch_by_depth_and_width_is_that_of_python(page: Any) -> None:
    found = added(page, "notch", f1_hz=50.0, depth_db=20.0, width_hz=10.0)
    wanted = ls.notch(50.0, depth_db=20.0, width_hz=10.0).block({}).parameters
    assert found == pytest.approx(dict(wanted), rel=1e-12)


def test_a_resonator_a_complex_lead_an_integrator_and_a_high_pass_are_what_they_are_called(page: Any) -> None:
    found = added(page, "resonator", f1_hz=20.0, damping1=0.3, damping2=0.1)
    assert found == dict(ls.resonator(20.0, 0.3, 0.1).block({}).parameters)
    found = added(page, "complex_lead", f1_hz=20.0, f2_hz=60.0, damping1=0.4)
    assert found == dict(ls.complex_lead(20.0, 60.0, 0.4).block({}).parameters)
    s = 2j * np.pi * np.geomspace(0.1, 100.0, 50)

    def response(p: dict[str, float]) -> Any:
        return (p["n0"] + p["n1"] * s + p["n2"] * s**2) / (p["d0"] + p["d1"] * s + p["d2"] * s**2)

    w = TWO_PI * 0.4
    assert np.allclose(response(added(page, "integrator", f_hz=0.4)), w / s, rtol=1e-12, atol=0.0)
    assert np.allclose(response(added(page, "high_pass", f_hz=0.4)), s / (s + w), rtol=1e-12, atol=0.0)
    names = page.locator(".blocks .head b").all_inner_texts()[-4:]
    assert [name.split(" ", 1)[1] for name in names] == ["resonator", "complex lead", "integrator", "high-pass"]


@pytest.mark.parametrize(
    ("word", "numbers"),
    [
        ("notch", {"f1_hz": 180.0, "depth_db": 12.0, "width_hz": 30.0}),
        ("resonator", {"f1_hz": 3.0, "damping1": 0.2, "damping2": 0.1}),
        ("complex_lead", {"f1_hz": 15.0, "f2_hz": 60.0, "damping1": 0.6}),
        ("integrator", {"f_hz": 0.3}),
        ("high_pass", {"f_hz": 0.3}),
    ],
)
def test_check_finds_of_the_downloaded_file_what_the_page_finds(
    word: str, numbers: dict[str, float], page: Any, tmp_path: Path
) -> None:
    P, R, _ = shaped_cases.bench()
    added(page, word, **numbers)
    page.get_by_label("computation delay [s]").fill("0.0002")
    page.keyboard.press("Enter")
    page_in_browser.until(page, "loopshape.state.controller.computation_delay_s === 0.0002")
    with page.expect_download() as download:
        page.get_by_role("button", name="download the controller").click()
    download.value.save_as(tmp_path / "controller.toml")
    (C,) = ls.read_controllers(tmp_path / "controller.toml")
    assert C.computation_delay_s == 0.0002
    assert not differences(ls.check([P], C, R), asked(page, C))


def test_handles_of_an_integrator_and_a_high_pass_move_them(page: Any) -> None:
    added(page, "integrator", f_hz=5.0)
    before = added(page, "high_pass", f_hz=20.0)
    page_in_browser.settled(page)  # typed numbers are drawn
    page.locator("#magnitude").scroll_into_view_if_needed()
    box, (x, y) = page.locator("#magnitude").bounding_box(), page.evaluate("loopshape.handles.H")
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.down()
    page.mouse.move(box["x"] + x + 40, box["y"] + y + 20)
    page.mouse.up()
    after = page.evaluate("loopshape.design.blocks.at(-1).parameters")
    assert after["n1"] == after["d1"] < 0.9 * before["n1"]
    assert (after["d0"], after["n0"]) == (1, 0)


#: where L stands on the Nichols plot near its crossover, and degrees and dB of a pixel there
ON_NICHOLS = """(() => { const { nichols: plot, traces: [{ f, L }] } = loopshape.screen
  const db = k => 20 * Math.log10(Math.hypot(L.re[k], L.im[k])), k = f.findIndex((_, k) => db(k) < 2)
  const deg = Math.atan2(L.im[k], L.re[k]) * 180 / Math.PI
  return { x: plot.px(deg > 0 ? deg - 360 : deg), y: plot.py(db(k)), deg: plot.toX(1) - plot.toX(0),
    db: plot.toY(0) - plot.toY(1) } })()"""


@pytest.mark.parametrize(("right", "up"), [(0, 30), (0, -20), (-14, 0), (-12, 18), (40, 5)])
def test_the_curve_on_the_nichols_plot_follows_the_mouse(right: int, up: int, page: Any) -> None:
    """Up and down by the gain exactly, sideways by the lead, which has 84.8 degrees there and cannot come to 90."""

    def at(hz: float) -> complex:
        return complex(controller_from(page.evaluate("loopshape.state.controller")).response(np.array([hz]))[0])

    page.locator("#nichols").scroll_into_view_if_needed()
    box, there = page.locator("#nichols").bounding_box(), page.evaluate(ON_NICHOLS)
    x, y = round(box["x"] + there["x"]), round(box["y"] + there["y"])
    page.mouse.move(x, y)
    hz, blocks = page.evaluate("loopshape.screen.cursorHz"), page.evaluate("loopshape.design.blocks")
    before = at(hz)
    page.mouse.down()
    page.mouse.move(x + right, y - up)
    page.mouse.up()
    page_in_browser.settled(page)
    ratio = at(hz) / before
    assert 20.0 * np.log10(abs(ratio)) == pytest.approx(up * there["db"], abs=1e-9)
    turned = np.degrees(np.angle(ratio))
    assert 5.0 < turned < 5.3 if right > 0 else turned == pytest.approx(right * there["deg"], abs=1e-9)
    after = page.evaluate("loopshape.design.blocks")
    moved = {old["kind"] for old, new in zip(blocks, after, strict=True) if old != new}
    assert moved == ({"gain", "lead_lag"} if right else {"gain"})
    page.keyboard.press("Control+z")
    page_in_browser.until(page, "loopshape.decided")
    assert page.evaluate("loopshape.design.blocks") == blocks
