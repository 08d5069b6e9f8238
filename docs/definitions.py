"""Draws the pictures of the page of signs and definitions: the loop, and each margin where it is read."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

import loopshape as ls
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, new_figure, styled

ARROW = {"arrowstyle": "-|>", "color": "0.2", "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}


def example() -> ls.Loop:
    """An integrating axis with a lag and a delay under a gain and a lead."""
    f_hz = np.geomspace(0.5, 400.0, 600)
    s = 2j * np.pi * f_hz
    P = ls.FRF.from_arrays(
        f_hz,
        100.0 / (s * (s + 30.0)) * np.exp(-0.004 * s),
        relative_std=0.0,
        rate_hz=2000.0,
        loop="axis",
    )
    C = ls.controller(ls.gain(40.0), ls.lead_lag(4.0, 40.0), rate_hz=2000.0, loop="axis")
    return ls.Loop(P, C)


@styled()
def loop() -> Figure:
    """The loop, drawn once."""
    figure = Figure(figsize=(FULL_WIDTH_IN, 1.9))
    ax = figure.add_subplot()
    ax.set(xlim=(0.0, 14.0), ylim=(-1.9, 1.9), aspect="equal")
    ax.set_axis_off()
    for x in (2.0, 4.0, 8.0):
        ax.add_patch(Circle((x, 0.0), 0.22, facecolor="white", edgecolor="0.2", zorder=3))
    for x, width, name in ((5.6, 1.2, "C"), (10.4, 2.4, "plant P")):
        box = Rectangle(
            (x - width / 2, -0.5), width, 1.0, facecolor="white", edgecolor="0.2", zorder=3
        )
        ax.add_patch(box)
        ax.text(x, 0.0, name, ha="center", va="center", zorder=4)
    for a, b in (
        (0.6, 1.78),
        (2.22, 3.78),
        (4.22, 5.0),
        (6.2, 7.78),
        (8.22, 9.2),
        (11.6, 13.4),
    ):
        ax.annotate("", (b, 0.0), (a, 0.0), arrowprops=ARROW)
    for x in (4.0, 8.0):
        ax.annotate("", (x, 0.22), (x, 1.2), arrowprops=ARROW)
    ax.plot([12.6, 12.6, 2.0], [0.0, -1.4, -1.4], color="0.2", linewidth=0.9)
    ax.annotate("", (2.0, -0.22), (2.0, -1.4), arrowprops=ARROW)
    for x, y, words in (
        (0.35, 0.0, "r"), (3.0, 0.3, "e"), (7.0, 0.3, "z"), (8.7, 0.3, "u"), (13.6, 0.0, "y"), (1.7, -0.55, "\N{MINUS SIGN}"),
        (4.0, 1.5, "n (controller_input)"), (8.0, 1.5, "n (plant_input)"),
    ):  # fmt: skip
        ax.text(
            x,
            y,
            words,
            ha="center",
            va="center",
            style="italic" if len(words) == 1 else "normal",
        )
    return figure


@styled()
def nyquist() -> Figure:
    """Gain, phase and modulus margin where they are read, in Nyquist's diagram."""
    one = example()
    L, m = one.L, one.margins()
    figure = Figure(figsize=(FULL_WIDTH_IN, 3.2))
    ax = figure.add_subplot()
    ax.plot(L.real, L.imag, color=COLOURS[0], label="L (high frequency: 0)")
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400))
    ax.plot(turn.real, turn.imag, color=QUIET, linewidth=0.7, linestyle="--", label="|L| = 1")
    radius = m.modulus_margin
    ax.plot(
        -1.0 + radius * turn.real,
        radius * turn.imag,
        color=LIMIT,
        linewidth=0.9,
        label="modulus margin: radius",
    )
    arc = np.exp(1j * np.radians(180.0 + np.linspace(0.0, m.phase_margin_deg, 60)))
    ax.plot(
        arc.real,
        arc.imag,
        color=COLOURS[2],
        linewidth=3.0,
        label=f"phase margin: {m.phase_margin_deg:.3g} deg",
    )
    gain = 10.0 ** (-m.gain_margin_db / 20.0)
    ax.plot(
        [-1.0, -gain],
        [0.0, 0.0],
        color=COLOURS[1],
        linewidth=3.0,
        label=f"gain margin: {m.gain_margin_db:.3g} dB",
    )
    ax.plot([-1.0], [0.0], "+", color="black", markersize=9.0)
    ax.set(
        xlim=(-1.9, 3.1),
        ylim=(-1.35, 0.95),
        aspect="equal",
        xlabel="real part",
        ylabel="imaginary part",
    )
    ax.legend(loc="center right")
    return figure


