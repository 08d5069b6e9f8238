"""One quiet look for every figure: fonts, grid, colours; new figures, and figures as PNG."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

#: Okabe and Ito's colours, told apart by colour-blind readers; doi.org/10.1038/nmeth.1618
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
_COLD_TO_WARM = ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
LIMIT = "#B2182B"  # what must not be crossed
QUIET = "#6E6E6E"  # what only helps to read
FULL_WIDTH_IN = 7.0
MOST_DETAILS = 4  # lines under a title
MARKS = re.compile(r"\\[a-z]{2}[a-z]+|[$_{}]")

RC: dict[str, object] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "figure.titlesize": 10.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "mathtext.default": "regular",
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#404040",
    "axes.axisbelow": True,
    "axes.titley": 1.0,  # titles need not look for labels above the axes, a quarter of a page's layout
    "axes.grid": True,
    "axes.grid.which": "major",
    "grid.color": "#D9D9D9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.0,
    "xtick.major.pad": 5.5,  # clear of the lowest label of the other axis
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "legend.frameon": True,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "none",
    "legend.borderpad": 0.3,
    "legend.handlelength": 1.8,
    "figure.constrained_layout.use": True,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "path.simplify": True,
}


@contextmanager
def styled() -> Iterator[None]:
    """The look, as `with styled():` or as the decorator `@styled()`."""
    with mpl.rc_context(RC):  # type: ignore[arg-type]
        yield


@styled()
def new_figure(rows: int = 1, cols: int = 1, size: tuple[float, float] | None = None, **grid: object) -> Figure:
    """Figure with rows x cols axes (`figure.axes`, row by row); `size` in inches, `grid` as of `Figure.subplots`."""
    figure = Figure(figsize=size or (FULL_WIDTH_IN, 1.2 + 2.2 * rows))
    figure.subplots(rows, cols, **grid)  # type: ignore[call-overload]
    return figure


def axes_or_new(ax: Axes | None, size: tuple[float, float] = (4.5, 3.2)) -> Axes:
    """The axes given, or those of a new figure."""
    return new_figure(1, 1, size).axes[0] if ax is None else ax


def figure_of(ax: Axes) -> Figure:
    """The figure that an axes stands in."""
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    return figure


def shades(n: int) -> list[str]:
    """n colours in rising order, cold to warm: five that colour-blind readers tell apart, a ramp beyond."""
    if n <= len(_COLD_TO_WARM):
        return list(_COLD_TO_WARM[:n]) if n > 2 else list(COLOURS[:n])
    ramp = mpl.colormaps["plasma"]  # its bright end vanishes on white paper
    return [to_hex(ramp(0.88 * i / (n - 1))) for i in range(n)]


@styled()
def head(figure: Figure, title: str, *details: str) -> None:
    """Title at the left, at most four lines of details below it in grey; the figure grows by what the axes lack.

    Longer details end in "...": they stand whole in the FRF's `method` and `notes`, and in the report.
    """
    lines = [line for detail in details for line in wrapped(detail, round(16.5 * figure.get_figwidth()))]
    if len(lines) > MOST_DETAILS:
        lines = [*lines[: MOST_DETAILS - 1], f"{lines[MOST_DETAILS - 1]} ..."]
    room = 0.24 + 0.165 * len(lines)
    head_in = 1.0  # of a figure's height, which its own size allows for title and details
    height = figure.get_figheight() + max(0.0, room - head_in)
    figure.set_figheight(height)
    figure.text(0.012, 1.0 - 0.06 / height, title, va="top", fontsize=10.0)
    for k, line in enumerate(lines):
        figure.text(0.012, 1.0 - (0.25 + 0.165 * k) / height, line, va="top", fontsize=8.0, color=QUIET)
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - room / height))
    figure.align_ylabels()


def wrapped(text: str, width: int) -> list[str]:
    """Lines of at most `width` printed characters; the marks of mathematics do not print."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and len(MARKS.sub("", longer)) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


@styled()
def png(figure: Figure) -> bytes:
    """The figure as PNG of 150 dpi; the same figure gives the same bytes. Files are the store's business."""
    buffer, own_dpi = BytesIO(), figure.dpi
    figure.dpi = 150
    for spine in (spine for ax in figure.axes for spine in ax.spines.values()):
        spine.set_in_layout(False)  # as wide as the axes, whose size the layout knows
    level = {"compress_level": 3}  # six parts in a hundred larger than at 6, in two thirds of its time
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None}, pil_kwargs=level)  # `savefig` draws twice
    figure.dpi = own_dpi
    return buffer.getvalue()
