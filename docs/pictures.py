"""Draws the pictures of README and docs anew, and notes what they show in figures/shown.json: `make pictures`.

A test computes these numbers anew and compares: where it is red the pictures are older than the code.
"""

import json
import os
import re
import runpy
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments" / "lab"))

from text_layout import look_at_each_png

import loopshape as ls
from loopshape.toolbox.gap.nouns.gap_report import BudgetPart, GapReport
from loopshape.toolbox.gap.pictures.report import gap_figure, missing, sizes
from loopshape.toolbox.learning.picture import feedforward_page
from loopshape.toolbox.learning.verbs import setpoint_of
from loopshape.toolbox.planning.tone.pictures import tones_page
from loopshape.toolbox.planning.tone.tones import Excitation, Period, tones_of, without_periods
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, png, styled

DOCS = Path(__file__).parent
FIGURES, BENCH = DOCS.parent / "figures", DOCS.parent / "examples" / "motor_bench"


def shown() -> dict[str, dict[str, list[float]]]:
    """By folder and requirement the worst case and the ends of its 95 % interval, computed anew.

    Those of the shipped controller: the pictures of the report show where the tour's `tune` ends, which is another one.
    """
    P = ls.frf(ls.formats.read_table(BENCH / "multisine_type_a.parquet", BENCH / "map.toml"))
    model = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
    (own,) = ls.read_controllers(BENCH / "controller.toml")
    (R,) = ls.read_requirements(BENCH / "requirements.toml")
    verdicts = {
        "readme": ls.check(P, own, R, fits=[model]),
        "shape": ls.check(*runpy.run_path(str(DOCS / "shape_pictures.py"))["walk"]()),
    }
    return {
        name: {
            row["requirement"]: [float(row[k]) for k in ("worst case", "low", "high")]
            for _, row in verdict.table().iterrows()
        }
        for name, verdict in verdicts.items()
    }


def diagnosed() -> GapReport:
    """The diagnosis of the page of gaps and of the demo: an arm with an effect that the model leaves out."""
    with TemporaryDirectory() as here:
        run = ls.rig.measure(DOCS.parent / "examples" / "arm" / "gap.toml", Path(here) / "gap")
        return ls.gap(run, table=False, name="gap")


def diagnosed_swing() -> GapReport:
    """The diagnosis of the README and of the page of machines: a real double pendulum, modelled without friction."""
    here = DOCS.parent / "examples" / "double_pendulum"
    return ls.gap(here, model=here / "model.toml")


def shown_of(report: GapReport) -> dict[str, list[float]]:
    """What the picture of a diagnosis shows of its first hypothesis, and how far the gap shrinks."""
    first, gap = report.ranking[0], report.gap
    assert gap is not None
    assert first.magnitude is not None
    assert first.interval is not None
    return {
        first.effect: [first.magnitude, *first.interval],
        "held-out gap": [gap.before, gap.after],
        "probability": [first.probability],
        "budget": [step.gap for step in report.budget],
    }


def drawn() -> dict[str, Figure]:
    """By their paths under figures/ the pictures that need neither a browser nor minutes."""
    here = Path.cwd()
    os.chdir(DOCS / "gallery")  # examples read their data two folders above themselves
    bench = runpy.run_path("1_bench.py")["figure"]
    os.chdir(here)
    return {
        "readme/bench": bench,
        "readme/tones": _tones(),
        "readme/feedforward": _feedforward(),
        "readme/adopt": adopt_figure(),
        **_diagrams(),
        **runpy.run_path(str(DOCS / "definitions.py"))["pictures"](),
    }


def shown_in(figure: Figure) -> dict[str, list[float]]:
    """What stands in a picture: the rms of each line's x and y; of axes without scales their words, without a number."""
    found: dict[str, list[float]] = {}
    for k, ax in enumerate(figure.axes):
        for n, line in enumerate(ax.lines):
            xy = np.ma.masked_invalid(np.asarray(line.get_xydata(), dtype=float))
            found[f"axes {k}, line {n}"] = [float(x) for x in np.sqrt((xy**2).mean(axis=0))]
        if not ax.axison and ax.texts:
            found[" ".join(text.get_text() for text in ax.texts).strip()] = []
    return found


