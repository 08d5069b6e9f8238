"""Prewarping, delay, hold and rounded coefficients, each by a second route."""

from dataclasses import replace
from fractions import Fraction

import control
import numpy as np
import pytest
from exported_controllers import BLOCKS, PRECISIONS, RATE_HZ, cases
from scipy import signal

import loopshape as ls
from loopshape.core.kernels import biquads
from loopshape.data.algebra import with_hold
from loopshape.data.control.block import series_response
from loopshape.data.control.controller import Block, hold_and_delay

F = np.geomspace(1e-3, 49.9, 200)
SERIES = tuple(BLOCKS.values())
ROUNDED = {name: c for name, c in cases().items() if c.precision != "double"}


@pytest.mark.parametrize("prewarp_hz", [0.1, 5.0, 49.0])
@pytest.mark.parametrize("block", SERIES, ids=list(BLOCKS))
def test_prewarped_response_is_exact_where_it_is_asked_to_be(block, prewarp_hz):
    controller = ls.Controller("one", (block,), RATE_HZ, prewarp_hz=prewarp_hz)
    continuous = series_response([block], np.array([2j * np.pi * prewarp_hz]))
    np.testing.assert_allclose(controller.response([prewarp_hz]), continuous, rtol=1e-12)
    sos = np.insert(controller.biquads(), 3, 1.0, axis=1)
    by_scipy = signal.freqz_sos(sos, worN=[2.0 * np.pi * prewarp_hz / RATE_HZ])[1]
    np.testing.assert_allclose(by_scipy, continuous, rtol=1e-7)


@pytest.mark.parametrize("block", SERIES, ids=list(BLOCKS))
def test_prewarped_response_is_python_control_s(block):
    ours = ls.Controller("one", (block,), RATE_HZ, prewarp_hz=7.0)
    num, den = (np.trim_zeros(p[::-1], "f") for p in block.section())
    continuous = control.tf(num, den)
    w = 2.0 * np.pi * 7.0
    theirs = control.sample_system(continuous, 1.0 / RATE_HZ, method="tustin", prewarp_frequency=w)
    np.testing.assert_allclose(ours.response(F), theirs(np.exp(2j * np.pi * F / RATE_HZ)), rtol=1e-7)


def test_prewarping_far_below_the_rate_is_plain_tustin():
    plain = ls.Controller("one", SERIES, RATE_HZ)
    np.testing.assert_allclose(replace(plain, prewarp_hz=1e-4).response(F), plain.response(F), rtol=1e-9)


def test_a_delay_of_whole_samples_is_that_power_of_z():
    plain = ls.Controller("one", SERIES, RATE_HZ)
    late = replace(plain, computation_delay_s=3.0 / RATE_HZ)
    np.testing.assert_allclose(late.response(F), plain.response(F) * np.exp(-6j * np.pi * F / RATE_HZ), rtol=1e-12)


def test_the_hold_is_the_mean_of_a_held_sample():
    # z held over a period T is z's spectrum times the Fourier transform of a box over [0, T], over T
    plain, period = ls.Controller("one", SERIES, RATE_HZ), 1.0 / RATE_HZ
    s = 2j * np.pi * F
    np.testing.assert_allclose(
        replace(plain, added_hold=True).response(F), plain.response(F) * (1.0 - np.exp(-s * period)) / (s * period),
        rtol=1e-9,
    )  # fmt: skip


def test_a_delay_and_a_hold_in_the_controller_are_those_of_a_held_plant():
    one = np.ones((F.size, 1, 1), dtype=complex)
    plant = ls.FRF(F, one, 0.0 * one, np.ones(F.size, dtype=bool), ("u",), ("y",), "model")
    in_plant = with_hold(plant, RATE_HZ, 0.004).siso
    plain = ls.Controller("one", SERIES, RATE_HZ)
    in_controller = replace(plain, computation_delay_s=0.004, added_hold=True)
    np.testing.assert_allclose(in_controller.response(F), plain.response(F) * in_plant, rtol=1e-13)
    np.testing.assert_array_equal(hold_and_delay(F, RATE_HZ, 0.004), in_plant)


def exact_response(sections, halves):
    """Response of sections in exact fractions, at z = (1 + jt)/(1 - jt), where f = rate atan(t)/pi, for fractions t."""
    out = []
    for t in halves:
        re, im = (1 - t * t) / (1 + t * t), -2 * t / (1 + t * t)  # 1/z
        re2, im2 = re * re - im * im, 2 * re * im
        value = 1.0 + 0.0j
        for b0, b1, b2, a1, a2 in ([Fraction(v) for v in row] for row in sections.tolist()):
            value *= complex(b0 + b1 * re + b2 * re2, b1 * im + b2 * im2)
            value /= complex(1 + a1 * re + a2 * re2, a1 * im + a2 * im2)
        out.append(value)
    return np.array(out)


