"""Feedforward for tracking: z from a third-order model of one point, of every angle, and from the inverted arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from loopshape.core.units import Array, angular, deg, rad
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.equilibrium import LOWEST_BAR
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.dynamics.model import derivatives
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, constants
from loopshape.toolbox.rig.excitation.setpoints import Profile

RATE_HZ = 1000.0


@dataclass(frozen=True, eq=False)
class Path:
    """The reference of the angle (n,) in rad and its derivatives up to the third; `limits` in deg/s, deg/s2, deg/s3."""

    limits: tuple[float, float, float]
    derivative: tuple[Array, Array, Array, Array]
    ends_s: float

    def ahead(self, preview_s: float) -> Path:
        """The same, known `preview_s` earlier."""
        k = round(preview_s * RATE_HZ)
        moved = tuple(np.concatenate([x[k:], np.full(k, x[-1])]) for x in self.derivative)
        return replace(self, derivative=moved)


def path(settings: Mapping[str, Any], limits: Sequence[float]) -> Path:
    """The profile under these limits. Derivatives are differences of its samples, centred in time."""
    n = round(settings["duration_s"] * RATE_HZ)
    v, a, j = (float(rad(x)) for x in limits)
    profile = Profile(tuple(settings["times_s"]), tuple(rad(np.array(settings["values_deg"]))), v, a, j)
    steps = [profile.sampled(n, RATE_HZ, 0.0)]
    for _ in range(3):
        steps.append(np.gradient(steps[-1]) * RATE_HZ)
    moving = np.flatnonzero(np.abs(np.diff(steps[0])) > 1e-12)
    return Path((limits[0], limits[1], limits[2]), tuple(steps), float(moving[-1]) / RATE_HZ)  # type: ignore[arg-type]


def third_order(way: Path, kappa: Array | float, f_hz: Array | float, zeta: Array | float) -> Array:
    """z_theta2 (n,) in V from kappa/(s^3 + 2 zeta w s^2 + w^2 s) turned around."""
    w = angular(np.asarray(f_hz))
    return np.asarray((way.derivative[3] + 2.0 * zeta * w * way.derivative[2] + w**2 * way.derivative[1]) / kappa)


def scheduled(way: Path, p_ab_bar: float, changes: Mapping[str, float], *, by_flow: bool) -> Array:
    """The same with parameters linearised at each angle; `by_flow` takes kappa by which valves the sign of z opens."""
    numbers = constants(ARM1_PARAMETERS.vector(changes))
    angles = np.linspace(*(deg(x) for x in (way.derivative[0].min() - 0.02, way.derivative[0].max() + 0.02)), 25)
    table = []
    for angle in angles:
        lin = linearise(numbers, float(angle), p_ab_bar)
        up, down = (lin.fill[0], lin.exhaust[1]), (lin.exhaust[0], lin.fill[1])
        table.append((*lin.third_order(), *(lin.third_order(np.array(g))[0] for g in (up, down))))
    mean, f_hz, zeta, rising, falling = (np.interp(deg(way.derivative[0]), angles, x) for x in np.array(table).T)
    bare = third_order(way, 1.0, f_hz, zeta)
    return bare / (np.where(bare > 0.0, rising, falling) if by_flow else mean)


def inverted(way: Path, p_ab_bar: float, changes: Mapping[str, float], step_s: float) -> Array:
    """z (n, 2) in V that the model itself needs: pressures from the torque, flows from their slopes, duties from flows.

    p_AB stays as it is held; the capacity is taken to be at the supply's pressure and each muscle to fill alone.
    """
    numbers = constants(ARM1_PARAMETERS.vector(changes))
    t = np.arange(way.derivative[0].size) / RATE_HZ
    at = np.arange(0.0, t[-1] + 0.5 * step_s, step_s)
    q, w, a = (np.interp(at, t, x) for x in way.derivative[:3])
    p_a = np.array([held(numbers, *row, p_ab_bar) for row in zip(q, w, a, strict=True)])
    slope = CubicSpline(at, p_a)(at, 1)
    u = np.array([
        (duty(numbers, *row, p_ab_bar, 0), duty(numbers, *row, p_ab_bar, 1))
        for row in zip(q, w, p_a, slope, strict=True)
    ])  # fmt: skip
    u = np.stack([np.interp(t, at, x) for x in u.T], axis=1)
    return np.stack([0.5 * (u[:, 0] - u[:, 1]), 0.5 * (u[:, 0] + u[:, 1])], axis=1)


def held(c: Array, angle: float, velocity: float, wanted: float, p_ab_bar: float) -> float:
    """p_A in bar that gives the wanted acceleration with the sum held, by bisection; the nearest end if none does."""
    low, high = LOWEST_BAR, p_ab_bar - LOWEST_BAR
    for _ in range(30):
        middle = 0.5 * (low + high)
        state = (0.0, 1e5 * middle, 1e5 * (p_ab_bar - middle), angle, velocity)
        given = derivatives(c, state, (False,) * 4)[3]
        low, high = (middle, high) if given < wanted else (low, middle)
    return 0.5 * (low + high)


def duty(c: Array, angle: float, velocity: float, p_a: float, slope: float, p_ab_bar: float, muscle: int) -> float:
    """Duty of a muscle's valves that gives its pressure the slope: p_A's, or with the other sign p_B's."""
    state = float(c[P_IN]), 1e5 * p_a, 1e5 * (p_ab_bar - p_a), angle, velocity
    k, sign = 1 + muscle, 1.0 - 2.0 * muscle
    shut = derivatives(c, state, (False,) * 4)[k]
    missing = 1e5 * sign * slope - shut
    if missing > 0.0:
        return missing / max(derivatives(c, state, (muscle == 0, muscle == 1, False, False))[k] - shut, 1.0)
    return -missing / min(derivatives(c, state, (False, False, muscle == 0, muscle == 1))[k] - shut, -1.0)


