"""`frf --renew`: a band measured once more stands in the earlier run's FRF, and `check` reads both as one."""

import json

import numpy as np
import pytest
from commands import loopshape
from run_files import read_frfs
from scipy.signal import lfilter

import loopshape as ls

RATE_HZ = 100.0


def recorded(folder, u, seed, loop="axis"):
    y = lfilter([0.0, 0.1], [1.0, -0.9], u) + 0.02 * np.random.default_rng(seed).standard_normal(u.size)
    ls.write(ls.Run.from_arrays(u=u, y=y, rate_hz=RATE_HZ, loop=loop), folder)


def truth_at(f_hz):
    back = np.exp(-2j * np.pi * f_hz / RATE_HZ)
    return 0.1 * back / (1.0 - 0.9 * back)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A wide, short run, and one of forty periods of a multisine from 5 to 10 Hz."""
    top = tmp_path_factory.mktemp("runs")
    recorded(top / "wide", np.random.default_rng(1).standard_normal(4000), 2)
    t, k = np.arange(1000) / RATE_HZ, np.arange(50, 101)
    phase = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, k.size)
    period = np.cos(2.0 * np.pi * 0.1 * k[:, None] * t + phase[:, None]).sum(axis=0) / np.sqrt(k.size)
    recorded(top / "band", np.tile(period, 40), 4)
    assert loopshape("frf", top / "wide", "--no-figures").returncode == 0
    return top


def test_the_band_is_new_and_the_rest_is_old(folders):
    (old,) = read_frfs(folders / "wide")
    found = loopshape("frf", folders / "band", "--renew", folders / "wide", "--no-figures", "--json")
    assert found.returncode == 0
    assert read_frfs(folders / "band")[0].input_power is None  # per Hz of one, per line of the other
    (made,) = read_frfs(folders / "band")
    f = made.frequency_hz
    inside = (f >= 5.0) & (f <= 10.0)
    assert inside.sum() == pytest.approx(51, abs=2)
    np.testing.assert_array_equal(made.siso[f < 4.9], old.siso[old.frequency_hz < 4.9])
    error = np.abs(made.siso - truth_at(f)) / np.abs(truth_at(f))
    before = np.abs(old.siso - truth_at(old.frequency_hz)) / np.abs(truth_at(old.frequency_hz))
    within = (old.frequency_hz >= 5.0) & (old.frequency_hz <= 10.0)
    assert np.median(error[inside]) < 0.5 * np.median(before[within])
    (row,) = json.loads(found.stdout)["frfs"]
    assert row["valid_from_hz"] == pytest.approx(old.valid_band_hz[0])


def test_another_loop_is_refused_in_a_sentence(folders, tmp_path):
    recorded(tmp_path / "other", np.random.default_rng(5).standard_normal(2000), 6, loop="other")
    found = loopshape("frf", tmp_path / "other", "--renew", folders / "wide", "--no-figures")
    assert found.returncode == 2
    assert "no FRF in" in found.stderr
