"""The report of a run: one page that loads nothing, says what is there and what is missing, and works in a browser."""

import json
import re
import shutil
import subprocess
from base64 import b64decode, b64encode
from collections.abc import Iterator
from hashlib import sha256
from html import escape
from html.parser import HTMLParser
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import report_run
import typer
from bench_nouns import RequirementResult
from page_in_browser import browser, until
from typer.testing import CliRunner

import loopshape as ls
from loopshape.data.result.verdict_words import row_of
from loopshape.toolbox.pages.commands import report
from loopshape.toolbox.pages.markup import VOID, Markup, json_block, tag
from loopshape.toolbox.pages.report.page import page
from loopshape.toolbox.pages.report.report_inputs import gather
from loopshape.toolbox.pages.report.words import TYPESET

DATE = "2025-03-04 05:06:07+01:00"
BROWSER = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome on PATH")
app = typer.Typer()
app.command()(report)


class Page(HTMLParser):
    """A page taken apart; elements that do not nest are refused."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.feed(text)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, name: str, attributes: list[tuple[str, str | None]]) -> None:
        names = [key for key, _ in attributes]
        assert len(set(names)) == len(names), f"<{name}> repeats an attribute: {names}"
        self.elements.append((name, dict(attributes)))
        if name not in VOID:
            self.open.append(name)
        if name == "script":
            self.scripts.append((dict(attributes), ""))

    def handle_endtag(self, name: str) -> None:
        assert self.open, f"</{name}> closes nothing"
        assert self.open[-1] == name, f"</{name}> closes <{self.open[-1]}>"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)
        elif not (self.open and self.open[-1] == "style"):
            self.words.append(data)

    def all(self, name: str) -> list[dict[str, str | None]]:
        return [attributes for found, attributes in self.elements if found == name]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return report_run.whole_run(tmp_path_factory.mktemp("report") / "run")


def made(run: Path, require: str = "require.toml", limit: int = 1_000_000) -> str:
    return page(gather(run, run.parent / "controller.toml", run.parent / require, DATE, limit))


@pytest.fixture(scope="module")
def whole(run: Path) -> str:
    return made(run)


@pytest.fixture(scope="module")
def parts(whole: str) -> Page:
    return Page(whole)


def test_the_page_nests_and_its_names_are_its_own(parts: Page) -> None:
    names = [a["id"] for _, a in parts.elements if "id" in a]
    assert len(set(names)) == len(names)
    targets = [str(a["href"])[1:] for a in parts.all("a")]
    targets += [name for _, a in parts.elements for name in str(a.get("aria-labelledby") or "").split()]
    targets += re.findall(r"url\(#([^)]+)\)", " ".join(str(v) for _, a in parts.elements for v in a.values()))
    assert targets
    assert set(targets) <= set(names)


def test_the_page_loads_nothing(whole: str, parts: Page) -> None:
    assert not [a for n, a in parts.elements if n in ("link", "iframe", "object", "embed", "base", "form", "video")]
    assert all(str(a["src"]).startswith("data:image/") for n, a in parts.elements if "src" in a)
    assert all(str(a["href"]).startswith("#") for n, a in parts.elements if "href" in a)
    style = whole[whole.index("<style>") : whole.index("</style>")]
    assert not re.search(r"@import|url\(|https?:", style)
    outside = re.sub(r'src="data:[^"]*"', "", whole)
    assert not re.search(r"(src|href|action|data)\s*=\s*[\"']?\s*(https?:)?//", outside)
    policy = next(str(a["content"]) for a in parts.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    digest = b64encode(sha256(parts.scripts[1][1].encode()).digest()).decode()
    assert policy.startswith("default-src 'none';")
    assert f"script-src 'sha256-{digest}'" in policy


def test_what_a_user_wrote_stays_text(whole: str, parts: Page) -> None:
    assert [a.get("type") for a, _ in parts.scripts] == ["application/json", None]
    assert "owned" not in parts.scripts[0][1] + parts.scripts[1][1]
    for where in (f"near: {report_run.HOSTILE}", report_run.HOSTILE, "<b>bold</b>", "# a comment with </script>"):
        assert " ".join(where.split()) in parts.text
    assert not parts.all("b")
    assert "<!-- &" not in whole


def test_embedded_data_cannot_end_their_block() -> None:
    hostile = "</script><!--<script>\u2028&amp;"
    block = json_block("x", {hostile: [hostile]})
    inside = block[block.index(">") + 1 : block.rindex("</script>")]
    assert not set("<>&") & set(inside)
    assert json.loads(inside) == {hostile: [hostile]}


def test_markup_escapes_once_and_everything() -> None:
    assert tag("p", 'a<b & "c"\'', tag("i", "<")) == "<p>a&lt;b &amp; &quot;c&quot;&#x27;<i>&lt;</i></p>"
    assert tag("p", title='"><script>') == '<p title="&quot;&gt;&lt;script&gt;"></p>'
    assert tag("p", "\x00\x1b\u202e\ud800").encode() == "<p>   \N{REPLACEMENT CHARACTER}</p>".encode()
    assert Markup("<i>") + "<" == "<i>&lt;"


def test_the_verdict_and_every_line_are_there(parts: Page, run: Path) -> None:
    found = gather(run, run.parent / "controller.toml", run.parent / "require.toml", DATE).checked[0].verdict
    head = parts.text[parts.text.index("Verdict") : parts.text.index("Requirements of loop")]
    assert {"passed": "pass", "undecided": "undecided", "failed": "FAIL"}[found.outcome] in head
    for line in found.lines:
        assert line.recording in parts.text
        assert f"{line.value:.4g}".replace("-", "\N{MINUS SIGN}") in parts.text
    for m in found.margins.values():
        assert f"{m.modulus_margin:.4g}" in parts.text
        assert m.stability_reason in parts.text


def test_ends_of_a_bound_read_the_same_in_check_and_report() -> None:
    """The bound's own interval says nothing of how much better the value may be: its good end is `bound`."""
    bound = RequirementResult(
        "control_high_frequency_db", "dB", 60.0, 59.98, 0.0, "undecided", "a", 90.0, (59.97, 60.0), bound=59.69
    )
    least = RequirementResult("gain_margin_db", "dB", 6.0, 10.8, 4.7, "passed", "a", 90.0, (10.7, 10.9), bound=14.0)
    assert [row_of(one).interval for one in (bound, least)] == ["59.69 .. 60 (bound)", "10.7 .. 14 (bound)"]
    typeset = [row_of(one, TYPESET) for one in (bound, least)]
    assert [row.interval for row in typeset] == ["59.69 … 60 (bound)", "10.7 … 14 (bound)"]
    assert [row.worst for row in typeset] == ["≤ 59.98", "≥ 10.8"]


