"""Excitation step by step under injected faults, and recordings that end by themselves: both against the truth."""

from __future__ import annotations

import csv
import sys
import warnings
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np
from scipy.signal import cont2discrete

import loopshape as ls
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.settings import Limit
from loopshape.toolbox.rig.simulated import plan
from loopshape.toolbox.rig.steps.course import Course, StoppedAtLimitError
from loopshape.toolbox.rig.steps.enough import State, Until, look
from loopshape.toolbox.rig.steps.escalation import Escalation
from loopshape.toolbox.rig.steps.supervisor import Supervisor, cut
from loopshape.toolbox.rig.study import ExperimentTemplate, Study
from loopshape.toolbox.servo.axis import ServoAxis
from loopshape.verbs.watch import Unwatched

HERE = Path(__file__).parent
DRAWS, RATE, LIMIT_M, AFTER = 400, 1000.0, 4e-3, 1000
FAULTS = ("none", "gain x3", "resonance moved", "sensor sticks", "friction lost")
PERIODS = 48


@numba.njit
def simulate(m, share, spring, damper, viscous, coulomb, gain, most, sections, r, n, noise, step, fault, at, vent):
    """Two masses, one driven, friction at it; a fault from tick `at`, the brake from tick `vent`. Gives x, y, u."""
    k_n = r.size
    x, v, x2, v2 = 0.0, 0.0, 0.0, 0.0
    m1, m2 = (1.0 - share) * m, share * m
    w = np.zeros((sections.shape[0], 2))
    out = np.zeros((k_n, 3))
    stuck = 0.0
    for k in range(k_n):
        c, g, kk, f = spring, gain, coulomb, damper
        if k >= at:
            if fault == 1:
                g = 3.0 * gain
            elif fault == 2:
                c = 0.5 * spring
            elif fault == 4:
                kk = 0.0
        y = x + noise[k]
        if step > 0.0:
            y = step * np.round(y / step)
        if k < at or fault != 3:
            stuck = y
        else:
            y = stuck
        e = r[k] + n[k] - y
        for i in range(sections.shape[0]):
            b0, b1, b2, a1, a2 = sections[i]
            z = b0 * e + w[i, 0]
            w[i, 0], w[i, 1] = b1 * e - a1 * z + w[i, 1], b2 * e - a2 * z
            e = z
        u = e
        out[k, 0], out[k, 1], out[k, 2] = x, y, u
        force = g * min(max(u, -most), most)
        held = kk
        if k >= vent:
            force, held = 0.0, most
        for _ in range(20):
            dt = 0.001 / 20.0
            link = c * (x2 - x) + f * (v2 - v)
            v += dt * (force + link - viscous * v) / m1
            rub = dt * held / m1
            v = 0.0 if abs(v) <= rub else v - np.sign(v) * rub
            v2 -= dt * link / m2
            x += dt * v
            x2 += dt * v2
    return out


