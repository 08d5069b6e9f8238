"""The scoreboard's rows, decided from the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from decoupling_measure import LIMIT_DB

from loopshape.toolbox.arm.source import value

Tables = Mapping[str, Sequence[Mapping]]


def scores(tables: Tables) -> list[dict[str, str]]:
    """One row for each claim."""
    return [outputs(tables), two_plants(tables), recommended(tables), satisfactory(tables)]


def row(item: str, quantity: str, source: str, ours: str, verdict: str, why: str) -> dict[str, str]:
    """A line of the scoreboard."""
    return {"item": item, "quantity": quantity, "source": source, "ours": ours, "verdict": verdict, "why": why}


def share(holds: Sequence[bool]) -> str:
    """All hold, some, or none."""
    return "agrees" if all(holds) else "partly" if any(holds) else "differs"


def of_band(tables: Tables, band: str) -> list[Mapping]:
    """Lines of the table of interactions for a band."""
    return [r for r in tables["interaction"] if r["band"] == band]


def counts(rows: Sequence[Mapping]) -> str:
    """How many points have which verdict."""
    words = [r["verdict"] for r in rows]
    return ", ".join(f"{words.count(w)} {w}" for w in ("decoupled", "coupled", "undecided") if w in words)


def worst(rows: Sequence[Mapping]) -> str:
    """The point of the largest k_I with its bounds."""
    top = max((r for r in rows if np.isfinite(r["k_i_db"])), key=lambda r: r["k_i_db"])
    return (
        f"{top['k_i_db']:.1f} dB ({top['low_db']:.1f} to {top['high_db']:.1f}) at"
        f" ({top['theta2_deg']:g} deg, {top['p_ab_bar']:g} bar)"
    )


def outputs(tables: Tables) -> dict[str, str]:
    """Section 5.1: the outputs are considered decoupled over the application range."""
    rows = of_band(tables, "bandwidth")
    return row(
        "section 5.1", "theta2 and p_AB considered decoupled",
        "lines of constant theta2 and p_AB approximately perpendicular over the whole range; no k_I given",
        f"{table_5_1()}: {counts(rows)} of {len(rows)} equilibria against {LIMIT_DB:g} dB;"
        f" largest |k_I| {worst(rows)}",
        share([r["verdict"] == "decoupled" for r in rows]),
        "rule: upper 95 % bound of |k_I| below the limit of H.7 at every point. Not where a muscle is near the supply's"
        " pressure: it fills far slower than it empties, so z_theta2 changes p_AB. "
        + ("Decoupled there with the highest supply tried" if cured(tables) else "More supply lowers it (supply.csv)"),
    )  # fmt: skip


def cured(tables: Tables) -> bool:
    """Whether the worst points are decoupled with the highest supply."""
    highest = max(r["supply_bar"] for r in tables["supply"])
    return all(r["verdict"] == "decoupled" for r in tables["supply"] if r["supply_bar"] == highest)


def table_5_1() -> str:
    """The source's bandwidth in words."""
    return f"{value('table_5_1.bandwidth_low'):g} to {value('table_5_1.bandwidth_high'):g} Hz"


def two_plants(tables: Tables) -> dict[str, str]:
    """Figure 5.2: the plant is two FRFs."""
    p12, p21 = ([r[k] for r in tables["points"]] for k in ("p12_over_p11_db", "p21_over_p22_db"))
    both = [max(a, b) < LIMIT_DB for a, b in zip(p12, p21, strict=True)]
    return row(
        "figure 5.2", "the plant is two FRFs, the others are zero", "P is given by theta2/z_theta2 and p_AB/z_p",
        f"P12/P11 up to {max(p12):.1f} dB, P21/P22 up to {max(p21):.1f} dB, medians over {table_5_1()};"
        f" both below {LIMIT_DB:g} dB at {sum(both)} of {len(both)} points",
        share(both),
        "both elements vanish at 0 deg only, where the muscles are alike; P12 is small nowhere else"
        " (rule: both below the limit of H.7)",
    )  # fmt: skip


def recommended(tables: Tables) -> dict[str, str]:
    """Chapter 6: the analysis that was recommended."""
    rows = of_band(tables, "range of H.7")
    return row(
        "chapter 6", "MIMO analysis with the interaction coefficient", "recommended, not done",
        f"done at {len(rows)} equilibria: up to {value('figure_h_7.up_to'):g} Hz {counts(rows)};"
        f" largest |k_I| {worst(rows)}",
        "not comparable", "the source gives no number",
    )  # fmt: skip


def satisfactory(tables: Tables) -> dict[str, str]:
    """Chapter 6: not perfect, but satisfactory, which allows SISO loop shaping."""
    closed = [
        r for r in tables["margins"] if r["matrix"] == "none" and r["other"] == "closed" and r["loop"] == "theta2"
    ]
    opened = [r for r in tables["margins"] if r["matrix"] == "none" and r["other"] == "open" and r["loop"] == "theta2"]
    holds = [
        r["peak_s_low_db"] <= value("required.sensitivity")
        and r["phase_margin_high_deg"] >= value("required.phase_margin")
        and r["stable"] != "unstable"
        for r in closed
    ]
    seen = [(c, o) for c, o in zip(closed, opened, strict=True) if c["bandwidth_hz"] > 0.0 and o["bandwidth_hz"] > 0.0]
    lost = max(1.0 - c["bandwidth_hz"] / o["bandwidth_hz"] for c, o in seen)
    phase = [c["phase_margin_deg"] - o["phase_margin_deg"] for c, o in seen]
    return row(
        "chapter 6", "decoupling not perfect, but satisfactory: SISO loop shaping is allowed",
        "claimed; single loops stable at every equilibrium",
        f"with p_AB closed the angle loop keeps |S| and phase margin (95 %) at {sum(holds)} of {len(holds)} points;"
        f" phase margin {min(phase):+.1f} to {max(phase):+.1f} deg, bandwidth at most {100.0 * lost:.0f} % lower"
        f" (crossings in sight: {len(seen)} points)",
        share(holds), "rule: no requirement missed by more than its 95 % interval with the other loop closed",
    )  # fmt: skip
