"""Bands of a loop's responses hold the truth in 95 % of repetitions, line by line, and refuse other names."""

import numpy as np
import pytest
from bench_nouns import Block, Loop
from conversions import TWO_PI, ComplexArray, db, deg

import loopshape as ls
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.points import PLACES, band, circular_places

RATE, RUNS = 1000.0, 400
F = np.geomspace(0.2, 40.0, 60)
CONTROLLER = ls.Controller(
    "axis", (Block("gain", {"gain": 1.6}), Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 30.0})), RATE
)


def truth() -> ComplexArray:
    s = 1j * TWO_PI * F
    return np.asarray(30.0 * np.exp(-0.002 * s) / s**2)


def frf(response: ComplexArray, variance: np.ndarray) -> ls.FRF:
    return ls.FRF(
        F, response[:, None, None], variance[:, None, None] + 0j, np.ones(F.size, dtype=bool), ("z_v",), ("y_rad",),
        "made up", rate_hz=RATE,
    )  # fmt: skip


def repeated(noise: float, rng: np.random.Generator) -> ComplexArray:
    error = rng.standard_normal((RUNS, F.size)) + 1j * rng.standard_normal((RUNS, F.size))
    return np.asarray(truth() * (1.0 + noise * np.sqrt(0.5) * error))


def true_responses() -> dict[str, ComplexArray]:
    loop = Loop(frf(truth(), np.zeros(F.size)), CONTROLLER, 2, unstable_poles=0)
    return {"P": truth()} | {name: getattr(loop, name) for name in ("L", "S", "T", "CS", "PS")}


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.05, 0.15])
def test_magnitude_and_phase_bands_cover_what_they_promise(noise: float) -> None:
    rng = np.random.default_rng(11)
    true = true_responses()
    inside = {name: np.zeros(2) for name in true}
    for response in repeated(noise, rng):
        loop = Loop(frf(response, (noise * np.abs(truth())) ** 2), CONTROLLER, 2, unstable_poles=0)
        for name, at in true.items():
            ends = band(loop, name)
            own = response if name == "P" else getattr(loop, name)
            turn = deg(np.angle(at * np.conj(own)))
            inside[name] += (
                np.mean((ends.low_db <= db(at)) & (db(at) <= ends.high_db)),
                np.mean((ends.low_deg <= turn) & (turn <= ends.high_deg)),
            )
    for name, hits in inside.items():
        # 60 x 400 independent lines: 0.0014; the rest is the two-sided quantile of a magnitude that noise makes larger
        assert np.all(np.abs(hits / RUNS - 0.95) < 0.012), (name, hits / RUNS)


@pytest.mark.parametrize("name", ["P", "L", "S", "T", "CS", "PS"])
def test_a_band_agrees_with_the_quantiles_of_the_smoothed_responses_own_draws(name: str) -> None:
    rng = np.random.default_rng(3)
    variance = (0.1 * np.abs(truth())) ** 2
    plant, scatter = smoothed(frf(repeated(0.1, rng)[0], variance))
    ends = band(Loop(plant, CONTROLLER, 2, unstable_poles=0), name)
    values = []
    for deviation in scatter.deviations:
        loop = Loop(frf(plant.siso + deviation, variance), CONTROLLER, 2, unstable_poles=0)
        values.append(db(loop.plant.siso if name == "P" else getattr(loop, name)))
    low, high = np.quantile(values, (0.025, 0.975), axis=0)
    width = ends.high_db - ends.low_db
    # 200 draws know a 2.5 % quantile to about 0.19 standard deviations, 5 % of the width; averaged over the lines less
    assert np.max(np.abs(low - ends.low_db) / width) < 0.25
    assert np.max(np.abs(high - ends.high_db) / width) < 0.25
    assert abs(np.mean((high - low) / width) - 1.0) < 0.05


def test_the_places_are_those_of_a_circular_error() -> None:
    z = circular_places()
    assert z.size == PLACES
    assert abs(np.mean(z)) < 0.01
    assert abs(np.mean(np.abs(z) ** 2) - 1.0) < 0.02
    assert abs(np.mean(z**2)) < 0.02
    assert abs(np.mean(np.abs(z) < np.sqrt(-np.log(0.05))) - 0.95) < 1.0 / PLACES


def test_a_controller_has_no_band() -> None:
    ends = band(Loop(frf(truth(), (0.1 * np.abs(truth())) ** 2), CONTROLLER, 2, unstable_poles=0), "C")
    assert np.array_equal(ends.low_db, ends.high_db)
    assert np.allclose(ends.high_deg - ends.low_deg, 0.0, atol=1e-12)


def test_a_phase_that_is_not_known_has_a_band_all_round() -> None:
    ends = band(Loop(frf(truth(), (5.0 * np.abs(truth())) ** 2), CONTROLLER, 2, unstable_poles=0), "L")
    assert np.all(ends.high_deg > 150.0)
    assert np.all(ends.low_deg < -150.0)


def test_other_names_are_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="one of a loop's responses"):
        band(Loop(frf(truth(), np.zeros(F.size)), CONTROLLER, 2, unstable_poles=0), "Q")
