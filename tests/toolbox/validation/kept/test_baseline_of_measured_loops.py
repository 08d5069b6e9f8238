"""Two measurements of one loop: chance is called a change about once in 20 times; a plant that drifted is found."""

import numpy as np
import pytest
from bench_nouns import Block, TransferFunction
from conversions import TWO_PI

import loopshape as ls
from loopshape.toolbox.validation.kept.baseline import compare

F = np.arange(0.2, 40.01, 0.2)
W = TWO_PI * 6.3
PLANT = TransferFunction([780.0], [1.0, 0.1 * W, W * W, 0.0]).response(F)  # an integrator and a resonance
WISHED = ls.Requirements("theta2", integrators=1, phase_margin_deg=1.0)


def controller(gain=55.0):
    notch = {"f1_hz": 6.1, "f2_hz": 6.1, "damping1": 0.05, "damping2": 5.0}
    blocks = [Block("gain", {"gain": gain}), Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 15.0}), Block("notch", notch)]
    return ls.Controller("theta2", (*blocks, Block("low_pass_2", {"f_hz": 15.0, "damping": 0.7})), 1000.0)


def measured(rng, relative, drift=1.0, own=None):
    """A check of the loop on one more measurement of its plant, with circular errors of a relative size."""
    size = relative * np.abs(PLANT)
    error = size * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size)) / np.sqrt(2.0)
    frf = ls.FRF(
        F, (drift * PLANT + error)[:, None, None], (size**2)[:, None, None] + 0j, np.ones(F.size, dtype=bool),
        ("z_v",), ("y_rad",), "made up", recording="r1", loop="theta2", rate_hz=1000.0,
    )  # fmt: skip
    own = own or controller()
    return ls.check([frf], own, WISHED)


@pytest.mark.long
@pytest.mark.parametrize("relative", [0.02, 0.05])
def test_a_loop_measured_again_is_seldom_called_changed(relative):
    rng, trials = np.random.default_rng(7), 50
    found = [compare([measured(rng, relative)], [measured(rng, relative)]) for _ in range(trials)]
    assert sum(one.outcome != "unchanged" for one in found) <= 8  # of 50 at 5 %: more once in 1000 such tests
    moved = [change for one in found for change in one.margins if change.interval is not None]
    assert len(moved) >= 10 * trials


def test_a_plant_that_drifted_is_found_with_its_size():
    rng = np.random.default_rng(8)
    for _ in range(10):
        found = compare([measured(rng, 0.02)], [measured(rng, 0.02, drift=1.2)])
        worse = {change.quantity: change for change in found.of("worse")}
        low, high = worse["gain_margin_db"].interval
        assert low < -20.0 * np.log10(1.2) < high < 0.0


def test_a_small_change_of_the_gain_is_seen_on_the_same_data_and_hides_in_others():
    seen = 0
    for seed in range(10):
        draws = [np.random.default_rng(seed), np.random.default_rng(seed), np.random.default_rng(100 + seed)]
        before, same, other = (
            measured(rng, 0.05, own=controller(gain)) for rng, gain in zip(draws, (55.0, 55.5, 55.5), strict=True)
        )
        worse = {change.quantity: change for change in compare([before], [same]).of("worse")}
        assert worse["gain_margin_db"].common
        assert worse["gain_margin_db"].change == pytest.approx(-20.0 * np.log10(55.5 / 55.0), abs=0.02)
        seen += "gain_margin_db" in {change.quantity for change in compare([before], [other]).of("worse")}
    assert seen == 0
