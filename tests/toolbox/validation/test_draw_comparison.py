"""Pictures of comparisons show the data that they are given."""

import numpy as np
import pytest
from prediction_nouns import T, predictions, sensitivity, step

import loopshape as ls
from loopshape.loop.predict.indicators import indicators
from loopshape.toolbox.validation.comparison import compare
from loopshape.toolbox.validation.nouns import StepComparison
from loopshape.toolbox.validation.pictures import comparison_grid, steps_grid
from loopshape.view.style import png


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
