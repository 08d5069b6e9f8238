"""The scoreboard's rows for appendices E and G, and all of the study's rows."""

from __future__ import annotations

from collections.abc import Iterable

import muscle_models as models
import numpy as np
from muscle_findings import FIVE_MM, Found
from muscle_law import LAWS, damping, slope_open, volume_slopes
from muscle_models import closed_air, taylor
from muscle_points import BAND, coverage
from muscle_records import reliable_to_hz
from muscle_scores import ANALYTICAL, FIT_ERROR, HALF_DIGIT, PICTURE, Row, analytical_error, judged, rounds_to
from muscle_scores import rows_of_chapters as chapters

from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS
from loopshape.toolbox.arm.source import number, value

K_TEXT = ", ".join(f"{{figure_g_3.k_{h}}}" for h in FIVE_MM)
D_TEXT = ", ".join(f"{{figure_g_3.d_{h}}}" for h in FIVE_MM)
DAMPING_BELOW = "rule: the damping model's largest error; the printed model lies below all five"
STEADY = 0.99  # coherence that counts as excellent


def scores(found: Found) -> list[Row]:
    """All rows of the study."""
    appendix = [apart_row(found), below_row(found), same_row(), secant_row(found), *taylor_rows()]
    bench = [coherence_row(found), rises_row(found), *five_rows(found), *interval_rows(found), shape_row(found)]
    return [*chapters(found), *appendix, *bench, *error_rows(found)]


def listed(values: Iterable[float], digits: int) -> str:
    """Numbers in a row."""
    return ", ".join(f"{v:.{digits}f}" for v in values)


def apart_row(found: Found) -> Row:
    """Appendix E.1 over the grid."""
    by = {(c.model, c.quantity): c.numbers for c in found.comparisons}
    pull, slope = by[("Chou-Hannaford", "pull")], by[("Chou-Hannaford", "slope")]
    limit = value("existing_models_above")
    ours = (
        f"pull apart by more than 20 % on {100 * pull[0]:.0f} % of the grid below {limit:g} bar and"
        f" {100 * pull[1]:.0f} % above; slope on {100 * slope[0]:.0f} and {100 * slope[1]:.0f} %"
    )
    why = "no muscle measured above 1.4 bar is published here: nobody can tell which of both is right there"
    what = "Chou and Hannaford beside the source's model, 0.2 to 4 bar"
    return "appendix E.1", what, "fits measurements above {e_1.valid_above}", ours, "not comparable", why


def below_row(found: Found) -> Row:
    """Appendix E.1 on figure G.3, with what the bench adds."""
    p, h, k, _ = found.five
    off = 100.0 * (closed_air(p, h)["cylinder, isothermal"] / k - 1.0)
    barrel = 100.0 * (closed_air(p, h)["barrel, isothermal"] / k - 1.0)
    ours = (
        "cylinder, closed air (isothermal, absolute pressure) and the tube of E.28:"
        f" {off.min():.0f} to {off.max():+.0f} % of figure G.3, nothing fitted; the source's"
        f" barrel instead: {barrel.min():.0f} to {barrel.max():.0f} %"
    )
    verdict = "differs" if np.max(np.abs(off)) <= 10.0 else "agrees"
    why = (
        "rule: agrees if it misses by more than 10 %; the closed air's spring, left out in E.18, makes k_w rise with h"
    )
    source = "existing models predict only above {existing_models_above}"
    return "appendix E.1", "existing model at 0.9 bar", source, ours, verdict, why


def same_row() -> Row:
    """Appendix E.2."""
    p, h = np.array([[0.5], [2.0]]), np.array([0.17, 0.19, 0.21])
    off = float(np.max(np.abs(models.petrovic(p, h) / models.chou_hannaford(p, h) - 1.0)))
    what = "Petrovic's polynomial is Chou and Hannaford's model"
    ours = f"largest relative difference {off:.0e}"
    return "appendix E.2", what, "the same in powers of h - h_r", ours, judged(off, 1e-12), "rule: 1e-12"


def secant_row(found: Found) -> Row:
    """Appendix E.3: slope and secant."""
    k = np.array([r.k for r in found.rows["gauge"]])
    over = np.array([slope_open(p, h) for p, h in found.points]) / k
    ours = f"slope of (3.47) at constant pressure: {over.min():.2f} to {over.max():.2f} k, median {np.median(over):.2f}"
    why = "rule: 5 %; k is derived as a slope and used as a secant, which is the same only where k does not depend on h"
    what = "k as slope dF/dh (E.18) and as factor of h - h0 (3.47)"
    return "appendix E.3", what, "one quantity", ours, judged(float(np.max(np.abs(over - 1.0))), 0.05), why


