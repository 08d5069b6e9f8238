"""Machines of the exam: two MJCF models of no example, their tolerances, and specimens drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from engine import RATE_HZ, Truth, recorded

from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run

XML = {
    "cart": """<mujoco model="cart"><compiler angle="radian"/><worldbody><body name="wagon">
      <joint name="rail" type="slide" axis="1 0 0" damping="4.0" armature="0.8"/>
      <geom name="box" type="box" size="0.1 0.05 0.04" mass="1.7" contype="0" conaffinity="0"/></body></worldbody>
      <actuator><motor name="belt" joint="rail"/></actuator>
      <sensor><jointpos name="scale" joint="rail"/></sensor></mujoco>""",
    "boom": """<mujoco model="boom"><compiler angle="radian"/><worldbody><body name="mast">
      <joint name="pivot" type="hinge" axis="0 1 0" damping="0.09" armature="0.02"/>
      <geom name="tube" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.01" mass="0.3" contype="0" conaffinity="0"/>
      <geom name="bob" type="sphere" pos="0 0 -0.4" size="0.03" mass="0.35" contype="0" conaffinity="0"/>
      </body></worldbody>
      <actuator><motor name="gear" joint="pivot"/></actuator>
      <sensor><jointpos name="resolver" joint="pivot"/></sensor></mujoco>""",
}
PLACES = {"cart": ("belt", "scale", "rail", "wagon"), "boom": ("gear", "resolver", "pivot", "mast")}
COLUMNS = {"cart": ("belt_n", "wagon_m"), "boom": ("gear_nm", "mast_rad")}
STEPS = {"cart": (2e-5, 4e-5), "boom": (1e-4, 3.8e-4)}  # noise, step of the sensor
GAINS = {"cart": (260.0, 22.0, 60.0), "boom": (9.0, 0.7, 60.0)}
SIZE = {"cart": 0.12, "boom": 0.5}  # m, rad
G = 9.81
SPREAD = {"mass": 0.02, "damping": 0.10, "armature": 0.03, "motor_constant": 0.02}
#: names that no recording of one such machine tells apart
ALIKE = {
    "cart": (
        {"actuator_delay", "sensor_delay"},
        {"actuator_lag", "sensor_lag"},
        {"actuator_gain_error", "sensor_gain"},
    ),
    "boom": ({"actuator_delay", "sensor_delay"}, {"actuator_lag", "sensor_lag"}, {"base_tilt", "sensor_offset"}),
}


@dataclass(frozen=True)
class Specimen:
    """A label, its magnitude, and the recordings."""

    name: str
    plant: str
    effect: str
    magnitude: float
    run: Run


def nominal(plant: str, rng: np.random.Generator, longer: float = 0.0, more: float = 0.0) -> Truth:
    """A machine within its tolerances; a boom `longer` (m), a mass `more` (kg) at nine tenths of it."""
    mass, damping, rotor, gain = (1.0 + rng.uniform(-1, 1) * SPREAD[k] for k in SPREAD)
    if plant == "cart":
        return Truth(load=1.7 * mass + more, motor=0.8 * rotor, damping=4.0 * damping, gain=gain, scale=SIZE[plant])
    length = 0.4 + longer
    tube, bob, end = 0.3 * mass * length / 0.4, 0.35 * mass, 0.9 * length
    inertia = tube * (length**2 / 3 + 3.3e-5) + bob * (length**2 + 3.6e-4) + more * end**2
    weight = G * (tube * length / 2 + bob * length + more * end)
    return Truth(inertia, 0.02 * rotor, 0.09 * damping, weight, gain=gain, scale=SIZE[plant])


Simulate = Callable[..., tuple[np.ndarray, np.ndarray]]
Draw = Callable[[np.random.Generator, Truth, float, float], tuple[Mapping[str, float], float]]


def _signed(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))


def drawn(effect: str, rng: np.random.Generator, m: Truth, peak: float) -> tuple[dict[str, float], float]:
    """Numbers of an effect and its magnitude; `peak` is the largest command without it."""
    size, inertia = m.scale, m.load + m.motor
    u = float(rng.uniform(0.0, 1.0))
    late = 0.002 + 0.006 * u
    table: dict[str, tuple[dict[str, float], float]] = {
        "coulomb_friction": ({"friction": (0.02 + 0.06 * u) * peak}, (0.02 + 0.06 * u) * peak),
        "viscous_error": ({"drag": (0.5 + u) * m.damping}, 0.0),
        "cable_stiffness": (
            {"cable": (0.04 + 0.1 * u) * peak / size, "rest": _signed(rng, 0.0, size)},
            (0.04 + 0.1 * u) * peak / size,
        ),
        "joint_flexibility": ({"spring": (2 * np.pi * (9.0 + 9.0 * u)) ** 2 * m.motor * m.load / inertia}, 0.0),
        "backlash": ({"play": (0.006 + 0.012 * u) * size}, (0.006 + 0.012 * u) * size),
        "actuator_delay": ({"delay": late}, 1e3 * late),
        "actuator_lag": ({"lag": late}, 1e3 * late),
        "sensor_delay": ({"sensor_delay": late}, 1e3 * late),
        "actuator_saturation": ({"limit": (0.55 + 0.25 * u) * peak}, (0.55 + 0.25 * u) * peak),
        "dead_zone": ({"dead": (0.02 + 0.05 * u) * peak}, (0.02 + 0.05 * u) * peak),
        "cogging": ({"cogging": (0.03 + 0.05 * u) * peak, "pitch": 0.05 * size}, 0.0),
        "sag": ({"sag": (0.15 + 0.15 * u) / peak}, 0.0),
        "rate_limit": ({"rate": (14.0 + 8.0 * u) * peak}, 0.0),
    }
    gain = _signed(rng, 0.08, 0.2)
    table["actuator_gain_error"] = ({"gain": m.gain * (1.0 + gain)}, gain)
    table["sensor_gain"] = ({"sensor_gain": 0.5 * gain}, 0.5 * gain)
    table["base_tilt"] = ({"tilt": 0.5 * gain}, 0.5 * gain)
    moves, magnitude = table[effect]
    return moves, magnitude or next(iter(moves.values()))


def references(rng: np.random.Generator, size: float) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Kind, reference and injected signal of seven recordings; the last two are held out."""
    t = np.arange(12 * RATE_HZ) / RATE_HZ
    ramp, still = np.minimum(t, 1.0), np.zeros(t.size)

    def sines(share: float) -> np.ndarray:
        hz = rng.uniform(0.2, 9.0, 14)
        parts = [np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) / (0.5 + f) ** 0.7 for f in hz]
        return share * size * ramp * np.sum(parts, axis=0) / 3.0

    def stairs() -> np.ndarray:
        levels = np.repeat(rng.uniform(-1, 1, 6), 2 * RATE_HZ)
        smooth = np.hanning(400) / np.hanning(400).sum()
        return size * np.convolve(levels, smooth, mode="same")

    sweep = 0.3 * size * ramp * np.sin(2 * np.pi * (0.3 * t + 0.3 * t**2))
    slow = size * np.sin(2 * np.pi * 0.09 * t)
    return [
        ("multisine", still + 0.4 * size, sines(0.5)), ("multisine", still - 0.3 * size, sines(0.2)),
        ("sweep", still, sweep), ("staircase", stairs(), still), ("profile", slow, sines(0.05)),
        ("multisine", still + 0.1 * size, sines(0.4)), ("staircase", stairs(), still),
    ]  # fmt: skip


