"""Honest models of real machines, falsified one number at a time: what does the diagnosis name?

python experiments/falsified/run.py                  all that has no answer yet, then the score
  --only NAME      one specimen (emps-03) or a case of any machine (no_coulomb): printed, not kept
  --machine NAME   the specimens of one machine
  --every K        every K-th specimen of each machine, the honest models always
  --jobs N         so many at the same time, one core each
  --into NAME      tables NAME.csv (score) and NAME_results.csv; "score" if not given
  --peer           plain least squares instead of the diagnosis (tables peer.csv, peer_results.csv)
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "lab")]  # the study's own files and the lab, however it is started

import emps  # noqa: E402
import pendulums  # noqa: E402
import qube  # noqa: E402
import tokyo  # noqa: E402
from common import Case, Real, false, honest  # noqa: E402
from examiner.score import calibrated, share  # noqa: E402
from peer import least_squares_name  # noqa: E402

from loopshape.toolbox.gap.diagnose.diagnose import diagnose  # noqa: E402
from loopshape.toolbox.gap.own.plant import OwnMachine  # noqa: E402

MACHINES = {m.name: m for m in (emps.AXIS, qube.DRIVE, tokyo.BENCH, pendulums.PENDULUM)}
SEED = 2031  # of the order in which specimens are numbered
HONEST = Case("honest", {}, "none")
SAYS_NO_NAME = ("none", "unknown")
SURE, NEAR = 0.5, 0.2  # stated probability that counts as a false name, share of a size
PLAIN = 1.5  # of what the honest model leaves held out: a falsification that these recordings plainly show
Specimen = tuple[str, Real, Case]


def main() -> None:
    """Seal, diagnose what has no answer yet, score."""
    asked = options()
    for machine in MACHINES.values():
        if not machine.there:
            print(f"{machine.name} is skipped: its recordings are absent, set LOOPSHAPE_DATA to their folder")
    every = [s for m in MACHINES.values() if m.there for s in specimens(m)]
    if not every:
        return
    if not asked.only:
        seal(every, HERE / "sealed.csv")
    path = HERE / f"{'' if asked.into == 'score' else asked.into + '_'}results.csv"
    known = {} if asked.only else read(path)
    left = [s for s in chosen(every, asked) if s[0] not in known]
    for row in answers(left, asked, path):
        known[row["specimen"]] = row
        print(*(f"{k} {row[k]}" for k in SHOWN), sep=", ", flush=True)
        if not asked.only:
            known = {**read(path), **known}  # another process may work on the same table
            write(path, [known[s[0]] for s in every if s[0] in known])
    if not asked.only:
        rows = [known[s[0]] for s in every if s[0] in known]
        write(HERE / f"{asked.into}.csv", scored(rows))


def answers(left: Sequence[Specimen], asked: argparse.Namespace, path: Path) -> Iterator[dict]:
    """Rows as they come, several at the same time if asked for."""
    if asked.jobs == 1:
        for s in left:
            if asked.only or s[0] not in read(path):  # another process may have answered since
                yield answered(s[0], s[1].name, s[2].name, asked.peer)
        return
    with ProcessPoolExecutor(asked.jobs) as pool:
        tasks = [pool.submit(answered, s[0], s[1].name, s[2].name, asked.peer) for s in left]
        yield from (task.result() for task in as_completed(tasks))


SHOWN = ("specimen", "case", "label", "verdict", "probability", "first_name", "rank", "found", "size", "seconds")


def options() -> argparse.Namespace:
    """What was asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only")
    parser.add_argument("--machine", choices=list(MACHINES))
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--peer", action="store_true")
    parser.add_argument("--into")
    asked = parser.parse_args()
    asked.into = asked.into or ("peer" if asked.peer else "score")
    return asked


def specimens(machine: Real) -> list[Specimen]:
    """The honest model and all falsified ones, numbered in an order drawn from a seed."""
    every = [HONEST, *machine.cases(honest(machine))]
    order = np.random.default_rng(SEED).permutation(len(every))
    return [(f"{machine.name}-{k + 1:02d}", machine, every[i]) for k, i in enumerate(order)]


def chosen(every: Sequence[Specimen], asked: argparse.Namespace) -> list[Specimen]:
    """Those asked for."""
    if asked.only:
        return [s for s in every if asked.only in (s[0], s[2].name)]
    some = [s for k, s in enumerate(every) if k % asked.every == 0 or s[2] is HONEST]
    return [s for s in some if asked.machine in (None, s[1].name)]


def seal(every: Sequence[Specimen], path: Path) -> None:
    """Hashes of the labels, written once, before any answer."""
    if not path.exists():
        rows = [{"specimen": s, "machine": m.name, "sha256": sha(s, c)} for s, m, c in every]
        write(path, rows)


