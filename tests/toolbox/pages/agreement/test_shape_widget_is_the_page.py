"""The page in a notebook's cell: its module in a browser with a host of models, and its traits in Python."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import page_in_browser
import pytest
import several_cases
import shaped_cases

import loopshape as ls
from loopshape.toolbox.pages.shape.payload import (
    controller_from,
    controller_words,
    requirement_words,
    requirements_from,
)

pytest.importorskip("anywidget", reason="the extra notebook (anywidget) is not installed")

#: what a notebook does for a widget: a model with traits, and the module's render
HOST = """async ({state, script}) => {
  const heard = {}, sent = [], gone = []
  window.model = { get: name => state[name], set: (name, value) => { state[name] = value },
    save_changes: () => sent.push(structuredClone([state.controller, state.requirements])),
    on: (event, does) => (heard[event] ??= []).push(does), off: (event, does) => gone.push(event) }
  window.python = (name, value) => { state[name] = value; (heard[`change:${name}`] ?? []).forEach(does => does()) }
  Object.assign(window, { state, sent, gone })
  const url = URL.createObjectURL(new Blob([script], { type: 'text/javascript' }))
  const { default: { render } } = await import(url)
  URL.revokeObjectURL(url)
  for (const id of ['one', 'two']) {
    const el = document.body.appendChild(Object.assign(document.createElement('div'), { id }))
    const end = render({ model, el })
    if (id === 'two') window.end = end
  }
}"""


@pytest.fixture(scope="module")
def widget() -> Any:
    P, R, _ = shaped_cases.bench()
    blocks = ls.gain(10.0), ls.lead_lag(1.0, 50.0), ls.notch(77.5, 0.1, 0.6), ls.low_pass(400.0, 1.0)
    return ls.shape(P, ls.controller(*blocks, rate_hz=2500.0, loop="motor"), R, None)


@pytest.fixture(scope="module")
def page(widget: Any) -> Iterator[Any]:
    with page_in_browser.browser() as browser:
        page = browser.new_page(viewport={"width": 1000, "height": 900})
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        sent = widget.get_state()
        state = {name: sent[name] for name in ("payload", "script", "style", "controller", "requirements")}
        page.evaluate(HOST, {"state": json.loads(json.dumps(state)), "script": sent["_esm"]})
        yield page
        assert errors == []


@pytest.mark.long
def test_a_notch_moved_in_the_cell_moves_it_in_python_and_back(widget: Any, page: Any) -> None:
    field = page.locator("#one").get_by_label("zero [Hz] of block 3, notch", exact=True)
    field.fill("79")
    field.press("Enter")
    page_in_browser.until(page, "sent.length === 1")
    ((controller, requirements),) = page.evaluate("sent")
    widget.set_state({"controller": controller, "requirements": requirements})  # as the kernel hears of it
    assert widget.controller.blocks[2].parameters["f1_hz"] == 79.0
    assert repr(widget.requirements) == repr(shaped_cases.bench()[1])
    blocks = list(widget.controller.blocks)
    blocks[0] = type(blocks[0])("gain", {"gain": 8.5})
    widget.controller = replace(widget.controller, blocks=tuple(blocks))
    page.evaluate("words => python('controller', words)", controller_words(widget.controller))
    from playwright.sync_api import expect

    for cell in ("#one", "#two"):
        shown = page.locator(cell).get_by_label("gain of block 1, gain", exact=True)
        expect(shown).to_have_value("8.5")
        page.locator(f"{cell} #verdict-badge .badge.{widget.check().outcome.value}").wait_for()
    assert page.evaluate("sent.length") == 1  # what Python said is not said back


def test_a_requirement_is_changed_from_either_side(widget: Any, page: Any) -> None:
    from playwright.sync_api import expect

    words = {**requirement_words(widget.requirements), "phase_margin_deg": 89.0}
    page.evaluate("words => python('requirements', words)", words)
    page.locator("#one #verdict-badge .badge.failed").wait_for()
    field = page.locator("#one").get_by_label("required phase margin", exact=True)
    expect(field).to_have_value("89")
    before = page.evaluate("sent.length")
    field.fill("31")
    field.press("Enter")
    page_in_browser.until(page, f"sent.length > {before}")
    assert requirements_from(page.evaluate("sent.at(-1)[1]")).phase_margin_deg == 31.0


def test_a_cell_that_is_closed_listens_no_more(page: Any) -> None:
    page.evaluate("end()")
    assert page.evaluate("gone") == ["change:controller", "change:requirements"]


def test_traits_tell_of_changes_and_refuse_another_loop(widget: Any) -> None:
    heard: list[Any] = []
    widget.observe(lambda change: heard.append(change["new"]), "controller")
    C = widget.controller
    widget.controller = controller_from(controller_words(C))
    assert [one.digest for one in heard] == [C.digest]
    with pytest.raises(ls.errors.WrongUseError, match="shapes loop 'motor' at 2500 Hz"):
        widget.controller = ls.controller(ls.gain(1.0), rate_hz=1000.0, loop="motor")
    assert widget.controller.digest == C.digest


F = np.geomspace(0.1, 20.0, 120)


def coupled() -> ls.FRF:
    """Two axes, each moving the other by a third."""
    G = np.array([[1.0, 0.3], [-0.3, 1.0]]) * (4.0 / (2j * np.pi * F * (0.04j * np.pi * F + 1.0)))[:, None, None]
    return several_cases.frf_of(F, G, 0.01, loop="a+b")


@pytest.fixture(scope="module")
def pair() -> Any:
    own = [several_cases.gain("a", 3.0), several_cases.gain("b", 2.0)]
    required = [ls.Requirements("a", modulus_margin=0.5), ls.Requirements("b", modulus_margin=0.5)]
    return ls.shape(coupled(), own, required, None, together=ls.Requirements(integrators=2, unstable_poles=0))


def test_a_widget_of_several_loops_checks_them_closed(pair: Any) -> None:
    own, R = pair.controller, pair.requirements
    assert ([one.loop for one in own], [one.loop for one in R]) == (["a", "b"], ["a", "b"])
    together = ls.Requirements(integrators=2, unstable_poles=0)
    assert pair.check().to_dict() == ls.check(coupled(), own, R, together=together).to_dict()
    with pytest.raises(ls.errors.WrongUseError, match=r"shapes loop 'a' at 1e.06 Hz and 'b' at 1e.06 Hz"):
        pair.controller = own[:1]


@pytest.mark.long
def test_a_gain_of_the_second_loop_moves_it_in_python_and_back(pair: Any, page: Any) -> None:
    from playwright.sync_api import expect

    second = page.context.browser.new_page(viewport={"width": 1000, "height": 900})
    sent = pair.get_state()
    state = {name: sent[name] for name in ("payload", "script", "style", "controller", "requirements")}
    second.evaluate(HOST, {"state": json.loads(json.dumps(state)), "script": sent["_esm"]})
    cell = second.locator("#one")
    cell.get_by_label("Loop", exact=True).select_option("1")
    field = cell.get_by_label("gain of block 1, gain", exact=True)
    expect(field).to_have_value("2")
    field.fill("1.25")
    field.press("Enter")
    page_in_browser.until(second, "sent.length === 1")
    ((controllers, required),) = second.evaluate("sent")
    pair.set_state({"controller": controllers, "requirements": required})
    assert [one.blocks[0].parameters["gain"] for one in pair.controller] == [3.0, 1.25]
    back = [controller_words(one) for one in (pair.controller[0], several_cases.gain("b", 7.0))]
    field.blur()  # what is being typed is not written over
    second.evaluate("words => python('controller', words)", back)
    expect(field).to_have_value("7")
    second.close()
