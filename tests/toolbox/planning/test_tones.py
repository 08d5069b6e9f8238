"""Tones of known frequency, amplitude and growth in noise of known colour, and no tones where there are none."""

import json

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from commands import invoked
from scipy.signal import chirp, lfilter
from scipy.stats import binom

import loopshape as ls
from loopshape.toolbox.planning.tone.nouns import Growth
from loopshape.toolbox.planning.tone.tones import Excitation, Period, tones_of

RATE, N = 1000.0, 8192
T = np.arange(N) / RATE
MIDDLE = 0.5 * (N - 1) / RATE
BROAD = np.poly([0.99 * np.exp(0.3j), 0.99 * np.exp(-0.3j)]).real  # a resonance of 13 lines in half width
COLOURS = {"white": [1.0], "red": [1.0, -0.98], "resonance": BROAD, "random walk": [1.0, -1.0]}


def noise(rng, colour, samples=N):
    return lfilter([1.0], COLOURS[colour], rng.standard_normal(samples + 4000))[4000:]


@pytest.mark.parametrize("colour", COLOURS)
def test_noise_alone_shows_a_tone_no_more_often_than_was_asked(colour):
    """Asked for one false alarm in five: of 60 records no more than binomial chance of 1e-4 allows."""
    rng = np.random.default_rng(1)
    alarms = sum(bool(tones_of(noise(rng, colour), RATE, chance=0.2).tones) for _ in range(60))
    assert alarms <= binom.ppf(1.0 - 1e-4, 60, 0.2)


def test_intervals_of_frequency_amplitude_growth_and_rms_cover_the_truth():
    """100 tones in red noise: each 95 % interval covers as often as binomial chance of 1e-4 allows."""
    rng = np.random.default_rng(2)
    covered = np.zeros(4)
    for _ in range(100):
        g, f, a = rng.uniform(-0.3, 0.5), rng.uniform(20.0, 400.0), rng.uniform(0.5, 2.0)
        wave = a * np.exp(g * (T - MIDDLE)) * np.cos(2.0 * np.pi * f * T + rng.uniform(0.0, 6.28))
        found = tones_of(wave + lfilter([1.0], [1.0, -0.8], rng.standard_normal(N)), RATE)
        tone = found.tones[0]
        here = a * np.exp(g * (0.5 * (tone.from_s + tone.to_s) - MIDDLE))
        rms = np.sqrt(1.0 / (1.0 - 0.64) + np.mean(wave**2))
        pairs = [(tone.frequency_interval_hz, f), (tone.amplitude_interval, here), (tone.growth_interval_per_s, g)]
        covered += [low <= truth <= high for (low, high), truth in [*pairs, (found.rms_interval, rms)]]
    low, high = binom.ppf([1e-4, 1.0 - 1e-4], 100, 0.95)
    assert (covered >= low).all()
    assert (covered <= high).all()


def test_a_machine_that_begins_to_oscillate_is_seen():
    """58.8 Hz from the last eighth of a record on, hardly above the noise of the whole."""
    rng = np.random.default_rng(3)
    begins = 0.875 * N / RATE
    wave = np.where(begins < T, 0.02 * np.exp(3.0 * (T - begins)), 0.0) * np.sin(2.0 * np.pi * 58.8 * T)
    found = tones_of(wave + 0.05 * rng.standard_normal(N), RATE)
    tone = found.tones[0]
    assert tone.frequency_hz == pytest.approx(58.8, abs=0.3)
    assert tone.to_s == pytest.approx(N / RATE)
    assert tone.growth is Growth.GROWS
    assert "58." in found.warnings[0]


def test_two_tones_are_told_apart_and_the_steady_one_does_not_grow():
    rng = np.random.default_rng(4)
    wave = 3.0 * np.sin(2.0 * np.pi * 50.0 * T) + 0.3 * np.exp(0.3 * (T - MIDDLE)) * np.sin(2.0 * np.pi * 53.0 * T)
    found = tones_of(wave + 0.3 * rng.standard_normal(N), RATE)
    strong, weak = sorted(found.tones, key=lambda tone: tone.frequency_hz)
    assert strong.amplitude == pytest.approx(3.0, rel=0.01)
    assert strong.growth is Growth.STEADY
    assert weak.amplitude == pytest.approx(0.3, rel=0.1)
    assert weak.growth is Growth.GROWS
    assert weak.growth_interval_per_s[0] < 0.3 < weak.growth_interval_per_s[1]


def held(noise_std, injected, rng):
    """Output of an integrator under a gain, 1/(z - 0.95) about, with what is injected in front of the controller."""
    return lfilter([0.0, 0.05], [1.0, -0.95], injected) + noise_std * rng.standard_normal(injected.size)


