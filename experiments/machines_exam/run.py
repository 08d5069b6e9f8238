"""Sealed exams on carts and booms: seed-*/ with sealed.csv, answers/*.json, results.csv, score.csv; one figure each.

python experiments/machines_exam/run.py [SEED [N]]     goes on where it stopped, at most N diagnoses
"""

from __future__ import annotations

import csv
import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import beta

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own files, however it is started

import engine_other  # noqa: E402
from engine import recorded  # noqa: E402
from specimens import ALIKE, COLUMNS, PLACES, SPREAD, XML, Specimen, specimen  # noqa: E402

import loopshape as ls  # noqa: E402
from loopshape.core.errors import UnreadableInputError  # noqa: E402
from loopshape.io.files import write_bytes_whole, write_json  # noqa: E402
from loopshape.toolbox.gap.mechanism.mechanism import machine  # noqa: E402
from loopshape.toolbox.gap.nouns.machine import Mechanism, Model  # noqa: E402
from loopshape.view.style import COLOURS, head, new_figure, png, styled  # noqa: E402

FIGURES = HERE.parents[1] / "figures" / HERE.name
SEEDS = (2026, 2027, 2028, 2029)
SLIPS = 2028  # from this exam on the engine has the other friction and drag
OTHER_ENGINE = 2029  # from this exam on the second engine simulates
SINGLE = {
    "cart": ("coulomb_friction", "viscous_error", "joint_flexibility", "backlash", "payload", "actuator_lag"),
    "boom": (
        "coulomb_friction", "cable_stiffness", "backlash", "length_error", "base_tilt", "sensor_delay",
        "actuator_saturation", "dead_zone", "sensor_gain",
    ),
}  # fmt: skip
OTHER = (
    ("cart", "none"),
    ("boom", "none"),
    ("boom", "none"),
    ("cart", "cogging"),
    ("boom", "sag"),
    ("boom", "cogging"),
)
UNLISTED = ("cogging", "sag", "rate_limit")
AT = {"actuator": 0, "dead": 0, "sensor": 1, "payload": 3, "length": 3}  # by first word, else the joint


def main() -> None:
    """Sit each exam: seal the labels, diagnose what has no answer yet, then open and score."""
    seeds = [int(sys.argv[1])] if len(sys.argv) > 1 else SEEDS
    most = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    for seed in seeds:
        exam(seed, HERE / f"seed-{seed}", most)


def exam(seed: int, folder: Path, most: int) -> None:
    """One exam in a folder of its own."""
    cases = shuffled(seed)
    answers = folder / "answers"
    answers.mkdir(exist_ok=True, parents=True)
    seal(cases, folder / "sealed.csv")
    left = [c for c in cases if not (answers / f"{c[0]}.json").exists()]
    for case in left[:most]:
        start = time.monotonic()
        s = simulated(case, seed)
        found = ls.gap(s.run, model=described(s.plant), table=False, name=s.name)
        write_json(answers / f"{s.name}.json", found.to_dict())
        print(f"{found.sentence} ({time.monotonic() - start:.0f} s)", flush=True)
    if len(left) <= most:
        opened([simulated(c, seed) for c in cases], folder)


def simulated(case: tuple[str, str, str, int], seed: int) -> Specimen:
    """A specimen by the engine of its exam."""
    engine = engine_other.recorded if seed >= OTHER_ENGINE else recorded
    return specimen(*case, slips=seed >= SLIPS, simulate=engine)


def shuffled(seed: int) -> list[tuple[str, str, str, int]]:
    """Name, plant, effect and seed of each specimen."""
    rng = np.random.default_rng(seed)
    every = [(plant, effect) for plant, effects in SINGLE.items() for effect in effects] + list(OTHER)
    return [(f"e{k + 1:02d}", *every[i], seed + 100 * k) for k, i in enumerate(rng.permutation(len(every)))]


def seal(cases: Sequence[tuple[str, str, str, int]], path: Path) -> None:
    """Hashes of the labels, written once, before any answer."""
    if path.exists():
        return
    rows = [(name, plant, hashlib.sha256(f"{effect}/{own}".encode()).hexdigest()) for name, plant, effect, own in cases]
    write(path, ("specimen", "plant", "sha256"), rows)


def described(plant: str) -> Model:
    """The nominal machine by its MJCF."""
    try:
        import mujoco
    except ImportError:
        raise UnreadableInputError("the study needs mujoco", "it is not installed", "pip install mujoco") from None
    actuator, sensor, joint, body = PLACES[plant]
    u, y = COLUMNS[plant]
    spread = {
        "mass": {body: SPREAD["mass"]}, "damping": {joint: SPREAD["damping"]},
        "armature": {joint: SPREAD["armature"]}, "motor_constant": {actuator: SPREAD["motor_constant"]},
    }  # fmt: skip
    spec = mujoco.MjSpec.from_string(XML[plant])
    without = ("force_offset",)
    return machine(Mechanism(plant, spec, spread, {actuator: (u, 1.0)}, {sensor: (y, 1.0)}, without=without))


