"""Three logs of one rate loop: the margin read off the closed loop, its coherence, and what `check` says."""

from __future__ import annotations

import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy import optimize, signal

import loopshape as ls
from loopshape.core.errors import LoopshapeError
from loopshape.core.units import TWO_PI, Array, ComplexArray, deg
from loopshape.io.files import write_bytes_whole
from loopshape.view.style import COLOURS, head, new_figure, png, styled

HERE = Path(__file__).parent
FIGURE = HERE.parents[1] / "figures" / HERE.name / "margins.png"
S = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
RATE = S["rate_hz"]
C = ls.controller(ls.gain(S["gain"]), ls.pi(S["fi_hz"]), rate_hz=RATE)
ASKED = ls.Requirements(phase_margin_deg=60.0, sensitivity_peak_db=6.0, integrators=1, unstable_poles=0)
#: what moves the setpoint: nothing, the pilot's sticks, a sweep that somebody asked for
LOGS = ("hover", "sticks", "sweep")
PERIOD_S = 20.0


class Log(NamedTuple):
    """Setpoint, command and rate, each (n,); whether the setpoint repeats every `PERIOD_S`."""

    r: Array
    u: Array
    y: Array
    repeats: bool


class Reading(NamedTuple):
    """The margin read off the closed loop, its mean coherence, and the margin that `check` has, with its verdict."""

    read_deg: float
    coherence: float
    ours_deg: float
    low_deg: float
    high_deg: float
    outcome: str


def main() -> None:
    """Draw the logs, read them both ways, write table and figure."""
    rows = [(kind, seed, *reading(log(kind, seed))) for kind in LOGS for seed in range(S["seeds"])]
    lines = [",".join(f"{x:.5g}" if isinstance(x, float) else str(x) for x in row) for row in rows]
    header = "log,seed,read_deg,coherence,ours_deg,low_deg,high_deg,outcome"
    write_bytes_whole(HERE / "readings.csv", "\n".join([header, *lines, ""]).encode())
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    write_bytes_whole(FIGURE, png(drawn(rows)))
    print(f"true phase margin {truth():.2f} deg")
    for line in summary(rows):
        print(line)


def plant(f_hz: Array) -> ComplexArray:
    """The sampled plant (nf,), exactly as `log` runs it."""
    num, den, _ = signal.cont2discrete(([1.0], [S["lag_s"], 1.0, 0.0]), 1.0 / RATE)
    z = np.exp(1j * TWO_PI * f_hz / RATE)
    return np.asarray(np.polyval(num[0], z) / np.polyval(den, z) * z ** -S["dead_ticks"])


def truth() -> float:
    """The loop's own phase margin in degrees, at |L| = 1."""

    def L(f_hz: float) -> complex:
        f = np.array([f_hz])
        return complex(plant(f)[0] * C.response(f)[0])

    at_hz = optimize.brentq(lambda f: abs(L(f)) - 1.0, 0.1, 10.0)
    return 180.0 + float(deg(np.angle(L(at_hz))))


def log(kind: str, seed: int) -> Log:
    """What the firmware would have logged; the plant's state and dead time by hand, the controller by its sections."""
    n, rng = round(S["seconds"] * RATE), np.random.default_rng(seed)
    r = setpoint(kind, n, rng)
    gust = S["gust"] * low_passed(rng.standard_normal(n), 2.0)
    noise = S["noise_rad_s"] * rng.standard_normal(n)
    lag = 1.0 / S["lag_s"]
    states = np.array([[0.0, 1.0], [0.0, -lag]]), np.array([[0.0], [lag]]), np.eye(2), np.zeros((2, 1))
    A, B, *_ = signal.cont2discrete(states, 1.0 / RATE)
    (b0, b1, _, a1, _), late = C.biquads()[1], [0.0] * S["dead_ticks"]
    x, u, y, before = np.zeros(2), np.zeros(n), np.zeros(n), (0.0, 0.0)
    for k in range(n):
        y[k] = x[0] + noise[k]
        e = S["gain"] * (r[k] - y[k])
        u[k] = b0 * e + b1 * before[0] - a1 * before[1]
        before = (e, u[k])
        late.append(u[k] + gust[k])
        x = A @ x + B[:, 0] * late.pop(0)
    return Log(r, u, y, kind == "sweep")


def setpoint(kind: str, n: int, rng: np.random.Generator) -> Array:
    """Nothing; slow sticks, below 0.3 Hz; or lines from 0.05 to 20 Hz of random phase that repeat every 20 s."""
    if kind == "hover":
        return np.zeros(n)
    if kind == "sticks":
        return 0.8 * low_passed(rng.standard_normal(n), 0.3)
    lines = np.unique(np.round(np.geomspace(1, 400, 60)))
    t, phase = np.arange(n) / RATE, rng.uniform(0.0, TWO_PI, lines.size)
    return np.asarray(0.08 * np.sum(np.cos(TWO_PI * lines[:, None] * t / PERIOD_S + phase[:, None]), axis=0))


