"""The page of effects: rows, labels, units and what is plotted; and the numbers of a sheet."""

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.arm.effects_page import effects_page
from loopshape.toolbox.gap.nouns.effect import EffectForm, Free
from loopshape.toolbox.gap.nouns.effect_sheet import EffectSheet, FrfChange, TimeChange
from loopshape.view.style import png

F = np.geomspace(0.15, 15.0, 30)


def change(factor: complex, noise: float = 0.01) -> FrfChange:
    without = 1.0 / (1j * F)
    return FrfChange(F, without, factor * without, np.full(F.size, noise))


def sheet(name: str = "joint_friction", factor: complex = 2.0 * np.exp(-0.2j)) -> EffectSheet:
    form = EffectForm(name, "tanh", "joint", "N m", (Free("coulomb_nm", 0.0, 1.0, (0.1,)),))
    paths = ("u -> theta2", "u -> p", "p -> theta2")
    frfs = {(recording, path): change(factor) for recording in ("small", "large") for path in paths}
    t = np.arange(0.0, 9.0, 0.02)
    flat = np.full(t.size, np.radians(10.0))
    ramp = np.radians(25.0) * np.sin(0.7 * t)
    times = {
        ("statics", "p_d"): TimeChange(t, np.zeros(t.size), np.full(t.size, 0.02)),
        ("statics", "theta2"): TimeChange(t, ramp, ramp),
        ("steps", "theta2"): TimeChange(t, flat, flat + np.radians(1.5)),
    }
    return EffectSheet(form, 0.12, frfs, times)


def test_a_sheet_s_numbers():
    c = change(2.0 * np.exp(-0.2j))
    np.testing.assert_allclose(c.gain_db, 20.0 * np.log10(2.0))
    np.testing.assert_allclose(c.phase_deg, -np.degrees(0.2))
    assert c.between(1.0, 5.0).frequency_hz.min() >= 1.0
    assert change(1.1, noise=0.0).size == pytest.approx(0.1)
    assert change(1.1, noise=0.06).size == pytest.approx(0.08)  # what noise gives is taken off
    assert change(1.0, noise=0.5).size == 0.0
    assert np.isnan(c.between(50.0, 60.0).size)
    assert TimeChange(np.arange(3.0), np.zeros(3), np.array([0.0, -2.0, 1.0])).largest == 2.0


def test_a_row_an_effect_and_six_panels_a_row():
    figure = effects_page([sheet("joint_friction"), sheet("payload")])
    assert len(figure.axes) == 12
    names = [t.get_text() for ax in figure.axes for t in ax.texts if t.get_gid() == "effect"]
    assert names == ["joint friction, 0.12 N m", "payload, 0.12 N m"]


def test_panels_hold_what_changes_in_their_units():
    gain, phase, *_, statics, step = effects_page([sheet()]).axes
    for ax, level in ((gain, 20.0 * np.log10(2.0)), (phase, -np.degrees(0.2))):
        lines = {line.get_gid(): line.get_ydata() for line in ax.lines}
        assert set(lines) == {"large", "small"}
        np.testing.assert_allclose(lines["large"], level)
    np.testing.assert_allclose(statics.lines[0].get_ydata(), 20.0)  # mbar
    assert np.abs(statics.lines[0].get_xdata()).max() == pytest.approx(25.0, abs=0.5)  # deg
    np.testing.assert_allclose(step.lines[0].get_ydata(), 1.5)  # deg


def test_headings_name_quantities_and_units():
    titles = [ax.texts[-1].get_text() for ax in effects_page([sheet()]).axes]
    assert [t.split("\n")[1] for t in titles] == [
        "[dB over Hz]", "[deg over Hz]", "[dB over Hz]", "[deg over Hz]", "[mbar over deg]", "[deg over s]",
    ]  # fmt: skip


def test_scales_are_symmetric_wide_enough_and_bounded():
    for factor, least, most in ((1.0, 2.0, 2.0), (2.0, 6.0, 12.0), (1e3, 12.0, 12.0)):
        low, high = effects_page([sheet(factor=factor)]).axes[0].get_ylim()
        assert low == -high
        assert least <= high <= most


def test_a_path_without_known_lines_leaves_its_panel_empty():
    one = sheet()
    del one.frfs["small", "u -> p"]
    assert [line.get_gid() for line in effects_page([one]).axes[2].lines] == ["large"]


def test_it_prints():
    assert png(effects_page([sheet()])).startswith(b"\x89PNG")


def test_a_page_without_sheets_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="a page of effects needs a sheet"):
        effects_page([])