def thread_length_range_mm() -> tuple[float, float]:
    """Thread lengths L inside the rounding of the printed one that give E.24's printed k2."""
    middle = {row.name: row.value for row in ARM1_PARAMETERS.rows}["braid_length_mm"]
    lengths = middle + np.linspace(-0.05, 0.05, 4001)
    at, key = value("e_4.reference_length"), "e_24.k2"
    k2 = np.array([-0.5 * volume_slopes(at, float(length))[4] for length in lengths])
    fits = lengths[np.abs(k2 - value(key)) <= number(key).half_digit]
    return (float(fits[0]), float(fits[-1])) if fits.size else (float("nan"), float("nan"))


def taylor_rows() -> list[Row]:
    """Appendix E.4."""
    t, (low, high) = taylor(), thread_length_range_mm()
    why = f"{HALF_DIGIT}; k2 needs a thread of {low:.4f} to {high:.4f} mm, inside the rounding of the printed length"
    rows = []
    for group, what in (
        ("e_24", "Taylor coefficients at the reference length (E.24)"),
        ("e_27", "in powers of h (E.27)"),
    ):
        right = [rounds_to(t[f"{group}.k{n}"], f"{group}.k{n}") == "agrees" for n in range(3)]
        verdict = "agrees" if all(right) else "partly" if any(right) else "differs"
        source = ", ".join(f"k{n} {{{group}.k{n}}}" for n in range(3))
        ours = f"k0 {t[f'{group}.k0']:.5f} m, k1 {t[f'{group}.k1']:.5f}, k2 {t[f'{group}.k2']:.4f} 1/m"
        rows.append(("appendix E.4", what, source, ours, verdict, why))
    b = t["e_28.b"]
    return [*rows, ("appendix E.4", "bias b (E.28)", "{e_28.b}", f"{b:.3f} bar", rounds_to(b, "e_28.b"), HALF_DIGIT)]


def coherence_row(found: Found) -> Row:
    """Figure G.1."""
    one = next(r for r in found.rows["gauge"] if r.p_bar == 0.8 and round(1e3 * r.h_m) == 170)
    good = reliable_to_hz(one.both, STEADY)
    f = found.noisy.h1.frequency_hz
    poor = float(np.median(found.noisy.coherence[(f > 1.0) & (f < value("bench.fit_to"))]))
    ours = f"{good:.1f} Hz (coherence above {STEADY:g}); with poor sensors {poor:.2f} throughout"
    verdict = judged(abs(good - value("bench.reliable_to")), 1.0)
    why = "rule: 1 Hz; our noise is flat up to its limit, the source describes neither its actuator nor its sensors"
    return "figure G.1", "reliable up to", "{bench.reliable_to}", ours, verdict, why


def rises_row(found: Found) -> Row:
    """Figure G.2."""
    rows = found.rows["gauge"]
    over_p = [np.diff([r.found.k for r in rows if r.h_m == h]) > 0.0 for h in sorted({r.h_m for r in rows})]
    over_h = [np.diff([r.found.k for r in rows if r.p_bar == p]) > 0.0 for p in sorted({r.p_bar for r in rows})]
    rises, longer = (float(np.mean(np.concatenate(x))) for x in (over_p, over_h))
    ours = f"in {100 * rises:.0f} % of the steps in pressure and {100 * longer:.0f} % of those in length"
    verdict = "agrees" if min(rises, longer) == 1.0 else "partly" if max(rises, longer) == 1.0 else "differs"
    why = "table 4.1's stiffness is smallest near 160 mm: from 150 to 160 mm it falls, figure G.3's rises"
    return "figure G.2", "magnitude rises with pressure and with length", "it does", ours, verdict, why


def five_rows(found: Found) -> list[Row]:
    """Figure G.3."""
    p, h, k, d = found.five
    at = {law: [r for r in rows if r.p_bar == p[0] and r.h_m < 0.195] for law, rows in found.rows.items()}
    k_w, closed = (np.array([r.found.k for r in at[law]]) for law in LAWS[:2])
    d_w = np.array([r.found.d for r in at[LAWS[0]]])
    limits = value("figure_g_6.fitted_error"), value("figure_g_7.damping_error")
    offs = [100.0 * float(np.max(np.abs(v - 1.0))) for v in (k_w / k, d_w / d)]
    ours = (
        f"{listed(1e-3 * k_w, 2)} kN/m by a bench that measures k; {listed(1e-3 * closed, 2)} kN/m with closed valves,"
        " gauge gas law"
    )
    near = f"{listed(1e-3 * found.nearest.stiffness(p, h), 2)} kN/m"
    best = judged(100.0 * found.nearest_misfit, limits[0])
    damped = f"{listed(d_w, 1)} N s/m"
    return [
        (
            "figure G.3",
            "k_w at 0.9 bar, 150 to 190 mm, printed digits",
            K_TEXT,
            ours,
            judged(offs[0], limits[0]),
            FIT_ERROR,
        ),
        ("figure G.3", "the same, digits inside the rounding nearest to it", K_TEXT, near, best, FIT_ERROR),
        ("figure G.3", "d_w at 0.9 bar, printed damping", D_TEXT, damped, judged(offs[1], limits[1]), DAMPING_BELOW),
    ]


