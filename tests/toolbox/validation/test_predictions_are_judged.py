"""The statistic of a comparison: uniform where the plant has not changed, small where it has, and where it says."""

import numpy as np
import pytest
from bench_nouns import LoopSetup
from plant_behind import plant_behind
from predicted_loops import NEW, OLD, SETUP, arm, measured, predicted, recording
from scipy.stats import binom

import loopshape as ls
from loopshape.data.algebra import regrid
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.validation.agreement import combined, on_common_lines, paired
from loopshape.toolbox.validation.comparison import compare, compare_plants, estimate_sensitivity, sensitivity_of
from loopshape.toolbox.validation.nouns import Comparison

LINES = 0.1 * np.arange(1, 151)
#: line overlap, averages behind each variance (0: it is known), lines that a variance is pooled over
KINDS = [(1.0, 0, 1), (1.94, 0, 1), (1.0, 5, 1), (1.94, 20, 1), (1.94, 5, 5), (1.0, 4, 15)]


def again(seed: int, relative: float, kind: tuple[float, int, int], changed: object = None) -> Comparison:
    """One prediction and one measurement of it, by FRFs with errors of known kind."""
    rng, (overlap, averages, pooled) = np.random.default_rng(seed), kind
    how = {"overlap": overlap, "averages": averages, "pooled": pooled}
    P = arm().response(LINES)
    P2 = P if changed is None else changed.response(LINES)  # type: ignore[attr-defined]
    one, two = measured(rng, LINES, P, relative, OLD, **how), measured(rng, LINES, P2, relative, NEW, **how)
    return compare(predicted(one), sensitivity_of(two))


def within_binomial(count: int, runs: int, share: float) -> bool:
    """Whether a count is no surprise at 0.2 % for a test of this level."""
    return bool(binom.ppf(0.001, runs, share) <= count <= binom.ppf(0.999, runs, share))


@pytest.mark.long
@pytest.mark.parametrize(("relative", "kind"), [*((0.05, kind) for kind in KINDS), (0.02, KINDS[3]), (0.1, KINDS[3])])
def test_a_plant_that_has_not_changed_is_contradicted_as_often_as_the_level_says(
    relative: float, kind: tuple[float, int, int]
) -> None:
    runs = 120
    p = np.array([again(seed, relative, kind).p_value for seed in range(runs)])
    for level in (0.05, 0.2, 0.5):
        assert within_binomial(int(np.sum(p < level)), runs, level), (level, np.mean(p < level))


def test_lines_that_a_lucky_variance_let_into_the_valid_band_are_not_judged() -> None:
    """Errors rise with frequency: the band ends at the last line whose estimated variance is small enough, and there
    errors are larger than stated. Without care the last five lines' mean of x is 1.3."""
    relative, ends = 0.1 * LINES / 10.0, []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        one = measured(rng, LINES, arm().response(LINES), relative, OLD, averages=4, pooled=7)
        two = measured(rng, LINES, arm().response(LINES), 0.01, NEW, averages=4, pooled=7)
        known = valid_lines(LINES, one.relative_std[:, 0, 0], np.ones(LINES.size, dtype=bool))
        pair = on_common_lines(predicted(one.select(known)).sensitivity, sensitivity_of(two))
        ends.append(paired(*pair[:3]).excess[-5:])
    assert np.mean(ends) == pytest.approx(1.0, abs=3.5 / np.sqrt(5 * 120))


@pytest.mark.parametrize(("relative", "gain"), [(0.02, 1.1), (0.05, 1.1), (0.1, 1.15)])
def test_a_changed_gain_is_noticed_and_said_in_decibels(relative: float, gain: float) -> None:
    found = [again(seed, relative, (1.94, 20, 1), arm(kappa=1350.0 * gain)) for seed in range(25)]
    assert sum(c.outcome == "refuted" for c in found) >= 22
    lowest = np.mean([c.bands[0].sensitivity_db for c in found])  # there |S| goes as 1/|P|
    assert lowest == pytest.approx(-20.0 * np.log10(gain), abs=0.3)


