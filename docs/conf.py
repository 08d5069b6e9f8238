"""The documentation site: `make docs` builds it, and every warning is an error.

Pages are Markdown; docstrings are plain text with `code`; pictures of the gallery and of the notebooks are made by the
build. Formulas become MathML, so that a page is read without a network.
"""

import re
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar
from weakref import WeakSet

import matplotlib.pyplot as plt
import typer
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pygments.lexer import inherit
from pygments.lexers.shell import BashLexer
from pygments.token import Keyword, Name
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx_gallery.scrapers import figure_rst
from sphinx_gallery.sorting import FileNameSortKey

import loopshape
from loopshape.cli import main as command_line
from loopshape.core.toolboxes import found

project = "loopshape"
author = "the loopshape developers"
copyright = "the loopshape developers; BSD-3-Clause"
release = version = loopshape.__version__

sys.path.insert(0, str(Path(__file__).parent))  # the gallery finds `last_picture` by its name
for _name in (
    "plot",
    "errors",
    *found().toolboxes,
):  # pages name pictures, errors and toolboxes' names as a script does
    if (_names := getattr(loopshape, _name, None)) is not None:
        _module = ModuleType(f"loopshape.{_name}", _names.__doc__)
        vars(_module).update(
            {one: getattr(_names, one) for one in dir(_names) if not one.startswith("_")}
        )
        sys.modules[_module.__name__] = _module

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["gallery", "notebooks", "paper", "**/*.ipynb"]
suppress_warnings = ["config.cache"]  # the gallery's sorting is a class
html_theme = "furo"
html_title = f"loopshape {release}"
templates_path = ["_templates"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["copy.js"]
html_copy_source = html_show_sourcelink = False
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
pygments_style = "xcode"  # every colour has 4.5:1 and more on its ground; a test computes it
pygments_dark_style = "github-dark-high-contrast"

default_role = "code"
autosummary_generate = True
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
python_use_unqualified_type_names = True
nitpicky = True
#: what has no page on this site: other projects, and what is inside the package
nitpick_ignore_regex = [
    ("py:.*", r"(?!loopshape\.)[\w.]+"),
    ("py:.*", r"loopshape\.[a-z]\w*\..*"),
]

sphinx_gallery_conf = {
    "examples_dirs": ["gallery", "notebooks"],
    "gallery_dirs": ["made/gallery", "made/notebooks"],
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__\.py",
    "within_subsection_order": FileNameSortKey,
    "capture_repr": ("_repr_html_", "__repr__"),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "ignore_repr_types": r"matplotlib|Figure|Axes",
    "image_scrapers": ("conf.last_picture", "matplotlib"),
    "remove_config_comments": True,
}
warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive")


SHOWN: WeakSet[Figure] = WeakSet()


def last_picture(block: Any, block_vars: Any, gallery_conf: Any) -> str:
    """The picture that a block ends with: those of `loopshape.plot` are not among pyplot's."""
    last = block_vars["example_globals"].get("___")
    figure = last.figure if isinstance(last, Axes) else last
    if not isinstance(figure, Figure) or figure in SHOWN:
        return ""
    SHOWN.add(figure)
    if plt.fignum_exists(getattr(figure, "number", -1)):
        return ""  # the next scraper, matplotlib's, shows it
    path = next(block_vars["image_path_iterator"])
    figure.savefig(path, dpi=130)
    return figure_rst([path], gallery_conf["src_dir"])


def mathml(writer: Any, node: nodes.Element, *, block: bool) -> None:
    """A formula as MathML, and nothing after it."""
    tex = node.astext().strip()
    writer.body.append(
        tex2mathml(
            r"\begin{aligned}" + tex + r"\end{aligned}" if r"\\" in tex else tex, as_block=block
        )
    )
    raise nodes.SkipNode


def as_rst(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape what a docstring means as text and reST would read as markup: |S|, X* Y, a trailing underscore."""
    for k, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...", "..")):
            parts = re.split(r"(`+[^`]*`+)", line)
            lines[k] = "".join(
                p if p.startswith("`") else re.sub(r"([|*\\]|_(?=\W|$))", r"\\\1", p)
                for p in parts
            )


def public(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, text: nodes.Element
) -> nodes.reference | None:
    """A class is known by its public name wherever it is defined: loopshape.data.response.frf.FRF is loopshape.FRF."""
    short = f"loopshape.{str(node.get('reftarget')).rsplit('.', 1)[-1]}"
    if node.get("refdomain") != "py" or short == node["reftarget"]:
        return None
    found = env.domains["py"].objects.get(short)
    if found is None or app.builder is None:
        return None
    uri = app.builder.get_relative_uri(env.docname, found.docname)
    return nodes.reference(
        "", "", text, internal=True, refuri=f"{uri}#{found.node_id}", reftitle=short
    )


class Commands(BashLexer):
    """Lines that are typed: the program with its command, and options, in colours of their own."""

    tokens: ClassVar = {
        "root": [
            (r"\bloopshape(?: [a-z][a-z-]+)?", Keyword),
            (r"(?<=\s)--?[a-z][\w-]*", Name.Attribute),
            inherit,
        ]
    }


def commands_page(app: Sphinx) -> None:
    """The reference of the commands, from the commands themselves."""
    group: Any = typer.main.get_command(command_line.app)
    parts = [
        "# Commands",
        "",
        "Every command with its options, as `loopshape COMMAND --help` prints them.",
    ]
    for heading, listed in command_line.COMMANDS.items():
        parts += ["", f"## {heading}"]
        for one in listed:
            parts += _command(one.name, one.example, group.commands[one.name])
    path = Path(app.srcdir) / "made" / "commands.md"
    path.parent.mkdir(exist_ok=True)
    text = "\n".join(parts) + "\n"
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def _command(name: str, example: str, command: Any) -> list[str]:
    """A command: what it does, its arguments and options, an example."""
    context = typer.Context(command, info_name=f"loopshape {name}")
    rows = [record for p in command.params if (record := p.get_help_record(context))]
    table = [f"| `{what}` | {' '.join(words.split())} |" for what, words in rows]
    head = [
        "",
        f"### {name}",
        "",
        re.sub(r"\s*\n\s*\n\s*", "\n\n", command.help or "").strip(),
        "",
    ]
    table = [
        row.replace("|G|", r"\|G\|")
        .replace("|S|", r"\|S\|")
        .replace("|E", r"\|E")
        .replace("d|²", r"d\|²")
        for row in table
    ]
    return [*head, "| | |", "|---|---|", *table, "", "```console", example, "```"]


def setup(app: Sphinx) -> None:
    """Formulas, docstrings and names as above."""
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda writer, node: mathml(writer, node, block=False), None),
        block_renderers=(lambda writer, node: mathml(writer, node, block=True), None),
    )
    app.connect("autodoc-process-docstring", as_rst, priority=400)
    app.connect("missing-reference", public)
    app.connect("builder-inited", commands_page)
    app.add_lexer("console", Commands)  # blocks of commands have no prompt: they are no output