def specimen(
    name: str, plant: str, effect: str, seed: int, *, slips: bool = True, simulate: Simulate = recorded
) -> Specimen:
    """A machine with one effect, or `none`, and its seven recordings; `slips` has other friction and drag."""
    rng = np.random.default_rng(seed)
    body, magnitude = {}, 0.0
    if effect == "length_error":
        magnitude = body["longer"] = _signed(rng, 0.012, 0.03)
    if effect == "payload":
        magnitude = body["more"] = float(rng.uniform(0.06, 0.25)) * (1.0 if plant == "boom" else 2.5)
    m, signals = nominal(plant, rng, **body)._replace(slips=slips), references(rng, SIZE[plant])
    noise, step = STEPS[plant]
    draws = [noise * rng.standard_normal(r.size) for _, r, _ in signals]
    if effect not in ("none", "payload", "length_error"):
        usual = [simulate(r, n, m, GAINS[plant], e, step)[0] for (_, r, n), e in zip(signals, draws, strict=True)]
        moves, magnitude = drawn(effect, rng, m, float(np.quantile(np.abs(np.concatenate(usual)), 0.999)))
        m = m._replace(**moves)
    made = []
    for k, ((kind, r, n), e) in enumerate(zip(signals, draws, strict=True)):
        u, y = simulate(r, n, m, GAINS[plant], e, step)
        info = RecordingInfo(
            f"r{k}.parquet", kind, "reference", role="validation" if k > 4 else "estimation",
            operating_point={"start": float(r[0])},
        )  # fmt: skip
        cut = 2 * RATE_HZ  # the loop has been closed for a while
        made.append(Recording(info, RATE_HZ, dict(zip(COLUMNS[plant], (u[cut:], y[cut:]), strict=True))))
    return Specimen(name, plant, effect, magnitude, Run(RATE_HZ, (), tuple(made)))