def interval_rows(found: Found) -> list[Row]:
    """Figure G.4."""
    k_held, d_held = np.mean([coverage(r) for r in found.rows.values()], axis=0)
    k_half, d_half = (np.median([BAND * getattr(r.found, n) for r in found.every]) for n in ("k_std", "d_std"))
    ours = (
        f"{100 * k_held:.0f} % and {100 * d_held:.0f} % of {3 * len(found.points)}; half widths {k_half:.0f} N/m and"
        f" {d_half:.2f} N s/m by the assumed sensors"
    )
    slope, half = damping_slope(found)
    verdict = judged(abs(slope - value("table_4_1.damping1")), half)
    text, rule = f"{slope:.2f} ± {half:.2f} N s/(m bar)", "rule: our 95 % interval"
    what = "95 % intervals of k_w and d_w that hold the truth"
    return [
        ("figure G.4", what, "no intervals; damping hard to identify", ours, "not comparable", PICTURE),
        ("figure G.4", "slope of d_w over pressure found again", "{table_4_1.damping1}", text, verdict, rule),
    ]


def damping_slope(found: Found) -> tuple[float, float]:
    """Slope of d_w over pressure in N s/(m bar) with its 95 % half width."""
    rows = found.rows["gauge"]
    p, d = np.array([r.p_bar for r in rows]), np.array([r.found.d for r in rows])
    w = np.array([r.found.d_std for r in rows]) ** -2.0
    spread = p - float(w @ p / w.sum())
    total = float(w @ spread**2)
    return float((w * spread) @ d / total), float(BAND / np.sqrt(total))


def shape_row(found: Found) -> Row:
    """Figure G.5."""
    worst = {
        law: 100.0 * float(np.max(np.abs(fit.residual) / np.array([r.found.k for r in found.rows[law]])))
        for law, fit in found.fits.items()
    }
    ours = f"largest residual {worst['gauge']:.1f} % (gauge) and {worst['absolute']:.1f} % (absolute gas law)"
    verdict = judged(worst["gauge"], value("figure_g_6.fitted_error"))
    why = (
        "rule: the source's residual; six parameters nearly fit a slope that is no polynomial: a good fit proves little"
    )
    source = "it is; residual up to {figure_g_6.fitted_error}"
    return "figure G.5", "k_w linear in pressure, quadratic in length", source, ours, verdict, why


def error_rows(found: Found) -> list[Row]:
    """Figures G.6 and G.7."""
    p, h, k, d = found.five
    five = -100.0 * (ANALYTICAL.stiffness(p, h) / k - 1.0)
    grid = -100.0 * analytical_error(found, nearest=True)
    off = 100.0 * (damping(float(p[0])) / d - 1.0)
    ends = value("figure_g_6.analytical_low"), value("figure_g_6.analytical_error")
    apart = max(abs(float(grid.min()) - ends[0]), abs(float(grid.max()) - ends[1]))
    ours = (
        f"{five.min():.0f} to {five.max():.0f} % lower at figure G.3's points; {grid.min():.0f} to {grid.max():.0f} %"
        " over the grid against the digits nearest to them"
    )
    fitted, near = f"{100 * found.nearest_misfit:.1f} % at five points", 100.0 * found.nearest_misfit
    source = "{figure_g_6.analytical_low} to {figure_g_6.analytical_error} lower"
    limit = value("figure_g_6.fitted_error")
    damped = judged(float(np.max(np.abs(off))), value("figure_g_7.damping_error"))
    below = f"{off.min():.0f} to {off.max():.0f} % at five points"
    best = "error of the fitted stiffness, best digits inside the rounding"
    return [
        ("figure G.6", "error of the analytical stiffness", source, ours, judged(apart, limit), FIT_ERROR),
        ("figure G.6", best, "{figure_g_6.fitted_error} at most", fitted, judged(near, limit), FIT_ERROR),
        (
            "figure G.7",
            "error of the damping model",
            "{figure_g_7.damping_error} at most",
            below,
            damped,
            DAMPING_BELOW,
        ),
    ]
