"""The scoreboard's rows for chapters 3 and 4; every verdict about a number is decided by the rule that its row states.

`judged`: agrees within the tolerance, partly within three times it, else differs. Appendices: `muscle_scores_appendix`.
"""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
from muscle_arm import JZZ2, joint_inertia, k_ab, k_ab_rounding
from muscle_findings import Found, digits_needed, k_at
from muscle_law import LAWS, damping, diameter_m, nominal_length_m, printed
from muscle_models import taylor
from muscle_parameters import NAMES
from muscle_points import BAND

from loopshape.core.units import Array
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS
from loopshape.toolbox.arm.source import number, value

Row = tuple[str, str, str, str, str, str]
TABLE, ANALYTICAL = printed(), printed("analytical")
PICTURE = "the source gives its measurements as a picture alone"
HALF_DIGIT = "rule: half a printed digit"
FIT_ERROR = "rule: the source's largest error of its fit"


def judged(off: float, tolerance: float) -> str:
    """A verdict from a distance and what is allowed."""
    if off <= tolerance * (1.0 + 1e-9):
        return "agrees"
    return "partly" if off <= 3.0 * tolerance else "differs"


def rounds_to(found: float, key: str) -> str:
    """A verdict by half a printed digit."""
    return judged(abs(found - value(key)), number(key).half_digit)


def rows_of_chapters(found: Found) -> list[Row]:
    """All rows of chapters 3 and 4, in the source's order."""
    return [
        longest_row(),
        nominal_row(),
        grid_row(found),
        spread_row(found),
        minimum_row(),
        lower_row(found),
        recovered_row(found),
        scatter_row(found),
        digits_row(found),
        rounding_row(found),
        analytical_row(),
        damping_row(found),
        *arm_rows(found),
    ]


def longest_row() -> Row:
    """Figure 3.12, kinematics."""
    v = {row.name: row.value for row in ARM1_PARAMETERS.rows}
    longest = np.sqrt(4.0 * v["braid_length_mm"] ** 2 - (v["braid_turns"] * np.pi * v["end_diameter_mm"]) ** 2)
    verdict = rounds_to(float(longest), "muscles.longest")
    what = "length of a completely stretched muscle"
    return "figure 3.12", what, "{muscles.longest}", f"{longest:.1f} mm", verdict, HALF_DIGIT


def nominal_row() -> Row:
    """Figure 3.12, the model and what spread and hysteresis are worth."""
    p = np.array([value("muscles.braid_touches"), 1.0])
    h0, d20 = 1e3 * nominal_length_m(p), 1e3 * diameter_m(nominal_length_m(p))
    per_bar = float(1e3 * (nominal_length_m(np.array(1.01)) - nominal_length_m(np.array(0.99))) / 0.02)
    hysteresis, spread = (value(f"muscles.{n}") / abs(per_bar) for n in ("hysteresis", "nominal_length_spread"))
    source = (
        "five muscles within {muscles.nominal_length_spread}, hysteresis {muscles.hysteresis}; the model is a good fit"
        " above {muscles.braid_touches}"
    )
    ours = (
        f"model from {p[0]:g} to 1 bar: h0 {h0[0]:.0f} to {h0[1]:.0f} mm, d20 {d20[0]:.1f} to {d20[1]:.1f} mm; at 1 bar"
        f" the hysteresis is worth {hysteresis:.2f} bar, the spread {spread:.2f} bar"
    )
    return "figure 3.12", "h0(p), d20(p), d20(h0)", source, ours, "not comparable", PICTURE


def grid_row(found: Found) -> Row:
    """Figure 4.4."""
    ours = f"{len(found.points)} of {len(found.points) + len(found.left)} pairs of figure 4.5's lengths and pressures"
    why = "the text does not list them: those farthest below the nominal length are left out here"
    return "figure 4.4", "working points of muscle 4", "{bench.points}", ours, "not comparable", why


def spread_over(found: Found) -> tuple[float, float]:
    """Smallest and largest k_w of the other muscles over muscle 4's at the reference points."""
    own = {(r.p_bar, round(1e3 * r.h_m)): r.found.k for r in found.rows["gauge"]}
    ratios = [r.found.k / own[(r.p_bar, round(1e3 * r.h_m))] for rows in found.others for r in rows]
    return min(ratios), max(ratios)


def spread_row(found: Found) -> Row:
    """Figure 4.5, the other muscles."""
    low, high = spread_over(found)
    ours = (
        f"{100 * (low - 1):+.0f} to {100 * (high - 1):+.0f} % with k spread by the published share and h0 by the"
        " published length (closed valves, gauge gas law)"
    )
    verdict = judged(abs(100.0 * (high - 1.0) - value("muscles.stiffness_spread")), 5.0)
    source = "up to {muscles.stiffness_spread} more; muscle 4 below the others in almost all cases"
    why = "rule: within 5 points; a spread in h0 alone moves the slope that a bench with closed valves measures"
    return "figure 4.5", "k_w of the other muscles over muscle 4's", source, ours, verdict, why


