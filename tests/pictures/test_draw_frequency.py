"""Frequency pictures show the FRF's own numbers, in the units that their labels say."""

import numpy as np
import picture_nouns as nouns
import pytest
from conversions import angular, db, rad
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

import loopshape as ls
from loopshape.view.plots import frequency
from loopshape.view.plots.curves import magnitude_band_db, unwrapped_deg
from loopshape.view.style import new_figure

MODEL_FREE = {"coherence": None, "input_power": None, "output_power": None, "cross_power": None}


def by_gid(ax: Axes, gid: str) -> list:
    return [artist for artist in (*ax.lines, *ax.patches, *ax.artists) if artist.get_gid() == gid]


def curve(ax: Axes) -> Line2D:
    return next(line for line in ax.lines if line.get_gid() is None)


def test_the_magnitude_is_the_trusted_response_in_decibel() -> None:
    frf = nouns.frf()
    ax = frequency.magnitude(frf)
    x, y = curve(ax).get_data()
    assert np.array_equal(x, frf.frequency_hz[frf.valid])
    assert np.array_equal(y, db(frf.siso)[frf.valid])
    assert ax.get_ylabel() == "magnitude [dB re rad/V]"
    assert ax.get_xlabel() == "frequency [Hz]"
    assert ax.get_xscale() == "log"


def test_lines_outside_the_valid_band_are_faint_and_do_not_stretch_the_axes() -> None:
    frf = nouns.frf()
    ax = frequency.magnitude(frf)
    (dots,) = by_gid(ax, "not valid")
    assert np.array_equal(dots.get_xdata(), frf.frequency_hz[~frf.valid])
    assert dots.get_alpha() < 0.5
    assert ax.get_xlim()[1] < frf.frequency_hz[-1]
    assert ax.dataLim.x1 == frf.valid_band_hz[1]


def test_the_band_holds_95_of_100_magnitudes() -> None:
    truth = db(nouns.model(0.0, 1.0).response(nouns.frf().frequency_hz))
    inside = []
    for seed in range(20):
        frf = nouns.frf(seed=1000 * seed)
        low, high = magnitude_band_db(frf)
        inside.append(((low < truth) & (truth < high))[frf.valid])
    assert np.mean(inside[0]) > 0.8
    assert np.mean([i.mean() for i in inside]) == pytest.approx(0.95, abs=0.01)


def test_a_band_wider_than_the_response_goes_to_the_floor_without_a_warning() -> None:
    low, high = magnitude_band_db(nouns.frf(noise=2.0))
    assert low.min() == -400.0
    assert np.isfinite(high).all()


def test_the_band_can_be_left_out() -> None:
    assert len(by_gid(frequency.magnitude(nouns.frf()), "band")) == 1
    assert not by_gid(frequency.magnitude(nouns.frf(), band=False), "band")


def test_the_phase_of_an_integrating_plant_goes_from_minus_90_to_minus_270() -> None:
    frf = nouns.frf()
    ax = frequency.phase(frf)
    _, y = curve(ax).get_data()
    assert y[0] == pytest.approx(-90.0, abs=10.0)
    assert y[-1] == pytest.approx(-270.0, abs=15.0)
    assert ax.get_ylabel() == "phase [deg]"


@pytest.mark.parametrize("start", [90.0, 0.0, -90.0, -180.0, -269.0])
@pytest.mark.parametrize("noise_turns", [0.0, 3.0])
def test_the_phase_is_exact_on_trusted_lines_whatever_the_others_hold(start: float, noise_turns: float) -> None:
    phase = np.linspace(start, start - 700.0, 200)
    valid = np.ones(200, dtype=bool)
    valid[[0, 1, 60, 61, 62, 150, 190]] = False
    phase = phase + (start - phase[2])
    wrong = np.where(valid, 0.0, noise_turns * 111.0)
    found = unwrapped_deg(np.exp(1j * rad(phase + wrong)), valid)
    assert np.allclose(found[valid], phase[valid])
    assert np.all(np.abs(found - phase) <= 200.0)


def test_the_phase_without_any_trusted_line_is_still_drawn() -> None:
    frf = nouns.frf(valid=np.zeros(nouns.frf().frequency_hz.size, dtype=bool))
    figure = frequency.frf_page(frf)
    assert len(by_gid(figure.axes[2], "not valid")) == 1


