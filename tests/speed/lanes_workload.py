"""Several arms in the lanes of one vector loop, in C, beside the plain C arm one after the other."""

from __future__ import annotations

import ctypes
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np
from arm_workload import biquads, references, start

from loopshape.toolbox.arm.dynamics.model import HELD, moving
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants

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


@numba.njit(nogil=True, error_model="numpy", fastmath={"contract"}, _nrt=False)
def own_steps(c, held, p_c, p_a, p_b, theta, w, in_a, in_b, out_a, out_b, h, steps):
    """Steps of arms by our own right-hand side, a loop over arms within each step; an array for each state."""
    for _ in range(steps):
        for k in range(p_c.size):
            c0, a0, b0, q0, w0 = p_c[k], p_a[k], p_b[k], theta[k], w[k]
            valves = in_a[k], in_b[k], out_a[k], out_b[k]
            c1, a1, b1, _, w1, _, _ = moving(c, held, (c0, a0, b0, q0, w0, q0, w0), valves)
            v2, q2 = w0 + 0.5 * h * w1, q0 + 0.5 * h * w0
            state = (c0 + 0.5 * h * c1, a0 + 0.5 * h * a1, b0 + 0.5 * h * b1, q2, v2, q2, v2)
            c2, a2, b2, _, w2, _, _ = moving(c, held, state, valves)
            v3, q3 = w0 + 0.5 * h * w2, q0 + 0.5 * h * v2
            state = (c0 + 0.5 * h * c2, a0 + 0.5 * h * a2, b0 + 0.5 * h * b2, q3, v3, q3, v3)
            c3, a3, b3, _, w3, _, _ = moving(c, held, state, valves)
            v4, q4 = w0 + h * w3, q0 + h * v3
            state = (c0 + h * c3, a0 + h * a3, b0 + h * b3, q4, v4, q4, v4)
            c4, a4, b4, _, w4, _, _ = moving(c, held, state, valves)
            p_c[k] = c0 + h / 6.0 * (c1 + 2.0 * (c2 + c3) + c4)
            p_a[k] = a0 + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            p_b[k] = b0 + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)
            theta[k] = q0 + h / 6.0 * (w0 + 2.0 * (v2 + v3) + v4)
            w[k] = w0 + h / 6.0 * (w1 + 2.0 * (w2 + w3) + w4)


def own(arms: int, steps: int = 20_000) -> float:
    """Processor time in s of a step of one of so many arms at rest, by `own_steps`."""
    c, held = constants(ARM1_PARAMETERS.vector()), np.zeros(HELD)
    states, valves = np.repeat(start()[:5, None], arms, axis=1), np.zeros((4, arms))
    own_steps(c, held, *states.copy(), *valves, 1e-3, 1)
    times = [timed(own_steps, c, held, *states.copy(), *valves, 1e-3, steps) for _ in range(5)]
    return min(times) / (steps * arms)


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
    lines.append(
        ("8 arms in lanes, our own right-hand side", own(1) / own(8), "times one arm (numba; its branches stay)")
    )
    return lines
