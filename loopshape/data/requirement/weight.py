"""Weights over frequency of |S|, |T|, |CS| and |PS| (the norm of the weighted loop), and what a tuning makes large."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import pass_fields, received
from loopshape.core.units import Array, angular, from_db
from loopshape.data.control.block import BlockTemplate, Free, series_response
from loopshape.data.control.fixed import roots_of
from loopshape.data.requirement.limits_over import Mask, weights

#: responses that can be weighted, in the order of the kernel's rows
WEIGHTED = ("S", "T", "CS", "PS")


@dataclass(frozen=True, eq=False)
class Weight:
    """A weight |W| on |S|, |T|, |CS| or |PS| over frequency, for the norm max over f of sqrt(sum of |W|² |response|²).

    That is the H-infinity norm of the stacked column (W1 S, W2 T, W3 CS, ...), the mixed sensitivity of
    Skogestad and Postlethwaite (Multivariable feedback control, 2005, chapter 9). `size` is a number; points (Hz, dB),
    straight in dB over ln f and level outside them; a block or several in series; a system of python-control or scipy
    (continuous, or with its timebase); or a function of frequencies (nf,) in Hz. Only |W| counts, so that a weight may
    be improper. The unit of |W| is one over that of its response, so that the norm has none.

    Refuses another response, points as a mask does, blocks with free parameters, and whatever else `size` is; a weight
    that is not finite at a frequency where it is needed is refused there. It misleads where it is steeper than the
    frequencies of the FRF are dense: the norm is read there and between them no finer than the loop is.

    Examples
    --------
    >>> import loopshape as ls
    >>> print(ls.Weight("S", ((0.1, 40.0), (10.0, 0.0))).at([0.01, 1.0, 100.0]))
    [100.  10.   1.]
    >>> print(ls.Weight("CS", lambda f_hz: f_hz / 50.0).at([100.0]))
    [2.]
    """

    response: str
    size: Any

    def __post_init__(self) -> None:
        pass_fields(self)
        refuse_unknown("a weight is on S, T, CS or PS (|L| has masks alone)", self.response, WEIGHTED)
        object.__setattr__(self, "_of", _function(self.response, self.size))

    def at(self, frequency_hz: ArrayLike) -> Array:
        """|W| (nf,) at frequencies (nf,) in Hz."""
        f = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        of: Callable[[Array], Any] = getattr(self, "_of")  # noqa: B009
        with np.errstate(all="ignore"):
            try:
                found = np.abs(np.asarray(of(f)))
            except (TypeError, ValueError) as error:
                raise WrongUseError(
                    f"the weight on |{self.response}| is no function of frequencies", f"{error}",
                    "give a function of an array (nf,) in Hz",
                ) from error  # fmt: skip
        if found.shape != f.shape or not np.isfinite(found).all():
            bad = f[~np.isfinite(found)][:1] if found.shape == f.shape else f[:1]
            raise WrongUseError(
                f"the weight on |{self.response}| must be one finite number at each frequency",
                f"shape {found.shape} of {f.size} frequencies, not finite at {bad} Hz",
                "give points, or a function of an array in Hz",
            )
        return np.asarray(found, dtype=float)

    @classmethod
    def from_table(cls, table: Any) -> Weight:
        """A weight from TOML: { response = "S", points = [[0.1, 40.0], [10.0, 0.0]] }, blocks = [...] or size = 2.0."""
        known = [{"response", one} for one in ("points", "blocks", "size")]
        if not isinstance(table, Mapping) or set(table) not in known:
            raise WrongUseError("a weight has response, and size, points or blocks", f"{table!r}")
        if "size" in table:
            return cls(table["response"], table["size"] if is_number(table["size"]) else None)
        if "points" in table:
            return cls(table["response"], tuple(map(tuple, table["points"])) if _pairs(table["points"]) else None)
        return cls(table["response"], tuple(BlockTemplate.from_table(one) for one in table["blocks"]))

    def to_table(self) -> dict[str, Any]:
        """The table of this weight in a file; refuses systems and functions, which have none."""
        size: Any = (self.size,) if isinstance(self.size, BlockTemplate) else self.size
        head = {"response": self.response}
        if is_number(size):
            return head | {"size": float(size)}
        if not isinstance(size, Sequence):
            what = f"the weight on |{self.response}| has no form in a file"
            raise WrongUseError(what, type(size).__name__, "give a number, points (Hz, dB) or blocks")
        if isinstance(size[0], BlockTemplate):
            return head | {"blocks": [one.to_table() for one in size]}
        return head | {"points": [list(map(float, pair)) for pair in size]}


def _function(response: str, size: Any) -> Callable[[Array], Any]:
    """|W| or W as a function of frequencies (nf,) in Hz."""
    if isinstance(size, int | float) and not isinstance(size, bool):
        if not abs(size) < 1e50:
            raise WrongUseError(f"the weight on |{response}| must be finite", received(size))
        return lambda f: np.full(f.shape, float(size))
    if isinstance(size, BlockTemplate):
        return _of_blocks(response, (size,))
    if isinstance(size, Sequence) and size and all(isinstance(one, BlockTemplate) for one in size):
        return _of_blocks(response, size)
    if _pairs(size):
        return _of_points(response, size)
    if hasattr(size, "dt") or hasattr(size, "to_zpk"):
        return _of_system(size)
    if callable(size):
        return lambda f: size(f)
    raise WrongUseError(
        f"the weight on |{response}| is a number, points (Hz, dB), blocks, a system or a function of Hz", f"{size!r}"
    )


def _pairs(size: Any) -> bool:
    return (
        isinstance(size, Sequence) and bool(size) and all(isinstance(one, Sequence) and len(one) == 2 for one in size)
    )


def _of_points(response: str, points: Sequence[Sequence[float]]) -> Callable[[Array], Any]:
    hz, level = np.transpose(Mask(response, tuple((one[0], one[1]) for one in points)).points)
    return lambda f: from_db(np.interp(np.log(f), np.log(hz), level))


def _of_blocks(response: str, templates: Sequence[BlockTemplate]) -> Callable[[Array], Any]:
    free = [name for one in templates for name, value in one.parameters.items() if isinstance(value, Free)]
    if free:
        raise WrongUseError(f"the weight on |{response}| has free parameters", ", ".join(free), "give their values")
    blocks = [one.block({}) for one in templates]
    return lambda f: series_response(blocks, np.asarray(1j * angular(f), dtype=np.complex128))


def _of_system(system: Any) -> Callable[[Array], Any]:
    zeros, poles, gain = roots_of(system)
    dt = getattr(system, "dt", None)
    if dt is True:
        raise WrongUseError("a discrete weight needs its rate", "dt = True", "give its timebase in seconds")

    def response(f: Array) -> Any:
        s = 1j * angular(f)
        x = np.exp(s * float(dt)) if dt else s
        return gain * _product(x, zeros) / _product(x, poles)

    return response


def _product(x: Any, roots: Any) -> Any:
    return np.prod(x[:, None] - roots[None, :], axis=1)


def stacked(weighted: Sequence[Weight], f: Array) -> Array:
    """Squared weights of |S|², |T|², |CS|² and |PS|² (4, nf) at frequencies (nf,) in Hz; several on one are added."""
    out = np.zeros((len(WEIGHTED), f.size))
    for one in weighted:
        out[WEIGHTED.index(one.response)] += one.at(f) ** 2
    return out


def over(masks: Sequence[Mask], weighted: Sequence[Weight], f: Array) -> Array:
    """Rows of the kernel of margins (10, nf): those of masks, then those of weights; 0 where nothing is weighed."""
    return np.concatenate([weights(masks, f), stacked(weighted, f)])


#: terms that may stand alone
TERMS = ("bandwidth", "disturbance", "weighted_norm")


@dataclass(frozen=True)
class Objective:
    """What `tune` makes large, over the operating points at their worst each: a weighted sum of its terms.

    `bandwidth` weighs ln of the first 0 dB crossing of L; `disturbance` the mean of ln 1/|S| over ln f on the lines up
    to `disturbance_below_hz`. |S| is the error with the loop over the error without it, wherever a disturbance
    enters, so that operating points compare. `weighted_norm` weighs ln of one over the norm that the requirements'
    `weights` ask for: that norm is made small. Refuses weights below zero, none above, and half a disturbance term.

    >>> import loopshape as ls
    >>> ls.Objective(bandwidth=1.0, disturbance=0.5, disturbance_below_hz=0.3).disturbance
    0.5
    """

    bandwidth: float = 1.0
    disturbance: float = 0.0
    disturbance_below_hz: float | None = None
    weighted_norm: float = 0.0

    def __post_init__(self) -> None:
        pass_fields(self)
        weights = (self.bandwidth, self.disturbance, self.weighted_norm)
        if not all(is_number(w) and 0.0 <= w < np.inf for w in weights) or max(weights) == 0.0:
            raise WrongUseError(
                "the weights of an objective must not be negative, and one must be positive", f"{weights}"
            )
        below = self.disturbance_below_hz
        if (self.disturbance > 0.0) != (below is not None):
            raise WrongUseError(
                "disturbance and disturbance_below_hz of an objective go together", "one of them", "give both or none"
            )
        if below is not None and not (is_number(below) and 0.0 < below < np.inf):
            raise WrongUseError("disturbance_below_hz must be positive and finite", f"{below!r}")

    @classmethod
    def unfolded(cls, given: Any, below: Mapping[str, Any] | None = None) -> Any:
        """A table of weights from one term, or from a table that leaves out those of 0; `below` stands beside it."""
        if not isinstance(given, Mapping):
            refuse_unknown("an objective is a word, or a table of weights", given, TERMS, "use one of")
            given = {given: 1.0}
        return {"bandwidth": 0.0} | dict(below or {}) | dict(given)

    def to_table(self) -> dict[str, float]:
        """The table of weights in a file, as `unfolded` reads it."""
        return {name: value for name, value in vars(self).items() if value}


def is_number(value: Any) -> bool:
    """Whether a value is a number, true and false left out."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
