"""Pictures of comparisons show the data that they are given."""

import numpy as np
import pytest
from bench_nouns import Block, Step

import loopshape as ls
from loopshape.loop.predict.indicators import indicators
from loopshape.toolbox.validation.comparison import compare, sensitivity_of
from loopshape.toolbox.validation.nouns import StepComparison
from loopshape.toolbox.validation.pictures import comparison_grid, steps_grid
from loopshape.view.style import png

GAIN = ls.Controller("theta2", (Block("gain", {"gain": 5.0}),), 1000.0)
T = np.linspace(0.0, 2.0, 200)


def sensitivity(point: float, gain: float = 1.0) -> ls.FRF:
    f = np.geomspace(0.1, 20.0, 40)
    P = gain / (2j * np.pi * f)
    frf = ls.FRF(
        f, P[:, None, None], (1e-3 * np.abs(P) ** 2)[:, None, None].astype(complex), np.ones(40, dtype=bool), ("z_v",),
        ("theta2_rad",), "made", recording=f"r{point:g}", loop="theta2", rate_hz=1000.0, recorded_under=GAIN,
        operating_point={"theta2_deg": point},
    )  # fmt: skip
    return sensitivity_of(frf)


def step() -> Step:
    y = 1.0 - np.exp(-5.0 * T)
    return Step(T, y, y - 0.05, y + 0.05, indicators(T, y), "fit")


def predictions() -> list[ls.Prediction]:
    return [ls.Prediction(sensitivity(p), "stable", step()) for p in (0.0, 15.0)]


def test_a_comparison_shows_both_and_shades_where_it_fails() -> None:
    made = predictions()
    measured = [sensitivity(0.0), sensitivity(15.0, gain=0.6)]
    found = [compare(p, m) for p, m in zip(made, measured, strict=True)]
    figure = comparison_grid(made, measured, found)
    held, failed = figure.axes[:2]
    assert [c.outcome for c in found] == ["confirmed", "refuted"]
    assert len(failed.patches) == len(held.patches) + 1
    assert np.allclose(failed.lines[1].get_ydata(), 20.0 * np.log10(np.abs(measured[1].siso)))
    assert "dB" in failed.texts[0].get_text()
    assert png(figure).startswith(b"\x89PNG")


def test_steps_are_drawn_over_the_predicted_band() -> None:
    response = 1.1 * (1.0 - np.exp(-5.0 * T))
    one = StepComparison(
        "r", "theta2", {"theta2_deg": 0.0}, 1.0, 0.1, indicators(T, response), T, response, step(), 0.5, 0.1, 2.0
    )
    figure = steps_grid([one])
    ax = figure.axes[0]
    assert np.allclose(ax.lines[0].get_ydata(), response)
    assert np.allclose(ax.lines[1].get_ydata(), step().response)
    assert "10 %" in ax.texts[0].get_text()


def test_pictures_of_nothing_are_refused() -> None:
    for call in (lambda: comparison_grid([], [], []), lambda: steps_grid([])):
        with pytest.raises(ls.errors.WrongUseError):
            call()