def test_the_detuning_table_names_limits_as_the_other_tables_do(run: Path, tmp_path: Path) -> None:
    require = tmp_path / "detuned.toml"
    require.write_text(report_run.REQUIRE.format(bandwidth=5.0) + "detuning_percent = 1.0\n")
    text = Page(page(gather(run, run.parent / "controller.toml", require, DATE, 0))).text
    table = text[
        text.index("Detuning margins of loop") : text.index("Stability certificate", text.index("Detuning margins"))
    ]
    assert "% (bandwidth)" in table
    assert "_hz" not in table
    assert "_db" not in table


def test_a_missed_requirement_fails_in_words_at_the_top(run: Path) -> None:
    text = Page(made(run, "wild.toml")).text
    head = text[: text.index("Requirements of loop axis")]
    assert "Loop axis: FAIL" in head
    assert "Missed:" in head
    assert "bandwidth (first 0 dB crossing of L): required ≥ 200 Hz" in head


def test_tables_have_captions_pictures_words_and_headings_no_gaps(parts: Page) -> None:
    assert len(parts.all("caption")) == len(parts.all("table")) > 8
    assert all(a.get("alt") for a in parts.all("img"))
    levels = [int(name[1]) for name, _ in parts.elements if re.fullmatch(r"h[1-6]", name)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))
    assert parts.all("html")[0]["lang"] == "en"
    assert all(a.get("scope") in ("col", "row") for a in parts.all("th"))


def test_inputs_are_named_with_their_digests_and_shown_verbatim(parts: Page, run: Path) -> None:
    files = [p for p in run.rglob("*") if p.is_file()] + [run.parent / n for n in ("controller.toml", "require.toml")]
    for path in files:
        assert sha256(path.read_bytes()).hexdigest() in parts.text, path
    for words in (report_run.CONTROLLER, report_run.REQUIRE.format(bandwidth=2.0), (run / "run.toml").read_text()):
        assert " ".join(words.split()) in parts.text


