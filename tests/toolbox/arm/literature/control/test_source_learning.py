"""The source against a learner (section 5.4): the arm that is driven by nine actions, and the feedback's side.

The learner itself needs an extra and minutes (`experiments/learning`); here is what both are measured on.
"""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Experiment

from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.source import value

STUDY = Path(__file__).parents[5] / "experiments" / "learning"
sys.path.insert(0, str(STUDY))
from arm_stepper import SteppedArm  # noqa: E402
from feedback_rival import feedback, valve_edges  # noqa: E402
from nine_actions import ACTIONS, HOLD, LIMIT, Rules, Trace, Trial, pairs, play, relay  # noqa: E402
from rivals import designed  # noqa: E402
from trial_outcomes import at_setpoint, first_held, reached_s, summary  # noqa: E402

from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS  # noqa: E402

SETTINGS = tomllib.loads((STUDY / "study.toml").read_text(encoding="utf-8"))
RULES = Rules(**SETTINGS["trial"], **SETTINGS["reward"])
SECONDS = RULES.limit_s + RULES.stay_s


@pytest.mark.parametrize("changes", [{}, SETTINGS["changes"]["heavier"]])
def test_the_stepped_arm_is_the_simulated_arm(changes):
    actions = [ACTIONS[k] for k in np.random.default_rng(1).integers(len(ACTIONS), size=25)]
    arm = SteppedArm(RULES.action_s, changes)
    stepped = [arm.start(5.0, 1.2, 7)[None]]
    for u_a, u_b in actions:
        fine, rows = arm.act(u_a, u_b)
        assert fine
        stepped.append(rows)
    stepped = np.concatenate(stepped)[:-1]
    z = np.repeat([(0.5 * (a - b), 0.5 * (a + b)) for a, b in actions], arm.ticks, axis=0)
    loops = Arm1().loop_setups(Arm1().default_controllers(1000.0), "control")
    point = {"theta2_deg": 5.0, "p_ab_bar": 1.2}
    asked = Experiment(
        "open", "open_loop", loops, 1000.0, np.zeros_like(z), z, "control", point, closed_loop=False, seed=7
    )
    whole = Arm1().simulate([asked], changes=changes, threads=1)[0]
    columns = np.array([whole.column(c) for c in ("theta2_rad", "p_a_bar", "p_b_bar")]).T
    assert np.abs(columns - stepped * [1.0, 1e-5, 1e-5]).max() < 1e-9


def test_the_trials_are_the_sources():
    assert len(ACTIONS) == value("learning.actions")
    assert value("learning.limit") == LIMIT
    assert RULES.states == value("learning.states")


def test_with_all_valves_shut_the_arm_rests():
    trial = Trial(RULES)
    seen = trial.start(10.0, 12.5, 3)
    for _ in range(10):
        fine, rows = trial.act(HOLD)
        assert fine
        assert np.abs(np.rad2deg(rows[:, 0]) - 10.0).max() < 0.3  # noise and converter
    assert trial.seen()[: RULES.states] == pytest.approx(seen[: RULES.states], abs=0.03)
    assert trial.paid(True) == pytest.approx(RULES.per_deg * 2.5, abs=0.01)
    trial.setpoint_deg = 11.0
    assert trial.paid(True) > 0.0
    assert trial.paid(False) == RULES.left_range


@pytest.fixture(scope="module")
def steered():
    """The tuned feedback controller on a part of the study's trials, and without the PWM's dead zone."""
    trials = pairs(RULES, 15, SETTINGS["final"]["seed"])
    controllers = designed()["feedback"]
    return [summary(feedback(controllers, RULES, trials, SECONDS, 1, c), RULES) for c in ({}, {"pwm_dead_zone": 0.0})]


def test_feedback_reaches_every_setpoint_and_rests_with_its_valves_shut(steered):
    found = steered[0]
    assert found.reached == found.trials == found.stayed
    assert found.moving == 0
    assert found.static_deg < 0.1
    assert found.edges_hz < 1.0


def test_without_the_dead_zone_the_valves_never_rest(steered):
    assert steered[1].edges_hz > 100.0


def test_a_relay_on_the_error_shakes_the_arm_out_of_its_range():
    trials = pairs(RULES, 15, SETTINGS["final"]["seed"])
    for ahead_s in (0.0, SETTINGS["final"]["relay_ahead_s"]):
        found = summary(play(relay(RULES, 1.0, ahead_s), RULES, trials, SECONDS, 1), RULES)
        assert found.reached <= 2
        assert found.left_range >= 13


def made(theta2_deg, left_range=False):
    n = theta2_deg.size
    return Trace(np.zeros(n), theta2_deg, np.zeros((n, 2)), np.zeros(n), left_range)


def test_reached_is_the_first_stay_inside_the_tolerance_before_the_limit():
    t = np.arange(round(SECONDS * 1000)) * 1e-3
    assert first_held(np.array([True, False, True, True]), 2) == 2
    passing = np.where((t > 1.0) & (t < 1.0 + 0.9 * RULES.held_s), 0.0, 9.0)
    assert np.isnan(reached_s(made(passing), RULES.limit_s, RULES.tolerance_deg, RULES.held_s))
    assert reached_s(made(np.where(t > 1.0, 0.0, 9.0)), RULES.limit_s, 2.0, 0.5) == pytest.approx(1.0, abs=2e-3)
    late = made(np.where(t > RULES.limit_s, 0.0, 9.0))
    assert np.isnan(reached_s(late, RULES.limit_s, RULES.tolerance_deg, RULES.held_s))


def test_a_limit_cycle_is_found_with_its_span_and_frequency():
    t = np.arange(round(SECONDS * 1000)) * 1e-3
    end = at_setpoint(made(1.5 * np.sin(2.0 * np.pi * 5.0 * t)), RULES)
    assert end.span_deg == pytest.approx(3.0, abs=0.01)
    assert end.frequency_hz == pytest.approx(5.0, abs=0.1)
    assert np.isnan(at_setpoint(made(np.zeros(t.size)), RULES).frequency_hz)


def test_edges_of_the_valves_are_counted_a_pulse_each():
    vector = ARM1_PARAMETERS.vector()

    def counted(*commands):
        return valve_edges(np.repeat(commands, 20), vector).sum()

    assert counted(0.0, 0.5, 0.0) == 2
    assert counted(0.0, 1.0, 1.0, 0.0) == 2  # open through both periods
    assert counted(0.005, -0.005) == 0  # inside the dead zone
    assert counted(1.0, -1.0, 0.0) == 4  # the out valve takes over from the in valve
