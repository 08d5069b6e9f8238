"""`loopshape exam`: arms with sealed effects, diagnosed one by one; then the seals are opened, the answers scored."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    import numpy as np

    from loopshape.data.effect import EffectForm
    from loopshape.data.experiment import Experiment
    from loopshape.data.recording import Recording
    from loopshape.data.run import Run
    from loopshape.examiner.score import Scores

FORMAT = "loopshape-exam/1"
PLANT = "arm-1dof"
LEAD_S = 4.0  # a replayed arm stands so long at its first references
TRIES = 20  # other spread and signals for an arm that leaves its range
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Case(NamedTuple):
    """One arm to be made: `variant` is the form that makes its effects, of the examiner or of the library."""

    name: str
    kind: str
    labels: Mapping[str, float]
    variant: int
    run_seed: int
    nonce: str
    library: bool = False

    @property
    def seal(self) -> str:
        """Hash of labels and nonce; the nonce holds kind, variant and seed too."""
        from loopshape.examiner import seal

        return seal(self.labels, f"{self.kind}/{self.variant}/{self.run_seed}/{self.nonce}")


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
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Sit an exam on arms whose effects are sealed, then open the seals and score the answers."""
    from loopshape.io.files import make_folder
    from loopshape.io.run_folder import alone

    output = Output(as_json, quiet)
    plan = {"single": single, "healthy": healthy}
    plan |= {} if library_forms else {"unknown": unknown, "pair": pairs}
    make_folder(out)
    with alone(out):
        cases = case_list(plan, seed, library_forms)
        seal_up(out, cases, {"seed": seed, "plan": plan, "forms": "library" if library_forms else "examiner"}, output)
        sit_all(out, cases, jobs or os.cpu_count() or 1, keep_runs, output)
        show(conclude(out, cases), output)


def case_list(plan: Mapping[str, int], seed: int, library: bool) -> list[Case]:
    """All cases in an order that tells nothing, the same for the same plan and seed."""
    import numpy as np

    from loopshape.examiner import OUTSIDE, draw_case, draw_magnitude

    rng = np.random.default_rng([seed, int(library)])
    forms = catalogue() if library else {}
    drawn: list[tuple[str, dict[str, float], int]] = []
    for name, variant in rounds(forms, plan["single"], rng):
        form = forms[name][variant] if library else None
        drawn.append(("single", {name: magnitude_in(form, rng) if form else draw_magnitude(name, rng)}, variant))
    drawn += [("healthy", {}, 0)] * plan["healthy"]
    outside = rounds({name: (None,) for name in OUTSIDE}, plan.get("unknown", 0), rng)
    drawn += [("unknown", {name: draw_magnitude(name, rng)}, variant) for name, variant in outside]
    drawn += [("pair", draw_case("pair", rng), k % 2) for k in range(plan.get("pair", 0))]
    order = [drawn[k] for k in rng.permutation(len(drawn))]
    return [
        Case(f"case-{k:03d}", kind, labels, variant, int(rng.integers(2**31)), rng.bytes(16).hex(), library)
        for k, (kind, labels, variant) in enumerate(order, start=1)
    ]


def rounds(forms: Mapping[str, Sequence[Any]], count: int, rng: np.random.Generator) -> list[tuple[str, int]]:
    """Names with forms, round after round in one shuffled order; each round takes a name's next form."""
    from loopshape.examiner import EFFECTS

    many = {name: len(of) for name, of in forms.items()} or dict.fromkeys(EFFECTS, 2)
    order = [str(name) for name in rng.permutation(sorted(many))]
    first = rng.permutation(len(order))
    return [
        (order[at], int(first[at] + lap) % many[order[at]]) for lap, at in (divmod(k, len(order)) for k in range(count))
    ]