def test_faults_of_recordings_are_named(parts: Page) -> None:
    assert "y_m of recording near.parquet has 1 spike sample at row 700" in parts.text


def test_the_first_page_says_machine_date_and_author_and_what_the_verdict_hangs_on(tmp_path: Path) -> None:
    """A lightly damped resonance under its notch: a shift of less than 2 % breaks a limit, which stands in red."""
    found = report_run.on_a_resonance(tmp_path / "run", DATE, "A. Engineer")
    said = page(found)
    detuning = found.checked[0].verdict.margins["one"].detuning
    assert detuning is not None
    assert detuning.worst.percent < 2.0
    first = said[: said.index('<section id="requirements">')]
    assert first.count('class="hangs"') == 1
    assert f"a shift of {detuning.worst.percent:.2g} % breaks" in first
    assert "A. Engineer" in first
    assert DATE in first
    assert first.count("<img") == 1
    assert ".card p.hangs { color: var(--failed); }" in said


@needs_browser
def test_the_first_page_fits_a4(chromium: Any, whole: str, tmp_path: Path) -> None:
    """Verdict and plot stand on the first sheet."""
    (tmp_path / "page.html").write_text(whole, encoding="utf-8")
    with chromium.new_context(viewport={"width": 718, "height": 1047}) as context:  # A4 within its margins, in CSS px
        sheet = context.new_page()
        sheet.emulate_media(media="print")
        sheet.goto((tmp_path / "page.html").as_uri())
        box = sheet.locator("#verdict").bounding_box()
        assert box["y"] + box["height"] <= 1047.0
        assert sheet.locator("#verdict img").bounding_box()["height"] > 300.0


def test_pictures_are_embedded_up_to_a_limit_and_the_rest_is_named(parts: Page, run: Path) -> None:
    kinds = [str(a["src"]).split(";")[0] for a in parts.all("img")]
    assert sorted(kinds) == ["data:image/png"] * 2 + ["data:image/svg+xml"]  # one stands in place of the plots
    assert "zz_large.png: 2.0 MB more would exceed the 1 MB kept for pictures" in parts.text
    assert "no_picture.png: no PNG or SVG" in parts.text
    assert len(Page(made(run, limit=10_000_000)).all("img")) == 4
    assert "nichols_axis.png" in Page(made(run, limit=0)).text


def test_a_link_out_of_the_run_brings_nothing_in(tmp_path: Path) -> None:
    run = report_run.recordings_only(tmp_path / "run")
    (tmp_path / "secret.svg").write_text("<svg>secret</svg>")
    (run / "figures").mkdir()
    (run / "figures" / "nichols_x.svg").symlink_to(tmp_path / "secret.svg")
    (run / "linked.txt").symlink_to(tmp_path / "secret.svg")
    found = gather(run, None, None, DATE)
    assert not found.figures
    assert found.figures_left_out == {"nichols_x.svg": "a link that leaves the run's folder"}
    assert {one.name for one in found.files} == {"run.toml", "journal.jsonl", "near.parquet", "far-away.parquet"}


def test_the_same_run_gives_the_same_page_but_for_the_date(run: Path, whole: str) -> None:
    assert made(run) == whole
    other = page(gather(run, run.parent / "controller.toml", run.parent / "require.toml", "another day", 1_000_000))
    assert other != whole
    assert other.replace("another day", DATE) == whole


def test_a_run_of_recordings_alone_says_what_to_do_next(tmp_path: Path) -> None:
    found = Page(page(gather(report_run.recordings_only(tmp_path / "run"), None, None, DATE)))
    assert "No frequency responses yet: loopshape frf RUN" in found.text
    assert "no verdict" in found.text
    assert found.all("svg")


def test_frfs_alone_are_drawn_and_the_rest_is_asked_for(tmp_path: Path) -> None:
    from run_files import write_frfs

    write_frfs(tmp_path, [report_run.frf("near", 40.0, 0.1)])
    found = Page(page(gather(tmp_path, None, None, DATE)))
    assert "The recordings: these frequency responses came from elsewhere." in found.text
    assert "loopshape tune RUN --require requirements.toml --out controller.toml" in found.text
    assert {a.get("data-plot") for a in found.all("canvas")} == {"P-db", "P-deg"}


def test_a_controller_without_requirements_passes_nothing(run: Path) -> None:
    found = gather(run, run.parent / "controller.toml", None, DATE)
    assert found.outcome is None
    text = Page(page(found)).text
    assert "no requirements were given" in text
    assert "plant with 1 integrator (by phase and slope at its lowest frequencies, from 0.25 Hz)" in text


