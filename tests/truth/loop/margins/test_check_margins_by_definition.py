"""Margins by their definition: change the loop by the margin and it touches -1; by less, and it does not."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, Loop, TransferFunction
from conversions import TWO_PI, from_db, rad

import loopshape as ls
from loopshape.loop.margin.margins import Reader, margins

RATE = 1000.0
F = np.geomspace(0.02, 400.0, 6000)


def pair(f_hz, damping):
    w = TWO_PI * f_hz
    return np.array([1.0 / w**2, 2.0 * damping / w, 1.0])


def real(f_hz):
    return np.array([1.0 / (TWO_PI * f_hz), 1.0])


def product(*polynomials):
    out = np.ones(1)
    for polynomial in polynomials:
        out = np.polymul(out, polynomial)
    return out


INTEGRATOR = np.array([1.0, 0.0])
LEAD = (Block("gain", {"gain": 1.0}), Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 30.0}))
GAIN = (Block("gain", {"gain": 1.0}),)
PI_LEAD = (Block("pi", {"f_hz": 0.2}), *LEAD)
#: plant, controller's blocks, integrators, unstable poles; all stable in closed loop
LOOPS = {
    "integrator with a resonance": (
        TransferFunction([20.0], product(INTEGRATOR, pair(20.0, 0.1))), GAIN, 1, 0),
    "the same with a delay": (
        TransferFunction([20.0], product(INTEGRATOR, pair(20.0, 0.1)), 0.004), GAIN, 1, 0),
    "a resonance that a delay turns away from -1": (
        TransferFunction([20.0], product(INTEGRATOR, pair(20.0, 0.02)), 0.02), GAIN, 1, 0),
    "double integrator with a lead": (TransferFunction([30.0], [1.0, 0.0, 0.0], 0.002), LEAD, 2, 0),
    "conditionally stable, three integrators": (
        TransferFunction(
            100.0 * product(real(0.4), real(0.4)), product(INTEGRATOR, INTEGRATOR, INTEGRATOR, real(30.0))),
        GAIN, 3, 0),
    "unstable pole": (TransferFunction([4.0], product([1.0 / TWO_PI, -1.0], real(15.0))), GAIN, 0, 1),
    "no integrator": (TransferFunction([6.0], product(real(0.5), real(3.0), real(20.0))), GAIN, 0, 0),
    "several crossings": (
        TransferFunction(12.0 * pair(5.0, 0.05), product(INTEGRATOR, pair(7.0, 0.02), real(60.0))), GAIN, 1, 0),
    "an integrator in the controller": (TransferFunction([30.0], [1.0, 0.0, 0.0], 0.002), PI_LEAD, 2, 0),
    "biproper until far above": (TransferFunction(0.4 * real(10.0), product(INTEGRATOR, real(200.0)) / 30), GAIN, 1, 0),
}  # fmt: skip


def loop_of(name):
    plant, blocks, integrators, unstable = LOOPS[name]
    G, known = plant.response(F)[:, None, None], np.ones(F.size, dtype=bool)
    frf = ls.FRF(F, G, 1e-20 * np.abs(G) ** 2 + 0j, known, ("z_v",), ("y_rad",), "exact", rate_hz=RATE)
    return Loop(frf, ls.Controller("axis", blocks, RATE), integrators, unstable)


@pytest.fixture(params=LOOPS)
def case(request):
    """A loop, its margins, and L (nf,) at any frequencies."""
    loop = loop_of(request.param)
    plant = LOOPS[request.param][0]
    return loop, margins(loop), lambda f: loop.controller.response(f) * plant.response(f)


SHARES = (0.0, 0.25, 0.5, 0.75, 0.9, 0.97)


def distance(open_loop, change, near_hz=None):
    """Least |1 + L| after a change, over the lines, or at one frequency."""
    f = F if near_hz is None else np.array([near_hz])
    return float(np.min(np.abs(1.0 + change(f, open_loop(f)))))


def assert_margin(open_loop, change, near_hz):
    """At the whole margin the loop touches -1 where the margins say; at any part of it nowhere."""
    # crossings are interpolated over 0.17 % of frequency: a touch is missed by less than 1e-4
    assert distance(open_loop, change(1.0), near_hz) < 2e-4
    for share in SHARES:
        assert distance(open_loop, change(share)) > 1e-3


def test_every_loop_here_is_stable(case):
    assert case[1].stable == "stable", case[1].stability_reason


def test_gain_margin(case):
    loop, found, open_loop = case
    f = found.at_hz["gain_margin_db"]
    if f == F[-1]:  # no crossing seen: the margin is bounded by the last line, and |L| just reaches 1 there
        assert from_db(found.gain_margin_db) * np.abs(loop.L[-1]) == pytest.approx(1.0, rel=1e-9)
        return
    assert_margin(open_loop, lambda share: lambda _, L: L * from_db(share * found.gain_margin_db), f)


def test_gain_reduction_margin(case):
    _, found, open_loop = case
    if not np.isfinite(found.gain_reduction_margin_db):
        for share in np.linspace(0.001, 1.0, 50):
            assert distance(open_loop, lambda _, L, share=share: share * L) > 1e-3
        return
    f = found.at_hz["gain_reduction_margin_db"]
    if f == F[0] and found.bounds:  # as large as |L| at the first line at least: no crossing is seen
        for share in np.linspace(0.001, 1.0, 50):
            assert (
                distance(open_loop, lambda _, L, share=share: L / from_db(share * found.gain_reduction_margin_db))
                > 1e-3
            )
        return
    assert_margin(open_loop, lambda share: lambda _, L: L / from_db(share * found.gain_reduction_margin_db), f)


def test_which_loops_have_a_reduction_margin():
    found = {name: margins(loop_of(name)) for name in LOOPS}
    have = {
        name
        for name, m in found.items()
        if np.isfinite(m.gain_reduction_margin_db) and "gain_reduction_margin_db" not in m.bounds
    }
    assert {"conditionally stable, three integrators", "an integrator in the controller"} <= have
    assert not {"integrator with a resonance", "double integrator with a lead", "no integrator"} & have


def test_phase_margin(case):
    _, found, open_loop = case
    touched = []
    for sign in (-1.0, 1.0):
        turn = np.exp(sign * 1j * rad(found.phase_margin_deg))
        touched.append(distance(open_loop, lambda _, L, turn=turn: L * turn, found.at_hz["phase_margin_deg"]))
        for share in SHARES:
            less = turn**share
            assert distance(open_loop, lambda _, L, less=less: L * less) > 1e-3
    assert min(touched) < 2e-4


def test_delay_margin(case):
    _, found, open_loop = case
    assert_margin(
        open_loop,
        lambda share: lambda f, L: L * np.exp(-1j * TWO_PI * f * share * found.delay_margin_s),
        found.at_hz["delay_margin_s"],
    )


def test_modulus_margin_is_the_distance_from_minus_one(case):
    loop, found, open_loop = case
    at, nearest = found.at_hz["modulus_margin"], np.abs(1.0 + loop.L).min()
    beyond = 1.0 - np.abs(loop.L[-1])  # as near as L may come above the last line
    if beyond < nearest:
        assert found.modulus_margin == pytest.approx(beyond, rel=1e-12)
        assert at == F[-1]
        return
    assert found.modulus_margin == pytest.approx(distance(open_loop, lambda _, L: L, at), rel=1e-3)
    assert found.modulus_margin <= nearest * (1.0 + 1e-12)
    assert found.modulus_margin == pytest.approx(nearest, rel=1e-2)


def test_where_the_modulus_margin_is_bounded_above_the_last_line():
    bounded = {name for name in LOOPS if margins(loop_of(name)).at_hz["modulus_margin"] == F[-1]}
    assert bounded == {"biproper until far above"}


def test_peaks_are_those_of_the_responses(case):
    loop, found, _ = case
    last = np.abs(loop.L[-1])
    S, T = (np.append(np.abs(x), above / (1.0 - last)) for x, above in ((loop.S, 1.0), (loop.T, last)))
    assert found.sensitivity_peak_db == pytest.approx(-20.0 * np.log10(found.modulus_margin), rel=1e-12)
    assert from_db(found.sensitivity_peak_db) == pytest.approx(S.max(), rel=1e-2)
    if loop.unstable_poles:  # |T| is largest at 0 Hz, below the lines: L is -4 there
        assert from_db(found.complementary_peak_db) == pytest.approx(4.0 / 3.0, rel=1e-4)
        assert found.at_hz["complementary_peak_db"] == 0.0
    else:
        assert from_db(found.complementary_peak_db) == pytest.approx(T.max(), rel=1e-9)
        assert found.at_hz["complementary_peak_db"] == np.append(F, F[-1])[np.argmax(T)]
    CS = np.abs(loop.CS).max(), np.abs(loop.controller.response(loop.above_hz)).max() / (1.0 - last)
    assert from_db(found.control_peak_db) == pytest.approx(max(CS), rel=1e-9)


def test_a_loop_seen_to_a_lower_last_line_never_looks_better(case):
    # above the line where |L| has come below a half for good, it stays below what it is there: the bounds hold
    loop, whole, _ = case
    size = np.abs(loop.L)
    highest_above = np.maximum.accumulate(size[::-1])[::-1]
    k = int(np.flatnonzero((size == highest_above) & (size < 0.5))[0])
    cut = margins(replace(loop, plant=loop.plant.select(np.arange(k + 1))))
    assert cut.stable == "stable"
    assert cut.modulus_margin <= whole.modulus_margin * (1.0 + 1e-12)
    for name in ("gain_margin_db", "gain_reduction_margin_db", "phase_margin_deg", "delay_margin_s"):
        assert getattr(cut, name) <= getattr(whole, name) + 1e-9
    for name in ("sensitivity_peak_db", "complementary_peak_db", "control_peak_db"):
        assert getattr(cut, name) >= getattr(whole, name) - 1e-3  # above the line |CS| is looked at on a coarser grid


def test_without_a_last_line_below_1_there_is_no_room():
    loop = loop_of("integrator with a resonance")
    cut = margins(Loop(loop.plant.between(0.02, 2.0), loop.controller, 1, unstable_poles=0))
    assert cut.stable == "undecided"
    assert cut.crossings_hz == ()
    assert (cut.phase_margin_deg, cut.delay_margin_s, cut.gain_margin_db, cut.modulus_margin) == (0.0, 0.0, 0.0, 0.0)
    assert cut.sensitivity_peak_db == np.inf


def test_bandwidth_is_the_first_crossing_and_crossings_have_gain_one(case):
    _, found, open_loop = case
    assert found.bandwidth_hz == pytest.approx(found.crossings_hz[0], rel=1e-12)
    np.testing.assert_allclose(np.abs(open_loop(np.array(found.crossings_hz))), 1.0, atol=2e-4)
    at_axis = open_loop(np.array(found.phase_crossings_hz))
    np.testing.assert_allclose(at_axis.imag / np.abs(at_axis), 0.0, atol=1e-3)
    assert np.all(at_axis.real < 0.0)


def test_three_crossings_are_seen_and_the_worst_phase_counts():
    found = margins(loop_of("several crossings"))
    assert len(found.crossings_hz) == 3
    worst = found.at_hz["phase_margin_deg"]
    assert worst in found.crossings_hz
    assert worst > found.bandwidth_hz


def test_control_peaks_count_the_controller_above_the_last_line():
    loop = loop_of("double integrator with a lead")
    low = Loop(loop.plant.between(0.02, 40.0), loop.controller, 2, unstable_poles=0)
    found = margins(low, Reader(200.0))
    # above 40 Hz |L| stays below l = 0.011, so |CS| below |C|/(1 - l); |C| climbs to 30 at half the rate, and
    # margins look up to 0.45 of the rate
    top = np.abs(loop.controller.response([450.0]))[0] / (1.0 - np.abs(low.L[-1]))
    assert from_db(found.control_high_frequency_db) == pytest.approx(top, rel=1e-9)
    assert found.at_hz["control_high_frequency_db"] == pytest.approx(450.0)
    assert from_db(found.control_peak_db) >= top * (1.0 - 1e-9)
    assert margins(low).control_high_frequency_db == -np.inf


def seen_from(f_low_hz):
    """Margins of an integrator with a resonance, crossover 3.2 Hz, from lines above `f_low_hz`."""
    loop = loop_of("integrator with a resonance")
    return margins(Loop(loop.plant.between(f_low_hz, 400.0), loop.controller, 1, 0))


def test_small_models_lead_to_a_crossover_a_third_of_an_octave_below_the_lines_at_most():
    whole = margins(loop_of("integrator with a resonance"))
    near = seen_from(1.2 * whole.bandwidth_hz)
    assert near.stable == "stable"
    assert near.bandwidth_hz == pytest.approx(whole.bandwidth_hz, rel=3e-3)
    assert near.phase_margin_deg == pytest.approx(whole.phase_margin_deg, abs=0.1)
    assert near.gain_margin_db == pytest.approx(whole.gain_margin_db, abs=1e-2)
    far = seen_from(1.5 * whole.bandwidth_hz)
    assert far.stable == "undecided"
    assert "the crossover lies lower" in far.stability_reason
    assert (far.bandwidth_hz, np.isnan(far.phase_margin_deg)) == (0.0, True)


def test_a_loop_below_1_everywhere_needs_no_crossover():
    loop = loop_of("no integrator")
    quiet = ls.Controller("axis", (Block("gain", {"gain": 0.1}),), RATE)
    found = margins(Loop(loop.plant, quiet, 0, 0, LOOPS["no integrator"][0]))
    assert found.stable == "stable"
    assert (found.bandwidth_hz, found.crossings_hz, found.phase_margin_deg) == (0.0, (), np.inf)


def test_gain_margin_never_exceeds_what_the_last_line_bounds():
    loop = loop_of("integrator with a resonance")
    cut = Loop(
        loop.plant.between(0.02, 12.0), loop.controller, 1, unstable_poles=0
    )  # the axis is crossed at 20 Hz, unseen
    found = margins(cut)
    assert found.phase_crossings_hz == ()
    assert from_db(found.gain_margin_db) == pytest.approx(1.0 / np.abs(cut.L[-1]), rel=1e-12)
    assert found.at_hz["gain_margin_db"] == cut.frequency_hz[-1]
