"""The PWM of DCT 2007.002: 3.2, appendix C, section 5.5, chapter 6 (experiments/pwm)."""

import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_machines import read_study

from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.dynamics.model import flow, supply_flows
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS
from loopshape.toolbox.arm.source import value

sys.path.insert(0, str(Path(__file__).parents[5] / "experiments" / "pneumatic_test_setup"))
sys.path.insert(0, str(Path(__file__).parents[5] / "experiments" / "pwm"))

import pwm_lag as lag
import pwm_rest as rest
import pwm_ripple as ripple

STUDY = Path(__file__).parents[5] / "experiments" / "pwm"
SETTINGS = tomllib.loads((STUDY / "settings.toml").read_text(encoding="utf-8"))
PERIOD_S = 1.0 / value("pwm_frequency")


@pytest.mark.parametrize("figure", ["figure_3_3", "figure_c_6"])
def test_dead_zones_of_the_examples_cannot_be_in_seconds(figure):
    """A threshold from tau to 1 - tau needs tau below one half."""
    tau, f = value(f"{figure}.dead_zone"), value(f"{figure}.pwm_frequency")
    assert tau < 0.5 <= tau * f


def test_the_model_has_the_source_s_pwm():
    table = dict(zip(ARM1_PARAMETERS.names, ARM1_PARAMETERS.vector(), strict=True))
    assert table["pwm_frequency_hz"] == value("pwm_frequency") == value("figure_c_6.pwm_frequency")
    assert table["pwm_dead_zone"] == value("pwm_dead_zone") == value("figure_c_6.dead_zone")


def test_a_pulse_has_the_power_of_the_sampled_command():
    """(C.4-C.6)."""
    for u in np.linspace(0.011, 0.989, 50):
        assert pwm.pulse_s(u, PERIOD_S, value("pwm_dead_zone")) == pytest.approx(u * PERIOD_S, rel=1e-12)


def test_the_model_s_dead_zone_is_the_rule_s_number_and_not_its_time():
    """(C.9) as bare number and in s; what the kernel does with the number is a share of the period."""
    table = dict(zip(ARM1_PARAMETERS.names, ARM1_PARAMETERS.vector(), strict=True))
    tau, rule = table["pwm_dead_zone"], value("pwm_dead_zone_rule") / value("valve_frequency")
    shortest_s = min(s for s in (pwm.pulse_s(u, PERIOD_S, tau) for u in np.linspace(0.0, 0.1, 1001)) if s > 0.0)
    assert 0.5 < tau / rule < 2.0
    assert shortest_s < 0.05 * rule
    assert shortest_s < 0.2e-3 * value("valve_response_open")


def test_tables_3_1_and_3_2_are_the_kernel_s():
    c, p_c, p_a, p_b = k.constants(k.ARM1_PARAMETERS.vector()), 0.98e5, 0.3e5, 0.7e5
    assert supply_flows(c, p_c, p_a, p_b, 0.0, 0.0) == (0.0, 0.0)
    assert supply_flows(c, p_c, p_a, p_b, 1.0, 0.0) == (flow(c, c[k.BETA_S], p_c, p_a), 0.0)
    q_a, q_b = supply_flows(c, p_c, p_a, p_b, 1.0, 1.0)
    assert q_a + q_b == pytest.approx(flow(c, c[k.BETA_S], p_c, min(p_a, p_b)), rel=1e-12)
    assert q_a / (q_a + q_b) == pytest.approx((p_c - p_a) / (2.0 * p_c - p_a - p_b), rel=1e-12)


def test_a_small_sine_about_zero_is_late_by_half_the_mean_pulse():
    a, f = 0.05, 1.0
    measured = lag.lag_deg(lag.gain(f, a, 0.0, 0.0, SETTINGS["lag"]))
    assert measured == pytest.approx(360.0 * f * 8.0 / (3.0 * np.pi) * a * PERIOD_S / 2.0, rel=1e-3)


def test_a_small_sine_about_an_offset_is_late_by_the_whole_pulse():
    """Only the pulse's end moves: no half of it, and more than a hold's half period beyond an offset of 0.5."""
    for offset in (0.2, 0.6):
        measured = lag.lag_deg(lag.gain(5.0, 0.02, offset, 0.0, SETTINGS["lag"]))
        assert measured == pytest.approx(360.0 * 5.0 * offset * PERIOD_S, rel=1e-3)
        assert (measured > lag.hold_deg(5.0)) == (offset > 0.5)


def test_a_saturated_sine_is_late_by_a_hold_s_half_period():
    assert lag.lag_deg(lag.gain(5.0, 20.0, 0.0, 0.0, SETTINGS["lag"])) == pytest.approx(lag.hold_deg(5.0), rel=0.01)


def test_the_source_s_lag_at_5_hz_is_that_of_one_amplitude():
    wanted = value("pwm_phase_lag_5hz")
    assert lag.amplitude_for(5.0, wanted, 0.01, SETTINGS["lag"]) == pytest.approx(0.65, abs=0.01)
    small = lag.lag_deg(lag.gain(5.0, 0.1, 0.0, 0.01, SETTINGS["lag"]))
    assert small < 0.2 * wanted < wanted < lag.hold_deg(5.0)


def test_ripple_falls_with_the_frequency_and_the_rise_time_does_not_change():
    slow, fast = (value(f"{name}.frequency") for name in ("figure_c_2", "figure_c_4"))
    runs = {f: ripple.fill(ripple.models.bench(), f) for f in (slow, fast)}
    size = {f: ripple.ripple_mbar(run, f, 3, 0.5) for f, run in runs.items()}
    assert size[slow] / size[fast] == pytest.approx(fast / slow, rel=0.15)
    assert ripple.rise_s(runs[slow]) == pytest.approx(ripple.rise_s(runs[fast]), abs=0.5 / slow)


def at_rest(condition, dead_zone):
    study = read_study(STUDY / "study.toml")
    words = SETTINGS["rest"]["conditions"][condition]
    changed = replace(study, pwm={"dead_zone": dead_zone}, changes=rest.changes(words))
    return next(rest.one_study(changed, condition, dead_zone, SETTINGS["rest"]["from_s"]))


def test_without_dead_zone_the_printed_arm_rests_unless_something_moves_it():
    assert at_rest("neither", 0.0).kind == "rest"
    assert at_rest("noise and converters", 0.0).kind == "irregular"
    assert at_rest("late valves, neither", 0.0).kind == "periodic"
    assert at_rest("late valves, neither", value("pwm_dead_zone")).kind == "rest"


def test_a_smaller_dead_zone_makes_the_loop_nervous_and_a_larger_one_leaves_an_error():
    own, code = (
        at_rest("noise and converters", value(key)).pulses_s for key in ("pwm_dead_zone", "pwm_dead_zone_code")
    )
    assert code > 10.0 * max(own, 0.1)
    errors = [abs(at_rest("neither", tau).error_deg) for tau in (0.0, 0.01, 0.1)]
    assert errors[0] < 1e-9
    assert errors[2] > 3.0 * errors[1] > 0.0
