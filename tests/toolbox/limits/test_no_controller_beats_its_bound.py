"""A controller under limits at its own peaks never has more bandwidth than the bound for these limits."""

import numpy as np
import pytest
from bench_nouns import Block, TransferFunction
from bound_cases import RATE, limits, loop_of, own_limits, random_controller, random_plant

import loopshape as ls
from loopshape.loop.stability.stability import closed_loop_stability
from loopshape.toolbox.limits import bound_nodes
from loopshape.toolbox.limits.bound import excluded


def crossing_hz(loop):
    """First frequency at which |L| falls below 1, by the lines."""
    return float(loop.frequency_hz[np.flatnonzero(np.abs(loop.L) < 1.0)[0] - 1])


def stable_loops(rng, plants):
    """Loops of plants under one random controller with the largest gain of some at which all are stable."""
    blocks = random_controller(rng)
    for gain in np.geomspace(100.0, 1.0, 25):
        controller = ls.Controller("one", (Block("gain", {"gain": gain}), *blocks), RATE)
        loops = [loop_of(model, controller, k, name=f"p{n}") for n, (model, k) in enumerate(plants)]
        good = all(closed_loop_stability(one).outcome == "stable" for one in loops)
        if good and max(np.abs(1.0 / (1.0 + one.L)).max() for one in loops) < 3.0:
            return loops
    return None


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_one_plant(seed):
    rng = np.random.default_rng(seed)
    loops = stable_loops(rng, [random_plant(rng)])
    assert loops is not None
    bound = excluded(loops[0], loops, own_limits(loops))
    assert crossing_hz(loops[0]) <= bound.bound_hz < np.inf
    assert bound.bound_hz > bound.first_hz


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20, 22))
def test_several_plants_together_by_the_q_of_each(seed):
    rng = np.random.default_rng(seed)
    model, k = random_plant(rng)
    others = [(TransferFunction(factor * model.num, model.den, model.delay_s), k) for factor in (0.6, 1.7)]
    loops = stable_loops(rng, [(model, k), *others])
    assert loops is not None
    asked = own_limits(loops)
    lowest = min(crossing_hz(loop) for loop in loops)
    for loop in loops[:2]:
        together, alone = excluded(loop, loops, asked), excluded(loop, [loop], asked)
        assert lowest <= together.bound_hz
        assert together.bound_hz <= 1.02 * alone.bound_hz  # more is asked; a node of 1.5 % aside


@pytest.mark.long
def test_several_plants_bound_more_than_each_alone():
    # a gain of 1 and of 16, |S| within 6 dB: what lifts the weak one over 0 dB is loud on the strong one
    plants = [(TransferFunction([k], [1.0, 0.0], 0.02), 1) for k in (1.0, 16.0)]
    loops = [loop_of(model, integrators=k, name=f"p{n}") for n, (model, k) in enumerate(plants)]
    asked = limits(sensitivity_peak_db=6.0, control_peak_db=40.0)
    alone = min(excluded(loop, [loop], asked).bound_hz for loop in loops)
    together = min(excluded(loop, loops, asked).bound_hz for loop in loops)
    assert together < 0.8 * alone


@pytest.mark.parametrize("gain", [2.0, 4.0])
def test_an_unstable_plant(gain):
    # 1/(s/a - 1) exp(-s d) is held by a gain above 1; the free parameter is built about that controller
    model = TransferFunction([1.0], [1.0 / (2.0 * np.pi), -1.0], 0.01)
    controller = ls.Controller("one", (Block("gain", {"gain": gain}),), RATE)
    loop = loop_of(model, controller, 0, 1)
    assert closed_loop_stability(loop).outcome == "stable"
    asked = own_limits([loop])
    bound = excluded(loop, [loop], asked)
    assert crossing_hz(loop) <= bound.bound_hz < np.inf


def test_both_parametrisations_give_one_bound(monkeypatch):
    # the closed loops of a stable plant, with CS itself free or with the parameter about a controller
    model = TransferFunction([2.0], np.polymul([1.0, 1.0], [0.02, 1.0]), 0.01)
    pi = ls.Controller("one", (Block("gain", {"gain": 1.0}), Block("pi", {"f_hz": 0.1})), RATE)
    loop = loop_of(model, pi)
    asked = limits(sensitivity_peak_db=5.0, control_peak_db=8.0)  # both bind
    direct = excluded(loop, [loop], asked).bound_hz
    monkeypatch.setattr(bound_nodes, "_itself", bound_nodes._about_controller)
    assert excluded(loop, [loop], asked).bound_hz == pytest.approx(direct, rel=0.03)
