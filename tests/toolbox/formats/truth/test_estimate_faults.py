"""Spikes and clipped samples are named by row and time; what an excitation does by itself is none of them."""

from pathlib import Path

import numpy as np
import pytest
from run_files import check_recordings
from scipy.signal import lfilter

import loopshape as ls
from loopshape.identify.quality.faults import saturated, spikes
from loopshape.toolbox.formats.tables.import_file import import_file

RATE = 1000.0
N = 20_000
T = np.arange(N) / RATE


def sweep(top_hz):
    k = np.log(top_hz / 0.1)
    return np.sin(2.0 * np.pi * 0.1 * T[-1] / k * np.expm1(k * T / T[-1]))


def multisine(lines):
    X = np.zeros(5001, dtype=complex)
    X[1 : lines + 1] = np.exp(2j * np.pi * np.random.default_rng(lines).random(lines))
    x = np.tile(np.fft.irfft(X), 2)
    return x / x.std()


def healthy():
    rng = np.random.default_rng(0)
    e = rng.standard_normal(N)
    found = {
        "white noise": e,
        "coloured noise": lfilter([1.0], [1.0, -0.99], e),
        "drift": np.cumsum(e),
        "square": np.sign(np.sin(3.0 * T)),
        "square, noisy": np.sign(np.sin(3.0 * T)) + 0.01 * e,
        "triangle": np.abs(T % 2.0 - 1.0),
        "staircase": np.repeat(rng.standard_normal(N // 200), 200),
        "staircase, noisy": np.repeat(rng.standard_normal(N // 200), 200) + 0.01 * e,
        "telegraph": np.cumprod(np.where(rng.random(N) < 0.03, -1.0, 1.0)),
    }
    found |= {f"sweep to {f} Hz": sweep(f) for f in (5, 50, 450)}
    found |= {f"multisine of {k} lines": multisine(k) for k in (5, 50, 400, 4000)}
    for clock in (1, 2, 3, 5, 20):
        bits = np.repeat(np.sign(rng.standard_normal(N // clock + 1)), clock)[:N]
        found |= {f"PRBS of {clock}": bits, f"PRBS of {clock}, noisy": bits + 0.01 * e}
        found[f"PRBS of {clock} through a plant"] = lfilter([0.1], [1.0, -0.9], bits)
    for name in ("sweep to 50 Hz", "multisine of 5 lines", "multisine of 50 lines", "white noise"):
        found |= {f"{name}, steps of {step:g}": np.round(found[name] / step) * step for step in (1e-2, 1e-3, 3e-5)}
    return found


@pytest.mark.parametrize("name", healthy())
def test_excitations_are_healthy(name):
    x = healthy()[name]
    assert spikes(x, RATE) is None
    assert saturated(x, RATE) is None


def test_a_million_samples_of_noise_hold_no_spike():
    assert spikes(np.random.default_rng(1).standard_normal(1_000_000), RATE) is None


@pytest.mark.parametrize(
    ("name", "height"),
    [("sweep to 5 Hz", 0.2), ("white noise", 15.0), ("coloured noise", 15.0), ("square, noisy", 0.3), ("drift", 15.0)],
)
def test_spikes_are_named_by_row_and_time(name, height):
    x = healthy()[name].copy()
    rows = np.array([777, 3000, 3001, 9123, 15_000, 15_001, 15_002])
    x[rows] += height * np.array([1, -1, -1, 1, 1, 1, 1])
    found = spikes(x, RATE, "y_rad")
    assert found is not None
    np.testing.assert_array_equal(found.rows, rows)
    assert found.sentence.startswith(
        "y_rad has 7 spike samples at rows 777, 3000-3001, 9123, 15000-15002 (from 0.777 to"
    )
    assert "check the cable" in found.sentence


def test_a_step_there_and_back_is_no_spike_if_it_lasts():
    x = np.sin(T)
    x[5000:5004] += 1.0
    assert spikes(x, RATE) is None
    x[5003] -= 1.0
    found = spikes(x, RATE)
    assert found is not None
    np.testing.assert_array_equal(found.rows, [5000, 5001, 5002])


def test_clipped_peaks_are_named_and_nothing_else():
    x = 3.0 * np.sin(2.0 * np.pi * 0.4 * T) + lfilter([0.1], [1.0, -0.9], np.random.default_rng(2).standard_normal(N))
    limit = np.sort(x)[-60]
    clipped = np.minimum(x, limit)
    found = saturated(clipped, RATE, "z_v")
    assert found is not None
    np.testing.assert_array_equal(found.rows, np.flatnonzero(x >= limit))
    assert f"row{'s'} {found.rows[0]}" in found.sentence
    assert "excite less" in found.sentence


def test_clipping_of_a_converters_steps_is_found_and_its_peaks_are_not_clipped():
    x = np.round(1e3 * np.sin(2.0 * np.pi * 2.0 * T))
    assert saturated(x, RATE) is None  # rests on its crest for ten samples
    found = saturated(np.minimum(x, 900.0), RATE)
    assert found is not None
    np.testing.assert_array_equal(found.rows, np.flatnonzero(x >= 900.0))


def test_what_is_no_row_of_numbers_is_refused():
    with pytest.raises(ls.errors.BadSignalError, match="first in row 5"):
        spikes(np.where(np.arange(100) == 5, np.nan, 1.0), RATE)


@pytest.fixture(scope="module")
def qube(shared):
    folder = shared / "data" / "qube"
    if not folder.is_dir():
        pytest.skip("the QUBE recordings are not in the shared data")
    return sorted(folder.glob("*.csv"))


MAP = Path(__file__).resolve().parents[4] / "examples" / "qube" / "map.toml"


def test_the_qubes_saturated_rows_are_exactly_those_that_it_flags(qube):
    for file in qube:
        flag = np.genfromtxt(file, delimiter=",", skip_header=1)[:, -1]
        run = import_file(file, MAP)
        (recording,) = run.recordings
        for name in ("u_v", "theta_rad", "alpha_rad", "control_v"):
            found = saturated(recording.column(name), 500.0, name)
            assert (found is None) == (name != "u_v")
            if found is not None:
                np.testing.assert_array_equal(found.rows, np.flatnonzero(flag))
        (sentence,) = check_recordings(run)
        last = np.flatnonzero(flag)[-1]
        assert f"rows 0-{last} (from 0 to {last / 500.0:g} s)" in sentence
