"""Lines for the scoreboard: what the source says of its equilibria, and what the model says; verdicts by code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from standing import ANALYTICAL, MODELS, arm, firmness, gain_limit, rests, supply_bar

from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics.equilibrium import angle_deg, angle_map, pressures
from loopshape.toolbox.arm.source import EQUILIBRIA, number, value

POINTS = (
    "theta2_deg", "p_ab_bar", "p_a_fitted_bar", "p_b_fitted_bar", "p_a_analytical_bar", "p_b_analytical_bar",
    "fitted_within_supply", "analytical_at_the_fitted_pressures_deg", "shift_deg", "firm_fitted_nm_rad",
    "firm_fitted_closed_nm_rad", "firm_fitted_closed_absolute_nm_rad", "firm_analytical_nm_rad",
    "firm_analytical_closed_nm_rad", "firm_analytical_closed_absolute_nm_rad", "off_square_fitted_deg",
    "off_square_analytical_deg", "largest_gain_fitted_v_rad", "largest_gain_analytical_v_rad",
)  # fmt: skip
DIGIT = number("equilibria.pressure_low").half_digit
Row = list[object]


def any_pair(s: dict, c: Array) -> tuple[float, float]:
    """Shares of all pairs of pressures of the supply with a rest within 45 deg, and with a stable one."""
    grid = np.linspace(s["supply"]["low_bar"], supply_bar(), s["supply"]["count"])
    angle = angle_map(c, grid, grid)
    found = [(angle[j, k], a + b) for j, b in enumerate(grid) for k, a in enumerate(grid) if np.isfinite(angle[j, k])]
    firm = [firmness(c, t, p).pressure > 0.0 for t, p in found]
    return len(found) / angle.size, sum(firm) / angle.size


def column(rows: Sequence[Row], name: str) -> Array:
    """A column of the points' table."""
    return np.array([row[POINTS.index(name)] for row in rows], dtype=float)


def scores(s: dict, points: list[Row], plane: list[Row], moves: list[Row]) -> list[Row]:
    """The scoreboard's lines; a verdict that is a number is decided here."""
    return [
        *score_maps(s, points),
        *score_difference(plane),
        *score_analytical(s, points),
        score_square(points),
        *score_causes(moves),
    ]


def score_maps(s: dict, points: list[Row]) -> list[Row]:
    """Figures 4.7 and 4.8."""
    rest, firm = any_pair(s, arm())
    inside = column(points, "fitted_within_supply") > 0.0
    low, high = pressure_span(points, "fitted", inside)
    both = low >= value("equilibria.pressure_low") - DIGIT and high <= value("equilibria.pressure_high") + DIGIT
    return [
        [
            "figure 4.7", "every pair of pressures of the supply is a stable rest",
            "whatever p_A and p_B are up to the supply, the arm has a stable equilibrium",
            f"a rest within 45 deg for {100 * rest:.0f} % of the pairs, a stable one for {100 * firm:.0f} %",
            "agrees" if firm == 1.0 else "partly",
            "pairs far apart carry it beyond 45 deg; below 0.17 bar in each muscle the fitted stiffness is unstable",
        ],
        [
            "figure 4.8", "points that a supply of 1 bar can hold",
            "{identification.count} equilibria identified, {equilibria.count} verified, all with a supply of 1 bar",
            f"{int(inside.sum())} of {len(points)}; the other four ask for {top(points, ~inside)} bar",
            "agrees" if inside.all() else "partly" if inside.sum() == value("equilibria.count") else "differs",
            "as many as were verified, but the source identified at all; which ones it verified the text does not say "
            "(it counts the circles of figure 4.9 as either number)",
        ],
        [
            "figure 4.8", "pressures in the verified equilibria, fitted stiffness",
            "{equilibria.pressure_low} to {equilibria.pressure_high}", f"{low:.2f} to {high:.2f} bar",
            "agrees" if both else "differs",
            "fitted stiffness needs pressures further apart than the arm did: the mismatch of figure 4.9",
        ],
    ]  # fmt: skip