def tracked(
    way: Path, feed: Array | None, controllers: Sequence[Controller], settings: Mapping[str, Any], seed: int,
    parameters: Mapping[str, float] | None = None,
) -> tuple[dict[str, object], Recording]:  # fmt: skip
    """Simulate the profile with z added at the plant's input; the true angle's error in deg, and what it took."""
    arm, n = Arm1(), way.derivative[0].size
    references = np.stack([way.derivative[0], np.full(n, settings["p_ab_bar"])], axis=1)
    injected = np.zeros((n, 2))
    if feed is not None:
        injected[:, : 1 if feed.ndim == 1 else 2] = feed[:, None] if feed.ndim == 1 else feed
    point = {"theta2_deg": 0.0, "p_ab_bar": settings["p_ab_bar"]}
    e = Experiment(
        "profile", "profile", arm.loop_setups(controllers, "plant_input"), RATE_HZ, references, injected, "plant_input",
        point, seed=seed, parameters=dict(parameters or {}),
    )  # fmt: skip
    recording = arm.simulate([e], threads=1, states=True)[0]
    return looked_at(way, recording, settings), recording


def looked_at(way: Path, recording: Recording, settings: Mapping[str, Any]) -> dict[str, object]:
    """Error from the first motion to a second after the last; delay is the shift of the reference that leaves least."""
    if recording.info.ended_early:
        return {"ended": recording.info.ended_early}
    begin, end = round(settings["times_s"][0] * RATE_HZ), round((way.ends_s + 1.0) * RATE_HZ)
    angle, r = recording.column("true_theta2_rad")[:end], way.derivative[0][:end]
    error = deg(r - angle)[begin:]
    shifts = np.arange(0, 400, 2)
    left = [float(np.sqrt(np.mean((np.roll(r, k)[begin:] - angle[begin:]) ** 2))) for k in shifts]
    u = np.abs(np.stack([recording.column(f"u_{k}_v")[begin:end] for k in "ab"]))
    p_ab = recording.column("p_a_bar") + recording.column("p_b_bar")
    return {
        "rms_deg": float(np.sqrt(np.mean(error**2))), "peak_deg": float(np.abs(error).max()),
        "delay_s": float(shifts[int(np.argmin(left))]) / RATE_HZ, "greatest_u_v": float(u.max()),
        "saturated_s": float((u.max(axis=0) >= 1.0).sum() / RATE_HZ),
        "p_ab_rms_bar": float(np.std(p_ab[begin:end] - settings["p_ab_bar"])), "ended": "",
    }  # fmt: skip


