"""Closed-loop stability of the linearised arm, by Nyquist's count and by the eigenvalues of one PWM period."""

import numpy as np
import pytest
from bench_nouns import Loop
from scipy.linalg import expm
from source_controllers import angle_controller

import loopshape as ls
from loopshape.loop.margin.margins import margins
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.source import EQUILIBRIA

F = np.geomspace(0.01, 100.0, 3000)
#: table 5.1; unstable on the printed model (ARM.md, section 10)
SOURCE = angle_controller()
#: where the source's controller is stable on the printed model all the same: stiff arm, low gain
SOURCE_STABLE = {(0.0, 1.4), (-15.0, 1.6), (0.0, 1.6), (15.0, 1.6), (0.0, 1.8)}


def nyquist(lin, controllers):
    """Answers of `loopshape.loop` for both loops on a dense FRF of the linearisation, one at a time."""
    P = lin.response(F)
    out = []
    for k, controller in enumerate(controllers):
        frf = ls.FRF(F, P[:, k : k + 1, k : k + 1], np.zeros((F.size, 1, 1)), F > 0.0, ("z",), ("y",), "linearisation")
        out.append(margins(Loop(frf, controller, integrators=1, unstable_poles=0)).stable)
    return out


def state_space(sections):
    """Matrices A, B, C, D of a cascade of biquads with a0 = 1 (b0, b1, b2, a1, a2 a row)."""
    A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1)
    for b0, b1, b2, a1, a2 in sections:
        a, b, c = np.array([[-a1, 1.0], [-a2, 0.0]]), np.array([[b1 - a1 * b0], [b2 - a2 * b0]]), np.array([[1.0, 0.0]])
        A = np.block([[A, np.zeros((len(A), 2))], [b @ C, a]])
        B, C, D = np.vstack([B, b @ D]), np.hstack([b0 * C, c]), b0 * D
    return A, B, C, D


def growth(lin, controllers, gains=None):
    """Largest size of an eigenvalue of both loops over one PWM period of 20 ticks.

    A short pulse of duration u T at the period's start moves the state by B u T at once; the controllers run
    at each tick on the angle and on p_A + p_B.
    """
    outputs = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    spaces = [state_space(c.biquads()) for c in controllers]
    n = 4 + sum(len(s[0]) for s in spaces)
    tick, z, at = np.eye(n), np.zeros((2, n)), 4
    tick[:4, :4] = np.eye(4)
    for k, (A, B, C, D) in enumerate(spaces):
        rows = slice(at, at + len(A))
        tick[rows, rows], tick[rows, :4] = A, -B @ outputs[k : k + 1]
        z[k, rows], z[k, :4] = C, -(D @ outputs[k : k + 1])
        at += len(A)
    flow = np.eye(n)
    flow[:4, :4] = expm(lin.dynamics * 1e-3)
    pulse = np.eye(n)
    pulse[:4] += np.reshape(lin.inputs(gains), (4, 2)) @ z * 0.02
    first = flow @ (tick + pulse - np.eye(n))
    return np.abs(np.linalg.eigvals(np.linalg.matrix_power(flow @ tick, 19) @ first)).max()


@pytest.mark.parametrize("point", EQUILIBRIA)
def test_default_controllers_are_stable_by_both_routes(arm, arm_constants, point):
    lin = linearise(arm_constants(), *point)
    controllers = arm.default_controllers(1000.0)
    assert nyquist(lin, controllers) == ["stable", "stable"]
    assert growth(lin, controllers) < 0.99  # the slowest motion has died to 1/e within 2 s


@pytest.mark.parametrize("point", EQUILIBRIA)
def test_source_s_angle_controller_is_judged_alike_by_both_routes(arm, arm_constants, point):
    lin = linearise(arm_constants(), *point)
    controllers = (SOURCE, arm.default_controllers(1000.0)[1])
    stable = point in SOURCE_STABLE
    assert nyquist(lin, controllers)[0] == ("stable" if stable else "unstable")
    assert (growth(lin, controllers) < 1.0) == stable


@pytest.mark.parametrize("point", EQUILIBRIA)
def test_direction_of_flow_does_not_unsettle_it_except_where_a_muscle_exceeds_the_supply(arm, arm_constants, point):
    """There an open in-valve empties the muscle: its gain turns round, and the loop that fills is unstable."""
    lin = linearise(arm_constants(), *point)
    controllers = arm.default_controllers(1000.0)
    (fill_a, fill_b), (exhaust_a, exhaust_b) = lin.fill, lin.exhaust
    gains = [(fill_a, fill_b), (exhaust_a, exhaust_b), (fill_a, exhaust_b), (exhaust_a, fill_b)]
    worst = max(growth(lin, controllers, np.array(g)) for g in gains)
    above_supply = point in {(-30.0, 1.4), (30.0, 1.4), (-15.0, 1.6), (15.0, 1.6)}
    assert (min(fill_a, fill_b) < 0.0) == above_supply
    assert (worst > 1.0) == above_supply
    if not above_supply:
        assert worst < 0.99