def sha(specimen: str, case: Case) -> str:
    """Hash of a label."""
    return hashlib.sha256(f"{specimen}/{case.label}/{case.name}".encode()).hexdigest()


def answered(specimen: str, machine: str, case: str, peer: bool) -> dict:
    """One row: the answer beside the label. Seconds are those of the processor, after all is compiled."""
    real = MACHINES[machine]
    numbers = honest(real)
    one = next(c for c in (HONEST, *real.cases(numbers)) if c.name == case)
    model, run = false(real, numbers, one)
    plant = OwnMachine(model)
    plant.residuals(plant.prepare(run.recordings[0], run, None), {})  # compiles
    start = time.process_time()
    row = {"specimen": specimen, "machine": machine, "case": case, "label": one.label, "twins": " ".join(one.twins)}
    row |= dict.fromkeys((*COLUMNS, *BY_OUTPUTS) if peer else COLUMNS, "")
    try:
        if peer:
            found = least_squares_name(plant, run)
            again = marked(real, one, found["by_outputs"])
            row |= {name: again[name.removesuffix("_by_outputs")] for name in BY_OUTPUTS}
        else:
            found = diagnose(plant, run, specimen, threads=1, table=False).to_dict()
    except Exception as error:  # an answer too: the study says which
        return row | {
            "verdict": "refused", "why": str(error)[:200], "probability": 1.0,
            "seconds": round(time.process_time() - start, 1)
        }  # fmt: skip
    return row | marked(real, one, found) | {"seconds": round(time.process_time() - start, 1)}


COLUMNS = (
    "verdict", "probability", "group", "first_name", "first_probability", "rank", "rank_of_names", "place_right",
    "found", "unit", "low", "high", "size", "before", "after", "seconds", "why",
)  # fmt: skip
BY_OUTPUTS = ("verdict_by_outputs", "rank_of_names_by_outputs")  # of the peer


def marked(real: Real, case: Case, a: dict) -> dict:
    """Is the answer right: name, rank, place and size of the first right name in the ranking."""
    ranking, right = a["ranking"], case.right
    names = [r["effect"] for r in ranking]
    effects = [n for n in names if n not in SAYS_NO_NAME]
    truth = next((r for r in ranking if r["effect"] in right), {})
    low, high = truth.get("interval") or (np.nan, np.nan)
    place = a["verdict"].partition("@")[2] if a["verdict"] not in SAYS_NO_NAME else a["where"].get("block", "")
    gap, size = a.get("gap") or {}, right.get(truth.get("effect", ""))
    return dict.fromkeys(COLUMNS, "") | {
        "verdict": a["verdict"], "probability": f"{stated(real, a):.3f}", "group": " ".join(group(a)),
        "first_name": effects[0] if effects else "", "first_probability": f"{probability(a, effects[:1]):.3f}",
        "rank": place_of(names, right), "rank_of_names": place_of(effects, right),
        "place_right": case.label == a["verdict"] or place in {r.partition("@")[2] for r in right},
        "found": number(truth.get("magnitude")), "unit": truth.get("unit", ""), "low": number(low),
        "high": number(high), "size": number(size),
        "before": number(gap.get("before")), "after": number(gap.get("after")),
    }  # fmt: skip


def group(a: dict) -> list[str]:
    """Names that the recordings cannot tell from the verdict, itself among them."""
    return next((g for g in a["ambiguity_set"] if a["verdict"] in g), [a["verdict"]])


def place_of(names: Sequence[str], right: Sequence[str] | dict) -> int | str:
    """The rank of the first right name."""
    return next((k + 1 for k, n in enumerate(names) if n in right), "")


def probability(a: dict, names: Sequence[str]) -> float:
    """Sum over names."""
    return min(sum(r["probability"] for r in a["ranking"] if r["effect"] in names), 1.0)


def stated(real: Real, a: dict) -> float:
    """The verdict's probability: that of all names that no recording of the machine tells from it."""
    groups = [set(c.right) for c in real.cases(honest(real)) if c.twins]
    return probability(a, next((sorted(g) for g in groups if a["verdict"] in g), [a["verdict"]]))


def number(value: float | None) -> str:
    """Four digits, or nothing."""
    return "" if value is None or not np.isfinite(value) else f"{value:.4g}"


