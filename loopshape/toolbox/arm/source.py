"""Numbers that the arm's source publishes, from one table: `source.csv`, a row each with its place and page.

The source is S.N. van den Brink, DCT 2007.002 (2007). The model's own parameters (tables 3.3, 3.4, F.1 and what
else the simulation needs) stand with their place in `parameters`; here is what was measured, simulated, designed,
required or claimed, and what the reproduction is compared with. A number keeps the digits it was printed with.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from loopshape.core.errors import WrongUseError

#: what a number may be: of the source's rig, of its simulation, a design or setting, computed from others, and so on
KINDS = ("measured", "simulated", "chosen", "derived", "required", "claimed")
#: the 24 equilibria of the 1-DoF arm (section 4.3, figure 4.13): theta2 in deg, p_AB in bar
EQUILIBRIA: tuple[tuple[float, float], ...] = tuple(
    [(theta, p) for p in (0.8, 1.0, 1.2, 1.4) for theta in (-30.0, -15.0, 0.0, 15.0, 30.0)]
    + [(theta, 1.6) for theta in (-15.0, 0.0, 15.0)]
    + [(0.0, 1.8)]
)


@dataclass(frozen=True)
class Number:
    """One published number: `printed` as it stands, in `unit`; `place` and `page` say where, `kind` what it is."""

    key: str
    printed: str
    unit: str
    kind: str
    place: str
    page: int
    what: str

    @property
    def value(self) -> float:
        """The number."""
        return float(self.printed)

    @property
    def half_digit(self) -> float:
        """Half a unit of the last printed digit: what rounding alone leaves open."""
        decimals = len(self.printed.partition(".")[2])
        return 0.5 * 10.0**-decimals

    def __str__(self) -> str:
        return self.printed if self.unit == "1" else f"{self.printed} {self.unit}"


@cache
def numbers() -> dict[str, Number]:
    """All of them by key, in the order of the source."""
    text = files("loopshape.toolbox.arm").joinpath("source.csv").read_text(encoding="utf-8")
    return {row["key"]: _number(row) for row in csv.DictReader(text.splitlines())}


def _number(row: dict[str, str]) -> Number:
    key, printed, unit, kind, place, page, what = row.values()
    return Number(key, printed, unit, kind, place, int(page), what)


def number(key: str) -> Number:
    """One of them. Refuses a key that the table does not have."""
    table = numbers()
    if key not in table:
        near = [one for one in table if one.split(".")[0] == key.split(".")[0]]
        raise WrongUseError(
            "the source's table has no such number", key, f"one of {', '.join(near) or 'those in source.csv'}"
        )
    return table[key]


def value(key: str) -> float:
    """The value of one of them, in its own unit."""
    return number(key).value
