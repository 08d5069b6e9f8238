"""Sensor noise has the statistics it promises, and what is logged lies on the converters' grid."""

import math

import numpy as np
import pytest
from scipy import stats

from loopshape.toolbox.gap.noise import normal_pair, start_state

N = 200_000


def draws(seed, stream=0, n=N):
    out, state = np.empty(n), start_state(seed, stream)
    for k in range(0, n, 2):
        state, out[k], out[k + 1] = normal_pair(state)
    return out


@pytest.mark.parametrize("seed", [0, 1, 100_003])
def test_draws_are_standard_normal(seed):
    x = draws(seed)
    assert abs(x.mean()) < 4.0 / math.sqrt(N)
    assert abs(x.var() - 1.0) < 4.0 * math.sqrt(2.0 / N)
    assert abs(stats.skew(x)) < 4.0 * math.sqrt(6.0 / N)
    assert abs(stats.kurtosis(x)) < 4.0 * math.sqrt(24.0 / N)
    assert stats.kstest(x, "norm").pvalue > 1e-4  # Kolmogorov-Smirnov, the whole distribution


def test_successive_draws_are_uncorrelated():
    x = draws(7)
    for lag in range(1, 21):
        assert abs(x[lag:] @ x[:-lag]) / N < 4.0 / math.sqrt(N), lag
        assert abs((x[lag:] ** 2 - 1.0) @ (x[:-lag] ** 2 - 1.0)) / N < 4.0 * 2.0 / math.sqrt(N), lag


@pytest.mark.parametrize("other", [(7, 1), (8, 0), (7 + 2**32, 0)])
def test_streams_and_seeds_are_independent(other):
    x, y = draws(7), draws(*other)
    for lag in range(-3, 4):
        assert abs(np.roll(x, lag) @ y) / N < 4.0 / math.sqrt(N), lag


@pytest.fixture(scope="module")
def noisy(arm, arm_experiment):
    """A still arm (z = 0 in open loop: no valve opens), recorded for 50 s with noise and without converters."""
    e = arm_experiment((10.0, 1.1), 50_000, injection="control", seed=11)
    (r,) = arm.simulate([e], changes={"converter_bits": 0.0}, states=True)
    return r


def test_sensor_noise_has_its_standard_deviation_and_no_memory(noisy, arm):
    nominal = dict(zip(arm.parameters.names, arm.parameters.vector(), strict=True))
    std = {"theta2_rad": math.radians(nominal["angle_noise_deg"])}
    std |= dict.fromkeys(("p_a_bar", "p_b_bar"), nominal["pressure_noise_bar"])
    noise = {k: (noisy.column(k) - noisy.column(f"true_{k}")) / std[k] for k in std}
    n = 50_000
    for name, x in noise.items():
        assert abs(x.mean()) < 4.0 / math.sqrt(n), name
        assert abs(x.var() - 1.0) < 4.0 * math.sqrt(2.0 / n), name
        for other in noise.values():  # over all pairs of sensors
            for lag in range(1, 11):
                assert abs(x[lag:] @ other[:-lag]) / n < 4.0 / math.sqrt(n), (name, lag)
    x, y, z = noise.values()
    for a, b in ((x, y), (x, z), (y, z)):
        assert abs(a @ b) / n < 4.0 / math.sqrt(n)


def test_noise_does_not_move_the_plant(noisy):
    assert np.ptp(noisy.column("true_theta2_rad")) < 1e-9


def test_logged_values_lie_on_the_12_bit_grid(arm, arm_experiment, quiet):
    references = np.column_stack([np.radians(np.linspace(-10.0, 10.0, 2000)), np.linspace(0.9, 1.2, 2000)])
    e = arm_experiment((-10.0, 0.9), 2000, references=references)
    (r,) = arm.simulate([e], changes=quiet | {"converter_bits": 12.0}, states=True)
    # 270 deg and 2 bar in 4096 steps
    for name, step in (("theta2_rad", math.radians(270.0) / 4096), ("p_a_bar", 2.0 / 4096), ("p_b_bar", 2.0 / 4096)):
        codes = r.column(name) / step
        np.testing.assert_allclose(codes, np.round(codes), atol=1e-9)
        assert len(np.unique(np.round(codes))) > 100
        error = r.column(name) - r.column(f"true_{name}")
        assert np.abs(error).max() <= 0.5 * step * (1.0 + 1e-9)  # rounded to the nearest, not cut off
        assert np.abs(error).max() > 0.49 * step


def test_the_controllers_see_the_converted_values(arm, arm_experiment, quiet):
    e = arm_experiment((1.0, 1.0), 20, setpoint=(0.0, 1.0))
    coarse = {"converter_bits": 1.0, "angle_span_deg": 3600.0}  # one step is 1800 deg: the angle reads 0
    blind, sighted = (arm.simulate([e], changes=quiet | more, states=True)[0] for more in (coarse, {}))
    assert np.all(blind.column("true_theta2_rad") > np.radians(0.5))
    assert np.all(blind.column("z_theta2_v") == 0.0)
    assert np.all(sighted.column("z_theta2_v") != 0.0)