def scored(rows: Sequence[dict]) -> list[dict]:
    """Shares with their intervals after Clopper and Pearson."""
    singles, healthy = [r for r in rows if r["case"] != "honest"], [r for r in rows if r["case"] == "honest"]
    sized = [r for r in singles if r["size"] and r["found"] and ranked(r, "rank_of_names") <= 2]
    false_names = [r for r in healthy if r["verdict"] not in SAYS_NO_NAME and float(r["probability"]) >= SURE]
    table = [
        counted("named", singles, lambda r: r["verdict"] in names(r)),
        counted("named, or not told from a right name", singles, lambda r: within(r)),
        counted("among the first two answers", singles, lambda r: ranked(r, "rank") <= 2),
        counted("first among the names", singles, lambda r: ranked(r, "rank_of_names") == 1),
        counted("among the first two names", singles, lambda r: ranked(r, "rank_of_names") <= 2),
        counted("place right", singles, lambda r: str(r["place_right"]) == "True"),
        counted("honest models given a name at 50 %", healthy, lambda r: r in false_names),
        counted("falsified models given a wrong name at 50 %", singles, wrong),
        counted("size within 20 %", sized, lambda r: abs(float(r["found"]) / float(r["size"]) - 1.0) < NEAR),
        counted("interval covers and is narrower than the size", sized, covers),
        counted("refused", rows, lambda r: r["verdict"] == "refused"),
    ]
    usual = {r["machine"]: float(r["before"]) for r in healthy if r["before"]}
    plain = [r for r in singles if r["before"] and float(r["before"]) > PLAIN * usual.get(r["machine"], np.inf)]
    table.append(
        counted(f"named, of gaps {PLAIN:g} times the honest model's", plain, lambda r: r["verdict"] in names(r))
    )
    table.append(counted("first two names, of those", plain, lambda r: ranked(r, "rank_of_names") <= 2))
    for machine in dict.fromkeys(r["machine"] for r in rows):
        own = [r for r in singles if r["machine"] == machine]
        table.append(counted(f"named, {machine}", own, lambda r: r["verdict"] in names(r)))
    right = np.array([float(r["verdict"] in (names(r) if r["case"] != "honest" else SAYS_NO_NAME)) for r in rows])
    c = calibrated(np.array([float(r["probability"]) for r in rows]), right)
    sizes = np.array([float(len(r["group"].split()) or 1) for r in singles])
    table.append(row_of("names in the verdict's group, mean (least and most)", len(sizes), sizes.mean(), sizes.min(),
                        sizes.max()))  # fmt: skip
    seconds = np.array([float(r["seconds"]) for r in rows])
    table.append(row_of("calibration error (of perfect answers: mean, 95 %)", len(rows), c.ece, c.null_mean, c.null_95))
    table.append(row_of("seconds of one core, median (10 to 90 %)", len(rows), np.median(seconds),
                        *np.quantile(seconds, (0.1, 0.9))))  # fmt: skip
    for row in table:
        print(*row.values())
    return table


def names(row: dict) -> tuple[str, ...]:
    """Names that are right."""
    return (row["label"], *row["twins"].split())


def within(row: dict) -> bool:
    """Whether a right name is in the verdict's group."""
    return bool({*names(row)} & {row["verdict"], *row["group"].split()})


def ranked(row: dict, key: str) -> int:
    """A rank, a large one where there is none."""
    return int(row[key] or 1000)


def wrong(row: dict) -> bool:
    """A name that is not right, stated at half or more."""
    return row["verdict"] not in (*names(row), *SAYS_NO_NAME, "refused") and float(row["probability"]) >= SURE


def covers(row: dict) -> bool:
    """Whether an interval holds the true size and says more than nothing."""
    if not (row["low"] and row["high"]):
        return False
    low, high, size = float(row["low"]), float(row["high"]), float(row["size"])
    return low <= size <= high and high - low < abs(size)


def counted(name: str, rows: Sequence[dict], good: Callable[[dict], bool]) -> dict:
    """One line of the score."""
    s = share(sum(good(r) for r in rows), len(rows))
    return {"share": name, "right": s.right} | {
        k: v for k, v in row_of(name, s.of, s.value, *s.interval).items() if k != "share" and k != "right"
    }


def row_of(name: str, of: int, value: float, low: float, high: float) -> dict:
    """One line of the score without a count."""
    return {
        "share": name,
        "right": "",
        "of": of,
        "value": f"{value:.3f}",
        "low_95": f"{low:.3f}",
        "high_95": f"{high:.3f}",
    }


def read(path: Path) -> dict[str, dict]:
    """Rows of a table by specimen."""
    if not path.exists():
        return {}
    with path.open() as file:
        return {row["specimen"]: row for row in csv.DictReader(file)}


def write(path: Path, rows: Sequence[dict]) -> None:
    """A table."""
    with path.open("w", newline="") as file:
        out = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        out.writeheader()
        out.writerows(rows)


if __name__ == "__main__":
    main()
