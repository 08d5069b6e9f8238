"""Several loops under new controllers, what disturbed all of them under the old ones -> what disturbs each.

Whatever disturbs linear loops, and wherever, their errors at the same time go over by e1 = (I + P C1)^-1 (I + P C0) e0:
the error of each loop follows from those of all, with their phases, which spectra do not tell. An error dP of the plant
makes e1 wrong by (I + P C1)^-1 dP (C0 e0 - C1 e1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra.propagation import pick
from loopshape.data.response.frf import FRF
from loopshape.data.signal.disturbance import Disturbance, amplitudes
from loopshape.loop.loop import Loop, responses
from loopshape.loop.margin.disturbed import Carried, OneOfSeveral, refuse_other_rate
from loopshape.loop.stability.continued import ABOVE, Continued, between, continued, integrators_of

#: an element that is known better than this between its lines is straight in ln P there, another one in P
KNOWN = 0.5


def of_each(loops: Sequence[Loop], disturbances: Sequence[Disturbance]) -> dict[str, tuple[OneOfSeveral, ...]]:
    """What disturbs each of several loops at each operating point (`loops`, n x n), by the loops' names.

    Those of an operating point are the ones that were recorded there; of a loop that has one alone, that one. Refuses
    loops of which none was recorded, recordings that are not of the same time, and spectra.
    """
    found: dict[str, tuple[OneOfSeveral, ...]] = {name: () for name in loops[0].names} if disturbances else {}
    by_loop = {name: [one for one in disturbances if one.loop == name] for name in found}
    if missing := [name for name, mine in by_loop.items() if not mine]:
        raise WrongUseError(
            f"the errors of several loops follow from those of all, and nothing tells that of {', '.join(missing)}",
            f"disturbances of {', '.join(dict.fromkeys(repr(one.loop) for one in disturbances))}",
            "give a run in which all loops are closed and none is excited",
        )  # fmt: skip
    for loop in loops:
        here = [_at(loop, mine) for mine in by_loop.values()]
        if here and all(here):
            for name, one in of_loops(loop, [one for one in here if one is not None]).items():
                found[name] += (one,)
    return found


def _at(loop: Loop, disturbances: Sequence[Disturbance]) -> Disturbance | None:
    """That of the loop's operating point; one alone serves all."""
    if len(disturbances) == 1:
        return disturbances[0]
    return next((one for one in disturbances if dict(one.operating_point) == dict(loop.plant.operating_point)), None)


def of_loops(loop: Loop, recorded: Sequence[Disturbance]) -> dict[str, OneOfSeveral]:
    """What disturbs each of several loops of one plant, from what disturbed all of them, in their order.

    Raises WrongUseError for spectra and profiles, for records of different lengths and for another rate.
    """
    rate_hz = loop.controllers[0].rate_hz
    _refuse_apart(recorded)
    for name, one in zip(loop.names, recorded, strict=True):
        refuse_other_rate(one, name, rate_hz)
    n = recorded[0].samples.size // 2 * 2
    f = np.asarray(np.fft.rfftfreq(n, 1.0 / rate_hz)[1:-1], dtype=float)
    plant = _Elements.of(loop.plant, f)
    ways = _Ways.of(loop, recorded, f, plant)
    taken = [amplitudes(one.samples[:n]) for one in recorded]
    before = np.array([z[: f.size] for z, _ in taken]).T
    error = ways.over(before)
    pulled = ways.C0 * before - ways.C1 * error
    flat = _Ways(np.broadcast_to(loop.P[-1], ways.P.shape), ways.C0, ways.C1).over(before)
    whole = ways.over(np.array([np.fft.rfft(one.samples[:n])[1 : f.size + 1] for one in recorded]).T)
    means, inverse = _means(loop, recorded), np.linalg.inv(ways.closed(ways.C1))
    covariance = loop.plant.covariance / (plant.own[:, :, None] * plant.own[:, None, :].conj())
    made = {}
    for k, (name, one, own) in enumerate(zip(loop.names, recorded, loop.controllers, strict=True)):
        moves = (inverse[:, k, None, :] * pulled[:, :, None]).reshape(f.size, -1).T * plant.here.T
        power = np.abs(error[:, k]) ** 2
        carried = Carried(
            f=f, before=before[:, k], error=error[:, k], scatter=0.5 * taken[k][1] * power**2, C1=ways.C1[:, k],
            moves=moves, there=plant.there, covariance=covariance, flat=flat[:, k],
            band_hz=(float(loop.frequency_hz[0]), float(loop.frequency_hz[-1])), overlap=loop.plant.line_overlap,
        )  # fmt: skip
        made[name] = OneOfSeveral(
            f, power, carried.scatter, own, name, one.recording, loop.plant.operating_point,
            duration_s=one.duration_s, control_mean=means[k], carried=carried,
            samples=np.fft.irfft(np.concatenate([[0.0], whole[:, k], [0.0]]), n),
        )  # fmt: skip
    return made


