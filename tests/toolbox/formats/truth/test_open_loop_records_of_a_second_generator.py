"""Records of steps, squares, multisines, sweeps and PRBS in open loop: none is said to be of a closed loop, or to grow;
what repeats in arrays is estimated by its periods."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter, max_len_seq

import loopshape as ls

STUDY = Path(__file__).parents[4] / "experiments" / "examiner_cases"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*saturated:UserWarning")  # a machine with play rests at its ends
def test_open_loop_records_are_not_called_closed(monkeypatch):
    monkeypatch.syspath_prepend(str(STUDY))
    import open_loop

    found = Counter()
    for seed in range(50_000, 50_060):
        found.update(open_loop.claims(open_loop.drawn(seed)))
    sys.modules.pop("open_loop")
    assert found["records"] == 60
    assert found["closed by the draft"] <= 2  # at most 3 of 300 are asked for: 2 of 60 by chance in one of eight
    assert found["closed by frf"] <= 2
    assert found["grows"] == 0


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_prbs_that_repeats_in_arrays_is_estimated_by_its_periods(noise):
    rng, b, a = np.random.default_rng(2), [0.0, 0.1], [1.0, -0.9]
    u = np.resize(2.0 * max_len_seq(9)[0] - 1.0, 511 * 12)
    y = lfilter(b, a, u) + noise * rng.standard_normal(u.size)
    run = ls.Run.from_arrays(u=u, y=y, rate_hz=100.0)
    assert run.recordings[0].info.period_s == pytest.approx(5.11)
    P = ls.frf(run)
    z = np.exp(-2j * np.pi * P.frequency_hz / 100.0)
    truth = 0.1 * z / (1.0 - 0.9 * z)
    assert P.frequency_hz.size > 200
    assert np.median(np.abs(P.siso / truth - 1.0)) < 0.005 + 3.0 * noise


@pytest.mark.parametrize("period", [41.3, 173.7])
def test_a_square_whose_period_is_no_whole_number_of_rows_has_no_period(period):
    u = np.where(np.arange(6000) % period < period / 2.0, 1.0, -1.0)
    info = ls.Run.from_arrays(u=u, y=lfilter([0.0, 0.1], [1.0, -0.9], u), rate_hz=100.0).recordings[0].info
    assert info.period_s is None or (info.period_s * 100.0 / period) % 1.0 == pytest.approx(0.0, abs=1e-3)
