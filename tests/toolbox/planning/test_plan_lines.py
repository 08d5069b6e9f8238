"""Lines of a plan: as close as a resonance asks, odd ones with some left out, levels as asked, crossovers of L."""

import numpy as np
import pytest
from study_signals import Multisine

import loopshape as ls
from loopshape.toolbox.planning.plan_lines import (
    chosen_lines,
    crossovers_hz,
    levels_of,
    needed_spacing_hz,
    round_period_s,
    with_line_near,
)


@pytest.mark.parametrize("damping", [0.005, 0.02, 0.1])
def test_four_lines_stand_within_the_half_power_width(damping):
    f = np.arange(2.0, 20.0, 0.01)
    G = 1.0 / (1.0 - (f / 8.0) ** 2 + 2j * damping * f / 8.0)
    need = needed_spacing_hz(f, G, np.zeros(f.size))
    width = 2.0 * damping * 8.0
    assert need.min() == pytest.approx(width / 4.0, rel=0.3)
    assert abs(f[need.argmin()] - 8.0) < width
    period_s = round_period_s(1.0 / need.min(), 1000.0)
    lines = chosen_lines(period_s, (2.0, 20.0), (f, need), 12.0, "log")
    assert np.sum(np.abs(lines - 8.0) <= width / 2.0) >= 3
    assert np.diff(np.log2(lines)).max() <= 1.0 / 12.0 + 1e-6 + np.log2(1.0 + 1.0 / (2.0 * period_s))


def test_noise_does_not_make_resonances():
    f = np.arange(0.1, 20.0, 0.05)
    rng = np.random.default_rng(1)
    std = 0.07
    G = (1.0 + std * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))) / (1.0 + 1j * f / 5.0)
    assert np.all(needed_spacing_hz(f, G, np.full(f.size, std)) > 0.1 * f)


def test_odd_lines_leave_some_out_and_keep_the_crossover():
    smooth = (np.array([0.1, 50.0]), np.array([10.0, 10.0]))
    lines = chosen_lines(10.0, (0.5, 20.0), smooth, 12.0, "odd")
    k = np.round(lines * 10.0).astype(int)
    assert np.all(k % 2 == 1)
    assert not np.any(k % 8 == 7)
    added = with_line_near(lines, 3.33, 10.0, "odd")
    assert np.abs(added - 3.33).min() <= 0.1 + 1e-9
    assert set(lines) <= set(added)


def test_all_takes_every_line():
    smooth = (np.array([0.1, 50.0]), np.array([10.0, 10.0]))
    np.testing.assert_allclose(chosen_lines(2.0, (1.0, 4.0), smooth, 1.0, "all"), np.arange(2, 9) / 2.0)


def test_crossovers_are_those_where_the_loop_falls():
    f = np.geomspace(0.1, 10.0, 200)
    assert crossovers_hz(f, 1.0 / (1j * f)) == pytest.approx([1.0])
    assert crossovers_hz(f, 1j * f).size == 0


def test_levels_of_a_multisine_are_its_lines_amplitudes():
    lines, levels = (0.5, 1.0, 2.5), (1.0, 0.25, 4.0)
    x = Multisine(0.4, 3.0, 2.0, 0.7, 1, ramp_s=0.0, lines_hz=lines, levels=levels).signal(100.0)
    size = np.abs(np.fft.rfft(x))[[1, 2, 5]]
    np.testing.assert_allclose(size / size[0], levels, rtol=1e-9)
    assert np.abs(x).max() == pytest.approx(0.7)


@pytest.mark.parametrize("levels", [(1.0, 2.0), (1.0, 2.0, 0.0), (1.0, 2.0, float("nan"))])
def test_levels_that_do_not_fit_are_refused(levels):
    with pytest.raises(ls.errors.WrongUseError, match="as many levels, all positive"):
        Multisine(0.4, 3.0, 2.0, 0.7, 1, lines_hz=(0.5, 1.0, 2.5), levels=levels)


def test_levels_are_limited_about_the_crossover():
    levels = levels_of(np.array([1e-6, 1.0, 4.0, 1e6]), 1, 10.0)
    np.testing.assert_allclose(levels, [10.0**-0.5, 1.0, 2.0, 10.0**0.5])


def test_periods_are_round_and_whole_samples():
    assert round_period_s(3.1, 1000.0) == 4.0
    assert round_period_s(0.119, 100.0) == 0.12
    n = round_period_s(7.0, 983.3) * 983.3
    assert n == pytest.approx(round(n), abs=1e-6)
