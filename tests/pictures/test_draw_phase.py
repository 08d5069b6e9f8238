"""Noise does not turn a phase round: no jumps of 360 degrees, and the branch that the poles at 0 tell."""

from dataclasses import replace

import loop_nouns
import numpy as np
import picture_nouns as nouns
import pytest
from bench_nouns import Block, Loop, TransferFunction
from conversions import deg

import loopshape as ls
from loopshape.view.plots.curves import (
    continuous_deg,
    controller_phase_deg,
    known_lines,
    loop_phase_deg,
    plant_phase_deg,
    unwrapped_deg,
)

FLOOR = 0.02


def true_phase_deg(truth: TransferFunction, f: np.ndarray, start_deg: float) -> np.ndarray:
    """Continuous phase from a dense grid that starts far below, where it is `start_deg`."""
    dense = np.unique(np.concatenate([np.geomspace(1e-4 * f[0], f[-1], 200000), f]))
    phase = deg(np.unwrap(np.angle(truth.response(dense))))
    return (phase + (start_deg - phase[0]))[np.searchsorted(dense, f)]


def loop_of(frf: ls.FRF, integrators: int | None = 1, controller: ls.Controller | None = None) -> Loop:
    return Loop(frf, controller or loop_nouns.gain(), integrators, unstable_poles=0)


@pytest.mark.parametrize("seed", range(12))
def test_a_noisy_phase_stays_on_the_true_branch_where_it_is_known(seed: int) -> None:
    truth = loop_nouns.plant()
    frf = loop_nouns.noisy(truth, noise=0.1, floor=FLOOR, seed=seed)
    phase, known = loop_phase_deg(loop_of(frf))
    true = true_phase_deg(truth, frf.frequency_hz, -90.0)
    assert 0.6 < np.mean(known) < 1.0  # the floor hides the last lines
    assert np.max(np.abs(phase - true)[known]) < 180.0
    assert np.max(np.abs(np.diff(phase[known]))) < 180.0
    assert np.allclose(
        np.exp(1j * np.radians(phase)), frf.siso / np.abs(frf.siso)
    )  # each line's own, whole turns apart


def test_plain_unwrapping_of_the_same_lines_jumps() -> None:
    truth = loop_nouns.plant()
    lost = 0
    for seed in range(12):
        frf = loop_nouns.noisy(truth, noise=0.1, floor=FLOOR, seed=seed)
        known = known_lines(frf)
        wrong = unwrapped_deg(frf.siso) - true_phase_deg(truth, frf.frequency_hz, -90.0)
        lost += bool(np.any(np.abs(wrong[~known]) > 270.0))
    assert lost >= 4


def test_one_bad_line_turns_nothing_round() -> None:
    own = np.full(61, -170.0)
    own[30] = 40.0  # says -320 from above, 40 from below
    relative = np.full(61, 0.02)
    relative[30] = 0.49
    response = np.exp(1j * np.radians(own))
    phase = continuous_deg(response, relative, np.ones(61, dtype=bool))
    assert np.ptp(np.delete(phase, 30)) < 1e-9


def test_a_loud_line_among_clear_ones_is_not_known_nor_a_lucky_one_among_loud_ones() -> None:
    frf = loop_nouns.noisy(loop_nouns.plant(), noise=0.05)
    variance = np.array(frf.variance[:, 0, 0])
    variance[200] = np.abs(frf.siso[200]) ** 2
    variance[300:320] = np.abs(frf.siso[300:320]) ** 2
    variance[310] = 0.0
    known = known_lines(replace(frf, covariance=variance[:, None, None] + 0j))
    assert not known[200]
    assert known[[199, 201, 299, 320]].all()
    assert not known[302:318].any()


