"""`make exam`: arms with sealed effects, diagnosed one by one; then the seals are opened, the answers scored.

python experiments/lab/exam.py --out FOLDER [--seed 2] [--library-forms]
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Annotated, Any

import typer
from exam_cases import Case, case_list, made
from exam_pictures import confusion_figure, reliability_figure, shrink_figure
from examiner.score import BARS, Label, Scores, as_csv, as_json, mark, score
from pandas import DataFrame

import loopshape
from loopshape.core.errors import LoopshapeError, WrongUseError
from loopshape.data.signal.run import Run
from loopshape.io.files import make_folder, read_json, reading, write_bytes_whole, write_json, write_text_whole
from loopshape.io.run.run_folder import alone, write_run
from loopshape.toolbox.gap.diagnose import diagnose as diagnosis
from loopshape.toolbox.rig.registry import diagnosable
from loopshape.view import style

FORMAT = "loopshape-exam/1"
DIAGNOSES = (
    "core",
    "data",
    "identify",
    "loop",
    "toolbox/arm",
    "toolbox/gap",
)  # folders of the package whose code gives answers
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def exam(
    out: Annotated[Path, typer.Option(help="The folder to write; an interrupted exam goes on.")],
    single: Annotated[int, typer.Option(min=0, help="Arms with one effect.")] = 60,
    healthy: Annotated[int, typer.Option(min=0, help="Arms with none.")] = 20,
    unknown: Annotated[int, typer.Option(min=0, help="Arms with an effect that the library lacks.")] = 12,
    pairs: Annotated[int, typer.Option(min=0, help="Arms with two effects.")] = 12,
    seed: Annotated[int, typer.Option(help="Draws cases, arms, signals and noise.")] = 1,
    jobs: Annotated[int | None, typer.Option(min=1, help="Diagnoses at once; all cores if left out.")] = None,
    keep_runs: Annotated[bool, typer.Option("--keep-runs", help="Write the run folders too.")] = False,
    library_forms: Annotated[
        bool, typer.Option("--library-forms", help="Arms by the library's own model and forms: single and healthy.")
    ] = False,
) -> None:
    """Sit an exam on arms whose effects are sealed, then open the seals and score the answers."""
    plan = {"single": single, "healthy": healthy}
    plan |= {} if library_forms else {"unknown": unknown, "pair": pairs}
    make_folder(out)
    with alone(out):
        cases = case_list(plan, seed, library_forms)
        seal_up(out, cases, {"seed": seed, "plan": plan, "forms": "library" if library_forms else "examiner"})
        sit_all(out, cases, jobs or os.cpu_count() or 1, keep_runs)
        show(conclude(out, cases))


def seal_up(out: Path, cases: Sequence[Case], words: Mapping[str, Any]) -> None:
    """Write the seals before anything is diagnosed, or refuse a folder that holds something else."""
    sealed = {"format": FORMAT, **words, "cases": [{"case": c.name, "seal": c.seal} for c in cases]}
    path = out / "sealed.json"
    if path.exists():
        there = read_json(path)
        for key, mine in sealed.items():
            if not isinstance(there, dict) or there.get(key) != mine:
                received = f"another {key}" if key == "cases" else f"{key} {there.get(key)!r}, now {mine!r}"
                raise WrongUseError(f"{path} seals another exam", received, "use its seed and plan, or a new folder")
    elif foreign := sorted(p.name for p in out.iterdir()):
        raise WrongUseError(
            "a folder without seals is no exam", f"{out}, which holds {', '.join(foreign[:5])}", "choose a new folder"
        )
    else:
        write_json(path, sealed)
    for case in cases:
        print(f"{case.name}  {case.seal}")


def sit_all(out: Path, cases: Sequence[Case], jobs: int, keep_runs: bool) -> None:
    """Diagnose what has no answer yet; each answer is written whole as it comes."""
    make_folder(out / "answers")
    todo = [c for c in cases if not answer_file(out, c.name).exists()]
    code = code_sha256()
    try:
        for found in answers(todo, jobs, out / "runs" if keep_runs else None):
            write_json(answer_file(out, found["run"]), found | {"code_sha256": code})
            print(f"{found['run']}  {found['verdict']}")
    except KeyboardInterrupt:
        print(f"interrupted; what {out / 'answers'} holds is kept, the same command goes on", file=sys.stderr)
        raise typer.Exit(130) from None


def answer_file(out: Path, name: str) -> Path:
    """Where a case's answer stands."""
    return out / "answers" / f"{name}.json"