def multisine(rng, period=1024):
    lines = np.arange(1, 200, 2)
    k = np.arange(period)
    return np.tile(
        np.cos(2.0 * np.pi * np.outer(k, lines) / period + rng.uniform(0.0, 6.28, lines.size)).sum(axis=1), N // period
    )


def test_lines_of_the_excitation_are_no_tones_of_the_machine():
    """Multisines (with and without their period known), a sweep, noise and a sine as excitation."""
    rng = np.random.default_rng(5)
    many = multisine(rng)
    cases = [
        (many, Period(1024)), (many, None), (chirp(T, 1.0, T[-1], 200.0, method="logarithmic"), None),
        (rng.standard_normal(N), None), (np.sin(2.0 * np.pi * 40.0 * T), None),
    ]  # fmt: skip
    for injected, period in cases:
        for level in (1e-3, 0.1):
            found = tones_of(held(level, injected, rng), RATE, excitation=Excitation([injected], period))
            assert not found.tones


def test_a_tone_between_the_lines_of_a_multisine_is_seen():
    rng = np.random.default_rng(6)
    y = held(0.05, multisine(rng), rng) + 0.03 * np.exp(0.2 * (T - MIDDLE)) * np.sin(2.0 * np.pi * 58.8 * T)
    (tone,) = tones_of(y, RATE, excitation=Excitation(period=Period(1024))).tones
    assert tone.frequency_interval_hz[0] < 58.8 < tone.frequency_interval_hz[1]
    assert tone.amplitude_interval[0] < 0.03 < tone.amplitude_interval[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run whose output begins to oscillate at 58.8 Hz under a multisine."""
    rng = np.random.default_rng(7)
    n = multisine(rng)
    y = held(0.01, n, rng) + 0.05 * np.exp(0.5 * (T - MIDDLE)) * np.sin(2.0 * np.pi * 58.8 * T)
    info = RecordingInfo(
        "r1.parquet", "multisine", "control", excites="axis", closed_loop=False, period_s=1.024, periodic_from_s=0.0
    )
    loop = LoopSetup("axis", None, None, "z_v", "y_rad", None)
    place = tmp_path_factory.mktemp("tones") / "run"
    ls.write(ls.Run(RATE, (loop,), (ls.Recording(info, RATE, {"z_v": n, "y_rad": y}),)), place)
    return place


def test_the_command_gives_table_json_and_a_picture(folder):
    done = invoked(["tones", str(folder), "--json"])
    told = json.loads(done.stdout)
    output, control = told["channels"]
    assert control["tones"] == []  # the excitation alone, to its last digit
    assert (output["channel"], output["unit"]) == ("y", "rad")
    (tone,) = output["tones"]
    assert tone["frequency_hz"] == pytest.approx(58.8, abs=0.01)
    assert tone["growth"] == "grows"
    assert [path.endswith("tones_r1_y.png") for path in told["figures"]] == [True]
    said = invoked(["tones", str(folder), "--no-figures"])
    assert "58.8" in said.stdout
    assert "grows by" in said.stderr


def test_frf_warns_of_a_tone_that_grows(folder):
    done = invoked(["frf", str(folder), "--no-figures"])
    assert done.exit_code == 0
    assert "holds a tone at 58.8 Hz that is not the excitation's and grows" in done.stderr


def test_long_signals_are_read_in_parts(monkeypatch):
    rng = np.random.default_rng(8)
    y = rng.standard_normal(N) + 0.5 * np.sin(2.0 * np.pi * 58.8 * T)
    whole = tones_of(y, RATE)
    monkeypatch.setattr("loopshape.toolbox.planning.tone.tones.LONGEST", N // 4)
    parts = tones_of(y, RATE)
    assert parts.rms == pytest.approx(whole.rms, rel=1e-12)
    assert parts.rms_interval == pytest.approx(whole.rms_interval, rel=0.01)
    assert parts.tones[0].frequency_hz == pytest.approx(58.8, abs=0.1)


def test_what_is_no_signal_is_refused():
    with pytest.raises(ls.errors.BadSignalError, match="too short"):
        ls.planning.tones(np.zeros(100), rate_hz=1000.0)
    with pytest.raises(ls.errors.WrongUseError, match="rate_hz"):
        ls.planning.tones(np.zeros(1000))
    with pytest.raises(ls.errors.BadSignalError, match="not numbers"):
        ls.planning.tones({"y": np.full(1000, np.nan)}, rate_hz=1000.0)
    (still,) = ls.planning.tones(np.zeros(1000), rate_hz=1000.0)
    assert (still.rms, still.tones) == (0.0, ())
