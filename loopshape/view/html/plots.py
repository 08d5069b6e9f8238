"""The report's plots as SVG that stands by itself; the page's script only reads values off it and hides curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array
from loopshape.data.frf import FRF
from loopshape.data.requirements import LIMIT_OF, Requirements
from loopshape.data.verdict import Line
from loopshape.view.html.axes import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    Frame,
    Scale,
    axes,
    border,
    decibel_range,
    degree_range,
    frequency_band,
    frequency_frame,
    linear_ticks,
)
from loopshape.view.html.guides import (
    Guide,
    ceiling,
    critical_phases,
    least_bandwidth,
    level,
    limits_of,
    mask_guide,
    mask_sizes,
    nichols_guides,
    nichols_words,
    shown_sizes,
)
from loopshape.view.html.markup import Markup, joined, tag
from loopshape.view.html.traces import REACH_OF, Trace
from loopshape.view.html.words import count
from loopshape.view.labels import decibel, ratio, units_of

#: of more curves than these the script shows one band at a time
BANDS_AT_ONCE = 4
NICHOLS_HEIGHT, REACH_DB = 590, 40.0
_TITLES = {
    "P": "Plant P",
    "L": "Open loop L = C P",
    "S": "Sensitivity S",
    "T": "Complementary sensitivity T",
    "CS": "Control sensitivity CS",
    "PS": "Process sensitivity PS",
}


@dataclass(frozen=True, eq=False)
class Plots:
    """Plots of one loop, numbered so that their names on the page stay their own; `wished` draws the limits.

    `lines` are a verdict's: where each is worst a ring stands.
    """

    number: int
    traces: Sequence[Trace]
    plant: FRF
    wished: Requirements | None = None
    lines: Sequence[Line] = ()

    @property
    def band_hz(self) -> tuple[float, float]:
        """From the lowest line to the highest."""
        return frequency_band([trace.frequency_hz for trace in self.traces])

    def unit(self, name: str) -> str:
        """Unit of a response."""
        unit_in, unit_out = units_of(self.plant)
        units = {"P": ratio(unit_out, unit_in), "CS": ratio(unit_in, unit_out), "PS": ratio(unit_out, unit_in)}
        return units.get(name, "")

    def magnitude(self, name: str) -> Markup:
        """|name| over frequency with its 95 % bands, and its limits where there are any."""
        limits = limits_of(self.wished, name)
        masks = () if self.wished is None else self.wished.masks_on(name)
        sizes = [trace.size_db[name] for trace in self.traces] + shown_sizes(limits) + mask_sizes(masks)
        low, high = decibel_range(sizes, span=100.0 if name in "PL" else 60.0)
        frame = frequency_frame(self.band_hz, low, high, decibel(f"|{name}|", self.unit(name)))
        guides = [ceiling(frame, *limit) for limit in limits] + [mask_guide(frame, mask) for mask in masks]
        if name == "L":
            guides += [level(frame, 0.0, "zero"), least_bandwidth(frame, self.wished)]
        guides += [self._worst(frame, name, [x.size_db[name] for x in self.traces])]
        curves = joined(self._magnitude_curve(frame, k, name) for k in range(len(self.traces)))
        return self._figure(frame, f"{name}-db", f"{_TITLES[name]}: magnitude", Guide.of(guides), curves)

    def phase(self, name: str) -> Markup:
        """Phase over frequency with its 95 % bands."""
        phases = [trace.phase_deg[name] for trace in self.traces]
        frame = frequency_frame(self.band_hz, *degree_range(phases), f"phase of {name} [deg]", step=45.0)
        guides = [critical_phases(frame, self.wished), self._worst(frame, "L phase", phases)] if name == "L" else []
        curves = []
        for k, (trace, y) in enumerate(zip(self.traces, phases, strict=True)):
            reach = trace.reach_deg["P"]
            curves.append(self._curve(frame, k, y, y - reach, y + reach))
            curves += [_dots(frame, k, trace, trace.dots[2])] if name == "P" else []
        return self._figure(frame, f"{name}-deg", f"{_TITLES[name]}: phase", Guide.of(guides), joined(curves))

    def nichols(self) -> Markup:
        """L, phase against magnitude, with contours of |S|, the forbidden region and a cross of required margins."""
        frame = _nichols_frame(self.traces)
        curves = [_line(frame, k, x, x.phase_deg["L"], x.size_db["L"]) for k, x in enumerate(self.traces)]
        guide, words = nichols_guides(frame, self.wished), nichols_words(self.wished)
        return self._figure(frame, "nichols", "Nichols: open loop L", guide, joined(curves), words)

    def _worst(self, frame: Frame, name: str, curves: Sequence[Array]) -> Guide:
        """A ring on the curve of each requirement's worst operating point, at the frequency that the check names."""
        rings = []
        for line in self.lines:
            k = next((k for k, x in enumerate(self.traces) if x.name == line.recording), None)
            if LIMIT_OF[line.quantity].plot != name or k is None or not line.at_hz:
                continue
            f = self.traces[k].frequency_hz
            y = float(np.interp(np.log(line.at_hz), np.log(f), curves[k]))
            if f[0] <= line.at_hz <= f[-1] and frame.y.low <= y <= frame.y.high:
                x = float(frame.x(np.array([line.at_hz]))[0])
                at = {"cx": f"{x:.1f}", "cy": f"{float(frame.y(np.array([y]))[0]):.1f}", "r": 6}
                rings.append(tag("circle", class_=f"ring {line.outcome}", data_op=k, **at))
        return Guide(above=joined(rings))

    def _magnitude_curve(self, frame: Frame, k: int, name: str) -> Markup:
        trace, reach = self.traces[k], REACH_OF[name]
        size = trace.size_db[name]
        curve = self._curve(frame, k, size, size + trace.down_db[reach], size + trace.up_db[reach])
        return joined([curve, _dots(frame, k, trace, trace.dots[1]) if name == "P" else None])

    def _curve(self, frame: Frame, k: int, y: Array, low: Array, high: Array) -> Markup:
        """A curve over frequency on its band, which many curves leave out."""
        trace, band = self.traces[k], None
        if len(self.traces) <= BANDS_AT_ONCE:
            area = frame.area(trace.frequency_hz, low, high)
            band = tag("path", d=area, class_="band", fill=trace.colour, data_op=k)
        return joined([band, _line(frame, k, trace, trace.frequency_hz, y)])

    def _figure(self, frame: Frame, key: str, title: str, guide: Guide, curves: Markup, words: str = "") -> Markup:
        """The plot with its caption; its scales go with it for the script."""
        name = f"plot-{self.number}-{key}"
        box = tag("rect", x=LEFT, y=TOP, width=WIDTH - LEFT - RIGHT, height=frame.height - TOP - BOTTOM)
        svg = tag(
            "svg",
            tag("title", f"{title}, {count(len(self.traces), 'operating point')}", id=f"{name}-title"),
            tag("defs", tag("clipPath", box, id=f"{name}-clip")),
            axes(frame),
            tag("g", guide.below, curves, guide.above, clip_path=f"url(#{name}-clip)"),
            border(frame),
            viewBox=f"0 0 {WIDTH} {frame.height}",
            role="img",
            aria_labelledby=f"{name}-title",
            data_plot=key,
            data_x=_scale_words(frame.x),
            data_y=_scale_words(frame.y),
            data_log="1" if frame.x.log else "0",
        )
        note = tag("p", words, class_="quiet") if words else None
        kind = "plot tall" if frame.height > HEIGHT else "plot"
        return tag("figure", tag("figcaption", title), svg, note, class_=kind)


