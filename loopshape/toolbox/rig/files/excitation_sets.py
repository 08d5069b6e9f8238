"""Several loops excited at once: multisines are told apart by signs or phases over recordings, noises by their seeds.

With as many recordings as loops and an orthogonal matrix between them, the spectra of the multisines at a line,
U[recording, loop], have columns at right angles: U^H U is diagonal. Every loop is excited in every recording, which
for n loops is worth n times the recordings of one loop after the other. Source: Dobrowiecki, Schoukens and Guillaume,
Optimized excitation signals for MIMO frequency response function measurements, IEEE TIM 55(6), 2006.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import gcd
from typing import Any, cast

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.toolbox.rig.excitation.excitation import BandNoise, Excitation
from loopshape.toolbox.rig.excitation.multisine import Multisine

#: most realisations of one experiment
MOST_REALISATIONS = 1000
#: between the seeds of realisations, and between those of loops without a seed of their own; both prime
REALISATION_STEP, LOOP_STEP = 1_000_003, 7_919
_ONE_BY_ONE = "or excite one loop after the other, each in an [[experiment]] of its own"


def together(signals: Mapping[str, Excitation]) -> tuple[dict[str, Excitation], ...]:
    """What each recording injects by loop: as many recordings as loops for multisines, a single one for noises.

    Refuses (`WrongUseError`) fewer than two loops, kinds that are neither all multisine nor all noise,
    multisines that are not alike (`orthogonal`) and noises that cannot be told apart.
    """
    if len(signals) < 2:
        raise WrongUseError(
            "loops are excited at once where there are two or more",
            ", ".join(signals) or "none",
            "for one loop write excites and excitation",
        )
    if all(isinstance(s, Multisine) for s in signals.values()):
        made = orthogonal(cast("Mapping[str, Multisine]", signals))
        return tuple(cast("dict[str, Excitation]", one) for one in made)
    if all(isinstance(s, BandNoise) for s in signals.values()):
        _refuse_like_noises(cast("Mapping[str, BandNoise]", signals))
        return (dict(signals),)
    raise WrongUseError(
        "loops are excited at once by multisines alone or by noise alone",
        _described(signals, lambda s: s.kind),
        f"give each a multisine of the same lines, {_ONE_BY_ONE}",
    )


def orthogonal(signals: Mapping[str, Multisine]) -> tuple[dict[str, Multisine], ...]:
    """Multisines of n recordings by loop, each with its own phases times a number of an orthogonal matrix (n, n).

    Hadamard signs where n is a power of two; else the DFT matrix, the loop j of recording e (from 0) turned by
    e j/n cycles at all its lines. A loop's amplitude is its largest peak over the recordings. Refuses multisines
    that differ in period, number of periods, ramp or lines.
    """
    _refuse_unlike(signals)
    n = len(signals)
    orders = [max(2, n // gcd(n, j)) for j in range(n)]  # of how many turns each loop's are; signs are two
    return tuple(
        {
            loop: replace(signal, turn=float(turn), turns=2 if n & (n - 1) == 0 else order)
            for (loop, signal), turn, order in zip(signals.items(), row, orders, strict=True)
        }
        for row in turns(n)
    )


def turns(n: int) -> Array:
    """Turns in cycles (recordings, loops) of the orthogonal matrix of n loops; its first row and column are zero."""
    from scipy.linalg import hadamard

    if n & (n - 1) == 0:
        return np.where(hadamard(n) < 0, 0.5, 0.0)
    k = np.arange(n)
    return np.asarray((np.outer(k, k) % n) / n)


def realised(signals: Mapping[str, Excitation], number: int) -> dict[str, Excitation]:
    """The same multisines with other phases: `number` 0 keeps the seeds, others move each by a fixed step.

    Refuses other excitations than multisines: they have no phases to draw.
    """
    if not (signals and all(isinstance(s, Multisine) for s in signals.values())):
        raise WrongUseError(
            "realisations are of multisines, whose phases are drawn anew",
            _described(signals, lambda s: s.kind) or "no excitation",
            "use a multisine, or leave realisations out and write an [[experiment]] for each repetition",
        )
    made = {loop: cast("Multisine", s) for loop, s in signals.items()}
    return {loop: replace(s, seed=s.seed + number * REALISATION_STEP) for loop, s in made.items()}


def _described(signals: Mapping[str, Any], text: Callable[[Any], str]) -> str:
    return ", ".join(f"{loop} {text(signal)}" for loop, signal in signals.items())


def _refuse_unlike(signals: Mapping[str, Multisine]) -> None:
    alike: tuple[tuple[str, Callable[[Multisine], str]], ...] = (
        ("period", lambda m: f"{m.period_s!r} s"),
        ("number of periods", lambda m: f"{m.periods!r}"),
        ("ramp", lambda m: f"{m.ramp_s!r} s"),
    )
    for what, text in alike:
        if len({text(m) for m in signals.values()}) > 1:
            raise _unlike(what, _described(signals, text))
    (first, lines), *others = ((loop, set(m.lines().tolist())) for loop, m in signals.items())
    for loop, theirs in others:
        if differing := sorted(lines ^ theirs):
            some = ", ".join(f"{f:g}" for f in differing[:5])
            raise _unlike("lines", f"{first} and {loop} differ at {some}{' ...' if differing[5:] else ''} Hz")


def _unlike(what: str, received: str) -> WrongUseError:
    return WrongUseError(
        f"multisines at once share their {what}, or they are not orthogonal",
        received,
        f"give them the same, {_ONE_BY_ONE}",
    )


def _refuse_like_noises(signals: Mapping[str, BandNoise]) -> None:
    if len({s.seed for s in signals.values()}) < len(signals):
        raise WrongUseError(
            "noises of one seed are identical, and what they do cannot be told apart",
            _described(signals, lambda s: f"seed {s.seed}"),
            "give each loop another seed, or none of them one",
        )
    if len({s.duration_s for s in signals.values()}) > 1:
        raise WrongUseError(
            "noises at once have one duration",
            _described(signals, lambda s: f"{s.duration_s:g} s"),
            f"give them the same, {_ONE_BY_ONE}",
        )
