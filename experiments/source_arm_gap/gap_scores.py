"""What this study says of the source's section 4.4, for the scoreboard: from the tables that it wrote."""

from __future__ import annotations

import csv
from pathlib import Path

COLUMNS = ("item", "quantity", "source", "ours", "verdict", "why")
SURE = 0.95  # a cause is called found from this probability on, under every set of assumptions


def rows(folder: Path) -> list[tuple[str, ...]]:
    """Lines of scores.csv: the cause of the frequencies, and of kappa."""
    results, posterior = _read(folder / "results.csv"), _read(folder / "posterior.csv")
    gas = min(float(p) for name, p in _row(posterior, effect="gas_law").items() if name != "effect")
    without, stiff = (_row(results, digits="own", effects=e) for e in ("none", "stiffness_error"))
    absolute = min(
        (r for r in results if r["digits"] == "own" and r["effects"] == "gas_law"),
        key=lambda r: float(r["chi2_frequency"]),
    )
    return [
        (
            "section 4.4", "cause of the eigenfrequencies",
            "the muscles' stiffness is modelled too low; f {figure_4_14.f} and {figure_4_15.simulated.f} simulated, "
            "{figure_4_12.f} and {figure_4_15.measured.f} measured",
            f"the gas law's gauge pressure, probability {gas:.2f} or more; squared misfit of five frequencies "
            f"{float(without['chi2_frequency']):.0f} without, {float(stiff['chi2_frequency']):.0f} with a stiffness "
            f"factor, {float(absolute['chi2_frequency']):.1f} with the gas law",
            "differs" if gas > SURE else "not comparable",
            "A factor on the stiffness lifts all frequencies and keeps their fall towards 30 deg; absolute pressure in "
            "p dV/dt turns it into a rise, as measured.",
        ),
        (
            "section 4.4", "cause of kappa",
            "flows or volumes modelled wrongly; {figure_4_14.kappa} and {figure_4_15.simulated.kappa} simulated, "
            "{figure_4_12.kappa} and {figure_4_15.measured.kappa} measured",
            f"model over measured {float(without['kappa_over_measured']):.2g} at (0, 1.0); ratio of both points "
            f"{float(without['kappa_ratio']):.2f}, with the gas law {float(absolute['kappa_ratio']):.2f}",
            "not comparable",
            "The size may come from flows or volumes, and nothing published parts them; the ratio is repaired by no "
            "effect of the catalogue. The shape of h0(p) below 0.3 bar is the first suspect.",
        ),
    ]  # fmt: skip


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _row(table: list[dict[str, str]], **keys: str) -> dict[str, str]:
    return next(row for row in table if all(row[name] == required for name, required in keys.items()))
