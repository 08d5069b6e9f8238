"""An undecided verdict says what to measure: band, distance of lines and seconds by hand; measured, it is decided."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block
from drawn_loops import LINES, PLANTS, RATE, by_roots, errors, limit_gain

import loopshape as ls
from loopshape.loop.verdict import check

PLANT = PLANTS["one integrator"]
DECLARED = ls.Requirements("axis", integrators=1, unstable_poles=0)
LIMIT = limit_gain(PLANT)


def frf_of(f, relative, seed=None):
    P = PLANT.response(f)
    if seed is not None:
        P = P * (1.0 + relative * errors(np.random.default_rng(seed), f.size))
    return ls.FRF.from_arrays(f, P, std=relative * np.abs(P), rate_hz=RATE, loop="axis", recording="one two")


def answered(frf, gain=1.0, asked=DECLARED):
    return check([frf], ls.Controller("axis", (Block("gain", {"gain": gain}),), RATE), asked)


def the_order(verdict):
    assert verdict.outcome == "undecided"
    (order,) = verdict.orders
    return order


def test_above_the_last_line_its_own_distance_and_four_periods():
    order = the_order(answered(frf_of(LINES[LINES < 3.0], 1e-6)))
    assert order.low_hz == pytest.approx(2.9)
    assert np.abs(PLANT.response([order.high_hz]))[0] < 1.0
    assert order.resolution_hz == pytest.approx(0.1)
    assert order.seconds == pytest.approx(40.0)


def test_below_the_first_line_half_of_the_lowest_frequency_at_most():
    order = the_order(answered(frf_of(np.arange(10.0, 60.0, 2.0), 1e-6)))
    low, high = np.abs(PLANT.response([order.low_hz, order.high_hz]))
    assert high < 1.0 < low
    assert order.high_hz == pytest.approx(10.0)
    assert order.resolution_hz == pytest.approx(0.5 * order.low_hz, rel=1e-3)
    assert order.seconds == pytest.approx(4.0 / order.resolution_hz, rel=1e-3)


def test_in_a_hole_the_hole():
    order = the_order(answered(frf_of(LINES[(LINES < 4.05) | (LINES > 8.95)], 0.01)))
    assert (order.low_hz, order.high_hz) == pytest.approx((4.0, 9.0))
    assert order.resolution_hz == pytest.approx(0.1)


def test_the_ordered_band_renews_the_old_lines_and_decides():
    old = frf_of(LINES[(LINES < 4.05) | (LINES > 8.95)], 0.01, seed=1)
    order = the_order(answered(old))
    newer = frf_of(np.arange(order.low_hz, order.high_hz + 1e-9, order.resolution_hz), 0.01, seed=2)
    made = old.renewed(newer)
    assert answered(made).outcome == ("passed" if by_roots(PLANT, 1.0) == 0 else "failed")
    assert np.all(np.diff(made.frequency_hz) > 0.0)
    assert made.frequency_hz.size == LINES.size
    within = (made.frequency_hz > 3.99) & (made.frequency_hz < 9.01)
    np.testing.assert_array_equal(made.siso[within], newer.siso)
    other = replace(newer, operating_point={"x": 1.0})
    with pytest.raises(ls.errors.WrongUseError, match="operating_point"):
        old.renewed(other)


def test_a_measurement_of_the_whole_band_takes_the_place_of_the_old_one():
    f = np.geomspace(1.0, 10.0, 9)
    old, newer = (ls.FRF.from_arrays(f, 1.0 / (1j * f), std=std) for std in (0.1, 0.01))
    made = old.renewed(newer)
    np.testing.assert_array_equal(made.frequency_hz, f)
    np.testing.assert_array_equal(made.relative_std, newer.relative_std)


def test_seconds_go_with_the_square_of_the_error():
    """The seconds bring the deviation of a line that is too uncertain to 5 %: (0.3/0.05)² periods, (0.6/0.05)²."""
    seconds = []
    for poor in (0.3, 0.6):
        relative = np.where((LINES > 4.0) & (LINES < 8.0), poor, 1e-3)
        order = the_order(answered(frf_of(LINES, relative)))
        assert order.low_hz <= 5.0
        assert order.high_hz >= 7.0
        seconds.append(order.seconds * order.resolution_hz)
    assert seconds == pytest.approx([36.0, 144.0], rel=0.05)


def test_known_averages_are_what_was_spent():
    relative = np.where((LINES > 4.0) & (LINES < 8.0), 0.3, 1e-3)
    frf = frf_of(LINES, relative)
    once, five = (the_order(answered(one)).seconds for one in (frf, replace(frf, averages=5.0)))
    assert five == pytest.approx(5.0 * once, rel=1e-3)


def test_a_declaration_is_no_measurement():
    order = the_order(answered(frf_of(LINES, 1e-3), asked=ls.Requirements("axis", integrators=1)))
    assert order.by == "declaration"
    assert order.command is None
    assert order.seconds is None


def test_a_band_that_is_not_to_be_used_is_not_ordered():
    asked = ls.Requirements("axis", integrators=1, unstable_poles=0, band_hz=(0.1, 2.0))
    order = the_order(answered(frf_of(LINES, 1e-3), asked=asked))
    assert order.by == "declaration"


@pytest.mark.parametrize("gain", [1.0, 1.5 * LIMIT])
def test_what_is_decided_orders_nothing(gain):
    verdict = answered(frf_of(LINES, 1e-6), gain)
    assert verdict.outcome == ("passed" if by_roots(PLANT, gain) == 0 else "failed")
    assert verdict.orders == ()


def test_the_words_are_the_command_with_the_name_quoted():
    verdict = answered(frf_of(LINES[LINES < 3.0], 1e-6))
    order = the_order(verdict)
    words = (
        "loopshape plan RUN --recording 'one two' --lines all --from-hz 2.9"
        f" --to-hz {order.high_hz:.6g} --resolution-hz 0.1 --seconds 40"
    )
    assert order.command == words
    assert f"to settle it: {words}" in str(verdict).splitlines()
    assert verdict.to_dict()["orders"][0]["command"] == words
    assert verdict.to_dict()["orders"][0]["by"] == "measurement"


@pytest.mark.parametrize("share", [0.8, 1.25])
@pytest.mark.parametrize(
    "relative",
    [
        np.full(LINES.size, 0.1),
        np.where((LINES > 4.0) & (LINES < 30.0), 0.4, 1e-3),
        np.where((LINES > 0.0) & (LINES < 8.0), 1e-3, 0.6),
    ],
    ids=["all", "a band", "the end"],
)
def test_measured_as_ordered_it_is_decided(share, relative):
    """Near the limit of stability: lines of what is ordered, with the noise of its seconds, in place of the old."""
    gain, frf = share * LIMIT, frf_of(LINES, relative, 3)
    verdict = answered(frf, gain)
    rng = np.random.default_rng(5)
    for _ in range(3):
        for order in verdict.orders:
            k = np.arange(np.ceil(order.low_hz / order.resolution_hz), order.high_hz / order.resolution_hz + 1e-9)
            new = order.resolution_hz * k
            std = np.interp(new, frf.frequency_hz, frf.relative_std[:, 0, 0])
            std = std / np.sqrt(order.resolution_hz * order.seconds)
            old = (frf.frequency_hz < order.low_hz) | (frf.frequency_hz > order.high_hz)
            f = np.append(frf.frequency_hz[old], new)
            P = np.append(frf.siso[old], PLANT.response(new) * (1.0 + std * errors(rng, new.size)))
            every = np.append(frf.relative_std[old, 0, 0], std)
            f, at = np.unique(f, return_index=True)
            frf = ls.FRF.from_arrays(f, P[at], std=(every * np.abs(P))[at], rate_hz=RATE, loop="axis", recording="one")
        verdict = answered(frf, gain)
    assert verdict.outcome == ("passed" if share < 1.0 else "failed")
