"""What a bound and a schedule refuse, and what they say."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from bound_cases import frf_of, gain, limits, loop_of

from loopshape.errors import WrongUseError
from loopshape.model import TransferFunction
from loopshape.tune.bound import bound, excluded
from loopshape.tune.schedule import schedule


def test_a_plant_whose_integrators_are_not_known():
    between = TransferFunction([1.0], [1.0, 2.0 * np.pi * 0.05])  # the lowest lines look like half an integrator
    with pytest.raises(WrongUseError, match="number of integrators"):
        bound([frf_of(between)], gain(), limits(sensitivity_peak_db=6.0))


def test_an_unstable_plant_under_a_controller_that_does_not_hold_it():
    model = TransferFunction([1.0], [1.0 / (2.0 * np.pi), -1.0], 0.01)
    loop = loop_of(model, gain(0.5), 0, 1)
    with pytest.raises(WrongUseError, match="known to stabilise"):
        excluded(loop, [loop], limits(sensitivity_peak_db=6.0))


def test_nothing_to_schedule():
    with pytest.raises(WrongUseError, match="no FRF"):
        schedule([], limits(sensitivity_peak_db=6.0), gain())