def top(points: list[Row], chosen: Array) -> str:
    """Range of the highest pressure of some points, fitted."""
    high = np.maximum(column(points, "p_a_fitted_bar"), column(points, "p_b_fitted_bar"))[chosen]
    return f"{high.min():.2f} to {high.max():.2f}"


def pressure_span(points: list[Row], model: str, chosen: Array) -> tuple[float, float]:
    """Lowest and highest pressure in bar of some points."""
    both = np.array([column(points, f"p_{k}_{model}_bar")[chosen] for k in "ab"])
    return float(both.min()), float(both.max())


def score_difference(plane: list[Row]) -> list[Row]:
    """Figure 4.9 and chapter 6, with the analytical arm standing in for the measured one."""
    inside, outside, close, apart = (row for row in plane if row[1] == "analytical")
    half, whole = 0.5 * value("equilibria.angular_shift"), value("equilibria.angular_shift")

    def verdict(near: Row, far: Row) -> str:
        small, large = float(str(near[5])) <= half, float(str(far[5])) >= whole
        return "agrees" if small and large else "partly" if large else "differs"

    said = (
        "analytical stands in for measured, which is drawn only; agrees: largest shift inside at most half the source's"
    )
    return [
        [
            "figure 4.9", "where the fitted stiffness predicts the equilibria",
            "accurate within {equilibria.model_good_angle} from {equilibria.model_good_from} to "
            "{equilibria.model_good_to}; a shift of {equilibria.angular_shift} elsewhere",
            f"inside median {inside[4]}, largest {inside[5]} deg; outside median {outside[4]}, largest "
            f"{outside[5]} deg and {outside[3]} of {outside[2]} places without rest within 45 deg",
            verdict(inside, outside),
            f"{said}, outside at least the whole; it grows steadily with the angle, without a border, and changes sign "
            "near p_AB 0.63 bar",
        ],
        [
            "chapter 6", "pressure difference up to which the model predicts", "below {model.good_difference}",
            f"below median {close[4]}, largest {close[5]} deg; above median {apart[4]}, largest {apart[5]} deg "
            f"and {apart[3]} of {apart[2]} places without rest within 45 deg",
            verdict(close, apart),
            f"{said}; {low_pressure()}",
        ],
    ]  # fmt: skip


def low_pressure() -> str:
    """Why a limit on the difference alone is too wide: the lowest p_AB of the good range, at the largest angle."""
    low, widest, c = value("equilibria.model_good_from"), max(t for t, _ in EQUILIBRIA), arm()
    p_a, p_b = pressures(c, widest, low)
    other = angle_deg(arm(ANALYTICAL), p_a, p_b)
    return (
        f"at p_AB {low:g} bar a difference of {p_a - p_b:.2f} bar already turns the fitted arm by {widest:g} deg and "
        f"the analytical one by {other:.0f}"
    )


def score_analytical(s: dict, points: list[Row]) -> list[Row]:
    """Figure 4.10: match with what was measured, and the source's word that the analytical arm is unstable."""
    inside = column(points, "fitted_within_supply") > 0.0
    low, high = pressure_span(points, "analytical", inside)
    near = max(abs(low - value("equilibria.pressure_low")), abs(high - value("equilibria.pressure_high"))) <= DIGIT
    firm = column(points, "firm_analytical_nm_rad")
    gains = column(points, "largest_gain_analytical_v_rad")
    own = gain_limit(*(value(f"figure_4_15.simulated.{k}") for k in ("kappa", "f", "zeta")))
    turned = fold(s, points)
    return [
        [
            "figure 4.10", "pressures in the verified equilibria, analytical stiffness",
            "{equilibria.pressure_low} to {equilibria.pressure_high}; match with the measured ones striking",
            f"{low:.2f} to {high:.2f} bar", "agrees" if near else "differs",
            "only the range is printed; half a printed digit",
        ],
        [
            "section 4.4", "the analytical arm is unstable", "unstable, gravity dominates over the muscles",
            f"stable at all {len(points)} points: {firm.min():.1f} to {firm.max():.1f} N m/rad at constant pressure "
            f"with gravity's -0.9 in it, more with closed valves; {turned}",
            "agrees" if (firm < 0.0).any() else "differs",
            f"a loop with a plain gain bears {gains.min():.1f} to {gains.max():.1f} V/rad only, the source's own "
            f"simulation at (30 deg, 0.8 bar) {own:.1f}: a gain between falls over in one and not in the other",
        ],
    ]  # fmt: skip