class Machine(ServoAxis):
    """A random axis with a load on a spring, its fault, and what it did last."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__()
        self.m, self.share = 10.0 ** rng.uniform(1.0, 2.3), rng.uniform(0.1, 0.3)
        f, damping = rng.uniform(60.0, 200.0), rng.uniform(0.01, 0.05)
        reduced = self.share * (1.0 - self.share) * self.m
        self.spring = reduced * (2 * np.pi * f) ** 2
        self.damper = 2.0 * damping * reduced * 2 * np.pi * f
        self.crossover_hz = f * rng.uniform(0.06, 0.12)
        self.most = self.m * LIMIT_M * (2 * np.pi * self.crossover_hz) ** 2 * rng.uniform(2.0, 20.0)
        self.viscous, self.coulomb = self.m * rng.uniform(0.5, 5.0), self.most * rng.uniform(0.0, 0.02)
        self.noise, self.step = LIMIT_M * 10.0 ** rng.uniform(-4.0, -3.0), LIMIT_M * 10.0 ** rng.uniform(-5.0, -3.0)
        self.fault, self.fault_in, self.fault_at = 0, "", 0.0
        self.last, self.order = None, [*(f"axis-a{n}" for n in range(60)), "axis"]
        self.largest = 0.0

    def controller(self):
        """A gain and a lead about the crossover, and a low-pass."""
        w, C = 2 * np.pi * self.crossover_hz, self.crossover_hz
        blocks = (ls.gain(self.m * w**2 / 3.0), ls.lead_lag(C / 3.0, 3.0 * C), ls.low_pass(8.0 * C, order=1))
        return ls.controller(*blocks, rate_hz=RATE, loop="position")

    def moved(self, e, vent: int):
        """What the machine does in an experiment, braked from a tick on."""
        place, where = (self.order.index(name) if name else 99 for name in (e.name, self.fault_in))
        at = 10**9 if not self.fault_in or place < where else 0 if place > where else round(self.fault_at * e.samples)
        rng = np.random.default_rng(e.seed)
        pad = 0 if vent > e.samples else AFTER
        r = np.concatenate([e.references[:, 0], np.full(pad, e.references[0, 0])])
        n = np.concatenate([e.injected[:, 0], np.zeros(pad)])
        noise = self.noise * rng.standard_normal(e.samples + AFTER)
        return simulate(
            self.m, self.share, self.spring, self.damper, self.viscous, self.coulomb, 1.0, self.most,
            e.loops[0].controller.biquads(), r, n, noise, self.step, self.fault, at, vent,
        )  # fmt: skip

    def simulate(self, experiments, **settings):
        """Recordings, as a rig gives them."""
        return [self._one(e) for e in experiments]

    def _one(self, e):
        out, self.last = self.moved(e, 10**9), e
        columns = {"t_s": np.arange(e.samples) / RATE, "reference_m": e.references[:, 0]}
        columns |= {"n_position_m": e.injected[:, 0], "force_n": out[: e.samples, 2], "position_m": out[: e.samples, 1]}
        return Recording(RecordingInfo.of(e), RATE, columns)


def climb(machine, folder, seed):
    """The names of the recordings made, why it ended, and the largest excursion over the limit, braking included."""
    C = machine.controller()
    signal = Multisine(1.0, min(2.0 * machine.crossover_hz, 100.0), 1.0, 10 * LIMIT_M, 6, ramp_s=0.2, seed=seed)
    one = ExperimentTemplate("axis", "multisine", "controller_input", "position", signal, lead_s=0.2)
    limits = {
        "position_m": Limit("position_m", -LIMIT_M, LIMIT_M),
        "force_n": Limit("force_n", -machine.most, machine.most),
    }
    study = Study("simulated", "servo-axis", (one,), ({"position_m": 0.0},), RATE, seed, limits=limits,
                  controllers={"position": C.blocks})  # fmt: skip
    course = Course(study, machine, folder, Unwatched(), Escalation(start_percent=0.1))
    names, largest, why = [], 0.0, "whole"
    try:
        for e in course.coming(plan(study, machine)):
            recording = course.simulated(e)
            names.append(e.name)
            n = recording.columns["t_s"].size
            stopped = recording.info.ended_early is not None
            done = machine.last
            vents = stopped and course._supervisor is not None and course._supervisor.trip.vents
            true = machine.moved(done, n if vents else 10**9)
            largest = max(largest, float(np.abs(true[: n + AFTER if vents else n, 0]).max()))
            course.taken(recording)
            why = recording.info.ended_early.partition(" at ")[0] if e.name == "axis" and stopped else why
    except StoppedAtLimitError as error:
        why = error.received.rpartition("; ")[2]
    return names, why, largest / LIMIT_M - 1.0


def faults(draws: int):
    """Each draw climbs without a fault first, then with one at a random time of a random recording."""
    rows, ends = [], []
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for k in range(draws):
            rng = np.random.default_rng([2026, k])
            machine = Machine(rng)
            names, why, beyond = climb(machine, Path(folder), k)
            ends.append(("none", why, beyond))
            fault = 1 + k % 4
            machine.fault, machine.fault_at = fault, rng.uniform(0.1, 0.9)
            machine.fault_in = str(rng.choice(names[1:])) if len(names) > 1 else names[0]
            _, why, beyond = climb(machine, Path(folder), k)
            ends.append((FAULTS[fault], why, beyond))
    for fault in FAULTS:
        mine = [(why, beyond) for name, why, beyond in ends if name == fault]
        over = np.array([beyond for _, beyond in mine])
        rows.append((fault, len(mine), sum(over > 0.0), sum(over > 0.02), round(100 * float(over.max(initial=-1.0)), 2),
                     "; ".join(f"{n} {w}" for w, n in Counter(w for w, _ in mine).most_common())))  # fmt: skip
    write("faults.csv", ("fault", "draws", "limit_passed", "by_more_than_2_percent", "largest_percent", "ends"), rows)


def truth(C, m, viscous, R, f):
    """Whether the requirements hold by the exact loop, from scipy's zero-order hold."""
    num, den, _ = cont2discrete(([1.0], [m, viscous, 0.0]), 1.0 / RATE)
    z = np.exp(2j * np.pi * f / RATE)
    L = np.polyval(np.ravel(num), z) / np.polyval(den, z) * C.response(f)
    peak = 20.0 * np.log10(np.abs(1.0 / (1.0 + L)).max())
    k = int(np.flatnonzero(np.abs(L) > 1.0)[-1])
    return peak, 180.0 + float(np.degrees(np.angle(L[k])))


