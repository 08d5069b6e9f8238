"""A global search by scipy, far slower, finds nothing clearly better than `tune`."""

import sys
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block
from scipy.optimize import differential_evolution

from loopshape.design.problem.measures import measure
from loopshape.design.problem.problem import problem
from loopshape.loop.loops import loops_of

sys.path.insert(0, str(Path(__file__).parents[3] / "speed"))
from tune_workload import frfs, requirements

import loopshape as ls


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.hour)])
def test_tune_reaches_97_percent_of_a_global_search(seed: int) -> None:
    plants, limits = [f for k, f in enumerate(frfs(120)) if k % 4 == 0], requirements()
    unit = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), 1000.0)
    p = problem(loops_of(plants, unit, limits)[0], limits, 1000.0)

    def cost(x: np.ndarray) -> float:
        m = measure(p, x, {})
        return 50.0 if not m.stable else float(-m.ln_bandwidth.min() + 20.0 * max(0.0, -m.worst))

    bounds = list(zip(p.low, p.high, strict=True))
    found = differential_evolution(cost, bounds, seed=seed, maxiter=120, popsize=10, tol=1e-8, polish=False)
    ours = ls.tune(plants, limits, seed=seed)
    assert ours.feasible
    assert ours.bandwidth_hz >= 0.97 * np.exp(-found.fun)
