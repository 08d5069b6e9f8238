"""Objectives: what is made large is what was asked, by definition and against a search of the whole grid."""

import numpy as np
import pytest
from bench_nouns import Block
from tune_plants import DELAYED, GAIN, LEAD, LOW_PASS, NOTCH, PI, RATE, frf, problem_of, required, servos

import loopshape as ls
from loopshape.design.problem.measures import measure
from loopshape.design.tune import Search, tune

LOW = {"disturbance": 1.0, "disturbance_below_hz": 3.0}
NEAR = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 30.0, "gain_margin_db": 6.0}


def mean_rejection_db(plant, controller, below_hz):
    """Mean of 1/|S| in dB over ln f up to a frequency, by the trapezoidal rule."""
    f = plant.frequency_hz[plant.frequency_hz <= below_hz]
    L = (controller.response(plant.frequency_hz) * plant.siso)[: f.size]
    size = 20.0 * np.log10(np.abs(1.0 + L))
    return np.trapezoid(size, np.log(f)) / np.log(f[-1] / f[0])


def test_rejection_is_the_mean_of_s_over_ln_f():
    found = tune([frf(DELAYED)], required(GAIN, PI, **NEAR, objective=LOW))
    assert found.feasible
    expected = mean_rejection_db(frf(DELAYED), found.controller, 3.0)
    assert found.rejection_db == pytest.approx(expected, rel=1e-9)
    assert found.objective == pytest.approx(found.rejection_db * np.log(10.0) / 20.0, rel=1e-9)


def test_a_gain_and_pi_are_where_a_grid_finds_them():
    plant, asked = frf(DELAYED, 300), required(GAIN, PI, **NEAR, objective=LOW)
    found, best = tune([plant], asked), -np.inf
    p = problem_of([plant], asked)
    for gain in np.geomspace(5.0, 30.0, 40):
        for corner in np.geomspace(0.05, 5.0, 40):
            m = measure(p, np.log([gain, corner]), {})
            if m.worst >= 0.0 and m.stable:
                best = max(best, float(m.rejection.min()))
    assert found.objective >= best - 1e-3
    assert found.objective <= best + 0.05


@pytest.mark.long
def test_each_objective_is_the_best_at_its_own_and_a_weighted_one_between():
    blocks, plants = (GAIN, LEAD, PI, NOTCH, LOW_PASS), servos(lines=200)
    limits = NEAR | {"control_peak_db": 10.0}
    kinds = ("bandwidth", LOW | {"bandwidth": 0.7}, LOW)
    made = [
        tune(plants, required(*blocks, **limits, objective=kind), search=Search(starts=8, draws=30)) for kind in kinds
    ]
    assert all(one.feasible for one in made)
    hz = [one.bandwidth_hz for one in made]
    down = [min(mean_rejection_db(plant, one.controller, 3.0) for plant in plants) for one in made]
    assert hz[0] > 1.02 * hz[2]
    assert down[2] > down[0] + 0.2
    assert hz[0] * 1.001 >= hz[1] >= 0.999 * hz[2]
    assert down[0] - 0.01 <= down[1] <= down[2] + 0.01


def test_the_worst_operating_point_counts():
    plants = servos()
    found = tune(plants, required(GAIN, LEAD, LOW_PASS, **NEAR, objective=LOW))
    each = [mean_rejection_db(plant, found.controller, 3.0) for plant in plants]
    assert found.rejection_db == pytest.approx(min(each), rel=1e-9)
    assert found.objective == pytest.approx(min(each) * np.log(10.0) / 20.0, rel=1e-9)
    named = {b.recording for b in found.binding if b.quantity == "disturbance"}
    assert named == {plants[int(np.argmin(each))].recording}


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ({}, ls.Objective()),
        ({"objective": "bandwidth"}, ls.Objective(1.0, 0.0)),
        ({"objective": "disturbance", "disturbance_below_hz": 0.3}, ls.Objective(0.0, 1.0, 0.3)),
        ({"objective": {"disturbance": 2.0, "disturbance_below_hz": 0.3}}, ls.Objective(0.0, 2.0, 0.3)),
        (
            {"objective": {"bandwidth": 1.0, "disturbance": 0.5, "disturbance_below_hz": 0.3}},
            ls.Objective(1.0, 0.5, 0.3),
        ),
    ],
)
def test_objectives_as_files_write_them(given, meant):
    assert ls.Requirements.from_table({"name": "one"} | given).objective == meant


def test_an_objective_does_not_change_a_check():
    controller = ls.Controller("one", (Block("gain", {"gain": 10.0}),), RATE)
    lines = [
        ls.check([frf(DELAYED)], controller, required(GAIN, **NEAR, objective=kind)).lines
        for kind in ("bandwidth", LOW)
    ]
    assert lines[0] == lines[1]
