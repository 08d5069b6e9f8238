"""Each excitation that cannot be, and the sentence that the user gets."""

import pytest

import loopshape as ls
from loopshape.toolbox.rig.excitation.excitation import BandNoise, Prbs, Sweep, samples
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.excitation.setpoints import Profile, Staircase

NAN, INF = float("nan"), float("inf")
BANDED = {
    "sweep": lambda lo, hi: Sweep(lo, hi, 10.0, 1.0),
    "multisine": lambda lo, hi: Multisine(lo, hi, 10.0, 1.0),
    "noise": lambda lo, hi: BandNoise(lo, hi, 10.0, 1.0),
}


@pytest.mark.parametrize("kind", BANDED)
@pytest.mark.parametrize("band", [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, 1.0), (1.0, INF), (NAN, 1.0), (1.0, NAN)])
def test_band_that_does_not_rise_from_above_zero(kind, band):
    with pytest.raises(ls.errors.WrongUseError, match=f"a {kind}'s band must be positive and increasing; received"):
        BANDED[kind](*band)


@pytest.mark.parametrize("kind", BANDED)
@pytest.mark.parametrize("high", [50.0, 80.0])
def test_band_above_half_the_rate(kind, high):
    with pytest.raises(
        ls.errors.WrongUseError, match=rf"a {kind} must stay below half the rate \(50 Hz\); received {high:g} Hz"
    ):
        BANDED[kind](1.0, high).signal(100.0)


@pytest.mark.parametrize("value", [0.0, -1.0, NAN, INF])
@pytest.mark.parametrize(
    "make",
    [
        lambda v: Sweep(1.0, 2.0, 10.0, v),
        lambda v: Sweep(1.0, 2.0, v, 1.0),
        lambda v: Multisine(1.0, 2.0, 10.0, v),
        lambda v: Multisine(1.0, 2.0, v, 1.0),
        lambda v: Multisine(1.0, 2.0, 10.0, 1.0, periods=v),
        lambda v: Prbs(5, 0.01, v),
        lambda v: Prbs(5, v, 1.0),
        lambda v: BandNoise(1.0, 2.0, 10.0, v),
        lambda v: BandNoise(1.0, 2.0, v, 1.0),
        lambda v: Profile((0.0,), (1.0,), v, 1.0, 1.0),
        lambda v: Profile((0.0,), (1.0,), 1.0, v, 1.0),
        lambda v: Profile((0.0,), (1.0,), 1.0, 1.0, v),
    ],
)
def test_number_that_must_be_positive(make, value):
    with pytest.raises(ls.errors.WrongUseError, match="must be positive; received"):
        make(value)


@pytest.mark.parametrize("duration_s", [0.0105, 0.0, -1.0, NAN, INF, 1e-9])
def test_duration_that_is_no_whole_number_of_samples(duration_s):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"whole number of samples; received .* s at 1000 Hz; change the duration"
    ):
        samples(duration_s, 1000.0)


def test_rounded_durations_are_whole():
    assert [samples(k * 0.1, 1000.0) for k in (1, 3, 7, 123_457)] == [100, 300, 700, 12_345_700]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sweep(1.0, 2.0, 10.0005, 1.0),
        lambda: Multisine(1.0, 2.0, 10.0005, 1.0),
        lambda: Prbs(5, 0.0015, 1.0),
        lambda: BandNoise(1.0, 2.0, 10.0005, 1.0),
    ],
)
def test_signal_whose_length_falls_between_samples(make):
    with pytest.raises(ls.errors.WrongUseError, match="whole number of samples"):
        make().signal(1000.0)


@pytest.mark.parametrize("lines", [(1.0, 1.55), (0.05,), (-1.0,), (0.0, 1.0), ()])
def test_lines_off_the_grid(lines):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"whole multiples of 0\.1 Hz; received .*choose frequencies on that grid"
    ):
        Multisine(1.0, 2.0, 10.0, 1.0, lines_hz=lines).lines()


def test_band_without_a_line():
    with pytest.raises(ls.errors.WrongUseError, match="whole multiples of 1 Hz"):
        Multisine(1.2, 1.8, 1.0, 1.0).lines()
    with pytest.raises(
        ls.errors.WrongUseError, match=r"every 1 Hz, and none in its band; received 0\.2 to 0\.8 Hz; lengthen"
    ):
        BandNoise(0.2, 0.8, 1.0, 1.0, ramp_s=0.0).signal(1000.0)


@pytest.mark.parametrize("lines", [(600.0, 1.0), (1.0, 500.0)])
def test_lines_above_half_the_rate_in_any_order(lines):
    with pytest.raises(ls.errors.WrongUseError, match="a multisine must stay below half the rate"):
        Multisine(1.0, 2.0, 10.0, 1.0, lines_hz=lines).signal(1000.0)


@pytest.mark.parametrize("ramp_s", [0.6, 1.0, 2.0, -0.1])
@pytest.mark.parametrize("make", [Sweep, BandNoise])
def test_ramps_that_leave_no_signal_between_them(make, ramp_s):
    with pytest.raises(ls.errors.WrongUseError, match=r"outlast both its ramps; received .*shorten ramp_s"):
        make(5.0, 20.0, 1.0, 1.0, ramp_s=ramp_s).signal(1000.0)


def test_spacing():
    with pytest.raises(
        ls.errors.WrongUseError, match="spacing is not known; received 'cubic'; use linear or logarithmic"
    ):
        Sweep(1.0, 2.0, 10.0, 1.0, spacing="cubic")


@pytest.mark.parametrize("order", [2, 21])
def test_prbs_order(order):
    with pytest.raises(ls.errors.WrongUseError, match="order from 3 to 20; received"):
        Prbs(order, 0.01, 1.0)


@pytest.mark.parametrize(("times", "values"), [((0.0, 1.0), (1.0,)), ((2.0, 1.0), (1.0, 2.0))])
def test_staircase_and_profile_points(times, values):
    for make in (lambda: Staircase(times, values), lambda: Profile(times, values, 1.0, 1.0, 1.0)):
        with pytest.raises(
            ls.errors.WrongUseError, match="a value for each time, and times that rise; received 2 times"
        ):
            make()


def test_profile_whose_moves_overlap():
    profile = Profile((0.0, 0.5), (30.0, 0.0), 60.0, 300.0, 3000.0)  # the first takes 0.8 s
    with pytest.raises(
        ls.errors.WrongUseError, match=r"begins before the last one has ended; received 0\.5 s, .*0\.8 s; move it"
    ):
        profile.sampled(3000, 1000.0, 0.0)
    Profile((0.0, 0.8), (30.0, 0.0), 60.0, 300.0, 3000.0).sampled(3000, 1000.0, 0.0)
