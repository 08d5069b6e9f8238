"""A channel: one signal of a rig, whose column name ends in its unit (`theta_rad`, `p_a_bar`)."""

from __future__ import annotations

from dataclasses import dataclass

from loopshape.core.errors import WrongUseError
from loopshape.core.units import SUFFIXES


@dataclass(frozen=True)
class Channel:
    """A signal's name and its stored unit's suffix; `column` is the name it has in a table."""

    name: str
    unit: str

    @property
    def column(self) -> str:
        """Name of the column in a recording's table."""
        return f"{self.name}_{self.unit}"

    @property
    def label(self) -> str:
        """Name and unit as an axis shows them."""
        return f"{self.name} [{SUFFIXES[self.unit]}]"

    @classmethod
    def from_column(cls, column: str) -> Channel:
        """Split `theta_rad` into name and unit; refuses a column that ends in no known unit."""
        for suffix in SUFFIXES:  # the longest suffixes stand first
            if column.endswith("_" + suffix) and len(column) > len(suffix) + 1:
                return cls(column[: -len(suffix) - 1], suffix)
        raise WrongUseError(
            "a column's name must end in its unit",
            f"{column!r}",
            f"end it in one of {', '.join('_' + s for s in SUFFIXES)}",
        )


def unit_of(column: str) -> str:
    """Suffix of a column's unit; "1" of a name that ends in none, as other programs give."""
    return next((suffix for suffix in SUFFIXES if column.endswith("_" + suffix)), "1")


def sum_terms(expression: str) -> tuple[str, ...]:
    """Columns of an output that is a column or a sum of columns (`"p_a_bar + p_b_bar"`)."""
    terms = tuple(term.strip() for term in expression.split("+"))
    if not all(term.isidentifier() for term in terms):
        raise WrongUseError(
            "an output is a column or a sum of columns",
            f"{expression!r}",
            'write "p_a_bar" or "p_a_bar + p_b_bar"',
        )
    return terms
