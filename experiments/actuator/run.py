"""What an actuator must do under a new controller: predictions of 400 random loops against their simulation."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numba
import numpy as np
from scipy.signal import bilinear, cont2discrete, lfilter

import loopshape as ls
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run

HERE = Path(__file__).parent
DRAWS, RATE, SAMPLES, LONG, WARM = 400, 1000.0, 20_000, 4_000_000, 10_000
FREE = (-1e30, 1e30)
LIMITS = ("error_rms", "control_rms", "control_peak", "control_rate", "saturation_percent")
COLUMNS = (
    "quantity",
    "saturation",
    "draws",
    "not_read",
    "covered_percent",
    "below",
    "above",
    "median_half_width_percent",
)
#: a share of time in percent is counted in the long record no more finely than this: five samples
RESOLUTION = 100.0 * 5 / LONG
#: shares of time in saturation, in percent, by which the draws are told apart
CLASSES = {"none": (-1.0, 1e-9), "up to 5 %": (1e-9, 5.0), "5 to 30 %": (5.0, 30.0)}


@numba.njit
def simulate(b, a, c, d, low, high, disturbance, noise):
    """Error and input of a loop whose actuator saturates: plant b/a from the sample after, controller c/d."""
    n, p, q = disturbance.size, a.size - 1, d.size - 1
    error, control, output = np.zeros(n), np.zeros(n), np.zeros(n)
    applied = np.zeros(n)
    for k in range(n):
        y = 0.0
        for i in range(1, p + 1):
            if k >= i:
                y += b[i] * applied[k - i] - a[i] * output[k - i]
        output[k] = y
        error[k] = -(y + noise[k])
        u = c[0] * error[k]
        for i in range(1, q + 1):
            if k >= i:
                u += c[i] * error[k - i] - d[i] * control[k - i]
        control[k] = u
        applied[k] = min(max(u, low), high) + disturbance[k]
    return error, control


class Machine:
    """A random axis: mass, friction and one resonance, a disturbance at its input and the noise of its sensor."""

    def __init__(self, rng: np.random.Generator) -> None:
        pole, f = 2 * np.pi * rng.uniform(0.3, 3.0), 2 * np.pi * rng.uniform(40.0, 150.0)
        self.resonance_hz = f / (2 * np.pi)
        self.integrators = int(rng.random() < 0.5)
        slow = 0.0 if self.integrators else 2 * np.pi * 0.3
        den = np.polymul(np.polymul([1.0, pole], [1.0, 2 * rng.uniform(0.01, 0.1) * f, f**2]), [1.0, slow])
        num = np.atleast_1d(10.0 ** rng.uniform(-1.0, 1.0) * pole * f**2)
        b, self.a, _ = cont2discrete((num, den), 1.0 / RATE)
        self.b = b.ravel()
        self.pole, self.sensor = rng.uniform(0.9, 0.999), 0.0

    def response(self, f_hz: np.ndarray) -> np.ndarray:
        """Of the motion to the input, at frequencies in Hz."""
        z = np.exp(2j * np.pi * f_hz / RATE)
        return np.polyval(self.b, z) / np.polyval(self.a, z)

    def controller(self, crossover_hz: float, lead: float):
        """A PI, a lead about its crossover and a low-pass; and its polynomials by Tustin's rule, from scipy."""
        w, size = 2 * np.pi * crossover_hz, abs(self.response(np.array([crossover_hz]))[0])
        gain = 1.0 / (size * lead)
        C = ls.controller(
            ls.gain(gain), ls.pi(crossover_hz / 10.0), ls.lead_lag(crossover_hz / lead, crossover_hz * lead),
            ls.low_pass(5.0 * crossover_hz, order=1), rate_hz=RATE, loop="axis",
        )  # fmt: skip
        num = gain * np.polymul([1.0, w / 10.0], [lead / w, 1.0])
        den = np.polymul(np.polymul([1.0, 0.0], [1.0 / (lead * w), 1.0]), [1.0 / (5.0 * w), 1.0])
        return C, bilinear(num, den, RATE)

    def stable(self, laws) -> bool:
        """By the poles of the discrete loop."""
        c, d = laws
        poles = np.polyadd(np.polymul(self.a, d), np.polymul(self.b, c))
        return bool(np.abs(np.roots(poles)).max() < 0.999)

    def run(self, laws, rng, samples: int, ends):
        """Error and input of the loop with its actuator's ends, from standing still on."""
        n = samples + WARM
        disturbance = lfilter([np.sqrt(1.0 - self.pole**2)], [1.0, -self.pole], rng.standard_normal(n))
        signals = simulate(self.b, self.a, *laws, *ends, disturbance, self.sensor * rng.standard_normal(n))
        return tuple(one[WARM:] for one in signals)


