"""C1 * C2, P * C, P + Q, P.feedback(C) and ls.Loop(P, C): against numpy, python-control and draws of the error."""

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest

import loopshape as ls

F = np.geomspace(1.0, 100.0, 40)
S = 2j * np.pi * F
PLANT = 40.0 / (S * (S / 60.0 + 1.0))
P = ls.FRF.from_arrays(F, PLANT, std=0.01 * np.abs(PLANT))
GAIN, LEAD = ls.controller(ls.gain(2.0), rate_hz=1000.0), ls.controller(ls.lead_lag(5.0, 50.0), rate_hz=1000.0)
C = ls.controller(ls.gain(2.0), ls.lead_lag(5.0, 50.0), rate_hz=1000.0)


def std(frf: ls.FRF) -> np.ndarray:
    return np.sqrt(frf.variance[:, 0, 0])


def test_controllers_in_series_are_one_controller():
    both = GAIN * LEAD
    assert both.digest == C.digest
    late = ls.controller(ls.gain(1.0), rate_hz=1000.0, computation_delay_s=1e-4)
    assert (late * late).computation_delay_s == pytest.approx(2e-4)
    np.testing.assert_allclose((late * late).response(F), late.response(F) ** 2, rtol=1e-12)


@pytest.mark.parametrize("changed", [{"rate_hz": 2000.0}, {"rate_hz": 1000.0, "precision": "single"}])
def test_controllers_that_run_otherwise_are_not_put_in_series(changed):
    with pytest.raises(ls.LoopshapeError, match=r"controllers in series run alike; received"):
        GAIN * ls.controller(ls.gain(1.0), **changed)


def test_controllers_of_two_loops_are_not_put_in_series():
    one, other = (ls.controller(ls.gain(2.0), rate_hz=1000.0, loop=name) for name in ("x", "y"))
    assert (one * GAIN).loop == (GAIN * one).loop == "x"
    with pytest.raises(ls.LoopshapeError, match=r"controllers in series run alike; received loop = 'x' and 'y'"):
        one * other


def test_open_loop_sum_and_multiples_with_their_errors():
    c = C.response(F)
    for L in (P * C, C * P):
        np.testing.assert_allclose(L.siso, c * PLANT, rtol=1e-12)
        np.testing.assert_allclose(std(L), np.abs(c) * std(P), rtol=1e-9)
    Q = ls.FRF.from_arrays(F, 1.0 / S, std=0.02 / np.abs(S))
    np.testing.assert_allclose((P + Q).siso, PLANT + 1.0 / S, rtol=1e-12)
    np.testing.assert_allclose(std(P - Q), np.hypot(std(P), std(Q)), rtol=1e-9)
    np.testing.assert_allclose((P * Q).siso, PLANT / S, rtol=1e-12)
    for twice in (2.0 * P, P * 2.0, -(-2.0 * P), np.float64(2.0) * P):
        np.testing.assert_allclose(twice.siso, 2.0 * PLANT, rtol=1e-12)
        np.testing.assert_allclose(std(twice), 2.0 * std(P), rtol=1e-12)


def test_the_closed_loop_is_that_of_python_control_and_of_draws():
    loop = ls.Loop(P, C)
    plant, by = control.FRD(PLANT, 2.0 * np.pi * F), control.FRD(C.response(F), 2.0 * np.pi * F)
    T = np.squeeze(control.feedback(plant * by, 1).frdata)
    rng = np.random.default_rng(3)
    error = rng.standard_normal((4000, 2, F.size)) / np.sqrt(2.0)
    drawn = PLANT + std(P) * (error[:, 0] + 1j * error[:, 1])
    c = C.response(F)
    for ours, true, draws in (
        (loop.complementary, T, c * drawn / (1.0 + c * drawn)),
        (loop.sensitivity, 1.0 - T, 1.0 / (1.0 + c * drawn)),
        (loop.process, T / c, drawn / (1.0 + c * drawn)),
        (loop.control, T / PLANT, c / (1.0 + c * drawn)),
        (loop.open_loop, c * PLANT, c * drawn),
    ):
        np.testing.assert_allclose(ours.siso, true, rtol=1e-9)
        np.testing.assert_allclose(std(ours), np.sqrt(np.mean(np.abs(draws - true) ** 2, axis=0)), rtol=0.1)
    np.testing.assert_array_equal(P.feedback(C).S_o.siso, loop.sensitivity.siso)


def test_two_loops_are_the_same_noun_by_matrices():
    G = np.stack([PLANT, 0.3 / S, -0.2 / S, 2.0 * PLANT], axis=1).reshape(-1, 2, 2)
    both = (ls.controller(ls.gain(2.0), rate_hz=1000.0, loop="x"), LEAD)
    plant = ls.FRF.from_arrays(F, G, std=0.01, outputs=["x_m", "y_m"], inputs=["u_v", "w_v"])
    loop, k = ls.Loop(plant, both), np.stack([one.response(F) for one in both], axis=1)
    K = k[:, :, None] * np.eye(2)
    So = np.linalg.inv(np.eye(2) + G @ K)
    for bare, ours, true in (
        (loop.L, loop.open_loop, G @ K),
        (loop.S, loop.sensitivity, So),
        (loop.T, loop.complementary, G @ K @ So),
        (loop.PS, loop.process, So @ G),
        (loop.CS, loop.control, K @ So),
    ):
        np.testing.assert_allclose(bare, true, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(ours.response, true, rtol=1e-9, atol=1e-12)
        assert ours.covariance.shape == (F.size, 4, 4)
    np.testing.assert_allclose(loop.C, K)
    np.testing.assert_allclose(loop.L_i, K @ G)
    with pytest.raises(ls.LoopshapeError, match="one loop's controller was requested of several loops"):
        _ = loop.controller
    assert len(ls.plot(loop).axes) >= 4  # S, element by element
    plt.close("all")


def test_one_loop_in_a_list_is_one_loop():
    one, listed = ls.Loop(P, C), ls.Loop(P, [C])
    for name in ("C", "L", "S", "T", "CS", "PS"):
        np.testing.assert_array_equal(getattr(one, name), getattr(listed, name))
        assert getattr(one, name).shape == F.shape
    np.testing.assert_allclose(one.determinant, 1.0 + one.L, rtol=1e-13)


@pytest.mark.parametrize(
    ("controllers", "words"),
    [((C, C), "a square plant, and a controller for each channel; received 1 x 1, 2 controllers"),
     ((), "received 1 x 1, 0 controllers")],
)  # fmt: skip
def test_as_many_controllers_as_channels(controllers, words):
    with pytest.raises(ls.LoopshapeError, match=words):
        ls.Loop(P, controllers)


def test_what_does_not_multiply_is_refused_by_python():
    for other in ("C", None, [1.0], np.array([1.0, 2.0])):
        with pytest.raises(TypeError):
            P * other
        with pytest.raises(TypeError):
            other * P
        with pytest.raises(TypeError):
            C * other
