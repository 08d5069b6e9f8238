"""The source's controllers on its printed plants and on simulated arms: loops, margins, and what each cause does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from arm1_sweeps import Arm, Found, found, recorded
from source_controllers import angle_controller, pressure_controller, third_order_plant

from loopshape.core.units import Array, angular, db, from_db
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import TransferFunction
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.identify.frequency_response import estimate_frf
from loopshape.loop.loop import Loop
from loopshape.loop.margin.margins import margins
from loopshape.loop.verdict import check
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.rig.study import Study

PLACES = ("figure_4_12", "figure_4_15.measured", "figure_4_14", "figure_4_15.simulated")
UPRIGHT = (0.0, 1.0)


def required(loop: str) -> Requirements:
    """What the source requires of each loop in every equilibrium (section 5.2)."""
    return Requirements(
        loop,
        sensitivity_peak_db=value("required.sensitivity"),
        phase_margin_deg=value("required.phase_margin"),
        gain_margin_db=value("required.gain_margin"),
    )


def meets(m: Margins) -> bool:
    """Whether one loop is stable and its margins, at their estimates, are those required."""
    phase, gain, peak = (value(f"required.{name}") for name in ("phase_margin", "gain_margin", "sensitivity"))
    enough = m.phase_margin_deg >= phase and m.gain_margin_db >= gain
    return m.stable == "stable" and enough and m.sensitivity_peak_db <= peak


def matched(table: Mapping[str, Any], name: str) -> Arm:
    """An arm of the settings; with `match` all throttles' area is scaled to that kappa at (0 deg, 1.0 bar)."""
    arm = Arm(name, table["label"], table.get("effects", {}), table.get("changes", {}))
    if "match" not in table:
        return arm
    nominal = next(r.value for r in ARM1_PARAMETERS.rows if r.name == "throttle_factor")
    scale = value(table["match"]) / arm.linearised(UPRIGHT, {}).third_order()[0]
    return replace(arm, changes={**arm.changes, "throttle_factor": nominal * scale})


@dataclass(frozen=True, eq=False)
class Judged:
    """One controller on one arm's FRFs."""

    arm: Arm
    controller: str
    loops: tuple[Loop, ...]
    verdict: Verdict

    @property
    def margins(self) -> list[Margins]:
        """In the order of the FRFs."""
        return list(self.verdict.margins.values())

    @property
    def stable(self) -> int:
        """Points that are stable."""
        return sum(m.stable == "stable" for m in self.margins)

    @property
    def meeting(self) -> int:
        """Points that meet all three requirements."""
        return sum(meets(m) for m in self.margins)

    def bandwidths_hz(self) -> tuple[float, float]:
        """Lowest and highest first crossing of 0 dB, of the stable loops."""
        all_hz = [m.bandwidth_hz for m in self.margins if m.stable == "stable"]
        return (min(all_hz), max(all_hz)) if all_hz else (float("nan"), float("nan"))

    def row(self) -> list[Any]:
        """One line of a table; the worst numbers are over all points, the unstable ones too."""
        worst = [f"{min(m.phase_margin_deg for m in self.margins):.0f}",
                 f"{min(m.gain_margin_db for m in self.margins):.1f}",
                 f"{max(m.sensitivity_peak_db for m in self.margins):.1f}"]  # fmt: skip
        bandwidth = [f"{x:.2f}" for x in self.bandwidths_hz()]
        return [self.arm.name, self.controller, len(self.margins), self.stable, self.meeting, *bandwidth, *worst,
                self.verdict.outcome]  # fmt: skip


def judge(name: str, every: Sequence[Found], controller: Controller) -> Judged:
    """Margins, with intervals, of one controller at all of an arm's equilibria."""
    frfs = [f.frf for f in every]
    verdict = check(frfs, controller, required(controller.loop), [f.fit for f in every])
    loops = tuple(Loop(frf.valid_lines(), controller, 1, unstable_poles=0) for frf in frfs)
    return Judged(every[0].arm, name, loops, verdict)


def judge_identical(every: Sequence[Found], controller: Controller) -> Judged:
    """The same with each FRF scaled to the printed kappa: the identical mass line that the source reports."""
    frfs = [scaled(f.frf, value("figure_4_12.kappa") / f.value("kappa")) for f in every]
    verdict = check(frfs, controller, replace(required(controller.loop), integrators=1, unstable_poles=0))
    loops = tuple(Loop(frf.valid_lines(), controller, 1, unstable_poles=0) for frf in frfs)
    return Judged(every[0].arm, "source, kappa alike", loops, verdict)


def scaled(frf: FRF, factor: float) -> FRF:
    """An FRF times a real factor."""
    return replace(frf, response=factor * frf.response, covariance=factor**2 * frf.covariance)


def identified(study: Study, arm: Arm) -> list[Found]:
    """An arm's 24 FRFs and fits, by the identification's own study."""
    own = replace(study, experiments=tuple(e for e in study.experiments if not e.name.startswith("linear")))
    run, recordings = recorded(own, arm)
    return found(run, recordings, arm)


def pressure_loop(study: Study, arm: Arm, controller: Controller) -> Judged:
    """The pressure loop identified at 0 deg, and a controller on it."""
    own = replace(study, experiments=tuple(e for e in study.experiments if e.name == "pressure"))
    run, recordings = recorded(own, arm)
    frfs = [estimate_frf(recording, run.loop("p_ab")) for recording in recordings]
    verdict = check(frfs, controller, replace(required("p_ab"), integrators=1))
    loops = tuple(Loop(frf.valid_lines(), controller, 1, unstable_poles=0) for frf in frfs)
    return Judged(arm, "table 5.2", loops, verdict)