@pytest.mark.parametrize("name", ROUNDED)
def test_response_is_that_of_the_rounded_sections(name):
    controller = ROUNDED[name]
    form, sections = controller.number_format, controller.biquads()
    in_double = replace(controller, precision="double").biquads()
    if form.fixed:
        np.testing.assert_array_equal(sections * 2.0**form.fraction_bits % 1.0, 0.0)
        assert np.abs(sections - in_double).max() <= 0.5 * 2.0**-form.fraction_bits
    else:
        expected = in_double.astype(np.float32)
        beside = [block.integrators() == 1 and block.order() == 2 for block in controller.blocks]
        expected[beside, 4] = -1.0 - expected[beside, 3]  # an integrator stays at z = 1 to the last digit
        np.testing.assert_array_equal(sections, expected)
    halves = [Fraction(float(t)).limit_denominator(10**9) for t in np.geomspace(1e-5, 100.0, 20)]
    f = RATE_HZ * np.arctan([float(t) for t in halves]) / np.pi
    np.testing.assert_allclose(controller.response(f), exact_response(sections, halves), rtol=1e-11)


@pytest.mark.parametrize("kind", [*BLOCKS, "series"])
def test_response_of_the_sections_in_double_is_the_exact_one(kind):
    controller = ls.Controller("one", SERIES if kind == "series" else (BLOCKS[kind],), RATE_HZ)
    f = np.geomspace(0.1, 49.9, 200)
    found = biquads.response(controller.biquads(), 2.0 * np.pi * f / RATE_HZ)
    np.testing.assert_allclose(found, controller.response(f), rtol=1e-9)


def test_a_check_sees_what_rounding_moves():
    # two slow poles at 1.9 Hz and 1 kHz: 1 + a1 + a2 is 1.4e-4, of which half a step of 2^-14 is a fifth
    slow = ls.Controller("one", (Block("low_pass_2", {"f_hz": 1.9, "damping": 0.7}),), 1000.0)
    rounded = replace(slow, precision="q2.14")
    dc = abs(rounded.response([1e-3])[0])
    b0, b1, b2, a1, a2 = rounded.biquads()[0]
    assert dc == pytest.approx((b0 + b1 + b2) / (1.0 + a1 + a2), rel=1e-6)
    assert abs(dc - 1.0) > 0.2
    assert rounded.moved_by_rounding() > 0.2
    assert replace(slow, precision="q2.40").moved_by_rounding() < 1e-6


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_pole_of_a_pi_stays_at_one(precision):
    pi = ls.Controller("one", (BLOCKS["pi"],), RATE_HZ, precision=precision)
    assert pi.biquads()[0, 3:].tolist() == [-1.0, 0.0]
    assert pi.integrators() == 1


def test_every_setting_changes_the_digest_and_the_name_does_not():
    plain = ls.Controller("one", SERIES, RATE_HZ)
    others = [
        replace(plain, prewarp_hz=5.0), replace(plain, computation_delay_s=0.001), replace(plain, added_hold=True),
        replace(plain, precision="single"), replace(plain, precision="q5.27"), replace(plain, rate_hz=101.0),
        replace(plain, blocks=SERIES[:-1]),
    ]  # fmt: skip
    assert len({plain.digest, *(one.digest for one in others)}) == len(others) + 1
    assert replace(plain, loop="two").digest == plain.digest


def test_the_phase_budget_is_each_section_alone_and_what_follows_them():
    c = ls.Controller("one", SERIES, RATE_HZ, computation_delay_s=3e-3, added_hold=True)
    at_hz = 0.21 * RATE_HZ
    parts = c.phase_budget(at_hz)
    w = [2.0 * np.pi * at_hz / RATE_HZ]
    alone = [signal.freqz(row[:3], [1.0, *row[3:]], worN=w)[1][0] for row in c.biquads()]
    behind = np.sinc(0.21) * np.exp(-1j * np.pi * 0.21) * np.exp(-2j * np.pi * at_hz * 3e-3)
    assert [kind for kind, *_ in parts] == [block.kind for block in SERIES] + ["hold and delay"]
    for (_, degrees, decibels), one in zip(parts, [*alone, behind], strict=True):
        assert 10.0 ** (decibels / 20.0) * np.exp(1j * np.radians(degrees)) == pytest.approx(one, rel=1e-9)
    whole = np.exp(1j * np.radians(sum(degrees for _, degrees, _ in parts)))
    assert whole == pytest.approx(np.exp(1j * np.angle(c.response([at_hz])[0])), rel=1e-9)
