"""Stamps that jitter or are rounded keep their rate; lost samples, a wrong rate and wild stamps do not."""

import numpy as np
import pytest

import loopshape as ls
from loopshape.io.stamps import check_rate, read_stamps
from loopshape.toolbox.formats.tables.import_file import import_file

N = 5000
K = np.arange(N)


@pytest.mark.parametrize("rate", [300.0, 512.0, 999.0, 1001.0, 2000.0, 2048.0])
def test_stamps_of_three_decimals_keep_their_rate(rate):
    t = np.round(17.3 + K / rate, 3)
    assert "rounded to 0.001 s" in check_rate(t, rate)
    assert read_stamps(t, rate).rate_hz == pytest.approx(rate, rel=2e-4)


@pytest.mark.parametrize("rms", [0.05, 0.2])
def test_jitter_is_no_gap_and_the_rate_is_that_of_all_stamps(rms):
    jitter = np.clip(rms * np.random.default_rng(1).standard_normal(N), -0.9, 0.9) / 400.0
    note = check_rate(K / 400.0 + jitter, 400.0)
    assert "all 5000 of them keep 400" in note
    found = read_stamps(K / 400.0 + jitter, 400.0)
    assert found.jitter_s == pytest.approx(rms / 400.0, rel=0.1)
    assert found.rate_hz == pytest.approx(400.0, rel=4.0 * rms * np.sqrt(12.0 / N) / N)


@pytest.mark.parametrize("rounded", [None, 3])
@pytest.mark.parametrize("lost", [1, 2, 40])
@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_lost_samples_are_named_by_row_and_counted(rounded, lost, jitter):
    kept = np.delete(np.arange(N + 2 * lost), np.r_[1000 : 1000 + lost, 3000 + lost : 3000 + 2 * lost])
    t = (kept + np.clip(jitter * np.random.default_rng(2).standard_normal(N), -0.3, 0.3)) / 250.0
    t = t if rounded is None else np.round(t, rounded)
    with pytest.raises(ls.errors.BadSignalError, match=r"of 250 Hz at row 1000.*, 2 such steps in all"):
        check_rate(t, 250.0)


@pytest.mark.parametrize("rounded", [3, 9])
def test_a_wrong_rate_is_told_with_the_right_one(rounded):
    t = np.round(K / 333.0, rounded)
    with pytest.raises(ls.errors.BadSignalError, match=r"all 5000 of them keep (333|332\.999) Hz"):
        check_rate(t, 332.0)
    with pytest.raises(ls.errors.BadSignalError, match=r"all 5000 of them keep (333|332\.999) Hz"):
        check_rate(t, 1000.0)


def test_no_sentence_counts_no_steps():
    for t in (K / 100.1, K / 100.0 + 0.5 * (K == 7), K / 100.0 + 0.01 * (K > 7), np.sqrt(K)):
        with pytest.raises(ls.errors.BadSignalError) as caught:
            check_rate(t, 100.0)
        assert " 0 such" not in str(caught.value)


MAP = """
format = "loopshape-map/1"
rate_hz = {rate}
time = {{ from = "t", unit = "s" }}
resample = true
[columns]
u_v = {{ from = "u", unit = "V" }}
x_m = {{ from = "x", unit = "m" }}
[[loop]]
name = "axis"
control = "u_v"
output = "x_m"
[recording]
kind = "multisine"
injection = "control"
"""


def imported(tmp_path, t, u, rate):
    (tmp_path / "map.toml").write_text(MAP.format(rate=rate))
    np.savez(tmp_path / "r.npz", t=t, u=u, x=np.sin(u))
    run = import_file(tmp_path / "r.npz", tmp_path / "map.toml")
    return run.recordings[0].column("u_v"), " ".join(run.extra["notes"])


def periodic(t, seed=0):
    """Ten sines up to 40 Hz that repeat every second."""
    f, rng = np.arange(1, 11) * 4.0, np.random.default_rng(seed)
    return np.cos(2.0 * np.pi * np.outer(t, f) + rng.uniform(0, 7, f.size)).sum(axis=1)


def test_resampling_rounded_stamps_that_keep_the_rate_leaves_every_number(tmp_path):
    u = periodic(K / 300.0)
    back, note = imported(tmp_path, np.round(K / 300.0, 3), u, 300.0)
    np.testing.assert_array_equal(back, u)
    assert "not resampled" in note


@pytest.mark.parametrize("file_rate", [333.0, 480.0, 2000.0])
def test_resampling_does_not_spoil_a_period(tmp_path, file_rate):
    t = np.arange(round(8.0 * file_rate)) / file_rate
    back, note = imported(tmp_path, np.round(t, 3), periodic(t), 400.0)
    folded = back[400:2800].reshape(6, 400)
    scatter = np.mean((folded - folded.mean(axis=0)) ** 2) / np.mean(folded**2)
    assert scatter < 1e-5  # what the estimator takes for another period is 1e-3
    truth = periodic(np.arange(back.size) / 400.0)
    assert np.sqrt(np.mean((back - truth)[400:2800] ** 2) / np.mean(truth**2)) < 0.02
    assert "by splines" in note
    assert "gap" not in note
