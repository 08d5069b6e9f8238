"""Claims of experiments/beyond about the source's recommendations (chapter 6) and the tracking of its section 5.2.3."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.arm.source import number, value

ROOT = Path(__file__).parents[5]
FOLDER = ROOT / "experiments" / "beyond"
SETTINGS = tomllib.loads((FOLDER / "settings.toml").read_text(encoding="utf-8"))
FULL = (0.0, 1.8)


def at_supply(supply_bar, point):
    return linearise(constants(ARM1_PARAMETERS.vector({"supply_bar": supply_bar})), *point)


@pytest.fixture(scope="module")
def modules():
    """The study's own functions."""
    sys.path.insert(0, str(FOLDER))
    try:
        import beyond_feedforward
        import beyond_prestress

        yield beyond_feedforward, beyond_prestress
    finally:
        sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def tracked(modules):
    """The slowest profile without feedforward and with two kinds of it, under the shipped controllers."""
    feedforward, _ = modules
    settings = SETTINGS["feedforward"]
    way = feedforward.path(settings, settings["limits"][0])
    fitted = at_supply(1.0, (0.0, settings["p_ab_bar"])).third_order()
    controllers = ls.read_controllers(ROOT / "examples" / "arm" / "controller.toml")
    kinds = feedforward.feeds(way, fitted, settings)
    names = ("none", "third order, one point", "inverted model")
    return {n: feedforward.tracked(way, kinds[n], controllers, settings, SETTINGS["seed"])[0] for n in names}


def test_a_higher_supply_fills_faster_and_leaves_exhaust_and_mode_as_they_are():
    low, high = at_supply(1.0, FULL), at_supply(2.0, FULL)
    assert high.fill.min() > 2.0 * low.fill.max()
    assert high.exhaust == pytest.approx(low.exhaust)
    assert high.third_order()[1:] == pytest.approx(low.third_order()[1:])


def test_kappa_rises_most_where_the_muscles_are_near_the_supply():
    """Why the lowest bandwidth gains and the others hardly do."""
    ratio = {p: at_supply(2.0, p).third_order()[0] / at_supply(1.0, p).third_order()[0] for p in (FULL, (0.0, 0.8))}
    assert ratio[FULL] > 1.4 > ratio[0.0, 0.8] + 0.02
    unlike = [lin.exhaust.max() / lin.fill.min() for lin in (at_supply(1.0, FULL), at_supply(2.0, FULL))]
    assert unlike[0] > 4.0 > 2.0 > unlike[1]


def test_the_third_order_feedforward_is_that_models_inverse(modules):
    """Put through kappa/(s^3 + 2 zeta w s^2 + w^2 s) it gives the reference back."""
    from scipy.signal import lsim

    feedforward, _ = modules
    settings = SETTINGS["feedforward"]
    way = feedforward.path(settings, settings["limits"][0])
    kappa, f_hz, zeta = 1400.0, 5.2, 0.065
    w = 2.0 * np.pi * f_hz
    z = feedforward.third_order(way, kappa, f_hz, zeta)
    t = np.arange(z.size) / feedforward.RATE_HZ
    _, y, _ = lsim(([kappa], [1.0, 2.0 * zeta * w, w**2, 0.0]), z, t)
    assert np.abs(np.rad2deg(y - way.derivative[0])).max() < 0.05


def test_tracking_without_feedforward_lags_as_the_source_says(tracked):
    """Section 5.2.3: a delay of about 0.1 s, here under the shipped controllers."""
    delay = number("figure_5_7.delay")
    assert tracked["none"]["delay_s"] == pytest.approx(delay.value, abs=delay.half_digit)


def test_feedforward_takes_the_tracking_error_away(tracked):
    none, one, model = (tracked[n]["rms_deg"] for n in ("none", "third order, one point", "inverted model"))
    assert one < none / 2.5
    assert model < none / 20.0
    assert tracked["inverted model"]["saturated_s"] == 0.0


def test_stretched_muscles_raise_the_mode_and_narrow_the_range_above_one_pressure(modules):
    """By the fitted stiffness; that the tube meets the braid at a lower pressure then is not in the model."""
    _, prestress = modules
    stretch = (0.0, value("prestress.low"), value("prestress.high"))
    rows = prestress.prestress_rows({"stretch_mm": stretch, "p_ab_bar": [1.0]})
    f_hz, widest = ([r[key] for r in rows] for key in ("f_hz", "widest_deg"))
    assert f_hz == sorted(f_hz)
    assert widest == sorted(widest, reverse=True)
    assert f_hz[-1] > 1.4 * f_hz[0]
