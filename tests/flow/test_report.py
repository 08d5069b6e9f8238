"""The report of a run: one page that loads nothing, says what is there and what is missing, and works in a browser."""

import json
import re
import shutil
import subprocess
from base64 import b64encode
from hashlib import sha256
from html import escape
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import report_run
import typer
from typer.testing import CliRunner

from loopshape.cli.report import report
from loopshape.core.errors import LoopshapeError
from loopshape.io.gathered import gather
from loopshape.view.html.markup import VOID, Markup, json_block, tag
from loopshape.view.html.page import page

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
        assert f"{line.found:.4g}".replace("-", "\N{MINUS SIGN}") in parts.text
    for m in found.margins.values():
        assert f"{m.modulus_margin:.4g}" in parts.text
        assert m.stability_reason in parts.text


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


def test_pictures_are_embedded_up_to_a_limit_and_the_rest_is_named(parts: Page, run: Path) -> None:
    kinds = [str(a["src"]).split(";")[0] for a in parts.all("img")]
    assert sorted(kinds) == ["data:image/png", "data:image/svg+xml"]
    assert "zz_large.png: 2.0 MB more would exceed the 1 MB kept for pictures" in parts.text
    assert "no_picture.png: no PNG or SVG" in parts.text
    assert len(Page(made(run, limit=10_000_000)).all("img")) == 3
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
    from loopshape.io.frfs import write_frfs

    write_frfs(tmp_path, [report_run.frf("near", 40.0, 0.1)])
    found = Page(page(gather(tmp_path, None, None, DATE)))
    assert "The recordings: these frequency responses came from elsewhere." in found.text
    assert "loopshape tune RUN --require requirements.toml --out controller.toml" in found.text
    assert {a.get("data-plot") for a in found.all("svg")} >= {"P-db", "P-deg"}


def test_a_controller_without_requirements_passes_nothing(run: Path) -> None:
    found = gather(run, run.parent / "controller.toml", None, DATE)
    assert found.outcome == "none"
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
    with pytest.raises(LoopshapeError, match="needs recordings or frequency responses"):
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


DRIVE = """
window.addEventListener("load", function () {
  var root = document.documentElement.dataset, box = document.querySelector(".plots");
  var plot = box.querySelector('svg[data-plot="S-db"]');
  plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
  plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
  root.marks = box.querySelectorAll(".mark").length;
  root.readout = box.querySelector(".readout").textContent;
  root.tip = box.querySelector(".tip").textContent;
  plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowDown", bubbles: true }));
  root.other = box.querySelector(".readout").textContent;
  var boxes = box.querySelectorAll(".legend input");
  boxes[0].click();
  root.hidden = box.querySelectorAll('[data-op="0"].off').length + " of "
    + box.querySelectorAll('.plot-grid [data-op="0"]').length;
  root.boxes = boxes.length;
  var at = plot.getBoundingClientRect();
  plot.dispatchEvent(new PointerEvent("pointermove",
    { clientX: at.left + 0.5 * at.width, clientY: at.top + 0.5 * at.height, bubbles: true }));
  root.pointed = box.querySelector(".readout").textContent;
  var table = document.querySelector("table.sortable"), head = table.tHead.rows[0].cells[2];
  function column() {
    return Array.prototype.map.call(table.tBodies[0].rows, function (row) { return row.cells[2].dataset.value; });
  }
  head.querySelector("button").click();
  root.rising = column().join(" ") + " " + head.getAttribute("aria-sort");
  head.querySelector("button").click();
  root.falling = column().join(" ") + " " + head.getAttribute("aria-sort");
});
"""


@needs_browser
def test_values_are_read_off_curves_hidden_and_tables_sorted(whole: str, run: Path, tmp_path: Path) -> None:
    driven = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", whole)
    html = tmp_path / "driven.html"
    html.write_text(driven.replace("</body>", f"<script>{DRIVE}</script></body>"))
    done = browse(html, tmp_path / "profile", 1280, "--dump-dom")
    root = root_of(done.stdout)
    assert console(done) == []
    data = json.loads(Page(whole).scripts[0][1])["loops"][0]
    point, k = data[0], len(data[0]["f"]) // 2 + 1
    size = f"{point['db']['S'][k]:.2f} dB ({point['db']['S'][k] + point['down']['S'][k]:.2f}".replace(
        "-", "\N{MINUS SIGN}"
    )
    assert root["data-marks"] == "9"
    for words in (str(root["data-readout"]), str(root["data-tip"])):
        assert point["name"] in words
        assert f"{point['f'][k]:g} Hz" in words
        assert size in words
    assert data[1]["name"] in str(root["data-other"])
    assert root["data-boxes"] == "2"
    count = str(root["data-hidden"]).split(" of ")
    assert count[0] == count[1] != "0"
    assert data[1]["name"] in str(root["data-pointed"])  # the first operating point is hidden
    *rising, up = str(root["data-rising"]).split()
    *falling, down = str(root["data-falling"]).split()
    assert (up, down) == ("ascending", "descending")
    assert rising == sorted(rising, key=float) == falling[::-1]
    assert len(set(rising)) == 2


@needs_browser
def test_without_script_everything_still_shows(whole: str, tmp_path: Path) -> None:
    still = re.sub(r"<script>.*?</script>", "", whole, flags=re.S)
    html, shot = tmp_path / "still.html", tmp_path / "shot.png"
    html.write_text(still)
    done = browse(html, tmp_path / "profile", 1280, "--dump-dom", f"--screenshot={shot}", height=5000)
    assert "data-report" not in root_of(done.stdout)
    found = Page(still)
    assert sum(a.get("class") == "curve" for a in found.all("path")) == 18
    picture = (matplotlib.image.imread(shot)[..., :3] * 255).astype(int)
    blue = (np.abs(picture - [0, 114, 178]).max(axis=2) < 12).sum()  # the first operating point's curves
    assert blue > 2000
