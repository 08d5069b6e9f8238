"""The picture of predictions shows the data that it is given."""

import numpy as np
import pytest
from prediction_nouns import predictions, step

import loopshape as ls
from loopshape.toolbox.validation.predicted.picture import prediction_page


def test_a_prediction_shows_s_t_and_the_step_with_bands() -> None:
    made = predictions()
    figure = prediction_page(made)
    s, t, answer = figure.axes
    assert (s.get_ylabel(), t.get_ylabel()) == ("|S| [dB]", "|T| [dB]")
    assert s.get_xlabel() == "frequency [Hz]"
    drawn = s.lines[0].get_ydata()
    assert np.allclose(drawn, 20.0 * np.log10(np.abs(made[0].sensitivity.siso)))
    assert np.allclose(t.lines[0].get_ydata(), 20.0 * np.log10(np.abs(1.0 - made[0].sensitivity.siso)))
    assert np.allclose(answer.lines[0].get_ydata(), step().response)
    assert len(answer.collections) == 2  # a band for each of two
    assert "[s]" in answer.get_xlabel()


def test_a_picture_of_nothing_is_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError):
        prediction_page([])
