"""Figures become files that are whole, the same every time, and need no display."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import picture_nouns as nouns
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from text_layout import look_at_each_png, looked_at, unreadable

from loopshape.view.key import key_of, varying
from loopshape.view.labels import (
    decibel,
    method_in_short,
    methods_by_loop,
    number,
    numbers,
    point,
    product,
    quantity,
    ratio,
    superscripts,
    symbol,
    unit_of,
)
from loopshape.view.plots import frequency
from loopshape.view.style import head, new_figure, png, shades

OVERLAPPING = Figure()  # made here, where the eye on a test's figures does not see it


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
    code = (
        "import sys; from loopshape.view import style; from loopshape.view.plots import fits, frequency, loops;"
        " from loopshape.view.verdict import verdicts; print('matplotlib.pyplot' in sys.modules)"
    )
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


def test_a_key_of_24_points_of_one_quantity_is_broken_into_lines_that_fit() -> None:
    frfs = [replace(frf, operating_point={"payload_kg": 0.5 + 0.125 * k}) for k, frf in enumerate(nouns.frfs())]
    figure = frequency.frf_overview(frfs)
    (key,) = figure.legends
    texts = [text.get_text() for text in key.get_texts() if text.get_text()]
    assert set(texts) == {"payload [kg]", *(f"{0.5 + 0.125 * k:.3f}" for k in range(24))}
    assert key._ncols < 12
    assert unreadable(figure) == []


@pytest.mark.parametrize("at", [{}, {"load_kg": 1.0}])
def test_a_key_without_operating_points_falls_back_on_recordings(at: dict) -> None:
    items = [replace(frf, operating_point=at) for frf in nouns.frfs()]
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
    assert point({"payload_kg": 2.3784142, "p_ab_bar": 1.0}) == "payload = 2.378 kg, $p_{AB}$ = 1 bar"
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


def sweeps() -> list:
    """24 FRFs whose methods differ in windows, rationals and harmonics, as those of the demo."""
    return [
        replace(
            frf,
            method=f"reference estimator, local fits of a sweep of 202.5 s, windows of 0.0543 to {1 + 0.1 * k:.2g} Hz, "
            f"{26 + k} % of lines by rationals, without the sweep's harmonics 2, 3",
            method_numbers={"sweep_s": 202.5, "rationals_percent": 26.0 + k},
        )
        for k, frf in enumerate(nouns.frfs())
    ]


def test_many_methods_are_one_line_with_ranges_and_one_method_stands_in_full() -> None:
    frfs = sweeps()
    assert method_in_short(frfs) == "24 estimates: local fits of sweeps of 202.5 s, 26-49 % rationals"
    assert method_in_short(frfs[:1]) == method_in_short(frfs[:1] * 2) == frfs[0].method
    assert method_in_short([]) == ""
    periodic = [replace(frfs[0], method=f"{n} periods", method_numbers={"periods": n, "period_s": 4.0}) for n in (5, 7)]
    foreign = [replace(frfs[0], method=name, method_numbers={}) for name in ("of A", "of B")]
    assert method_in_short([*frfs[:2], *periodic, *foreign]) == (
        "2 estimates: local fits of sweeps of 202.5 s, 26-27 % rationals; 2 estimates: 5-7 periods of 4 s; "
        "2 estimates by 2 methods"
    )
    pressures = [replace(frf, loop="p_ab") for frf in frfs[:2]]
    assert methods_by_loop([*frfs[2:5], *pressures])[1] == (
        "p_ab: 2 estimates: local fits of sweeps of 202.5 s, 26-27 % rationals"
    )


def test_24_methods_leave_both_axes_of_the_overview_free() -> None:
    figure = frequency.frf_overview(sweeps(), nouns.fits())
    details = [text.get_text() for text in figure.texts]
    assert details[1:] == ["24 estimates: local fits of sweeps of 202.5 s, 26-49 % rationals"]
    assert unreadable(figure) == []


def test_a_long_head_makes_the_figure_taller_and_leaves_the_axes_their_room() -> None:
    short, long = (frequency.frf_page(replace(nouns.frf(), notes=notes)) for notes in ((), ("a note " * 40,) * 12))
    assert unreadable(long) == []
    heights = [figure.axes[0].get_position().height * figure.get_figheight() for figure in (short, long)]
    assert heights[1] > 0.8 * heights[0]


def test_text_over_axes_over_text_and_beyond_the_frame_is_found() -> None:
    figure = new_figure(1, 1, (4.0, 3.0))
    (ax,) = figure.axes
    ax.text(0.5, 0.5, "in its own axes", transform=ax.transAxes)
    head(figure, "a title")
    assert unreadable(figure) == []
    figure.text(0.5, 0.5, "a caption over the plot")
    figure.text(0.9, 0.0, "beyond the right edge of the figure")
    found = "; ".join(unreadable(figure))
    assert "'a caption over the plot' over the axes" in found
    assert "'in its own axes' over 'a caption over the plot'" in found
    assert "'beyond the right edge of the figure' is cut" in found
    figure.clear()  # each figure of these tests is looked at


def test_a_process_of_a_test_that_writes_a_png_which_cannot_be_read_ends_with_an_error(tmp_path: Path) -> None:
    draws = "f = Figure(figsize=(4.0, 3.0)); f.text({}, 0.5, 'a line of words'); f.savefig('f.png')"
    for x, told in (("0.1", ""), ("0.9", "'a line of words' is cut")):
        code = f"from matplotlib.figure import Figure; {draws.format(x)}"
        words = [sys.executable, "-c", code]
        done = subprocess.run(words, cwd=tmp_path, env=looked_at(), capture_output=True, text=True, check=False)
        assert (done.returncode == 0) == (not told)
        assert told in done.stderr


def test_what_png_writes_is_looked_at(monkeypatch):
    """However figures become bytes: one that cannot be read must reach the eye of tests and studies."""
    bare = getattr(FigureCanvasAgg.print_png, "__wrapped__", FigureCanvasAgg.print_png)
    monkeypatch.setattr(FigureCanvasAgg, "print_png", bare)
    seen: list[str] = []
    look_at_each_png(seen.extend)
    for words in ("one", "two"):
        OVERLAPPING.text(0.5, 0.5, words)
    png(OVERLAPPING)
    assert seen == ["'one' over 'two'"]
