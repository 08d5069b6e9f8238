"""An FRF out of somebody's file: what the file holds, what the user states of it, and what is not known.

An FRF carries its error. Where a file holds no covariance, the error is stated by the user (`relative_std`), or follows
from the coherence of a single input and the number of averages: E|d|² = |G|² (1 - γ²)/(γ² (K - 1)), which is Bendat and
Piersol (Random Data, 4th ed., table 9.6) with the one degree of freedom that G itself took. With several inputs an
ordinary coherence does not say this, and it is not used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import check_relative_std, independent, valid_frequencies, variance_by_coherence
from loopshape.io.config_table import said_in
from loopshape.io.files import plain_name, short
from loopshape.io.write.frf_words import PERHAPS, frf_words


@dataclass(frozen=True)
class Stated:
    """What a user says of a file: each word goes before the file's own.

    `relative_std` is sqrt(E|d|²)/|G|, the same for all elements and lines; 0 for a model's response. `averages` is the
    number of independent averages behind a coherence. Names of inputs and outputs end in their unit. `negative`: the
    response was measured around the whole loop with the sign of its summing point, as loop analysers do, and is turned.
    `complete_loop`: it is L = C P of this controller, which is divided out.
    """

    relative_std: float | None = None
    averages: float | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    recording: str = ""
    loop: str = ""
    rate_hz: float = 0.0
    negative: bool = False
    complete_loop: Controller | None = None


@dataclass(frozen=True, eq=False)
class ForeignFRF:
    """What a file holds: lines (nf,), response (nf, ny, nu), other arrays of `FRF` by name, and its words.

    `element_coherence` (nf, ny, nu) is the ordinary coherence of each pair, `std` (nf, ny, nu) is sqrt(E|d|²).
    """

    where: str
    frequency_hz: Array
    response: ComplexArray
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    words: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    element_coherence: Array | None = None
    std: Array | None = None


def frf_of(found: ForeignFRF, stated: Stated | None = None) -> FRF:
    """The FRF, with its error; refuses one whose error is not stated. A line at 0 Hz is left out with a note."""
    stated = stated or Stated()
    _check_stated(stated)
    found = _above_zero(_checked(found))
    with said_in(found.where), np.errstate(over="ignore", invalid="ignore"):  # an FRF refuses what is not finite
        words = _words(found, stated)
        covariance, freedom = _covariance(found, stated, words["averages"])
        arrays: dict[str, Any] = {name: found.arrays[name] for name in PERHAPS if name in found.arrays} | _coherences(
            found
        )
        words |= {"variance_freedom": freedom} if "covariance" not in found.arrays and freedom is not None else {}
        valid = found.arrays.get("valid")
        made = FRF(
            frequency_hz=found.frequency_hz, response=found.response, covariance=covariance,
            valid=np.ones(found.frequency_hz.size, dtype=bool) if valid is None else valid, **arrays, **words,
        )  # fmt: skip
        known = valid_frequencies(made.frequency_hz, made.response, made.covariance) if valid is None else made.valid
        return replace(made, valid=known)


def _check_stated(stated: Stated) -> None:
    if stated.relative_std is not None:
        check_relative_std(stated.relative_std)
    if stated.averages is not None and not 1.0 < stated.averages < np.inf:
        raise WrongUseError("a coherence gives no error without averages above 1", f"{stated.averages:g}")
    if not (np.isfinite(stated.rate_hz) and stated.rate_hz >= 0.0):
        raise WrongUseError("a rate must not be negative", f"{stated.rate_hz:g} Hz")
    for word, what in ((stated.recording, "the name of a recording"), (stated.loop, "the name of a loop")):
        if word:
            plain_name(word, what)


def _checked(found: ForeignFRF) -> ForeignFRF:
    f, G = np.asarray(found.frequency_hz, dtype=float), np.asarray(found.response, dtype=complex)
    if f.ndim != 1 or not f.size or G.ndim != 3 or G.shape[0] != f.size or 0 in G.shape:
        raise UnreadableInputError(
            f"{found.where} holds no FRF: a response has outputs, inputs and frequencies",
            f"{f.size} frequencies and a response of {' x '.join(map(str, G.shape))}", "write frequency first",
        )  # fmt: skip
    if not (np.isfinite(f).all() and np.isfinite(G[f > 0.0]).all()):
        bad = f[~np.isfinite(G).all(axis=(1, 2)) & np.isfinite(f) & (f > 0.0)]
        raise UnreadableInputError(
            f"{found.where} holds values that are not numbers", f"at {bad[0]:g} Hz" if bad.size else "in frequency",
            "leave such frequencies out",
        )  # fmt: skip
    return found


def _above_zero(found: ForeignFRF) -> ForeignFRF:
    """Without a first line at 0 Hz, which analysers write and an FRF on lines above zero does not have."""
    if found.frequency_hz[0] != 0.0 or found.frequency_hz.size == 1:
        return found

    def cut(values: Any) -> Any:
        return None if values is None else values[1:]

    return ForeignFRF(
        found.where, cut(found.frequency_hz), cut(found.response), {k: cut(v) for k, v in found.arrays.items()},
        found.words, (*found.notes, "the value at 0 Hz was left out"), cut(found.element_coherence), cut(found.std),
    )  # fmt: skip


def _words(found: ForeignFRF, stated: Stated) -> dict[str, Any]:
    """The keywords of `FRF`: stated, else the file's, else plain defaults with a note."""
    ny, nu = found.response.shape[1:]
    notes = [*found.words.get("notes", ()), *found.notes]
    header: dict[str, Any] = {"recording": "", "loop": "", "rate_hz": 0.0, "operating_point": {}, "method": "measured"}
    header |= dict(found.words)
    for name, mine, count in (("inputs", stated.inputs, nu), ("outputs", stated.outputs, ny)):
        given = list(mine or header.get(name) or ())
        if not given:
            given = [f"{'y' if name == 'outputs' else 'u'}{k + 1}_1" for k in range(count)]
            notes.append(f"the {name} have no names: called {', '.join(given)}, without a unit")
        if len(given) != count or len(set(given)) != count:
            raise WrongUseError(f"it has {count} {name}, each with a name of its own", short(", ".join(given)))
        header[name] = given
    for name in ("recording", "loop", "rate_hz", "averages"):
        if getattr(stated, name):
            header[name] = getattr(stated, name)
    try:
        words = frf_words(header | {"notes": notes}, found.where)
    except (WrongUseError, TypeError, ValueError, LookupError, AttributeError) as error:
        raise UnreadableInputError("its words cannot be read", short(error), "write it again") from None
    if not (words["rate_hz"] >= 0.0 and words["variance_pooled"] >= 1):
        raise UnreadableInputError("its words cannot be read", f"rate {words['rate_hz']}", "write it again")
    return words