def enough(draws: int):
    """Each draw is looked at with and without the correction for many looks."""
    f, counts, ends = np.geomspace(0.2, 450.0, 200_000), {True: Counter(), False: Counter()}, {True: [], False: []}
    for k in range(draws):
        rng = np.random.default_rng([2027, k])
        m, viscous, cross = 100.0, 10.0 ** rng.uniform(1.5, 3.0), rng.uniform(8.0, 25.0)
        w, lead = 2 * np.pi * cross, rng.uniform(1.8, 4.0)
        C = ls.controller(
            ls.gain(m * w**2 / lead), ls.lead_lag(cross / lead, cross * lead), rate_hz=RATE, loop="position"
        )
        peak, margin = truth(C, m, viscous, None, f)
        asked = {"sensitivity_peak_db": peak + rng.normal(0.0, 0.6), "phase_margin_deg": margin + rng.normal(0.0, 3.0)}
        R = ls.Requirements("position", **asked, unstable_poles=0, integrators=1)
        right = "passed" if R.sensitivity_peak_db >= peak and R.phase_margin_deg <= margin else "failed"
        recording, loop, e = recorded(C, m, viscous, 10.0 ** rng.uniform(-5.0, -3.0), k)
        until = Until(requirements=(R,))
        for corrected in (True, False):
            watched = Supervisor(e, until=until)
            widened = watched.widened if corrected else 1.0
            for t in watched.times_s:
                n = min(round(t * RATE), e.samples)
                found = look(cut(recording, n, None), loop, until, widened)
                if found.state is not State.MORE:
                    break
            share = n / e.samples if found.state is not State.MORE else 1.0
            if found.state is State.MORE:
                word = "undecided to the end"
            else:
                at_end = look(cut(recording, n, None), loop, until).outcome
                word = "right" if at_end == right else "wrong"
            counts[corrected][word] += 1
            ends[corrected].append(share)
    rows = [
        ("corrected" if c else "not corrected", draws, counts[c]["right"], counts[c]["wrong"],
         round(100 * counts[c]["wrong"] / draws, 2), counts[c]["undecided to the end"],
         round(100 * (1 - float(np.median(ends[c]))), 1), round(100 * (1 - float(np.mean(ends[c]))), 1))
        for c in (True, False)
    ]  # fmt: skip
    columns = ("looks", "recordings", "enough_right", "enough_wrong", "wrong_percent", "undecided_to_the_end",
               "median_time_saved_percent", "mean_time_saved_percent")  # fmt: skip
    write("enough.csv", columns, rows)


def recorded(C, m, viscous, noise_m, seed):
    """A whole recording of the simulated axis, its loop, and the experiment."""
    plant = ServoAxis()
    signal = Multisine(1.0, 200.0, 1.0, 1e-3, PERIODS, ramp_s=0.5, seed=seed)
    one = ExperimentTemplate("axis", "multisine", "controller_input", "position", signal, lead_s=0.2)
    study = Study("simulated", "servo-axis", (one,), ({"position_m": 0.0},), RATE, seed,
                  changes={"mass_kg": m, "viscous_ns_m": viscous, "position_noise_m": noise_m},
                  controllers={"position": C.blocks})  # fmt: skip
    course = Course(study, plant, HERE, Unwatched())
    (e,) = course.coming(plan(study, plant))
    return course.simulated(e), e.loops[0], e


def write(name, columns, rows):
    """A table, and the same on the terminal."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    for row in rows:
        print(*row)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS
    what = sys.argv[2] if len(sys.argv) > 2 else ""
    if what != "enough":
        faults(number)
    if what != "faults":
        enough(number)
