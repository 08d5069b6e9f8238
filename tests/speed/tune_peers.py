"""Peers of `tune` on its workload: scipy's global optimisers, a LQG of python-control, and a rule of open-loop shaping.

Each gives the lowest bandwidth that it reaches within the limits at all 24 FRFs. The optimisers search the same
structure with the tuner's own readings; the others bring a controller of theirs, whose gain is bisected.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import control
import numpy as np
from scipy.optimize import differential_evolution, dual_annealing
from tune_workload import frfs, requirements

import loopshape as ls
from loopshape.core.units import angular, db, deg
from loopshape.data.control.controller import Block
from loopshape.design.problem.measures import measure
from loopshape.design.problem.problem import Problem, problem
from loopshape.loop.loops import loops_of
from loopshape.loop.margin.margins import Reader
from loopshape.loop.stability.stability import count_unstable
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants

PENALTY = 20.0


class LateError(Exception):
    """The time is over."""


def workload_problem(lines: int = 500) -> Problem:
    """The tuner's own problem of the workload."""
    plants, required = frfs(lines), requirements()
    unit = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), 1000.0)
    return problem(loops_of(plants, unit, required)[0], required, 1000.0)


#: what a local search from one good start needs: 20 steps of 9 evaluations for slopes by differences, and a few more
EVALUATIONS = 200


def bare(controller: ls.Controller, plants: Sequence[ls.FRF], required: ls.Requirements) -> float:
    """Seconds for so many times L = C P and its margins on every line of every plant, with nothing about it.

    The least that any search on all lines can take; it has no starts, no slopes, no count and no intervals.
    """
    reader = Reader.of(required)
    f, above = plants[0].frequency_hz, np.geomspace(plants[0].frequency_hz[-1], 450.0, 80)[1:]
    P = np.array([frf.siso for frf in plants])
    begun = time.process_time()
    for _ in range(EVALUATIONS):
        C = controller.response(f)
        reader.read(f, C * P, C, above, controller.response(above))
    return time.process_time() - begun


def _timed(p: Problem, seconds: float) -> tuple[Callable[[np.ndarray], float], list[float]]:
    """A cost that remembers the largest bandwidth within all limits and ends the search when time is over."""
    best, begun = [0.0], time.process_time()

    def cost(x: np.ndarray) -> float:
        if time.process_time() - begun > seconds:
            raise LateError
        m = measure(p, np.asarray(x), {})
        slowest = float(m.ln_bandwidth.min())
        value = -slowest + PENALTY * max(0.0, -m.worst)
        if value < 50.0 and not m.stable:
            return 50.0
        if m.worst >= -1e-6:
            best[0] = max(best[0], float(np.exp(slowest)))
        return value

    return cost, best


def evolution(seconds: float, seed: int = 0) -> float:
    """Lowest bandwidth in Hz by scipy's differential evolution within so many seconds of processor time."""
    p = workload_problem()
    cost, best = _timed(p, seconds)
    bounds = list(zip(p.low, p.high, strict=True))
    with suppress(LateError):
        differential_evolution(cost, bounds, seed=seed, maxiter=10**6, popsize=15, tol=0.0, polish=False)
    return best[0]


def annealing(seconds: float, seed: int = 0) -> float:
    """Lowest bandwidth in Hz by scipy's dual annealing, with its local searches, within so many seconds."""
    p = workload_problem()
    cost, best = _timed(p, seconds)
    with suppress(LateError):
        dual_annealing(cost, list(zip(p.low, p.high, strict=True)), seed=seed, maxiter=10**6)
    return best[0]


def _slowest(C: np.ndarray, f: np.ndarray, plants: list[np.ndarray]) -> float:
    """Lowest bandwidth of C (nf,) over plants with one integrator, 0 where one limit is missed at one of them."""
    required, slowest = requirements(), np.inf
    for P in plants:
        L = C * P
        size, S = np.abs(L), 1.0 / (1.0 + L)
        if db(np.abs(S).max()) > required.sensitivity_peak_db or db(np.abs(C * S).max()) > required.control_peak_db:
            return 0.0
        crossings = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) < 0.0)
        axis = np.flatnonzero((L.imag[:-1] * L.imag[1:] < 0.0) & (L.real[:-1] < 0.0))
        margin = -float(db(max(size[axis][size[axis] < 1.0].max(initial=0.0), size[-1])))
        phase = np.abs(deg(np.angle(-L[crossings]))).min(initial=180.0)
        if size[0] <= 1.0 or size[-1] >= 1.0 or phase < required.phase_margin_deg or margin < required.gain_margin_db:
            return 0.0
        if count_unstable(L, 1, 0, np.zeros(0, dtype=complex)) != 0:
            return 0.0
        k = crossings[0]
        slowest = min(slowest, float(f[k] * (f[k + 1] / f[k]) ** (np.log(size[k]) / np.log(size[k] / size[k + 1]))))
    return slowest


def _best_gain(C: np.ndarray, f: np.ndarray, plants: list[np.ndarray]) -> float:
    """Lowest bandwidth with the best gain on C, from where it first crosses 1 at the slowest plant upwards."""
    least = 1.0 / min(abs(C[0] * P[0]) for P in plants)
    return max(_slowest(gain * C, f, plants) for gain in least * np.geomspace(1.0001, 100.0, 150))


def rule_of_thumb() -> float:
    """Open-loop shaping by rule: lead from a third to three times the crossover, low-pass at ten times, the best gain.

    With the source's notch at 4.5 Hz; the best over crossovers from 0.2 to 10 Hz.
    """
    plants = frfs(500)
    f, P = plants[0].frequency_hz, [frf.siso for frf in plants]
    notch = Block("notch", {"f1_hz": 4.5, "f2_hz": 4.5, "damping1": 0.1, "damping2": 1.0})

    def shaped(crossover_hz: float) -> np.ndarray:
        lead = Block("lead_lag", {"f1_hz": crossover_hz / 3.0, "f2_hz": 3.0 * crossover_hz})
        low_pass = Block("low_pass_2", {"f_hz": 10.0 * crossover_hz, "damping": 0.7})
        return ls.Controller("theta2", (lead, notch, low_pass), 1000.0).response(f)

    return max(_best_gain(shaped(c), f, P) for c in np.geomspace(0.2, 10.0, 20))


def lqg() -> float:
    """A LQG of python-control for the middle of the operating points with its delay, with the best gain.

    The best over 12 x 12 weights of control and noise.
    """
    plants = frfs(500)
    f, P = plants[0].frequency_hz, [frf.siso for frf in plants]
    kappa, eigen_hz, damping = linearise(constants(ARM1_PARAMETERS.vector()), 0.0, 1.4).third_order()
    w = float(angular(eigen_hz))
    arm = control.tf([kappa], [1.0, 2.0 * damping * w, w**2, 0.0])
    model = control.tf2ss(control.series(arm, control.tf(*control.pade(2e-3, 1))))
    A, B, C = model.A, model.B, model.C
    s, best = 1j * angular(f), 0.0
    for weight in np.geomspace(1e-6, 10.0, 12):
        K, _, _ = control.lqr(A, B, C.T @ C, weight * np.eye(1))
        for noise in np.geomspace(1e-8, 1e-1, 12):
            G, _, _ = control.lqe(A, B, C, np.eye(1), noise * np.eye(1))
            states = s[:, None, None] * np.eye(len(A)) - (A - B @ K - G @ C)
            response = (K @ np.linalg.solve(states, np.broadcast_to(G, (f.size, *G.shape))))[:, 0, 0]
            best = max(best, _best_gain(response, f, P))
    return best
