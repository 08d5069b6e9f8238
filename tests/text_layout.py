"""What a reader of a figure cannot read: text over other text, over axes that it does not belong to, or cut."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from itertools import combinations
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

#: pixels by which boxes may meet: a box has room for ascenders and descenders that most words do not use
SLACK_PX = 2.0


def unreadable(figure: Figure, dpi: float = 150.0) -> list[str]:
    """A sentence for each text that overlaps another, lies over an axes not its own, or leaves the figure or its clip.

    The boxes are matplotlib's own, of the texts that the Agg renderer is really asked to draw (tick labels outside
    the limits are not). A text belongs to an axes when it stands in its data area by intent: `ax.text`, an
    annotation, its legend or a table. Its title, axis labels and tick labels do not.
    """
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    with _drawn() as texts:
        canvas.draw()
    return _found(canvas, texts)


def look_at_each_png(told: Callable[[list[str]], object]) -> None:
    """From now on `told` gets what is unreadable in each PNG that this process writes, at the PNG's own dpi."""
    write = FigureCanvasAgg.print_png

    @wraps(write)
    def print_png(self: FigureCanvasAgg, *args: object, **words: object) -> None:
        with _drawn() as texts:
            write(self, *args, **words)
        if found := _found(self, texts):
            told(found)

    FigureCanvasAgg.print_png = print_png  # type: ignore[method-assign]


def looked_at() -> dict[str, str]:
    """An environment in which every Python ends with an error where it writes such a PNG, by `sitecustomize`."""
    here = str(Path(__file__).parent)
    return os.environ | {"PYTHONPATH": os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])}


def _found(canvas: FigureCanvasAgg, texts: list[Text]) -> list[str]:
    figure, renderer = canvas.figure, canvas.get_renderer()
    boxes = [(text, Text.get_window_extent(text, renderer)) for text in texts]
    found = [f"{_name(t)} is cut" for t, box in boxes if not _within(_frame(t, figure), box)]
    found += [
        f"{_name(t)} over {_name(other)}"
        for (t, box), (other, its) in combinations(boxes, 2)
        if _overlap(box, its) and t.get_text() != other.get_text()
    ]
    for ax in (ax for ax in figure.axes if ax.get_visible() and ax.axison):
        own = {id(text) for text in _inside(ax)}
        found += [
            f"{_name(t)} over the axes {ax.get_ylabel() or ax.get_title() or ax.get_xlabel()!r}"
            for t, box in boxes
            if id(t) not in own and not _of_an_inset(t, ax) and _overlap(box, ax.get_window_extent(renderer))
        ]
    return found


@contextmanager
def _drawn() -> Iterator[list[Text]]:
    """The texts that are drawn meanwhile, each once, blank ones left out."""
    seen: dict[int, Text] = {}
    original = Text.draw

    def draw(self: Text, renderer: object) -> None:
        if self.get_visible() and self.get_text().strip():
            seen[id(self)] = self
        original(self, renderer)

    texts: list[Text] = []
    Text.draw = draw  # type: ignore[method-assign]
    try:
        yield texts
    finally:
        Text.draw = original  # type: ignore[method-assign]
        texts.extend(seen.values())


def _inside(ax: Axes) -> list[Text]:
    """Texts that stand in the data area of an axes, or of one that shares its place, by intent."""
    same = [one for one in ax.figure.axes if one.get_position().bounds == ax.get_position().bounds]
    parts = [a for one in same for a in (*one.texts, *one.tables, *one.artists, one.get_legend()) if a is not None]
    return [text for part in parts for text in part.findobj(Text)]


def _of_an_inset(text: Text, ax: Axes) -> bool:
    """Whether the text is of axes that were put into these."""
    return text.axes is not None and text.axes is not ax and text.axes in ax.child_axes


def _frame(text: Text, figure: Figure) -> Bbox:
    clip = text.get_clip_box() if text.get_clip_on() else None
    return figure.bbox if clip is None else Bbox.intersection(figure.bbox, clip) or figure.bbox


def _within(outer: Bbox, box: Bbox) -> bool:
    return bool(
        box.x0 >= outer.x0 - 1.0
        and box.x1 <= outer.x1 + 1.0
        and box.y0 >= outer.y0 - SLACK_PX
        and box.y1 <= outer.y1 + SLACK_PX
    )


def _overlap(one: Bbox, other: Bbox) -> bool:
    both = Bbox.intersection(one, other)
    return both is not None and both.width > SLACK_PX and both.height > SLACK_PX


def _name(text: Text) -> str:
    words = " ".join(text.get_text().split())
    return repr(words if len(words) < 40 else f"{words[:37]}...")
