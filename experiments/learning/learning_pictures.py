"""Figures: how the learners learn, one trial beside the feedback's, the arm at its setpoint, a moving setpoint."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from learning_tables import Results
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from nine_actions import Trace, pairs
from rivals import Rival, follow, sine
from trial_outcomes import RATE_HZ, at_setpoint

from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.source import value
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, png, styled

FIGURES = Path(__file__).parents[2] / "figures" / "learning"
WORDS = {
    "unchanged": "nothing", "no_bonus": "no bonus inside", "never_shut": "valves never all shut",
    "one_state": "one state seen", "slower_actions": "actions of 0.1 s",
}  # fmt: skip


def draw_all(results: Results, rivals: Mapping[str, Rival], variants: Mapping[str, Rival]) -> None:
    """All figures."""
    figures = {
        "learning_curve": learning_curve(results),
        "trial": one_trial(results, rivals),
        "at_setpoint": resting(results, rivals, variants),
        "tracking": moving_setpoint(results, rivals),
    }
    for name, figure in figures.items():
        write_bytes_whole(FIGURES / f"{name}.png", png(figure))


@styled()
def learning_curve(r: Results) -> Figure:
    """Share of the watched setpoints reached, and of trials that still move at their end, over trials."""
    figure = new_figure(1, 3, (7.0, 3.7), sharex=True, sharey=True)
    share = 100.0 / r.settings["learner"]["curve_trials"]
    for k, (seed, curve) in enumerate(r.curves.items()):
        n, _, reached, moving, _ = np.array(curve).T
        for ax, count in zip(figure.axes, (reached, moving), strict=False):
            ax.plot(n, share * count, color=COLOURS[k], marker=".", label=f"seed {seed}")
    for k, (name, curves) in enumerate(r.variant_curves.items()):
        for j, curve in enumerate(curves.values()):
            n, _, reached, *_ = np.array(curve).T
            style = {"color": COLOURS[(6, 3, 4, 5, 2)[k]], "linestyle": ("-", "--")[j % 2]}
            figure.axes[2].plot(n, share * reached, label=WORDS[name] if j == 0 else None, **style)
    for ax, title in zip(
        figure.axes, ("reached", "still moving at the end", "reached, one thing changed"), strict=True
    ):
        ax.set_title(title)
        ax.set_xlabel("trials")
        ax.set_ylim(-3.0, 103.0)
    for ax in figure.axes[::2]:
        ax.axhline(value("learning.reached"), color=LIMIT, linewidth=0.9, linestyle=":", label="the source's learner")
    figure.axes[0].legend(loc="lower right", fontsize=7.0)
    handles, labels = figure.axes[2].get_legend_handles_labels()
    figure.legend(handles[:-1], labels[:-1], loc="outside lower right", ncols=5, fontsize=7.0, title="changed (right)")
    figure.axes[0].set_ylabel("share of the watched trials [%]")
    rules = r.rules
    detail = (
        f"{r.settings['learner']['curve_trials']} fixed trials, no exploration; reached: within "
        f"{rules.tolerance_deg:g} deg "
        f"for {rules.held_s:g} s inside {rules.limit_s:g} s; moving: more than {rules.moves_deg:g} deg peak to peak "
        "in the last seconds; right: shorter training"
    )
    head(figure, "The learner over its trials, section 5.4", detail)
    return figure


@styled()
def one_trial(r: Results, rivals: Mapping[str, Rival]) -> Figure:
    """One trial of the learner beside the feedback controller's: angle and pressures."""
    shown = r.settings["shown"]
    figure = new_figure(2, 2, (7.0, 4.4), sharex=True, sharey="row")
    for k, name in enumerate(("learner 1", "feedback")):
        trace = rivals[name]([(shown["start_deg"], shown["setpoint_deg"])], r.rules.limit_s, {}, None)[0]
        top, low = figure.axes[k], figure.axes[2 + k]
        angle(top, trace, r.rules.tolerance_deg)
        t = np.arange(trace.theta2_deg.size) / RATE_HZ
        for column, label in enumerate(("A", "B")):
            low.plot(t, trace.pressures_bar[:, column], color=COLOURS[1 + column], label=f"muscle {label}")
        top.set_title(f"{name.split()[0]}: {int(trace.edges.sum())} openings and closings of valves")
        low.set_xlabel("time [s]")
    figure.axes[0].set_ylabel(r"$\theta_2$ [deg]")
    figure.axes[2].set_ylabel("pressure [bar]")
    figure.axes[1].legend(loc="lower right")
    figure.axes[3].legend(loc="center right")
    head(figure, "One trial: nine actions with the valves open or shut, and the feedback controller through its PWM")
    return figure


