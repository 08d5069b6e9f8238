"""Biquads and pulse widths of the target in C are those of the kernels, to the last bit where both round alike."""

import struct

import numpy as np
import pytest
from bench_nouns import Block
from target_cases import GAIN, INFINITE, Bench

import loopshape as ls
from loopshape.core.kernels import biquads
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.formats.controllers.controller_words import run_floating
from loopshape.toolbox.rig.target.messages import Request

RATE_HZ = 1000.0
WIDE = np.array([[-1e6, 1e6, INFINITE]] * 5)
SERIES = ls.Controller(
    "theta2",
    (
        Block("gain", {"gain": 11.0}),
        Block("pi", {"f_hz": 0.7}),
        Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0}),
        Block("notch", {"f1_hz": 4.5, "f2_hz": 6.1, "damping1": 0.05, "damping2": 0.8}),
        Block("low_pass_2", {"f_hz": 19.0, "damping": 0.55}),
    ),
    RATE_HZ,
).biquads()


def recorded(bench, sensors, **configuration):
    """Samples (n, 11) of a recording in which nothing is injected, with these sensors (n, 3)."""
    bench.arm(tuple(sensors[0]), watchdog_ms=60000, limits=WIDE, **configuration)
    bench.to_setpoint(0.0, 0.0)
    bench.tick(19)  # the next tick begins a period
    return bench.watched(sensors)


@pytest.fixture
def bench():
    b = Bench()
    yield b
    b.close()


def test_controllers_of_twelve_sections_to_the_last_bit(bench):
    rng = np.random.default_rng(1)
    sensors = rng.standard_normal((3000, 3)) * 10.0 ** rng.uniform(-6.0, 2.0, (3000, 1))
    twelve = np.vstack([SERIES, GAIN, SERIES[1:], GAIN, GAIN])
    assert len(twelve) == 12
    samples = recorded(bench, sensors, sections=(SERIES, twelve))
    np.testing.assert_array_equal(samples[:, 6:9], sensors)
    # the references come to the setpoint with the tick after it was set: before, the controllers saw no error
    errors = (-sensors[:, 0], -(sensors[:, 1] + sensors[:, 2]))
    lead = [np.full(bench_ticks(samples, e), e[0]) for e in errors]
    for k, (sections, e) in enumerate(zip((SERIES, twelve), errors, strict=True)):
        signal = np.concatenate([lead[k], e])
        mine = run_floating(sections, signal, np.float64)[len(lead[k]) :]
        np.testing.assert_array_equal(samples[:, 4 + k], mine)
        kernel = biquads.run(sections, np.zeros((len(sections), 2)), signal)[len(lead[k]) :]
        np.testing.assert_allclose(samples[:, 4 + k], kernel, rtol=1e-8, atol=1e-9)  # it may contract


def bench_ticks(samples, errors):
    """Ticks from the setpoint to the recording: the answer to a constant error tells how many."""
    out = run_floating(SERIES, np.full(200, -samples[0, 6]), np.float64)
    (found,) = np.flatnonzero(out == samples[0, 4])
    assert errors.size
    return int(found)


COMMANDS = [0.0, 0.009, 0.01, np.nextafter(0.01, 1.0), 0.5, 0.98, 0.99, np.nextafter(0.99, 1.0), 1.0, 1.3, 1e-300]


@pytest.mark.parametrize(("pwm_hz", "dead_zone"), [(0.0, 0.0), (100.0, 0.02), (1000.0, 0.0), (40.0, 0.5)])
def test_pulses_to_the_last_bit(bench, pwm_hz, dead_zone):
    hz, zone = pwm_hz or 50.0, dead_zone or 0.01  # 0 leaves the board's own
    period = round(RATE_HZ / hz)
    rng = np.random.default_rng(2)
    values = np.array([*COMMANDS, *rng.uniform(0.0, 1.2, 60)])
    u = np.concatenate([values, -values])
    sensors = np.repeat(np.column_stack([-u, np.zeros((u.size, 2))]), period, axis=0)
    samples = recorded(bench, sensors, pwm_hz=pwm_hz, dead_zone=dead_zone)
    given = [line for line in bench.said if line.startswith("g ")][-u.size :]
    pulses = np.array([[float(v) for v in line.split()[1:]] for line in given])
    period_s = period * (1.0 / RATE_HZ)
    for k, command in enumerate((u, -u)):
        expected = [np.copysign(pwm.pulse_s(v, period_s, zone), v) for v in command.tolist()]
        np.testing.assert_array_equal(pulses[:, k], expected)
    np.testing.assert_array_equal(samples[::period, 9], u)


def test_a_board_without_pwm_gets_its_commands_each_tick():
    bench = Bench(pwm_hz=0.0)
    sensors = np.zeros((50, 3))
    sensors[:, 0] = np.linspace(0.0, 1.7, 50)
    samples = recorded(bench, sensors)
    given = np.array([[float(v) for v in line.split()[1:]] for line in bench.said if line.startswith("g ")])
    np.testing.assert_array_equal(given[-50:], samples[:, 9:])
    assert bench.status().tick == 50
    bench.ok(Request.DISARM)
    asked = bytearray(bench.configuration.frames()[0][1])
    asked[13:21] = struct.pack("<d", 50.0)
    assert bench.no(Request.CONFIGURE, bytes(asked)) == 8
    bench.close()
