"""A mass on a spring, driven by noise at several levels: the spring hardens, the guide rubs, the motor has play.

Integrated here by semi-implicit Euler at a thirtieth of the sampling time; nothing of the package takes part.
"""

from dataclasses import replace

import numba
import numpy as np

import loopshape as ls

RATE_HZ, SECONDS, INNER = 500.0, 40, 30
HZ, DAMPING = 20.0, 0.03


@numba.njit
def moved(u, stiff, cubic, friction, play):
    """Sensor readings (n,) of the mass for forces u (n,), stiffness 1 N/m; `play` lies between motor and mass."""
    w2, h, x, v, m, mv = (2 * np.pi * HZ) ** 2, 1.0 / RATE_HZ / INNER, 0.0, 0.0, 0.0, 0.0
    out = np.zeros(u.size)
    for i in range(u.size):
        out[i] = x
        for _ in range(INNER):
            force = u[i]
            if play > 0.0:
                twist = m - x
                force = stiff * np.sign(twist) * max(abs(twist) - 0.5 * play, 0.0)
                force += 1e-3 * stiff * (mv - v) if abs(twist) > 0.5 * play else 0.0
                mv += h * 4.0 * w2 * (u[i] - force - 0.02 * mv)
                m += h * mv
            v += h * (w2 * (force - x - cubic * x**3 - friction * np.tanh(v / 0.01)) - 2 * DAMPING * np.sqrt(w2) * v)
            x += h * v
    return out


def run_of(levels, seed=1, stiff=60.0, cubic=0.0, friction=0.0, play=0.0, noise=0.01):
    """A run with one open-loop recording of white force a level, sensor noise a share of the motion."""
    rng, runs = np.random.default_rng(seed), []
    for k, level in enumerate(levels):
        u = level * rng.standard_normal(round(SECONDS * RATE_HZ))
        y = moved(u, stiff, cubic, friction, play)
        y += noise * np.std(y) * rng.standard_normal(y.size)
        runs.append(ls.Run.from_arrays(u=u, y=y, rate_hz=RATE_HZ, recording=f"level-{k}"))
    return replace(runs[0], recordings=tuple(r.recordings[0] for r in runs))
