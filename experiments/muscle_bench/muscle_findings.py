"""All that the study finds, computed once: tables, scores and figures read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any

import muscle_parameters as six
import numpy as np
from h1_h2 import TwoEstimates
from muscle_arm import ArmReading, arm_readings, third_order
from muscle_law import (
    LAWS,
    Digits,
    Muscle,
    printed,
    slope_closed,
)
from muscle_models import Comparison, compare_models, taylor
from muscle_points import Measured, Point, columns, coverage, grid, muscles, sweep
from muscle_records import Bench, measure

from loopshape.core.units import Array
from loopshape.toolbox.arm.source import value

FIVE_MM = (150, 160, 170, 180, 190)


@dataclass(frozen=True, eq=False)
class Found:
    """Everything found; see `find`."""

    points: list[Point]
    left: list[Point]
    rows: dict[str, list[Measured]]
    others: list[list[Measured]]
    fits: dict[str, six.SixParameters]
    scattered: six.SixParameters
    conditions: tuple[float, float, float]
    box_low: Array
    box_high: Array
    nearest: Digits
    nearest_misfit: float
    reaching: list[Digits]
    k_arm_reach: tuple[float, float]
    k_arm_given: tuple[float, float]
    digit_errors: list[list[Any]]
    noisy: TwoEstimates
    comparisons: list[Comparison]
    arm: list[ArmReading]
    f_reaching: Array
    about: Mapping[str, float]
    arm_point: Point

    @property
    def every(self) -> list[Measured]:
        """All measured points: muscle 4 under each law, then the others."""
        return [row for rows in (*self.rows.values(), *self.others) for row in rows]

    @property
    def columns(self) -> tuple[Array, Array]:
        """Pressures and lengths (40,) of the grid."""
        return columns(self.points)

    def ratio(self, law: str) -> Array:
        """True slope over k (40,)."""
        return np.array([row.slope / row.k for row in self.rows[law]])

    @property
    def five(self) -> tuple[Array, Array, Array, Array]:
        """Figure G.3's points: pressures, lengths, k_w in N/m, d_w in N s/m."""
        return five()

    def summary(self) -> list[list[Any]]:
        """Single numbers."""
        return summary(self)


def five() -> tuple[Array, Array, Array, Array]:
    """Pressures, lengths, k_w in N/m and d_w in N s/m that figure G.3 prints."""
    k = np.array([1e3 * value(f"figure_g_3.k_{h}") for h in FIVE_MM])
    d = np.array([value(f"figure_g_3.d_{h}") for h in FIVE_MM])
    return np.full(5, 0.9), 1e-3 * np.array(FIVE_MM, dtype=float), k, d


def find(words: Mapping[str, Any]) -> Found:
    """Measure and compute all of it."""
    bench, about = Bench.of(words["bench"]), words["six_parameters"]
    points, left = grid(words["grid"])
    p, h = columns(points)
    rows = {law: sweep(bench, law, points, 100_000 * (n + 1) + bench.seed) for n, law in enumerate(LAWS)}
    fits = {law: six.fit(p, h, np.array([r.found.k for r in rows[law]])) for law in LAWS}
    low, high = six.reach(six.printed_box(), p, h)
    (mm, bar), poor = words["grid"]["one_point_mm_bar"], Bench.of({**words["bench"], **words["noisy_bench"]})
    digits = rounding(words, bench.seed)
    p_arm, h_arm, places = arm_place(words)
    return Found(
        points=points,
        left=left,
        rows=rows,
        others=other_muscles(bench, words["muscles"]),
        fits=fits,
        scattered=scattered(p, h, bench.seed),
        conditions=six.conditions(p, h, about),
        box_low=low,
        box_high=high,
        digit_errors=digit_errors(p, h, about),
        noisy=measure(poor, "gauge", bar, 1e-3 * mm, 500_000),
        comparisons=compare_models(words["models"]),
        arm=arm_readings(digits["nearest"], fits["gauge"].digits, places, (p_arm, h_arm)),
        about=about,
        arm_point=(p_arm, h_arm),
        **digits,
    )


