"""A machine of no example: a winch. A geared drum carries an off-centre load on a spring-loaded lever.

The truth is integrated by scipy's Radau or LSODA at tight tolerance, its friction is a sharp arctangent and its
controller a PD of the test's own; nothing of the package takes part.
"""

import numpy as np
from bench_nouns import RecordingInfo
from scipy.integrate import solve_ivp

import loopshape as ls

RATE_HZ, SECONDS = 500.0, 8
INERTIA, DAMPING, SPRING, WEIGHT = 0.020, 0.05, 0.8, 0.30
STEP_RAD = 2e-4


def motion(t, x, u, p):
    """Lever angle and speed from the drum's torque: inertia, damping, a spring, an off-centre weight."""
    torque = u[0] - p.damping * x[1] - p.spring * x[0] - p.weight * np.sin(x[0])
    return x[1], torque / (p.inertia + 0.03 * p.load)


MODEL = ls.gap.Model(
    "winch",
    motion,
    ("angle", "speed"),
    (
        ls.gap.ModelParameter("inertia", INERTIA, "kg m2", 0.03, "none"),
        ls.gap.ModelParameter("damping", DAMPING, "N m s/rad", 0.10, "none"),
        ls.gap.ModelParameter("spring", SPRING, "N m/rad", 0.03, "none"),
        ls.gap.ModelParameter("weight", WEIGHT, "N m", 0.03, "none"),
        ls.gap.ModelParameter("load", 0.0, "kg", effect="payload@lever", range=(0.0, 1.0)),
    ),
    (ls.gap.Input("drum", "torque_nm", unit="N m"),),
    (ls.gap.Output("encoder", "angle", "lever_rad", unit="rad"),),
    (ls.gap.Port("bearing", "drum", "angle", "speed", unit="N m"),),
    window_s=0.8,
)


def reference(k, t):
    """Sums of sines of random size and phase, and a slow wander, (n,) in rad."""
    rng = np.random.default_rng(k)
    hz = rng.uniform(0.2, 6.0, 7)
    parts = [0.25 / (1.0 + f) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in hz]
    return np.sum(parts, axis=0) + 0.3 * np.sin(2 * np.pi * 0.11 * t + k)


def recorded(k, *, coulomb=0.0, load=0.0, driven_back=0.0, square=0.0, stuck=(0.0, 0.0), held=0.0,
             inertia=INERTIA, delay_s=0.0, drag=0.0, cogging=0.0, cogs=9.0, role="estimation"):  # fmt: skip
    """One recording: the lever follows a reference, `held` rad off, under a PD law that sees the sensor.

    Friction takes a share `load` of the drum's torque, `driven_back` more where the load drives, and `square` of it for
    each N m; below 0.3 rad/s dry friction and that share are higher by the shares `stuck`.
    """
    n, rng = round(SECONDS * RATE_HZ), np.random.default_rng(100 + k)
    t = np.arange(n) / RATE_HZ
    r = reference(k, t) + held
    late = round(delay_s * RATE_HZ)
    state, true, read, torque = np.zeros(2), np.zeros(n), np.zeros(n), np.zeros(n)

    def slope(_, x, u):
        slow = 1.0 / (1.0 + (x[1] / 0.3) ** 4)
        taken = load * (1.0 + stuck[1] * slow) + square * abs(u) + (driven_back if u * x[1] < 0.0 else 0.0)
        dry = (coulomb * (1.0 + stuck[0] * slow) + taken * abs(u)) * 2 / np.pi * np.arctan(x[1] / 0.004) + drag * x[
            1
        ] * abs(x[1]) ** 1.5
        dry += cogging * np.sin(cogs * x[0])
        own = u - 1.04 * DAMPING * x[1] - 0.985 * SPRING * x[0] - 1.01 * WEIGHT * np.sin(x[0])
        return [x[1], (own - dry) / (1.01 * inertia)]

    for i in range(n):
        true[i] = state[0]
        seen = true[max(i - late, 0)] + 5e-5 * rng.standard_normal()
        read[i] = STEP_RAD * np.round(seen / STEP_RAD)
        speed = (read[i] - read[max(i - 4, 0)]) * RATE_HZ / 4
        torque[i] = 4.0 * (r[i] - read[i]) - 0.15 * speed
        state = solve_ivp(slope, (0, 1 / RATE_HZ), state, "LSODA", args=(torque[i],), rtol=1e-7, atol=1e-9).y[:, -1]
    info = RecordingInfo(f"r{k}.parquet", "noise", "reference", role=role, operating_point={"lever_rad": 0.1 * k})
    return ls.Recording(info, RATE_HZ, {"torque_nm": torque, "lever_rad": read})


def run_of(count=3, levels=(0.0,), **effect):
    """Recordings for estimation, and one of validation, held off by one of the levels after the other."""
    own = [recorded(k, held=levels[k % len(levels)], **effect) for k in range(count)]
    return ls.Run(RATE_HZ, (), (*own, recorded(9, held=levels[-1], role="validation", **effect)))
