"""Several arms in the lanes of one vector loop, in C, beside the plain C arm one after the other."""

from __future__ import annotations

import ctypes
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from arm_workload import biquads, references, start

HERE = Path(__file__).parent
PLAIN = ("-O3", "-std=c99")
VECTORS = ("-O3", "-std=gnu99", "-march=native", "-fno-math-errno", "-fno-trapping-math")
#: of the pressure's setpoint, arm by arm: other pulses, so edges at other times
SPREAD = np.linspace(1.0, 1.21, 8)


def compiled(folder: Path, source: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    """A file of this folder as a library."""
    library = folder / f"{source}{abs(hash(flags))}.so"
    command = [os.environ.get("CC", "cc"), *flags, "-shared", "-fPIC", "-o", str(library), str(HERE / source), "-lm"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(library))


def pointer(a: np.ndarray) -> ctypes.c_void_p:
    """Where an array lies."""
    return a.ctypes.data_as(ctypes.c_void_p)


def one_by_one(library: ctypes.CDLL, setpoints: np.ndarray, noise: bool) -> np.ndarray:
    """What the plain arm measures, (arms, n, 7), of setpoints (arms, n, 2)."""
    sections, n = biquads(), setpoints.shape[1]
    injected, out = np.zeros((n, 2)), np.empty((len(setpoints), n, 7))
    for k, (r, rows) in enumerate(zip(setpoints, out, strict=True)):
        x = start()[:5].copy()
        ended = library.arm1_run(
            n, pointer(r), pointer(injected), pointer(sections), sections.shape[1], pointer(x),
            ctypes.c_longlong(k + 1), int(noise), pointer(rows),
        )  # fmt: skip
        assert ended == 0, "the C arm left its range"
    return out


def side_by_side(library: ctypes.CDLL, setpoints: np.ndarray, noise: bool) -> tuple[np.ndarray, float]:
    """The same in lanes, and its steps a tick."""
    sections, (arms, n, _) = biquads(), setpoints.shape
    r = np.ascontiguousarray(np.moveaxis(setpoints, 0, -1))
    x = np.repeat(start()[:5, None], arms, axis=1)
    seeds, out = np.arange(1, arms + 1, dtype=np.int64), np.empty((arms, n, 7))
    run = library.arm1_lanes
    run.restype = ctypes.c_long
    steps = run(
        n, pointer(r), pointer(sections), sections.shape[1], pointer(x), pointer(seeds), int(noise), pointer(out)
    )
    return out, steps / n


def timed(run: Any, *given: Any) -> float:
    """Processor seconds of one run."""
    begun = time.process_time()
    run(*given)
    return time.process_time() - begun


def table(folder: Path, rounds: int = 5) -> list[tuple[str, float, str]]:
    """Lines of the table: what, how many times as fast as the plain C arm, and the rest in words."""
    plain, tuned = compiled(folder, "arm1.c", PLAIN), compiled(folder, "arm1.c", VECTORS)
    lines = []
    for arms in (4, 8):
        lanes = compiled(folder, "arm1_lanes.c", (*VECTORS, f"-DLANES={arms}", f"-mprefer-vector-width={64 * arms}"))
        together = np.repeat(references()[None], arms, axis=0)
        apart = together * np.stack([np.ones(arms), SPREAD[:: 8 // arms]], axis=1)[:, None]
        for name, setpoints, noise in (
            ("edges at one time, no noise", together, False),
            ("edges apart, no noise", apart, False),
            ("edges apart, noise and converters", apart, True),
        ):
            times = [
                (
                    timed(one_by_one, plain, setpoints, noise),
                    timed(one_by_one, tuned, setpoints, noise),
                    timed(side_by_side, lanes, setpoints, noise),
                )
                for _ in range(rounds)
            ]
            one, for_this, several = (min(column) for column in zip(*times, strict=True))
            steps = side_by_side(lanes, setpoints, noise)[1]
            text = f"times plain C, {for_this / several:.3g} of plain C for this processor; {steps:.2f} steps a tick"
            lines.append((f"{arms} arms in lanes, {name}", one / several, text))
        expected, found = one_by_one(plain, apart, False), side_by_side(lanes, apart, False)[0]
        worst = np.abs(found - expected).max(axis=(0, 1)) / np.abs(expected).max(axis=(0, 1))
        lines.append(("  they differ by", float(worst.max()), "of a signal's largest value, without noise"))
    return lines
