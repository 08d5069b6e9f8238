"""A matrix from the linearised 2-DoF arm, run on the simulated one: pressures move, and the angles hardly do."""

from dataclasses import replace

import numpy as np
import pytest
from arm2_cases import MIDDLE, experiment, numbers, point

import loopshape as ls
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.arm.dynamics.linear2 import linearise2

SECONDS = 8.0


def linear_matrix() -> dict[str, dict[str, float]]:
    """Below joint 1's mode, where the coupling hardly turns with frequency."""
    f_hz = np.geomspace(0.3, 1.2, 15)
    H = linearise2(numbers(), *MIDDLE).response(f_hz)
    names = Arm2().loops
    P = ls.FRF.from_arrays(f_hz, H, relative_std=0.01, rate_hz=1000.0)
    W = ls.diagrams.decouple(P, (0.3, 1.2)).matrix
    return {a: dict(zip(names, W[k].tolist(), strict=True)) for k, a in enumerate(names)}


def moved(weights: dict[str, dict[str, float]]) -> np.ndarray:
    """Error (n, 2) of both angles in rad while p_A rises by 0.1 bar and p_C by 0.15, within a second each."""
    t = np.arange(round(1000 * SECONDS)) / 1000.0
    references = np.tile(Arm2().setpoint(point(MIDDLE)), (t.size, 1))
    references[:, 2] += 0.1 * np.clip(t - 1.0, 0.0, 1.0)
    references[:, 3] += 0.15 * np.clip(t - 4.0, 0.0, 1.0)
    e = experiment(MIDDLE, t.size, references=references, seed=3)
    e = replace(e, loops=tuple(replace(loop, decoupling=weights.get(loop.name, {})) for loop in e.loops))
    (r,) = Arm2().simulate([e])
    assert r.info.ended_early is None
    pressures = np.stack([r.column("p_a_bar"), r.column("p_c_bar")])[:, -500:].mean(axis=1)
    np.testing.assert_allclose(pressures, [0.5, 0.55], atol=0.02)
    return np.stack([r.column(f"r_{j}_rad") - r.column(f"{j}_rad") for j in ("theta1", "theta2")], axis=1)


def test_pressures_move_the_angles_by_a_quarter_at_most_of_what_they_did():
    """The linear coupling within a joint goes; a quarter leaves room for dead zone, exhaust and the shared throttle."""
    without, behind = (np.sqrt(np.mean(moved(w) ** 2, axis=0)) for w in ({}, linear_matrix()))
    assert np.all(without > np.radians(0.1))
    assert np.all(behind < 0.25 * without)


def test_the_matrix_is_what_the_commands_say():
    """u_A = z_theta2 + z_pA, u_B = -z_theta2: all of z_theta2 in A and half of z_pA in both keep the loops apart."""
    W = linear_matrix()
    assert W["p_a"]["theta2"] == pytest.approx(-1.0, abs=0.1)
    assert W["theta2"]["p_a"] == pytest.approx(-0.5, abs=0.1)
    assert W["p_c"]["theta1"] == pytest.approx(1.0, abs=0.1)
    assert W["theta1"]["p_c"] == pytest.approx(0.5, abs=0.1)
