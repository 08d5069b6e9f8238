"""The page of `shape` as a person uses it: shaping from gain 1 to a passing loop, drag, type, keys, undo, files."""

import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from socket import create_connection
from threading import Thread, active_count
from typing import Any

import numpy as np
import page_in_browser
import pytest
import several_cases
import shaped_cases
from bench_nouns import Block

import loopshape as ls
from loopshape.toolbox.pages.shape import payload as page_module
from loopshape.toolbox.pages.shape.payload import ShapingSession, controller_words
from loopshape.toolbox.pages.shape.shape_server import ShapeServer
from loopshape.toolbox.pages.shape.shaping import ShapedLoops, shaped

SOURCES = Path(page_module.__file__).parent


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The motor bench from a gain of 1, under its shipped requirements."""
    P, R, _ = shaped_cases.bench()
    return ls.shape(P, None, R, tmp_path_factory.mktemp("shape") / "bench.html")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with page_in_browser.browser() as made:
        yield made


@pytest.fixture
def page(browser: Any, file: Path) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 1440, "height": 1000}, accept_downloads=True)
    made = page_in_browser.opened(context, file)
    yield made
    assert not made.errors
    context.close()


@pytest.fixture(scope="module")
def still(browser: Any, file: Path) -> Iterator[Any]:
    """A page whose design no test changes."""
    context = browser.new_context()
    yield page_in_browser.opened(context, file)
    context.close()


def state(page: Any) -> dict[str, Any]:
    return dict(page.evaluate("loopshape.state"))


def typed(page: Any, label: str, value: float) -> None:
    page.get_by_label(label, exact=True).fill(str(value))
    page.keyboard.press("Enter")


def added(page: Any, kind: str) -> None:
    page.get_by_label("New block").select_option(kind)
    page.get_by_role("button", name="add a block of this kind").click()


def saved(page: Any, name: str, folder: Path) -> Path:
    with page.expect_download() as download:
        page.get_by_role("button", name=f"download the {name}").click()
    download.value.save_as(folder / f"{name}.toml")
    return folder / f"{name}.toml"


def handle(page: Any, label: str) -> tuple[float, float]:
    """Where a handle of the Bode plot stands on the screen."""
    box = page.locator("#magnitude").bounding_box()
    places = page.evaluate("loopshape.handles")
    x, y = places[label]
    return box["x"] + x, box["y"] + y


@pytest.mark.long
def test_the_bench_is_shaped_by_hand_from_gain_1_and_check_signs_it(page: Any, tmp_path: Path) -> None:
    assert state(page)["outcome"] == "failed"
    typed(page, "gain of block 1, gain", 12)
    added(page, "lead_lag")
    typed(page, "zero [Hz] of block 2, lead or lag", 1)
    typed(page, "pole [Hz] of block 2, lead or lag", 50)
    added(page, "notch")
    typed(page, "zero [Hz] of block 3, notch", 55)
    typed(page, "zero damping of block 3, notch", 0.1)
    typed(page, "pole damping of block 3, notch", 0.6)
    added(page, "low_pass_2")
    typed(page, "corner [Hz] of block 4, low-pass, order 2", 400)
    typed(page, "damping of block 4, low-pass, order 2", 1)
    page_in_browser.settled(page)
    assert state(page)["outcome"] != "passed"
    x, y = handle(page, "N")  # and the notch is dragged onto the resonance
    page.mouse.move(x, y)
    page.mouse.down()
    for _ in range(60):
        x += 2.0
        page.mouse.move(x, y)
        page.wait_for_timeout(20)
        notch = state(page)["controller"]["blocks"][2]["parameters"]
        if notch["f1_hz"] > 77.2:
            break
    page.mouse.up()
    page_in_browser.settled(page)
    assert notch["f1_hz"] == notch["f2_hz"]
    assert state(page)["outcome"] == "passed"
    (C,) = ls.read_controllers(saved(page, "controller", tmp_path))
    (R,) = ls.read_requirements(saved(page, "requirements", tmp_path))
    assert ls.check([shaped_cases.bench()[0]], C, R).passed


def test_files_are_byte_for_byte_those_of_python(page: Any, tmp_path: Path) -> None:
    C = ls.controller(
        ls.gain(-2.5e-5), ls.lead_lag(3.0, 33.25), ls.notch(80.1, 0.09, 0.3), ls.low_pass(300.0, 0.7), ls.pi(0.1),
        rate_hz=2500.0, loop="motor", computation_delay_s=1e-5, prewarp_hz=80.0, precision="q8.30",
    )  # fmt: skip
    ls.write(C, tmp_path / "mine.toml")
    page.set_input_files("#file", tmp_path / "mine.toml")
    page.get_by_text("controller read from mine.toml").wait_for()
    assert saved(page, "controller", tmp_path).read_bytes() == (tmp_path / "mine.toml").read_bytes()
    again = ls.read_requirements(saved(page, "requirements", tmp_path))[0]
    R = shaped_cases.bench()[1]
    assert repr(again) == repr(R)
    assert [(b.kind, b.parameters, b.tie) for b in again.structure] == [
        (b.kind, b.parameters, b.tie) for b in R.structure
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gain = ", "line 1: a value is missing"),
        ('format = "loopshape-controllers/1"\nrate_hz = 10.0\n[[loop]]\nname = "motor"\n', "rate is 10 Hz"),
        ('format = "loopshape-controllers/2"\n', 'format must be "loopshape-controllers/1"'),
        (
            'format = "loopshape-controllers/1"\nrate_hz = 2500.0\n[[loop]]\nname = "motor"\n'
            'controller = [{ kind = "notch", f1_hz = 1.0 }]\n',
            "a notch block has the parameters f1_hz, f2_hz, damping1, damping2",
        ),
        (
            'format = "loopshape-controllers/1"\nrate_hz = 2500.0\n[[loop]]\nname = "motor"\n'
            'controller = [{ kind = "pi", f_hz = -1.0 }]\n',
            "corner [Hz] must be positive",
        ),
    ],
)
def test_a_broken_file_is_refused_in_words(text: str, words: str, still: Any, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(text)
    before = state(still)["controller"]
    still.set_input_files("#file", tmp_path / "bad.toml")
    still.locator("#message", has_text=words).wait_for()
    assert "bad.toml was not read" in still.locator("#message").inner_text()
    assert state(still)["controller"] == before


def test_keys_undo_redo_lock_and_a_link_is_a_design(page: Any, browser: Any) -> None:
    field = page.get_by_label("gain of block 1, gain", exact=True)
    field.focus()
    page.keyboard.press("Shift+ArrowUp")
    page.keyboard.press("ArrowUp")
    assert state(page)["controller"]["blocks"][0]["parameters"]["gain"] == pytest.approx(1.111)
    typed(page, "gain of block 1, gain", -3)
    page.keyboard.press("Control+z")
    assert state(page)["controller"]["blocks"][0]["parameters"]["gain"] == pytest.approx(1.111)
    page.keyboard.press("Control+y")
    assert state(page)["controller"]["blocks"][0]["parameters"]["gain"] == -3
    page.get_by_role("button", name="lock gain of block 1, gain", exact=True).press("Enter")
    page.wait_for_selector('[aria-label="gain of block 1, gain"]:disabled')  # drawn with the next picture
    page_in_browser.until(page, "location.hash.slice(1) === loopshape.address")
    other = browser.new_context().new_page()
    other.goto(page.url)
    page_in_browser.settled(other)
    assert state(other)["controller"] == state(page)["controller"]
    other.context.close()


def test_a_wrong_number_is_refused_beside_its_field(page: Any) -> None:
    added(page, "notch")
    typed(page, "zero [Hz] of block 2, notch", -5)
    field = page.get_by_label("zero [Hz] of block 2, notch", exact=True)
    assert field.get_attribute("aria-invalid") == "true"
    beside = page.locator(".parameter", has=field).locator(".why")
    assert beside.inner_text() == "zero [Hz] must be positive; received -5; give a number above 0."
    assert state(page)["controller"]["blocks"][1]["parameters"]["f1_hz"] > 0
    page.get_by_label("zero [Hz] of block 2, notch", exact=True).fill("abc")
    page.keyboard.press("Enter")
    assert "received abc; write digits" in beside.inner_text()
    typed(page, "zero [Hz] of block 2, notch", 50)
    assert (beside.count(), field.get_attribute("aria-invalid")) == (0, "false")
    typed(page, "depth [dB] of block 2, notch", 3)
    assert "depth [dB] must be above 3.01; received 3" in page.locator(".why").inner_text()
    typed(page, "computation delay [s]", -1)
    page.locator(".why", has_text="computation delay [s] must not be negative; received -1").wait_for()


def test_a_design_is_compared_with_one_that_was_kept(page: Any) -> None:
    page.get_by_role("button", name="keep this design to compare with").click()
    typed(page, "gain of block 1, gain", 50)
    page_in_browser.settled(page)
    assert page.get_by_text("B: ").count() > 0
    page.get_by_role("button", name="continue with the design that was kept").click()
    assert state(page)["controller"]["blocks"][0]["parameters"]["gain"] == 1


def tabbed(page: Any) -> tuple[list[str], list[str]]:
    """What can be operated, and what the Tab key reaches from the top, each by its label; a radio group is one stop."""
    numbered = """(() => { const shown = [...document.querySelectorAll('button, select, input, canvas, summary')]
      .filter(x => !x.disabled && x.checkVisibility() && !(x.type === 'radio' && !x.checked))
      shown.forEach((x, k) => x.dataset.stop = k); document.activeElement.blur(); scrollTo(0, 0)
      return shown.map((x, k) => `${k} ${x.ariaLabel ?? x.labels?.[0]?.innerText ?? x.innerText}`) })()"""
    wanted, seen = page.evaluate(numbered), []
    for _ in range(len(wanted) + 2):
        page.keyboard.press("Tab")
        seen.append(page.evaluate("document.activeElement.dataset.stop ?? ''"))
    return wanted, [one for one in wanted if one.split(" ")[0] in seen]


def test_every_control_is_reached_by_tab_and_works_by_keys(page: Any) -> None:
    typed(page, "gain of block 1, gain", 12)
    page.get_by_label("Add a requirement").select_option("detuning_percent")
    page.get_by_role("button", name="add the requirement that is chosen").press("Enter")
    page.get_by_role("button", name="add a block of this kind").press("Enter")
    page.get_by_role("button", name="keep this design to compare with").press("Enter")
    page.get_by_label("step of the fit").press("Space")
    page.locator("#step").wait_for()
    page_in_browser.settled(page)
    wanted, reached = tabbed(page)
    assert len(wanted) > 50
    assert wanted == reached
    page.get_by_role("button", name="remove block 2, notch").press("Enter")
    page_in_browser.until(page, "document.activeElement.id === 'new-kind'")
    page.get_by_role("radio", name="L", exact=True).press("ArrowRight")
    page.locator("#response-P:checked").wait_for()
    page.locator("#phase, #step").locator("visible=true").press("ArrowRight")
    page.locator("#nichols").press("ArrowRight")
    page.locator("#readout", has_text="Hz").wait_for()
    for key in ("+", "+", *["Shift+ArrowRight"] * 3):  # zoomed in, the paper follows the cursor
        page.locator("#magnitude").press(key)
    assert " Hz" in page.locator("#readout").inner_text()


def test_a_finger_drags_a_notch_on_a_phone(browser: Any, file: Path) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = page_in_browser.opened(context, file)
    added(page, "notch")
    page_in_browser.until(page, "'N' in loopshape.handles")
    page.locator("#magnitude").scroll_into_view_if_needed()
    (x, y), touch = handle(page, "N"), context.new_cdp_session(page)
    before = state(page)["controller"]["blocks"][1]["parameters"]
    for kind, dx, dy in [("Start", 0, 0), *(("Move", -4 * k, 3 * k) for k in range(1, 9)), ("End", 0, 0)]:
        points = [] if kind == "End" else [{"x": x + dx, "y": y + dy}]
        touch.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
    wanted = f"b => b.f1_hz < 0.9 * {before['f1_hz']} && b.damping1 < 0.7 * {before['damping1']}"
    page_in_browser.until(page, f"({wanted})(loopshape.state.controller.blocks[1].parameters)")
    assert not page.errors
    context.close()


def test_on_a_phone_the_numbers_stay_beside_the_plot(browser: Any, file: Path) -> None:
    context = browser.new_context(viewport={"width": 375, "height": 700}, has_touch=True, is_mobile=True)
    page = page_in_browser.opened(context, file)
    for plot in ("magnitude", "nichols"):
        page.locator(f"#{plot}").evaluate("x => x.scrollIntoView({ block: 'start' })")
        for name in ("strip", "readout"):
            box = page.locator(f"#{name}").bounding_box()
            assert 0 <= box["y"] < box["y"] + box["height"] <= 700
        top = page.locator("#readout").bounding_box()["y"]
        assert top >= page.locator(f"#{plot}").bounding_box()["y"] + 240
    page_in_browser.settled(page)
    rows = page.locator("#strip .line").all_inner_texts()
    assert page.locator("#strip .badge").inner_text() == page.locator("#verdict-badge").inner_text() == "✗ failed"
    assert len(rows) == len(state(page)["rows"]) + 1  # the first says that stability is not known
    assert [row[0] for row in rows[1:]] == sorted((row[0] for row in rows[1:]), key="✗?✓".index)
    typed(page, "gain of block 1, gain", 12)
    page_in_browser.settled(page)
    assert page.locator("#strip").bounding_box()["y"] > 600
    assert page.locator("#strip .line").all_inner_texts() != rows
    page.set_viewport_size({"width": 1280, "height": 800})
    page.locator("#strip").wait_for(state="hidden")
    context.close()


def test_the_step_of_the_fit_stands_in_place_of_the_phase_and_names_the_fit(browser: Any, tmp_path: Path) -> None:
    P, R, C = shaped_cases.bench()
    fit = ls.fit(P, "rational", numerator=2, denominator=4, delay=True)
    context = browser.new_context()
    page = page_in_browser.opened(context, ls.shape(P, C, R, tmp_path / "fit.html", fits=[fit]))
    page.get_by_label("step of the fit").check()
    page.locator("#step-words", has_text="fit rational 2/4").wait_for()
    before = page.evaluate("loopshape.step(0).y.at(-1)")
    typed(page, "gain of block 1, gain", 0.7 * C.blocks[0].parameters["gain"])
    page_in_browser.until(page, f"loopshape.step(0) && loopshape.step(0).y.at(-1) < {before} - 0.02")
    typed(page, "gain of block 1, gain", -2.0 * C.blocks[0].parameters["gain"])
    page.locator("#step-words", has_text="does not come to rest").wait_for()
    context.close()


def test_intervals_and_detuning_are_shown_while_a_notch_moves(page: Any) -> None:
    added(page, "notch")
    page_in_browser.until(page, "loopshape.state.detuned")
    x, y = handle(page, "N")
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(20):
        page.mouse.move(x + 3.0 * k, y)
        assert "computing" not in page.locator("#detuning").inner_text()
        assert "interval follows" not in page.locator("#requirements").inner_text()
    page.mouse.up()
    page_in_browser.until(page, "loopshape.state.detuned")
    page_in_browser.until(page, "!document.querySelector('#requirements .pending, #verdict .late')")


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (1024, "dark"), (390, "light")])
def test_nothing_is_too_small_unlabelled_or_wider_than_the_screen(
    width: int, scheme: str, browser: Any, file: Path
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page = page_in_browser.opened(context, file)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    size = "x.innerText && parseFloat(getComputedStyle(x).fontSize) < 12"
    small = f"[...document.querySelectorAll('#page *')].filter(x => {size})"
    assert page.evaluate(f"{small}.length") == 0
    unnamed = (
        "[...document.querySelectorAll('button, select, canvas, input')].filter(x =>"
        " !(x.getAttribute('aria-label') || x.labels?.length || x.innerText)).map(x => x.outerHTML)"
    )
    assert page.evaluate(unnamed) == []
    assert all(ratio >= 4.5 for ratio in page.evaluate(CONTRAST))
    context.close()


#: contrast of the page's words and signs with what they stand on (WCAG 2.2, relative luminance)
CONTRAST = """(() => {
  const lum = c => { const [r, g, b] = c.match(/[\\d.]+/g).map(Number).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b }
  const probe = document.createElement('i'); document.body.append(probe)
  const of = name => { probe.style.color = `var(--${name})`; return lum(getComputedStyle(probe).color) }
  const pairs = [['ink', 'bg'], ['quiet', 'bg'], ['quiet', 'soft'], ['link', 'bg'], ['link', 'soft'], ['ink', 'paper'],
    ['quiet', 'paper'], ['worst', 'bg'], ['worst', 'paper'], ['chosen', 'paper'], ['other', 'bg'], ['limit', 'paper'],
    ['handle', 'paper'], ['passed', 'passed-bg'], ['failed', 'failed-bg'], ['undecided', 'undecided-bg'],
    ['none', 'none-bg']]
  const found = pairs.map(([a, b]) => [of(a), of(b)].sort((x, y) => y - x)).map(([a, b]) => (a + 0.05) / (b + 0.05))
  probe.remove(); return found })()"""


def test_masks_limits_of_single_points_pid_and_sections_are_shown_and_kept(browser: Any, tmp_path: Path) -> None:
    light, heavy = (
        replace(x, operating_point={"load_kg": m}) for x, m in zip(shaped_cases.plants("lag"), (1.0, 3.0), strict=True)
    )
    section = Block("section", {"n0": 1.0, "n1": 0.01, "n2": 0.0, "d0": 1.0, "d1": 0.001, "d2": 0.0})
    pid = Block("pid", {"gain": 2.0, "fi_hz": 0.5, "fd_hz": 30.0, "ff_hz": 250.0})
    C = ls.Controller("x", (pid, section), shaped_cases.RATE_HZ)
    heavier = ls.AtPoints(
        {"load_kg": (2.0, 4.0)}, {"phase_margin_deg": 70.0}, (ls.Mask("S", ((0.5, -6.0), (9.0, 6.0))),)
    )
    mask = ls.Mask("S", ((0.5, -12.0), (6.0, 3.0)))
    R = ls.Requirements("x", phase_margin_deg=30.0, masks=(mask,), at=(heavier,), integrators=0, unstable_poles=0)
    context = browser.new_context(accept_downloads=True)
    page = page_in_browser.opened(context, ls.shape([light, heavy], C, R, tmp_path / "limits.html"))
    page.locator("#requirements", has_text="|S| over its mask").wait_for()
    page.locator("#requirements", has_text="≥ 70 ° at this operating point").wait_for()
    page.locator(".blocks", has_text="(1 + 0.01 s + 0 s²) / (1 + 0.001 s + 0 s²)").wait_for()
    assert page.get_by_label("n0 of block 2", exact=False).count() == 0
    x, y = handle(page, "D")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y)
    page.mouse.up()
    page_in_browser.until(page, "loopshape.state.controller.blocks[0].parameters.fd_hz > 33")
    made = saved(page, "controller", tmp_path)
    assert ls.read_controllers(made)[0].blocks[1].parameters == section.parameters
    again = ls.read_requirements(saved(page, "requirements", tmp_path))[0]
    assert (again.masks, again.at, repr(again)) == (R.masks, R.at, repr(R))
    text = (tmp_path / "requirements.toml").read_text().replace("[6.0, 3.0]", "[0.1, 3.0]")
    (tmp_path / "bad.toml").write_text(text)
    page.set_input_files("#file", tmp_path / "bad.toml")
    page.locator(
        "#message", has_text="the mask on |S| are two pairs [Hz, dB] at least, with frequencies that rise"
    ).wait_for()
    page.get_by_role("button", name="remove the requirement |S| over its mask").click()
    page_in_browser.until(page, "loopshape.design.requirements.masks.length === 0")
    assert not page.errors
    context.close()


def test_operating_points_may_have_names_of_their_own(tmp_path: Path) -> None:
    one, two = shaped_cases.plants("lag")
    C = ls.controller(ls.gain(2.0), rate_hz=shaped_cases.RATE_HZ, loop="x")
    text = ls.shape({"cold": one, "hot": two}, C, out=tmp_path / "two.html").read_text()
    data = json.loads(text.split('id="data">')[1].split("</script>")[0])
    assert [point["name"] for point in data["loops"][0]["points"]] == ["cold", "hot"]


def test_a_plant_without_a_rate_needs_a_controller(tmp_path: Path) -> None:
    P = ls.FRF.from_arrays(np.geomspace(1.0, 10.0, 20), np.ones(20) + 0j, relative_std=0.01)
    with pytest.raises(ls.errors.WrongUseError, match="rate"):
        ls.shape(P, out=tmp_path / "none.html")


def test_the_page_loads_nothing_and_is_small(file: Path) -> None:
    text = file.read_text()
    assert "default-src &#x27;none&#x27;" in text
    assert not [word for word in ('src="http', "href=", "@import", "//cdn") if word in text]
    assert len(text) < 300_000


def test_the_scripts_are_built_from_their_sources(tmp_path: Path) -> None:
    tools = SOURCES / "node_modules" / ".bin"
    if shutil.which("node") is None or not (tools / "esbuild").exists():
        pytest.skip("no node, or no node_modules: run npm ci in loopshape/view/page")
    command = json.loads((SOURCES / "package.json").read_text())["scripts"]["build"].split()
    command = [str(tools / "esbuild"), *command[1:-1], f"--outdir={tmp_path}"]
    subprocess.run(command, cwd=SOURCES, check=True, capture_output=True, timeout=60)
    for name in ("shape.js", "report.js"):
        assert (tmp_path / name).read_bytes() == (SOURCES / name).read_bytes(), "npm run build makes it anew"
    typed_well = subprocess.run([tools / "tsc", "--noEmit"], cwd=SOURCES, capture_output=True, text=True, timeout=60)
    assert not typed_well.stdout


@contextmanager
def served(loops: list[ShapingSession], folder: Path, several: ShapedLoops | None = None) -> Iterator[ShapeServer]:
    made = ShapeServer(loops, "bench", folder / "controller.toml", several)
    thread = Thread(target=made.serve)
    thread.start()
    yield made
    made.http.shutdown()
    thread.join()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShapeServer]:
    """The bench's page on loopback, from the controller at the end of the walk in docs/shape.md."""
    P, R, _ = shaped_cases.bench()
    C = ls.controller(
        ls.gain(12.0), ls.lead_lag(1.0, 50.0), ls.notch(77.5, 0.1, 0.6), ls.low_pass(400.0, 1.0),
        rate_hz=2500.0, loop="motor",
    )  # fmt: skip
    with served([shaped([P], C, R, ())], tmp_path_factory.mktemp("saved")) as made:
        yield made