def seal_up(out: Path, cases: Sequence[Case], words: Mapping[str, Any], output: Output) -> None:
    """Write the seals before anything is diagnosed, or refuse a folder that holds something else."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import read_json, write_json

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
        output.say(f"{case.name}  {case.seal}")


def sit_all(out: Path, cases: Sequence[Case], jobs: int, keep_runs: bool, output: Output) -> None:
    """Diagnose what has no answer yet; each answer is written whole as it comes."""
    from loopshape.io.files import make_folder, write_json

    make_folder(out / "answers")
    todo = [c for c in cases if not answer_file(out, c.name).exists()]
    code = code_sha256()
    with output.progress("exam", len(todo)) as step:
        try:
            for found in answers(todo, jobs, out / "runs" if keep_runs else None):
                write_json(answer_file(out, found["run"]), found | {"code_sha256": code})
                step(f"{found['run']} {found['verdict']}")
        except KeyboardInterrupt:
            output.warn([f"interrupted; what {out / 'answers'} holds is kept, the same command goes on"])
            raise typer.Exit(130) from None


def answer_file(out: Path, name: str) -> Path:
    """Where a case's answer stands."""
    return out / "answers" / f"{name}.json"


def code_sha256() -> str:
    """Hash of what diagnoses, so that answers of different states of the code can be told apart."""
    import hashlib

    root = Path(__file__).parents[1]
    found = hashlib.sha256()
    for path in sorted(p for room in ("gap", "plants", "kernels") for p in (root / room).rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def answers(cases: Sequence[Case], jobs: int, runs: Path | None) -> Iterator[dict[str, Any]]:
    """Answers as they come: in this process for one job, else in processes of one thread each."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    if jobs == 1 or len(cases) <= 1:
        yield from (sit(case, runs) for case in cases)
        return
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # the processes to come read it as they start
    with ProcessPoolExecutor(min(jobs, len(cases)), multiprocessing.get_context("spawn")) as pool:
        try:
            for done in as_completed([pool.submit(sit, case, runs) for case in cases]):
                yield done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def sit(case: Case, runs: Path | None) -> dict[str, Any]:
    """Make a case's run and have it diagnosed: what diagnoses gets the run, and a name that says nothing."""
    run = made(case)
    if runs is not None:
        from loopshape.io.run_folder import write_run

        write_run(runs / case.name, run)
    return diagnosed(run, case.name)


def diagnosed(run: Run, name: str) -> dict[str, Any]:
    """The answer to a run, with its time in s. A diagnosis that breaks off is an answer too, and a wrong one."""
    import time
    import traceback

    from loopshape.cli.gap import answer
    from loopshape.diagnose.diagnose import diagnose
    from loopshape.model.registry import diagnosable

    began = time.perf_counter()
    try:
        found = answer(diagnose(diagnosable(str(run.plant)), run, name, threads=1, table=False))
    except Exception:
        found = {"run": name, "verdict": "failed", "ranking": [], "error": traceback.format_exc()}
    return found | {"time_s": time.perf_counter() - began}


def made(case: Case) -> Run:
    """The run of a case; an arm that leaves its range is drawn again, with the same effects."""
    from loopshape.core.errors import WrongUseError
    from loopshape.examiner import make_run

    for k in range(TRIES):
        try:
            if case.library:
                return library_run(case.labels, case.variant, case.run_seed + k)
            return make_run(case.labels, case.run_seed + k, variant=case.variant)
        except WrongUseError as error:
            last = error
    raise last


def catalogue() -> dict[str, list[EffectForm]]:
    """The library's forms by effect, where the form's own number carries the magnitude."""
    from loopshape.model.registry import diagnosable

    out: dict[str, list[EffectForm]] = {}
    for form in diagnosable(PLANT).effects:
        if form.usual[0] > 0.0:
            out.setdefault(form.effect, []).append(form)
    return out


def magnitude_in(form: EffectForm, rng: np.random.Generator) -> float:
    """A magnitude in a form's usual range, uniform in its logarithm, of either sign where both may be."""
    import numpy as np

    size = float(f"{np.exp(rng.uniform(*np.log(form.usual))):.4g}")
    return -size if form.free[0].low < 0.0 and rng.random() < 0.5 else size


def library_run(labels: Mapping[str, float], variant: int, seed: int) -> Run:
    """A session's signals on the library's own arm with its own form of the effects, ordinary spread and new noise."""
    from dataclasses import replace

    import numpy as np

    from loopshape.core.errors import WrongUseError
    from loopshape.data.recording import Recording
    from loopshape.diagnose.hypothesis import Hypothesis
    from loopshape.examiner import make_run
    from loopshape.model.registry import diagnosable

    plant, session, rng = diagnosable(PLANT), make_run({}, seed), np.random.default_rng([seed, 1])
    forms = [(catalogue()[name][variant], m) for name, m in labels.items()]
    phi = [x for f, m in forms for x in (m / f.scale, *(free.starts[0] for free in f.free[1:]))]
    phi += rng.uniform(-1.0, 1.0, len(plant.spread)).tolist()
    moves = Hypothesis(plant, tuple(f for f, _ in forms)).moves(np.array(phi))
    moves |= {"range_angle_deg": 60.0, "range_low_bar": 0.05, "range_high_bar": 1.5}  # as wide as the generator's own
    lead = round(LEAD_S * session.rate_hz)
    again = [_again(session, r, lead, int(rng.integers(2**31))) for r in session.recordings]
    done = plant.simulate(again, changes=moves, threads=1)
    for d in done:
        if d.info.ended_early:
            raise WrongUseError("the arm left its range", d.info.ended_early, "ask for a smaller effect")
    cut = [
        Recording(
            r.info,
            r.rate_hz,
            {k: v[-r.columns["t_s"].size :] for k, v in d.columns.items()} | {"t_s": r.columns["t_s"]},
        )
        for d, r in zip(done, session.recordings, strict=True)
    ]
    return replace(session, recordings=tuple(cut))


def _again(session: Run, r: Recording, lead: int, seed: int) -> Experiment:
    """A session's recording to be done again, after a lead at its first references where the loops are closed."""
    import numpy as np

    from loopshape.data.experiment import Experiment

    driven = [str(loop.injected if r.info.closed_loop else loop.control) for loop in session.loops]
    references = np.stack([r.column(str(loop.reference)) for loop in session.loops], axis=1)
    before = ((lead if r.info.closed_loop else 0, 0), (0, 0))
    return Experiment(
        r.info.name, r.info.kind, session.loops, r.rate_hz, np.pad(references, before, mode="edge"),
        np.pad(np.stack([r.column(name) for name in driven], axis=1), before), r.info.injection,
        r.info.operating_point, r.info.excites, r.info.role, r.info.closed_loop, seed=seed, pwm=session.pwm,
    )  # fmt: skip


def conclude(out: Path, cases: Sequence[Case]) -> Scores:
    """Open the labels against their seals, score the answers, write tables and figures."""
    from loopshape.cli.pictures import save
    from loopshape.examiner.score import BARS, Label, as_csv, as_json, mark, score
    from loopshape.io.files import read_json, write_json, write_text_whole
    from loopshape.view.exam import confusion_figure, reliability_figure, shrink_figure

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
        save(figure, out / f"{name}.png")
    return scores


def open_labels(out: Path, cases: Sequence[Case]) -> list[Case]:
    """Labels as they stand in the folder, written there the first time; refuses what does not fit its seal."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import read_json, reading, write_json

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


def show(scores: Scores, output: Output) -> None:
    """Scores against their bars, most important last."""
    from loopshape.examiner.score import as_json

    forms = [[name, s.right, s.of, interval(s.interval)] for name, s in scores.by_form.items()]
    output.table("Single effects by form", ["effect/form", "named", "of", "95 %"], forms)
    rows = [
        [x["name"], x["value"], interval(x["interval"]), x["of"], x["must"], x["aim"], x["met"]]
        for x in as_json(scores)["bars"]
    ]
    output.table("Against the bars", ["score", "found", "95 %", "of", "must", "aim", "met"], rows)
    c, longest = scores.calibration, scores.time_s.largest
    output.say(
        f"perfect answers would show a calibration error of {c.null_mean:.3f}, 95 % of them below {c.null_95:.3f}"
    )
    output.say(f"{scores.cases} arms, the longest {longest:.0f} s, {scores.failed} broken off")
    output.json(as_json(scores))


def interval(ends: Sequence[float | None] | None) -> str | None:
    """Two ends as people read them."""
    return f"{ends[0]:.3g} to {ends[1]:.3g}" if ends and None not in ends else None
