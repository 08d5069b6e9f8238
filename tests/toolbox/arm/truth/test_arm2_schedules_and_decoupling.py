"""Schedules and a decoupling matrix on the 2-DoF arm: what runs is what a loop of plain Python says."""

from dataclasses import replace

import numpy as np
import pytest
from arm2_cases import experiment
from bench_nouns import LoopSetup

import loopshape as ls
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.arm.strategies2 import DUAL, PAIRS

START = (2.0, 3.0, 0.45, 0.4)
MIX = np.array([[1.0, 0.1, 0.0, 0.3], [-0.2, 0.9, 0.4, 0.0], [0.0, 0.5, 1.1, -0.1], [0.6, 0.0, 0.2, 1.0]])


def moving(samples: int) -> np.ndarray:
    """References (n, 4): every one moves."""
    t = np.arange(samples) / 1000.0
    first = np.array([np.radians(2.0), np.radians(3.0), 0.45, 0.4])
    return first + np.outer(t, [np.radians(6.0), np.radians(-10.0), 0.15, 0.1])


def simulated(loops: dict[str, dict], samples: int = 400, **fields):
    """A recording of the arm, with changes of its loops' setups by loop."""
    e = experiment(START, samples, references=moving(samples), seed=5, **fields)
    e = replace(e, loops=tuple(replace(loop, **loops.get(loop.name, {})) for loop in e.loops))
    (r,) = Arm2().simulate([e])
    assert r.info.ended_early is None
    return r


def assert_alike(a, b):
    assert list(a.columns) == list(b.columns)
    for name in a.columns:
        np.testing.assert_array_equal(a.column(name), b.column(name), err_msg=name)


def one_node(C: ls.Controller) -> dict:
    return {
        "controller": None,
        "schedule": ls.schedules.gain_scheduled([C], [{"theta1_deg": 0.0}], {"theta1_deg": "theta1"}),
    }


def test_a_schedule_of_one_gain_is_that_gain_bit_for_bit():
    """Of gains alone: there both realisations (direct forms I and II transposed) do the same arithmetic."""
    gains = [ls.controller(ls.gain(2.0 + k), rate_hz=1000.0, loop=loop) for k, loop in enumerate(Arm2().loops)]
    plain = simulated({}, controllers=gains)
    assert_alike(plain, simulated({C.loop: one_node(C) for C in gains}, controllers=gains))
    assert np.ptp(plain.column("z_theta2_v")) > 0.01


def test_the_identity_is_no_matrix_bit_for_bit():
    names = Arm2().loops
    same = {a: {"decoupling": {b: float(a == b) for b in names}} for a in names}
    injected = np.random.default_rng(2).normal(0.0, 0.05, (400, 4))
    entering = {"injection": "plant_input", "injected": injected}
    assert_alike(simulated({}, **entering), simulated(same, **entering))


def node(gain: float, corner_hz: float) -> ls.Controller:
    return ls.controller(
        ls.gain(gain), ls.lead_lag(0.5, 8.0), ls.low_pass(corner_hz, 0.8), rate_hz=1000.0, loop="theta1"
    )


