"""400 tunes tried by `adopt` on simulated machines, half of them bad: what was decided, against the true loop."""

from __future__ import annotations

import csv
import sys
import warnings
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
from scipy.linalg import expm

import loopshape as ls
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.rig.adopt.blend import track_share
from loopshape.toolbox.rig.adopt.course import Adopted, Trial, TrialSettings, adopt
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.simulated import experiment, plan
from loopshape.toolbox.rig.study import ExperimentTemplate, Study
from loopshape.toolbox.rig.target.trial import Phase, Progress, Why
from loopshape.toolbox.servo.axis import ServoAxis

HERE = Path(__file__).parent
DRAWS, RATE, LIMIT_M, PEAK_DB = 400, 1000.0, 4e-3, 6.0
GRID = np.geomspace(0.05, 499.0, 4000)
BAD = ("gain", "gain, loaded alone", "no notch", "no notch, loaded alone", "resonance moved", "delay grown",
       "sign, loaded alone", "changes under way")  # fmt: skip
LAST = "changes in the last recording"
AFTER_S, REST_S, KEPT_S = 1.0, 0.5, 20.0
#: the draw of the documentation's picture
SHOWN = 127
#: places in the state of a trial, as `trial.c` has them
PHASE, WHY, TICKS, SEEN, OFFSET, SHARE, FROM, SUM, BEFORE, RISING, VALUE, AT_LIMIT = range(12)


@numba.njit
def simulate(A, B, at, x, delays, line, own, other, w, v, trial, watch, r, n, noise, force, travel):
    """Both plants (A, B: 2 of them, the second from tick `at` on) under both controllers, as the target runs them.

    `watch` is share, ramp, window, error_peak, control_low, control_high, error_rms, growth and the share to track.
    Gives y, z, the true position and the share, and how many ticks ran before it went back (all: it did not).
    """
    out = np.zeros((r.size, 4))
    back = r.size
    for k in range(r.size):
        p = 0 if k < at else 1
        y = x[0] + noise[k]
        error = r[k] - y
        entered = error + n[k]
        e = entered
        for i in range(own.shape[0]):
            b0, b1, b2, a1, a2 = own[i]
            z = b0 * e + w[i, 0]
            w[i, 0], w[i, 1] = b1 * e - a1 * z + w[i, 1], b2 * e - a2 * z
            e = z
        f = entered
        for i in range(other.shape[0]):
            b0, b1, b2, a1, a2 = other[i]
            z = b0 * f + v[i, 0]
            v[i, 0], v[i, 1] = b1 * f - a1 * z + v[i, 1], b2 * f - a2 * z
            f = z
        u = e
        if trial[PHASE] == 1.0:
            trial[OFFSET] += watch[8] * (f - e - trial[OFFSET])
        elif trial[PHASE] == 2.0 or trial[PHASE] == 4.0:
            trial[TICKS] += 1.0
            way = min(trial[TICKS] / max(watch[1], 1.0), 1.0)
            trial[SHARE] = trial[FROM] + way * (watch[0] - trial[FROM])
            u = e + trial[SHARE] * (f - trial[OFFSET] - e)
            why = 0.0
            if not abs(error) <= watch[3]:
                why, trial[VALUE], trial[AT_LIMIT] = 1.0, error, watch[3]
            elif not watch[4] <= u <= watch[5]:
                why, trial[VALUE], trial[AT_LIMIT] = 2.0, u, watch[5]
            else:
                trial[SUM] += error * error
                trial[SEEN] += 1.0
                if not trial[SUM] <= watch[6] ** 2 * watch[2]:
                    why, trial[VALUE], trial[AT_LIMIT] = 3.0, np.sqrt(trial[SUM] / watch[2]), watch[6]
                elif trial[SEEN] == watch[2]:
                    now = trial[SUM] / watch[2]
                    grew = trial[BEFORE] >= 0.0 and now > watch[7] * trial[BEFORE]
                    trial[RISING] = trial[RISING] + 1.0 if grew else 0.0
                    trial[BEFORE], trial[SUM], trial[SEEN] = now, 0.0, 0.0
                    if trial[RISING] == 3.0:
                        why, trial[VALUE], trial[AT_LIMIT] = 4.0, 0.0, watch[7]
            if why > 0.0:
                trial[PHASE], trial[WHY], trial[SHARE], u, back = 3.0, why, 0.0, e, k
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = y, u, x[0], trial[SHARE]
        d = delays[p]
        for i in range(line.size - 1, 0, -1):
            line[i] = line[i - 1]
        line[0] = u
        push = line[d] + force[k]
        new = A[p] @ x + B[p] * push
        for i in range(4):
            x[i] = new[i]
        if abs(x[0]) > travel:
            x[0], x[1] = travel * np.sign(x[0]), 0.0
            x[2], x[3] = x[0], 0.0
    return out, back


