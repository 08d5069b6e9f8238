"""The picture of a plan: before, after, wish and crossover where they belong, units on the axes."""

import known_loops as known
import numpy as np
import pytest
from study_signals import Multisine

from loopshape.toolbox.planning.plan import plan
from loopshape.toolbox.planning.plan_nouns import Required
from loopshape.toolbox.planning.plan_pictures import plan_page
from loopshape.toolbox.planning.plan_record import first_record
from loopshape.view.style import png


@pytest.fixture(scope="module")
def planned():
    signal = Multisine(0.5, 40.0, 10.0, 1.5, 4, ramp_s=1.0)
    n = signal.signal(known.RATE)
    z, y = known.run_loop("controller_input", n, 0.05 * np.random.default_rng(1).standard_normal(n.size))
    record = known.record("controller_input", "multisine", n, z, y, period_s=10.0, from_s=1.0)
    return plan(first_record(record, known.LOOP), Required(0.01, at_hz=6.0))


def test_accuracy_above_and_what_is_injected_below(planned):
    figure = plan_page(planned)
    top, bottom = figure.axes
    before, after = top.lines[:2]
    np.testing.assert_allclose(before.get_ydata(), 100.0 * planned.before_std)
    np.testing.assert_allclose(after.get_xdata(), planned.lines_hz)
    np.testing.assert_allclose(after.get_ydata(), 100.0 * planned.std)
    (required,) = (line for line in top.lines if line.get_gid() == "required")
    assert required.get_ydata()[0] == pytest.approx(1.0)
    for ax in (top, bottom):
        (at,) = (line for line in ax.lines if line.get_gid() == "crossover")
        assert at.get_xdata()[0] == pytest.approx(6.0)
    assert top.get_ylabel() == "relative std of |G| [%]"
    assert bottom.get_ylabel() == "amplitude of a frequency [rad]"
    low, high = top.get_ylim()
    assert low < 1.0 < high
    assert png(figure) == png(plan_page(planned))