@dataclass(frozen=True)
class Spread:
    """Least and most kappa and f over an arm's equilibria, as ratios to those printed for (0 deg, 1.0 bar)."""

    kappa: tuple[float, float]
    f: tuple[float, float]

    @classmethod
    def of(cls, every: Sequence[Found]) -> Spread:
        """From the fits."""
        kappa = np.array([x.value("kappa") for x in every]) / value("figure_4_12.kappa")
        f = np.array([x.value("f_hz") for x in every]) / value("figure_4_12.f")
        return cls((float(kappa.min()), float(kappa.max())), (float(f.min()), float(f.max())))

    @property
    def f_words(self) -> str:
        """The span of f."""
        return f"{self.f[0]:.2f} to {self.f[1]:.2f}"

    def __str__(self) -> str:
        kappa = f"{self.kappa[0]:.2f} to {self.kappa[1]:.2f}"
        return f"kappa is {kappa} times and f {self.f_words} times the measured at (0 deg, 1.0 bar)"


def exact_loop(plant: TransferFunction, controller: Controller, grid: Mapping[str, Any], name: str) -> Loop:
    """The loop of a plant known by formula, on a dense grid."""
    f = np.geomspace(grid["low_hz"], grid["high_hz"], grid["count"])
    P = plant.response(f)[:, None, None]
    nothing = 1e-12 * np.abs(P) ** 2 + 0j
    frf = FRF(f, P, nothing, np.ones(f.size, dtype=bool), ("z_theta2_v",), ("theta2_rad",), "formula", recording=name,
              loop="theta2", rate_hz=controller.rate_hz)  # fmt: skip
    return Loop(frf, controller, 1, unstable_poles=0)


def on_printed_plants(grid: Mapping[str, Any], delay_s: float) -> list[tuple[str, str, float, Loop, Margins]]:
    """Table 5.1 and its variant of figure 5.7 on the four printed fits, with and without delay."""
    out = []
    for place in PLACES:
        for words, notch in (("notch as printed", None), ("notch of figure 5.7", value("figure_5_7.notch"))):
            for delay in (0.0, delay_s):
                loop = exact_loop(third_order_plant(place, delay), angle_controller(notch_hz=notch), grid, place)
                out.append((place, words, delay, loop, margins(loop)))
    return out


def causes(every: Sequence[Found], grid: Mapping[str, Any], delay_s: float) -> list[list[Any]]:
    """Table 5.1 on the printed plant with kappa, then f, then zeta, then all of ours, one at a time."""
    out: list[list[Any]] = []
    for place, point in (("figure_4_12", (0.0, 1.0)), ("figure_4_15.measured", (30.0, 0.8))):
        f = next(x for x in every if x.point == point)
        printed = {"kappa": value(f"{place}.kappa"), "f_hz": value(f"{place}.f"), "zeta": value(f"{place}.zeta")}
        for moved in ((), ("kappa",), ("f_hz",), ("zeta",), ("kappa", "f_hz", "zeta")):
            given = printed | {name: f.value(name) for name in moved}
            w = float(angular(given["f_hz"]))
            den = np.array([1.0, 2.0 * given["zeta"] * w, w * w, 0.0])
            plant = TransferFunction(np.array([given["kappa"]]), den, delay_s)
            m = margins(exact_loop(plant, angle_controller(), grid, place))
            ratios = [f"{f.value(n) / printed[n]:.2f}" for n in ("kappa", "f_hz", "zeta")]
            out.append([f.arm.name, *point, " ".join(moved) or "printed", *ratios, *of(m)])
    return out


def of(m: Margins) -> list[Any]:
    """Stability, whether the requirements are met, and the margins of one loop as cells."""
    numbers = (f"{m.bandwidth_hz:.2f}", f"{m.phase_margin_deg:.0f}", f"{m.gain_margin_db:.1f}")
    return [m.stable, meets(m), *numbers, f"{m.sensitivity_peak_db:.1f}"]


@dataclass(frozen=True)
class PressurePlant:
    """The pressure loop's plants at several p_AB: level and slope of each."""

    at_1_hz_db: Array
    slopes: Array

    @classmethod
    def of(cls, judged: Judged) -> PressurePlant:
        """From 0.5 to 5 Hz."""
        levels, slopes = [], []
        for loop in judged.loops:
            f, P = loop.plant.frequency_hz, loop.plant.siso
            use = (f >= 0.5) & (f <= 5.0)
            slope, level = np.polyfit(np.log10(f[use]), np.asarray(db(P[use])) / 20.0, 1)
            slopes.append(slope)
            levels.append(20.0 * level)
        return cls(np.array(levels), np.array(slopes))

    @property
    def span_db(self) -> float:
        """Highest over lowest level."""
        return float(np.ptp(self.at_1_hz_db))

    @property
    def gain(self) -> float:
        """Mean rate of p_AB in bar/s per V of z_p, both directions, small commands."""
        return float(2.0 * np.pi * np.mean(from_db(self.at_1_hz_db)))


def implied_pressure_gain() -> float:
    """bar/s per V of the integrator whose loop with table 5.2 has the printed bandwidth."""
    f = value("table_5_2.bandwidth")
    return float(2.0 * np.pi * f / np.abs(pressure_controller().response(np.array([f]))[0]))