def low_passed(noise: Array, corner_hz: float) -> Array:
    """Noise behind a low-pass of second order, at an rms of 1."""
    out = signal.sosfilt(signal.butter(2, corner_hz, fs=RATE, output="sos"), noise)
    return np.asarray(out / out.std())


def reading(one: Log) -> Reading:
    """Both ways to read a log."""
    read_deg, coherence = closed_loop_reading(one)
    ours, interval, outcome = checked(one)
    return Reading(read_deg, coherence, ours, *interval, outcome)


def closed_loop_reading(one: Log) -> tuple[float, float]:
    """180 degrees plus the phase of rate over setpoint where its magnitude falls through 1; the mean coherence to 1 Hz.

    Without a setpoint the rate is read over the command, as a tuner without one does.
    """
    x = one.r if one.r.any() else one.u
    how = {"fs": RATE, "nperseg": round(PERIOD_S * RATE)}
    f, S_xy = signal.csd(x, one.y, **how)
    _, S_xx = signal.welch(x, **how)
    _, coherence = signal.coherence(x, one.y, **how)
    T, low = S_xy / S_xx, (f > 0.0) & (f <= 1.0)
    above = np.flatnonzero((np.abs(T[:-1]) >= 1.0) & (np.abs(T[1:]) < 1.0) & (f[:-1] > 0.0))
    read = float("nan") if above.size == 0 else 180.0 - abs(float(deg(np.angle(T[above[0]]))))
    return read, float(np.mean(coherence[low]))


def checked(one: Log) -> tuple[float, tuple[float, float], str]:
    """Phase margin, its 95 % interval and the verdict by the plant's FRF; nan where the log is refused."""
    nothing = float("nan"), (float("nan"), float("nan"))
    try:
        run = ls.Run.from_arrays(
            u=one.u, y=one.y, excitation=one.r, rate_hz=RATE, controller=C, period_s=PERIOD_S if one.repeats else None
        )
        verdict = ls.check(ls.frf(run), C, ASKED)
    except LoopshapeError as error:
        return *nothing, f"refused: {str(error).split(';')[0].replace(',', '')}"
    (margins,) = verdict.margins.values()
    interval = margins.intervals.get("phase_margin_deg", nothing[1])
    return margins.phase_margin_deg, interval, str(verdict.outcome)


def summary(rows: list[tuple]) -> Iterator[str]:
    """A line for each kind of log."""
    for kind in LOGS:
        mine = [Reading(*row[2:]) for row in rows if row[0] == kind]
        read = [m.read_deg for m in mine if np.isfinite(m.read_deg)]
        known = [m for m in mine if known_of(m)]
        held = sum(m.low_deg <= truth() <= m.high_deg for m in known)
        said = f"{min(read):.0f} to {max(read):.0f} deg read ({len(read)} of {len(mine)})" if read else "nothing read"
        ours = f"check {np.median([m.ours_deg for m in known]):.1f} deg, {held} of {len(known)} hold" if known else ""
        counts = ", ".join(f"{count} {what}" for what, count in Counter(m.outcome for m in mine).items())
        yield f"{kind}: {said}, coherence {np.mean([m.coherence for m in mine]):.3f}; {ours}; {counts}"


def known_of(m: Reading) -> bool:
    """Whether `check` has a margin with both ends of its interval."""
    return bool(np.isfinite([m.ours_deg, m.low_deg, m.high_deg]).all())


@styled()
def drawn(rows: list[tuple]) -> Figure:
    """Each log's margin read both ways, against the true one."""
    figure = new_figure(1, 1, (6.4, 3.2))
    ax = figure.axes[0]
    for k, kind in enumerate(LOGS):
        mine = [Reading(*row[2:]) for row in rows if row[0] == kind]
        known = [(x, m) for x, m in zip(k + np.linspace(0.05, 0.3, len(mine)), mine, strict=True) if known_of(m)]
        spread = k + np.linspace(-0.3, -0.05, len(mine))
        ax.plot(spread, [m.read_deg for m in mine], "o", color=COLOURS[1], label="read off the closed loop" * (k == 0))
        ours = np.array([(x, m.ours_deg, m.low_deg, m.high_deg) for x, m in known]).reshape(-1, 4).T
        ax.errorbar(*ours[:2], np.abs(ours[2:] - ours[1]), fmt=".", color=COLOURS[0], label="check, 95 %" * (k == 1))
    ax.axhline(truth(), color="black", linewidth=0.8, label="true")
    ax.set_xticks(range(len(LOGS)), ["hover: no setpoint", "sticks below 0.3 Hz", "sweep to 20 Hz"])
    ax.text(0.0, 130.0, "check refuses:\nthe injected signal is constant", ha="center", color=COLOURS[0])
    ax.set(ylabel="phase margin [deg]", ylim=(0.0, 200.0), xlim=(-0.5, 2.5))
    ax.legend(loc="lower left")
    head(figure, "A closed loop's phase is no phase margin, however coherent the log")
    return figure


if __name__ == "__main__":
    sys.exit(main())
