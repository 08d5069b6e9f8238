"""The bandwidth of C: by hand for simple blocks, and kept by the tuner where it is limited."""

import numpy as np
import pytest
from bench_nouns import Block
from tune_plants import GAIN, LEAD, LOW_PASS, NOTCH, RATE, required, servos

import loopshape as ls
from loopshape.data.control.controller import controller_bandwidth_hz
from loopshape.design.tune import tune

LAG = Block("low_pass_1", {"f_hz": 10.0})


def bandwidth(*blocks):
    return controller_bandwidth_hz(ls.Controller("one", blocks, RATE))


def test_a_low_pass_of_first_order_has_its_corner():
    assert bandwidth(LAG) == pytest.approx(10.0, rel=2e-3)


def test_a_low_pass_of_second_order_with_butterworth_damping_has_its_corner():
    assert bandwidth(Block("low_pass_2", {"f_hz": 20.0, "damping": np.sqrt(0.5)})) == pytest.approx(20.0, rel=2e-3)


def test_gain_and_integrator_do_not_count():
    assert bandwidth(Block("gain", {"gain": 40.0}), LAG, Block("pi", {"f_hz": 3.0})) == pytest.approx(
        bandwidth(LAG), rel=1e-12
    )


def test_what_does_not_roll_off_has_half_the_rate():
    assert bandwidth(Block("gain", {"gain": 2.0})) == 0.5 * RATE
    assert bandwidth(Block("lead_lag", {"f1_hz": 5.0, "f2_hz": 50.0})) == 0.5 * RATE


def test_it_is_measured_from_the_top_of_a_lead():
    # |C| rises tenfold from 1 Hz, the low-pass brings it down again: 3 dB below the top, not below the start
    lead = Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 10.0})
    found = bandwidth(lead, Block("low_pass_2", {"f_hz": 100.0, "damping": 0.7}))
    assert 80.0 < found < 110.0


@pytest.mark.long
def test_the_tuner_keeps_it_and_it_costs():
    limits = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 35.0, "gain_margin_db": 6.0, "control_peak_db": 20.0}
    free = tune(servos(), required(GAIN, LEAD, NOTCH, LOW_PASS, **limits))
    most = 0.3 * controller_bandwidth_hz(free.controller)
    kept = tune(servos(), required(GAIN, LEAD, NOTCH, LOW_PASS, **limits, controller_bandwidth_hz=most), explain=False)
    assert controller_bandwidth_hz(kept.controller) <= most
    assert controller_bandwidth_hz(kept.controller) > 0.98 * most
    assert 0.3 * free.bandwidth_hz < kept.bandwidth_hz < free.bandwidth_hz


def test_a_check_reads_it():
    asked = required(GAIN, phase_margin_deg=10.0, controller_bandwidth_hz=100.0)
    line = next(
        one
        for one in ls.check(servos(), ls.Controller("one", (Block("gain", {"gain": 0.01}),), RATE), asked).lines
        if one.quantity == "controller_bandwidth_hz"
    )
    assert line.outcome == "failed"
    assert line.value == 0.5 * RATE