def minimum_row() -> Row:
    """Figure 4.6, where the fitted stiffness is smallest."""
    p = 0.9
    minimum = -1e3 * TABLE.k1 * (TABLE.b * TABLE.c1 + p) / (2.0 * TABLE.k2 * (TABLE.b + p))
    verdict = judged(abs(minimum - value("figure_4_6.minimum")), 5.0)
    ours = f"{minimum:.0f} mm at {p:g} bar by the printed digits"
    what = "length of the smallest fitted stiffness"
    return "figure 4.6", what, "{figure_4_6.minimum}", ours, verdict, "rule: within 5 mm"


def analytical_error(found: Found, nearest: bool) -> Array:
    """Relative error (40,) of the analytical stiffness against the fitted one, by printed digits or the nearest."""
    p, h = found.columns
    fitted = (found.nearest if nearest else TABLE).stiffness(p, h)
    return np.asarray(ANALYTICAL.stiffness(p, h) / fitted - 1.0)


def lower_row(found: Found) -> Row:
    """Figure 4.6, the analytical surface."""
    own, near = (100.0 * analytical_error(found, nearest) for nearest in (False, True))
    ours = (
        f"{own.min():.0f} to {own.max():+.0f} % of the printed fit; {near.min():.0f} to {near.max():.0f} % of the"
        " digits nearest figure G.3"
    )
    verdict = "agrees" if own.max() < 0.0 else "partly" if near.max() < 0.0 else "differs"
    why = "the printed digits are too soft by their rounding; with digits inside it that meet figure G.3 it holds"
    return "figure 4.6", "analytical model below the fitted one", "everywhere", ours, verdict, why


def recovered_row(found: Found) -> Row:
    """Table 4.1, the right answer known."""
    fit = found.fits[LAWS[0]]
    half = BAND * np.sqrt(np.diag(fit.normal_covariance))
    inside = np.abs(np.array(astuple(fit.digits)) - np.array(astuple(TABLE))) <= half
    found_again = zip(NAMES, astuple(fit.digits), half, strict=True)
    ours = ", ".join(f"{n} {v:.3g} ± {h:.1g}" for n, v, h in found_again)
    verdict = "agrees" if inside.all() else "partly" if inside.sum() >= 5 else "differs"
    source = ", ".join(f"{n} {{table_4_1.experiment.{n}}}" for n in NAMES)
    what = "six parameters found again by a bench that measures k"
    return "table 4.1", what, source, ours, verdict, "rule: within the 95 % intervals of our least squares"


def scatter_row(found: Found) -> Row:
    """Table 4.1, what the source's own residual leaves."""
    half = BAND * np.sqrt(np.diag(found.scattered.normal_covariance))
    ours = ", ".join(f"{n} ± {h:.2g}" for n, h in zip(NAMES, half, strict=True))
    raw, _, centred = found.conditions
    why = f"the source gives no intervals; condition number {raw:.0f} as printed, {centred:.0f} centred"
    source = "residual up to {figure_g_6.fitted_error}"
    return "table 4.1", "95 % intervals with the source's own residual", source, ours, "not comparable", why


def digits_row(found: Found) -> Row:
    """Table 4.1 against figure G.3."""
    p, h, k, _ = found.five
    off = 100.0 * (TABLE.stiffness(p, h) / k - 1.0)
    reach = 1e-3 * float(np.max(found.box_high - TABLE.stiffness(*found.columns)))
    why = (
        f"too few digits: their rounding moves k by up to {reach:.1f} kN/m; {digits_needed(found, 1)} each would be"
        f" needed for 1 %, {digits_needed(found, 2)} in a centred polynomial"
    )
    verdict = judged(float(np.max(np.abs(off))), value("figure_g_6.fitted_error"))
    source, ours = "fit within {figure_g_6.fitted_error}", f"{off.min():.0f} to {off.max():.0f} %"
    return "table 4.1", "printed digits against figure G.3's stiffnesses", source, ours, verdict, why


def rounding_row(found: Found) -> Row:
    """Table 4.1, the best that rounding allows."""
    off = 100.0 * found.nearest_misfit
    verdict = judged(off, value("figure_g_6.fitted_error"))
    source, ours = "fit within {figure_g_6.fitted_error}", f"{off:.1f} % at best"
    return "table 4.1", "digits inside the rounding against figure G.3", source, ours, verdict, FIT_ERROR


def analytical_row() -> Row:
    """Table 4.1, lower row."""
    ours = {n.split(".")[-1]: v for n, v in taylor().items() if n.startswith("e_27")} | {"b": taylor()["e_28.b"]}
    right = [rounds_to(v, f"table_4_1.analytical.{n}") == "agrees" for n, v in ours.items()]
    verdict = "agrees" if all(right) else "partly" if any(right) else "differs"
    source = ", ".join(f"{n} {{table_4_1.analytical.{n}}}" for n in ours)
    text = ", ".join(f"{n} {v:.4g}" for n, v in ours.items())
    why = f"{HALF_DIGIT}; b of E.28 is printed with one digit there and gains a nought in the table"
    return "table 4.1", "analytical row", source, text, verdict, why