@pytest.mark.parametrize("relative", [0.02, 0.05])
def test_a_resonance_that_moved_is_noticed_where_it_is(relative: float) -> None:
    found = [again(seed, relative, (1.94, 20, 1), arm(f_hz=5.15)) for seed in range(25)]
    assert sum(c.outcome == "refuted" for c in found) >= 22
    worst = [c.worst for c in found]
    assert np.mean([w is not None and w.low_hz < 5.3 and w.high_hz > 4.7 for w in worst]) > 0.8


@pytest.mark.long
def test_what_would_be_noticed_is_noticed_four_times_in_five() -> None:
    noticed = again(0, 0.1, (1.0, 0, 1)).noticed_db
    changed = arm(kappa=1350.0 * 10.0 ** (noticed / 20.0))
    found = [again(seed, 0.1, (1.0, 0, 1), changed).p_value < 0.05 for seed in range(150)]
    assert 0.66 < np.mean(found) < 0.95


def test_data_that_would_notice_nothing_cannot_tell() -> None:
    assert again(1, 0.5, (1.94, 0, 1)).outcome == "cannot tell"


def test_a_deviation_within_the_tolerance_is_none() -> None:
    rng, gain = np.random.default_rng(2), 10.0 ** (0.6 / 20.0)
    one = measured(rng, LINES, arm().response(LINES), 1e-3, OLD)
    two = measured(rng, LINES, gain * arm().response(LINES), 1e-3, NEW)
    outcomes = [compare(predicted(one), sensitivity_of(two), tolerance_db=t).outcome for t in (0.0, 0.2, 1.0)]
    assert outcomes == ["refuted", "refuted", "confirmed"]


def test_a_local_deviation_is_not_drowned_by_lines_that_agree_too_well() -> None:
    """Variances four times too large, as a sweep's are, make p-values of 1 elsewhere; the one band must show."""
    rng, f = np.random.default_rng(3), 0.05 * np.arange(2, 401)
    wide = lambda frf: ls.FRF(**{**vars(frf), "covariance": 16.0 * frf.covariance})  # noqa: E731
    one = wide(measured(rng, f, arm().response(f), 0.01, OLD))
    two = wide(measured(rng, f, arm(f_hz=5.4).response(f), 0.01, NEW))
    assert compare(predicted(one), sensitivity_of(two)).outcome == "refuted"


def test_lines_that_differ_are_interpolated_and_it_is_said() -> None:
    rng, coarse = np.random.default_rng(4), 0.13 * np.arange(1, 110)
    fine = measured(rng, LINES, arm().response(LINES), 0.05, OLD)
    p = []
    for seed in range(40):
        other = measured(np.random.default_rng(seed), coarse, arm().response(coarse), 0.05, NEW)
        found = compare(predicted(fine), sensitivity_of(other))
        assert any("interpolated" in note for note in found.notes)
        p.append(found.p_value)
    assert np.mean(np.array(p) < 0.05) < 0.15
    assert regrid(fine, coarse[:5]).frequency_hz.size == 5


def test_grids_that_share_lines_are_compared_on_these() -> None:
    one = measured(np.random.default_rng(5), LINES, arm().response(LINES), 0.05, OLD)
    half = LINES[1::2]
    two = measured(np.random.default_rng(6), half, arm().response(half), 0.05, NEW)
    found = compare(predicted(one), sensitivity_of(two))
    assert (found.lines, found.notes) == (half.size, ())


@pytest.mark.long
def test_recordings_of_an_unchanged_loop_are_contradicted_one_time_in_twenty() -> None:
    """The whole way: multisines with noise, the plant estimated under one controller, S under the other."""
    runs, p = 100, []
    setup = LoopSetup("a", "r_a_rad", "n_a_rad", "z_a_v", "a_rad", OLD)
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        first = estimate_frf(recording(rng, arm(), OLD, 0.004, name="first"), setup)
        second = estimate_sensitivity(recording(rng, arm(), NEW, 0.004, name="second"), SETUP)
        p.append(compare(predicted(first), second).p_value)
    assert within_binomial(int(np.sum(np.array(p) < 0.05)), runs, 0.05), np.mean(np.array(p) < 0.05)
    assert within_binomial(int(np.sum(np.array(p) < 0.5)), runs, 0.5), np.mean(np.array(p) < 0.5)


