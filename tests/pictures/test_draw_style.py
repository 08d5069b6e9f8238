"""Figures become files that are whole, the same every time, and need no display."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import picture_nouns as nouns
import pytest

from loopshape.draw import frequency
from loopshape.draw.key import key_of, varying
from loopshape.draw.labels import decibel, number, numbers, product, quantity, ratio, superscripts, symbol, unit_of
from loopshape.draw.style import new_figure, save, shades
from loopshape.errors import WrongUseError


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (save(frequency.frf_page(nouns.frf(), nouns.fit()), tmp_path / f"{k}.png") for k in "ab")
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes().startswith(b"\x89PNG")
    assert b"Software" not in first.read_bytes()


def test_a_file_is_whole_or_absent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = new_figure()
    path = save(figure, tmp_path / "kept.png")
    before = path.read_bytes()

    def breaks(target: Path, **_: object) -> None:
        Path(target).write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(figure, "savefig", breaks)
    with pytest.raises(OSError, match="disk full"):
        save(figure, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["kept.png"]


def test_only_png_is_written(tmp_path: Path) -> None:
    with pytest.raises(WrongUseError, match="PNG"):
        save(new_figure(), tmp_path / "figure.jpg")


def test_the_look_does_not_leak_into_the_callers_matplotlib() -> None:
    before = dict(mpl.rcParams)
    frequency.frf_page(nouns.frf())
    assert dict(mpl.rcParams) == before


def test_no_picture_loads_pyplot() -> None:
    rooms = "equilibria, fits, frequency, loops, style, time, verdicts"
    code = f"import sys; from loopshape.draw import {rooms}; print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_shades_differ() -> None:
    for n in (1, 2, 5, 6, 24):
        assert len(set(shades(n))) == n


def test_a_key_of_two_quantities_gives_colour_and_marker() -> None:
    frfs = nouns.frfs()
    assert varying(frfs) == ["theta2_deg", "p_ab_bar"]
    key = key_of(frfs)
    assert len({(look["color"], look["marker"]) for look in key.looks}) == 24
    same_angle = {
        look["color"] for frf, look in zip(frfs, key.looks, strict=True) if not frf.operating_point["theta2_deg"]
    }
    assert len(same_angle) == 1


def test_a_key_of_one_quantity_names_the_other_once() -> None:
    key = key_of([nouns.frf(theta, 1.2) for theta in (-15.0, 0.0, 15.0)])
    assert len(key.rows) == 1
    assert key.common == "$p_{AB}$ = 1.2 bar"


@pytest.mark.parametrize("point", [{}, {"load_kg": 1.0}])
def test_a_key_without_operating_points_falls_back_on_recordings(point: dict) -> None:
    items = [replace(frf, operating_point=point) for frf in nouns.frfs()]
    key = key_of(items)
    texts = [text for row in key.rows for text, _ in row]
    assert texts == [frf.recording for frf in items]
    assert len({(look["color"], look["marker"]) for look in key.looks}) == 24


def test_repeats_of_one_operating_point_are_told_apart_by_recording() -> None:
    key = key_of([nouns.frf(), replace(nouns.frf(), recording="r08b"), nouns.frf(15.0, 1.0)])
    assert [text for text, _ in key.rows[0]] == ["r08", "r08b", "r09"]


def test_names_and_units_are_written_as_on_paper() -> None:
    assert quantity("theta2_deg") == r"$\theta_{2}$ [deg]"
    assert quantity("p_ab_bar") == "$p_{AB}$ [bar]"
    assert quantity("position_m") == "position [m]"
    assert symbol("z_theta2") == r"$z_{\theta_{2}}$"
    assert symbol("z_p_a") == "$z_{p,A}$"
    assert unit_of("p_a_bar + p_b_bar") == "bar"
    assert unit_of("whatever") == "1"
    assert ratio("rad", "V") == "rad/V"
    assert ratio("rad", "N m") == "rad/(N m)"
    assert ratio("bar", "bar") == ""
    assert product("V", "V") == "V²"
    assert product("V", "rad") == "V rad"
    assert decibel("|S|", "") == "|S| [dB]"
    assert superscripts("rad/(V s3)") == "rad/(V s³)"
    assert number(-30.0) == "\N{MINUS SIGN}30"
    assert numbers([0.8, 1.0, 1.2]) == ["0.8", "1.0", "1.2"]
    assert numbers([-30.0, 0.0]) == ["\N{MINUS SIGN}30", "0"]