class Plant:
    """A driven mass with a load on a spring, viscous friction, a zero-order hold and a delay of whole samples."""

    def __init__(self, m, share, f_hz, damping, viscous, delay, gain=1.0):
        self.words = {"m": m, "share": share, "f_hz": f_hz, "damping": damping, "viscous": viscous, "delay": delay}
        m1, m2 = (1.0 - share) * m, share * m
        reduced = m1 * m2 / m
        c, d = reduced * (2 * np.pi * f_hz) ** 2, 2.0 * damping * reduced * 2 * np.pi * f_hz
        whole = np.zeros((5, 5))
        whole[0, 1] = whole[2, 3] = 1.0
        whole[1] = np.array([-c, -(d + viscous), c, d, gain]) / m1
        whole[3] = np.array([c, d, -c, -d, 0.0]) / m2
        step = expm(whole / RATE)
        self.A, self.B, self.delay, self.gain = step[:4, :4].copy(), step[:4, 4].copy(), delay, gain

    def changed(self, **words):
        """The same with other numbers."""
        return Plant(**{**self.words, "gain": self.gain, **words})

    def response(self, f):
        """Position over force, hold and delay in it."""
        z = np.exp(2j * np.pi * f / RATE)
        G = np.linalg.solve(z[:, None, None] * np.eye(4) - self.A, np.broadcast_to(self.B[:, None], (z.size, 4, 1)))
        return G[:, 0, 0] * z ** -float(self.delay)

    def poles(self, C):
        """The closed loop's, from the matrix of plant, delay line and sections."""
        rows = C.biquads()
        d, n = self.delay, len(rows)
        size = 4 + d + 2 * n
        M = np.zeros((size, size))
        # z as a row of the state: through the cascade, from e = -x0
        value, states = np.zeros(size), []
        value[0] = -1.0
        for k, (b0, b1, b2, a1, a2) in enumerate(rows):
            s1, s2 = np.zeros(size), np.zeros(size)
            s1[4 + d + 2 * k], s2[4 + d + 2 * k + 1] = 1.0, 1.0
            out = b0 * value + s1
            states.append((b1 * value - a1 * out + s2, b2 * value - a2 * out))
            value = out
        push = np.zeros(size)
        if d:
            push[4 + d - 1] = 1.0
        else:
            push = value
        M[:4, :4] = self.A
        M[:4] += np.outer(self.B, push)
        for i in range(d):
            M[4 + i] = value if i == 0 else np.eye(size)[4 + i - 1]
        for k, (one, two) in enumerate(states):
            M[4 + d + 2 * k], M[4 + d + 2 * k + 1] = one, two
        return np.linalg.eigvals(M)

    def peak_db(self, C):
        """The largest |S| of the true loop; inf where it is unstable."""
        if np.abs(self.poles(C)).max() >= 1.0 - 1e-9:
            return np.inf
        f = np.unique(np.concatenate([GRID, self.words["f_hz"] * np.linspace(0.9, 1.1, 1001)]))
        f = f[f < 499.5]
        return float(20 * np.log10(np.abs(1.0 / (1.0 + C.response(f) * self.response(f))).max()))


def tune(plant, cross_hz, f_hz, rng, notch=True, integrate=True):
    """A gain, a lead about the crossover, a low-pass, a notch at the resonance and an integrator."""
    blocks = [ls.lead_lag(cross_hz / 3.0, 3.0 * cross_hz), ls.low_pass(min(10.0 * cross_hz, 300.0), order=1)]
    blocks += [ls.notch(f_hz, 0.05, 0.4)] if notch else []
    blocks += [ls.pi(cross_hz / 12.0)] if integrate else []
    one = ls.controller(ls.gain(1.0), *blocks, rate_hz=RATE, loop="position")
    at = np.array([cross_hz])
    gain = 1.0 / float(np.abs(one.response(at) * plant.response(at))[0])
    return ls.controller(ls.gain(gain), *blocks, rate_hz=RATE, loop="position")


