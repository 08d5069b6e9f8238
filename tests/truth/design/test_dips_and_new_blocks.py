"""A dip of |L| below the bandwidth is seen, blocks begin where they do nothing, and a passed stage is ranked so."""

from types import SimpleNamespace

import numpy as np
import pytest
from tune_plants import GAIN, LEAD, problem_of, required

import loopshape as ls
from loopshape.data.control.controller import series_response
from loopshape.design.problem.measures import measure
from loopshape.design.problem.rows import DIP
from loopshape.design.stage import Stage
from loopshape.design.starts import neutral

LIMITS = {"sensitivity_peak_db": 6.0, "control_peak_db": 20.0}


def test_a_dip_below_the_bandwidth_is_seen_and_its_slopes_are_exact():
    """|L| of an integrator with an anti-resonance dips at 20 Hz; by formula L = k P."""
    f = np.geomspace(1.0, 200.0, 400)
    s, w = 1j * f, 20.0
    P = 100.0 / s * (s * s + 0.4 * w * s + w * w) / (s + w) ** 2
    plant = ls.FRF.from_arrays(f, P, relative_std=0.0, rate_hz=10_000.0, loop="one")
    p = problem_of([plant], required(GAIN, LEAD, **LIMITS))
    x = np.log([1.3, 40.0, 400.0])
    m = measure(p, x, {})
    (k,) = [i for i, what in enumerate(m.what) if what == DIP]
    L = series_response(p.blocks(x), p.s[: f.size]) * P
    inner = np.flatnonzero((np.abs(L[1:-1]) < np.abs(L[:-2])) & (np.abs(L[1:-1]) < np.abs(L[2:]))) + 1
    assert m.room[k] == pytest.approx(np.log(np.abs(L[inner[0]])))
    for j in range(x.size):
        step = np.eye(x.size)[j] * 1e-6
        slope = (measure(p, x + step, {}).room[k] - measure(p, x - step, {}).room[k]) / 2e-6
        assert m.room_slopes[k, j] == pytest.approx(slope, rel=1e-5, abs=1e-8)


def test_an_anti_resonance_between_the_lines_is_read_as_deep_as_it_is():
    """Lines 1 Hz apart show |L| above 1 beside a dip at 53.5 Hz; by formula it enters the dip at 53.3 Hz."""

    def response(f):
        s, w = 1j * f, 53.5
        return 50.0 / s * (s * s + 2e-3 * w * s + w * w) / (s + w) ** 2

    f = np.arange(5.0, 150.0)
    plant = ls.FRF.from_arrays(f, response(f), relative_std=1e-4, rate_hz=10_000.0, loop="one")
    p = problem_of([plant], required(GAIN, LEAD, **LIMITS))
    gain = 1.5 / np.abs(response(np.array([53.0, 54.0]))).min()
    dense = np.linspace(5.0, 60.0, 200_000)
    truth = dense[np.argmax(gain * np.abs(response(dense)) < 1.0)]
    assert 53.0 < truth < 53.5
    read = np.exp(measure(p, np.log([gain, 1000.0, 1000.0]), {}).ln_bandwidth[0])
    assert read == pytest.approx(truth, abs=0.05)


def test_shorthands_of_the_biquad_contain_doing_nothing():
    for block in (ls.biquad((1.0, 9.0), (1.0, 9.0), (0.1, 1.0), (0.1, 1.0)), ls.complex_lead((1.0, 9.0), (1.0, 9.0))):
        values = neutral(block)
        at_rest = block.block({name: values.get(name, 1.0) for name in block.parameters})
        s = 2j * np.pi * np.geomspace(0.1, 100.0, 9)
        np.testing.assert_allclose(series_response([at_rest], s), 1.0, rtol=1e-12)


def test_a_resonator_peaks_by_its_dampings_ratio():
    s = 2j * np.pi * np.array([1e-3, 50.0, 1e6])
    np.testing.assert_allclose(np.abs(series_response([ls.resonator(50.0, 0.5, 0.05).block({})], s)), [1.0, 10.0, 1.0])


def test_a_complex_lead_of_damping_one_is_two_leads():
    s = 2j * np.pi * np.geomspace(0.1, 1e3, 30)
    two = [ls.lead_lag(8.0, 90.0).block({})] * 2
    one = [ls.complex_lead(8.0, 90.0, 1.0).block({})]
    np.testing.assert_allclose(series_response(one, s), series_response(two, s), rtol=1e-12)


def test_what_check_passes_needs_no_word_of_its_shifted_plants() -> None:
    def stage(objective: float, copies: tuple[int, float], passed: bool) -> Stage:
        best = SimpleNamespace(rank=(*copies, -objective), objective=objective)
        return Stage((), None, None, best, SimpleNamespace(passed=passed), 0)

    undecided_beyond, slower, failed = (
        stage(3.9, (1, 0.01), True),
        stage(3.7, (0, 0.0), True),
        stage(4.5, (0, 0.0), False),
    )
    assert min([slower, failed, undecided_beyond], key=lambda one: one.rank) is undecided_beyond
