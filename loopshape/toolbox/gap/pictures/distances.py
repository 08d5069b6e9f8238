"""How far a gap shrinks: before and after for each path, relative to noise and manufacturing tolerance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from loopshape.toolbox.gap.nouns.gap_report import GapReport, Submodel
from loopshape.view.labels import symbol
from loopshape.view.style import COLOURS, axes_or_new, styled

NOMINAL, HEALED, RIVAL = COLOURS[1], COLOURS[0], COLOURS[2]
LOOKS: Mapping[str, dict[str, Any]] = {
    "before": {"marker": "o", "color": NOMINAL, "markersize": 6.0, "markerfacecolor": "white", "linestyle": "none"},
    "after": {"marker": "o", "color": HEALED, "markersize": 6.0, "linestyle": "none"},
    "rival": {"marker": "D", "color": RIVAL, "markersize": 4.5, "markerfacecolor": "white", "linestyle": "none"},
}
TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 1e4)


def named(effect: str) -> str:
    """An effect, a pair, `none` or `unknown` in words."""
    words = {"none": "none: no gap", "unknown": "unknown: no known effect"}
    return words.get(effect, effect.replace("+", " + ").replace("_", " "))


def compared(report: GapReport) -> list[Submodel]:
    """Rows of the recordings that tell how far: those held out, or all where none is."""
    held = [s for s in report.submodels if s.role == "validation"]
    return held or list(report.submodels)


def rms(values: Iterable[float | None]) -> float | None:
    """Root of the mean square; None where a value is missing."""
    known = list(values)
    if not known or any(v is None for v in known):
        return None
    return float(np.sqrt(np.mean(np.square(np.array(known, dtype=float)))))


@styled()
def distances(report: GapReport, *, ax: Axes | None = None) -> Axes:
    """For each path the rms relative to its noise floor: nominal, with the effect (arrow), with the rival.

    Large marks are the rms over recordings, small ones each recording.
    """
    ax = axes_or_new(ax)
    rows = compared(report)
    groups = {"all paths": rows} | {
        path: [s for s in rows if s.path == path] for path in dict.fromkeys(s.path for s in rows)
    }
    ax.axvline(
        1.0,
        color="0.25",
        linewidth=1.0,
        linestyle=(0, (4, 2)),
        gid="floor",
        label="noise floor, manufacturing tolerance",
    )
    for k, mine in enumerate(groups.values()):
        _dumbbell(ax, float(k), mine, small=k > 0, named=report if k == 0 else None)
    _distance_axes(ax, list(groups), rows)
    return ax


_ARROW: dict[str, Any] = {"arrowstyle": "-|>", "color": "0.35", "linewidth": 1.0, "mutation_scale": 8.0}
_SHRINK = {"shrinkA": 3.0, "shrinkB": 4.0}  # points, so that the arrow ends at the marks' edges


def _dumbbell(ax: Axes, y: float, rows: Sequence[Submodel], *, small: bool, named: GapReport | None) -> None:
    """Marks of one path, an arrow from nominal to the effect; `named` where the marks go into the key."""
    words = labels(named) if named else {}
    before, after, rival = (rms(getattr(s, key) for s in rows) for key in ("before", "after", "rival"))
    if before is not None and after is not None:
        ax.annotate("", (after, y), (before, y), arrowprops=_ARROW | _SHRINK, zorder=2.0)
    for key, value, at in (("before", before, y), ("after", after, y), ("rival", rival, y + 0.28)):
        if value is None:
            continue
        look = LOOKS[key] | {"label": words.get(key, "_"), "gid": key, "zorder": 3.0, "markeredgewidth": 1.3}
        ax.plot([value], [at], **look)
        if small and key != "rival" and len(rows) > 1:
            each, colour = [getattr(s, key) for s in rows], LOOKS[key]["color"]
            ax.plot(each, np.full(len(rows), at), "|", color=colour, markersize=5.0, gid=f"{key} each", zorder=2.5)
    if named is not None and len(rows) > len({s.path for s in rows}):
        ax.plot([], [], "|", color="0.35", markersize=6.0, label="each recording")


def labels(report: GapReport) -> dict[str, str]:
    """What the marks and lines are called."""
    fitted = [r.effect for r in report.ranking if r.magnitude is not None or r.parts]
    known = report.verdict not in ("none", "unknown")
    effect = report.verdict if known else next(iter(fitted), "")
    rival = report.gap.rival if report.gap is not None else None
    rival = rival or next((name for name in fitted if name != effect), "the rival")
    nearest = "" if known else "the nearest, "
    return {"before": "nominal model", "after": f"with {nearest}{named(effect)}", "rival": f"with {named(rival)}"}


def _distance_axes(ax: Axes, names: Sequence[str], rows: Sequence[Submodel]) -> None:
    seen = [v for s in rows for v in (s.before, s.after, s.rival) if v is not None and v > 0.0]
    ax.set_xscale("log")
    ax.set_xlim(0.75 * min(0.5, *seen, 0.8), 1.4 * max(3.0, *seen, 1.0))
    low, high = ax.get_xlim()
    ticks = [t for t in TICKS if low < t < high]
    ax.set_xticks(ticks if len(ticks) < 8 else [t for t in ticks if np.log10(t) % 1.0 == 0.0])
    ax.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    ax.minorticks_off()
    ax.set_ylim(len(names) - 0.4, -0.6)
    ends = [name.removeprefix("inputs -> ").split(" -> ") for name in names]  # all inputs act on every output
    ax.set_yticks(range(len(names)), [" → ".join(symbol(end) for end in pair) for pair in ends])
    ax.get_yticklabels()[0].set_fontweight("bold")
    ax.tick_params(axis="y", length=0.0)
    ax.axhline(0.5, color="0.6", linewidth=0.6)
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("measured − simulated,\nrms relative to the noise floor")
