"""A controller of a given order from a convex design: its order, the check's word, and what it needs."""

import numpy as np
import pytest
from bench_nouns import TransferFunction
from bound_cases import frf_of, gain, limits

import loopshape as ls

MODEL = TransferFunction([3.0], np.polymul([1.0, 0.0], [1 / 900.0, 0.1 / 30.0, 1.0]), 0.01)
ASKED = {
    "sensitivity_peak_db": 6.0, "control_peak_db": 30.0, "phase_margin_deg": 45.0, "integrators": 1,
    "unstable_poles": 0,
}  # fmt: skip


@pytest.mark.long
@pytest.mark.hour
def test_a_controller_of_four_poles_passes_the_check_below_the_bound():
    P, R = frf_of(MODEL, lines=100), limits(**ASKED)
    found = ls.limits.max_order_design(P, gain(), R, 4)
    assert found.controller.order() <= 4
    assert ls.check(P, found.controller, R).passed
    most = ls.limits.bound(P, found.controller, R).bound_hz
    assert 0.4 * most < found.bandwidth_hz <= most


def test_an_order_below_one_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="at least one pole"):
        ls.limits.max_order_design(frf_of(MODEL), gain(), limits(**ASKED), 0)


def test_without_a_limit_to_design_for_it_says_so():
    asked = limits(phase_margin_deg=45.0, integrators=1, unstable_poles=0)
    with pytest.raises(ls.errors.WrongUseError, match="no convex design"):
        ls.limits.max_order_design(frf_of(MODEL), gain(), asked, 4)
