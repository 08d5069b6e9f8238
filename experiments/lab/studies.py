"""`make studies`: the project's studies and their questions, and any of them run anew.

python experiments/lab/studies.py               lists them
python experiments/lab/studies.py pwm qube      runs these two
python experiments/lab/studies.py --all         runs all, the scoreboard last; the exam is apart (exam.py)
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from text_layout import looked_at

from loopshape.core.errors import LoopshapeError, UnreadableInputError, WrongUseError

LAST = "scoreboard"  # reads what the others wrote
SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def studies(
    names: Annotated[list[str] | None, typer.Argument(help="Studies to run; none lists them all.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Run all of them.")] = False,
    jobs: Annotated[int, typer.Option(help="Studies at the same time, each on one core (0: one per core).")] = 0,
    experiments: Annotated[Path, typer.Option(help="The project's studies.")] = Path("experiments"),
) -> None:
    """List the studies under experiments/, or run them: their tables and figures are written anew."""
    scripts = known(experiments)
    if names and everything:
        raise WrongUseError("name studies or ask for --all, not both", ", ".join(names))
    if unknown := [name for name in names or () if name not in scripts]:
        raise WrongUseError("there is no such study", ", ".join(unknown), f"one of {', '.join(scripts)}")
    if jobs < 0:
        raise WrongUseError("the number of studies at the same time must be 1 or more (0: one per core)", str(jobs))
    if not names and not everything:
        for name, script in scripts.items():
            print(f"{name:28} {question(script.parent)}")
        return
    codes = run_all({name: scripts[name] for name in names or scripts}, jobs or os.cpu_count() or 1)
    if any(codes):
        raise typer.Exit(2 if all(code in (0, 2) for code in codes) else 1)


def known(experiments: Path) -> dict[str, Path]:
    """The scripts of the studies that can be run, by name. Refuses a folder that has none."""
    found = sorted(
        [*experiments.glob("*/run.py"), *experiments.glob("lab/*/run.py")], key=lambda path: path.parent.name
    )
    if not found:
        raise UnreadableInputError(
            "the project's studies are not here",
            str(experiments),
            "run this in the project's folder, or name --experiments",
        )
    return {path.parent.name: path for path in found}


def question(folder: Path) -> str:
    """What a study asks: the heading of its README."""
    readme = folder / "README.md"
    if not readme.is_file():
        return ""
    return next(iter(readme.read_text(encoding="utf-8", errors="replace").splitlines()), "").lstrip("# ")


def run_all(scripts: Mapping[str, Path], jobs: int) -> Sequence[int]:
    """Exit codes of studies run several at a time; the one that reads the others' results comes last."""
    first = [name for name in scripts if name != LAST]
    with ThreadPoolExecutor(max(1, min(jobs, len(first)))) as pool:
        try:
            codes = list(pool.map(lambda name: run(name, scripts[name]), first))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return codes + [run(name, scripts[name]) for name in scripts if name == LAST]


def run(name: str, script: Path) -> int:
    """Run one study in a process of its own; what it printed comes in one piece when it has ended."""
    started = time.monotonic()
    ended = subprocess.run(
        [sys.executable, str(script.resolve())],
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
        env={**looked_at(), **SINGLE, "MPLBACKEND": "Agg"},
    )
    word = "ran" if ended.returncode == 0 else f"FAILED (exit code {ended.returncode})"
    print(f"== {name}: {word}, {time.monotonic() - started:.0f} s ==\n{ended.stdout}", flush=True)
    if ended.returncode:
        print(f"study {name} {word}: {ended.stderr.strip() or 'it said nothing'}", file=sys.stderr)
    return ended.returncode


if __name__ == "__main__":
    try:
        typer.run(studies)
    except LoopshapeError as error:
        print(f"studies: {error}", file=sys.stderr)
        sys.exit(2)
