"""Control and output swapped give the plant's inverse: its magnitude rises and its phase leads; plants do not."""

from dataclasses import replace

import numpy as np
import pytest
from conversions import TWO_PI
from known_loops import LOOP, RATE, record, run_loop
from scipy.signal import cont2discrete, lfilter

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings

N = 12_000
UNKNOWN = replace(LOOP, controller=None)


def mode(f_hz, damping, numerator=(1.0,)):
    w = TWO_PI * f_hz
    scale = w ** (3 - len(numerator))
    return np.array(numerator) * scale, np.array([1.0, 2.0 * damping * w, w**2])


ANTI = (np.array([1.0, 2.0, (TWO_PI * 15.0) ** 2]), np.polymul([1.0, 0.5, (TWO_PI * 4.0) ** 2], [1.0, 40.0]))
PLANTS = {
    "mass": ([40.0], [1.0, 1.0, 0.0]),
    "mass and spring": mode(6.0, 0.1),
    "first order": ([5.0], [1.0, 5.0]),
    "antiresonance": ANTI,
    "accelerance": mode(20.0, 0.2, (1.0, 0.0, 0.0)),
}


def held(b, a):
    """Exact zero-order hold of a plant in s, as scipy makes it."""
    bz, az, _ = cont2discrete((b, a), 1.0 / RATE)
    return bz.ravel(), az


def notes(u, y, closed=False):
    place = "controller_input" if closed else "control"
    n = np.random.default_rng(3).standard_normal(u.size) if closed else u
    return " ".join(estimate_frf(record(place, "noise", n, u, y), UNKNOWN, Settings(method="welch")).notes)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("name", PLANTS)
def test_a_plant_is_no_inverse_and_its_inverse_is(name, noise):
    rng = np.random.default_rng(1)
    u = rng.standard_normal(N)
    x = lfilter(*held(*PLANTS[name]), u)
    y = x + noise * x.std() * lfilter([0.3], [1.0, -0.7], rng.standard_normal(N))
    assert "looks like the inverse of a plant" not in notes(u, y)
    if name != "accelerance":  # its inverse falls as a double integrator does: nothing tells it from a plant
        assert "looks like the inverse of a plant" in notes(y, u)


def test_in_open_loop_noise_before_its_cause_is_told_too():
    rng = np.random.default_rng(1)
    u = rng.standard_normal(N)
    y = lfilter(*held(*PLANTS["mass and spring"]), u) + 0.01 * rng.standard_normal(N)
    assert "comes before its cause" not in notes(u, y)
    assert "comes before its cause that z_v and y_rad may be swapped" in notes(y, u)


def test_in_closed_loop_without_a_known_controller_too():
    n = np.random.default_rng(3).standard_normal(N)
    z, y = run_loop("controller_input", n, 0.01 * np.random.default_rng(5).standard_normal(N))
    assert "looks like the inverse of a plant" not in notes(z, y, closed=True)
    assert "looks like the inverse of a plant" in notes(y, z, closed=True)


@pytest.mark.parametrize("other", ["z_v", "n_rad"])
def test_one_column_that_was_mapped_twice_is_refused(other):
    n = np.random.default_rng(3).standard_normal(N)
    whole = record("controller_input", "noise", n, *run_loop("controller_input", n, 0.0 * n))
    columns = dict(whole.columns) | {"y_rad": np.array(whole.columns[other])}
    with pytest.raises(ls.errors.BadSignalError, match=f"y_rad and {other} of loop axis .* same numbers.*map each"):
        estimate_frf(ls.Recording(whole.info, RATE, columns), UNKNOWN)


def test_an_output_that_is_a_multiple_of_the_input_is_told():
    u = np.random.default_rng(3).standard_normal(N)
    assert "exact multiple" in notes(u, -2.5 * u + 1.0)
    assert "exact multiple" not in notes(u, lfilter([0.0, 1.0], [1.0, -0.5], u))
