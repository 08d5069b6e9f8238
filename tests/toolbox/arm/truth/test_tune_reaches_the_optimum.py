"""Tuning: known optimum in, known optimum out; all limits hold as `check` reads them; slopes are exact."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block, TransferFunction
from source_controllers import angle_controller

from loopshape.design.problem.measures import measure
from loopshape.design.problem.problem import problem
from loopshape.design.search import LARGEST, initial_point, search
from loopshape.design.tighten import tighten_limits
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import verdict_on

sys.path.insert(0, str(Path(__file__).parents[3] / "speed"))
from tune_workload import frfs as arm_frfs
from tune_workload import requirements as arm_requirements

import loopshape as ls


def plant(model: TransferFunction, lines: int = 400, name: str = "one", high_hz: float = 100.0) -> ls.FRF:
    f = np.geomspace(0.05, high_hz, lines)
    G = model.response(f)
    return ls.FRF(
        frequency_hz=f,
        response=G[:, None, None],
        covariance=np.full((lines, 1, 1), 1e-20 + 0j),
        valid=np.ones(lines, dtype=bool),
        inputs=("z_v",),
        outputs=("y_rad",),
        method="known",
        recording=name,
        loop="one",
        rate_hz=10_000.0,
    )


def required(**limits: object) -> ls.Requirements:
    table = {
        "name": "one",
        "integrators": 1,
        "unstable_poles": 0,
        "structure": [{"kind": "gain", "gain": {"min": 0.01, "max": 1000.0}}],
    }
    return ls.Requirements.from_table(table | limits)


def test_a_gain_for_an_integrator_with_delay_has_its_textbook_value() -> None:
    # k exp(-s d)/s: the phase at crossover w is -90 deg - w d, so 45 deg of margin allow w = (pi/4)/d
    delay = 0.02
    found = ls.tune([plant(TransferFunction([2.0], [1.0, 0.0], delay), 2000)], required(phase_margin_deg=45.0))
    crossover = 0.25 * np.pi / delay
    assert found.feasible
    assert found.bandwidth_hz == pytest.approx(crossover / (2.0 * np.pi), rel=1e-3)
    assert found.controller.blocks[0].parameters["gain"] == pytest.approx(crossover / 2.0, rel=1e-3)
    assert {b.quantity for b in found.binding} == {"bandwidth_hz", "phase_margin_deg"}


def test_the_gain_margin_binds_where_it_should() -> None:
    # k/(s (s/w + 1)^2): gain margin 2 w/k, so 6.0206 dB ask for k = w
    w = 2.0 * np.pi * 5.0
    model = TransferFunction([1.0], np.polymul([1.0, 0.0], np.polymul([1 / w, 1.0], [1 / w, 1.0])))
    found = ls.tune([plant(model, 3000)], required(gain_margin_db=6.020599913))
    assert found.controller.blocks[0].parameters["gain"] == pytest.approx(w, rel=1e-3)


def test_the_worst_of_several_plants_decides() -> None:
    delays = (0.01, 0.02, 0.015)
    plants = [
        plant(TransferFunction([k], [1.0, 0.0], d), 1000, f"d{d}") for k, d in zip((1.0, 2.0, 1.0), delays, strict=True)
    ]
    found = ls.tune(plants, required(phase_margin_deg=60.0))
    # phase margin 60 deg at w d = pi/6; gains 1, 2, 1: the second one binds with the smallest gain
    gain = np.pi / 6.0 / 0.02 / 2.0
    assert found.controller.blocks[0].parameters["gain"] == pytest.approx(gain, rel=1e-3)
    assert {b.recording for b in found.binding if b.quantity == "phase_margin_deg"} == {"d0.02"}


def test_slopes_of_bandwidths_and_rooms_are_exact() -> None:
    plants, limits = arm_frfs(200), arm_requirements()
    unit = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), 1000.0)
    loops, _ = loops_of(plants, unit, limits)
    p = problem(loops, limits, 1000.0)
    x = np.log([11.0, 2.2, 18.0, 4.5, 0.05, 5.0, 19.0, 0.55])
    here = measure(p, x, {})
    assert len(here.room) > 30
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = 1e-6
        ahead, behind = measure(p, x + step, {}), measure(p, x - step, {})
        assert ahead.what == behind.what == here.what
        np.testing.assert_array_equal(ahead.at, here.at)
        numeric = (ahead.ln_bandwidth - behind.ln_bandwidth) / 2e-6
        np.testing.assert_allclose(here.bandwidth_slopes[:, k], numeric, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(here.room_slopes[:, k], (ahead.room - behind.room) / 2e-6, rtol=1e-4, atol=1e-5)


@pytest.fixture(scope="module")
def tuned():
    plants, limits = arm_frfs(200), arm_requirements()
    return plants, limits, ls.tune(plants, limits, seed=0)


def test_every_limit_holds_at_all_24_equilibria(tuned) -> None:
    plants, limits, found = tuned
    verdict = ls.check(plants, found.controller, limits)
    assert verdict.passed
    assert found.feasible
    assert len(verdict.margins) == 24
    assert all(m.stable == "stable" for m in verdict.margins.values())


def test_what_binds_has_no_room_left(tuned) -> None:
    _, _, found = tuned
    slack = {line.quantity: line.slack for line in found.verdict.lines}
    named = {b.quantity for b in found.binding}
    assert "bandwidth_hz" in named
    for quantity in named - {"bandwidth_hz"}:
        assert slack[quantity] < 0.05
    assert named & {"sensitivity_peak_db", "phase_margin_deg", "control_peak_db", "gain_margin_db"}


@pytest.mark.long
def test_same_seed_same_controller_to_the_last_bit(tuned) -> None:
    plants, limits, found = tuned
    again = ls.tune(plants, limits, seed=0)
    assert [b.parameters for b in again.controller.blocks] == [b.parameters for b in found.controller.blocks]


@pytest.mark.long
def test_another_seed_comes_within_two_percent(tuned) -> None:
    plants, limits, found = tuned
    other = ls.tune(plants, limits, seed=5)
    assert other.bandwidth_hz == pytest.approx(found.bandwidth_hz, rel=0.02)


def test_no_small_change_of_the_result_is_better(tuned) -> None:
    """A local optimum by definition: random nearby controllers either break a limit or are slower."""
    plants, limits, found = tuned
    unit = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), 1000.0)
    p = problem(loops_of(plants, unit, limits)[0], limits, 1000.0)
    x = np.log([found.controller.blocks[v.block].parameters[v.name] for v in p.variables])
    best = measure(p, x, {}).ln_bandwidth.min()
    rng = np.random.default_rng(0)
    for _ in range(300):
        trial = np.clip(x + 0.02 * rng.standard_normal(x.size), p.low, p.high)
        m = measure(p, trial, {})
        if m.stable and m.worst >= 0.0:
            assert m.ln_bandwidth.min() <= best + 1e-3


@pytest.mark.long
def test_tuned_beats_the_source_by_more_than_the_bar(tuned) -> None:
    """At least 1.3 times the lowest bandwidth of the source's controller, with at most twice its peak |CS|."""
    plants, _, _ = tuned
    bare = ls.Requirements(
        "theta2", sensitivity_peak_db=6.0, phase_margin_deg=45.0, gain_margin_db=5.0, integrators=1, unstable_poles=0
    )

    def source(gain: float) -> ls.Controller:
        return angle_controller(gain, notch_hz=4.5)

    low, high = 0.5, 55.0
    for _ in range(25):
        gain = float(np.sqrt(low * high))
        low, high = (gain, high) if ls.check(plants, source(gain), bare).passed else (low, gain)
    verdict = ls.check(plants, source(low), bare)
    assert verdict.passed
    slowest = min(m.bandwidth_hz for m in verdict.margins.values())
    peak = max(m.control_peak_db for m in verdict.margins.values())
    found = ls.tune(plants, arm_requirements(peak + 6.02))
    assert found.feasible
    assert max(m.control_peak_db for m in found.verdict.margins.values()) <= peak + 6.03
    assert found.bandwidth_hz >= 1.3 * slowest


