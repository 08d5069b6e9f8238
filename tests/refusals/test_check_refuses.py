"""What a check refuses, with its sentences."""

import numpy as np
import pytest
from bench_nouns import LIMITS, Block, Loop

import loopshape as ls
from loopshape.loop.verdict import check

WISHED = ls.Requirements("axis", phase_margin_deg=30.0, integrators=1, unstable_poles=0)


def frf_of(recording="r1", valid=True, rate_hz=1000.0, outputs=1, top_hz=100.0):
    f = np.geomspace(0.1, top_hz, 200)
    G = np.repeat((20.0 / (2j * np.pi * f))[:, None, None], outputs, axis=1)
    covariance = np.tile(1e-8 * np.eye(outputs, dtype=complex), (f.size, 1, 1))
    return ls.FRF(
        f, G, covariance, np.full(f.size, valid), ("z_v",), tuple(f"y{k}_rad" for k in range(outputs)), "made up",
        recording=recording, loop="axis", rate_hz=rate_hz,
    )  # fmt: skip


def under_gain(rate_hz=1000.0):
    return ls.Controller("axis", (Block("gain", {"gain": 1.0}),), rate_hz)


def refusal(call):
    with pytest.raises(ls.errors.WrongUseError) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("inf"), float("nan")])
@pytest.mark.parametrize("name", ["modulus_margin", "delay_margin_s", "bandwidth_hz", "control_high_frequency_from_hz"])
def test_a_requirement_that_must_be_above_zero(name, wrong):
    text = refusal(lambda: ls.Requirements("axis", **{name: wrong}))
    assert f"{name} of loop 'axis' must be positive and finite" in text
    assert f"{wrong!r}" in text


@pytest.mark.parametrize("name", ["gain_margin_db", "gain_reduction_margin_db", "phase_margin_deg"])
def test_a_margin_must_not_be_negative(name):
    assert f"{name} of loop 'axis' must not be negative" in refusal(lambda: ls.Requirements("axis", **{name: -1.0}))


@pytest.mark.parametrize("name", [limit.name for limit in LIMITS])
def test_a_requirement_is_finite(name):
    for wrong in (float("nan"), float("inf")):
        text = refusal(lambda wrong=wrong: ls.Requirements("axis", **{name: wrong}))
        assert f"{name} of loop 'axis' must be" in text
        assert "finite" in text


@pytest.mark.parametrize(("name", "least"), [("integrators", -2), ("unstable_poles", 0)])
def test_a_number_of_poles_is_a_whole_number_from_its_least(name, least):
    for wrong in (least - 1, 0.5, 1.0):
        text = refusal(lambda wrong=wrong: ls.Requirements("axis", **{name: wrong}))
        assert name in text
        assert (f"is a whole number from {least}" if isinstance(wrong, int) else "must be a whole number") in text
        assert f"{wrong:g}" in text


def test_no_frf_at_all():
    text = refusal(lambda: check([], under_gain(), WISHED))
    assert "there is no FRF of loop 'axis' to check" in text
    assert "measure or import one" in text


def test_a_controller_at_another_rate():
    text = refusal(lambda: ls.check([frf_of()], under_gain(500.0), WISHED))
    assert "the controller of loop axis runs at another rate than the recording r1" in text
    assert "500 and 1000 Hz" in text


def test_a_frf_of_unknown_rate_is_taken():
    assert ls.check([frf_of(rate_hz=0.0)], under_gain(500.0), WISHED).passed


def test_the_same_recording_twice():
    text = refusal(lambda: ls.check([frf_of(), frf_of()], under_gain(), WISHED))
    assert "two FRFs of one loop come from the same recording" in text
    assert "r1, r1" in text


def test_frfs_without_a_recording_get_names_of_their_own():
    verdict = ls.check([frf_of(""), frf_of("")], under_gain(), WISHED)
    assert list(verdict.margins) == ["frf 1", "frf 2"]


def test_a_frf_without_a_trusted_line():
    text = refusal(lambda: ls.check([frf_of(valid=False)], under_gain(), WISHED))
    assert "no frequency of the FRF axis r1 is valid" in text
    assert "excite more" in text


def test_a_band_without_lines():
    text = refusal(
        lambda: ls.check(
            [frf_of()], under_gain(), ls.Requirements("axis", phase_margin_deg=1.0, band_hz=(200.0, 300.0))
        )
    )
    assert "no frequency of the FRF lies in the band" in text
    assert "200 to 300 Hz" in text


def test_a_matrix_instead_of_one_loop():
    text = refusal(lambda: ls.check([frf_of(outputs=2)], under_gain(), WISHED))
    assert "each loop needs one output" in text


def test_lines_above_half_the_controllers_rate():
    text = refusal(lambda: Loop(frf_of(rate_hz=0.0, top_hz=100.0), under_gain(150.0), unstable_poles=0).L)
    assert "a controller at 150 Hz has no response at or above 75 Hz" in text
    assert "100 Hz" in text