def code_sha256() -> str:
    """Hash of what diagnoses, so that answers of different states of the code can be told apart."""
    root = Path(loopshape.__file__).parent
    found = hashlib.sha256()
    for path in sorted(p for folder in DIAGNOSES for p in (root / folder).rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def answers(cases: Sequence[Case], jobs: int, runs: Path | None) -> Iterator[dict[str, Any]]:
    """Answers as they come: in this process for one job, else in processes of one thread each."""
    if jobs == 1 or len(cases) <= 1:
        yield from (sit(case, runs) for case in cases)
        return
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # the processes to come read it as they start
    with ProcessPoolExecutor(min(jobs, len(cases)), multiprocessing.get_context("spawn")) as pool:
        try:
            for done in as_completed([pool.submit(sit, case, runs) for case in cases]):
                yield done.result()
        finally:  # interrupted: what has not begun is left
            pool.shutdown(wait=False, cancel_futures=True)


def sit(case: Case, runs: Path | None) -> dict[str, Any]:
    """Make a case's run and have it diagnosed: what diagnoses gets the run, and a name that says nothing."""
    run = made(case)
    if runs is not None:
        write_run(runs / case.name, run)
    return diagnosed(run, case.name)


def diagnosed(run: Run, name: str) -> dict[str, Any]:
    """The answer to a run, with its time in s. A diagnosis that breaks off is an answer too, and a wrong one."""
    began = time.perf_counter()
    try:
        report = diagnosis.diagnose(diagnosable(str(run.plant)), run, name, threads=1, table=False)
        found = report.to_dict()
    except Exception:  # whatever it breaks off with: the exam goes on, and the answer counts as wrong
        found = {"run": name, "verdict": "failed", "ranking": [], "error": traceback.format_exc()}
    return found | {"time_s": time.perf_counter() - began}


def conclude(out: Path, cases: Sequence[Case]) -> Scores:
    """Open the labels against their seals, score the answers, write tables and figures."""
    opened = open_labels(out, cases)
    labels = [Label(c.name, c.kind, c.labels, c.variant) for c in opened]
    given = [read_json(answer_file(out, c.name)) for c in opened]
    marked = [mark(label, found) for label, found in zip(labels, given, strict=True)]
    scores = score(marked)
    bar = next(b for b in BARS if b.score == "shrink")
    codes = sorted({found["code_sha256"] for found in given})
    write_json(out / "scores.json", as_json(scores) | {"code_sha256": codes})
    write_text_whole(out / "cases.csv", as_csv(marked))
    for name, figure in (
        ("confusion", confusion_figure(scores.confusion)),
        ("reliability", reliability_figure(scores.calibration)),
        ("shrink", shrink_figure(marked, must=bar.must, aim=bar.aim)),
    ):
        write_bytes_whole(out / f"{name}.png", style.png(figure))
    return scores


def open_labels(out: Path, cases: Sequence[Case]) -> list[Case]:
    """Labels as they stand in the folder, written there the first time; refuses what does not fit its seal."""
    path = out / "labels.json"
    if not path.exists():
        write_json(path, {"format": FORMAT, "cases": [c._asdict() for c in cases]})
    with reading(path, "the labels of an exam"):
        opened = [Case(**row) for row in read_json(path)["cases"]]
    seals = {row["case"]: row["seal"] for row in read_json(out / "sealed.json")["cases"]}
    broken = [c.name for c in opened if c.seal != seals.get(c.name)]
    if broken or len(opened) != len(seals):
        raise WrongUseError(
            "the labels are not those that were sealed",
            f"{path}: {', '.join(broken) or f'{len(opened)} of {len(seals)} cases'}",
            "delete labels.json, and the same command opens them again",
        )
    return opened


def show(scores: Scores) -> None:
    """Scores against their bars, most important last."""
    forms = [[name, s.right, s.of, interval(s.interval)] for name, s in scores.by_form.items()]
    table("Single effects by form", ["effect/form", "named", "of", "95 %"], forms)
    rows = [
        [x["name"], x["value"], interval(x["interval"]), x["of"], x["must"], x["aim"], x["met"]]
        for x in as_json(scores)["bars"]
    ]
    table("Against the bars", ["score", "found", "95 %", "of", "must", "aim", "met"], rows)
    c, longest = scores.calibration, scores.time_s.largest
    print(f"perfect answers would show a calibration error of {c.null_mean:.3f}, 95 % of them below {c.null_95:.3f}")
    print(f"{scores.cases} arms, the longest {longest:.0f} s, {scores.failed} broken off")


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Rows under a title, four figures a number."""
    shown = DataFrame(rows, columns=list(columns)).to_string(index=False, float_format="{:.4g}".format, na_rep="-")
    print(f"\n{title}\n{shown}\n")


def interval(ends: Sequence[float | None] | None) -> str | None:
    """Two ends as people read them."""
    return f"{ends[0]:.3g} to {ends[1]:.3g}" if ends and None not in ends else None


if __name__ == "__main__":
    try:
        typer.run(exam)
    except LoopshapeError as error:
        print(f"exam: {error}", file=sys.stderr)
        sys.exit(2)