def test_limits_that_cannot_hold_say_what_they_miss() -> None:
    found = ls.tune(
        [plant(TransferFunction([2.0], [1.0, 0.0], 0.02))], required(phase_margin_deg=45.0, bandwidth_hz=20.0)
    )
    assert not found.feasible
    assert not found.verdict.passed
    assert {line.quantity for line in found.verdict.lines if not line.passed}
    assert {b.quantity for b in found.binding} >= {"bandwidth_hz"}


def test_tied_and_fixed_parameters_stay_so(tuned) -> None:
    _, _, found = tuned
    notch = next(b for b in found.controller.blocks if b.kind == "notch")
    assert notch.parameters["f1_hz"] == notch.parameters["f2_hz"]
    fixed = required(
        phase_margin_deg=45.0,
        structure=[
            {"kind": "gain", "gain": {"min": 0.01, "max": 1000.0}},
            {"kind": "low_pass", "order": 1, "f_hz": 30.0},
        ],
    )
    block = ls.tune([plant(TransferFunction([2.0], [1.0, 0.0], 0.02))], fixed).controller.blocks[1]
    assert block.parameters["f_hz"] == 30.0


def test_an_integral_controller_is_tuned_stably() -> None:
    model = TransferFunction([3.0], [0.1, 1.0], 0.01)
    limits = ls.Requirements.from_table(
        {
            "name": "one",
            "integrators": 0,
            "unstable_poles": 0,
            "sensitivity_peak_db": 4.0,
            "phase_margin_deg": 50.0,
            "structure": [
                {"kind": "gain", "gain": {"min": 0.01, "max": 100.0}},
                {"kind": "pi", "f_hz": {"min": 0.5, "max": 20.0}},
            ],
        }
    )
    found = ls.tune([plant(model, 800)], limits)
    assert found.feasible
    assert all(m.stable == "stable" for m in found.verdict.margins.values())
    assert found.bandwidth_hz > 3.0


