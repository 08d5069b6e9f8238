"""What a reader of a figure cannot read: text that is too small, over other text, over axes not its own, or cut.

`make studies` and `make pictures` refuse to write such a figure, and note in the PNG where its texts stand.
"""

import json
import os
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from functools import wraps
from io import BytesIO
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox, BboxBase
from PIL import Image

from loopshape.view.style import FULL_WIDTH_IN

#: pixels by which boxes may meet: a box has room for ascenders and descenders that most words do not use
SLACK_PX = 2.0
#: the smallest text that is read on paper, in points, and the width of A4 between its margins
LEAST_PT, PAPER_IN = 6.0, FULL_WIDTH_IN
CSS_PX_PER_IN = 96.0
_KEY = b"Texts"


@dataclass(frozen=True)
class PlacedText:
    """A text of a picture: its size and its box in pixels, from the upper left corner."""

    text: str
    size_px: float
    x0: float
    y0: float
    x1: float
    y1: float

    def printed_pt(self, width_px: float, width_in: float) -> float:
        """Its size on paper, where a picture as wide as it is drawn is shrunk to the paper's width."""
        return self.size_px / width_px * min(width_in, PAPER_IN) * 72.0

    @property
    def box(self) -> BboxBase:
        """The box of its pixels."""
        return Bbox.from_extents(self.x0, self.y0, self.x1, self.y1)


def unreadable(figure: Figure, dpi: float = 150.0) -> list[str]:
    """A sentence for each text that is too small, overlaps another, lies over an axes not its own, or is cut.

    The boxes are matplotlib's own, of the texts that the Agg renderer is really asked to draw (tick labels outside
    the limits are not). A text belongs to an axes when it stands in its data area by intent: `ax.text`, an
    annotation, its legend or a table. Its title, axis labels and tick labels do not.
    """
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    with _drawn() as texts:
        canvas.draw()
    return _found(canvas, texts)


def with_texts(picture: bytes, texts: Iterable[PlacedText]) -> bytes:
    """A PNG with the places of its texts noted in it."""
    note = _KEY + b"\0\0" + zlib.compress(json.dumps([astuple(t) for t in texts]).encode())
    end = picture.rindex(b"IEND") - 4
    chunk = struct.pack(">I", len(note)) + b"zTXt" + note + struct.pack(">I", zlib.crc32(b"zTXt" + note))
    return picture[:end] + chunk + picture[end:]


def unreadable_on_paper(path: Path) -> list[str]:
    """A sentence for each text of a kept picture that is too small in print, overlaps another or leaves the picture."""
    with Image.open(path) as image:
        image.load()  # what is noted stands behind the pixels
        noted, (width, height) = image.info.get(_KEY.decode()), image.size
        width_in = width / image.info.get("dpi", (CSS_PX_PER_IN,))[0]
        grey = np.asarray(image.convert("L"), dtype=float)
    if noted is None:
        return ["does not note where its texts stand: draw it anew"]
    texts = [PlacedText(*row) for row in json.loads(noted)]
    frame = Bbox.from_extents(0.0, 0.0, width, height)
    found = [f"{t.text!r} has {pt:.1f} pt" for t in texts if (pt := t.printed_pt(width, width_in)) < LEAST_PT - 0.01]
    found += [f"{t.text!r} is cut" for t in texts if not _within(frame, t.box)]
    found += [f"{t.text!r} is not where it is noted" for t in texts if not _inked(grey, t)]
    found += [
        f"{t.text!r} over {o.text!r}" for t, o in combinations(texts, 2) if t.text != o.text and _overlap(t.box, o.box)
    ]
    return list(dict.fromkeys(found))


def _inked(grey: np.ndarray, text: PlacedText) -> bool:
    """Whether anything stands in the text's box: another picture's notes would point at blank paper."""
    rows, columns = (slice(max(int(a), 0), int(b) + 1) for a, b in ((text.y0, text.y1), (text.x0, text.x1)))
    return bool(np.ptp(grey[rows, columns]) > 20.0) if grey[rows, columns].size else False


def look_at_each_png(told: Callable[[list[str]], object], *, note: bool = False) -> None:
    """From now on `told` gets what is unreadable in each PNG that this process writes, at the PNG's own dpi.

    With `note` the places of the texts are noted in what is written to memory.
    """
    write = FigureCanvasAgg.print_png

    @wraps(write)
    def print_png(self: FigureCanvasAgg, to: object, *args: object, **words: object) -> None:
        with _drawn() as texts:
            write(self, to, *args, **words)
        if found := _found(self, texts):
            told(found)
        if note and isinstance(to, BytesIO):
            noted = with_texts(to.getvalue(), _placed(self, texts))
            to.seek(0)
            to.write(noted)

    FigureCanvasAgg.print_png = print_png  # type: ignore[method-assign,assignment]


def _placed(canvas: FigureCanvasAgg, texts: list[Text]) -> list[PlacedText]:
    height, dpi = canvas.figure.bbox.height, canvas.figure.dpi
    placed = []
    for t in texts:
        box = Text.get_window_extent(t, canvas.get_renderer())
        x0, y0, x1, y1 = (round(float(x), 1) for x in (box.x0, height - box.y1, box.x1, height - box.y0))
        size_px = float(t.get_fontsize()) * dpi / 72.0
        placed.append(PlacedText(" ".join(t.get_text().split()), size_px, x0, y0, x1, y1))
    return placed


def looked_at() -> dict[str, str]:
    """An environment in which every Python ends with an error where it writes such a PNG, by `sitecustomize`."""
    lab = Path(__file__).parent
    places = [str(lab.parents[1] / "tests"), str(lab)]
    return os.environ | {"PYTHONPATH": os.pathsep.join([*places, *filter(None, [os.environ.get("PYTHONPATH")])])}


def _found(canvas: FigureCanvasAgg, texts: list[Text]) -> list[str]:
    figure, renderer = canvas.figure, canvas.get_renderer()
    boxes = [(text, Text.get_window_extent(text, renderer)) for text in texts]
    shrunk = min(1.0, PAPER_IN / figure.get_figwidth())
    sizes = [(t, shrunk * float(t.get_fontsize())) for t in texts]
    found = [f"{_name(t)} has {pt:.1f} pt in print" for t, pt in sizes if pt < LEAST_PT - 0.01]
    found += [f"{_name(t)} is cut" for t, box in boxes if not _within(_frame(t, figure), box)]
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

    def draw(self: Text, renderer: RendererBase) -> None:
        if self.get_visible() and self.get_text().strip():
            seen[id(self)] = self
        original(self, renderer)

    texts: list[Text] = []
    Text.draw = draw  # type: ignore[method-assign,assignment]
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


def _frame(text: Text, figure: Figure) -> BboxBase:
    clip = text.get_clip_box() if text.get_clip_on() else None
    return figure.bbox if clip is None else Bbox.intersection(figure.bbox, clip) or figure.bbox


def _within(outer: BboxBase, box: BboxBase) -> bool:
    return bool(
        box.x0 >= outer.x0 - 1.0
        and box.x1 <= outer.x1 + 1.0
        and box.y0 >= outer.y0 - SLACK_PX
        and box.y1 <= outer.y1 + SLACK_PX
    )


def _overlap(one: BboxBase, other: BboxBase) -> bool:
    both = Bbox.intersection(one, other)
    return both is not None and both.width > SLACK_PX and both.height > SLACK_PX


def _name(text: Text) -> str:
    words = " ".join(text.get_text().split())
    return repr(words if len(words) < 40 else f"{words[:37]}...")
