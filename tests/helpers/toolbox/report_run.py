"""A small run with everything that a report shows: two operating points of a known plant, and words that break out."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from bench_nouns import Block, LoopSetup, RecordingInfo
from conversions import TWO_PI
from run_files import write_fits, write_frfs

import loopshape as ls
from loopshape.identify.fit import fit, structure_by_name
from loopshape.toolbox.pages.report.page import page
from loopshape.toolbox.pages.report.report_inputs import gather
from loopshape.view.plots.frequency import frf_page
from loopshape.view.style import new_figure, png

RATE = 500.0
HOSTILE = "</script><script>document.title='owned'</script><!-- & \"quoted\" 'single'"
CONTROLLER = """format = "loopshape-controllers/1"
rate_hz = 500.0
# a comment with </script><script>document.title='owned'</script>
[[loop]]
name = "axis"
controller = [{ kind = "gain", gain = 1.5 }, { kind = "low_pass", order = 1, f_hz = 60.0 }]
"""
REQUIRE = """format = "loopshape-requirements/1"
[[loop]]
name = "axis"
integrators = 1
phase_margin_deg = 30.0
sensitivity_peak_db = 8.0
complementary_peak_db = 8.0
control_high_frequency_db = 20.0
control_high_frequency_from_hz = 30.0
bandwidth_hz = {bandwidth}
"""

RESONANCE = """
format = "loopshape-requirements/1"

[[loop]]
name = "axis"
sensitivity_peak_db = 6.0
unstable_poles = 0
integrators = 0
"""


def plant(f: np.ndarray, gain: float) -> np.ndarray:
    """gain/(s (s/w + 1)), a corner at 20 Hz."""
    s = 2j * np.pi * f
    return gain / (s * (s / (TWO_PI * 20.0) + 1.0))


def frf(name: str, gain: float, where_m: float, lines: int = 240) -> ls.FRF:
    """An FRF of the known plant, which is stable, 2 % noise, the last lines not valid."""
    rng = np.random.default_rng(round(1000 * gain))
    f = np.linspace(0.25, 60.0, lines)
    truth = plant(f, gain)
    noise = 0.02 * np.abs(truth) * (rng.standard_normal(lines) + 1j * rng.standard_normal(lines)) / np.sqrt(2.0)
    return ls.FRF(
        f, (truth + noise)[:, None, None], (0.02 * np.abs(truth))[:, None, None].astype(complex) ** 2, f < 55.0,
        ("z_v",), ("y_m",), "local polynomials, <b>bold</b>", name, "axis", RATE, {"where_m": where_m},
        notes=(HOSTILE,), open_loop=True,
    )  # fmt: skip


def recording(name: str, where_m: float) -> ls.Recording:
    rng = np.random.default_rng(len(name))
    n = rng.standard_normal(2000)
    y = np.convolve(n, np.ones(5) / 5.0, mode="same")
    y[700] += 40.0  # a fault that a report must name
    columns = {"r_m": np.zeros(2000), "n_m": n, "z_v": 2.0 * n - y, "y_m": y}
    info = RecordingInfo(
        f"{name}.parquet", "noise", "controller_input", excites="axis", operating_point={"where_m": where_m}
    )
    return ls.Recording(info, RATE, columns)


def recordings_only(folder: Path) -> Path:
    """A run of two recordings; its note tries to break out."""
    loops = (LoopSetup("axis", "r_m", "n_m", "z_v", "y_m", None),)
    made = (recording("near", 0.1), recording("far-away", 0.4))
    ls.write(ls.Run(RATE, loops, made, extra={"notes": [HOSTILE]}), folder)
    return folder


def whole_run(folder: Path) -> Path:
    """Recordings, FRFs, fits and pictures; controller and requirements beside it."""
    recordings_only(folder)
    frfs = [frf("near", 40.0, 0.1), frf("far-away", 25.0, 0.4)]
    write_frfs(folder, frfs)
    write_fits(folder, [fit(one, structure_by_name("integrator")) for one in frfs])
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    figure = new_figure(1, 1, (2.0, 1.5))
    figure.axes[0].plot([0.0, 1.0])
    (figures / "nichols_axis.png").write_bytes(png(figure))
    (figures / "drawn.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><script>alert(1)</script></svg>')
    (figures / "zz_large.png").write_bytes(png(figure) + bytes(2_000_000))
    (figures / "no_picture.png").write_text("text")
    (folder.parent / "controller.toml").write_text(CONTROLLER)
    (folder.parent / "require.toml").write_text(REQUIRE.format(bandwidth=2.0))
    (folder.parent / "wild.toml").write_text(REQUIRE.format(bandwidth=200.0))
    return folder


def controller() -> ls.Controller:
    return ls.Controller("axis", (Block("gain", {"gain": 1.5}), Block("low_pass_1", {"f_hz": 60.0})), RATE)


def many(count: int) -> list[ls.FRF]:
    """FRFs of many operating points."""
    return [replace(frf(f"r{k:02d}", 20.0 + k, 0.01 * k, 120), recording=f"r{k:02d}") for k in range(count)]


def page_of_points(folder: Path, count: int, note: str, date: str) -> str:
    """The page of a run of so many operating points, checked, each with 240 lines, a note and a picture."""
    names = [f"r{k:02d}" for k in range(count)]
    loops = (LoopSetup("axis", "r_m", "n_m", "z_v", "y_m", None),)
    made = tuple(recording(name, 0.01 * k) for k, name in enumerate(names))
    ls.write(ls.Run(RATE, loops, made), folder)
    frfs = [
        replace(frf(name, 20.0 + k, 0.01 * k, 240), notes=(note.format(k),), recording=name)
        for k, name in enumerate(names)
    ]
    write_frfs(folder, frfs)
    (folder / "figures").mkdir()
    picture = png(frf_page(frfs[0]))
    for name in names:
        (folder / "figures" / f"frf_axis_{name}.png").write_bytes(picture)
    (folder.parent / "controller.toml").write_text(CONTROLLER)
    (folder.parent / "require.toml").write_text(REQUIRE.format(bandwidth=2.0))
    return page(gather(folder, folder.parent / "controller.toml", folder.parent / "require.toml", date))


def on_a_resonance(folder: Path, date: str, author: str) -> Any:
    """A lag with a resonance at 40 Hz of damping 0.005, under a controller whose notch stands exactly on it."""
    f_hz, w = np.geomspace(0.5, 200.0, 600), TWO_PI * 40.0
    s = 1j * TWO_PI * f_hz
    H = w**2 / ((s + 1.0) * (s**2 + 0.01 * w * s + w**2))
    write_frfs(folder, [ls.FRF.from_arrays(f_hz, H, relative_std=0.002, rate_hz=2000.0, loop="axis", recording="one")])
    C = ls.controller(ls.gain(60.0), ls.notch(40.0, 0.005, 0.5), rate_hz=2000.0, loop="axis")
    ls.write(C, folder / "c.toml")
    (folder / "r.toml").write_text(RESONANCE)
    return gather(folder, folder / "c.toml", folder / "r.toml", date, author=author)
