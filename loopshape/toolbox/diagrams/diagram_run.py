"""A diagram with models in the place of its plants: its state space at the controllers' rate, and how it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller
from loopshape.toolbox.diagrams.diagram import Diagram, Part
from loopshape.toolbox.learning.taps import Feedforward


class States(NamedTuple):
    """x+ = A x + B w, s = C x + D w: w is what is added at each signal of the diagram, s are all its signals."""

    A: Array
    B: Array
    C: Array
    D: Array


def simulate(D: Diagram, models: Mapping[str, Any], signals: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """All signals (n,) of a diagram from rest, sample by sample, with models in the place of its plants.

    `models` are python-control systems by the names of the plants: discrete at the controllers' rate, or continuous
    with inputs that are held. `signals` (n,) come from outside, or are added at a signal of that name. Feedforward taps
    see their setpoint ahead. Raises WrongUseError for a plant without a model, other rates, a delay that is no whole
    number of samples, and a circle without any delay that has no solution.

    >>> import control, numpy as np, loopshape as ls
    >>> plant = control.tf([20.0], [1.0, 4.0])
    >>> P = ls.FRF.from_control(plant, np.geomspace(0.1, 300.0, 80), rate_hz=1e3)
    >>> C = ls.diagrams.Part("C", "e", "u", ls.controller(ls.pi(1.0), rate_hz=1e3))
    >>> D = ls.diagrams.Diagram((C, ls.diagrams.Part("P", "u", "y", P)), {"e": "r - y"}, "C")
    >>> print(ls.diagrams.simulate(D, {"P": plant}, {"r": np.ones(3000)})["y"][-1].round(3))
    1.0
    """
    given = {name: real_array(value, f"signal {name}") for name, value in signals.items()}
    if len({one.shape for one in given.values()}) != 1 or next(iter(given.values())).ndim != 1:
        raise WrongUseError("signals of a diagram are (n,), all as long", f"{[x.shape for x in given.values()]}")
    if unknown := set(given) - set(D.signals):
        raise WrongUseError("the diagram has no such signal", ", ".join(unknown), f"it has {', '.join(D.signals)}")
    for one in D.parts:
        if isinstance(one.what, Feedforward):
            given[one.outputs[0]] = given.get(one.outputs[0], 0.0) + one.what.signal(_ahead(D, one, given))
    n = next(iter(given.values())).size
    added = np.stack([given.get(name, np.zeros(n)) for name in D.signals], axis=1)
    system = states(D, models)
    many = len(system.A) > 100  # more states than this are those of delay lines: their matrices are nearly empty
    A, B, c, d = (csr_array(m) if many else m for m in system)
    x, out = np.zeros(len(system.A)), np.empty((n, len(D.signals)))
    for k, w in enumerate(added):
        out[k] = c @ x + d @ w
        x = A @ x + B @ w
    return dict(zip(D.signals, out.T, strict=True))


def _ahead(D: Diagram, one: Part, given: Mapping[str, Array]) -> Array:
    """The setpoint that taps see ahead; refuses one that is not known ahead."""
    if (name := one.inputs[0]) not in D.external or name not in given:
        raise WrongUseError("taps that look ahead need a signal from outside", f"{one.name} reads {name}", "give it")
    return given[name]


def states(D: Diagram, models: Mapping[str, Any]) -> States:
    """The state space of the whole diagram, all loops closed; the poles are the eigenvalues of its A."""
    each = [_states(one, models.get(one.name), D.rate_hz) for one in D.parts]
    a, b, c, d = (_diagonal([one[k] for one in each]) for k in range(4))
    M, n = D.wiring()
    circle = np.eye(len(c)) - d @ M
    if np.linalg.cond(circle) > 1e12:
        raise WrongUseError(
            "a circle of the diagram has no delay and no solution", D.name, "put a filter or a delay into it"
        )
    through = np.linalg.inv(circle)
    by_state, by_signal = through @ c, through @ d @ n
    outputs, added = (np.array(rows) for rows in zip(*(D.reading(name) for name in D.signals), strict=True))
    return States(a + b @ M @ by_state, b @ (n + M @ by_signal), outputs @ by_state, outputs @ by_signal + added)


def _diagonal(matrices: list[Array]) -> Array:
    """Matrices along the diagonal, also such without rows or columns."""
    made = np.zeros((sum(len(one) for one in matrices), sum(one.shape[1] for one in matrices)))
    row = column = 0
    for one in matrices:
        made[row : row + len(one), column : column + one.shape[1]] = one
        row, column = row + len(one), column + one.shape[1]
    return made


def _states(one: Part, model: Any, rate_hz: float) -> tuple[Array, Array, Array, Array]:
    if one.plants:
        return _of_model(one, model, rate_hz)
    if isinstance(one.what, Controller):
        return _of_controller(one.what)
    if one.what is None:
        raise WrongUseError(f"block {one.name} has no controller yet", "nothing", "put it in: D.with_part(name, C)")
    return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.zeros((1, 1))  # taps are added from outside


def _of_model(one: Part, model: Any, rate_hz: float) -> tuple[Array, Array, Array, Array]:
    """A plant's model at the rate, its inputs held."""
    import control

    if model is None:
        raise WrongUseError(f"plant {one.name} needs a model to run", "none", f"give it: {{{one.name!r}: system}}")
    system = control.ss(model)
    if system.isctime(strict=True) or system.dt == 0:
        system = control.c2d(system, 1.0 / rate_hz)
    if abs(system.dt * rate_hz - 1.0) > 1e-9 or (system.noutputs, system.ninputs) != (
        len(one.outputs),
        len(one.inputs),
    ):
        raise WrongUseError(
            f"the model of plant {one.name} has its signals, and the controllers' rate or none",
            f"{system.noutputs} x {system.ninputs}, timebase {system.dt}", f"{rate_hz:g} Hz",
        )  # fmt: skip
    return tuple(np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))  # type: ignore[return-value]


def _of_controller(C: Controller) -> tuple[Array, Array, Array, Array]:
    """Sections in series in direct form II transposed, and whole samples of delay behind them."""
    delay = C.computation_delay_s * C.rate_hz
    if abs(delay - round(delay)) > 1e-6:
        raise WrongUseError(
            f"the delay of {C.loop or 'a controller'} is no whole number of samples", f"{delay:g} samples",
            "simulate with the next whole number",
        )  # fmt: skip
    A, B, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1)
    for b0, b1, b2, a1, a2 in C.biquads():
        own = np.array([[-a1, 1.0], [-a2, 0.0]])
        into = np.array([[b1 - a1 * b0], [b2 - a2 * b0]])
        A = np.block([[A, np.zeros((len(A), 2))], [into @ c, own]])
        B, c, d = np.vstack([B, into @ d]), np.hstack([b0 * c, [[1.0, 0.0]]]), b0 * d
    return _delayed(A, B, c, d, round(delay)) if round(delay) else (A, B, c, d)


def _delayed(A: Array, B: Array, c: Array, d: Array, samples: int) -> tuple[Array, Array, Array, Array]:
    """A state space with a delay line behind its output."""
    n = len(A)
    line, into = np.zeros((n + samples, n + samples)), np.zeros((n + samples, 1))
    line[:n, :n], line[n, :n], into[:n], into[n] = A, c, B, d
    line[range(n + 1, n + samples), range(n, n + samples - 1)] = 1.0
    last = np.zeros((1, n + samples))
    last[0, -1] = 1.0
    return line, into, last, np.zeros((1, 1))