def status(server: ShapeServer, path: str, body: bytes | None = None, **headers: str) -> int:
    line = HTTPConnection("127.0.0.1", server.http.server_address[1], timeout=20)
    line.request("GET" if body is None else "POST", path, body, headers)
    code = line.getresponse().status
    line.close()
    return code


def test_no_other_page_can_ask_the_server(server: ShapeServer) -> None:
    assert status(server, f"/{server.token}/") == 200
    assert status(server, f"/{server.token}/", Origin="http://elsewhere.example") == 403
    assert status(server, f"/{server.token}/", Host="elsewhere.example") == 403
    assert status(server, "/") == 403
    assert status(server, f"/{server.token[:-1]}/") == 403
    assert status(server, f"/{server.token}/save", b"{}", Origin="null") == 403
    assert status(server, f"/{server.token}/save", b"{}", **{"Content-Type": "text/plain"}) == 400
    assert status(server, f"/{server.token}/save", b"[]", **{"Content-Type": "application/json"}) == 400
    assert not server.save_to.exists()


JSON = {"Content-Type": "application/json"}


def asked(server: ShapeServer, what: str, body: bytes) -> tuple[int, dict[str, Any]]:
    line = HTTPConnection("127.0.0.1", server.http.server_address[1], timeout=20)
    line.request("POST", f"/{server.token}/{what}", body, JSON)
    answer = line.getresponse()
    found = answer.status, json.loads(answer.read())
    line.close()
    return found


