"""What stands behind the curves of the report's plots: limits, levels, contours, forbidden regions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from loopshape.core.units import db
from loopshape.data.limits_over import Mask
from loopshape.data.requirements import Requirements
from loopshape.view.contours import constant_s, constant_t, nichols_coordinates, turns
from loopshape.view.html.axes import LEFT, RIGHT, TOP, WIDTH, Frame
from loopshape.view.html.markup import Markup, joined, tag
from loopshape.view.html.words import number

LEVELS_DB = (12.0, 6.0, 3.0, 0.0, -6.0, -12.0)
_POINTS = 361


class Guide(NamedTuple):
    """Shapes that lie below the curves, and words that stand above them."""

    below: Markup = Markup("")
    above: Markup = Markup("")

    @classmethod
    def of(cls, parts: Iterable[Guide]) -> Guide:
        """Several in one."""
        every = list(parts)
        return cls(joined(one.below for one in every), joined(one.above for one in every))


def closest_db(wished: Requirements | None) -> float | None:
    """The sharper of the limits on |S|'s peak and on the modulus margin, as |S| in dB; None without either."""
    if wished is None:
        return None
    limits = [] if wished.sensitivity_peak_db is None else [wished.sensitivity_peak_db]
    if wished.modulus_margin is not None:
        limits.append(-float(db(wished.modulus_margin)))
    limits = [limit for limit in limits if limit > 0.0]
    return min(limits) if limits else None


def limits_of(wished: Requirements | None, name: str) -> list[tuple[float, float | None]]:
    """Upper limits of |S|, |T|, |CS| or |PS| in dB, each with the frequency it begins at (None: everywhere)."""
    if wished is None:
        return []
    if name != "S":
        return wished.ceilings_db(name)
    closest = closest_db(wished)
    return [] if closest is None else [(closest, None)]


def ceiling(frame: Frame, limit_db: float, from_hz: float | None) -> Guide:
    """An upper limit, the side above it tinted; nothing where it begins above the plot."""
    start = max(from_hz or frame.x.low, frame.x.low)
    if start >= frame.x.high:
        return Guide()
    y = float(frame.y(np.array([limit_db]))[0])
    left, right = float(frame.x(np.array([start]))[0]), frame.x.end
    words = f"at most {number(limit_db)} dB" + ("" if from_hz is None else f" from {number(from_hz)} Hz")
    tint = tag("path", d=f"M{left:.1f} {y:.1f}H{right:.1f}V{TOP}H{left:.1f}Z", class_="forbidden")
    line = tag("path", d=f"M{left:.1f} {y:.1f}H{right:.1f}", class_="limit")
    return Guide(
        joined([tint, line]), tag("text", words, x=f"{right - 4:.1f}", y=f"{y - 4:.1f}", class_="limit-text end")
    )


def mask_guide(frame: Frame, mask: Mask) -> Guide:
    """A mask over frequency, its forbidden side tinted; nothing where it lies outside the plot."""
    low, high = max(frame.x.low, mask.band_hz[0]), min(frame.x.high, mask.band_hz[1])
    if low >= high:
        return Guide()
    f = np.array([low, *(f for f, _ in mask.points if low < f < high), high])
    path = frame.path(f, mask.level_db(f))
    left, right = frame.x(np.array([low, high]))
    edge = frame.y.start if mask.sense == "at_least" else TOP
    tint = tag("path", d=f"{path}L{right:.1f} {edge:g}H{left:.1f}Z", class_="forbidden")
    return Guide(joined([tint, tag("path", d=path, class_="limit")]))


def mask_sizes(masks: Sequence[Mask]) -> list[np.ndarray]:
    """Values that an axis must span to show its masks."""
    return [np.array([level for _, level in mask.points]) for mask in masks]


def level(frame: Frame, value: float, kind: str, words: str = "") -> Guide:
    """A line across at a value, with words above its left end; nothing where it lies outside."""
    if not frame.y.low <= value <= frame.y.high:
        return Guide()
    y, right = float(frame.y(np.array([value]))[0]), WIDTH - RIGHT
    line = tag("path", d=f"M{LEFT} {y:.1f}H{right}", class_=kind)
    return Guide(line, tag("text", words, x=LEFT + 5, y=f"{y + 12:.1f}", class_="limit-text") if words else Markup(""))


def least_bandwidth(frame: Frame, wished: Requirements | None) -> Guide:
    """The required bandwidth on the open loop's magnitude, an upright line."""
    if wished is None or wished.bandwidth_hz is None or not frame.x.low < wished.bandwidth_hz < frame.x.high:
        return Guide()
    x, low, high = float(frame.x(np.array([wished.bandwidth_hz]))[0]), frame.y.start, frame.y.end
    left = x > 0.5 * WIDTH
    words = tag(
        "text",
        f"bandwidth at least {number(wished.bandwidth_hz)} Hz",
        x=f"{x + (-5 if left else 5):.1f}",
        y=f"{low - 6:g}",
        class_="limit-text end" if left else "limit-text",
    )
    return Guide(tag("path", d=f"M{x:.1f} {low:g}V{high:g}", class_="limit"), words)