def feeds(way: Path, fitted: tuple[float, float, float], settings: Mapping[str, Any]) -> dict[str, Array | None]:
    """The kinds of feedforward for a path; `fitted` are kappa, f, zeta of the measured FRF at (0 deg, p_AB)."""
    p_ab = settings["p_ab_bar"]
    return {
        "none": None,
        "third order, one point": third_order(way, *fitted),
        "third order, each angle": scheduled(way, p_ab, {}, by_flow=False),
        "third order, each angle and flow": scheduled(way, p_ab, {}, by_flow=True),
        "inverted model": inverted(way, p_ab, {}, settings["inverse_step_s"]),
    }


def kind_rows(
    ways: Sequence[Path], fitted: tuple[float, float, float], shipped: Sequence[Controller], own: Sequence[Controller],
    settings: Mapping[str, Any], seed: int,
) -> list[dict]:  # fmt: skip
    """A line for each profile and kind, the same controllers in all but the last kind."""
    rows = []
    for way in ways:
        kinds = feeds(way, fitted, settings)
        for name, feed in kinds.items():
            rows.append({**place(way), "feedforward": name, **tracked(way, feed, shipped, settings, seed)[0]})
        other = tracked(way, None, own, settings, seed)[0]
        rows.append({**place(way), "feedforward": "none, this point's own controller", **other})
    return rows


def by_supply_rows(
    ways: Sequence[Path], robust: Mapping[float, Sequence[Controller]], settings: Mapping[str, Any], seed: int
) -> list[dict]:
    """A line for each supply and profile under the supply's controller for all points, without and with the inverse."""
    rows = []
    for supply, controllers in robust.items():
        changes = {"supply_bar": supply}
        for way in ways:
            inverse = inverted(way, settings["p_ab_bar"], changes, settings["inverse_step_s"])
            for name, feed in (("none", None), ("inverted model", inverse)):
                found = tracked(way, feed, controllers, settings, seed, changes)[0]
                rows.append({"supply_bar": supply, **place(way), "feedforward": name, **found})
    return rows


def place(way: Path) -> dict[str, float]:
    """The profile's limits."""
    return dict(zip(("velocity_deg_s", "acceleration_deg_s2", "jerk_deg_s3"), way.limits, strict=True))


def error_rows(
    way: Path, fitted: tuple[float, float, float], shipped: Sequence[Controller], settings: Mapping[str, Any], seed: int
) -> list[dict]:
    """The feedforward from numbers that are off, one at a time; the arm stays as it is."""
    rows = []
    for off in (0.0, *settings["errors"]):
        kappa, f_hz, zeta = fitted
        made = {
            ("third order, one point", "kappa"): third_order(way, kappa * (1.0 + off), f_hz, zeta),
            ("third order, one point", "f"): third_order(way, kappa, f_hz * (1.0 + off), zeta),
            ("third order, one point", "zeta"): third_order(way, kappa, f_hz, zeta * (1.0 + off)),
        }
        nominal = ARM1_PARAMETERS.rows[ARM1_PARAMETERS.index("throttle_factor")].value
        for word, changes in (
            ("stiffness", {"stiffness_error": off}),
            ("flows", {"throttle_factor": nominal * (1.0 + off)}),
        ):
            made["inverted model", word] = inverted(way, settings["p_ab_bar"], changes, settings["inverse_step_s"])
            made["third order, each angle and flow", word] = scheduled(way, settings["p_ab_bar"], changes, by_flow=True)
        for (kind, word), feed in made.items():
            found = tracked(way, feed, shipped, settings, seed)[0]
            rows.append({"feedforward": kind, "off": word, "by": off, **found})
    return rows


def preview_rows(
    way: Path, fitted: tuple[float, float, float], shipped: Sequence[Controller], settings: Mapping[str, Any], seed: int
) -> list[dict]:
    """The same feedforward, earlier: what the delay of the PWM costs."""
    rows = []
    for preview in settings["previews_s"]:
        for kind, feed in feeds(way.ahead(preview), fitted, settings).items():
            if feed is not None:
                found = tracked(way, feed, shipped, settings, seed)[0]
                rows.append({"preview_s": preview, "feedforward": kind, **found})
    return rows


def recordings_shown(
    way: Path, fitted: tuple[float, float, float], shipped: Sequence[Controller], settings: Mapping[str, Any], seed: int
) -> dict[str, Recording]:
    """One recording for each kind, for the figure."""
    return {name: tracked(way, f, shipped, settings, seed)[1] for name, f in feeds(way, fitted, settings).items()}
