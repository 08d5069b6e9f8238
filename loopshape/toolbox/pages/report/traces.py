"""Curves of the report's plots: an operating point's plant and controller with the 95 % half width, thinned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.response.frf import FRF
from loopshape.loop.loop import Loop
from loopshape.toolbox.pages.markup import packed
from loopshape.toolbox.pages.report.words import point
from loopshape.view.key import key_of
from loopshape.view.plots.curves import NORMAL_95, thinned, unwrapped_deg
from loopshape.view.style import MARKERS

#: lines that one operating point's curves keep, and all of them together
MOST_LINES, MOST_TOGETHER = 600, 5400
DASHES = ("", "7 3", "2 2.5", "9 3 2 3", "4 2", "12 4", "6 2 2 2 2 2", "1 4", "14 3 3 3", "3 6")


@dataclass(frozen=True, eq=False)
class Trace:
    """One operating point's curves on `frequency_hz` (nf,), a choice out of `lines` measured ones.

    `plant` and `controller` (nf,) are complex, the latter empty where there is none: their product is the open loop,
    and the page makes the other responses of both. `phase_deg` goes on over all measured lines. `half_width` is the
    relative 95 % half width of |P|, |S| and |T|. `dots` are lines of P as they were measured: frequency, dB, degrees.
    """

    name: str
    label: str
    colour: str
    dash: str
    frequency_hz: Array
    plant: ComplexArray
    controller: ComplexArray
    phase_deg: Mapping[str, Array]
    half_width: Mapping[str, Array]
    lines: int
    dots: tuple[Array, Array, Array]


def plant_traces(frfs: Sequence[FRF]) -> list[Trace]:
    """Curves of plants alone, in their valid bands (everywhere where that is empty)."""
    shown = [frf.select(frf.valid) if frf.valid.any() else frf for frf in frfs]
    none = np.zeros(0, dtype=complex)
    return [
        _trace(look, {"P": one.siso}, none, one, frf, len(frfs))
        for look, one, frf in zip(_looks(frfs), shown, frfs, strict=True)
    ]


def loop_traces(loops: Sequence[Loop], frfs: Sequence[FRF]) -> list[Trace]:
    """Curves of loops on the lines that a check looks at; `frfs` are the same plants with all their lines."""
    responses = [{"P": x.plant.siso, "L": x.L, "S": x.S, "T": x.T, "CS": x.CS, "PS": x.PS} for x in loops]
    return [
        _trace(look, found, loop.C, loop.plant, frf, len(loops))
        for look, found, loop, frf in zip(_looks(frfs), responses, loops, frfs, strict=True)
    ]


class _Look(NamedTuple):
    colour: str
    dash: str
    name: str
    label: str


def _looks(frfs: Sequence[FRF]) -> list[_Look]:
    """Colour and dashes as the figures have colour and marker."""
    looks = []
    for k, (frf, look) in enumerate(zip(frfs, key_of(frfs).looks, strict=True)):
        dash = DASHES[MARKERS.index(look["marker"])] if "marker" in look else ""
        looks.append(
            _Look(str(look["color"]), dash, frf.recording or f"frf {k + 1}", point(frf.operating_point, frf.parameters))
        )
    return looks


def _trace(
    look: _Look, responses: Mapping[str, ComplexArray], controller: ComplexArray, lines: FRF, frf: FRF, together: int
) -> Trace:
    if lines.response.shape[1:] != (1, 1):
        raise WrongUseError("a plot over frequency shows one input and one output", f"{lines.response.shape[1:]}")
    f, sizes = lines.frequency_hz, [db(x) for x in responses.values()]
    phases = {name: unwrapped_deg(responses[name]) for name in ("P", "L") if name in responses}
    keep = thinned(f, [*sizes, *phases.values()], min(MOST_LINES, MOST_TOGETHER // together))
    return Trace(
        name=look.name,
        label=look.label,
        colour=look.colour,
        dash=look.dash,
        frequency_hz=f[keep],
        plant=responses["P"][keep],
        controller=controller[keep] if controller.size else controller,
        phase_deg={name: x[keep] for name, x in phases.items()},
        half_width={name: x[keep] for name, x in relative_half_width(lines, responses).items()},
        lines=int(f.size),
        dots=_dots(frf, lines, everything="L" in responses),
    )


def relative_half_width(lines: FRF, responses: Mapping[str, ComplexArray]) -> dict[str, Array]:
    """95 % half width (nf,) of |P|, |S| and |T| beside their sizes, to first order.

    With a circular error of P the real part alone has half its variance. dL/L = dP/P, dS/S = -T dP/P, dT/T = S dP/P;
    CS and PS follow as S and T do. It misleads where it comes near to 1.
    """
    own = NORMAL_95 * lines.modulus_std[:, 0, 0]
    found = {"P": own}
    if "S" in responses:
        found |= {"S": np.abs(responses["T"]) * own, "T": np.abs(responses["S"]) * own}
    return found


def _dots(frf: FRF, lines: FRF, *, everything: bool) -> tuple[Array, Array, Array]:
    """Frequency, dB and degrees of P as measured: every line, or those that the curve leaves out."""
    drawn = np.isin(frf.frequency_hz, lines.frequency_hz)
    phase = unwrapped_deg(frf.siso, drawn)
    shown = np.ones(drawn.size, dtype=bool) if everything else ~drawn
    f, size, phase = frf.frequency_hz[shown], db(frf.siso)[shown], phase[shown]
    keep = thinned(f, [size, phase], MOST_LINES)
    return f[keep], size[keep], phase[keep]


def embedded(traces: Sequence[Trace]) -> list[dict[str, Any]]:
    """The curves for the page's script."""
    return [
        {
            "name": trace.name,
            "label": trace.label,
            "f": packed(trace.frequency_hz),
            "P": packed(trace.plant),
            "C": packed(trace.controller),
            "phase": {name: packed(x) for name, x in trace.phase_deg.items()},
            "half_width": {name: packed(x) for name, x in trace.half_width.items()},
            "dots": {name: packed(x) for name, x in zip(("f", "size", "phase"), trace.dots, strict=True)},
        }
        for trace in traces
    ]
