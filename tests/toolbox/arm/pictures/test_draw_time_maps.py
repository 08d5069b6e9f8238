"""Time responses, equilibria, fitted parameters and verdicts: data, units, and what is left out."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import picture_nouns as nouns
import pytest
from conversions import deg
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet

import loopshape as ls
from loopshape.toolbox.arm import equilibria_pictures as equilibria
from loopshape.toolbox.rig import pictures as time
from loopshape.view.plots import fits

pytestmark = pytest.mark.short


def test_equilibria_load_no_pyplot() -> None:
    code = (
        "import sys; from loopshape.toolbox.arm import equilibria_pictures; print('matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def by_gid(ax: Axes, gid: str) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


def test_angles_are_shown_in_degrees_and_pressures_in_bar() -> None:
    recording = nouns.recording()
    figure = time.responses(recording, nouns.loop_setups())
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == [r"$\theta_{2}$ [deg]", "p [bar]", "control [V]", "pressure [bar]"]
    output, setpoint = figure.axes[0].lines
    assert np.allclose(output.get_ydata(), deg(recording.column("theta2_rad")))
    assert np.allclose(setpoint.get_ydata(), deg(recording.column("r_theta2_rad")))
    assert np.allclose(figure.axes[1].lines[0].get_ydata(), recording.output("p_a_bar + p_b_bar"))
    assert np.array_equal(output.get_xdata(), recording.column("t_s"))
    texts = [text.get_text() for text in figure.axes[3].get_legend().get_texts()]
    assert texts == ["$p_{A}$", "$p_{B}$", "p capacity"]
    assert figure.axes[-1].get_xlabel() == "time [s]"


def test_a_recording_without_time_stamps_setpoint_or_control_is_drawn() -> None:
    recording = nouns.recording(seconds=2.0)
    columns = {k: recording.columns[k] for k in ("theta2_rad", "u_a_v")}
    figure = time.responses(replace(recording, columns=columns), nouns.loop_setups()[:1])
    (ax,) = figure.axes
    assert len(ax.lines) == 1
    assert ax.lines[0].get_xdata()[-1] == pytest.approx(2.0 - 1e-3)


def grid() -> tuple[np.ndarray, np.ndarray]:
    p = np.linspace(0.2, 1.2, 41)
    angle = 50.0 * (p[None, :] - p[:, None])
    return p, np.where(np.abs(angle) > 40.0, np.nan, angle)


def contour_sets(ax: Axes) -> list[ContourSet]:
    return [c for c in ax.collections if isinstance(c, ContourSet)]


def test_contours_by_pressures_lie_where_the_angle_has_their_value() -> None:
    p, angle = grid()
    ax = equilibria.contours_by_pressures(p, p, angle, points=[{"p_a_bar": 0.5, "p_b_bar": 0.5}])
    sums, angles = contour_sets(ax)
    for level, path in zip(angles.levels, angles.get_paths(), strict=True):
        assert np.allclose(50.0 * (path.vertices[:, 0] - path.vertices[:, 1]), level)
    for level, path in zip(sums.levels, sums.get_paths(), strict=True):
        assert np.allclose(path.vertices.sum(axis=1), level)
    assert list(angles.levels) == [-40.0, -30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$p_{A}$ [bar]", "$p_{B}$ [bar]")
    assert by_gid(ax, "points")[0].get_xydata().tolist() == [[0.5, 0.5]]


def test_contours_by_angle_lie_where_the_pressures_have_their_value() -> None:
    theta, total = np.linspace(-40.0, 40.0, 41), np.linspace(0.2, 2.2, 31)
    spread = theta[None, :] / 100.0
    p_a, p_b = 0.5 * (total[:, None] + spread), 0.5 * (total[:, None] - spread)
    ax = equilibria.contours_by_angle(theta, total, p_a, p_b, points=[{"theta2_deg": 0.0, "p_ab_bar": 1.0}, {}])
    for sign, lines in zip((1.0, -1.0), contour_sets(ax), strict=True):
        for level, path in zip(lines.levels, lines.get_paths(), strict=True):
            x, y = path.vertices.T
            assert np.allclose(0.5 * (y + sign * x / 100.0), level)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"$\theta_{2}$ [deg]", "$p_{AB}$ [bar]")


def test_a_plane_without_equilibria_is_empty_and_silent() -> None:
    p, angle = grid()
    ax = equilibria.contours_by_pressures(p, p, np.full_like(angle, np.nan))
    assert len(contour_sets(ax)) == 1


def test_a_parameter_map_has_one_line_a_pressure_with_its_intervals() -> None:
    some = nouns.fits()
    ax = fits.parameter_map(some, "kappa")
    assert len(ax.containers) == 6
    first = sorted(
        (f for f in some if f.operating_point["p_ab_bar"] == 0.8), key=lambda f: f.operating_point["theta2_deg"]
    )
    line, _, (bars,) = ax.containers[0]
    assert np.allclose(line.get_ydata(), [f["kappa"].value for f in first])
    ends = np.array([segment[:, 1] for segment in bars.get_segments()])
    assert np.allclose(ends, [f["kappa"].interval for f in first])
    assert ax.get_ylabel() == r"$\kappa$ [rad/(V s³)]"
    assert ax.get_xlabel() == r"$\theta_{2}$ [deg]"
    assert ax.get_legend().get_title().get_text() == "$p_{AB}$ [bar]"


def test_a_setting_of_the_rig_stands_in_the_key_of_a_map_with_its_unit() -> None:
    some = nouns.fits()
    ax = fits.parameter_map([*some[:-1], replace(some[-1], rig_parameters={"supply_bar": 1.25})], "kappa")
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert sum(text.endswith(" (supply = 1.25 bar)") for text in texts) == 1


def test_a_fit_that_did_not_converge_is_hollow() -> None:
    some = [nouns.fit(-15.0, 1.0), nouns.fit(0.0, 1.0, "at_bound"), nouns.fit(15.0, 1.0)]
    ax = fits.parameter_map(some, "f_hz")
    (hollow,) = by_gid(ax, "not converged")
    assert hollow.get_ydata() == [some[1]["f_hz"].value]
    assert ax.get_ylabel() == "f [Hz]"


def test_fits_without_operating_points_stand_by_recording() -> None:
    some = [replace(fit, operating_point={}) for fit in nouns.fits()[:3]]
    ax = fits.parameter_map(some, "zeta")
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["r01", "r02", "r03"]
    assert ax.get_ylabel() == r"$\zeta$"


def test_a_map_without_fits_is_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="needs fits"):
        fits.parameter_map([], "kappa")
