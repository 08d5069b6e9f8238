"""FRFs + Requirements -> Bound: the bandwidth above which no controller whatever meets the requirements.

In a stable loop S and CS are affine in a free stable function Q, and what is asked is convex in S: |S| <= m and the
like are disks, and |L| >= 1, which a loop keeps up to its bandwidth (first 0 dB crossing of L), is Re S <= 1/2. A
frequency is excluded as bandwidth where a certificate shows that no stable Q, of whatever order, keeps all of it;
see `bound_certificate`. Convex limits on closed loops: Boyd and Barratt, Linear controller design, 1991.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import check
from loopshape.toolbox.limits.bound_certificate import CLEAR, Certificate, Poles, certificate
from loopshape.toolbox.limits.bound_nodes import WITHIN, Nodes, counted, impossible, nodes, weights
from loopshape.toolbox.limits.bound_reach import Reached, achieved
from loopshape.toolbox.limits.bound_regions import Regions, regions

#: dampings of the test functions' pairs: across all nodes, within the lines, and at the bandwidth tried
WIDE, NARROW, NEAR = 0.4, 0.15, (0.2, 0.1, 0.05, 0.02)
#: pairs across all nodes, and within the lines
PAIRS = 24
#: nodes per decade of a coarse search
COARSE = 60
INF = float("inf")


@dataclass(frozen=True)
class Excluded:
    """No controller reaches a bandwidth above `bound_hz`; inf where nothing could be excluded.

    `recording` is the plant whose Q was excluded. `first_hz` is its first line: a bound there means that the limits
    leave no bandwidth within the lines.
    """

    recording: str
    bound_hz: float
    first_hz: float


@dataclass(frozen=True, eq=False)
class Bound(Plain):
    """How far from the best possible a controller is.

    `alone` bounds a controller for each plant by itself, `together` one controller for all of them. `found_hz` is the
    given controller's lowest bandwidth, `bandwidths_hz` that at each recording. `counted` limits are kept by the bound,
    `left_out` ones are not convex and would only lower it. `reached` is how far a controller of many parameters gets
    on the plant whose bound alone is least: the best possible there lies between. `outcome` is that of the
    controller's own check: "passed", "failed" or "undecided"; `answer` is what was found of the limits. `impossible`
    limits are met by no controller with a bandwidth: every bound then stands at the first line.
    """

    IN_JSON = keys(
        "loop", "answer", "bound_hz", "ratio", "counted", "left_out", "outcome",
        bandwidth_hz="found_hz", bound_by="together.recording", alone="by_point", reached="reached",
    )  # fmt: skip

    loop: str
    found_hz: float
    bandwidths_hz: Mapping[str, float]
    alone: tuple[Excluded, ...]
    together: Excluded
    reached: Reached
    counted: tuple[str, ...]
    left_out: tuple[str, ...]
    outcome: str
    notes: tuple[str, ...] = ()
    impossible: tuple[str, ...] = ()

    @property
    def answer(self) -> str:
        """One of "bounded", "these limits exclude no bandwidth" and "no controller meets these limits"."""
        if self.impossible:
            return "no controller meets these limits"
        return "bounded" if self.bound_hz < INF else "these limits exclude no bandwidth"

    @property
    def bound_hz(self) -> float:
        """What no single controller exceeds."""
        return min(self.together.bound_hz, *(one.bound_hz for one in self.alone))

    @property
    def by_point(self) -> list[dict[str, Any]]:
        """Bound and bandwidth found at each operating point alone."""
        return [
            {"recording": x.recording, "bound_hz": x.bound_hz, "bandwidth_hz": self.bandwidths_hz[x.recording]}
            for x in self.alone
        ]

    @property
    def least_alone(self) -> Excluded:
        """The plant that allows the least."""
        return min(self.alone, key=lambda one: one.bound_hz)

    @property
    def ratio(self) -> float:
        """Lowest bandwidth found over the bound: 1 is the best possible."""
        return self.found_hz / self.bound_hz


def bound(
    frfs: Sequence[FRF],
    controller: Controller,
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    step: Callable[[str], None] = lambda word: None,
) -> Bound:
    """Bandwidths that no controller exceeds: for each plant alone, and for one controller for all.

    `step` is called with a word after each of 2 len(frfs) steps. The bounds hold for every linear controller at the
    rate, of any order, that keeps the counted limits at all frequencies, with these assumptions: P runs between lines
    as interpolated; below the first line it goes on as its model or integrators do; above the last line |CS| keeps
    its limit (without one, |L| its last value, and |P| falls on as it did). The controller must stabilise a plant
    with unstable poles; else it is only compared.

    Misleads: on noisy lines the plant is taken at its face value; a sharp resonance between lines is not
    seen; limits that are left out (phase margin) can put the best possible well below the bound.
    """
    if requirements.at:
        raise WrongUseError(
            f"a bound holds the limits of loop {requirements.loop!r} at all operating points alike",
            f"others at {len(requirements.at)} ranges of operating points",
            "bound one operating point alone, with requirements.of(operating_point)",
        )
    verdict = check(frfs, controller, requirements, fits)
    loops, notes = loops_of(frfs, controller, requirements, fits)
    _refuse_unknown(loops)
    (asked, left_out), never = counted(requirements), impossible(requirements)
    if never:
        words = " and ".join(f"{name} = {getattr(requirements, name):g}" for name in never)
        notes = (*notes, f"no controller with a bandwidth meets {words}, on any plant")
    alone = []
    for loop in loops:
        alone.append(excluded(loop, [loop], requirements))
        step(loop.plant.recording)
    found = {name: m.bandwidth_hz for name, m in verdict.margins.items()}
    together = _together(loops, alone, requirements, step)
    least = int(np.argmin([one.bound_hz for one in alone]))
    return Bound(
        loop=requirements.loop,
        found_hz=min(found.values()),
        bandwidths_hz=found,
        alone=tuple(alone),
        together=together,
        reached=achieved(loops[least], requirements, alone[least].bound_hz),
        counted=asked,
        left_out=left_out,
        outcome=verdict.outcome,
        notes=notes,
        impossible=never,
    )


def _together(
    loops: Sequence[Loop], alone: Sequence[Excluded], limits: Requirements, step: Callable[[str], None]
) -> Excluded:
    """The least bound over the choice of the plant whose Q is looked at, chosen by a coarse search."""
    best = min(alone, key=lambda one: one.bound_hz)
    coarse, sought = {}, len(loops) > 1 and not impossible(limits)
    for loop in loops:
        coarse[loop.plant.recording] = _Search(loop, loops, limits, COARSE).least() if sought else INF
        step(loop.plant.recording)
    promising = min(loops, key=lambda loop: coarse[loop.plant.recording])
    if coarse[promising.plant.recording] < best.bound_hz:
        best = min(best, excluded(promising, loops, limits), key=lambda one: one.bound_hz)
    return best


def _refuse_unknown(loops: Sequence[Loop]) -> None:
    for name, what in (("integrators", "integrators"), ("unstable_poles", "unstable poles")):
        unknown = [loop.plant.recording for loop in loops if getattr(loop, name) is None]
        if unknown:
            raise WrongUseError(
                f"a bound needs the number of {what} of the plant",
                f"not known at {', '.join(unknown)}",
                f"declare {name} in the requirements' [[loop]], or fit a model that follows the measured FRF",
            )


def excluded(loop: Loop, together: Sequence[Loop], limits: Requirements) -> Excluded:
    """The least bandwidth excluded for controllers that suit all loops of `together`, by the Q of `loop`.

    A certificate counts once it holds against the regions themselves on nodes twice as dense as those it was
    sought on. Limits that no controller meets exclude all from the first line on.
    """
    first = float(loop.frequency_hz[0])
    if impossible(limits):
        return Excluded(loop.plant.recording, first, first)
    found = _Search(loop, together, limits, WITHIN)
    return Excluded(loop.plant.recording, found.confirmed(found.least()), first)


class _Search:
    """A search over the bandwidth for the least that is excluded."""

    def __init__(self, loop: Loop, together: Sequence[Loop], limits: Requirements, within: int) -> None:
        self.loop, self.together, self.limits, self.within = loop, together, limits, within
        self.at = nodes(loop, limits, within=within)
        allowed = regions(self.at, limits, together)
        self.polygons = None if allowed is None else (allowed.polygons(crossing=True), allowed.polygons(crossing=False))

    def least(self) -> float:
        """Least bandwidth in Hz that a certificate excludes, inf for none; a higher one asks for more."""
        low, high = (int(k) for k in np.flatnonzero(self.at.inside)[[0, -1]])
        if self.polygons is None or not self.excludes(high):
            return INF
        if self.excludes(low):
            return float(self.at.f[low])
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.excludes(middle) else (middle, high)
        return float(self.at.f[high])

    def excludes(self, k: int) -> Certificate | bool:
        """A certificate against the bandwidth f[k]; True where a region is empty, False where none is found."""
        assert self.polygons is not None
        crossing, free = self.polygons
        s = np.concatenate([self.at.s[: k + 1], self.at.s[k:]])  # node k stands there twice: the regions jump
        vertices = np.concatenate([crossing[: k + 1], free[k:]])
        if np.isnan(vertices).any():
            return True
        return certificate(s, vertices, _poles(self.at, float(self.at.s[k].imag))) or False

    def confirmed(self, bound_hz: float) -> float:
        """The first node from `bound_hz` on whose certificate holds exactly on denser nodes; inf where none does."""
        if bound_hz == INF:
            return INF
        finer = nodes(self.loop, self.limits, halved=True, within=self.within)
        allowed = regions(finer, self.limits, self.together)
        assert allowed is not None
        for k in range(int(np.searchsorted(self.at.f, bound_hz)), int(np.flatnonzero(self.at.inside)[-1]) + 1):
            proof = self.excludes(k)
            if proof is True or (proof and _integral(proof, finer, allowed, float(self.at.f[k])) < -0.5 * CLEAR):
                return float(self.at.f[k])
        return INF


def _integral(proof: Certificate, at: Nodes, allowed: Regions, bandwidth_hz: float) -> float:
    """The certificate's integral over that of |h| times the regions' size, |L| >= 1 asked up to a bandwidth."""
    k = int(np.argmin(np.abs(at.f - bandwidth_hz)))
    s = np.concatenate([at.s[: k + 1], at.s[k:]])
    h = proof.test_function(s)
    below = allowed.at(np.arange(k + 1)).support(h[: k + 1], crossing=True)
    above = allowed.at(np.arange(k, at.f.size)).support(h[k + 1 :], crossing=False)
    support, (_, dw) = np.concatenate([below, above]), weights(s)
    size = np.abs(h) * np.repeat(np.abs(allowed.centre) + allowed.extent, np.where(at.f == at.f[k], 2, 1))
    return -INF if np.isnan(support).any() else float(dw @ support / (dw @ size))


def _poles(at: Nodes, tried: float) -> Poles:
    """Poles of test functions over the nodes' band, denser within the lines and about the bandwidth tried, in rad/s."""
    w, lines = at.s.imag, at.s.imag[at.inside]
    wide = np.geomspace(20.0 * w[0], min(4.0 * lines[-1], 0.1 * w[-1]), PAIRS)
    within = np.geomspace(lines[0], lines[-1], PAIRS)
    pairs = [(x, WIDE) for x in wide] + [(x, NARROW) for x in within] + [(tried, damping) for damping in NEAR]
    return Poles(np.geomspace(10.0 * w[0], 0.1 * w[-1], PAIRS), tuple((float(x), d) for x, d in pairs))
