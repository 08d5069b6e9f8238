"""A plant's unstable poles are counted from the loop under which it was recorded, which stood."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup, RecordingInfo, TransferFunction
from conversions import TWO_PI

import loopshape as ls
from loopshape.identify.matrix.equivalent_plant import equivalent_plant
from loopshape.identify.quality.quality import stayed_bounded
from loopshape.loop.loops import loops_of

RATE = 20_000.0
W = TWO_PI * 10.0
NUM, DEN = np.array([W * W]), np.polymul([1.0, 0.0], [1.0, -0.1 * W, W * W])  # 1/s times a growing mode at 10 Hz
LEAD = {"f1_hz": 8.0, "f2_hz": 100.0}
HOLDING = ls.Controller("l", (Block("gain", {"gain": 80.0}), Block("lead_lag", LEAD), Block("lead_lag", LEAD)), RATE)
WEAK = ls.Controller("l", (Block("gain", {"gain": 3.0}),), RATE)
WISH = ls.Requirements("l", phase_margin_deg=20.0)


def recorded(recorded_under, std=1e-4, last_hz=400.0):
    f = np.geomspace(0.3, last_hz, 1500)
    G = TransferFunction(NUM, DEN).response(f)[:, None, None]
    return ls.FRF(
        f, G, (std * np.abs(G)) ** 2 + 0j, np.ones(f.size, dtype=bool), ("z_v",), ("y_m",), "made up",
        recording="r", loop="l", rate_hz=RATE, recorded_under=recorded_under,
    )  # fmt: skip


def closed_loop_poles(controller):
    num, den = NUM, DEN
    for block in controller.blocks:
        b, a = block.section()
        num, den = np.polymul(num, np.trim_zeros(b[::-1], "f")), np.polymul(den, np.trim_zeros(a[::-1], "f"))
    return np.roots(np.polyadd(num, den))


def test_the_case_is_what_it_says():
    assert np.all(closed_loop_poles(HOLDING).real < 0.0)
    assert np.sum(closed_loop_poles(WEAK).real > 0.0) == 2


def test_both_poles_are_counted_and_the_weak_controller_fails():
    (loop,), notes = loops_of([recorded(HOLDING)], WEAK, WISH)
    assert loop.unstable_poles == 2
    assert "2 unstable poles, because the loop that was recorded was stable" in notes[0]
    verdict = ls.check([recorded(HOLDING)], WEAK, WISH)
    assert verdict.margins["r"].stable == "unstable"
    assert not verdict.passed


def test_the_holding_controller_itself_is_stable():
    assert ls.check([recorded(HOLDING)], HOLDING, WISH).margins["r"].stable == "stable"


@pytest.mark.parametrize("std", [1e-4, 0.03])
def test_a_single_unstable_pole_is_counted_too(std):
    # w^2/(s^2 - w^2) under gain 2.2 with a lead stands; under a gain of 0.5 it has one unstable pole
    w = TWO_PI * 8.0
    G = TransferFunction([w * w], [1.0, 0.0, -w * w]).response(np.geomspace(0.5, 300.0, 600))[:, None, None]
    own = ls.Controller("l", (Block("gain", {"gain": 2.2}), Block("lead_lag", {"f1_hz": 8.0, "f2_hz": 150.0})), RATE)
    rng = np.random.default_rng(2)
    error = std * np.abs(G) * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)) / np.sqrt(2.0)
    f, covariance = np.geomspace(0.5, 300.0, 600), (std * np.abs(G)) ** 2 + 0j
    frf = replace(
        recorded(own), frequency_hz=f, response=G + error, covariance=covariance, valid=np.ones(f.size, dtype=bool)
    )
    (loop,), notes = loops_of([frf], WEAK, replace(WISH, integrators=0))
    assert loop.unstable_poles == 1
    assert "1 unstable pole, because the loop that was recorded was stable" in notes[0]
    weak = ls.Controller("l", (Block("gain", {"gain": 0.5}),), RATE)
    assert ls.check([frf], own, replace(WISH, integrators=0)).margins["r"].stable == "stable"
    assert ls.check([frf], weak, replace(WISH, integrators=0)).margins["r"].stable == "unstable"


def test_a_record_with_the_wrong_sign_contradicts_itself():
    # a stable plant whose recorded loop cannot have stood by this FRF: the gain is turned
    f = np.geomspace(0.3, 400.0, 1500)
    G = -TransferFunction([20.0], [0.02, 1.0, 0.0]).response(f)[:, None, None]
    frf = replace(recorded(WEAK), response=G, covariance=(1e-4 * np.abs(G)) ** 2 + 0j)
    verdict = ls.check([frf], WEAK, replace(WISH, integrators=1))
    assert verdict.margins["r"].stable != "stable"


@pytest.mark.parametrize("recorded_under", [None, WEAK])
def test_nothing_is_counted_where_the_lines_cannot_carry_it(recorded_under):
    # no controller known, or noise that covers -1: then nothing is made up, neither a pole nor that there is none
    frf = recorded(recorded_under, std=3.0) if recorded_under is not None else recorded(None)
    (loop,), _ = loops_of([frf], WEAK, replace(WISH, integrators=1))
    assert loop.unstable_poles is None
    assert ls.check([frf], WEAK, replace(WISH, integrators=1)).outcome == "undecided"


def test_a_resonance_above_the_trusted_band_is_not_overlooked():
    # L crosses 0 dB near 1 Hz, falls, and comes up to 3 at 35 Hz, where the lines are known to 10 % and not valid
    w = TWO_PI * 35.0
    G = TransferFunction([6.0 * w * w], [1.0, 0.02 * w, w * w, 0.0])
    f = np.geomspace(0.1, 60.0, 1500)
    response = G.response(f)[:, None, None]
    share = np.where(f < 15.0, 1e-3, 0.1)[:, None, None]
    frf = replace(
        recorded(None),
        frequency_hz=f,
        response=response,
        covariance=(share * np.abs(response)) ** 2 + 0j,
        valid=f < 15.0,
    )
    unit = ls.Controller("l", (Block("gain", {"gain": 1.0}),), RATE)
    margins = ls.check([frf], unit, replace(WISH, integrators=1, unstable_poles=0)).margins["r"]
    assert margins.stable == "undecided"
    assert "above the band that is known well" in margins.stability_reason


@pytest.mark.parametrize(("growth_per_s", "told"), [(0.0, True), (-0.3, True), (0.8, False)])
def test_a_record_in_open_loop_whose_output_grows_is_no_witness(growth_per_s, told):
    # y' = growth y + u from rest for 20 s; 0.8 makes it grow by 9 million
    rate, n = 100.0, 2000
    u, y = np.random.default_rng(4).standard_normal(n), np.zeros(n)
    for k in range(n - 1):
        y[k + 1] = np.exp(growth_per_s / rate) * y[k] + u[k] / rate
    info = RecordingInfo("r.parquet", "noise", "control", closed_loop=False, excites="x")
    loop = LoopSetup("x", None, None, "u_v", "y_m", None)
    assert stayed_bounded([ls.Recording(info, rate, {"u_v": u, "y_m": y})], [loop], ["y_m"]) is told


def test_with_other_loops_closed_a_plant_recorded_in_open_loop_may_be_unstable():
    f = np.geomspace(0.1, 50.0, 200)
    G = np.broadcast_to(np.array([[1.0, 0.5], [0.5, 1.0]]) + 0j, (f.size, 2, 2))
    frf = ls.FRF(
        f, G, np.zeros((f.size, 4, 4)) + 0j, np.ones(f.size, dtype=bool), ("a_v", "b_v"), ("a_m", "b_m"), "known",
        loop="a+b", rate_hz=RATE, open_loop=True,
    )  # fmt: skip
    own = {name: ls.Controller(name, (Block("gain", {"gain": 1.0}),), RATE) for name in "ab"}
    assert not equivalent_plant(frf, ("a", "b"), "a", own).open_loop
