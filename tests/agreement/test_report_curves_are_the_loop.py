"""What the report's plots hold is what the loop's responses are, by other routes; thinning keeps every extreme."""

import sys
from pathlib import Path

import numpy as np
import pytest

from loopshape.core.units import db
from loopshape.data.algebra import feedback
from loopshape.data.requirements import Requirements
from loopshape.loop.verdict import loops_of
from loopshape.view.curves import magnitude_band_db, thinned
from loopshape.view.html.axes import Scale, frequency_frame, linear_ticks, log_ticks
from loopshape.view.html.traces import embedded, loop_traces, plant_traces

sys.path.insert(0, str(Path(__file__).parents[1] / "flow"))
import report_run


@pytest.fixture(scope="module")
def loop_and_trace():
    frf = report_run.frf("near", 40.0, 0.1)
    loops, _ = loops_of([frf], report_run.controller(), Requirements("axis", integrators=1))
    return loops[0], loop_traces(loops, [frf])[0]


def test_magnitudes_are_those_of_the_closed_loop(loop_and_trace) -> None:
    loop, trace = loop_and_trace
    closed = feedback(loop.plant, loop.controller, connect="order")
    for name, same in (("S", closed.S_o), ("T", closed.T_o), ("PS", closed.PS), ("CS", closed.KS)):
        np.testing.assert_allclose(trace.size_db[name], db(same.siso), atol=1e-9)
    np.testing.assert_allclose(trace.size_db["L"], db(loop.L), atol=1e-12)


def test_bands_are_those_of_propagated_covariances(loop_and_trace) -> None:
    """First order by hand here, by the algebra of matrices there."""
    loop, trace = loop_and_trace
    closed = feedback(loop.plant, loop.controller, connect="order")
    for name, same in (("P", loop.plant), ("S", closed.S_o), ("T", closed.T_o)):
        low, high = magnitude_band_db(same)
        np.testing.assert_allclose(trace.size_db[name] + trace.up_db[name], high, atol=1e-9)
        np.testing.assert_allclose(trace.size_db[name] + trace.down_db[name], low, atol=1e-9)
    low, high = magnitude_band_db(closed.KS)
    np.testing.assert_allclose(trace.size_db["CS"] + trace.up_db["S"], high, atol=1e-9)
    low, high = magnitude_band_db(closed.PS)
    np.testing.assert_allclose(trace.size_db["PS"] + trace.down_db["T"], low, atol=1e-9)


def test_embedded_numbers_are_the_curves_to_a_hundredth(loop_and_trace) -> None:
    _, trace = loop_and_trace
    held = embedded([trace])[0]
    for name in ("P", "L", "S", "T", "CS", "PS"):
        np.testing.assert_allclose(held["db"][name], trace.size_db[name], atol=0.0051)
    np.testing.assert_allclose(held["deg"]["L"], trace.phase_deg["L"], atol=0.051)
    np.testing.assert_allclose(held["f"], trace.frequency_hz, rtol=1e-5)


def test_thinning_keeps_extremes_moves_nothing_and_stays_within_its_bound() -> None:
    rng = np.random.default_rng(5)
    f = np.linspace(0.1, 200.0, 20_000)
    curves = [rng.standard_normal(f.size).cumsum(), rng.standard_normal(f.size)]
    curves[1][7777] = 99.0  # a peak on a single line
    rows = thinned(f, curves, 600)
    assert 300 < rows.size <= 600
    assert np.all(np.diff(rows) > 0)
    assert {0, f.size - 1, 7777, int(np.argmin(curves[0]))} <= set(rows.tolist())
    np.testing.assert_array_equal(thinned(f[:600], [c[:600] for c in curves], 600), np.arange(600))


def test_many_lines_are_thinned_and_counted() -> None:
    frf = report_run.frf("near", 40.0, 0.1, lines=5000)
    trace = plant_traces([frf])[0]
    assert trace.lines == int(frf.trusted.sum())
    assert trace.frequency_hz.size <= 600
    assert set(trace.frequency_hz.tolist()) <= set(frf.frequency_hz.tolist())
    assert np.isin(frf.frequency_hz[~frf.trusted][-1], trace.dots[0])


def test_looks_tell_operating_points_apart() -> None:
    looks = [(t.colour, t.dash) for t in plant_traces(report_run.many(24))]
    assert len(set(looks)) == 24


def test_scales_put_values_where_their_axis_says() -> None:
    scale = Scale(1.0, 100.0, 50.0, 250.0, log=True)
    np.testing.assert_allclose(scale(np.array([1.0, 10.0, 100.0])), [50.0, 150.0, 250.0])
    frame = frequency_frame((1.0, 100.0), -40.0, 20.0, "|L| [dB]")
    ends = frame.y(np.array([-40.0, 20.0]))
    assert ends[0] > ends[1]  # upwards is up
    assert frame.path(np.array([1.0, 10.0, 100.0]), np.array([0.0, np.nan, 0.0])).count("M") == 2


@pytest.mark.parametrize(("low", "high"), [(-40.0, 20.0), (0.0, 3.0), (-0.2, 0.1), (-315.0, 90.0)])
def test_ticks_are_round_inside_and_few(low: float, high: float) -> None:
    ticks = linear_ticks(low, high)
    assert 3 <= len(ticks) <= 8
    assert all(low - 1e-9 <= t <= high + 1e-9 for t in ticks)
    assert log_ticks(0.5, 20.0) == pytest.approx((0.5, 1.0, 2.0, 5.0, 10.0, 20.0))