def critical_phases(frame: Frame, wished: Requirements | None) -> Guide:
    """-180 degrees and its repeats on the open loop's phase, and above the first the required phase margin."""
    lines = [level(frame, shift - 180.0, "zero") for shift in turns(frame.y.low, frame.y.high)]
    if wished is not None and wished.phase_margin_deg is not None:
        words = f"phase margin {number(wished.phase_margin_deg)} deg"
        lines.append(level(frame, wished.phase_margin_deg - 180.0, "limit dotted", words))
    return Guide.of(lines)


def nichols_guides(frame: Frame, wished: Requirements | None) -> Guide:
    """Contours of constant |S|, and at every critical point in view the forbidden region and the required margins."""
    closest = closest_db(wished)
    shifts = turns(frame.x.low, frame.x.high)
    shown = [one for one in LEVELS_DB if closest is None or one < closest]
    contours = [_contour(frame, one, shift) for one in shown for shift in shifts]
    return Guide.of([*contours, *(Guide(_forbidden(frame, wished, closest, shift)) for shift in shifts)])


def nichols_words(wished: Requirements | None) -> str:
    """What the lines behind the Nichols curves mean."""
    said = ["Grey: |S| constant."]
    closest = closest_db(wished)
    if closest is not None:
        said.append(f"Red, filled: |S| above {number(closest)} dB.")
    if wished is not None and (wished.complementary_peak_db or 0.0) > 0.0:
        said.append(f"Red, dotted: |T| at {number(wished.complementary_peak_db)} dB.")
    if wished is not None and (wished.phase_margin_deg or wished.gain_margin_db or wished.gain_reduction_margin_db):
        said.append("Red cross: required margins, phase sideways, gain upwards and downwards.")
    return " ".join([*said, "A stable loop keeps the black cross on its left as frequency rises."])


def _forbidden(frame: Frame, wished: Requirements | None, closest: float | None, shift: float) -> Markup:
    parts = []
    if closest is not None:
        x, y = nichols_coordinates(constant_s(closest, _POINTS))
        parts.append(tag("path", d=f"{frame.path(x + shift, y)}Z", class_="forbidden edge"))
    peak_db = 0.0 if wished is None else wished.complementary_peak_db or 0.0
    if peak_db > 0.0:
        x, y = nichols_coordinates(constant_t(peak_db, _POINTS))
        parts.append(tag("path", d=frame.path(x + shift, y), class_="limit dotted"))
    if wished is not None:
        parts += _cross(frame, wished, shift - 180.0)
    at = float(frame.x(np.array([shift - 180.0]))[0]), float(frame.y(np.array([0.0]))[0])
    return joined([*parts, tag("path", d=f"M{at[0] - 5:.1f} {at[1]:.1f}h10m-5 -5v10", class_="critical")])


def _cross(frame: Frame, wished: Requirements, centre: float) -> list[Markup]:
    """Required margins at a critical point: left and right the phase, down the gain, up its reduction."""
    arms = []
    if pm := wished.phase_margin_deg:
        arms.append(([centre - pm, centre + pm], [0.0, 0.0]))
    down, up = wished.gain_margin_db or 0.0, wished.gain_reduction_margin_db or 0.0
    if down or up:
        arms.append(([centre, centre], [-down, up]))
    return [tag("path", d=frame.path(np.array(x), np.array(y)), class_="cross") for x, y in arms]


def _contour(frame: Frame, level_db: float, shift: float) -> Guide:
    """|S| constant, labelled where it is closed at its left end, else on its right branch."""
    phase, size = nichols_coordinates(constant_s(level_db, _POINTS))
    k = int(np.argmin(phase)) if level_db > 0.0 else int((0.93 if level_db < 0.0 else 0.985) * size.size)
    line = tag("path", d=frame.path(phase + shift, size), class_="contour")
    return Guide(joined([line, _contour_label(frame, float(phase[k] + shift), float(size[k]), level_db)]))


def _contour_label(frame: Frame, phase: float, size: float, level_db: float) -> Markup:
    x_room, y_room = 0.04 * (frame.x.high - frame.x.low), 0.03 * (frame.y.high - frame.y.low)
    inside = frame.x.low + x_room < phase < frame.x.high - x_room
    if not (inside and frame.y.low + y_room < size < frame.y.high - y_room):
        return Markup("")
    at = float(frame.x(np.array([phase]))[0]), float(frame.y(np.array([size]))[0])
    return tag("text", f"{number(level_db)} dB", x=f"{at[0]:.1f}", y=f"{at[1] + 3:.1f}", class_="contour-text middle")


def shown_sizes(limits: Sequence[tuple[float, float | None]]) -> list[np.ndarray]:
    """Values that an axis must span to show its limits."""
    return [np.array([limit_db, limit_db + 3.0]) for limit_db, _ in limits]