def test_coherence_and_spectra_show_the_estimators_own() -> None:
    frf = nouns.frf()
    assert np.array_equal(curve(frequency.coherence(frf)).get_ydata(), frf.coherence[frf.valid])
    ax = frequency.spectra(frf)
    drawn = [line.get_ydata() for line in ax.lines]
    assert np.array_equal(drawn[0], frf.input_power)
    assert np.array_equal(drawn[1], frf.output_power)
    assert np.array_equal(drawn[2], np.abs(frf.cross_power))
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert [text.split(" [")[1] for text in texts] == ["V²]", "rad²]", "V rad]"]
    assert ax.get_yscale() == "log"


def test_an_estimator_without_coherence_says_so() -> None:
    frf = nouns.frf(**MODEL_FREE)
    assert "no coherence" in frequency.coherence(frf).texts[0].get_text()
    assert "no spectra" in frequency.spectra(frf).texts[0].get_text()


def test_the_page_names_loop_recording_point_method_and_fit() -> None:
    figure = frequency.frf_page(nouns.frf(notes=("two lines were lost",)), nouns.fit())
    title, *details = [text.get_text() for text in figure.texts]
    assert title == (
        r"FRF $\theta_{2}$ / $z_{\theta_{2}}$  ·  loop $\theta_{2}$  ·  r08  ·  $\theta_{2}$ = 0 deg, $p_{AB}$ = 1 bar"
    )
    assert details[0].startswith("local polynomial")
    assert r"$\zeta$ = 0.0650 ± 0.0078 (95 %)" in details[1]
    assert r"$\kappa$ = 1480 ± 35 rad/(V s³)" in details[1]
    assert details[-1] == "two lines were lost"
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == ["magnitude [dB re rad/V]", "power spectra, per Hz", "phase [deg]", "coherence [1]"]


def test_the_fit_lies_on_its_band_and_on_the_turn_of_the_measured_phase() -> None:
    frf, fit = nouns.frf(), nouns.fit()
    a, _, b, _ = frequency.frf_page(frf, fit).axes
    (dashed,) = [line for line in a.lines if line.get_linestyle() == "--"]
    f = dashed.get_xdata()
    assert (f[0], f[-1]) == pytest.approx(fit.band_hz)
    assert np.allclose(dashed.get_ydata(), db(fit.model.response(f)))
    moved = nouns.frf(response=-frf.response)  # a turn of 180 degrees puts measured and fitted phase half a turn apart
    _, _, b, _ = frequency.frf_page(moved, fit).axes
    (dashed,) = [line for line in b.lines if line.get_linestyle() == "--"]
    assert abs(dashed.get_ydata()[0] - curve(b).get_ydata()[0]) == pytest.approx(180.0, abs=15.0)


def test_the_overview_draws_every_operating_point_and_its_key_splits_angle_and_pressure() -> None:
    frfs = nouns.frfs()
    figure = frequency.frf_overview(frfs, nouns.fits())
    top, bottom = figure.axes
    for ax in (top, bottom):
        assert len([line for line in ax.lines if line.get_gid() is None]) == 48
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[0] == r"$\theta_{2}$ [deg]"
    assert texts[1] == "$p_{AB}$ [bar]"
    assert len([t for t in texts if t]) == 2 + 5 + 6
    looks = {(line.get_color(), line.get_marker()) for line in top.lines if line.get_linestyle() == "-"}
    assert len(looks) == 24


def test_a_picture_draws_into_the_axes_it_is_given() -> None:
    figure = new_figure(1, 2)
    left, right = figure.axes
    assert frequency.magnitude(nouns.frf(), ax=left) is left
    assert frequency.phase(nouns.frf(), ax=right) is right
    assert figure.axes == [left, right]


def test_an_overview_without_frfs_or_with_too_few_fits_is_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="0 FRFs"):
        frequency.frf_overview([])
    with pytest.raises(ls.errors.WrongUseError, match="2 FRFs and 1 fits"):
        frequency.frf_overview(nouns.frfs()[:2], nouns.fits()[:1])


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.3, 3.0])
def test_phase_ticks_stay_readable_however_long_the_delay(delay_s: float) -> None:
    frf = nouns.frf()
    late = np.exp(-1j * angular(frf.frequency_hz) * delay_s)[:, None, None]
    ax = frequency.phase(nouns.frf(response=frf.response * late))
    low, high = ax.get_ylim()
    ticks = [tick for tick in ax.get_yticks() if low <= tick <= high]
    assert 3 <= len(ticks) <= 7
    assert all(tick % 45.0 == 0.0 for tick in ticks)
