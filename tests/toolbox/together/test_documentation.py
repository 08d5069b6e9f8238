"""The documentation site builds without a warning, its pages hang together, and its notebooks run as plain Python."""

import io
import json
import pkgutil
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import matplotlib.figure
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from page_in_browser import browser
from PIL import Image
from text_layout import PlacedText, looked_at, unreadable, unreadable_on_paper, with_texts

import loopshape as ls
from loopshape.core.toolboxes import found

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS) for path in DOCS.rglob("*.md") if not {"made", "paper"} & {*path.parts})
NOTEBOOKS, GALLERY = (sorted((DOCS / kind).glob("*.py")) for kind in ("notebooks", "gallery"))
DRAWN = [
    path for kind in ("readme", "diagrams", "definitions", "demo") for path in (ROOT / "figures" / kind).glob("*.png")
]
SHOWN = sorted(
    {
        (page.parent / name).resolve()
        for page in (ROOT / "README.md", *(DOCS / page for page in PAGES))
        for name in re.findall(r"[\w./-]+\.png", page.read_text())
        if "figures/" in name and "/out/" not in f"/{name}"
    }
)
SLOW = {"4_detuning", "5_estimators_on_a_sweep"} | {path.stem for path in NOTEBOOKS[1:]}


def copied(to: Path) -> Path:
    """What the site is made of, without what was made."""
    shutil.copytree(DOCS, to / "docs", ignore=shutil.ignore_patterns("made", "reference", "__pycache__"))
    shutil.copytree(ROOT / "examples", to / "examples")
    shutil.copytree(ROOT / "figures", to / "figures")
    return to / "docs"