@pytest.mark.parametrize(("size", "holds"), [(1.0005, False), (1.01, True)])
def test_l_that_only_touches_one_at_the_first_frequency_does_not_do(size: float, holds: bool) -> None:
    # a little less, as a search may leave it, and `check` has no crossover to count from
    limits = required(integrators=0, phase_margin_deg=45.0)
    frf = plant(TransferFunction([1.0], np.polymul([0.1, 1.0], [0.2, 1.0])))
    p = problem(
        loops_of([frf], ls.Controller("one", (Block("gain", {"gain": 1.0}),), 10_000.0), limits)[0], limits, 1e4
    )
    assert (measure(p, np.log([size / abs(frf.siso[0])]), {}).worst >= 0.0) is holds


def test_of_many_points_those_that_do_not_bind_are_read_twice_at_most() -> None:
    plants, limits = arm_frfs(100), arm_requirements()
    unit = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), 1000.0)
    loops, _ = loops_of(plants, unit, limits)
    p = problem(loops, limits, 1000.0)
    read = np.zeros(24, dtype=int)

    def judge(controller: ls.Controller, points: Sequence[int] | None = None) -> ls.Verdict:
        chosen = list(range(24) if points is None else points)
        read[chosen] += 1
        named = {plants[k].recording: replace(loops[k], controllers=controller) for k in chosen}
        return verdict_on(named, limits, detuned=False)[0]

    begun = initial_point(p, np.log([11.0, 2.2, 18.0, 4.5, 0.05, 5.0, 19.0, 0.55]))
    found = tighten_limits(p, search(p, begun, LARGEST, 300), judge)
    assert found.verdict.passed
    assert len(found.verdict.margins) == 24
    assert read.min() <= 2
    assert read.max() > read.min()


def test_a_limit_that_binds_beyond_the_last_frequency_alone_is_settled() -> None:
    # L is tuned to where |CS| above the last line is allowed: no limit binds on the lines
    noisy = plant(TransferFunction([2.0], [1.0, 0.0], 0.002), 300)
    noisy = replace(noisy, covariance=(0.02 * np.abs(noisy.response[:, :, 0:1])).astype(complex) ** 2)
    structure = [
        {"kind": "gain", "gain": {"min": 0.01, "max": 1000.0}},
        {"kind": "lead_lag", "f1_hz": 20.0, "f2_hz": {"min": 200.0, "max": 4000.0}},
    ]
    found = ls.tune([noisy], required(phase_margin_deg=30.0, control_peak_db=20.0, structure=structure))
    assert found.verdict.passed
    assert {b.quantity for b in found.binding} == {"bandwidth_hz", "control_peak_db"}
    peak = next(iter(found.verdict.margins.values()))
    assert peak.at_hz["control_peak_db"] > 100.0
    assert peak.control_peak_db == pytest.approx(20.0, abs=0.05)