def arm_place(words: Mapping[str, Any]) -> tuple[float, float, list[tuple[float, float]]]:
    """Pressure in bar and length in m of a muscle at the first of the arm's points, and these (deg, bar)."""
    mm, p = words["arm"]["muscle_mm_bar"]
    return p, 1e-3 * mm, [(t, b) for t, b in words["arm"]["points_deg_bar"]]


def other_muscles(bench: Bench, words: Mapping[str, Any]) -> list[list[Measured]]:
    """Muscles 1, 2, 3 and 5 at the reference points, valves closed, gauge gas law."""
    points = [(float(p), 1e-3 * mm) for mm, p in words["points_mm_bar"]]
    others = [one for one in muscles(words) if one.name != "4"]
    return [sweep(bench, "gauge", points, 400_000 + 10_000 * n, one) for n, one in enumerate(others)]


def rounding(words: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """What digits that round to table 4.1 can do: nearest to figure G.3, all that meet it, and k and f by these."""
    steps, share = int(words["six_parameters"]["b_steps"]), 0.01 * value("figure_g_6.fitted_error")
    known, box = five()[:3], six.printed_box()
    p_arm, h_arm, places = arm_place(words)
    misfit, nearest = six.smallest_misfit(*known, box, steps)
    reaching = six.reaching(known, share, box, steps, seed)
    low, high = six.reach(box, np.array([p_arm]), np.array([h_arm]))
    f = [[third_order(d, absolute, *at)[1] for absolute in (False, True) for at in places] for d in reaching]
    return {
        "nearest": nearest,
        "nearest_misfit": misfit,
        "reaching": reaching,
        "k_arm_reach": (float(low[0]), float(high[0])),
        "k_arm_given": six.reach_given(p_arm, h_arm, known, share, box, steps),
        "f_reaching": np.array(f),
    }


def scattered(p_bar: Array, h_m: Array, seed: int) -> six.SixParameters:
    """Table 4.1's own stiffness with the source's residual: uniform up to figure G.6's largest error."""
    most = 0.01 * value("figure_g_6.fitted_error")
    errors = np.random.default_rng(seed).uniform(-most, most, p_bar.size)
    return six.fit(p_bar, h_m, printed().stiffness(p_bar, h_m) * (1.0 + errors))


def digit_errors(p_bar: Array, h_m: Array, about: Mapping[str, float]) -> list[list[Any]]:
    """Largest relative error of k on the grid against the number of digits, in table 4.1's form and centred."""
    return [
        [
            n,
            float(f"{six.error_table_form(n, p_bar, h_m):.3g}"),
            float(f"{six.error_centred(n, p_bar, h_m, about):.3g}"),
        ]
        for n in range(2, int(about["most_digits"]) + 1)
    ]


def digits_needed(found: Found, column: int) -> int:
    """Fewest digits that keep k within the stated share."""
    return next(int(row[0]) for row in found.digit_errors if row[column] < found.about["good_share"])


def summary(found: Found) -> list[list[Any]]:
    """Single numbers for the README."""
    return [*_bench_summary(found), *_response_summary(found), *_digit_summary(found), *_arm_summary(found)]


def _response_summary(found: Found) -> list[list[Any]]:
    """How far H2 lies above H1 in the fitted band, and what h0 alone does to the slope at the reference points."""
    one = next(r for r in found.rows["gauge"] if r.p_bar == 0.8 and round(1e3 * r.h_m) == 170)
    out: list[list[Any]] = []
    for name, both in (("assumed", one.both), ("poor", found.noisy)):
        coherence = both.coherence[both.h1.frequency_hz <= value("bench.fit_to")]
        out.append([f"H2 over H1 with {name} sensors, median", round(float(np.median(1.0 / coherence)), 4), "1"])
    half = 0.5e-3 * value("muscles.nominal_length_spread")
    shifts = [
        slope_closed("gauge", r.p_bar, r.h_m, Muscle("", 1.0, s * half)) / slope_closed("gauge", r.p_bar, r.h_m) - 1.0
        for r in found.others[0]
        for s in (-1.0, 1.0)
    ]
    out += [[f"slope by half the spread of h0 alone, {n}", round(v, 3), "1"] for n, v in _ends(np.array(shifts))]
    off_diagonal = np.abs(six.correlation(found.scattered.normal_covariance))[~np.eye(6, dtype=bool)]
    return out + [[f"|correlation| of table 4.1's numbers, {n}", round(v, 4), "1"] for n, v in _ends(off_diagonal)]


def _ends(values: Array) -> list[tuple[str, float]]:
    return [("least", float(values.min())), ("most", float(values.max()))]


def _bench_summary(found: Found) -> list[list[Any]]:
    out: list[list[Any]] = []
    for law, rows in found.rows.items():
        k_held, d_held = coverage(rows)
        ratio, measured = found.ratio(law), np.array([r.found.k for r in rows])
        fitted = found.fits[law].digits.stiffness(*found.columns) / np.array([r.k for r in rows])
        worst = np.max(np.abs(found.fits[law].residual) / measured)
        out += [
            [f"{law}: intervals of k_w that hold the slope", k_held, "1"],
            [f"{law}: intervals of d_w that hold the damping", d_held, "1"],
            [f"{law}: slope over k, least", round(float(ratio.min()), 3), "1"],
            [f"{law}: slope over k, median", round(float(np.median(ratio)), 3), "1"],
            [f"{law}: slope over k, most", round(float(ratio.max()), 3), "1"],
            [f"{law}: six parameters over k, least", round(float(fitted.min()), 3), "1"],
            [f"{law}: six parameters over k, most", round(float(fitted.max()), 3), "1"],
            [f"{law}: six parameters, largest relative residual", round(float(worst), 4), "1"],
        ]
    return out


def _digit_summary(found: Found) -> list[list[Any]]:
    p, h = found.columns
    names = ("as printed (SI, bar)", "columns of length 1", "centred")
    most = 1e-3 * float(np.max(found.box_high - printed().stiffness(p, h)))
    std = 1e-3 * float(six.rounding_std(p, h, six.printed_box()).mean())
    out: list[list[Any]] = [
        [f"condition number, {n}", round(c, 1), "1"] for n, c in zip(names, found.conditions, strict=True)
    ]
    out += [
        ["rounding of table 4.1 moves k by at most", round(most, 2), "kN/m"],
        ["rounding of table 4.1, standard deviation, mean", round(std, 2), "kN/m"],
        ["digits for 1 % of k, table form", digits_needed(found, 1), "1"],
        ["digits for 1 % of k, centred", digits_needed(found, 2), "1"],
        ["smallest misfit to figure G.3 within the rounding", round(found.nearest_misfit, 4), "1"],
    ]
    out += [
        [f"digits nearest the bench, {n}", round(v, 5), "1"]
        for n, v in zip(six.NAMES, astuple(found.nearest), strict=True)
    ]
    return out + [[f"appendix E.4, {key}", float(f"{v:.6g}"), "SI"] for key, v in taylor().items()]


def _arm_summary(found: Found) -> list[list[Any]]:
    ends = ("least", "most")
    out: list[list[Any]] = [
        ["k at the arm's point by printed digits", k_at(printed(), found), "kN/m"],
        ["k there without b", k_at(printed(), found, biased=False), "kN/m"],
    ]
    for name, reach in (
        ("by any digits that round", found.k_arm_reach),
        ("of these within figure G.3", found.k_arm_given),
    ):
        out += [[f"k there {name}, {n}", round(1e-3 * v, 2), "kN/m"] for n, v in zip(ends, reach, strict=True)]
    span = np.array([found.f_reaching.min(axis=0), found.f_reaching.max(axis=0)])
    for i, where in enumerate(("gauge, 0 deg", "gauge, 30 deg", "absolute, 0 deg", "absolute, 30 deg")):
        for n, v in zip(ends, span[:, i].tolist(), strict=True):
            out.append([f"f by digits within figure G.3, {where}, {n}", round(v, 2), "Hz"])
    return out


def k_at(digits: Digits, found: Found, biased: bool = True) -> float:
    """k at the arm's point in kN/m; without b only what pressure gives."""
    p, h = (np.array(v) for v in found.arm_point)
    k = float(digits.stiffness(p, h))
    return round(1e-3 * (k if biased else k - float(digits.stiffness(0.0 * p, h))), 3)