def run_python(words: list[str], here: Path, tmp_path: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    environment = looked_at() | {"MPLBACKEND": "Agg", "TMPDIR": str(tmp_path)}
    return subprocess.run(
        [sys.executable, *words], cwd=here, env=environment, capture_output=True, text=True, check=False,
        timeout=timeout_s,
    )  # fmt: skip


@pytest.mark.parametrize(
    "path",
    # the site runs them all when it is built: the slow ones on their own, warnings as errors, by the hour
    [
        pytest.param(p, marks=(pytest.mark.long, pytest.mark.hour) if p.stem in SLOW else [])
        for p in NOTEBOOKS + GALLERY
    ],
    ids=lambda p: p.stem,
)
@pytest.mark.usefixtures("every_figure_is_readable")
def test_an_example_runs_and_its_figures_can_be_read(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if path.stem == "6_a_rig" and shutil.which("cc") is None:
        pytest.skip("there is no C compiler, which the emulator needs")
    here = tmp_path / "docs" / path.parent.name
    here.mkdir(parents=True)
    shutil.copy(path, here)
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(here)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    matplotlib.use("Agg")
    runpy.run_path(path.name)
    plt.close("all")


def test_there_are_six_notebooks_in_the_percent_format() -> None:
    assert len(NOTEBOOKS) == 6
    for path in NOTEBOOKS:
        text = path.read_text()
        assert text.startswith('# %% [markdown]\n"""\n')
        assert text.count("\n# %%\n") >= 3


def test_every_page_is_in_the_contents() -> None:
    index = (DOCS / "index.md").read_text()
    listed = set(
        re.findall(r"^[\w/]+$", "\n".join(re.findall(r"```{toctree}\n(.*?)```", index, flags=re.S)), flags=re.M)
    )
    made = {"made/notebooks/index", "made/gallery/index", "made/commands"}
    assert listed == {str(page.with_suffix("")) for page in PAGES} - {"index"} | made


def test_every_public_name_is_in_the_reference() -> None:
    listed = set(re.findall(r"^   ([\w.]+)$", (DOCS / "api.md").read_text(), flags=re.M))
    boxes = {key: dir(getattr(ls, key)) for key in ("plot", "errors", *found().toolboxes) if hasattr(ls, key)}
    inner = {f"{box}.{name}" for box, names in boxes.items() for name in names if not name.startswith("_")}
    assert listed == set(dir(ls)) - {"__version__", *boxes} | inner


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_what_a_page_leads_to_exists(page: Path) -> None:
    text = (DOCS / page).read_text()
    targets = [t.split("#")[0] for t in re.findall(r"\]\(([^):\s]+)\)", text)]
    assert all((DOCS / page.parent / target).exists() for target in targets if target)
    for code in re.findall(r"`(loopshape(?:\.[a-z_0-9]+)+)`", text):
        pkgutil.resolve_name(code)  # raises where there is no such thing


@pytest.mark.parametrize("page", ["estimators", "intervals"])
def test_each_part_of_the_mathematics_names_its_code(page: str) -> None:
    text = (DOCS / "mathematics" / f"{page}.md").read_text()
    parts = re.split(r"^## ", text, flags=re.M)[1:]
    assert [part.splitlines()[0] for part in parts if "*Code:*" not in part] == []


@pytest.mark.long
def test_the_pictures_show_what_the_code_computes_and_can_be_read() -> None:
    noted = json.loads((ROOT / "figures" / "shown.json").read_text())
    pictures = runpy.run_path(str(DOCS / "pictures.py"))
    figures = pictures["drawn"]()
    plt.close("all")
    computed = pictures["shown"]() | {name: pictures["shown_in"](figure) for name, figure in figures.items()}
    assert set(noted) - {"demo", "swing"} == set(computed)
    kept = {path.relative_to(ROOT / "figures").with_suffix("").as_posix() for path in DRAWN}
    assert kept == set(figures) | {"demo/gap", "readme/swing"}
    for name, rows in computed.items():
        assert set(noted[name]) == set(rows)
        for row, what in rows.items():
            assert noted[name][row] == pytest.approx(what, rel=2e-3), (name, row, "make pictures")
    assert {name: found for name, figure in figures.items() if (found := unreadable(figure))} == {}


@pytest.mark.long
@pytest.mark.timeout(900)  # two joints with two sensors: 80 s of a free core
@pytest.mark.parametrize(
    ("name", "made", "drawn"),
    [
        ("demo", "diagnosed", "gap_figure"),
        pytest.param("swing", "diagnosed_swing", "swing_figure", marks=pytest.mark.hour),
    ],
)
def test_the_picture_of_a_gap_shows_what_the_code_computes(name: str, made: str, drawn: str) -> None:
    noted = json.loads((ROOT / "figures" / "shown.json").read_text())[name]
    pictures = runpy.run_path(str(DOCS / "pictures.py"))
    report = pictures[made]()
    computed = pictures["shown_of"](report)
    assert set(noted) == set(computed)
    for row, numbers in computed.items():
        assert noted[row] == pytest.approx(numbers, rel=2e-3), (row, "make pictures")
    assert unreadable(pictures[drawn](report)) == []


@pytest.mark.parametrize("picture", SHOWN, ids=lambda path: path.relative_to(ROOT / "figures").as_posix())
def test_a_picture_of_readme_and_docs_is_read_on_paper(picture: Path) -> None:
    """At the width of A4 no text is smaller than 6 pt, over another or cut; its PNG notes where texts stand."""
    assert unreadable_on_paper(picture) == [], "make pictures, or make studies"


def test_small_overlapping_and_cut_text_of_a_picture_is_found(tmp_path: Path) -> None:
    figure = matplotlib.figure.Figure(figsize=(14.0, 2.0), dpi=100)
    figure.text(0.5, 0.5, "small", fontsize=11.0)
    figure.text(0.5, 0.5, "over it", fontsize=20.0)
    figure.text(0.995, 0.1, "cut", fontsize=20.0)
    canvas, buffer = FigureCanvasAgg(figure), io.BytesIO()
    canvas.draw()
    Image.fromarray(np.asarray(canvas.buffer_rgba())).save(buffer, "PNG", dpi=(100, 100))
    (tmp_path / "bare.png").write_bytes(buffer.getvalue())
    assert unreadable_on_paper(tmp_path / "bare.png") == ["does not note where its texts stand: draw it anew"]
    texts = [placed(text, figure) for text in figure.texts]
    (tmp_path / "noted.png").write_bytes(with_texts(buffer.getvalue(), texts))
    found = unreadable_on_paper(tmp_path / "noted.png")
    assert found == ["'small' has 5.5 pt", "'cut' is cut", "'small' over 'over it'"]
    away = [PlacedText("away", 40.0, 100.0, 20.0, 160.0, 60.0)]
    (tmp_path / "blank.png").write_bytes(with_texts(buffer.getvalue(), away))
    assert unreadable_on_paper(tmp_path / "blank.png") == ["'away' is not where it is noted"]


def placed(text: matplotlib.text.Text, figure: matplotlib.figure.Figure) -> PlacedText:
    box, height = text.get_window_extent(), figure.bbox.height
    return PlacedText(
        text.get_text(), text.get_fontsize() * figure.dpi / 72.0, box.x0, height - box.y1, box.x1, height - box.y0
    )


def test_every_picture_kept_is_named_by_a_page() -> None:
    """By its name or its study's folder: a picture that no page names is neither looked at nor drawn anew."""
    pages = [ROOT / "README.md", *DOCS.rglob("*.md"), *(ROOT / "experiments").rglob("*.md")]
    text = "\n".join(page.read_text() for page in pages if "made" not in page.parts)
    kept = sorted((ROOT / "figures").rglob("*.png"))
    named = [path for path in kept if path.name in text or re.search(rf"figures/{path.parent.name}(?!/[\w-]+\.)", text)]
    assert [str(path.relative_to(ROOT)) for path in kept if path not in named] == []


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` does; a warning ends it."""
    for module in ("sphinx", "furo", "myst_parser", "numpydoc", "sphinx_gallery"):
        pytest.importorskip(module, reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("docs")
    docs, out = copied(folder), folder / "site"
    done = run_python(
        ["-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(docs), str(out)], docs, folder, 280.0
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return out


@pytest.mark.long
def test_the_site_builds_without_a_warning(site: Path) -> None:
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html")}
    assert {"index.html", "api.html", "reference/loopshape.tune.html", "mathematics/intervals.html"} <= pages
    for kind, scripts in (("gallery", GALLERY), ("notebooks", NOTEBOOKS)):
        for script in scripts:
            page = (site / "made" / kind / f"{script.stem}.html").read_text()
            assert f"sphx_glr_{script.stem}_001.png" in page, script.stem
    assert "<math" in (site / "mathematics" / "intervals.html").read_text()
    loaded = re.compile(r"<(?:script|img)[^>]+src=\"https?:|<link[^>]+stylesheet[^>]+href=\"https?:")
    assert [path.name for path in site.rglob("*.html") if loaded.search(path.read_text())] == []
    commands = (site / "made" / "commands.html").read_text()
    assert all(f'id="{name}"' in commands for name in ("demo", "frf", "tune", "check", "report", "gap"))


@pytest.mark.long
def test_every_page_fits_a_phone_and_the_search_finds_from_a_file(site: Path) -> None:
    """375 px: nothing makes a page scroll sideways. The search is a script and needs no server."""
    with browser() as chromium, chromium.new_context(viewport={"width": 375, "height": 800}) as context:
        page, wide = context.new_page(), {}
        for path in sorted(site.rglob("*.html")):
            page.goto(path.as_uri())
            width = page.evaluate("document.documentElement.scrollWidth")
            if width > 375:
                wide[path.relative_to(site).as_posix()] = width
        assert wide == {}
        page.goto((site / "search.html").as_uri() + "?q=detuning")
        page.wait_for_selector("#search-results ul.search li a")
        assert "detuning.html" in " ".join(a.get_attribute("href") for a in page.locator("ul.search li a").all())
        page.goto((site / "first_loop.html").as_uri())
        assert page.locator("button.copy").count() == page.locator("div.highlight").count() > 5


def luminance(colour: str) -> float:
    """WCAG 2.1, of #rrggbb."""
    values = np.array([int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@pytest.mark.parametrize("key", ["pygments_style", "pygments_dark_style"])
def test_code_on_the_site_is_coloured_with_enough_contrast(key: str) -> None:
    """4.5 to 1, of every colour on its ground; commands are coloured as commands, not as grey output."""
    styles = pytest.importorskip("pygments.styles")
    conf = (DOCS / "conf.py").read_text()
    style = styles.get_style_by_name(re.findall(rf'^{key} = "([\w-]+)"', conf, flags=re.M)[0])
    low = {}
    for token, look in style:
        ground = f"#{look['bgcolor']}" if look["bgcolor"] else style.background_color
        if look["color"]:
            dark, light = sorted((luminance(f"#{look['color']}"), luminance(ground)))
            if (light + 0.05) / (dark + 0.05) < 4.5:
                low[str(token)] = (look["color"], ground)
    assert low == {}
    assert 'add_lexer("console", Commands)' in conf
