"""Sizes and p-values of a gap table on loops whose difference is known."""

from dataclasses import replace
from itertools import pairwise

import known_loops as known
import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo

import loopshape as ls
from loopshape.toolbox.gap.two_runs.table import compare
from loopshape.toolbox.gap.two_runs.table_paths import bands_hz

SAMPLES = 12_000
PERIOD_S = 10.0


def run(n, seed, gain=1.0, kind="noise", std=0.02, **period):
    """One recording of the known loop; `gain` is put on the plant by scaling its output and the controller back."""
    v = std * np.random.default_rng(seed).standard_normal(n.size)
    z, y = known.run_loop("controller_input", n, v)
    recording = known.record("controller_input", kind, n, z, gain * y, **period)
    return ls.Run(known.RATE, (replace(known.LOOP, controller=None),), (recording,))


def injected(kind, seed=0):
    rng = np.random.default_rng(seed)
    if kind == "noise":
        return rng.standard_normal(SAMPLES), {}
    one = rng.standard_normal(round(PERIOD_S * known.RATE))
    return np.tile(one, SAMPLES // one.size), {"period_s": PERIOD_S, "from_s": 0.0}


@pytest.mark.long
@pytest.mark.parametrize("kind", ["noise", "multisine"])
@pytest.mark.parametrize("same", [True, False])
def test_p_values_of_equal_machines_are_small_as_rarely_as_they_say(kind, same):
    values = []
    for k in range(40):
        n, period = injected(kind, 3 * k)
        other = n if same else injected(kind, 3 * k + 1)[0]
        table = compare(run(n, 100 + k, kind=kind, **period), run(other, 500 + k, kind=kind, **period))
        values += [row.p_value for row in table.rows]
        assert table.rows
    # 40 runs of some eight bands: 5 % of about 300, with room for three standard deviations
    assert np.mean(np.array(values) < 0.05) < 0.09
    assert np.mean(np.array(values) < 0.5) > 0.25  # and they are no mere words: half of them should


@pytest.mark.parametrize("kind", ["noise", "multisine"])
@pytest.mark.parametrize("gain", [1.03, 1.2])
def test_a_gain_error_has_its_size_its_gain_and_no_phase(kind, gain):
    n, period = injected(kind)
    table = compare(run(n, 1, kind=kind, **period), run(n, 2, gain, kind, **period))
    assert len(table.rows) >= 5
    for row in table.rows:
        assert row.size == pytest.approx(gain - 1.0, abs=4.0 * row.noise / np.sqrt(row.lines) + 0.1 * (gain - 1.0))
        assert row.gain_db == pytest.approx(20.0 * np.log10(gain), abs=20.0 * row.noise)
        assert abs(row.phase_deg) < 120.0 * row.noise
    assert table.largest is not None
    assert "z -> y" in table.conclusion


def test_the_noise_is_taken_off_the_size():
    n, period = injected("multisine")
    table = compare(run(n, 1, kind="multisine", std=0.08, **period), run(n, 2, 1.0, "multisine", 0.08, **period))
    rows = [row for row in table.rows if row.lines > 10]
    assert np.median([row.size for row in rows]) < 0.5 * np.median([row.noise for row in rows])
    assert table.largest is None
    assert table.conclusion.startswith("No difference beyond noise")


def test_a_delay_is_a_phase_that_falls_with_frequency():
    n, period = injected("multisine")
    real = run(n, 1, kind="multisine", std=1e-3, **period)
    recording = real.recordings[0]
    late = np.roll(recording.column("y_rad"), 1)  # one sample: a whole period repeats, so rolling is a delay
    sim = replace(real, recordings=(replace(recording, columns=dict(recording.columns) | {"y_rad": late}),))
    for row in compare(real, sim).rows:
        centre = 0.5 * sum(row.band_hz)
        if row.lines > 4 and row.band_hz[1] < 20.0:
            assert row.phase_deg == pytest.approx(-360.0 * centre / known.RATE, rel=0.15)
            assert abs(row.gain_db) < 0.3


def test_bands_cover_the_lines_once():
    for kind, ratio in (("octave", 2.0), ("third_decade", 10.0 ** (1.0 / 3.0))):
        bands = bands_hz(kind, 0.3, 14.0)
        assert bands[0][0] <= 0.3 < bands[0][1]
        assert bands[-1][0] <= 14.0 < bands[-1][1]
        assert all(b[0] == pytest.approx(a[1]) for a, b in pairwise(bands))
        assert all(b[1] / b[0] == pytest.approx(ratio) for b in bands)


def steps(seed, offset=0.0, shift=0, std=1e-3):
    """A staircase on a first-order lag, in open words: what was asked and what came."""
    r = np.repeat([0.0, 1.0, -0.5], 400)
    y, state = np.empty(r.size), 0.0
    for k, value in enumerate(np.roll(r, shift)):
        state += 0.05 * (value - state)
        y[k] = state
    y = y + offset + std * np.random.default_rng(seed).standard_normal(r.size)
    info = RecordingInfo("steps.parquet", "staircase", "reference", operating_point={"y_rad": 0.0})
    loop = LoopSetup("axis", "r_rad", None, "z_v", "y_rad", None)
    return ls.Run(known.RATE, (loop,), (ls.Recording(info, known.RATE, {"r_rad": r, "z_v": 0.0 * r, "y_rad": y}),))


def test_windows_and_rests_of_equal_inputs():
    table = compare(steps(1), steps(2))
    assert {row.kind for row in table.times} == {"window", "rest"}
    assert not any(row.loud for row in table.times if row.signal == "y_rad")
    windows = [row for row in table.times if row.kind == "window" and row.signal == "y_rad"]
    assert [(w.from_s, w.to_s) for w in windows] == [(0.0, 4.0), (4.0, 8.0), (8.0, 12.0)]
    assert all(w.ratio == pytest.approx(1.0, abs=0.2) for w in windows)


def test_a_static_offset_is_found_at_rest_and_a_lag_in_the_windows():
    moved = compare(steps(1), steps(2, offset=0.01))
    rests = [row for row in moved.times if row.kind == "rest" and row.signal == "y_rad"]
    assert [row.difference for row in rests] == pytest.approx([0.01] * 3, abs=5e-4)
    assert all(row.loud for row in rests)
    late = compare(steps(1), steps(2, shift=5))
    loud = [row for row in late.times if row.loud and row.signal == "y_rad"]
    assert {row.kind for row in loud} == {"window"}
    assert "time responses differ, most y_rad" in late.conclusion