class Draw:
    """A machine, its old controller, a tune, and what is wrong with one of them."""

    def __init__(self, k):
        rng = np.random.default_rng([2811, k])
        self.kind = BAD[(k // 2) % len(BAD)] if k % 2 else "none"
        while not self._drawn(rng):
            pass
        self.rng = rng

    def _drawn(self, rng):
        self.bad = self.kind
        f = rng.uniform(60.0, 200.0)
        self.first = first = Plant(10.0 ** rng.uniform(0.0, 2.0), rng.uniform(0.1, 0.3), f, rng.uniform(0.003, 0.01),
                                   0.0, int(rng.integers(1, 3)))  # fmt: skip
        first = self.first = first.changed(viscous=first.words["m"] * rng.uniform(0.5, 5.0))
        slow = f * rng.uniform(0.04, 0.07)
        self.old = tune(first, slow, f, rng, notch=False, integrate=bool(rng.random() < 0.7))
        cross = slow * rng.uniform(2.0, 4.0)
        good = tune(first, cross, f * rng.uniform(0.99, 1.01), rng)
        if not (first.peak_db(self.old) < 5.0 and first.peak_db(good) < PEAK_DB - 0.3):
            return False
        self.file = self.loaded = good
        self.then = self.later = first
        factor, sign = rng.uniform(2.0, 4.0), rng.choice([-1.0, 1.0])
        bad = {"gain": ls.controller(ls.gain(factor), rate_hz=RATE, loop="position") * good,
               "no notch": tune(first, cross, f, rng, notch=False),
               "sign": ls.controller(ls.gain(-1.0), rate_hz=RATE, loop="position") * good}  # fmt: skip
        kind = self.bad.split(",")[0]
        if kind in bad:
            self.loaded = bad[kind]
            self.file = good if "loaded" in self.bad else self.loaded
        moved = {"resonance moved": {"f_hz": f * (1.0 + sign * rng.uniform(0.1, 0.3))},
                 "delay grown": {"delay": first.delay + int(rng.integers(2, 7))},
                 "changes under way": {"gain": factor} if rng.random() < 0.5
                 else {"f_hz": f * rng.uniform(0.6, 0.85)}}  # fmt: skip
        if self.bad in moved:
            self.later = first.changed(**moved[self.bad])
            self.then = first if self.bad in (BAD[-1], LAST) else self.later
        self.change_at = (int(rng.integers(1, 5)), rng.uniform(0.05, 0.95))
        if self.bad == BAD[-1] and self.change_at[0] == 4:
            self.bad = LAST
        self.noise, self.force = LIMIT_M * 10.0 ** rng.uniform(-5.0, -4.0), rng.uniform(0.0, 0.3)
        return self.later.peak_db(self.old) < 10.0 and self.then.peak_db(self.old) < 10.0

    @property
    def holds(self):
        """Whether the new controller that is loaded keeps the requirement on the machine as it is in the end."""
        return self.later.peak_db(self.loaded) <= PEAK_DB


class Machine:
    """A `Machine` for the course: the simulation, with what was measured beforehand."""

    def __init__(self, draw, seed):
        self.draw, self.rig = draw, ServoAxis()
        signal = Multisine(1.0, 400.0, 2.0, 0.1 * LIMIT_M, 6, ramp_s=0.5, seed=seed)
        one = ExperimentTemplate("axis", "multisine", "controller_input", "position", signal, lead_s=0.2)
        self.study = Study("simulated", "servo-axis", (one,), ({"position_m": 0.0},), RATE, seed,
                           controllers={"position": draw.old.blocks})  # fmt: skip
        self.rng = np.random.default_rng([2812, seed])
        self.restart()
        self.track = track_share(draw.loaded, RATE, 0.1)
        self.largest, self.back_after, self.done, self.recorded = 0.0, None, [], -1

    def restart(self):
        """At rest, the old controller alone."""
        self.x, self.line = np.zeros(4), np.zeros(12)
        self.w, self.v = (np.zeros((len(C.biquads()), 2)) for C in (self.draw.old, self.draw.loaded))
        self.trial = np.zeros(12)
        self.trial[PHASE] = 1.0
        self.watch = np.array([0.0, 1.0, 1.0, np.inf, -np.inf, np.inf, np.inf, np.inf, 0.0])

    def ran(self, r, n, plants, change):
        """So many ticks; position, control and true position, and the tick at which it went back."""
        self.watch[8] = self.track
        m = self.draw.first.words["m"]
        size = self.draw.force * m * LIMIT_M * 20.0
        noise, force = self.draw.noise * self.rng.standard_normal(r.size), size * self.rng.standard_normal(r.size)
        out, back = simulate(
            np.array([p.A for p in plants]), np.array([p.B for p in plants]), change, self.x,
            np.array([p.delay for p in plants]), self.line, self.draw.old.biquads(), self.draw.loaded.biquads(), self.w,
            self.v, self.trial, self.watch, r, n, noise, force, 50.0 * LIMIT_M,
        )  # fmt: skip
        self.largest = max(self.largest, float(np.abs(out[:, 2]).max()))
        on = self.trial[PHASE] in (2.0, 4.0) or back < r.size
        limit = np.full(r.size, self.watch[6] if on else np.nan)
        self.done.append(np.column_stack([out[:, 0], out[:, 3], limit]))
        return out, back

    def measured(self, share, controller, longer, plants, change=10**9):
        """A recording; the change, in ticks of it."""
        template = self.study.experiments[0]
        signal = replace(template.excitation, periods=round(longer * template.excitation.periods))
        study = replace(self.study, controllers={"position": controller.blocks},
                        experiments=(replace(template, excitation=signal),))  # fmt: skip
        e = experiment(study, self.rig, plan(study, self.rig)[0])
        rest = int(AFTER_S * RATE)
        n = np.concatenate([np.zeros(int(REST_S * RATE)), e.injected[:, 0]])
        before, changes = int(REST_S * RATE), self.trial[PHASE]
        out, back = self.ran(np.zeros(n.size), n, plants, before + change)
        if back < n.size and changes == 2.0:
            first = before + change if change < 10**9 else 0
            self.back_after = back - first if self.draw.bad in (BAD[-1], LAST) else int(self.trial[TICKS])
        self.ran(np.zeros(rest), np.zeros(rest), plants, 0 if change < 10**9 else 10**9)
        out = out[before : max(back, before + 1)] if back < n.size else out[before:]
        columns = {"t_s": np.arange(len(out)) / RATE, "reference_m": np.zeros(len(out)),
                   "n_position_m": e.injected[: len(out), 0], "force_n": out[:, 1],
                   "position_m": out[:, 0]}  # fmt: skip
        e = replace(e, name=f"a{round(100 * share):03d}")
        info = RecordingInfo.of(e, None if len(out) == e.samples else "went back")
        return Recording(info, RATE, columns), e.loops[0]

    def record(self, share, controller, watch, longer):
        """As the course asks; the change of a machine that changes under way falls into one share's recording."""
        d = self.draw
        plants = (d.then, d.later) if d.bad in (BAD[-1], LAST) else (d.later, d.later)
        if getattr(self, "changed", False):
            plants = (d.later, d.later)
        if watch is not None:
            self.ran(np.zeros(int(REST_S * RATE)), np.zeros(int(REST_S * RATE)), (plants[0],) * 2, 10**9)
            self.begin(watch)
            ramp = watch.ramp + 1
            _, back = self.ran(np.zeros(ramp), np.zeros(ramp), (plants[0],) * 2, 10**9)
            if back < ramp:
                self.back_after = int(self.trial[TICKS])
                self.ran(np.zeros(int(AFTER_S * RATE)), np.zeros(int(AFTER_S * RATE)), (plants[0],) * 2, 10**9)
                return None
        change, self.recorded = 10**9, self.recorded + 1
        if d.bad in (BAD[-1], LAST) and self.recorded == d.change_at[0] and not getattr(self, "changed", False):
            change, self.changed = int(d.change_at[1] * 12_000), True
        return self.measured(share, controller, longer, plants, change)[0]

    def begin(self, watch):
        """BLEND."""
        self.trial[[FROM, TICKS, SEEN, SUM, BEFORE, RISING]] = [self.trial[SHARE], 0.0, 0.0, 0.0, -1.0, 0.0]
        self.trial[PHASE] = 4.0 if watch.lease == 0 else 2.0
        self.watch[:8] = [watch.share, watch.ramp, watch.window, watch.error_peak, watch.control_low,
                          watch.control_high, watch.error_rms, watch.growth]  # fmt: skip

    def progress(self):
        """PROGRESS."""
        t = self.trial
        return Progress(Phase(int(t[PHASE])), Why(int(t[WHY])), int(t[TICKS]), t[SHARE], t[VALUE], t[AT_LIMIT])

    def keep(self, watch):
        """For so long it stays watched, while what disturbs the machine goes on."""
        self.begin(watch)
        n = int(KEPT_S * RATE)
        plants = (self.draw.later, self.draw.later)
        self.ran(np.zeros(n), np.zeros(n), plants, 10**9)
        return self.progress()

    def back(self):
        """To the old controller."""
        if self.trial[PHASE] == 2.0:
            self.trial[PHASE], self.trial[WHY], self.trial[SHARE] = 3.0, 6.0, 0.0

    def thinking(self):
        """Nothing goes on meanwhile."""
        return nullcontext()


def tried(k, machines=None):
    """One draw: what was decided, and what is true."""
    draw = Draw(k)
    machine = Machine(draw, k)
    (machines if machines is not None else []).append(machine)
    run, loop = machine.measured(0.0, draw.old, 1.0, (draw.first, draw.first))
    before = ls.frf(ls.Run(RATE, (replace(loop, controller=draw.old),), (run,), "axis"))
    machine.restart()
    machine.largest, machine.done = 0.0, []
    R = ls.Requirements("position", sensitivity_peak_db=PEAK_DB, unstable_poles=0, integrators=1)
    trial = Trial(replace(loop, controller=draw.old), draw.old, draw.file, R, TrialSettings())
    found = adopt(trial, machine, [before])
    last = found.steps[-1] if found.steps else None
    by_target = last is not None and last.progress is not None
    return {
        "draw": k, "wrong": draw.bad, "holds": draw.holds, "true_peak_db": round(draw.later.peak_db(draw.loaded), 2),
        "outcome": found.outcome.value, "last_share": last.share if last else "", "by_target": by_target,
        "why": found.reason[:150], "ticks_to_go_back": machine.back_after if by_target else "",
        "largest_of_limit_percent": round(100.0 * machine.largest / LIMIT_M, 1),
    }  # fmt: skip


def trace(k):
    """A draw as a picture shows it: rms of the error over 0.1 s, the share, and the rms that is allowed."""
    machines = []
    tried(k, machines)
    done = np.concatenate(machines[0].done)
    done = done[: 1000 + np.flatnonzero(done[:, 1])[-1]]  # the excitation, which goes on here, stops on a target
    done = done[: len(done) // 100 * 100].reshape(-1, 100, 3)
    rms = 1e6 * np.sqrt(np.mean(done[:, :, 0] ** 2, axis=1))
    rows = np.column_stack([0.1 * (1 + np.arange(len(done))), rms, done[:, -1, 1], 1e6 * done[:, -1, 2]])
    write("trace.csv", ("time_s", "error_rms_um", "share", "allowed_rms_um"), np.round(rows, 4).tolist())


def row_of(wrong, holds, mine):
    """Of these draws how many ended how."""
    ends = Counter(r["outcome"] for r in mine)
    ticks = [r["ticks_to_go_back"] for r in mine if r["ticks_to_go_back"] != ""]
    largest = max((r["largest_of_limit_percent"] for r in mine), default="")
    by_target = sum(bool(r["by_target"]) for r in mine)
    return (wrong, holds, len(mine), *(ends[one.value] for one in Adopted), by_target, max(ticks, default=""), largest)


def main(draws):
    """All draws, and their table."""
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for k in range(draws):
            rows.append(tried(k))
            print(*rows[-1].values(), flush=True)
    write("draws.csv", list(rows[0]), [list(row.values()) for row in rows])
    kinds = [(wrong, holds) for wrong in ("none", *BAD, LAST) for holds in (True, False)]
    table = [row_of(*kind, [r for r in rows if (r["wrong"], r["holds"]) == kind]) for kind in kinds]
    good = [r for r in rows if r["holds"] and "loaded" not in r["wrong"] and r["wrong"] != LAST]
    table.append(row_of("all that hold and were checked", True, good))
    table.append(row_of("all that do not", False, [r for r in rows if not r["holds"] and r["wrong"] != LAST]))
    columns = ("what_is_wrong", "holds", "draws", "adopted", "went_back", "undecided", "refused", "back_by_the_target",
               "most_ticks_to_go_back", "largest_of_limit_percent")  # fmt: skip
    write("tunes.csv", columns, [row for row in table if row[2]])


def write(name, columns, rows):
    """A table, and the same on the terminal."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    for row in rows if name == "tunes.csv" else []:
        print(*row)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else DRAWS)
    trace(SHOWN)