def _covariance(found: ForeignFRF, stated: Stated, averages: float) -> tuple[ComplexArray, float | None]:
    """Covariance (nf, n, n) and its freedom where it follows from averages; the file's own, stated, or by coherence."""
    own = found.arrays.get("covariance")
    if stated.relative_std is not None:
        if own is not None or found.std is not None:
            raise WrongUseError(
                "it holds its own error, and a relative standard deviation was stated", f"{stated.relative_std:g}",
                "leave the statement out",
            )  # fmt: skip
        return independent((stated.relative_std * np.abs(found.response)) ** 2), None
    if own is not None:
        own = np.asarray(own, dtype=complex)
        if own.ndim != 3 or own.shape[1] != own.shape[2] or not _hermitian(own):
            raise UnreadableInputError("its covariance is none", "a matrix that is not Hermitian", "write it again")
        return own, None
    if found.std is not None:
        return independent(np.asarray(found.std, dtype=float) ** 2), None
    coherence, single = found.element_coherence, found.response.shape[2] == 1
    if coherence is not None and single and averages > 1.0:
        variance = variance_by_coherence(found.response, _coherence(coherence), averages)
        return independent(variance), 2.0 * (averages - 1.0)
    reasons = {
        coherence is None: "neither covariance nor coherence",
        coherence is not None and single: "a coherence without the number of averages behind it",
        coherence is not None and not single: "ordinary coherences of several inputs, which give no error",
    }
    way_out = "state relative_std (--relative-std 0.05 is 5 % at every frequency)"
    more = ", or averages (--averages 20)" if coherence is not None and single else ""
    raise WrongUseError("the error of this FRF is not given", reasons[True], way_out + more)


def _hermitian(C: ComplexArray) -> bool:
    return bool(np.abs(C - C.conj().transpose(0, 2, 1)).max() <= 1e-6 * np.abs(C).max())


def _coherence(values: Array) -> Array:
    if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0 + 1e-6):
        raise UnreadableInputError("a coherence lies between 0 and 1", f"{values.min():g} to {values.max():g}")
    return values


def _coherences(found: ForeignFRF) -> dict[str, Array]:
    """Ordinary coherence of a single input, where an FRF has room for it."""
    values, (ny, nu) = found.element_coherence, found.response.shape[1:]
    if values is None or nu > 1:
        return {}
    values = _coherence(values)
    return {"coherence": values[:, 0, 0]} if ny == 1 else {"multiple_coherence": values[:, :, 0]}