@styled()
def bode() -> Figure:
    """Bandwidths and peaks where they are read, over frequency."""
    one = example()
    f, m = one.frequency_hz, one.margins()
    figure = new_figure(1, 2, (FULL_WIDTH_IN, 3.2))
    left, right = figure.axes
    left.semilogx(f, decibels(one.L), label="|L|")
    mark(left, m.bandwidth_hz, 0.0, "bandwidth", (0.97, 0.55))
    left.set(ylim=(-40.0, 40.0), ylabel="[dB]", xlabel="frequency [Hz]", title="open loop")
    right.semilogx(f, decibels(one.S), color=COLOURS[1], label="|S|")
    right.semilogx(f, decibels(one.T), color=COLOURS[2], label="|T|")
    mark(right, f[np.argmax(np.abs(one.S))], m.sensitivity_peak_db, "peak of |S|", (0.97, 0.92))
    mark(right, m.sensitivity_bandwidth_hz, -3.0103, "bandwidth of S", (0.32, 0.92))
    mark(right, m.complementary_bandwidth_hz, -3.0103, "bandwidth of T", (0.6, 0.2))
    right.set(ylim=(-40.0, 15.0), xlabel="frequency [Hz]", title="closed loop")
    for ax in figure.axes:
        ax.axhline(0.0, color="0.3", linewidth=0.7)
        ax.legend(loc="lower left" if ax is left else "center left")
    return figure


@styled()
def intervals() -> Figure:
    """Peaks of |S| of thirty measurements of one loop: at face value, and as the check reads them."""
    exact = example()
    truth_db, f = exact.margins().sensitivity_peak_db, np.arange(0.5, 60.0, 0.5)
    plant = np.interp(f, exact.frequency_hz, exact.P[:, 0, 0])
    rng, own = np.random.default_rng(1), exact.controller
    figure = new_figure(1, 2, (FULL_WIDTH_IN, 2.9))
    left, right = figure.axes
    for k in range(30):
        error = (
            0.05
            * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
            / np.sqrt(2.0)
        )
        P = ls.FRF.from_arrays(
            f, plant * (1.0 + error), relative_std=0.05, rate_hz=2000.0, loop="axis"
        )
        naive = ls.Loop(P, own)
        (m,) = ls.check(P, own).margins.values()
        read = m["sensitivity_peak_db"]
        low, high = read.ends
        right.plot([k, k], [low, high], color=COLOURS[0], linewidth=1.2)
        right.plot(
            [k],
            [read.value],
            "o",
            color=COLOURS[0],
            markersize=3.0,
            label="check, 95 % interval" if k == 0 else None,
        )
        highest = float(decibels(naive.S).max())
        right.plot(
            [k],
            [highest],
            "x",
            color=LIMIT,
            markersize=4.0,
            label="largest line" if k == 0 else None,
        )
        if k == 0:
            left.plot(
                f,
                decibels(naive.S),
                ".",
                color=LIMIT,
                markersize=3.0,
                label="lines of one measurement",
            )
    left.plot(
        exact.frequency_hz, decibels(exact.S), color="black", linewidth=1.0, label="truth"
    )
    left.set(xlim=(10.0, 60.0), ylim=(-10.0, 12.0), xlabel="frequency [Hz]", ylabel="|S| [dB]")
    right.axhline(truth_db, color="black", linewidth=1.0, label="truth")
    right.set(
        xlabel="measurement", ylabel="peak of |S| [dB]", ylim=(truth_db - 1.2, truth_db + 3.2)
    )
    left.legend(loc="lower right")
    right.legend(loc="upper right")
    return figure


@styled()
def detuning() -> Figure:
    """The modulus margin over a shift of the plant's frequencies: a notch that cancels, and one that is wide."""
    f_hz = np.geomspace(2.0, 400.0, 4000)
    s, pole = 2j * np.pi * f_hz, 2.0 * np.pi * 40.0
    P = 100.0 / (s * (s + 30.0)) * pole**2 / (s**2 + 0.01 * pole * s + pole**2)
    shifts, figure = np.linspace(-6.0, 6.0, 121), Figure(figsize=(FULL_WIDTH_IN, 2.6))
    ax, lead = figure.add_subplot(), ls.lead_lag(4.0, 40.0)
    for k, (words, blocks) in enumerate({
        "notch on the resonance, as sharp": [ls.gain(16.0), lead, ls.notch(40.0, 0.005, 0.3)],
        "low-pass and less gain": [ls.gain(5.0), lead, ls.low_pass(18.0, damping=0.6)],
    }.items()):  # fmt: skip
        C, left = ls.controller(*blocks, rate_hz=4000.0, loop="axis"), []
        for shift in shifts:
            moved = ls.FRF.from_arrays(
                f_hz * (1.0 + shift / 100.0), P, relative_std=0.0, rate_hz=4000.0, loop="axis"
            )
            m = ls.Loop(moved, C, integrators=1, unstable_poles=0).margins()
            left.append(m.modulus_margin if m.stable == "stable" else 0.0)
        ax.plot(shifts, left, color=COLOURS[k], label=words)
    ax.axhline(0.5, color=LIMIT, linewidth=1.1, label="required")
    ax.set(
        xlim=(-6.0, 6.0),
        ylim=(0.0, 1.2),
        xlabel="shift of the plant's frequencies [%]",
        ylabel="modulus margin",
    )
    ax.legend(loc="upper right")
    return figure


