"""From noisy FRFs: what comes out passes the check with its 95 % intervals, and gives no more away than they ask."""

import numpy as np
import pytest
from tune_plants import DELAYED, GAIN, LEAD, LOW_PASS, NOTCH, PI, frf, problem_of, required, servos

import loopshape as ls
from loopshape.design.problem.measures import measure
from loopshape.design.search import Goal, initial_point, search
from loopshape.design.tighten import allowances, tighten_limits

LIMITS = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 35.0, "gain_margin_db": 6.0, "control_peak_db": 10.0}
BLOCKS = (GAIN, LEAD, PI, NOTCH, LOW_PASS)


@pytest.mark.long
@pytest.mark.parametrize("std", [0.02, 0.05])
def test_it_passes_with_intervals_and_what_binds_has_no_room(std):
    plants, asked = servos(std), required(*BLOCKS, **LIMITS)
    found = ls.tune(plants, asked)
    verdict = ls.check(plants, found.controller, asked)
    assert verdict.outcome == found.outcome == "passed"
    assert all(line.interval is not None and line.interval[0] < line.interval[1] for line in verdict.lines)
    slack = {line.quantity: line.slack for line in verdict.lines}
    bound = {b.quantity for b in found.binding} - {"bandwidth_hz", "stability"}
    assert bound
    assert all(0.0 <= slack[name] < 0.06 for name in bound)


def test_confidence_costs_and_more_data_give_it_back():
    # a gain alone: no other optimum to fall into, and the same noise three times over, ever smaller
    stds, asked = (0.1, 0.03, 0.003), required(GAIN, phase_margin_deg=45.0)
    hz = [ls.tune([frf(DELAYED, 400, std=std)], asked).bandwidth_hz for std in stds]
    assert hz[0] < hz[1] < hz[2] < 6.25
    assert hz[2] == pytest.approx(6.25, rel=5e-3)
    assert hz[0] > 0.8 * 6.25


def test_an_allowance_is_the_gap_to_the_bad_end():
    # one limit, one plant, a gain: what the tuner reads less the allowance is what the verdict counts
    plant, asked = frf(DELAYED, 400, std=0.05), required(GAIN, phase_margin_deg=45.0)
    p, x = problem_of([plant], asked), np.log([12.0])
    verdict = ls.check([plant], p.controller(x), asked)
    read = np.degrees(measure(p, x, {}).room.min())
    assert read - allowances(p, x, verdict)["phase_margin_deg"][0] == pytest.approx(verdict.lines[0].slack, abs=1e-9)


def test_settling_ends_where_it_passes_whatever_it_starts_from():
    plants, asked = servos(0.05), required(*BLOCKS, **LIMITS)
    p = problem_of(plants, asked)
    best = ls.tune(plants, asked).controller

    def judge(controller, points=None):
        return ls.check(plants if points is None else [plants[k] for k in points], controller, asked)

    x = np.log([best.blocks[v.block].parameters[v.name] for v in p.variables])
    for push in (-0.05, 0.05):
        moved = x.copy()
        moved[0] += push  # the gain: once too low, once beyond the limits
        found = search(p, initial_point(p, moved, Goal(), 0.1), Goal(), 60)
        settled = tighten_limits(p, found, judge)
        assert settled.verdict.passed
