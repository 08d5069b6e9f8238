"""The peers of the exam: plain least squares and MuJoCo's own `sysid` on the same specimens; peers.csv.

python experiments/machines_exam/peers.py [SEED [N]]     goes on where it stopped, the first N specimens;
needs pip install 'loopshape[peers]'

Both have all numbers free, windows of the length that our answer used, the same noise floors, tolerances, starts and
a hold to the nominal numbers. The name is the number that changed most, in tolerances, and by what the change does
to the outputs. What is no number of the model or of MuJoCo's format (play, a spring in the joint; for sysid a dead
zone) cannot be named.
"""

from __future__ import annotations

import csv
import io
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "falsified")]  # the study's own files, then the other study's peer

from peer import (  # noqa: E402
    HOLD,
    INSIDE,
    LATE_MS,
    MOST,
    ORDINARY,
    PLAIN,
    SEED,
    SHARE,
    SPREAD,
    STARTS,
    STEP,
    Number,
    least_squares_name,
    named,
)  # fmt: skip
from run import UNLISTED, described, shuffled, simulated, truths, write  # noqa: E402
from specimens import PLACES, XML, G, Specimen  # noqa: E402
from specimens import SPREAD as WITHIN  # noqa: E402

from loopshape.core.errors import UnreadableInputError  # noqa: E402
from loopshape.toolbox.gap.own.following import Followed  # noqa: E402
from loopshape.toolbox.gap.own.plant import OwnMachine  # noqa: E402
from loopshape.toolbox.gap.own.signals import lagged  # noqa: E402

SEEDS = (2030,)
FAR = 40.0  # tolerances: sysid wants finite bounds
ROUNDS, THINNED = 12, 3  # of sysid: iterations a start; one window in three is followed
SHIFT, LOOSE = 1e-3, 1.0 / 9.0  # of initial states, in ranges; they lie within three, as in the package
TILTED, LONGER = 0.35, 0.16  # rad and m: ends of the package's ranges, whose share is a tolerance
OF_OTHERS = {"mass_wagon": "payload@wagon", "damping_rail": "viscous_error@rail",
             "mass_mast": "payload@mast", "damping_pivot": "viscous_error@pivot"}  # fmt: skip
HEADER = ("seed", "specimen", "plant", "effect", "peer", "verdict", "rank", "verdict_by_outputs", "rank_by_outputs",
          "found", "before", "after", "seconds", "why")  # fmt: skip
SCORE = ("peer", "of", "first name", "first two", "first name by outputs", "first two by outputs",
         "healthy, given a name", "unlisted, given a name", "failed", "seconds, median")  # fmt: skip
Set = Callable[[Any, float], None]


def main() -> None:
    """Both peers on every specimen that has no row yet."""
    try:
        from mujoco import sysid
    except ImportError:
        sysid = None
    if not hasattr(sysid, "optimize"):
        raise UnreadableInputError(
            "the peers need mujoco[sysid]", "it is not installed", "pip install 'loopshape[peers]'"
        )
    path = HERE / "peers.csv"
    rows = list(csv.reader(path.open()))[1:] if path.exists() else []
    done = {(row[0], row[1], row[4]) for row in rows}
    seeds = [int(sys.argv[1])] if len(sys.argv) > 1 else SEEDS
    most = int(sys.argv[2]) if len(sys.argv) > 2 else None
    for seed in seeds:
        for case in shuffled(seed)[:most]:
            if all((str(seed), case[0], peer) in done for peer in PEERS):
                continue
            answer = HERE / f"seed-{seed}" / "answers" / f"{case[0]}.json"
            s = simulated(case, seed)
            plant = OwnMachine(described(s.plant)).windowed(json.loads(answer.read_text())["window_s"])
            for peer, ask in PEERS.items():
                if (str(seed), s.name, peer) not in done:
                    rows.append([str(seed), *asked(s, plant, peer, ask)])
                    print(*rows[-1], flush=True)
                    write(path, HEADER, sorted(rows))
    write(HERE / "peers_score.csv", SCORE, [scored(peer, rows) for peer in ("loopshape", *PEERS)])


