"""Axes of the report's plots as SVG: scales, ticks, grid, and the frame that curves are clipped to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array
from loopshape.view.html.markup import Markup, tag
from loopshape.view.labels import number

WIDTH, HEIGHT = 480, 300
LEFT, RIGHT, TOP, BOTTOM = 50, 12, 30, 38
#: paths stay within this many units of the picture: far-off numbers upset some readers
FAR = 2000.0


@dataclass(frozen=True)
class Scale:
    """Values from `low` to `high` on pixels from `start` to `end`; `log` scales equal ratios."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, values: Array) -> Array:
        """Pixels of values, kept finite where the values are."""
        low, high = (np.log(self.low), np.log(self.high)) if self.log else (self.low, self.high)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = ((np.log(values) if self.log else np.asarray(values, dtype=float)) - low) / (high - low)
        return np.clip(self.start + share * (self.end - self.start), -FAR, FAR)


@dataclass(frozen=True)
class Frame:
    """A plot's two scales, its height, and the words at its axes."""

    x: Scale
    y: Scale
    x_label: str
    y_label: str
    x_ticks: tuple[float, ...]
    y_ticks: tuple[float, ...]
    height: int = HEIGHT

    def path(self, x: Array, y: Array) -> str:
        """A curve as path data; it is broken where a value is not a number."""
        px, py = self.x(x), self.y(y)
        good = np.isfinite(px) & np.isfinite(py)
        starts = good & ~np.concatenate([[False], good[:-1]])
        return "".join(
            f"{'M' if start else 'L'}{_plain(a)} {_plain(b)}"
            for a, b, start, use in zip(px, py, starts, good, strict=True)
            if use
        )

    def dots(self, x: Array, y: Array) -> str:
        """Points as strokes of no length, which round ends make dots."""
        px, py = self.x(x), self.y(y)
        good = np.isfinite(px) & np.isfinite(py)
        return "".join(f"M{_plain(a)} {_plain(b)}h0" for a, b in zip(px[good], py[good], strict=True))

    def area(self, x: Array, low: Array, high: Array) -> str:
        """The closed outline between two curves."""
        good = np.isfinite(low) & np.isfinite(high)
        if not good.any():
            return ""
        return f"{self.path(np.append(x[good], x[good][::-1]), np.append(high[good], low[good][::-1]))}Z"


def _plain(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def frequency_frame(
    band_hz: tuple[float, float], low: float, high: float, y_label: str, *, step: float | None = None
) -> Frame:
    """A plot over logarithmic Hz; `step` sets the distance of the ticks, None finds a round one."""
    x = Scale(*band_hz, LEFT, WIDTH - RIGHT, log=True)
    y = Scale(low, high, HEIGHT - BOTTOM, TOP)
    return Frame(x, y, "frequency [Hz]", y_label, log_ticks(*band_hz), linear_ticks(low, high, step))


def log_ticks(low: float, high: float) -> tuple[float, ...]:
    """1, 2 and 5 of each decade over a short range, else the decades."""
    subs = (1.0, 2.0, 5.0) if high / low < 150.0 else (1.0,)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [sub * 10.0**k for k in decades for sub in subs]
    return tuple(tick for tick in ticks if low * 0.999 <= tick <= high * 1.001)


def fine_log_ticks(low: float, high: float) -> tuple[float, ...]:
    """Every whole multiple within each decade, for the faint grid."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return tuple(t for k in decades for sub in range(1, 10) if low < (t := sub * 10.0**k) < high)


def linear_ticks(low: float, high: float, step: float | None = None) -> tuple[float, ...]:
    """Round values from low to high, seven at most."""
    span = high - low
    if step is None:
        rough = span / 6.0
        base = 10.0 ** np.floor(np.log10(rough))
        step = float(next(m * base for m in (1.0, 2.0, 5.0, 10.0) if m * base >= rough * 0.999))
    while span / step > 7.0:
        step *= 2.0
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return tuple(step * k for k in range(first, last + 1))


def axes(frame: Frame) -> Markup:
    """Grid, ticks and labels of a plot."""
    left, right, top, bottom = LEFT, WIDTH - RIGHT, TOP, frame.height - BOTTOM
    parts = [tag("rect", x=left, y=top, width=right - left, height=bottom - top, class_="paper")]
    if frame.x.log:
        parts.append(_grid(frame.x(np.array(fine_log_ticks(frame.x.low, frame.x.high))), top, bottom, "fine", True))
    xs, ys = frame.x(np.array(frame.x_ticks)), frame.y(np.array(frame.y_ticks))
    parts += [_grid(xs, top, bottom, "grid", True), _grid(ys, left, right, "grid", False)]
    parts += [
        tag("text", number(float(value)), x=_plain(x), y=bottom + 15, class_="tick middle")
        for value, x in zip(frame.x_ticks, xs, strict=True)
    ]
    parts += [
        tag("text", number(float(value)), x=left - 5, y=_plain(y + 4.0), class_="tick end")
        for value, y in zip(frame.y_ticks, ys, strict=True)
    ]
    parts.append(tag("text", frame.y_label, x=4, y=13, class_="label"))
    parts.append(tag("text", frame.x_label, x=right, y=frame.height - 5, class_="label end"))
    return tag("g", *parts, class_="axes")


def _grid(at: Array, start: float, end: float, kind: str, upright: bool) -> Markup:
    """Parallel lines as one path."""
    lines = (
        f"M{_plain(p)} {_plain(start)}V{_plain(end)}" if upright else f"M{_plain(start)} {_plain(p)}H{_plain(end)}"
        for p in at
    )
    return tag("path", d="".join(lines), class_=kind)


def border(frame: Frame) -> Markup:
    """The frame's outline, drawn above the curves."""
    box = {"x": LEFT, "y": TOP, "width": WIDTH - RIGHT - LEFT, "height": frame.height - BOTTOM - TOP}
    return tag("rect", **box, class_="border")


def decibel_range(values: Sequence[Array], *, step: float = 10.0, span: float = 100.0) -> tuple[float, float]:
    """Whole steps of dB around the finite values, at most `span` below the top."""
    every = np.concatenate([np.ravel(one) for one in values]) if values else np.zeros(0)
    every = every[np.isfinite(every)]
    if not every.size:
        return -step, step
    top = step * np.ceil((every.max() + 1.0) / step)
    return float(max(step * np.floor((every.min() - 1.0) / step), top - span)), float(top)


def degree_range(values: Sequence[Array]) -> tuple[float, float]:
    """Whole steps of 45 degrees around the finite values."""
    every = np.concatenate([np.ravel(one) for one in values]) if values else np.zeros(0)
    every = every[np.isfinite(every)]
    if not every.size:
        return -180.0, 0.0
    return float(45.0 * np.floor((every.min() - 5.0) / 45.0)), float(45.0 * np.ceil((every.max() + 5.0) / 45.0))


def frequency_band(lines_hz: Sequence[Array]) -> tuple[float, float]:
    """Lowest and highest line of several grids; widened where there is one line alone."""
    low = min(float(f[0]) for f in lines_hz)
    high = max(float(f[-1]) for f in lines_hz)
    return (low, high) if low < high else (low / 1.6, high * 1.6)