def damping_row(found: Found) -> Row:
    """Table 4.1, damping."""
    p, _, _, d_w = found.five
    off = 100.0 * (damping(float(p[0])) / d_w - 1.0)
    verdict = judged(float(np.max(np.abs(off))), value("figure_g_7.damping_error"))
    why = "rule: the source's largest error; the model lies below all five, as a fit to such points would not"
    source, ours = "{table_4_1.damping0} + {table_4_1.damping1} p", f"{off.min():.0f} to {off.max():.0f} % at 0.9 bar"
    return "table 4.1", "damping model against figure G.3's dampings", source, ours, verdict, why


def arm_rows(found: Found) -> list[Row]:
    """Section 4.3."""
    return [*inertia_rows(), bias_row(found), soft_row(found), slope_row(found)]


def inertia_rows() -> list[Row]:
    """4.11 with the wrong and the right inertia."""
    f, key = value("figure_4_12.f"), "identification.k_ab"
    right = 1e-3 * k_ab(f, joint_inertia())
    low, high = (1e-3 * k for k in k_ab_rounding("figure_4_12.f", JZZ2))
    ours = f"{1e-3 * k_ab(f, JZZ2):.2f} kN/m ({low:.2f} to {high:.2f} by the rounding of f)"
    verdict = "agrees" if low <= value(key) <= high else "differs"
    times = joint_inertia() / JZZ2
    why = f"4.11 leaves out m2 l12^2, which the source's own equation of motion has: {times:.1f} times the inertia"
    head = ("section 4.3", "k_A + k_B by 4.11")
    return [
        (head[0], f"{head[1]}, Jzz2 alone", f"{{{key}}}", ours, verdict, "rule: within the rounding of f"),
        (head[0], f"{head[1]}, inertia about the joint", f"{{{key}}}", f"{right:.1f} kN/m", rounds_to(right, key), why),
    ]


def bias_row(found: Found) -> Row:
    """The model's stiffness at the arm's point."""
    k, without = k_at(TABLE, found), k_at(TABLE, found, biased=False)
    low, high = (1e-3 * v for v in found.k_arm_given)
    ours = (
        f"{k:.2f} kN/m by the printed digits; {low:.1f} to {high:.1f} kN/m by all digits inside the rounding that meet"
        " figure G.3"
    )
    why = f"p (k0 + k1 h + k2 h^2), without b, gives {without:.2f} kN/m, which rounds to the source's number"
    key = "identification.k_model"
    return "section 4.3", "one muscle's stiffness by 4.5", f"{{{key}}}", ours, rounds_to(k, key), why


def soft_row(found: Found) -> Row:
    """Whether the model is too soft for the arm."""
    by = {r.what: r.numbers for r in found.arm}
    best, as_printed = by["digits nearest the bench, absolute gas law"], by["printed digits, gauge gas law"]
    off = max(abs(best[0] - value("figure_4_12.f")), abs(best[1] - value("figure_4_15.measured.f")))
    span = [(float(v.min()), float(v.max())) for v in found.f_reaching.T[2:]]
    ours = (
        f"{best[0]:.2f} Hz ({span[0][0]:.2f} to {span[0][1]:.2f}) and {best[1]:.2f} Hz ({span[1][0]:.2f} to"
        f" {span[1][1]:.2f}) with digits that meet figure G.3 and the absolute gas law; {as_printed[0]:.2f} and"
        f" {as_printed[1]:.2f} Hz as printed"
    )
    source = "model too soft; measured {figure_4_12.f} and, at 30 deg, {figure_4_15.measured.f}"
    verdict = "differs" if off <= 0.1 else "agrees"
    why = (
        "digits inside the rounding and the absolute gas law lift f to what was measured, without a stiffer muscle; no"
        " number of the arm was used to choose the digits; rule: agrees if this model misses by more than 0.1 Hz"
    )
    return "section 4.3", "the model predicts the stiffness too low", source, ours, verdict, why


def slope_row(found: Found) -> Row:
    """What the bench's stiffness says if it is the slope that closed valves give."""
    by = {r.what: r.numbers for r in found.arm}
    near, first = by["slope = k by digits nearest the bench"], by["slope by first principles"]
    ours = (
        f"{near[0]:.1f} Hz, k_A + k_B {near[4]:.1f} kN/m; by first principles {first[0]:.1f} Hz, {first[4]:.1f} kN/m;"
        f" measured: {by['measured'][4]:.1f} kN/m"
    )
    verdict = judged(abs(near[0] - value("figure_4_12.f")), 0.1)
    why = "rule: 0.1 Hz; bench and arm, both measured with closed valves, contradict each other by a factor of 2"
    what = "arm with the bench's k_w as slope dF/dh"
    return "section 4.3", what, "{figure_4_12.f}", ours, verdict, why
