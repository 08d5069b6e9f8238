"""A step's log alone: a command at its end or at its largest rate, a sensor that freezes, and none of that."""

import numpy as np
import pytest
from bench_nouns import LoopSetup, Recording, RecordingInfo
from scipy.signal import lfilter

from loopshape.toolbox.rig.settings import Limit
from loopshape.toolbox.rig.steps.escalation import Climb, Escalation, Stop, at_rest
from loopshape.toolbox.rig.steps.escalation import tested as step_after

RATE, PERIOD = 1000.0, 1000
LIMITS = {"y_m": Limit("y_m", -10.0, 10.0), "u_v": Limit("u_v", -50.0, 50.0)}
LOOP = LoopSetup("loop", None, "n_m", "u_v", "y_m", None)
COMMANDS = frozenset({"u_v"})


def recording(u, y, n):
    info = RecordingInfo(
        "step.parquet", "multisine", "controller_input", excites="loop", period_s=1.0, periodic_from_s=0.0
    )
    return Recording(info, RATE, {"t_s": np.arange(u.size) / RATE, "n_m": n, "u_v": u, "y_m": y})


def signals(size, seed=0):
    """Two periods of a smooth excitation, the command of a loop that hardly reacts, and what it moves; with noise."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(PERIOD // 2 + 1, dtype=complex)
    spectrum[2:60] = np.exp(2j * np.pi * rng.random(58))
    n = size * np.tile(np.fft.irfft(spectrum, PERIOD), 2) * 30.0
    u = n + 0.01 * rng.standard_normal(n.size)
    return n, u


def moved(u, seed=1):
    return lfilter([0.0, 0.1], [1.0, -0.9], u) + 0.001 * np.random.default_rng(seed).standard_normal(u.size)


def climb_within(limits):
    return Climb(LOOP, Escalation(), limits, COMMANDS, None)


def stop_of(change=lambda u: u, freeze_from=None, size=1.0):
    n, u = signals(size)
    _, seen = at_rest(
        recording(*(0.01 * np.random.default_rng(2).standard_normal((2, 2 * PERIOD))), 0 * n), LIMITS, COMMANDS
    )
    u = change(u)
    y = moved(u)
    if freeze_from is not None:
        y[freeze_from:] = y[freeze_from]
    step, _ = step_after(recording(u, y, n), climb_within(LIMITS), 10.0, (seen,), 0.1, None)
    return step


def at_most_so_fast(u, most):
    out = u.copy()
    for k in range(1, u.size):
        out[k] = out[k - 1] + np.clip(u[k] - out[k - 1], -most, most)
    return out


def test_a_sound_step_leads_to_the_next():
    step = stop_of()
    assert step.stop is None
    assert step.valid
    assert step.next_percent == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("change", "stop"),
    [
        (lambda u: np.clip(u, -np.inf, 0.7 * u.max()), Stop.CLIPPED),
        (lambda u: np.clip(u, 0.7 * u.min(), np.inf), Stop.CLIPPED),
        (lambda u: at_most_so_fast(u, 0.3 * np.abs(np.diff(u)).max()), Stop.RATE_LIMITED),
    ],
)
def test_an_actuator_at_its_end_makes_the_data_invalid(change, stop):
    step = stop_of(change)
    assert step.stop is stop
    assert not step.valid
    assert step.next_percent is None


@pytest.mark.parametrize("freeze_from", [PERIOD + 100, PERIOD + 700])
def test_a_sensor_that_freezes_within_a_step_is_seen_by_its_period_before(freeze_from):
    assert stop_of(freeze_from=freeze_from).stop is Stop.STUCK


def test_the_next_step_is_smaller_near_to_a_limit_and_then_there_is_none():
    near = stop_of(size=9.0)
    assert 10.0 < near.next_percent < 12.0
    assert min(one.left_percent for one in near.rooms) >= 25.0
    assert stop_of(size=10.5).stop is Stop.LIMIT_NEAR
