"""An FRF follows from its recipe to 1e-8: window, detrending, overlap, segment length, estimator, against scipy.signal.

scipy's csd(x, y) is E[X* Y]: a response from u to y is csd(u, y)/welch(u).
"""

import json

import numpy as np
import pytest
from commands import invoked
from known_loops import LOOP, RATE, A, B, record, run_loop
from run_files import read_frfs
from scipy import signal

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import WINDOWS, Settings

N = 4000


def open_record():
    """Noisy input and output on a drift, so that windows, detrending and H1, H2, Hv all differ."""
    rng = np.random.default_rng(5)
    x, drift = rng.standard_normal(N), np.linspace(0.0, 3.0, N)
    u = x + 0.2 * rng.standard_normal(N) + drift
    return record("control", "noise", u, u, signal.lfilter(B, A, x) + 0.1 * rng.standard_normal(N) - drift)


def scipys(r, n, noverlap, window, symmetric, detrend):
    """H1, H2, Hv and coherence by scipy alone, on its lines."""
    words = {
        "fs": RATE,
        "window": signal.get_window(window, n, fftbins=not symmetric),
        "nperseg": n,
        "noverlap": noverlap,
        "detrend": {"mean": "constant", "none": False}.get(detrend, detrend),
    }
    u, y = r.columns["z_v"], r.columns["y_rad"]
    f, uu = signal.welch(u, **words)
    _, yy = signal.welch(y, **words)
    _, uy = signal.csd(u, y, **words)
    _, coherence = signal.coherence(u, y, **words)
    made = {"h1": uy / uu, "h2": yy / uy.conj(), "hv": np.sqrt(yy / uu) * np.exp(1j * np.angle(uy))}
    return f, made, coherence, uu


def assert_same(frf, f, response, coherence, uu):
    rows = np.searchsorted(f, frf.frequency_hz - 1e-9)
    assert rows.size > 0.9 * (f.size - 3)
    np.testing.assert_allclose(frf.frequency_hz, f[rows], rtol=1e-12)
    np.testing.assert_allclose(frf.siso, response[rows], rtol=1e-8)
    np.testing.assert_allclose(frf.coherence, coherence[rows], rtol=1e-8)
    np.testing.assert_allclose(frf.input_power, uu[rows], rtol=1e-8)


@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("window", WINDOWS)
def test_windows(window, symmetric):
    r = open_record()
    f, made, coherence, uu = scipys(r, 200, 100, window, symmetric, "mean")
    settings = Settings("h1", window=window, symmetric=symmetric, overlap=0.5, segment_samples=200)
    assert_same(estimate_frf(r, LOOP, settings), f, made["h1"], coherence, uu)


@pytest.mark.parametrize("estimator", ["h1", "h2", "hv"])
@pytest.mark.parametrize("detrend", ["mean", "linear", "none"])
@pytest.mark.parametrize(
    ("n", "overlap", "noverlap"), [(256, 0.5, 128), (255, 0.5, 127), (257, 0.5, 128), (300, 0.0, 0)]
)
def test_estimators_detrending_and_segments(estimator, detrend, n, overlap, noverlap):
    r = open_record()
    f, made, coherence, uu = scipys(r, n, noverlap, "hann", False, detrend)
    settings = Settings(estimator, detrend=detrend, overlap=overlap, segment_samples=n)
    assert_same(estimate_frf(r, LOOP, settings), f, made[estimator], coherence, uu)


@pytest.mark.parametrize("estimator", ["joint", "reference"])
def test_joint_input_output_estimator_in_closed_loop(estimator):
    rng = np.random.default_rng(6)
    n = rng.standard_normal(N)
    z, y = run_loop("controller_input", n, 0.05 * rng.standard_normal(N))
    words = {"fs": RATE, "window": "hamming", "nperseg": 250, "noverlap": 125, "detrend": "linear"}
    f, to_y = signal.csd(n, y, **words)
    _, to_u = signal.csd(n, z, **words)
    settings = Settings(estimator, window="hamming", detrend="linear", overlap=0.5, segment_samples=250)
    frf = estimate_frf(record("controller_input", "noise", n, z, y), LOOP, settings)
    rows = np.searchsorted(f, frf.frequency_hz - 1e-9)
    np.testing.assert_allclose(frf.siso, (to_y / to_u)[rows], rtol=1e-8)


def test_the_command_takes_the_recipe(tmp_path):
    r = open_record()
    ls.write(ls.Run(RATE, (LOOP,), (r,)), tmp_path / "run")
    recipe = "--estimator hv --window blackman --symmetric --detrend linear --overlap 0.5 --segment-samples 256"
    done = invoked(["frf", str(tmp_path / "run"), *recipe.split(), "--no-figures", "--json"])
    assert done.exit_code == 0, done.output
    method = json.loads(done.stdout)["frfs"][0]["method"]
    assert "hv estimator, Welch, symmetric blackman window, linear taken off" in method
    f, made, coherence, uu = scipys(r, 256, 128, "blackman", True, "linear")
    assert_same(read_frfs(tmp_path / "run")[0], f, made["hv"], coherence, uu)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ({"window": "hanning"}, "a window is not known"),
        ({"detrend": "cubic"}, "a detrending is not known"),
        ({"segment_samples": 2}, "four samples at least"),
        ({"segment_samples": 256, "resolution_hz": 1.0}, "twice"),
        ({"segment_samples": 256, "method": "local"}, "local fits have no segments"),
        ({"estimator": "h2", "method": "local"}, "local fits have no segments"),
    ],
)
def test_recipes_that_contradict_themselves_are_refused(words, why):
    with pytest.raises(ls.errors.WrongUseError, match=why):
        Settings(**words)


def test_spectral_estimators_refuse_feedback_and_periods():
    n = np.random.default_rng(6).standard_normal(N)
    closed = record("controller_input", "noise", n, *run_loop("controller_input", n, 0.0 * n))
    with pytest.raises(ls.errors.WrongUseError, match="open loop"):
        estimate_frf(closed, LOOP, Settings("h1"))
    u = np.tile(n[:500], 8)
    repeats = record("control", "multisine", u, u, signal.lfilter(B, A, u), 5.0, 0.0)
    with pytest.raises(ls.errors.WrongUseError, match="averages segments"):
        estimate_frf(repeats, LOOP, Settings("h2"))
    with pytest.raises(ls.errors.WrongUseError, match="a window and segments"):
        estimate_frf(repeats, LOOP, Settings(window="hamming"))