def truths(s: Specimen) -> tuple[str, ...]:
    """Names that are right: the label, and what no recording tells from it."""
    if s.effect == "none":
        return ("none",)
    if s.effect in UNLISTED:
        return ("unknown",)
    kinds = next((group for group in ALIKE[s.plant] if s.effect in group), {s.effect})
    return tuple(named(kind, s.plant) for kind in sorted(kinds))


def named(kind: str, plant: str) -> str:
    """`kind@place`."""
    place = "base" if kind == "base_tilt" else PLACES[plant][AT.get(kind.split("_")[0], 2)]
    return f"{kind}@{place}"


def opened(specimens: Sequence[Specimen], folder: Path) -> None:
    """Results one by one, shares with their 95 % intervals, and the figure."""
    rows = [marked(s, json.loads((folder / "answers" / f"{s.name}.json").read_text())) for s in specimens]
    write(folder / "results.csv", tuple(rows[0]), [tuple(r.values()) for r in rows])
    single = [r for r in rows if r["kind"] == "single"]
    sized = [r for r in single if r["right"] and r["effect"] not in ("viscous_error", "joint_flexibility")]
    shares = [
        share("kind and place named, single effects", single, lambda r: bool(r["right"])),
        share("among the first two", single, lambda r: bool(r["second"])),
        share("place right", single, lambda r: bool(r["place"])),
        share("false alarms on healthy machines", [r for r in rows if r["kind"] == "none"], lambda r: not r["right"]),
        share("unlisted effects recognised", [r for r in rows if r["kind"] == "unlisted"], lambda r: bool(r["right"])),
        share("size within 20 %", sized, lambda r: abs(float(r["found"]) / float(r["magnitude"]) - 1.0) < 0.2),
        share("95 % interval of the size covers it", sized, lambda r: bool(r["covered"])),
    ]
    write(folder / "score.csv", ("share", "right", "of", "value", "low_95", "high_95"), shares)
    FIGURES.mkdir(parents=True, exist_ok=True)
    write_bytes_whole(FIGURES / f"{folder.name}.png", drawn_score(shares, folder.name))


def marked(s: Specimen, a: dict) -> dict:
    """One row: label, answer, and whether it is right."""
    right, first = truths(s), a["ranking"][0]
    kind = "none" if s.effect == "none" else "unlisted" if s.effect in UNLISTED else "single"
    ends = first.get("interval") or (np.nan, np.nan)
    sign = -1.0 if first["effect"].split("@")[0] != s.effect and s.effect in ("base_tilt", "sensor_offset") else 1.0
    found = sign * float(first.get("magnitude") or np.nan)
    low, high = sorted((sign * ends[0], sign * ends[1]))
    place = {r.partition("@")[2] for r in right} & {p.partition("@")[2] for p in a["verdict"].split("+")}
    return {
        "specimen": s.name, "plant": s.plant, "kind": kind, "effect": s.effect, "magnitude": f"{s.magnitude:.4g}",
        "verdict": a["verdict"], "probability": f"{first['probability']:.3f}", "right": a["verdict"] in right,
        "second": any(r["effect"] in right for r in a["ranking"][:2]), "place": a["verdict"] in right or bool(place),
        "found": f"{found:.4g}", "covered": bool(low <= s.magnitude <= high),
        "before": f"{a['gap']['before']:.2f}", "after": f"{a['gap']['after']:.2f}",
    }  # fmt: skip


def share(name: str, rows: Sequence[dict], good: Callable[[dict], bool]) -> tuple[str, int, int, str, str, str]:
    """A share with its interval after Clopper and Pearson."""
    k, n = sum(good(r) for r in rows), len(rows)
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return name, k, n, f"{k / max(n, 1):.3f}", f"{low:.3f}", f"{high:.3f}"


def drawn_score(shares: Sequence[tuple[str, int, int, str, str, str]], name: str) -> bytes:
    """Shares with their intervals, one a line."""
    with styled():
        figure = new_figure(size=(6.0, 3.2))
        ax = figure.axes[0]
        for k, (_, _, _, value, low, high) in enumerate(shares):
            ax.plot([float(low), float(high)], [k, k], color=COLOURS[0], lw=1.2)
            ax.plot(float(value), k, "o", color=COLOURS[0])
        ax.set_yticks(range(len(shares)), [f"{name} ({k} of {n})" for name, k, n, *_ in shares])
        ax.set_xlim(0.0, 1.0)
        ax.invert_yaxis()
        ax.set_xlabel("share, with its 95 % interval")
        head(figure, f"Sealed exam on carts and booms, {name}")
        return png(figure)


def write(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """A table."""
    with path.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows(rows)


if __name__ == "__main__":
    main()