def draw(rng: np.random.Generator):
    """A machine, two stable controllers with margin, noise of its sensor, and the ends of its actuator."""
    while True:
        machine = Machine(rng)
        old, new = sorted(machine.resonance_hz * 10.0 ** rng.uniform(-1.5, -0.6, 2))
        made = [machine.controller(crossover, rng.uniform(2.0, 4.0)) for crossover in (old, new)]
        laws = [one[1] for one in made]
        if all(machine.stable((k * c, d)) for c, d in laws for k in (0.5, 1.0, 1.6)):
            break
    error, control = machine.run(laws[1], rng, 50_000, FREE)
    # from nothing to as much as half of what reaches the plant's input: noise of the sensor
    machine.sensor = float(np.std(error)) * 10.0 ** rng.uniform(-3.0, -0.5)
    error, control = machine.run(laws[1], rng, 50_000, FREE)
    half = float(np.std(control)) * rng.uniform(1.5, 6.0)
    middle = rng.uniform(-0.3, 0.3) * half
    return machine, [one[0] for one in made], laws, (middle - half, middle + half)


def still(machine, C, law, rng, ends):
    """A recording of the loop under the old controller, without excitation."""
    error, control = machine.run(law, rng, SAMPLES, ends)
    info = RecordingInfo("still.parquet", "none", "controller_input")
    loop = LoopSetup("axis", None, None, "u_v", "y_m", C)
    return Run(RATE, (loop,), (Recording(info, RATE, {"u_v": control, "y_m": -error}),))


def measured(machine, rng, relative: float):
    """An FRF with relative errors."""
    f = np.geomspace(0.2, 450.0, 300)
    noise = (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
    P = machine.response(f) * (1.0 + relative * noise)
    return ls.FRF.from_arrays(f, P, relative_std=relative, rate_hz=RATE, loop="axis")


def truths(machine, law, rng, ends) -> dict[str, float]:
    """What the loop does: powers and saturation of long records, peaks of one record."""
    error, control = machine.run(law, rng, LONG, ends)
    _, short = machine.run(law, rng, SAMPLES, ends)
    return {
        "error_rms": float(np.std(error)),
        "control_rms": float(np.std(control)),
        "control_peak": float(np.abs(short - short.mean()).max()),
        "control_rate": RATE * float(np.abs(np.diff(short)).max()),
        "saturation_percent": 100.0 * float(np.mean((control > ends[1]) | (control < ends[0]))),
    }


def one(seed: int):
    """What the loop does, and what the check reads."""
    rng = np.random.default_rng([2026, seed])
    machine, (C0, C1), laws, ends = draw(rng)
    P, run = measured(machine, rng, 10.0 ** rng.uniform(-2.5, -1.0)), still(machine, C0, laws[0], rng, ends)
    R = ls.Requirements("axis", saturation_percent=5.0, control_range=ends, integrators=machine.integrators)
    (margins,) = ls.check(P, C1, R, disturbance=run).margins.values()
    return truths(machine, laws[1], rng, ends), {name: margins[name] for name in LIMITS}


def main(draws: int) -> None:
    """Draw, and write the table."""
    every = [one(seed) for seed in range(draws)]
    rows = [row(name, label, every) for name in LIMITS for label in CLASSES]
    with (HERE / "results.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerows([COLUMNS, *rows])
    for each in rows:
        print(*each)


def row(name: str, label: str, every) -> tuple:
    """How often a quantity's interval covers, by how much the loops saturate."""
    low, high = CLASSES[label]
    mine = [(truth[name], read[name]) for truth, read in every if low < truth["saturation_percent"] <= high]
    pairs = [(truth, reading.interval) for truth, reading in mine if reading.interval is not None]
    seen = RESOLUTION if name == "saturation_percent" else 0.0
    below = sum(truth < ends[0] - seen for truth, ends in pairs)
    above = sum(truth > ends[1] + seen for truth, ends in pairs)
    covered = 100.0 * (1.0 - (below + above) / max(len(pairs), 1))
    widths = [50.0 * (ends[1] - ends[0]) / max(truth, 1e-12) for truth, ends in pairs]
    width = float(np.median(widths)) if widths else float("nan")
    return name, label, len(mine), len(mine) - len(pairs), round(covered, 1), below, above, round(width, 1)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS)
