"""The page of effects: a row an effect, what it does to FRFs, statics and steps, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, deg
from loopshape.toolbox.gap.nouns.effect_sheet import EffectSheet, TimeChange
from loopshape.view.labels import number
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, QUIET, head, new_figure, styled

#: excitations drawn, with their looks
LOOKS = {
    "large": {"color": COLOURS[0], "linewidth": 1.2, "linestyle": "-"},
    "small": {"color": COLOURS[1], "linewidth": 0.8, "linestyle": (0, (3, 1.2))},
}
PATHS = ("u -> theta2", "u -> p")
TITLES = (
    r"$u\rightarrow\theta_2$, gain", r"$u\rightarrow\theta_2$, phase", r"$u\rightarrow p_A{-}p_B$, gain",
    r"$u\rightarrow p_A{-}p_B$, phase", r"statics, $p_A{-}p_B$", r"step, $\theta_2$",
)  # fmt: skip
UNITS = ("dB over Hz", "deg over Hz", "dB over Hz", "deg over Hz", "mbar over deg", "deg over s")
STEP_S = 1.0  # when the setpoint jumps


def draw_effects(path: Path, words: Sequence[str]) -> list[Path]:
    """Pages of what effects do, at most six a page; gives the files. Refuses another ending than .png."""
    from loopshape.toolbox.arm.arm1 import Arm1
    from loopshape.toolbox.arm.effect.effect_study import effect_study, paths, signals
    from loopshape.toolbox.rig.effect_sheets import sheets
    from loopshape.toolbox.rig.effects import asked
    from loopshape.verbs.pictures import save

    arm = Arm1()
    if path.suffix != ".png":
        raise WrongUseError("a page of effects is a .png file", str(path), f"write {path.with_suffix('.png')}")
    every = words or list(dict.fromkeys(form.effect for form in arm.effects))
    found = list(sheets(arm, effect_study(), asked(arm, every), signals, paths))
    pages = -(-len(found) // 6)
    each = -(-len(found) // pages)
    files = [path.with_stem(f"{path.stem}_{k + 1}") for k in range(pages)] if pages > 1 else [path]
    return [
        save(effects_page(found[k * each : (k + 1) * each], title=_title(k, pages)), file)
        for k, file in enumerate(files)
    ]


def _title(k: int, pages: int) -> str:
    title = "What each effect does to the 1-DoF arm"
    return f"{title} ({k + 1} of {pages})" if pages > 1 else title


@styled()
def effects_page(sheets: Sequence[EffectSheet], *, title: str = "What each effect does") -> Figure:
    """One row a sheet: what changes with the effect in u -> theta2 and u -> p_A - p_B, statics, and a step of 10 deg.

    Solid blue is the large excitation, dashed orange the small one. Statics: by how much p_A - p_B differs while the
    setpoint moves slowly, up, down and up; the step: by how much theta2 differs after it. Scales differ from row to
    row, and none is narrower than +-2 dB, +-12 deg, +-5 mbar, +-0.5 deg. Refuses an empty list.
    """
    if not sheets:
        raise WrongUseError("a page of effects needs a sheet", "none", "name an effect")
    rows = len(sheets)
    row_in = 1.05
    figure = new_figure(rows, 6, (FULL_WIDTH_IN, 1.3 + row_in * rows))
    for k, sheet in enumerate(sheets):
        row = figure.axes[6 * k : 6 * k + 6]
        _frfs(row, sheet)
        _statics(row[4], sheet)
        _step(row[5], sheet)
        _finish(row, sheet, last=k == rows - 1)
    for ax, name, unit in zip(figure.axes[:6], TITLES, UNITS, strict=True):
        ax.annotate(
            f"{name}\n[{unit}]", (0.5, 1.0), (0.0, 17.0), xycoords="axes fraction", textcoords="offset points",
            ha="center", va="bottom", fontsize=7.5,
        )  # fmt: skip
    _legend(figure)
    head(figure, title)
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(h_pad=0.085, hspace=0.0)  # room for each row's name
    return figure


def _frfs(row: Sequence[Axes], sheet: EffectSheet) -> None:
    smallest_db, smallest_deg = 2.0, 12.0  # half heights below which a panel is not magnified further
    most_db, most_deg = 12.0, 90.0  # ... and above which it is cut
    for k, path in enumerate(PATHS):
        _frf(row[2 * k], sheet, path, "gain_db", smallest_db, most_db)
        _frf(row[2 * k + 1], sheet, path, "phase_deg", smallest_deg, most_deg)


def _frf(ax: Axes, sheet: EffectSheet, path: str, name: str, least: float, most: float) -> None:
    values = []
    for recording, look in LOOKS.items():
        change = sheet.frfs.get((recording, path))
        if change is not None and change.frequency_hz.size:
            values.append(getattr(change, name))
            ax.semilogx(change.frequency_hz, values[-1], gid=recording, **look)
    half = _half(values, least, most)
    ax.set_ylim(-half, half)
    ax.set_xscale("log")
    ax.set_xlim(0.14, 16.0)
    ax.set_xticks([0.2, 1.0, 10.0], ["0.2", "1", "10"])
    ax.minorticks_off()


def _half(values: Sequence[Array], least: float, most: float) -> float:
    """Half the height of a panel: what nearly all values need, on steps of 1, 1.5, 2, 3, 4.5, ... times `least`."""
    need = max((float(np.percentile(np.abs(v), 97.0)) for v in values), default=0.0) * 1.1
    steps = least * np.array([1.0, 1.5, 2.0, 3.0, 4.5, 6.0, 7.5])
    fitting = steps[(steps >= need) & (steps <= most + 1e-9)]
    return float(fitting[0]) if fitting.size else most


def _statics(ax: Axes, sheet: EffectSheet) -> None:
    pressure, angle = sheet.times["statics", "p_d"], sheet.times["statics", "theta2"]
    n = min(pressure.x.size, angle.x.size)
    change = 1e3 * _smooth(pressure.changed[:n] - pressure.without[:n])
    ax.plot(deg(_smooth(angle.without[:n])), change, color=COLOURS[0], linewidth=0.8, gid="statics")
    half = max(5.0, 1.15 * float(np.percentile(np.abs(change), 99.0)))
    ax.set_ylim(-half, half)
    ax.set_xlim(-26.0, 26.0)
    ax.set_xticks([-20.0, 0.0, 20.0])


def _smooth(values: Array, length: int = 25) -> Array:
    """Moving mean of the same length; its ends are those of the values."""
    padded = np.pad(values, (length // 2, length - 1 - length // 2), mode="edge")
    return np.convolve(padded, np.full(length, 1.0 / length), mode="valid")


def _step(ax: Axes, sheet: EffectSheet) -> None:
    change: TimeChange = sheet.times["steps", "theta2"]
    rows = (change.x > STEP_S - 0.2) & (change.x < STEP_S + 3.6)
    values = np.asarray(deg(change.changed[rows] - change.without[rows]))
    ax.plot(change.x[rows] - STEP_S, values, color=COLOURS[0], linewidth=0.9, gid="step")
    half = max(0.5, 1.1 * float(np.abs(values).max(initial=0.0)))
    ax.set_ylim(-half, half)
    ax.set_xlim(-0.2, 3.6)
    ax.set_xticks([0.0, 1.0, 2.0, 3.0])


def _finish(row: Sequence[Axes], sheet: EffectSheet, *, last: bool) -> None:
    """Small ticks, no numbers under any but the last row, and the row's name above its first panel."""
    for ax in row:
        ax.tick_params(labelsize=7.0, pad=1.5, labelbottom=last, length=2.0)
        ax.locator_params(axis="y", nbins=4)
    form = sheet.form
    size = f"{form.quantity} {number(sheet.magnitude)} {'' if form.quantity else form.unit}".strip()
    words = f"{form.effect.replace('_', ' ')}, {size}"
    text = row[0].annotate(
        words, (0.0, 1.0), (-10.0, 2.0), xycoords="axes fraction", textcoords="offset points", fontsize=7.5,
        fontweight="bold", va="bottom", gid="effect",
    )  # fmt: skip
    text.set_in_layout(False)
    more = row[2].annotate(
        f"{form.block}: {form.form}", (0.0, 1.0), (0.0, 2.0), xycoords="axes fraction", textcoords="offset points",
        fontsize=7.0, color=QUIET, va="bottom",
    )  # fmt: skip
    more.set_in_layout(False)


def _legend(figure: Figure) -> None:
    words = {"large": "with less without; FRFs at large excitation", "small": "FRFs at small excitation"}
    handles = [Line2D([], [], label=words[name], **look) for name, look in LOOKS.items()]  # type: ignore[arg-type]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
