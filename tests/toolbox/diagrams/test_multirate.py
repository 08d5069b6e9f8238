"""A filter at a multiple of the rate, folded into its plant, against the lifted state space of both."""

import control
import numpy as np
import pytest
from conversions import angular

import loopshape as ls

SLOW = 1000.0


@pytest.mark.parametrize("many", [2, 3, 4])
def test_a_folded_plant_is_that_of_the_lifted_state_space(many):
    rate = many * SLOW
    plant = control.c2d(control.ss(control.tf([4.0e6], [1.0, 300.0, 4.0e6])), 1.0 / rate)
    notch = ls.controller(ls.notch(700.0, 0.1, 0.7), ls.low_pass(900.0, 0.7), rate_hz=rate)
    f = np.arange(1.0, 0.5 * rate)
    f = np.union1d(f, 0.5 * rate - np.geomspace(1e-6, 0.9, 5))
    P = ls.FRF.from_control(plant, f)
    both = control.ss([], [], [], [[1.0]], 1.0 / rate)
    for b0, b1, b2, a1, a2 in notch.biquads():
        both = both * control.ss(control.tf([b0, b1, b2], [1.0, a1, a2], 1.0 / rate))
    A, B, C, D = (np.asarray(m) for m in control.ssdata(plant * both))
    into = sum(np.linalg.matrix_power(A, k) @ B for k in range(many))
    lifted = control.ss(np.linalg.matrix_power(A, many), into, C, D, 1.0 / SLOW)
    found = ls.diagrams.multirate(P, notch, SLOW)
    assert found.frequency_hz.size > 400
    truth = np.asarray(lifted.frequency_response(angular(found.frequency_hz)).frdata).ravel()
    np.testing.assert_allclose(found.siso, truth, rtol=1e-7, atol=1e-9)


def test_the_error_of_a_folded_plant_is_that_of_draws():
    rate, rng = 2000.0, np.random.default_rng(1)
    f = np.arange(1.0, 1000.0)
    H = 1.0 / (1.0 + 1j * f / 100.0)
    low = ls.controller(ls.low_pass(300.0, 0.7), rate_hz=rate)

    def met(noise):
        return ls.diagrams.multirate(
            ls.FRF.from_arrays(f, H + 0.05 * noise, std=0.05 * np.ones(f.size), rate_hz=rate), low, SLOW
        )

    shape = (100, f.size, 2)
    noise = rng.standard_normal(shape) @ np.array([1.0, 1j]) / np.sqrt(2.0)
    drawn = np.array([met(one).siso for one in noise])
    ratio = np.var(drawn, axis=0) / met(np.zeros(f.size)).variance[:, 0, 0]
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)


def test_a_plant_that_does_not_reach_the_images_and_other_rates_are_refused():
    f = np.geomspace(1.0, 400.0, 50)
    P = ls.FRF.from_arrays(f, 1.0 / (1.0 + 1j * f), relative_std=0.01, rate_hz=2000.0)
    with pytest.raises(ls.errors.WrongUseError, match="measured up to half"):
        ls.diagrams.multirate(P, ls.controller(ls.gain(1.0), rate_hz=2000.0), SLOW)
    with pytest.raises(ls.errors.WrongUseError, match="whole multiple"):
        ls.diagrams.multirate(P, ls.controller(ls.gain(1.0), rate_hz=1500.0), SLOW)
