"""Diagrams in common use: two actuators, two sensors, a prefilter, a disturbance observer, a cascade."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.data.control.block import BlockTemplate
from loopshape.data.control.controller import Controller
from loopshape.data.control.fixed import fixed, roots_of
from loopshape.data.control.shorthand import controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.toolbox.diagrams.diagram import Diagram, Part
from loopshape.toolbox.learning.taps import Feedforward

Plants = FRF | Sequence[FRF]
FEEDBACK = {"e": "r - y"}


class Stage(StrEnum):
    """How two actuators share one error."""

    PARALLEL = "parallel"
    MASTER_SLAVE = "master-slave"


class Path(StrEnum):
    """Where a setpoint's own filter leads: to the error, or to the plant's input."""

    SETPOINT = "setpoint"
    INPUT = "input"


def dual_stage(
    P1: Plants, P2: Plants | None, C2: Controller, *, kind: str = "parallel", estimate: Controller | None = None
) -> Diagram:
    """Two actuators that move one output: y = P1 u1 + P2 u2, with C1 tuned and C2 as given.

    `P1` is the coarse actuator, `P2` the fine one (None: `P1` is one FRF with both inputs, measured together). In
    parallel both controllers act on e = r - y; master and slave let the coarse one follow the fine one's displacement,
    which is added to its error: P2's as `estimate` models it, or else as it is measured.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> P1, P2 = (
    ...     ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / f), relative_std=0.01, rate_hz=1000.0)
    ...     for f in (5.0, 90.0)
    ... )
    >>> ls.diagrams.dual_stage(P1, P2, ls.controller(ls.gain(0.5), rate_hz=1000.0))
    Diagram dual stage, parallel: C1, C2, P1, P2; C1 is tuned, from outside: r
    """
    refuse_unknown("two actuators stand in parallel or as master-slave", kind, Stage)
    way = Stage(kind)
    if way is Stage.PARALLEL and estimate is not None:
        raise WrongUseError("an estimate of the fine actuator is the master's", "kind parallel", "leave it out")
    if P2 is None and way is Stage.MASTER_SLAVE and estimate is None:
        raise WrongUseError("the fine actuator's displacement is not measured alone", "one FRF", "give an estimate")
    coarse, sums = "e", dict(FEEDBACK)
    parts = [Part("C2", "e", "u2", C2)]
    if P2 is None:
        parts += [Part("P", ("u1", "u2"), "y", P1)]
    else:
        parts += [Part("P1", "u1", "y1", P1), Part("P2", "u2", "y2", P2)]
        sums["y"] = "y1 + y2"
    if way is Stage.MASTER_SLAVE:
        moved = "y2" if estimate is None else "y2_hat"
        parts += [] if estimate is None else [Part("M2", "u2", "y2_hat", estimate)]
        coarse, sums["e1"] = "e1", f"e + {moved}"
    return Diagram((Part("C1", coarse, "u1"), *parts), sums, "C1", f"dual stage, {way}")


def cascade(G: Plants, inner: Controller, requirements: Requirements | None = None, *, loop: str = "outer") -> Diagram:
    """An inner loop closed by its controller, and an outer one around it that is tuned.

    `G` is measured from the one actuator to both sensors at once, outputs in the order (inner, outer), one FRF for each
    operating point: the outer plant is G2 C1/(1 + C1 G1). `requirements` are the inner loop's, which has to be stable
    with the outer one open. Once the outer loop is certified stable too, the whole is. Refuses other than two outputs
    and one input. Misleads where the inner controller limits its output.

    >>> import control, numpy as np, loopshape as ls
    >>> motor, load = control.tf([50.0], [1.0, 10.0]), control.tf([50.0], [1.0, 10.0, 0.0])
    >>> G = ls.FRF.from_control(control.combine_tf([[motor], [load]]), np.geomspace(0.1, 100.0, 80), rate_hz=1e3)
    >>> C1 = ls.controller(ls.gain(2.0), ls.pi(1.0), rate_hz=1e3)
    >>> ls.diagrams.equivalent(ls.diagrams.cascade(G, C1, ls.Requirements(unstable_poles=0)))
    Equivalent: 1 operating point, unstable poles 0, inner loop inner passed
    """
    if not _every(G):
        raise WrongUseError("a cascade needs the FRF of its plant", "none", "measure or import one")
    for one in _every(G):
        if one.response.shape[1:] != (2, 1):
            raise WrongUseError(
                "a cascade is measured from one actuator to two sensors",
                f"{one.response.shape[1]} outputs and {one.response.shape[2]} inputs",
                "pick them in the order (inner, outer)",
            )
    names = _every(G)[0].outputs
    if not all(name.isidentifier() and name not in ("e1", "e2", "r", "r1", "u") for name in names):
        names = ("y1", "y2")
    within = Part(inner.loop or "inner", "e1", "u", inner, requirements=requirements)
    parts = (Part(loop, "e2", "r1"), within, Part("G", "u", names, _every(G)))
    return Diagram(parts, {"e2": f"r - {names[1]}", "e1": f"r1 - {names[0]}"}, loop, "cascade")


def two_sensors(G: Plants, H1: Controller, H2: Controller) -> Diagram:
    """One loop whose error is put together of two sensors: y = H1 y1 + H2 y2, with C tuned.

    `G` is measured from the one actuator to both sensors at once. Filters that add up to 1 (a low-pass and its
    complement) take each sensor where it is the better one.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> both = np.stack([1.0 / (1.0 + 1j * f_hz / f) for f in (5.0, 6.0)], axis=1)[:, :, None]
    >>> G = ls.FRF.from_arrays(f_hz, both, relative_std=0.01, rate_hz=1000.0)
    >>> half = ls.controller(ls.gain(0.5), rate_hz=1000.0)
    >>> ls.diagrams.two_sensors(G, half, half)
    Diagram two sensors: C, G, H1, H2; C is tuned, from outside: r
    """
    plant = Part("G", "u", ("y1", "y2"), _every(G))
    parts = (Part("C", "e", "u"), plant, Part("H1", "y1", "h1", H1), Part("H2", "y2", "h2", H2))
    return Diagram(parts, {"y": "h1 + h2", **FEEDBACK}, "C", "two sensors")


def prefilter(P: Plants, F: Controller | Feedforward, *, to: str = "setpoint") -> Diagram:
    """Two degrees of freedom: what the setpoint passes before the loop, and C tuned.

    `to` says where F leads: "setpoint" filters it (e = F r - y), "input" adds F r to the plant's input (e = r - y), as
    the taps of `ls.learning.feedforward` are meant. The plant that C meets is P itself.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 5.0), relative_std=0.01, rate_hz=1000.0)
    >>> ls.diagrams.prefilter(P, ls.controller(ls.low_pass(20.0, order=1), rate_hz=1000.0))
    Diagram prefilter: C, P, F; C is tuned, from outside: r
    """
    refuse_unknown("a filter of the setpoint leads to the setpoint or to the input", to, Path)
    if isinstance(F, Controller) and F.integrators() > 0:
        raise WrongUseError("a filter outside the loop must not integrate", repr(F), "put the integrator into the loop")
    if to == Path.SETPOINT:
        parts = (Part("C", "e", "u"), Part("P", "u", "y", P), Part("F", "r", "rf", F))
        return Diagram(parts, {"e": "rf - y"}, "C", "prefilter")
    parts = (Part("C", "e", "uc"), Part("P", "u", "y", P), Part("F", "r", "uf", F))
    return Diagram(parts, {**FEEDBACK, "u": "uc + uf"}, "C", "feedforward")


def disturbance_observer(P: Plants, nominal: Any, q_filter: BlockTemplate | Sequence[BlockTemplate]) -> Diagram:
    """An observer that takes off the plant's input what its output shows beyond the nominal model, and C tuned.

    u = uc - Q (y/Pn - u), run as u = (uc - Q/Pn y)/(1 - Q) (Ohnishi, Trans. Japanese Soc. Mech. Engineers 56, 1987).
    `nominal` is a system as `ls.fixed` takes it, or (zeros, poles, gain); `q_filter` blocks with numbers and Q = 1 at
    low frequency, so steep that Q/Pn is proper. Refuses a nominal model whose inverse is unstable or improper with
    this Q. Up to Q's corner C meets the nominal plant.

    >>> import control, numpy as np, loopshape as ls
    >>> Pn = control.tf([20.0], [1.0, 4.0])
    >>> P = ls.FRF.from_control(Pn, np.geomspace(0.1, 300.0, 80), rate_hz=1e3, open_loop=True)
    >>> D = ls.diagrams.disturbance_observer(P, Pn, ls.low_pass(20.0, order=1))
    >>> print(ls.diagrams.equivalent(D).inner["observer"].outcome)
    passed
    """
    rates = {one.rate_hz for one in _every(P)}
    rate_hz = rates.pop()
    if rates or not rate_hz > 0.0:
        raise WrongUseError("an observer runs at the rate of its plant", f"{rate_hz:g} Hz", "give the FRF its rate_hz")
    blocks = (q_filter,) if isinstance(q_filter, BlockTemplate) else tuple(q_filter)
    Q = controller(*blocks, rate_hz=rate_hz)
    num, den = (_series(one) for one in zip(*(b.section() for b in Q.blocks), strict=True))
    if abs(num[-1] / den[-1] - 1.0) > 1e-9:
        raise WrongUseError("Q of an observer is 1 at low frequency", f"{num[-1] / den[-1]:.6g}", "use a low-pass")
    zeros, poles, gain = roots_of(nominal)
    q = np.roots(num), np.roots(den), num[np.flatnonzero(num)[0]] / den[0]
    inverse = (np.concatenate([q[0], poles]), np.concatenate([q[1], zeros]), q[2] / gain)
    rest = np.polysub(den, num)
    rest[-1] = 0.0  # 1 - Q is 0 at s = 0
    around = (q[1], np.roots(rest), den[0] / rest[np.flatnonzero(rest)[0]])
    made = [controller(*fixed(one), rate_hz=rate_hz) for one in (around, inverse)]
    parts = (
        Part("C", "e", "uc"), Part("observer", "v", "u", made[0]), Part("P", "u", "y", P),
        Part("inverse", "y", "w", made[1]),
    )  # fmt: skip
    return Diagram(parts, {**FEEDBACK, "v": "uc - w"}, "C", "disturbance observer")


def _series(polynomials: Sequence[Sequence[float]]) -> np.ndarray:
    """The product of polynomials in rising powers, in falling ones, without leading zeros."""
    whole = np.ones(1)
    for one in polynomials:
        whole = np.polymul(whole, np.trim_zeros(np.asarray(one, dtype=float)[::-1], "f"))
    return np.asarray(whole)


def _every(P: Plants) -> tuple[FRF, ...]:
    return (P,) if isinstance(P, FRF) else tuple(P)
