"""Figures become files that are whole, the same every time, and need no display."""

import subprocess
import sys
from dataclasses import replace

import matplotlib as mpl
import picture_nouns as nouns
import pytest

from loopshape.view import frequency
from loopshape.view.key import key_of, varying
from loopshape.view.labels import decibel, number, numbers, product, quantity, ratio, superscripts, symbol, unit_of
from loopshape.view.style import png, shades


def test_the_same_figure_gives_the_same_bytes() -> None:
    first, second = (png(frequency.frf_page(nouns.frf(), nouns.fit())) for _ in "ab")
    assert first == second
    assert first.startswith(b"\x89PNG")
    assert b"Software" not in first


def test_the_look_does_not_leak_into_the_callers_matplotlib() -> None:
    before = dict(mpl.rcParams)
    frequency.frf_page(nouns.frf())
    assert dict(mpl.rcParams) == before


def test_no_picture_loads_pyplot() -> None:
    rooms = "equilibria, fits, frequency, loops, style, time, verdicts"
    code = f"import sys; from loopshape.view import {rooms}; print('matplotlib.pyplot' in sys.modules)"
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
