"""FRFs that do not go together: the sentence a user gets."""

from dataclasses import replace

import numpy as np
import pytest
from algebra_nouns import any_frf
from bench_nouns import Block

import loopshape as ls
from loopshape.data.algebra import (
    add,
    channels,
    controller_frf,
    feedback,
    inverse,
    lower_closure,
    product,
    regrid,
    upper_closure,
    with_hold,
)  # fmt: skip
from loopshape.loop.verdict import check

RNG = np.random.default_rng(1)
A, B = any_frf(RNG, 2, 2), any_frf(RNG, 2, 2)
CHAIN = replace(B, outputs=A.inputs)
GAIN = ls.Controller("x", (Block("gain", {"gain": 1.0}),), 100.0)


def no(words, do, *given, **more):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        do(*given, **more)


def test_other_lines_are_named_and_never_regridded():
    moved = any_frf(RNG, 2, 2, f=np.array([1.0, 2.0, 3.5, 4.0, 5.0, 6.0, 7.0]))
    no(r"different frequencies.*line 3 at 3 Hz and 3\.5 Hz; .*regrid\(frf", add, A, moved)
    no("line 4 at 4 Hz and nothing", add, A, A.select(slice(0, 3)))
    no("different frequencies", feedback, A, replace(moved, inputs=A.outputs, outputs=A.inputs))
    nearly = replace(B, frequency_hz=B.frequency_hz * (1.0 + 1e-12))
    assert add(A, nearly).frequency_hz[3] == A.frequency_hz[3]


def test_one_frf_twice_has_errors_that_are_not_independent():
    square = replace(A, inputs=A.outputs)
    for do in (add, product):
        no("stands twice.*feedback, lower_closure", do, square, square)
    assert np.allclose(add(A, A, independent=True).covariance, 2.0 * A.covariance)
    exact = replace(A, covariance=0.0 * A.covariance)
    assert not add(exact, exact).covariance.any()
    one, two = replace(A, recording="r01"), replace(B, recording="r02+r01")
    assert "two FRFs come from r01: their errors were taken as independent" in add(one, two).notes
    assert not add(one, replace(B, recording="r02")).notes


def test_channels_that_do_not_meet():
    no("inner channels of a product are not as many", product, A, any_frf(RNG, 3, 2))
    no(r"inner channels of a product go by their names.*y0, y1 and u0, u1.*connect=\"order\"", product, A, B)
    no("by names or by order", product, A, B, connect="somehow")
    assert product(A, B, connect="order").outputs == ("y0", "y1")
    no("outputs of an FRF go by their names.*use the names y0, y1", channels, A, ["y2"])
    no("each once", channels, A, ["y0", "y0"])
    no("controller outputs and plant inputs", feedback, A, B)
    no("only a square FRF has an inverse; received 1 x 2", inverse, any_frf(RNG, 1, 2))
    singular = replace(A, response=np.ones((7, 2, 2)) + 0j)
    no(r"an FRF has no inverse at every frequency; received 1 Hz", inverse, singular)


def test_closures_that_close_nothing_or_all():
    no("outputs of M that a lower closure closes go by their names", lower_closure, A, B)
    K = replace(A, inputs=A.outputs, outputs=A.inputs)
    no("leaves at least one input", lower_closure, B, K)
    no("bare controllers have no channels", lower_closure, A, GAIN)
    no("bare controllers have no channels.*controller_frf", upper_closure, A, [GAIN, GAIN], connect="order")
    assert upper_closure(A, GAIN, connect="order").outputs == ("y1",)


def test_rates_and_controllers():
    no("different rates", add, replace(A, rate_hz=10.0), replace(B, rate_hz=20.0))
    no("different rates", feedback, any_frf(RNG, 1, 1, rate_hz=50.0), GAIN)
    other = replace(GAIN, rate_hz=200.0)
    no(r"controllers of one rate.*\[100.0, 200.0\]", controller_frf, [GAIN, other], [1.0], ["a", "b"], ["c", "d"])
    no("2 controllers at", controller_frf, [GAIN, GAIN], [1.0], ["a"], ["c", "d"])
    no("0 controllers", controller_frf, [], [1.0], [], [])
    no("at or above 50 Hz", controller_frf, GAIN, [60.0], ["a"], ["b"])


def test_the_hold_is_multiplied_in_once():
    one = with_hold(A, 100.0, 0.001)
    assert "zero-order hold at 100 Hz and 0.001 s of delay" in one.method
    no("the hold and the delay already", with_hold, one, 100.0)
    no("already", with_hold, product(one, replace(B, outputs=A.inputs)), 100.0)
    no(
        "recorded at the controller's own rate contains the hold.*continuous=True",
        with_hold,
        replace(A, rate_hz=100.0),
        100.0,
    )
    assert with_hold(replace(A, rate_hz=100.0), 100.0, continuous=True).rate_hz == 100.0
    no("frequencies below half its rate", with_hold, A, 10.0)
    no("frequencies below half its rate", with_hold, A, 100.0, -1.0)
    no("frequencies below half its rate", with_hold, A, float("nan"))


def test_that_the_hold_is_included_is_a_field_and_no_word_of_the_method():
    one = replace(with_hold(A, 100.0), method="bench", notes=())
    no("already", with_hold, one, 100.0)
    no("already", with_hold, ls.from_control(ls.to_control(one), relative_std=0.0), 100.0)
    added = replace(GAIN, added_hold=True)
    plant = replace(with_hold(any_frf(RNG, 1, 1), GAIN.rate_hz), method="bench", notes=(), loop=GAIN.loop)
    no("contains the hold already", check, [plant], added, ls.Requirements(GAIN.loop, bandwidth_hz=1.0))


def test_regridding_never_extrapolates():
    no(r"never extrapolated; received 0\.5 to 3 Hz; stay within 1 to 7 Hz", regrid, A, [0.5, 3.0])
    no("never extrapolated", regrid, A, [3.0, 8.0])
    no("never extrapolated; received no line", regrid, A, [])
    no("never extrapolated", regrid, A, [2.0, np.nan])
    no("strictly increasing", regrid, A, [3.0, 2.0])
    made = regrid(A, np.arange(1.5, 7.0, 0.25))
    assert "interpolated from 7 onto 22 lines" in made.notes[-1]
    assert made.line_overlap > 3.0
    assert list(made.valid[:3]) == [False, False, True]  # the first line is not valid, nor what leans on it
    assert regrid(A.select([2]), [3.0]).response == pytest.approx(A.response[2:3])