def test_the_count_of_encirclements_says_what_its_integrators_rest_on(parts: Page) -> None:
    assert "plant with 1 integrator (declared in the requirements)" in parts.text


def test_a_loop_that_cannot_be_checked_is_not_passed(run: Path, tmp_path: Path) -> None:
    require = tmp_path / "more.toml"
    require.write_text(
        report_run.REQUIRE.format(bandwidth=2.0) + '[[loop]]\nname = "other <i>"\nphase_margin_deg = 30.0\n'
    )
    found = gather(run, run.parent / "controller.toml", require, DATE)
    assert found.outcome == "undecided"
    assert "Requirements name loop other <i>, which has no frequency response." in Page(page(found)).text


def test_a_folder_without_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ls.LoopshapeError, match="needs recordings or frequency responses"):
        gather(tmp_path, None, None, DATE)


@pytest.mark.short
def test_the_command_writes_the_page_and_says_where(run: Path, tmp_path: Path) -> None:
    words = [run, "--controller", run.parent / "controller.toml", "--require", run.parent / "require.toml"]
    out = tmp_path / "new" / "report.html"
    done = CliRunner().invoke(app, [str(w) for w in [*words, "--out", out, "--date", DATE, "--json"]])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["bytes"] == out.stat().st_size
    assert out.read_text().startswith('<!DOCTYPE html>\n<html lang="en">')


NOTE = "on {} of 240 lines a resonance is narrower than the resolution of resolve"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Page of 24 operating points, pictures of each among them."""
    return report_run.page_of_points(tmp_path_factory.mktemp("points") / "run", 24, NOTE, DATE)


def test_a_report_of_24_points_is_small_and_says_a_warning_once(campaign: str) -> None:
    assert len(campaign.encode("utf-8")) <= 3_000_000
    heads = re.findall(r"<li><p>(24 recordings alike.*?)</p>", campaign)
    assert len(heads) == 1
    assert all(f"r{k:02d}" in heads[0] for k in range(24))
    assert NOTE.format(0) in heads[0]
    assert all(f"r{k:02d}: {NOTE.format(k)}" in campaign for k in range(24))  # folded, and none lost


@needs_browser
def test_a_report_of_24_points_prints_on_ten_pages(campaign: str, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(campaign, encoding="utf-8")
    printed = tmp_path / "page.pdf"
    command = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'user'}"]
    command += ["--no-pdf-header-footer", f"--print-to-pdf={printed}", (tmp_path / "page.html").as_uri()]
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b(?!s)", printed.read_bytes())) <= 10


def test_colours_have_enough_contrast(whole: str) -> None:
    """WCAG 2.1 AA: 4.5 for text, in light and dark."""
    style = whole[whole.index("<style>") : whole.index("</style>")]
    schemes = [
        dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", block))
        for block in re.findall(r":root \{(.*?)\}", style, re.S)
    ]
    assert len(schemes) == 3
    outcomes = ("passed", "failed", "undecided", "none")
    pairs = [("ink", "bg"), ("ink", "soft"), ("quiet", "bg"), ("quiet", "soft"), ("link", "bg")]
    pairs += [(o, f"{o}-bg") for o in outcomes] + [(o, "bg") for o in outcomes] + [("ink", f"{o}-bg") for o in outcomes]
    pairs += [("quiet", f"{o}-bg") for o in outcomes]
    for scheme in schemes:
        for text, ground in pairs:
            assert contrast(scheme[text], scheme[ground]) >= 4.5, (text, ground, scheme[text], scheme[ground])


def contrast(one: str, other: str) -> float:
    """Contrast of two colours as WCAG defines it."""

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def browse(html: Path, profile: Path, width: int, *orders: str, height: int = 1800) -> subprocess.CompletedProcess[str]:
    """Chromium without a window on one page, its console on standard error."""
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"]
    flags += [
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--enable-logging=stderr",
    ]
    words = [
        str(BROWSER),
        *flags,
        f"--user-data-dir={profile}",
        f"--window-size={width},{height}",
        *orders,
        html.as_uri(),
    ]
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)


def console(done: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line]


#: a page in a frame as wide as a phone, because windows without a screen are 500 wide at least
PHONE = """<!DOCTYPE html><html lang="en"><body><iframe width="390" height="3000" srcdoc="{page}"></iframe><script>
window.addEventListener("load", function () {{
  var inner = document.querySelector("iframe").contentDocument.documentElement;
  Object.keys(inner.dataset).forEach(function (key) {{ document.documentElement.dataset[key] = inner.dataset[key]; }});
}});
</script><style>body {{ margin: 0; }} iframe {{ border: 0; }}</style></body></html>"""


def root_of(dom: str) -> dict[str, str | None]:
    return Page(dom).all("html")[0]


@pytest.mark.long
@needs_browser
@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_shows_it_without_errors_and_without_sideways_scrolling(
    width: int, whole: str, tmp_path: Path
) -> None:
    html, framed, shot = (tmp_path / name for name in ("report.html", "framed.html", "shot.png"))
    html.write_text(whole)
    framed.write_text(PHONE.format(page=escape(whole)))
    done = browse(framed if width < 500 else html, tmp_path / "profile", width, "--dump-dom")
    root = root_of(done.stdout)
    assert console(done) == []
    assert (root["data-report"], root["data-errors"]) == ("ready", "0")
    assert int(str(root["data-width"])) == width
    assert int(str(root["data-overflow"])) <= 0
    assert console(browse(html, tmp_path / "profile", width, f"--screenshot={shot}")) == []
    picture = matplotlib.image.imread(shot)[..., :3]
    assert picture.shape[1] == width
    rows_with_ink = (np.ptp(picture, axis=1).max(axis=1) > 0.3).mean()
    assert rows_with_ink > 0.4
    assert len(np.unique((picture.reshape(-1, 3) * 255).astype(np.uint8), axis=0)) > 50


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as made:
        yield made


@pytest.fixture
def seen(chromium: Any, whole: str, tmp_path: Path) -> Iterator[Any]:
    """The page as a reader has it, who may point at it; it must end without an error."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, color_scheme="light")
    shown = opened_report(context, whole, tmp_path)
    yield shown
    assert shown.errors == []
    context.close()