def draw_in_browser() -> None:
    """The pages of shape and report, in the system's Chromium."""
    for script in (
        DOCS / "shape_pictures.py",
        DOCS.parent / "experiments" / "report" / "run.py",
    ):
        runpy.run_path(str(script), run_name="__main__")


def _tones() -> Figure:
    """A machine that begins to oscillate at 58.8 Hz under a multisine: what the page of disturbances shows."""
    rng, t = np.random.default_rng(7), np.arange(8192) / 1000.0
    lines = np.arange(1, 200, 2)
    phases = np.outer(np.arange(1024), lines) * (2 * np.pi / 1024) + rng.uniform(
        0.0, 2 * np.pi, lines.size
    )
    y = 0.01 * rng.standard_normal(t.size) + lfilter(
        [0.0, 0.05], [1.0, -0.95], np.tile(np.cos(phases).sum(axis=1), 8)
    )
    y += 0.05 * np.exp(0.5 * (t - 4.0)) * np.sin(2 * np.pi * 58.8 * t)
    period = Period(1024)
    found = tones_of(
        y,
        1000.0,
        excitation=Excitation(period=period),
        recording="multisine",
        channel="y",
        unit="rad",
    )
    return tones_page(found, without_periods(y, period), 1000.0)


def _feedforward() -> Figure:
    """A third-order plant with a resonance at 5 Hz, measured to 1 %, and a third-order move."""
    f_hz, w = np.geomspace(0.1, 100.0, 200), 2 * np.pi * 5.0
    s = 2j * np.pi * f_hz
    P = ls.FRF.from_arrays(
        f_hz,
        1350.0 / (s * (s**2 + 0.13 * w * s + w**2)) * np.exp(-0.005 * s),
        relative_std=0.01,
        rate_hz=1000.0,
        loop="axis",
        inputs=("u_v",),
        outputs=("y_rad",),
    )
    C = ls.controller(ls.gain(0.5), rate_hz=1000.0, loop="axis")
    F = ls.learning.feedforward(P, band_hz=(0.1, 8.0))
    r = setpoint_of(0.35, 0.6, 2.0, 12.0, rate_hz=1000.0, rest_s=4.0)
    return feedforward_page(
        F,
        {
            "without": ls.learning.tracking_error(P, C, r),
            "with feedforward": ls.learning.tracking_error(P, C, r, F),
        },
        P,
    )