@pytest.mark.parametrize("body", [b"[" * 200_000, b'{"a":' * 150_000])
def test_json_nested_too_deeply_is_answered(server: ShapeServer, body: bytes) -> None:
    code, said = asked(server, "check", body)
    assert (code, said["error"]) == (400, "a request without sense: it is nested too deeply")


@pytest.mark.long
def test_silent_and_slow_connections_hold_neither_threads_nor_the_page(
    server: ShapeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two hundred that say nothing, or a byte now and then: at most 16 threads, and the page comes at once."""
    from loopshape.toolbox.pages.shape import shape_server

    monkeypatch.setattr(shape_server, "MOST_S", 1.0)
    before = active_count()
    silent = [create_connection(("127.0.0.1", server.http.server_address[1])) for _ in range(200)]
    slow = silent[-1]
    slow.sendall(b"GET ")
    time.sleep(0.3)
    assert active_count() - before <= shape_server.MOST_CONNECTIONS
    assert status(server, f"/{server.token}/") == 200
    end = time.monotonic() + 10.0
    while active_count() > before and time.monotonic() < end:
        with suppress(OSError):
            slow.sendall(b"x")
        time.sleep(0.1)
    assert active_count() <= before
    for one in silent:
        one.close()


def test_a_save_notices_that_another_wrote_the_file(tmp_path: Path) -> None:
    """Two servers on one file, and two pages of one: the later Save is refused until it is loaded anew."""
    P, R, _ = shaped_cases.bench()
    C = ls.controller(ls.gain(12.0), rate_hz=2500.0, loop="motor")
    loops = [shaped([P], C, R, ())]

    def mark(server: ShapeServer) -> str:
        return re.search(rb'"saved":\s*"([^"]*)"', server.page)[1].decode()

    def save(server: ShapeServer, saved: str) -> tuple[int, dict[str, Any]]:
        words = {"saved": saved, "controller": controller_words(C)}
        return asked(server, "save", json.dumps(words).encode())

    with served(loops, tmp_path) as one, served(loops, tmp_path) as other:
        first, second = mark(one), mark(other)
        assert (first, second) == ("none", "none")
        code, said = save(one, first)
        assert code == 200
        assert save(one, said["saved"])[0] == 200  # what it wrote itself is no news
        kept = one.save_to.read_bytes() + b"# by hand\n"
        one.save_to.write_bytes(kept)
        for server, stale in ((other, second), (one, said["saved"])):
            code, words = save(server, stale)
            assert (code, "changed by another" in words["error"]) == (400, True)
            assert one.save_to.read_bytes() == kept
        assert save(other, mark(other))[0] == 200


def test_served_each_loop_of_a_matrix_meets_the_others_as_they_are_now(browser: Any, tmp_path: Path) -> None:
    f = np.arange(0.1, 20.0, 0.1)
    s = 2j * np.pi * f
    G = np.array([[1.0, 0.5], [-0.5, 1.0]]) * (4.0 / (s * (0.02 * s + 1.0)))[:, None, None]
    several = ShapedLoops((several_cases.frf_of(f, G, 0.01, loop="a+b"),))
    with served(
        several.sessions([several_cases.gain("a", 6.0), several_cases.gain("b", 4.0)]), tmp_path, several
    ) as made:
        page = browser.new_context().new_page()
        page.goto(made.url)
        page.locator("#closed", has_text="Loop a, with b closed.").wait_for()
        before = page.evaluate("loopshape.loop.points[0].P.re[20]")
        page.get_by_label("Loop", exact=True).select_option("1")
        page.locator("#closed", has_text="Loop b, with a closed.").wait_for()
        typed(page, "gain of block 1, gain", 1)
        page.get_by_label("Loop", exact=True).select_option("0")
        page.locator("#closed", has_text="Changed since: b").wait_for()
        page.get_by_role("button", name="close the other loops as they are designed now").click()
        page.locator("#closed", has_text="Loop a, with b closed.").wait_for()
        assert page.evaluate("loopshape.loop.points[0].P.re[20]") != before
        page.context.close()


def test_served_the_page_certifies_tunes_and_saves(browser: Any, server: ShapeServer, tmp_path: Path) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(server.url)
    page_in_browser.settled(page)
    typed(page, "gain of block 1, gain", 10)
    page.get_by_text("of an earlier design").wait_for()
    page.get_by_role("button", name="let loopshape check this design").click()
    page.get_by_text("Certificate of loopshape check for this design: passed").wait_for()
    held = {"2, lead or lag": ("zero [Hz]", "pole [Hz]"), "3, notch": ("zero [Hz]", "zero damping", "pole damping")}
    held["4, low-pass, order 2"] = ("corner [Hz]", "damping")
    for block, names in held.items():
        for name in names:
            page.get_by_role("button", name=f"lock {name} of block {block}", exact=True).click()
    page.get_by_role("button", name="let loopshape tune what is not locked").click()
    page.get_by_text("tuned from here").wait_for(timeout=120_000)  # kernels may have to be compiled
    page_in_browser.settled(page)
    tuned = state(page)
    assert tuned["outcome"] == "passed"
    assert tuned["controller"]["blocks"][0]["parameters"]["gain"] != 10
    assert tuned["controller"]["blocks"][2]["parameters"]["damping1"] == 0.1
    page.get_by_role("button", name="save the controller on this machine").click()
    page.get_by_text("saved to").wait_for()
    (C,) = ls.read_controllers(server.save_to)
    assert [dict(block.parameters) for block in C.blocks] == [x["parameters"] for x in tuned["controller"]["blocks"]]
    ls.write(C, tmp_path / "python.toml")
    assert server.save_to.read_bytes() == (tmp_path / "python.toml").read_bytes()
    context.close()
