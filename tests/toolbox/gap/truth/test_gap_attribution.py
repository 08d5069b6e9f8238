"""An arm with a known effect: named, its size met, its held-out gap closed; a healthy arm is healthy."""

from dataclasses import replace

import numpy as np
import pytest
from examiner import make_run
from simulated_machines import FORMS, Arm1

from loopshape.toolbox.gap.diagnose import attribute, decide, fitting, shrink
from loopshape.toolbox.gap.diagnose.diagnose import attribute_effect
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis

pytestmark = pytest.mark.long

CATALOGUE = ("payload", "gas_law", "joint_friction", "valve_delay", "angle_sensor_lag")


def arm():
    """The arm with a small catalogue: one form each."""
    made = Arm1()
    made.effects = tuple(next(f for f in FORMS if f.effect == name) for name in CATALOGUE)
    return made


def short(labels, seed):
    """An arm of the independent generator, its recordings cut to 11 s."""
    run = make_run(labels, seed)
    cut = [replace(r, columns={k: v[:11000] for k, v in r.columns.items()}) for r in run.recordings]
    return replace(run, recordings=tuple(cut))


def attributed(run):
    names = [r.info.name for r in run.recordings if r.info.role == "estimation"]
    return attribute_effect(arm(), run, names, threads=1, say=lambda step: None)


@pytest.fixture(scope="module")
def healthy():
    run = short({}, 41)
    return run, attributed(run)


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "magnitude"), [("payload", 60.0), ("gas_law", 0.8), ("angle_sensor_lag", 10.0), ("valve_delay", 3.5)]
)
def test_a_single_effect_is_named_with_its_size_and_closes_the_held_out_gap(effect, magnitude):
    run = short({effect: magnitude}, 42)
    a = attributed(run)
    assert a.verdict == effect
    assert a.probabilities[effect] > 0.8
    assert a.leading.fitted.magnitudes[0] == pytest.approx(magnitude, rel=0.2)
    held = [r for r in run.recordings if r.info.role == "validation"]
    moves = [f.hypothesis.moves(f.phi) for f in (a.none.fitted, a.leading.fitted)]
    before, after = shrink.levels(a.evidence.plant, run, held, moves)
    assert before.size > 2.0
    assert shrink.shrink_of(before.squares, after.squares) > 0.8


@pytest.mark.long
def test_two_effects_are_both_named():
    a = attributed(short({"payload": 60.0, "gas_law": 0.9}, 43))
    assert a.verdict == "gas_law+payload"
    assert a.leading.fitted.hypothesis.name == "gas_law+payload"


def test_a_healthy_arm_is_healthy_and_leaves_noise(healthy):
    _, a = healthy
    assert a.verdict == "none"
    assert a.none.fitted.cost < a.evidence.quiet + 3.0
    assert np.all(np.abs(a.none.fitted.phi) <= 1.0)


@pytest.mark.long
def test_what_the_catalogue_lacks_is_unknown():
    a = attributed(short({"potentiometer_waves": 1.2}, 44))
    assert a.verdict == "unknown"


def test_leaving_recordings_out_by_slopes_is_fitting_without_them(healthy):
    """The linear prediction for one recording against a fit that never saw it."""
    run, a = healthy
    names = a.evidence.recordings
    base = a.none.fitted
    left = attribute.left_out(a.evidence, base)
    few = Evidence.of(a.evidence.plant, run, names[1:], 10.0, 1)
    again = fitting.improve(
        few,
        fitting.at(few, base.hypothesis, base.phi, np.zeros((few.cells[-1].stop, base.phi.size))),
        4,
        all_slopes=True,
    )
    assert np.max(np.abs(left.phi[0] - again.phi)) < 0.35  # of a spread of -1..1; other weights, and a light hold
    assert left.cost >= fitting.cost(base.mean_squares) - 1e-9


def test_probabilities_add_up_and_hold_every_name(healthy):
    _, a = healthy
    assert sum(a.probabilities.values()) == pytest.approx(1.0)
    assert set(a.probabilities) >= {"none", "unknown", *CATALOGUE}


def test_an_unusual_size_costs_and_a_usual_one_does_not():
    form = next(f for f in FORMS if f.effect == "payload")
    assert decide.unusual(form, 50.0) == 0.0
    assert decide.unusual(form, 1.0) > decide.unusual(form, 10.0) > 0.5
    assert decide.unusual(form, 900.0) > 3.0


def test_the_spread_moves_what_it_names_by_its_share():
    plant = arm()
    h = Hypothesis(plant)
    phi = np.zeros(len(plant.spread))
    phi[[s.name for s in plant.spread].index("damping")] = 0.5
    moves = h.moves(phi)
    assert moves["damping_ns_m"] == pytest.approx(44.0)
    assert moves["m2_kg"] == pytest.approx(0.533)
    phi[-1] = -1.0
    assert h.moves(phi)["m2_kg"] == pytest.approx(0.533 * 0.99)


def test_a_shrink_is_none_without_a_gap_and_one_at_the_floor():
    assert shrink.shrink_of(np.full((2, 3, 4), 1.2**2), np.ones((2, 3, 4))) is None
    assert shrink.shrink_of(np.full((2, 3, 4), 9.0), np.ones((2, 3, 4))) == pytest.approx(1.0)
    assert shrink.shrink_of(np.full((2, 3, 4), 9.0), np.full((2, 3, 4), 4.0)) == pytest.approx(0.5)