def fold(s: dict, points: list[Row]) -> str:
    """Whether the analytical arm rests at all at the pressures that hold the fitted one, to far beyond 45 deg."""
    grid = np.linspace(-s["fold"]["widest_deg"], s["fold"]["widest_deg"], s["fold"]["count"])
    c, none, angles = arm(ANALYTICAL), 0, []
    for row in points:
        stays = [t for t, firm in rests(c, float(str(row[2])), float(str(row[3])), grid) if firm]
        none += not stays
        angles += stays
    grid = grid[::2]
    pairs = np.linspace(s["supply"]["low_bar"], supply_bar(), s["supply"]["count"])
    falls = [not any(firm for _, firm in rests(c, a, b, grid)) for a in pairs for b in pairs]
    share = f"it finds none up to {grid[-1]:.0f} deg for {100 * np.mean(falls):.0f} % of all pairs of the supply"
    stands = f"at the fitted arm's pressures it stands at up to {max(map(abs, angles)):.0f} deg"
    return f"{stands}, {none} without rest; {share}"


def score_square(points: list[Row]) -> Row:
    """Figure 5.1: lines of theta2 and p_AB."""
    inside = column(points, "fitted_within_supply") > 0.0
    theta = np.abs(column(points, "theta2_deg"))[inside]
    off = {m: np.abs(column(points, f"off_square_{m}_deg"))[inside] for m in MODELS}
    at = {m: [f"{off[m][theta == t].max():.0f}" for t in (0.0, 15.0, 30.0)] for m in MODELS}
    only_at_zero = off["fitted"][theta == 0.0].max() < 1.0 < off["fitted"][theta > 0.0].min()
    return [
        "figure 5.1", "lines of theta2 and p_AB perpendicular",
        "model at 0 deg only; measured approximately in the whole range",
        "off 90 deg at 0, 15, 30 deg by " + "; ".join(f"{', '.join(at[m])} deg ({m})" for m in MODELS),
        "partly" if only_at_zero else "differs",
        "the model's half agrees; the stand-in for the measured arm is squarer and not square, in axes of equal scale",
    ]  # fmt: skip


def score_causes(moves: list[Row]) -> list[Row]:
    """Section 4.2: what the source suspects, one at a time."""
    table = {str(row[0]): np.array(row[2:], dtype=float) for row in moves}
    wanted, held = table["analytical k"], table["k of one length"]
    length, stiff = table["both shorter by the spread of h0"], table["both stiffer by the spread of k"]
    one = np.concatenate([table["A longer by the spread of h0"], table["A shorter by the spread of h0"]])
    left, size = np.abs(held - wanted).max(), np.abs(wanted).max()
    return [
        [
            "section 4.2", "the nominal length as the cause", "spread of h0 of {muscles.nominal_length_spread} and k",
            f"one muscle: {np.nanmin(np.abs(one)):.1f} to {np.nanmax(np.abs(one)):.1f} deg, to one side at all angles; "
            f"both muscles: {np.abs(length).max():.1f} deg, odd in the angle; wanted {size:.1f} deg, odd",
            "agrees" if np.abs(length).max() >= size else "partly" if np.nanmax(np.abs(one)) >= size else "differs",
            "agrees where both muscles alike make the wanted shift, partly where one alone makes its size: unequal "
            "muscles move 0 deg too, where the model is good",
        ],
        [
            "section 4.2", "the stiffness as the cause",
            "fitted from {equilibria.stiffness_data_from} to {equilibria.stiffness_data_to} and used below; spread of "
            "k {muscles.stiffness_spread}",
            f"a factor moves nothing ({np.abs(stiff).max():.1f} deg); without k's dependence on the length the fitted "
            f"arm stands within {left:.1f} deg of the analytical one",
            "agrees" if left < 0.2 * size else "differs",
            "agrees: what is left is below a fifth of the shift at p_AB 1.0 bar; the length does it, not the pressure",
        ],
    ]  # fmt: skip