@styled()
def weights() -> Figure:
    """|S|, |T| and |CS| of a loop under gamma over the size of each weight, which they touch where they bind."""
    f_hz = np.geomspace(0.5, 400.0, 150)
    s = 2j * np.pi * f_hz
    P = ls.FRF.from_arrays(
        f_hz,
        900.0 / (s * (s + 8.0)) * np.exp(-0.002 * s),
        relative_std=0.01,
        rate_hz=2000.0,
        open_loop=True,
    )
    sizes = {
        "S": ls.Weight("S", ((0.5, 35.0), (20.0, -5.0))),
        "T": ls.Weight("T", (ls.gain(0.4), ls.lead_lag(30.0, 3000.0))),
        "CS": ls.Weight("CS", lambda f: 0.02 * np.sqrt(1.0 + (f / 200.0) ** 2)),
    }
    R = ls.Requirements(
        phase_margin_deg=40.0,
        weights=tuple(sizes.values()),
        objective=ls.Objective(bandwidth=0.0, weighted_norm=1.0),
        integrators=1,
    )
    C = ls.tune(P, R, [ls.gain(), ls.lead_lag(), ls.low_pass()], starts=4)
    one = ls.Loop(P, C.controller)
    figure = new_figure(1, 3, (FULL_WIDTH_IN, 2.6))
    for k, (ax, response) in enumerate(zip(figure.axes, (one.S, one.T, one.CS), strict=True)):
        name, size = list(sizes.items())[k]
        ax.semilogx(f_hz, decibels(response), color=COLOURS[k], label=f"|{name}|")
        ax.semilogx(
            f_hz,
            decibels(C.weighted_norm / size.at(f_hz)),
            "--",
            color=LIMIT,
            label=f"$\\gamma$ / |W$_{k + 1}$|",
        )
        ax.set(xlabel="frequency [Hz]", xlim=(0.5, 400.0))
        ax.legend(loc="lower left" if k == 1 else "lower right")
    figure.axes[0].set_ylabel("[dB]")
    return figure


@styled()
def rig() -> Figure:
    """Who does what while a machine is driven: host, target, machine, and what goes between them."""
    figure = Figure(figsize=(FULL_WIDTH_IN, 1.7))
    ax = figure.add_subplot()
    ax.set(xlim=(0.0, 14.0), ylim=(-1.7, 1.7))
    ax.set_axis_off()
    for x, name, words in (
        (1.9, "host", "loopshape: study, limits,\ncolumns as they arrive,\njournal"),
        (7.0, "target", "controllers at their rate,\nlimits, watchdog, vent"),
        (12.1, "machine", "actuators, plant,\nsensors"),
    ):
        ax.add_patch(Rectangle((x - 1.8, -1.4), 3.6, 2.8, facecolor="white", edgecolor="0.2"))
        ax.text(x, 0.95, name, ha="center", va="center", fontweight="bold")
        ax.text(x, -0.25, words, ha="center", va="center", fontsize=7.5)
    for left, right, there, back in (
        (3.7, 5.2, "excitation", "samples"),
        (8.8, 10.3, "commands", "signals"),
    ):
        for y, a, b, words in ((0.45, left, right, there), (-0.45, right, left, back)):
            ax.annotate("", (b, y), (a, y), arrowprops=ARROW)
            ax.text((left + right) / 2, y + 0.25, words, ha="center", va="center", fontsize=7.0)
    return figure


def decibels(values: np.ndarray) -> np.ndarray:
    return np.asarray(20.0 * np.log10(np.abs(values)))


def mark(ax: Axes, x: float, y: float, words: str, at: tuple[float, float]) -> None:
    """A dot where a number is read, and its name."""
    ax.plot([x], [y], "o", color="black", zorder=4.0)
    ax.annotate(
        words,
        (x, y),
        at,
        textcoords="axes fraction",
        ha="right",
        arrowprops={"arrowstyle": "-", "color": QUIET},
    )


def pictures() -> dict[str, Figure]:
    """By their paths under figures/."""
    return {
        "definitions/loop": loop(),
        "definitions/nyquist": nyquist(),
        "definitions/bode": bode(),
        "definitions/intervals": intervals(),
        "definitions/detuning": detuning(),
        "definitions/weights": weights(),
        "definitions/rig": rig(),
    }
