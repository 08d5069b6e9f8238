"""Real machines' FRFs under controllers that are drawn: what a user asks of a recording, its truth unknown."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.data.algebra.propagation import pick
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.matrix.matrix import estimate_matrix
from loopshape.identify.settings import Settings
from loopshape.toolbox.formats.tables.import_file import import_file

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data"))
#: an element is used where it is known so well on so many lines
FEWEST = 12
#: |L| is placed at 1 at so many of an element's lines, each under a controller of its own
CROSSINGS, TRIED = 6, 60
#: poles at 0 Hz less zeros there, by the physics of each machine
INTEGRATORS = {"suspension": 0, "motor bench": 2, "CD player arm": 0, "flexible structure": -2}


def elements() -> Iterator[tuple[str, FRF]]:
    """Every response of the recordings, by name of the machine: of those that lie there."""
    for path in sorted((DATA / "kagra").glob("*.xml")):
        yield from _each("suspension", ls.formats.read_frf(path))
    bench, maps = DATA / "tokyo_bench", ROOT / "examples"
    if bench.is_dir():
        for kind, where in (("A", maps / "motor_bench"), ("B", ROOT / "experiments" / "tokyo_distortion")):
            run = import_file(bench / f"MultisineType{kind}.mat", where / "map.toml")
            yield "motor bench", estimate_frf(run.recordings[0], run.loops[0])
    if (DATA / "daisy").is_dir():
        for name, settings in (
            ("CD_player_arm", Settings(method="welch")),
            ("flexible_structure", Settings(method="welch", resolution_hz=1.0)),
        ):
            run = import_file(DATA / "daisy" / f"{name}_dat.mat", maps / "daisy" / f"{name.lower()}.toml")
            yield from _each(name.replace("_", " "), estimate_matrix(run, run.recordings, settings))


def _each(name: str, frf: FRF) -> Iterator[tuple[str, FRF]]:
    for i in range(frf.response.shape[1]):
        for j in range(frf.response.shape[2]):
            one = pick(frf, [i], [j])
            relative = np.sqrt(one.variance[:, 0, 0]) / np.maximum(np.abs(one.siso), 1e-300)
            known = valid_lines(one.frequency_hz, relative, np.isfinite(relative))
            if known.sum() >= FEWEST:
                yield name, replace(one, valid=known)


def asked(rng: np.random.Generator, name: str, frf: FRF) -> Iterator[tuple[FRF, Controller, Requirements]]:
    """The element under gains that place |L| = 1 at its lines, most with a lag, a lead or low-passes, falling above."""
    lines = frf.valid_lines()
    f, beyond = lines.frequency_hz, frf.frequency_hz > lines.frequency_hz[-1]
    rate_hz = frf.rate_hz or 100.0 * float(f[-1])
    own = replace(frf, loop="axis", recording="one", rate_hz=rate_hz)
    limits = {"modulus_margin": 0.5, "gain_margin_db": 6.0, "phase_margin_deg": 30.0}
    required = Requirements("axis", integrators=INTEGRATORS[name], unstable_poles=0, **limits)
    found = 0
    for _ in range(TRIED):
        k, sign = int(rng.integers(f.size)), float(rng.choice([-1.0, 1.0]))
        low_hz, high_hz = float(rng.choice(f)), 0.4 * rate_hz
        shapes: list[tuple[Block, ...]] = [
            (),
            (Block("pi", {"f_hz": 0.1 * f[k]}),) if required.integrators >= 0 else (),
            (Block("lead_lag", {"f1_hz": f[k] / 3.0, "f2_hz": min(3.0 * f[k], high_hz)}),),
            (Block("low_pass_1", {"f_hz": low_hz}),),
            (Block("low_pass_2", {"f_hz": low_hz, "damping": 0.7}),),
            (Block("low_pass_1", {"f_hz": 0.1 * low_hz}), Block("low_pass_1", {"f_hz": 0.3 * low_hz})),
        ]
        blocks = shapes[int(rng.integers(len(shapes)))]
        size = np.abs(Controller("axis", (Block("gain", {"gain": 1.0}), *blocks), rate_hz).response(f) * lines.siso)
        above = Controller("axis", (Block("gain", {"gain": 1.0 / size[k]}), *blocks), rate_hz)
        high = np.abs(above.response(frf.frequency_hz[beyond]) * frf.siso[beyond])
        if size[-1] < 0.7 * size[k] and not np.any(high > 0.3) and found < CROSSINGS:
            found += 1
            gain = Block("gain", {"gain": sign / float(size[k])})
            yield own, Controller("axis", (gain, *blocks), rate_hz), required