def _scale_words(scale: Scale) -> str:
    return f"{scale.low:.9g} {scale.high:.9g} {scale.start:g} {scale.end:g}"


def _line(frame: Frame, k: int, trace: Trace, x: Array, y: Array) -> Markup:
    look = {"stroke": trace.colour, "stroke_dasharray": trace.dash or None}
    return tag("path", d=frame.path(x, y), class_="curve", data_op=k, **look)


def _dots(frame: Frame, k: int, trace: Trace, y: Array) -> Markup:
    """Lines of P that are not looked at, faint; those outside the plot are left out."""
    x = trace.dots[0]
    inside = (x >= frame.x.low) & (x <= frame.x.high)
    d = frame.dots(x[inside], y[inside])
    return tag("path", d=d, class_="dots", stroke=trace.colour, data_op=k) if d else Markup("")


def _nichols_frame(traces: Sequence[Trace]) -> Frame:
    """Whole steps around what lies within 40 dB of the 0 dB line; the critical point always shows."""
    x = np.concatenate([trace.phase_deg["L"] for trace in traces])
    y = np.concatenate([trace.size_db["L"] for trace in traces])
    seen = np.isfinite(x) & np.isfinite(y) & (np.abs(y) <= REACH_DB)
    x, y = np.append(x[seen], [-225.0, -135.0]), np.append(y[seen], [10.0, -20.0])
    left, right = float(45.0 * np.floor((x.min() - 5.0) / 45.0)), float(45.0 * np.ceil((x.max() + 5.0) / 45.0))
    low, high = float(10.0 * np.floor((y.min() - 1.0) / 10.0)), float(10.0 * np.ceil((y.max() + 1.0) / 10.0))
    step = 45.0 if right - left <= 270.0 else 90.0
    ticks = tuple(float(step * k) for k in range(int(np.ceil(left / step)), int(np.floor(right / step)) + 1))
    return Frame(
        Scale(left, right, LEFT, WIDTH - RIGHT),
        Scale(low, high, NICHOLS_HEIGHT - BOTTOM, TOP),
        "open-loop phase [deg]",
        "|L| [dB]",
        ticks,
        linear_ticks(low, high, 10.0),
        NICHOLS_HEIGHT,
    )