def angle(ax: Axes, trace: Trace, tolerance_deg: float) -> None:
    """Angle and setpoint with its tolerance."""
    t = np.arange(trace.theta2_deg.size) / RATE_HZ
    ax.fill_between(t, trace.setpoint_deg - tolerance_deg, trace.setpoint_deg + tolerance_deg, color="0.88")
    ax.plot(t, trace.setpoint_deg, color=QUIET, linestyle="--", linewidth=0.8, label="setpoint, tolerance")
    ax.plot(t, trace.theta2_deg, color=COLOURS[0], label="measured")


@styled()
def resting(r: Results, rivals: Mapping[str, Rival], variants: Mapping[str, Rival]) -> Figure:
    """The last seconds at the setpoint: of each, the trial at the 90 % point of how far the arm moves."""
    kept = r.settings["learner"]["network"]["kept_trials"]
    named = {"feedback": rivals["feedback"], "learner": rivals["learner 1"]}
    named |= {f"learner after {kept} trials": rivals["early"]}
    named |= {f"learner, {WORDS[name]}": variants[name] for name in ("no_bonus", "never_shut", "one_state")}
    figure = new_figure(2, 3, (7.0, 4.4), sharex=True, sharey=True)
    trials = pairs(r.rules, r.settings["final"]["trials"], r.settings["final"]["seed"])
    n = round(r.rules.look_s * RATE_HZ)
    for ax, (name, rival) in zip(figure.axes, named.items(), strict=True):
        traces = [t for t in rival(trials, r.rules.limit_s + r.rules.stay_s, {}, None) if not t.left_range]
        most = sorted(traces, key=lambda t: at_setpoint(t, r.rules).span_deg)[round(0.9 * (len(traces) - 1))]
        end = at_setpoint(most, r.rules)
        error = (most.theta2_deg - most.setpoint_deg)[-n:]
        ax.plot(np.arange(n) / RATE_HZ, error, color=COLOURS[0], linewidth=0.8)
        ax.axhspan(-r.rules.tolerance_deg, r.rules.tolerance_deg, color="0.9", zorder=0)
        words = f"span {end.span_deg:.2f} deg"
        words += f", {end.frequency_hz:.1f} Hz" if np.isfinite(end.frequency_hz) else ""
        ax.set_title(f"{name}\n{words}, {end.edges_hz:.0f} edges/s", fontsize=8.0)
    for ax in figure.axes[3:]:
        ax.set_xlabel("time [s]")
    for ax in figure.axes[::3]:
        ax.set_ylabel("error [deg]")
    head(
        figure, f"At the setpoint, the last {r.rules.look_s:g} s of a trial",
        "of each the trial at the 90 % point of the span over those that stay in range, of the changed learners "
        "the seed that "
        "moves more; grey: tolerance; edges: openings and closings of valves",
    )  # fmt: skip
    return figure


@styled()
def moving_setpoint(r: Results, rivals: Mapping[str, Rival]) -> Figure:
    """A sine as setpoint: angle and error."""
    settings = r.settings["track"]
    hz = settings["shown_hz"]
    figure = new_figure(2, 2, (7.0, 4.4), sharex=True, sharey="row")
    for k, name in enumerate(("learner 1", "feedback")):
        trace = follow(rivals[name], settings, hz)
        t = np.arange(trace.theta2_deg.size) / RATE_HZ
        top, low = figure.axes[k], figure.axes[2 + k]
        top.plot(t, [sine(settings, hz)(s) for s in t], color=QUIET, linestyle="--", linewidth=0.8, label="setpoint")
        top.plot(t, trace.theta2_deg, color=COLOURS[0], label="measured")
        low.plot(t, trace.theta2_deg - trace.setpoint_deg, color=COLOURS[0], linewidth=0.8)
        top.set_title(f"{name.split()[0]}: rms {r.tracking[name, hz][0]:.1f} deg")
        low.set_xlabel("time [s]")
    figure.axes[0].set_ylabel(r"$\theta_2$ [deg]")
    figure.axes[2].set_ylabel("error [deg]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    head(figure, f"A moving setpoint, {settings['amplitude_deg']:g} deg at {hz:g} Hz")
    return figure