def scored(peer: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Counts of one peer, or of our first answers to the specimens that a peer has answered."""
    own = [dict(zip(HEADER, row, strict=True)) for row in rows if row[4] == peer]
    if peer not in PEERS:
        known = {(row[0], row[1]) for row in rows}
        own = [ours(seed, name) for seed, name in sorted(known)]
    single = [r for r in own if r["effect"] not in ("none", *UNLISTED)]

    def count(rank: str, most: int) -> str:
        return f"{sum(bool(r[rank]) and int(r[rank]) <= most for r in single)} of {len(single)}"

    def given(effects: Sequence[str]) -> str:
        some = [r for r in own if r["effect"] in effects]
        return f"{sum(r['verdict'] not in ('none', 'unknown', 'failed') for r in some)} of {len(some)}"

    shares = [count(rank, most) for rank in ("rank", "rank_by_outputs") for most in (1, 2)]
    seconds = [float(r["seconds"]) for r in own if r["seconds"]]
    failed = sum(r["verdict"] == "failed" for r in own)
    return [peer, str(len(own)), *shares, given(("none",)), given(UNLISTED), str(failed),
            f"{np.median(seconds):.0f}" if seconds else ""]  # fmt: skip


def ours(seed: str, name: str) -> dict[str, str]:
    """Our row of a specimen; it has one ranking, and seconds were not kept."""
    with (HERE / f"seed-{seed}" / "results.csv").open() as file:
        row = next(r for r in csv.DictReader(file) if r["specimen"] == name)
    rank = "1" if row["right"] == "True" else "2" if row["second"] == "True" else ""
    return {"effect": row["effect"], "verdict": row["verdict"], "rank": rank, "rank_by_outputs": rank, "seconds": ""}


def asked(s: Specimen, plant: OwnMachine, peer: str, ask: Callable[[Specimen, OwnMachine], dict]) -> list[str]:
    """One row; a peer that fails says why."""
    start, known = time.process_time(), [s.name, s.plant, s.effect, peer]
    try:
        a = ask(s, plant)
    except Exception as error:  # an answer too
        return [*known, "failed", *[""] * 6, f"{time.process_time() - start:.1f}", str(error)[:200]]
    right = truths(s)
    ranks = [next((k + 1 for k, r in enumerate(own["ranking"]) if r["effect"] in right), "")
             for own in (a, a["by_outputs"])]  # fmt: skip
    size = next((f"{r['magnitude']:.4g}" for r in a["ranking"] if r["effect"] in right), "")
    gap = [f"{a['gap'][k]:.2f}" for k in ("before", "after")]
    return [*known, a["verdict"], str(ranks[0]), a["by_outputs"]["verdict"], str(ranks[1]), size, *gap,
            f"{time.process_time() - start:.1f}", ""]  # fmt: skip


def squares(s: Specimen, plant: OwnMachine) -> dict:
    """Plain least squares."""
    return least_squares_name(plant, s.run, OF_OTHERS)


def sysid_name(s: Specimen, plant: OwnMachine) -> dict:
    """MuJoCo's `sysid`: parameters in tolerances, the best of some starts by its own objective."""
    from mujoco import sysid

    parts = {
        role: [thinned(plant.prepare(r, s.run, None)) for r in s.run.recordings if r.info.role == role]
        for role in ("estimation", "validation")
    }
    table, setters = numbers(s.plant, parts["estimation"])
    fit, checked = (Windows(s.plant, own, table, setters) for own in parts.values())
    rng, best = np.random.default_rng(SEED), None
    for k in range(STARTS):
        params = parameters(table, setters)
        low, high = params.get_bounds()
        start = np.where(low == 0.0, INSIDE, 0.0) + SPREAD * (k > 0) * rng.uniform(-1, 1, low.size)
        params.update_from_vector(np.clip(start, low + INSIDE, high - INSIDE))
        _, found = sysid.optimize(params, fit.residual, "mujoco", verbose=False, max_iters=ROUNDS, eps=STEP,
                                  output=io.StringIO())  # fmt: skip
        cost = float(np.sum(np.concatenate(fit.residual(found.x, params)[0]) ** 2))
        best = (cost, found.x) if best is None or cost < best[0] else best
    assert best is not None
    x = np.ravel(best[1])
    slopes = (fit.left(x[:, None] + STEP * np.eye(x.size)) - fit.left(x[:, None])) / STEP
    held = np.concatenate([slopes, HOLD * np.eye(x.size)])
    spread = np.sqrt(np.mean(fit.left(x[:, None]) ** 2)) * np.sqrt(np.diag(np.linalg.pinv(held.T @ held)))
    before, after = (float(np.sqrt(np.mean(checked.left(y[:, None]) ** 2))) for y in (0.0 * x, x))
    felt = np.abs(x) * np.sqrt(np.mean(slopes**2, axis=0))
    answer = named(table, x, spread, np.abs(x), ORDINARY)
    return answer | {"gap": {"before": before, "after": after}, "by_outputs": named(table, x, spread, felt, PLAIN)}


def thinned(f: Followed) -> Followed:
    """The recording with fewer windows: a step of MuJoCo costs much."""
    return replace(f, first=f.first[::THINNED], start=f.start[::THINNED])


class Windows:
    """Recordings in windows as sysid follows them; what initial states explain is taken out, as in the package."""

    def __init__(self, plant: str, parts: Sequence[Followed], table: Sequence[Number], setters: Sequence[Set]) -> None:
        from mujoco import sysid

        self.table, self.params, self.spec = table, parameters(table, setters), started(plant, parts[0].tick_s)
        self.lead, self.block = parts[0].lead, parts[0].block
        self.floors = np.concatenate([np.full(f.first.size, f.floor[0]) for f in parts])[:, None, None]
        self.model = sysid.apply_param_modifiers(self.params, self.spec)
        self.raw = self.followed(parts, np.zeros(2))
        nominal, base = np.zeros((len(table), 1)), None
        for shift in (np.zeros(2), *(SHIFT * np.diag(parts[0].ranges))):
            own = self.floored(self.followed(parts, shift), nominal)
            base = own if base is None else np.concatenate([base, own], axis=2)
        assert base is not None
        self.slopes = (base[:, :, 1:] - base[:, :, :1]) / SHIFT
        turned = np.swapaxes(self.slopes, 1, 2)
        self.answer = np.linalg.solve(turned @ self.slopes + LOOSE * np.eye(2), turned)

    def followed(self, parts: Sequence[Followed], shift: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Residuals of sysid (windows, values, columns) by changes, initial states of windows moved by a shift (2,)."""
        from mujoco import sysid

        windows = []
        for f in parts:
            for k, first in enumerate(f.first):
                u, y = (values[first : first + f.length] for values in (f.u, f.y))
                times, (q, v) = np.arange(f.length) * f.tick_s, f.start[k] + shift
                state = sysid.create_initial_state(self.model, np.array([q]), np.array([v]))
                seen = sysid.TimeSeries.from_names(times, y, self.model)
                windows.append(sysid.SystemTrajectory(self.model, sysid.TimeSeries(times, u), seen, state, None))

        def build(params: Any) -> Any:
            return sysid.apply_param_modifiers(params, self.spec)

        def raw(x: np.ndarray) -> np.ndarray:
            off, _, _ = sysid.model_residual(x, self.params, build, windows, self.compared, n_threads=1)
            return np.transpose(off.reshape(off.shape[0], -1, len(windows)), (2, 0, 1))

        return raw

    def compared(
        self, params: Any, predicted: Any, measured: Any, model: Any, everything: bool, state: Any = None
    ) -> tuple[np.ndarray, Any, Any]:
        """Block means (1, values) of measured less predicted, and the series as they came."""
        own = {n.key: n.start + n.tolerance * float(v) for n, v in zip(self.table, params.as_vector(), strict=True)}
        times, path = measured.times, np.concatenate([[2.0 * state[0, 1] - state[1, 1]], state[:, 1]])
        path = lagged(path, 1e-3 * own["lag"] / times[1], 1.0) if own["lag"] > 0.0 else path
        seen = np.interp(times - 1e-3 * own["delay"], times, path)
        off = measured.data[:, 0] - (1.0 + own["sensor_gain"]) * seen - own["offset"]
        return off[self.lead :].reshape(-1, self.block).mean(axis=1)[None], measured, measured

    def floored(self, raw: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
        """Residuals (windows, values, columns) in floors for changes x (n, columns)."""
        off = raw(x) / self.floors
        return np.clip(np.nan_to_num(off, nan=MOST), -MOST, MOST)

    def left(self, x: np.ndarray) -> np.ndarray:
        """What no initial state explains (values, columns) in floors, for changes x (n, columns)."""
        off = self.floored(self.raw, x)
        return (off - self.slopes @ (self.answer @ off)).reshape(-1, x.shape[1])

    def residual(self, x: np.ndarray, params: Any) -> tuple[list[np.ndarray], list, list]:
        """As sysid wants it, the hold at last."""
        columns = x.reshape(x.shape[0], -1)
        both = np.concatenate([self.left(columns), HOLD * columns])
        return [both[:, 0] if x.ndim == 1 else both], [], []


def started(plant: str, tick_s: float) -> Any:
    """The MJCF model, one step a tick, with an actuator that may be limited."""
    import mujoco

    spec = mujoco.MjSpec.from_string(XML[plant])
    spec.option.timestep, spec.option.integrator = tick_s, mujoco.mjtIntegrator.mjINT_RK4
    spec.actuator(PLACES[plant][0]).forcelimited = True
    return spec


def parameters(table: Sequence[Number], setters: Sequence[Set]) -> Any:
    """Parameters of sysid in tolerances."""
    from mujoco import sysid

    def modifier(n: Number, own: Set) -> Callable[[Any, Any], None]:
        return lambda spec, p: own(spec, n.start + n.tolerance * float(p.value[0]))

    out = sysid.ParameterDict()
    for n, own in zip(table, setters, strict=True):
        out.add(sysid.Parameter(n.key, 0.0, max(n.low, -FAR), min(n.high, FAR), modifier=modifier(n, own)))
    return out


def numbers(plant: str, parts: Sequence[Followed]) -> tuple[list[Number], list[Set]]:
    """All numbers that MuJoCo's format has for such a machine, and what sets each in a spec.

    What reads the sensor sets nothing there. Tolerances are those of the exam; where there is none, those of `peer`.
    """
    actuator, sensor, joint, body = PLACES[plant]
    u, y, starts = (np.concatenate([getattr(f, name) for f in parts]) for name in ("u", "y", "start"))
    push, peak = SHARE * float(np.sqrt(np.mean(u**2))), float(np.abs(u).max())
    travel = float(np.ptp(starts[:, 0]))
    usual = started(plant, 1e-3).joint(joint)
    damping, armature = float(usual.damping[0]), float(usual.armature)

    def first(kind: str, name: str, numeric: str) -> Set:
        def put(spec: Any, value: float) -> None:
            getattr(getattr(spec, kind)(name), numeric)[0] = value

        return put

    def at_joint(numeric: str) -> Set:
        return lambda spec, value: setattr(spec.joint(joint), numeric, value)

    def tilt(spec: Any, value: float) -> None:
        spec.option.gravity = [G * np.sin(value), 0.0, -G * np.cos(value)]

    def limit(spec: Any, value: float) -> None:
        spec.actuator(actuator).forcerange = [-value, value]

    def nothing(spec: Any, value: float) -> None:
        """A number of the sensor's."""

    cable, most = f"cable_stiffness@{joint}", 0.9 / SHARE
    rows = [
        (_own(f"viscous_error@{joint}", "damping", damping, WITHIN["damping"]), first("joint", joint, "damping")),
        (_own(f"parameter_error@{joint}", "armature", armature, WITHIN["armature"]), at_joint("armature")),
        (Number(f"coulomb_friction@{joint}", "coulomb", push, 0.0), at_joint("frictionloss")),
        (Number(cable, "stiffness", push / travel, 0.0), first("joint", joint, "stiffness")),
        (Number(cable, "rest", travel, start=float(np.median(starts[:, 0]))), at_joint("springref")),
        (_own(f"actuator_gain_error@{actuator}", "gain", 1.0, WITHIN["motor_constant"]),
         first("actuator", actuator, "gainprm")),
        (Number(f"actuator_saturation@{actuator}", "limit", -SHARE * peak, 0.0, most, peak), limit),
        (Number("base_tilt@base", "tilt", SHARE * TILTED), tilt),
        (Number(f"sensor_gain@{sensor}", "sensor_gain", SHARE), nothing),
        (Number(f"sensor_offset@{sensor}", "offset", SHARE * float(np.abs(y).max())), nothing),
        (Number(f"sensor_delay@{sensor}", "delay", LATE_MS, 0.0), nothing),
        (Number(f"sensor_lag@{sensor}", "lag", LATE_MS, 0.0), nothing),
        *_bodies(plant, body),
    ]  # fmt: skip
    return [n for n, _ in rows], [own for _, own in rows]


def _own(effect: str, key: str, value: float, share: float) -> Number:
    """A number of the model with its tolerance, that stays above a tenth of what it is."""
    return Number(effect, key, share * value, -0.9 / share, start=value)


def _bodies(plant: str, body: str) -> list[tuple[Number, Set]]:
    """Mass of the wagon; of the mast's bob, and how long it is, its tube heavier with it."""
    if plant == "cart":
        own = _own(f"payload@{body}", "mass", 1.7, WITHIN["mass"])
        return [(own, lambda spec, value: setattr(spec.geom("box"), "mass", value))]

    def length(spec: Any, value: float) -> None:
        tube, bob = spec.geom("tube"), spec.geom("bob")
        tube.fromto, tube.mass, bob.pos = [0.0, 0.0, 0.0, 0.0, 0.0, -value], 0.3 * value / 0.4, [0.0, 0.0, -value]

    return [
        (_own(f"payload@{body}", "mass", 0.35, WITHIN["mass"]),
         lambda spec, value: setattr(spec.geom("bob"), "mass", value)),
        (Number(f"length_error@{body}", "length", SHARE * LONGER, -FAR / 2, start=0.4), length),
    ]  # fmt: skip


PEERS = {"least squares": squares, "mujoco sysid": sysid_name}

if __name__ == "__main__":
    main()
