"""A logger whose clock wanders by 6.5 ms: no effect of the catalogue, so the answer is `unknown`, and not a hose."""

from dataclasses import replace

import numpy as np
import pytest
import small_gap_run
from scipy.signal import butter, sosfiltfilt

import loopshape as ls

JITTER_S = 6.5e-3
SENSORS = ("theta2_rad", "p_a_bar", "p_b_bar")


def jittered(recording: ls.Recording, columns: tuple[str, ...], wander_hz: float | None, seed: int) -> ls.Recording:
    """Columns as they were at other times than their rows say: by white noise, or one that wanders below a corner."""
    n = len(recording.column("theta2_rad"))
    t, off_s = np.arange(n) / recording.rate_hz, np.random.default_rng(seed).standard_normal(n)
    if wander_hz is not None:
        off_s = sosfiltfilt(butter(2, wander_hz, fs=recording.rate_hz, output="sos"), off_s)
    then = t + JITTER_S * off_s / off_s.std()
    seen = {name: np.interp(then, t, recording.column(name)) for name in columns}
    return replace(recording, columns={**recording.columns, **seen})


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.parametrize(
    "columns", [SENSORS, (*SENSORS, "z_theta2_v", "z_p_v", "u_a_v", "u_b_v")], ids=["sensors", "all"]
)
@pytest.mark.parametrize("wander_hz", [None, 5.0])
def test_a_clock_that_jitters_is_unknown(columns, wander_hz):
    run = small_gap_run.recorded({})
    spoilt = [jittered(r, columns, wander_hz, k) for k, r in enumerate(run.recordings)]
    found = ls.gap(replace(run, recordings=tuple(spoilt)), table=False)
    assert found.verdict == "unknown"
    assert found.probability > 0.9
