"""The walk of docs/shape.md as a person goes it: real clicks and keys, with the pauses of somebody who reads."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import page_in_browser
import pytest
import shaped_cases

import loopshape as ls

#: seconds that a click, a key, a look at a step of the walk take
CLICK, KEY, READ = 0.4, 0.15, 4.0


class Person:
    """Clicks where the pointer can, types key by key, waits as a person does."""

    def __init__(self, page: Any) -> None:
        self.page, self.clicks, self.keys = page, 0, 0

    def click(self, element: Any) -> None:
        element.scroll_into_view_if_needed()
        box = element.bounding_box()
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=4)
        self.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.clicks += 1
        self.page.wait_for_timeout(1000 * CLICK)

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)
            self.keys += 1
            self.page.wait_for_timeout(1000 * KEY)

    def fill(self, label: str, text: str) -> None:
        self.click(self.page.get_by_label(label, exact=True))
        self.press("Control+a", *text, "Enter")

    def add(self, *keys: str) -> None:
        """Chooses a kind of block by its first letters and arrows, as in any list, and adds it."""
        self.page.get_by_label("New block").focus()
        self.press(*keys)
        self.click(self.page.get_by_role("button", name="add a block of this kind"))

    def read(self) -> None:
        self.page.wait_for_timeout(1000 * READ)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Any]:
    P, R, _ = shaped_cases.bench()
    file = ls.shape(P, None, R, tmp_path / "bench.html")
    with page_in_browser.browser() as browser:
        context = browser.new_context(viewport={"width": 1440, "height": 1000}, accept_downloads=True)
        yield page_in_browser.opened(context, file)


@pytest.mark.long
@pytest.mark.hour
def test_from_a_gain_of_1_to_a_signed_controller_in_under_three_minutes(page: Any, tmp_path: Path) -> None:
    begun, person = time.monotonic(), Person(page)
    person.read()
    person.fill("gain of block 1, gain", "12")
    page.locator("#verdict", has_text="the crossover lies lower").wait_for()
    person.read()
    person.add(*"lead")
    person.fill("zero [Hz] of block 2, lead or lag", "1")
    person.fill("pole [Hz] of block 2, lead or lag", "50")
    person.read()
    person.add(*"notch")
    person.fill("zero damping of block 3, notch", "0.1")
    person.fill("pole damping of block 3, notch", "0.6")
    dragged(page)
    person.read()
    person.add(*"low", "ArrowDown")
    person.fill("corner [Hz] of block 4, low-pass, order 2", "400")
    person.fill("damping of block 4, low-pass, order 2", "1")
    person.read()
    page_in_browser.until(page, "loopshape.state.outcome === 'passed'")
    with page.expect_download() as download:
        person.click(page.get_by_role("button", name="download the controller"))
    download.value.save_as(tmp_path / "controller.toml")
    taken = time.monotonic() - begun
    print(f"{taken:.0f} s, {person.clicks} clicks, {person.keys} keys, one drag")
    P, R, _ = shaped_cases.bench()
    assert ls.check([P], ls.read_controllers(tmp_path / "controller.toml")[0], R).passed
    assert taken < 180.0


def dragged(page: Any) -> None:
    """The notch's handle onto the resonance, slower near it, as an eye leads a hand."""
    page.locator("#magnitude").scroll_into_view_if_needed()
    box, (x, y) = page.locator("#magnitude").bounding_box(), page.evaluate("loopshape.handles.N")
    x, y = box["x"] + x, box["y"] + y
    page.mouse.move(x, y, steps=8)
    page.mouse.down()
    for _ in range(400):
        away = page.evaluate("loopshape.screen.size.px(77.3) - loopshape.handles.N[0]")
        if abs(away) < 1.0:
            break
        x += min(max(0.3 * away, -12.0), 12.0) if abs(away) > 3.0 else away
        page.mouse.move(x, y)
        page.wait_for_timeout(30)
    page.mouse.up()


def test_a_page_without_requirements_takes_the_first_one(tmp_path: Path) -> None:
    P, _, _ = shaped_cases.bench()
    file = ls.shape(P, None, None, tmp_path / "bare.html")
    with page_in_browser.browser() as browser:
        page = page_in_browser.opened(browser.new_context(), file)
        page.get_by_label("Add a requirement").select_option(label="phase margin")
        page.get_by_role("button", name="add the requirement that is chosen").click()
        assert page.get_by_label("required phase margin").input_value() == "45"
