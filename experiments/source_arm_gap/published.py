"""The source's published numbers of its own arm, the errors assumed for them, and what a model says of each.

S.N. van den Brink, DCT 2007.002 (2007), sections 4.3 and 4.4. Misfits are (model - published)/error, so that their
squares add; a bound counts on its wrong side only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array, db
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.arm.source import EQUILIBRIA, number, value

UPRIGHT, WIDE = (0.0, 1.0), (30.0, 0.8)


def _fit(place: str) -> tuple[float, float, float]:
    """kappa, f in Hz and zeta of a printed third-order fit."""
    return value(f"{place}.kappa"), value(f"{place}.f"), value(f"{place}.zeta")


MEASURED = {UPRIGHT: _fit("figure_4_12"), WIDE: _fit("figure_4_15.measured")}
SIMULATED = {UPRIGHT: _fit("figure_4_14"), WIDE: _fit("figure_4_15.simulated")}  # by the source itself
F_ERROR_HZ = 0.1  # two digits are printed, and the text once has another f for the same fit (figure_4_15.f_text)
LOW_HZ, HIGH_HZ = value("identification.f_low"), value("identification.f_high")
RANGE_ERROR_HZ = 0.25  # of both ends, half a unit is 0.5
AWAY_HZ, AWAY_ERROR_HZ = 0.2, 0.2  # "slightly increases" from 0 to 30 deg
KAPPA_ERROR = 0.1  # of each, relative
GAIN_SPAN_DB, GAIN_SPAN_ERROR_DB = value("identification.gain_span"), 2.0  # "a factor 3" in the low-frequency gain
MASS_SPAN_DB, MASS_SPAN_ERROR_DB = 0.0, 1.5  # "the mass line is identical", by eye
ZETA_ERROR = 0.3  # relative: fits of one resonance, and friction makes them depend on the amplitude
#: half a unit of the last printed digit of table 4.1
_PRINTED = {
    "stiffness_b_bar": "b", "stiffness_k0": "k0", "stiffness_k1": "k1", "stiffness_k2": "k2", "stiffness_c0": "c0",
    "stiffness_c1": "c1",
}  # fmt: skip
ROUNDING = {name: number(f"table_4_1.experiment.{key}").half_digit for name, key in _PRINTED.items()}


@dataclass(frozen=True, eq=False)
class Numbers:
    """kappa, f in Hz and zeta (24, 3) of one model at the source's equilibria; nan where it has none."""

    table: Array

    def at(self, point: tuple[float, float]) -> Array:
        """kappa, f, zeta at one point."""
        return self.table[EQUILIBRIA.index(point)]

    def frequency_misfits(self) -> Array:
        """Both fits, the range over 24 equilibria, and the rise away from 0 deg, (5,)."""
        f = self.table[:, 1]
        return np.array([
            *((self.at(p)[1] - MEASURED[p][1]) / F_ERROR_HZ for p in (UPRIGHT, WIDE)),
            min(0.0, (f.min() - LOW_HZ) / RANGE_ERROR_HZ),
            max(0.0, (f.max() - HIGH_HZ) / RANGE_ERROR_HZ),
            (self.away_hz - AWAY_HZ) / AWAY_ERROR_HZ,
        ])  # fmt: skip

    def gain_misfits(self) -> Array:
        """kappa's ratio of both fits, spans of low-frequency gain and of kappa, (3,): no flow's size is in them."""
        ratio = np.log(self.at(WIDE)[0] / self.at(UPRIGHT)[0]) - np.log(MEASURED[WIDE][0] / MEASURED[UPRIGHT][0])
        return np.array([
            ratio / (KAPPA_ERROR * np.sqrt(2.0)),
            (self.gain_span_db - GAIN_SPAN_DB) / GAIN_SPAN_ERROR_DB,
            (self.mass_span_db - MASS_SPAN_DB) / MASS_SPAN_ERROR_DB,
        ])  # fmt: skip

    def damping_misfits(self) -> Array:
        """Relative damping of both fits, (2,)."""
        return np.array([(self.at(p)[2] / MEASURED[p][2] - 1.0) / ZETA_ERROR for p in (UPRIGHT, WIDE)])

    @property
    def away_hz(self) -> float:
        """Mean rise of f from 0 to +-30 deg at 0.8 to 1.4 bar."""
        f = self._of(1)
        return float(np.mean([0.5 * (f[-30.0, p] + f[30.0, p]) - f[0.0, p] for p in (0.8, 1.0, 1.2, 1.4)]))

    @property
    def per_bar_hz(self) -> float:
        """Mean rise of f with p_AB, 0.8 to 1.4 bar, Hz per bar."""
        f = self._of(1)
        return float(np.mean([(f[t, 1.4] - f[t, 0.8]) / 0.6 for t in (-30.0, -15.0, 0.0, 15.0, 30.0)]))

    @property
    def gain_span_db(self) -> float:
        """Largest over smallest low-frequency gain kappa/w^2."""
        gain = self.table[:, 0] / self.table[:, 1] ** 2
        return float(db(gain.max() / gain.min()))

    @property
    def mass_span_db(self) -> float:
        """Largest over smallest kappa."""
        return float(db(self.table[:, 0].max() / self.table[:, 0].min()))

    def _of(self, column: int) -> dict[tuple[float, float], float]:
        return dict(zip(EQUILIBRIA, self.table[:, column].tolist(), strict=True))


def numbers(moves: Mapping[str, float]) -> Numbers:
    """The linearised arm's numbers with parameters moved; nan where it cannot stand or would fall over."""
    c = constants(ARM1_PARAMETERS.vector(moves))
    with np.errstate(invalid="ignore"):
        return Numbers(np.array([linearise(c, *p).third_order() for p in EQUILIBRIA]))


def digits(shares: Array) -> dict[str, float]:
    """Table 4.1 moved by shares (6,), -1..1, of half a unit of each last digit."""
    row = {r.name: r.value for r in ARM1_PARAMETERS.rows}
    return {name: row[name] + half * float(q) for (name, half), q in zip(ROUNDING.items(), shares, strict=True)}


def own_misfits(shares: Array) -> Array:
    """How far these digits, gauge gas law, are from the source's own simulated f, in half units of its digit, (2,)."""
    c = constants(ARM1_PARAMETERS.vector(digits(shares)))
    half = number("figure_4_14.f").half_digit
    return np.array([(linearise(c, *p).third_order()[1] - SIMULATED[p][1]) / half for p in (UPRIGHT, WIDE)])