@styled()
def adopt_figure() -> Figure:
    """A trial of the study `adopt` whose machine changes under way: the target goes back by itself."""
    path = DOCS.parent / "experiments" / "adopt" / "trace.csv"
    d = np.genfromtxt(path, delimiter=",", names=True)
    figure = Figure(figsize=(FULL_WIDTH_IN, 3.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot(d["time_s"], d["error_rms_um"], color=COLOURS[0], label="error, rms over 0.1 s")
    above.plot(
        d["time_s"],
        d["allowed_rms_um"],
        "--",
        color=COLOURS[1],
        label="allowed over a period of the multisine",
    )
    above.set_yscale("log")
    above.set_ylabel("error [µm]")
    above.legend(loc="upper left", ncols=2)
    above.set_ylim(top=2000.0)
    below.plot(d["time_s"], 100.0 * d["share"], color=COLOURS[0])
    below.set(xlabel="time [s]", ylabel="share [%]", ylim=(-5.0, 105.0))
    return figure


@styled()
def swing_figure(report: GapReport) -> Figure:
    """The force that is missing over speed at the place that explains most, and what is left of the gap with each step."""
    curve = next(c for c in report.missing if c.over == "speed")
    figure = Figure(figsize=(FULL_WIDTH_IN, 2.8))
    left, right = figure.subplots(1, 2, width_ratios=[1.2, 1.0])
    missing(report, curve, ax=left)
    left.set_title(f"force missing at {curve.place}, 95 % interval", loc="left")
    name = _placed(report.leading_name).partition(" at ")[0]
    size = sizes(report.ranking[0]).replace(" (", "\n(")
    left.legend(
        left.lines[1:], ["any force", f"{name} {size}"], loc="upper right", fontsize=7.5
    )
    _budget(report, right)
    right.set_title("what is left of the gap, in noise floors", loc="left")
    return figure


def _placed(effect: str) -> str:
    """An effect in words, a place alone as "at joint2"."""
    kind, _, place = effect.rpartition("@")
    return f"{kind.replace('_', ' ').replace('coulomb', 'Coulomb')} at {place}".strip()


def _budget(report: GapReport, ax: Axes) -> None:
    """A bar a step, its name above and the noise floors that it leaves behind it."""
    named: set[str] = set()
    shown = [
        x
        for k, x in enumerate(report.budget)
        if not k or x.effects != report.budget[k - 1].effects
    ]
    for k, step in enumerate(shown):
        more = named <= set(step.effects)
        new = " and ".join(_placed(e) for e in step.effects if not more or e not in named)
        named |= set(step.effects)
        words = {
            BudgetPart.BEFORE: "the model as it is",
            BudgetPart.BEST_NAME: f"with {new}",
            BudgetPart.BEST_SET: f"{'and' if more else 'with'} {new}",
            BudgetPart.CEILING: f"with any force {new}",
            BudgetPart.FLOOR: "noise floor",
        }[step.step]
        colour = COLOURS[0 if step.step is BudgetPart.CEILING else 1] if step.effects else "0.6"
        ax.barh(k + 0.68, step.gap, 0.4, color=colour)
        ax.text(0.0, k + 0.27, words, va="center", fontsize=8.0)
        ax.text(step.gap + 1.5, k + 0.68, f"{step.gap:.3g}", va="center", fontsize=8.0)
    ax.set_ylim(len(shown), 0.0)
    ax.set_xlim(0.0, 1.12 * max(step.gap for step in report.budget))
    ax.set_axis_off()


def structures() -> dict[str, object]:
    """What the examples of the page of structures leave behind, by name."""
    made: dict[str, object] = {}
    page = (DOCS / "structures.md").read_text()
    exec("\n".join(re.findall(r"```python\n(.*?)```", page, flags=re.S)), made)
    return made


def _diagrams() -> dict[str, Figure]:
    """The diagrams of the page of structures, by their names there."""
    return {
        f"diagrams/{name}": ls.plot(one)
        for name, one in structures().items()
        if isinstance(one, ls.diagrams.Diagram) and name not in ("D", "with_it")
    }


def refuse(found: list[str]) -> None:
    """A picture that cannot be read is not written."""
    raise ValueError("; ".join(found))


if __name__ == "__main__":
    matplotlib.use("Agg")
    look_at_each_png(refuse, note=True)
    draw_in_browser()
    pictures, demo, swing = drawn(), diagnosed(), diagnosed_swing()
    noted = shown() | {name: shown_in(figure) for name, figure in pictures.items()}
    noted |= {"demo": shown_of(demo), "swing": shown_of(swing)}
    for name in ("readme", "diagrams", "definitions", "demo"):
        (FIGURES / name).mkdir(parents=True, exist_ok=True)
    for name, figure in (pictures | {"readme/swing": swing_figure(swing)}).items():
        (FIGURES / f"{name}.png").write_bytes(png(figure))
    (FIGURES / "demo" / "gap.png").write_bytes(png(gap_figure(demo)))
    text = re.sub(
        r"\[[^][{}]*\]", lambda m: json.dumps(json.loads(m[0])), json.dumps(noted, indent=1)
    )
    (FIGURES / "shown.json").write_text(text + "\n")