def answer(nodes: tuple[ls.Controller, ls.Controller], share: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Sample by sample, the interpolated polynomials in s made discrete by Tustin's rule, in direct form I."""
    z = np.array(error)
    for k in range(len(nodes[0].blocks)):
        both = [np.array(C.blocks[k].section()) for C in nodes]  # constants of the denominators are 1
        order = int(max(np.flatnonzero(p)[-1] for p in both[0]))
        out, given = np.zeros(z.size + order), np.concatenate([np.zeros(order), z])
        for n in range(z.size):
            b, a = (discrete(p, order) for p in (1.0 - share[n]) * both[0] + share[n] * both[1])
            before = slice(n, n + order)
            sum_ = b @ given[n : n + order + 1][::-1] - a[1:] @ out[before][::-1]
            out[n + order] = sum_ / a[0]
        z = out[order:]
    return z


def discrete(p: np.ndarray, order: int, k: float = 2000.0) -> np.ndarray:
    """Falling powers of z of (sum of p_m s^m)(z + 1)^order at s = k (z - 1)/(z + 1), by expansion."""
    out = np.zeros(order + 1)
    for m in range(order + 1):
        factors = [np.array([1.0, -1.0])] * m + [np.array([1.0, 1.0])] * (order - m)
        term = np.array([p[m] * k**m])
        for factor in factors:
            term = np.convolve(term, factor)
        out += term
    return out


@pytest.mark.parametrize("follows", ["reference", "output"])
def test_the_logged_z_is_that_of_the_interpolated_controller(follows: str):
    """theta1's controller follows theta2, behind a lag; z from the logged r and y."""
    nodes = node(4.0, 12.0), node(9.0, 7.0)
    points = [{"theta2_deg": 1.0}, {"theta2_deg": 3.5}]
    S = ls.schedules.gain_scheduled(list(nodes), points, {"theta2_deg": ("theta2", follows)}, lag_s=0.05)
    r = simulated({"theta1": {"controller": None, "schedule": S}}, 700)
    seen = np.degrees(r.column("r_theta2_rad" if follows == "reference" else "theta2_rad"))
    at, lag = seen.copy(), np.exp(-1.0 / (1000.0 * 0.05))
    for n in range(1, at.size):
        at[n] = lag * at[n - 1] + (1.0 - lag) * seen[n]
    share = np.clip((at - 1.0) / 2.5, 0.0, 1.0)
    assert np.ptp(share) > 0.1
    z = answer(nodes, share, r.column("r_theta1_rad") - r.column("theta1_rad"))
    np.testing.assert_allclose(r.column("z_theta1_v"), z, rtol=0.0, atol=1e-9 * np.abs(z).max())


def test_every_loop_runs_its_own_schedule():
    """Two nodes each, following the loop's own reference: the gain at each sample is read off z and the error."""
    names, units = ("theta1", "theta2", "p_a", "p_c"), ("deg", "deg", "bar", "bar")
    setups = {}
    for k, (loop, unit) in enumerate(zip(names, units, strict=True)):
        low, high = (ls.controller(ls.gain(g + k), rate_hz=1000.0, loop=loop) for g in (1.0, 3.0))
        knots = [{f"x_{unit}": 0.0}, {f"x_{unit}": 6.0 if unit == "deg" else 0.9}]
        setups[loop] = {
            "controller": None,
            "schedule": ls.schedules.gain_scheduled([low, high], knots, {f"x_{unit}": loop}, lag_s=0.0),
        }
    r = simulated(setups)
    outputs = (r.column("theta1_rad"), r.column("theta2_rad"), r.column("p_a_bar"), r.column("p_c_bar"))
    references = [
        r.column(f"r_{loop}_{'rad' if unit == 'deg' else 'bar'}") for loop, unit in zip(names, units, strict=True)
    ]
    for k, loop in enumerate(names):
        share = np.clip(np.degrees(references[k]) / 6.0 if k < 2 else references[k] / 0.9, 0.0, 1.0)
        expected = (1.0 + k + 2.0 * share) * (references[k] - outputs[k])
        np.testing.assert_allclose(r.column(f"z_{loop}_v"), expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("strategy", [DUAL, PAIRS], ids=["dual", "pairs"])
def test_the_commands_are_those_of_the_matrix(strategy):
    """u = D W (z + n) from the logged z and what was injected, with the strategy's D."""
    arm = Arm2(strategy)
    injected = np.random.default_rng(2).normal(0.0, 0.05, (300, 4))
    loops = arm.loop_setups(arm.default_controllers(1000.0), "plant_input")
    loops = tuple(weighted(loop, MIX[k], arm.loops) for k, loop in enumerate(loops))
    point = dict(zip(strategy.point_keys, (0.0, 0.0, 0.8, 0.9) if strategy is PAIRS else START, strict=True))
    base = experiment(START, 300, injection="plant_input", injected=injected, seed=1)
    references = np.tile(arm.setpoint(point), (300, 1))
    (r,) = arm.simulate([replace(base, loops=loops, operating_point=point, references=references)])
    z = np.stack([r.column(f"z_{loop}_v") for loop in arm.loops], axis=1)
    u = np.stack([r.column(f"u_{m}_v") for m in "abcd"], axis=1)
    np.testing.assert_allclose(u, (z + injected[: len(z)]) @ MIX.T @ strategy.decoupling.T, rtol=0.0, atol=1e-12)


def weighted(loop: LoopSetup, row: np.ndarray, names: tuple[str, ...]) -> LoopSetup:
    return replace(loop, decoupling=dict(zip(names, row.tolist(), strict=True)))


def test_the_study_s_schedule_and_matrix_reach_the_arm(tmp_path):
    """By the public verb: `ls.rig.measure(..., controllers, decoupling)` writes them with the run."""
    study = tmp_path / "study.toml"
    study.write_text(
        'format = "loopshape-study/1"\nrig = "simulated"\nplant = "arm-2dof"\n'
        "operating_points = [{ theta1_deg = 0.0, theta2_deg = 0.0, p_a_bar = 0.4, p_c_bar = 0.4 }]\n"
        '[[experiment]]\nname = "rest"\nduration_s = 0.2\n'
    )
    S = ls.schedules.gain_scheduled(
        [node(4.0, 12.0), node(9.0, 7.0)], [{"theta2_deg": -1.0}, {"theta2_deg": 3.0}], {"theta2_deg": "theta2"}
    )
    weights = {"theta1": {"theta1": 1.0, "p_c": 0.5}}
    ls.rig.measure(study, tmp_path / "run", controllers=[S], decoupling=weights)
    run = ls.read(tmp_path / "run")
    assert run.loops[0].schedule.variables == S.variables
    assert run.loops[0].decoupling == weights["theta1"]
    r = run.recordings[0]
    u_d = r.column("z_theta1_v") + 0.5 * r.column("z_p_c_v")
    np.testing.assert_allclose(r.column("u_d_v"), u_d, rtol=0.0, atol=1e-6)