def opened_report(context: Any, html: str, folder: Path) -> Any:
    (folder / "report.html").write_text(html)
    shown = context.new_page()
    shown.errors = []
    shown.on("pageerror", lambda error: shown.errors.append(str(error)))
    shown.on("console", lambda message: shown.errors.append(message.text))
    shown.goto((folder / "report.html").as_uri())
    until(shown, "document.documentElement.dataset.report === 'ready'")
    return shown


def sizes_of(whole: str, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, plant and open loop of an operating point, from the page's data."""
    points = json.loads(Page(whole).scripts[0][1])["loops"][0]["points"]
    found = next(one for one in points if one["name"] == name)
    f, P, C = (
        np.frombuffer(b64decode(found[k][kind[1:]]), kind) for k, kind in (("f", "<f8"), ("P", "<c16"), ("C", "<c16"))
    )
    return f, P, C * P


def test_one_frequency_is_marked_in_all_plots_and_read_off(seen: Any, whole: str) -> None:
    plot, readout = seen.locator('canvas[data-plot="S-db"]'), seen.locator(".readout")
    every = seen.locator("canvas[data-plot]")
    bare = [pixels(every.nth(k)) for k in range(every.count())]
    plot.focus()
    plot.press("ArrowRight")
    plot.press("ArrowRight")
    until(seen, "!document.querySelector('.readout').hidden")
    first = readout.text_content()
    name = next(name for name in ("near", "far-away") if first.startswith(name))
    f, _, L = sizes_of(whole, name)
    k = f.size // 2 + 1
    for words in (first, seen.locator(".tip").text_content()):
        assert f"{f[k]:.6g} Hz" in words
        assert f"{-20.0 * np.log10(abs(1.0 + L[k])):.2f} dB (".replace("-", "\N{MINUS SIGN}") in words
    for k, before in enumerate(bare):
        until_drawn(seen, every.nth(k), before)
    plot.press("ArrowDown")
    until(seen, f"!document.querySelector('.readout').textContent.startsWith({json.dumps(name)})")
    plot.press("Escape")
    until(seen, "document.querySelector('.readout').hidden")


def pixels(canvas: Any) -> str:
    return str(canvas.evaluate("one => one.toDataURL()"))


def until_drawn(page: Any, canvas: Any, before: str) -> None:
    """Waits until a canvas shows something else."""
    for _ in range(200):
        if pixels(canvas) != before:
            return
        page.wait_for_timeout(25)
    raise AssertionError(f"{canvas} shows what it showed")


def test_hidden_points_are_not_read_and_all_frequencies_zoom_together(seen: Any) -> None:
    boxes = seen.locator(".legend input")
    assert boxes.count() == 2
    hidden = seen.locator(".legend li").first.text_content()
    boxes.first.uncheck()
    nichols, size = seen.locator('canvas[data-plot="L-nichols"]'), seen.locator('canvas[data-plot="T-db"]')
    nichols.scroll_into_view_if_needed()
    box = nichols.bounding_box()
    seen.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"])
    until(seen, "!document.querySelector('.readout').hidden")
    assert seen.locator(".readout b").first.text_content() not in hidden
    before = pixels(size)
    other = seen.locator('canvas[data-plot="P-deg"]')
    other.focus()
    other.press("+")
    until_drawn(seen, size, before)
    before = pixels(size)
    other.press("0")
    until_drawn(seen, size, before)


def test_on_a_phone_the_note_leaves_the_critical_point_free(chromium: Any, whole: str, tmp_path: Path) -> None:
    with chromium.new_context(viewport={"width": 390, "height": 800}) as context:
        shown = opened_report(context, whole, tmp_path)
        nichols = shown.locator('canvas[data-plot="L-nichols"]')
        nichols.press("Home")
        for _ in range(20):
            nichols.press("Shift+ArrowRight")
            tip, box = shown.locator(".tip").bounding_box(), nichols.bounding_box()
            # -180 degrees of -360 to 0, 0 dB of -40 to 40: the middle of the paper between its margins
            x, y = box["x"] + 54 + (box["width"] - 64) / 2, box["y"] + 8 + (box["height"] - 44) / 2
            assert not (0 < x - tip["x"] < tip["width"] and 0 < y - tip["y"] < tip["height"])


def test_tables_are_sorted_by_their_heads(seen: Any) -> None:
    def column() -> list[float]:
        return seen.evaluate("""[...document.querySelector('table.sortable').tBodies[0].rows]
            .map(row => Number(row.cells[2].dataset.value))""")

    head = seen.locator("table.sortable").first.locator("thead th").nth(2)
    for order in ("ascending", "descending"):
        head.locator("button").click()
        assert head.get_attribute("aria-sort") == order
        assert column() == sorted(column(), reverse=order == "descending")
    assert len(set(column())) == 2


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_curves_are_drawn_in_the_colours_of_the_legend(chromium: Any, whole: str, tmp_path: Path, scheme: str) -> None:
    with chromium.new_context(color_scheme=scheme) as context:
        shown = opened_report(context, whole, tmp_path)
        for k, (red, green, blue) in enumerate(shown.evaluate(LOOKS)):
            assert shown.evaluate(COUNT, [red, green, blue]) > 300, k


LOOKS = """[...document.querySelectorAll('.swatch path')].map(path => {
  const one = document.createElement('canvas').getContext('2d')
  one.fillStyle = getComputedStyle(path).stroke; one.fillRect(0, 0, 1, 1)
  return [...one.getImageData(0, 0, 1, 1).data].slice(0, 3) })"""
COUNT = """wanted => { const one = document.querySelector('canvas[data-plot="S-db"]')
  const { data } = one.getContext('2d').getImageData(0, 0, one.width, one.height)
  let found = 0
  for (let k = 0; k < data.length; k += 4) found += wanted.every((value, c) => Math.abs(data[k + c] - value) < 40)
  return found }"""


def test_without_script_a_picture_stands_in_place_of_the_plots(chromium: Any, whole: str, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(whole)
    with chromium.new_context(java_script_enabled=False) as context:
        still = context.new_page()
        still.goto((tmp_path / "report.html").as_uri())
        shot = still.locator("#verdict img").screenshot()
        assert not still.locator("canvas").first.is_visible()
    picture = (matplotlib.image.imread(BytesIO(shot))[..., :3] * 255).astype(int)
    blue = (np.abs(picture - [0, 114, 178]).max(axis=2) < 12).sum()  # the first operating point's curve
    assert blue > 500


@pytest.mark.parametrize("size", [np.inf, np.nan, 1e300, -1.0])
def test_pictures_of_no_size(tmp_path, size):
    with pytest.raises(ls.errors.WrongUseError, match="size of the embedded pictures"):
        report(tmp_path, figures_mb=size)
