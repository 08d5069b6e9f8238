"""A run over the target in Python is the direct simulation of its machine, bit for bit, and its FRF the machine's."""

import numpy as np
import pytest
from axis_study import experiment, measured, simulated, study_text, table, target, write_study
from python_target import Board, Target
from python_target_line import Pty, Running
from python_target_machine import Axes

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf

MOVING = 'references = { axis1 = { kind = "staircase", times_s = [0.2, 0.5], values_rad = [0.2, -0.1] } }'
CONTROL = """
[[experiment]]
name = "open"
duration_s = 0.7
control = { axis1 = { kind = "staircase", times_s = [0.1, 0.3], values_v = [0.05, -0.05] } }
"""
WITHOUT = """
[[experiment]]
name = "nothing"
duration_s = 0.5
"""
CASES = [
    ("controller_input", experiment("one"), "one"),
    ("plant_input", experiment("one", "plant_input", "v", 0.3), "one"),
    ("reference", experiment("one", "reference"), "one"),
    ("controller_input", experiment("one", more=MOVING), "one"),
    ("control", CONTROL, "open"),
    ("controller_input", WITHOUT, "nothing"),
]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize(("injection", "text", "name"), CASES)
def test_what_is_stored_is_what_was_done(tmp_path, injection, text, name, count):
    study = write_study(tmp_path, study_text(text, count=count))
    with Running(lambda: target(count)) as running:
        assert measured(study, tmp_path / "run", running.port) == []
    found, expected = table(tmp_path / "run", name, injection, count), simulated(study, name, count)
    if injection == "control":  # what is injected is z itself
        expected |= {key: 0.0 * value for key, value in expected.items() if key[0] == "n"}
    for key, values in expected.items():
        np.testing.assert_array_equal(found[key], values, err_msg=key)
    assert np.ptp(found["s1"]) > 0.0


def test_over_a_pseudo_terminal_and_in_single_precision_it_is_rounded_and_no_more(tmp_path):
    study = write_study(tmp_path, study_text())
    with Running(lambda: target(number_bytes=4), line=Pty()) as running:
        measured(study, tmp_path / "run", running.port)
    found, expected = table(tmp_path / "run", "one"), simulated(study, "one")
    for key, values in expected.items():
        largest = np.abs(values).max()
        np.testing.assert_allclose(found[key], values, atol=1e-6 * largest, rtol=0.0, err_msg=key)
    assert not np.array_equal(found["s1"], expected["s1"])  # the excitation came in single precision


def test_in_real_time_nothing_is_missing(tmp_path):
    """Not placed: noise and start are the machine's own. The columns still obey the loop's equations."""
    text = study_text(target=["place = false", "soft_start_s = 0.05", "settle_s = 0.2"])
    with Running(lambda: target(fast=False)) as running:
        measured(write_study(tmp_path, text), tmp_path / "run", running.port)
    found, expected = table(tmp_path / "run", "one"), simulated(tmp_path / "study.toml", "one")
    np.testing.assert_array_equal(found["n1"], expected["n1"])
    np.testing.assert_array_equal(found["u1"], found["z1"])
    np.testing.assert_allclose(found["s1"], expected["s1"], atol=0.02)


@pytest.mark.parametrize("injection", ["controller_input", "plant_input"])
def test_the_frf_is_the_machine_s(tmp_path, injection):
    amplitude = (0.05, "rad") if injection == "controller_input" else (1.0, "v")
    text = study_text(experiment("one", injection, amplitude[1], amplitude[0], periods=8))
    with Running(lambda: Target(Axes(noise_rad=1e-6), Board())) as running:
        measured(write_study(tmp_path, text), tmp_path / "run", running.port)
    run = ls.read(tmp_path / "run")
    frf = estimate_frf(run.recordings[0], run.loops[0])
    z = np.exp(2j * np.pi * frf.frequency_hz / 1000.0)
    truth = np.array([Axes().response(one, 0, 0) for one in z])
    np.testing.assert_allclose(frf.response[:, 0, 0], truth, rtol=0.02)