def _refuse_apart(recorded: Sequence[Disturbance]) -> None:
    """Refuse what was not recorded of all loops at the same time."""
    sizes = [one.samples.size for one in recorded]
    if len({(one.recording, one.samples.size, one.repeats) for one in recorded}) > 1 or not min(sizes):
        raise WrongUseError(
            "the errors of several loops follow from recordings of all of them at the same time",
            "; ".join(f"{x.loop!r}: {x.recording or 'no recording'}, {x.samples.size} samples" for x in recorded),
            "give a run in which all loops are closed and none is excited",
        )  # fmt: skip
    if recorded[0].repeats:
        raise WrongUseError("profiles of several loops are not carried over", "from_profile", "check the loops alone")


class _Ways(NamedTuple):
    """Plant (nf, n, n) and both controllers (nf, n)."""

    P: ComplexArray
    C0: ComplexArray
    C1: ComplexArray

    @classmethod
    def of(cls, loop: Loop, recorded: Sequence[Disturbance], f: Array, plant: _Elements) -> _Ways:
        under = [None if one.recorded_under is None else one.recorded_under.response(f) for one in recorded]
        C0 = np.array([np.zeros(f.size) if x is None else x for x in under], dtype=complex).T
        return cls(plant.response(len(under)), C0, responses(loop.controllers, f))

    def closed(self, c: ComplexArray) -> ComplexArray:
        """I + P C."""
        return np.asarray(np.eye(c.shape[1]) + self.P * c[:, None, :])

    def over(self, error: ComplexArray) -> ComplexArray:
        """Errors (nf, n) under the old controllers as they are under the new ones."""
        return np.asarray(np.linalg.solve(self.closed(self.C1), self.closed(self.C0) @ error[..., None])[..., 0])


class _Elements(NamedTuple):
    """A matrix's elements, columns stacked, on other frequencies (nf, n²), and what errors scale with.

    `here` (nf, n²) on these frequencies and `own` (lines, n²) on the FRF's: an error d there makes `here` d / `own`.
    """

    P: ComplexArray
    here: ComplexArray
    own: ComplexArray
    there: Continued

    def response(self, n: int) -> ComplexArray:
        """The matrix (nf, n, n)."""
        return self.P.reshape(-1, n, n).transpose(0, 2, 1)

    @classmethod
    def of(cls, frf: FRF, f: Array) -> _Elements:
        """Each as `continued` has it, one that is hardly known straight between its lines."""
        n, lines_hz = len(frf.outputs), frf.frequency_hz
        line, share = between(f, lines_hz)
        fall = np.minimum(lines_hz[-1] / f, 1.0) ** ABOVE
        P, here, own = [], [], []
        for column, row in np.ndindex(n, n):
            one = pick(frf, [row], [column])
            size = np.abs(one.siso)
            if np.median(np.sqrt(one.variance[:, 0, 0]) - KNOWN * size) < 0.0 < size.min():
                P.append(continued(one, f, integrators_of(one)).response)
                here.append(P[-1])
                own.append(one.siso)
            else:
                P.append(fall * (share * one.siso[line] + (1.0 - share) * one.siso[line + 1]))
                here.append(fall + 0j)
                own.append(np.ones(lines_hz.size, dtype=complex))
        return cls(np.array(P).T, np.array(here).T, np.array(own).T, Continued(np.array(P[0]), line, share))


def _means(loop: Loop, recorded: Sequence[Disturbance]) -> Array:
    """Means (n,) of the plant's inputs under the new controllers, by the plant near 0 Hz."""
    means = np.array([one.control_mean for one in recorded])
    f = np.array([1e-3 * loop.frequency_hz[0]])
    ways = _Ways.of(loop, recorded, f, _Elements.of(loop.plant, f))
    if not means.any() or not ways.C0.all() or not ways.C1.all():
        return means
    return np.asarray((ways.C1 * ways.over(means / ways.C0)).real[0])