def test_lines_between_known_ones_take_the_branch_around_them() -> None:
    slope = np.linspace(0.0, -1500.0, 301)
    rng = np.random.default_rng(1)
    relative = np.full(301, 0.05)
    relative[100:130] = 2.0
    noise = np.where(relative > 1.0, rng.uniform(-180.0, 180.0, 301), 0.0)
    phase = continuous_deg(np.exp(1j * np.radians(slope + noise)), relative, relative < 0.5)
    good = relative < 0.5
    assert np.allclose((phase - slope)[good] - (phase - slope)[0], 0.0, atol=1e-6)
    assert np.max(np.abs((phase - slope)[~good] - (phase - slope)[0])) <= 180.0 + 1e-6


@pytest.mark.parametrize("slope", [40.0, 90.0, 150.0, 175.0])
def test_a_steep_phase_is_followed(slope: float) -> None:
    phase = -slope * np.arange(40.0)
    found = continuous_deg(np.exp(1j * np.radians(phase)), np.full(40, 0.01), np.ones(40, dtype=bool))
    assert np.allclose(found - found[0], phase, atol=1e-6)


@pytest.mark.parametrize(("integrators", "start"), [(0, 0.0), (1, -90.0), (2, -180.0), (3, -270.0)])
def test_the_branch_is_that_of_the_integrators(integrators: int, start: float) -> None:
    truth = TransferFunction([1.0], np.polymul([1.0] + [0.0] * integrators, [0.001, 1.0]))
    for seed in range(5):
        frf = loop_nouns.noisy(truth, noise=0.15, seed=seed)
        phase, _ = plant_phase_deg(loop_of(frf, integrators))
        assert abs(phase[0] - start) < 60.0


def test_a_negative_gain_lags_by_half_a_turn() -> None:
    frf = loop_nouns.noisy(TransferFunction([-1.0], [0.01, 1.0]), noise=0.02)
    phase, _ = plant_phase_deg(loop_of(frf, 0))
    assert abs(phase[0] + 180.0) < 10.0


def test_the_controllers_phase_comes_from_far_below() -> None:
    f = np.geomspace(5.0, 200.0, 50)
    pi = Block("pi", {"f_hz": 400.0})  # still near -90 degrees on all lines
    assert abs(controller_phase_deg(ls.Controller("x", (pi,), 1000.0), f)[0] + 90.0) < 3.0
    notch = Block("notch", {"f1_hz": 1.0, "f2_hz": 1.0, "damping1": 0.05, "damping2": 1.0})
    assert abs(controller_phase_deg(ls.Controller("x", (notch,), 1000.0), f)[0]) < 90.0  # below the lines it came back
    both = controller_phase_deg(ls.Controller("x", (pi, pi), 1000.0), f)
    assert abs(both[0] + 180.0) < 6.0
    slow = Block("low_pass_2", {"f_hz": 0.5, "damping": 0.7})  # has turned by half a turn below the lines
    three = controller_phase_deg(ls.Controller("x", (pi, slow, slow), 1000.0), f)
    assert abs(three[0] + 450.0) < 20.0


def test_the_loops_phase_is_the_sum_of_plant_and_controller() -> None:
    loop = nouns.loops()[3]
    phase, known = loop_phase_deg(loop)
    assert np.allclose(np.exp(1j * np.radians(phase)), loop.L / np.abs(loop.L))
    assert np.array_equal(known, known_lines(loop.plant))


def test_without_known_integrators_the_first_line_lies_in_a_plain_turn() -> None:
    for seed in range(5):
        frf = loop_nouns.noisy(loop_nouns.plant(), seed=seed)
        phase, _ = plant_phase_deg(loop_of(frf, None))
        assert -270.0 < phase[0] <= 90.0


def test_few_lines_and_none_known_are_no_error() -> None:
    frf = loop_nouns.noisy(loop_nouns.plant(), noise=3.0, f=np.array([1.0, 2.0]))
    phase, known = loop_phase_deg(loop_of(frf))
    assert phase.shape == (2,)
    assert not known.any()
