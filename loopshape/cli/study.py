"""`loopshape study`: the project's studies, their questions, and any of them run anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet

LAST = ("scoreboard",)  # reads what the others wrote


def study(
    names: Annotated[list[str] | None, typer.Argument(help="Studies to run; none lists them all.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Run all of them; `loopshape exam` is apart.")] = False,
    jobs: Annotated[int, typer.Option(help="Studies at the same time, each on one core; 0 for one a core.")] = 0,
    experiments: Annotated[Path, typer.Option(help="The project's studies.")] = Path("experiments"),
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """List the studies under experiments/, or run them: their tables and figures are written anew."""
    from loopshape.core.errors import WrongUseError

    known = _known(experiments)
    if names and everything:
        raise WrongUseError("name studies or ask for --all, not both", ", ".join(names))
    if unknown := [name for name in names or () if name not in known]:
        raise WrongUseError("there is no such study", ", ".join(unknown), f"one of {', '.join(known)}")
    if jobs < 0:
        raise WrongUseError("the number of studies at the same time is 1 or more, or 0 for one a core", str(jobs))
    output = Output(as_json, quiet)
    if not names and not everything:
        return _list(known, output)
    ended = _run_all(experiments, list(dict.fromkeys(names or known)), jobs, output)
    output.json({"studies": [vars(one) for one in ended]})
    if any(one.exit_code for one in ended):
        raise typer.Exit(2 if all(one.exit_code in (0, 2) for one in ended) else 1)
    return None


@dataclass(frozen=True)
class Ended:
    """How a study ended: its exit code and wall time in s."""

    study: str
    exit_code: int
    wall_s: float


def _known(experiments: Path) -> dict[str, str]:
    """The studies that can be run and their questions, by name. Refuses a folder that has none."""
    from loopshape.core.errors import UnreadableInputError

    found = {path.parent.name: _question(path.parent) for path in sorted(experiments.glob("*/run.py"))}
    if not found:
        raise UnreadableInputError(
            "the project's studies are not here",
            str(experiments),
            "run this in the project's folder, or name --experiments",
        )
    return found


def _question(folder: Path) -> str:
    readme = folder / "README.md"
    if not readme.is_file():
        return ""
    return next(iter(readme.read_text(encoding="utf-8", errors="replace").splitlines()), "").lstrip("# ")


def _list(known: dict[str, str], output: Output) -> None:
    output.table("Studies, run by `loopshape study NAME`:", ("name", "question"), known.items())
    output.json({"studies": [{"study": name, "question": question} for name, question in known.items()]})


def _run_all(experiments: Path, names: Sequence[str], jobs: int, output: Output) -> list[Ended]:
    """Run studies, several at a time, each with a single thread; those that read the others' results come last."""
    from concurrent.futures import ThreadPoolExecutor
    from os import cpu_count

    first = [name for name in names if name not in LAST]
    with ThreadPoolExecutor(max(1, min(jobs or cpu_count() or 1, len(first)))) as pool:
        try:
            ended = list(pool.map(lambda name: _run(experiments, name, output), first))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return ended + [_run(experiments, name, output) for name in names if name in LAST]


def _run(experiments: Path, name: str, output: Output) -> Ended:
    """Run one study in a process of its own; what it printed comes in one piece when it has ended."""
    import os
    import subprocess
    import sys
    import time

    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    script = (experiments / name / "run.py").resolve()
    started = time.monotonic()
    ended = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
        env={**os.environ, **single, "MPLBACKEND": "Agg"},
    )
    wall_s = time.monotonic() - started
    word = "ran" if ended.returncode == 0 else f"FAILED (exit code {ended.returncode})"
    output.say(f"== {name}: {word}, {wall_s:.0f} s ==\n{ended.stdout}")
    if ended.returncode:
        print(f"loopshape: study {name} {word}: {ended.stderr.strip() or 'it said nothing'}", file=sys.stderr)
    return Ended(name, ended.returncode, round(wall_s, 1))
