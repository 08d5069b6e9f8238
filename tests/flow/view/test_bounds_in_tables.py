"""A reading that is a bound stands as one in every table, with the way to measure on the side that it lies."""

import numpy as np

import loopshape as ls
from loopshape.view.verdict.markdown import markdown
from loopshape.view.verdict.tables import margins_table, verdict_tables

C = ls.controller(ls.gain(1.0), rate_hz=500.0)


def verdict_on(f, **required):
    s = 2j * np.pi * f
    P = ls.FRF.from_arrays(f, 60.0 / (s * (s / 60.0 + 1.0)), relative_std=1e-3, rate_hz=500.0, open_loop=True)
    return ls.check(P, C, ls.Requirements(integrators=1, unstable_poles=0, **required))


def test_a_bound_stands_as_one_in_every_table():
    """|L| is 0.91 at the last line, 8 Hz: the modulus margin is 0.09 at least."""
    verdict = verdict_on(np.arange(0.5, 8.5, 0.5), modulus_margin=0.5)
    (m,) = verdict.margins.values()
    assert 0.08 < m.modulus_margin < 0.1
    shown = f">= {m.modulus_margin:.4g}"
    _, columns, rows = margins_table(verdict)
    assert rows[0][columns.index("modulus margin [1]")] == shown
    assert shown in str(verdict)
    tables = markdown([verdict]).replace("\\>", ">")
    assert tables.count(f"| {shown} ") == 2


def test_what_is_open_below_the_first_line_is_measured_there():
    """A crossover at 6 Hz below lines from 12 Hz on: nothing is told of the peak of |CS| but where to measure."""
    verdict = verdict_on(np.arange(12.0, 60.0, 0.5), control_peak_db=6.0)
    (_, _, rows), *_ = verdict_tables(verdict)
    assert rows[1][3] == "undecided"
    assert "below the first frequency; measure down to 1.2 Hz" in rows[1][-1]
