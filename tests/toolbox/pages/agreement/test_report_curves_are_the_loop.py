"""What the report's plots hold is what the loop's responses are, by other routes; thinning keeps every extreme."""

import re
from base64 import b64decode

import numpy as np
import pytest
import report_run
from conversions import db
from page_in_browser import browser

import loopshape as ls
from loopshape.data.algebra import feedback
from loopshape.loop.loops import loops_of
from loopshape.toolbox.pages.report.page import page
from loopshape.toolbox.pages.report.report_inputs import gather
from loopshape.toolbox.pages.report.traces import embedded, loop_traces, plant_traces
from loopshape.view.plots.curves import magnitude_band_db, thinned


@pytest.fixture(scope="module")
def loop_and_trace():
    frf = report_run.frf("near", 40.0, 0.1)
    loops, _ = loops_of([frf], report_run.controller(), ls.Requirements("axis", integrators=1))
    return loops[0], loop_traces(loops, [frf])[0]


def test_relative_half_widths_are_those_of_propagated_covariances(loop_and_trace) -> None:
    """First order by hand here, by the algebra of matrices there."""
    loop, trace = loop_and_trace
    closed = feedback(loop.plant, loop.controller, connect="order")
    pairs = (("P", loop.plant), ("S", closed.S_o), ("T", closed.T_o), ("S", closed.KS), ("T", closed.PS))
    for name, same in pairs:
        np.testing.assert_allclose(
            db(np.abs(same.siso) * (1.0 + trace.half_width[name])), magnitude_band_db(same)[1], atol=1e-9
        )


def test_embedded_arrays_are_the_loop(loop_and_trace) -> None:
    loop, trace = loop_and_trace
    held = embedded([trace])[0]
    plant, controller = (np.frombuffer(b64decode(held[name]["c16"]), "<c16") for name in "PC")
    np.testing.assert_allclose(plant * controller, loop.L, rtol=1e-12)
    np.testing.assert_array_equal(np.frombuffer(b64decode(held["f"]["f8"]), "<f8"), loop.frequency_hz)


@pytest.mark.long
def test_what_the_page_reads_off_is_the_closed_loop_with_its_bands(loop_and_trace, tmp_path) -> None:
    """In the browser, on some frequencies, against the algebra of matrices."""
    loop, _ = loop_and_trace
    closed = feedback(loop.plant, loop.controller, connect="order")
    responses = {"P": loop.plant, "S": closed.S_o, "T": closed.T_o, "CS": closed.KS, "PS": closed.PS}
    html = page(
        gather(report_run.whole_run(tmp_path / "run"), tmp_path / "controller.toml", tmp_path / "require.toml", "x")
    )
    (tmp_path / "report.html").write_text(html)
    with browser() as made:
        shown = made.new_page()
        shown.goto((tmp_path / "report.html").as_uri())
        shown.locator(".legend label", has_text="far-away").locator("input").uncheck()
        plot = shown.locator('canvas[data-plot="S-db"]')
        for key in ("ArrowRight", "Home", "Shift+ArrowRight", "End"):
            plot.press(key)
            words = shown.locator(".readout").text_content().replace("\N{MINUS SIGN}", "-")
            hz = float(re.search(r"at ([\d.]+) Hz", words)[1])
            k = int(np.argmin(np.abs(loop.frequency_hz - hz)))
            assert loop.frequency_hz[k] == pytest.approx(hz, rel=1e-5)
            for name, same in responses.items():
                low, high = magnitude_band_db(same)
                found = re.search(rf"\|{name}\| (\S+) dB \((\S+) … (\S+)\)", words).groups()
                np.testing.assert_allclose([float(x) for x in found], [db(same.siso)[k], low[k], high[k]], atol=0.0051)


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
    assert trace.lines == int(frf.valid.sum())
    assert trace.frequency_hz.size <= 600
    assert set(trace.frequency_hz.tolist()) <= set(frf.frequency_hz.tolist())
    assert np.isin(frf.frequency_hz[~frf.valid][-1], trace.dots[0])


def test_looks_tell_operating_points_apart() -> None:
    looks = [(t.colour, t.dash) for t in plant_traces(report_run.many(24))]
    assert len(set(looks)) == 24