@pytest.mark.parametrize("injection", ["controller_input", "plant_input", "reference"])
def test_sensitivity_from_a_recording_is_that_of_its_plant_and_controller(injection: str) -> None:
    rng = np.random.default_rng(7)
    unit = "n_a_v" if injection == "plant_input" else "n_a_rad"
    setup = LoopSetup("a", "r_a_rad", unit, "z_a_v", "a_rad", NEW)
    made = recording(rng, arm(), NEW, 0.005, injection=injection)
    S, P = estimate_sensitivity(made, setup), estimate_frf(made, setup)
    f = S.frequency_hz
    assert np.allclose(S.siso, 1.0 / (1.0 + NEW.response(f) * P.siso[np.searchsorted(P.frequency_hz, f)]), rtol=1e-6)
    distance = np.abs(S.siso - 1.0 / (1.0 + NEW.response(f) * arm().response(f))) ** 2 / S.variance[:, 0, 0]
    assert 0.6 < distance.mean() < 1.6


def test_a_plant_behind_a_sensitivity_is_the_plant() -> None:
    frf = measured(np.random.default_rng(8), LINES, arm().response(LINES), 0.05, NEW)
    back = plant_behind(sensitivity_of(frf), "z_a_v")
    assert np.allclose(back.siso, frf.siso, rtol=1e-9)
    assert np.allclose(back.variance, frf.variance, rtol=1e-9)


def test_combined_p_values_are_exact_for_one_and_keep_small_ones() -> None:
    for p in (1e-200, 1e-12, 0.01, 0.5):
        assert combined(np.array([p]), np.ones(1)) == pytest.approx(p, rel=1e-6)
    assert combined(np.array([1.0, 1e-9]), np.array([0.5, 0.5])) == pytest.approx(2e-9, rel=1e-3)


@pytest.mark.parametrize("periods", [4, 16])
def test_where_a_loop_lets_little_noise_through_its_sensitivity_is_as_sure_as_it_says(periods: int) -> None:
    """Pooled with neighbours, of which the loop lets more noise through, the lowest lines' variances were 10 to 50
    times too large: the comparison was blind there."""
    squares, variances = [], []
    for seed in range(40):
        made = recording(np.random.default_rng(seed), arm(), NEW, 0.004, periods=periods)
        found = estimate_sensitivity(made, SETUP)
        S = 1.0 / (1.0 + NEW.response(found.frequency_hz) * arm().response(found.frequency_hz))
        squares.append(np.abs(found.siso - S)[:4] ** 2)
        variances.append(found.variance[:4, 0, 0])
    ratio = np.mean(squares, axis=0) / np.mean(variances, axis=0)
    assert np.all((ratio > 0.2) & (ratio < 2.0)), ratio


def two_plants(seed, relative, gain=1.0):
    """An integrator measured twice with circular errors, the second time with another gain; known by numpy alone."""
    rng = np.random.default_rng(seed)
    G = 30.0 / (2j * np.pi * LINES)

    def drawn(P):
        errors = rng.standard_normal((2, LINES.size)) / np.sqrt(2.0)
        noisy = P * (1.0 + relative * (errors[0] + 1j * errors[1]))
        return ls.FRF.from_arrays(LINES, noisy, std=relative * np.abs(P), inputs=("u_v",), outputs=("y_m",))

    return drawn(G), drawn(gain * G)


@pytest.mark.long
def test_one_plant_measured_twice_differs_as_often_as_the_level_says():
    found = [compare_plants(*two_plants(seed, 0.05)) for seed in range(300)]
    assert within_binomial(sum(one.outcome == "refuted" for one in found), 300, 0.05)
    assert all(one.outcome == "confirmed" for one in found if one.p_value >= 0.05)


def test_a_gain_that_changed_by_half_a_db_between_two_frfs_is_found_with_its_size():
    found = compare_plants(*two_plants(1, 0.02, 10.0 ** (0.5 / 20.0)))
    assert found.outcome == "refuted"
    assert all(abs(band.sensitivity_db - 0.5) < 4.0 * band.std_db for band in found.bands)
    assert 0.05 < found.noticed_db < 0.2
    assert compare_plants(*two_plants(1, 0.02, 10.0 ** (0.5 / 20.0)), tolerance_db=1.0).outcome == "confirmed"
