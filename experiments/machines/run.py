"""Answers for nine machines whose effect nobody told: answers/*.json, answers.csv, figures/machines/answers.png.

python experiments/machines/run.py              all that have no answer yet
python experiments/machines/run.py m003 m007    these
"""

from __future__ import annotations

import csv
import json
import os
import sys
import time
import tomllib
from pathlib import Path

import loopshape as ls
from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import write_bytes_whole, write_json
from loopshape.toolbox.gap.mechanism.mechanism import machine
from loopshape.toolbox.gap.nouns.machine import Mechanism, Model
from loopshape.view.style import COLOURS, QUIET, head, new_figure, png, styled

HERE = Path(__file__).parent
RUNS = Path(os.environ.get("LOOPSHAPE_MACHINES", HERE.parents[2] / "shared" / "machines" / "withheld"))
FIGURES = HERE.parents[1] / "figures" / "machines"
WITHOUT = ("force_offset",)  # the list of effects that may occur has none


def main() -> None:
    """Diagnose every run folder found; an answer that exists is kept: it was given before anyone told the truth."""
    wanted = sys.argv[1:] or [p.parent.name for p in sorted(RUNS.glob("*/run.toml"))]
    if not wanted or not RUNS.is_dir():
        print(f"machines: no run folders in {RUNS} (set LOOPSHAPE_MACHINES); nothing done")
        return
    answers = HERE / "answers"
    answers.mkdir(exist_ok=True)
    for name in wanted:
        if not (answers / f"{name}.json").exists():
            answer(RUNS / name, answers)
    given = {p.stem: json.loads(p.read_text()) for p in sorted(answers.glob("*.json"))}
    table(given)
    FIGURES.mkdir(parents=True, exist_ok=True)
    write_bytes_whole(FIGURES / "answers.png", drawn(given))


def answer(folder: Path, answers: Path) -> None:
    """Diagnose one run folder, keep the answer."""
    start = time.monotonic()
    found = ls.gap(folder, model=described(folder), table=False)
    write_json(answers / f"{folder.name}.json", found.to_dict())
    print(f"{folder.name}: {found.sentence} ({time.monotonic() - start:.0f} s)", flush=True)


def described(folder: Path) -> Model:
    """The machine of a folder's `model.xml` with the tolerances and columns of its `machine.toml`."""
    try:
        import mujoco
    except ImportError:
        raise UnreadableInputError("the study needs mujoco", "it is not installed", "pip install mujoco") from None
    words = tomllib.loads((folder / "machine.toml").read_text())
    columns = {
        kind: {name: (own["column"], 1.0) for name, own in words[kind].items()} for kind in ("actuators", "sensors")
    }
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    return machine(Mechanism(words["name"], spec, words["spread"], without=WITHOUT, **columns))


def table(answers: dict[str, dict]) -> None:
    """One row a machine: verdict, probabilities of the first three, magnitude, held-out gap."""
    with (HERE / "answers.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(HEADER)
        for name, a in answers.items():
            first, second, third = a["ranking"][:3]
            gap = a["gap"] or {}
            parts = first.get("parts", {}).values()
            sizes = first.get("magnitude") or ", ".join(f"{p['magnitude']:.3g}" for p in parts)
            row = [name, a["plant"], first["effect"], first["probability"], second["effect"], second["probability"]]
            row += [third["effect"], third["probability"], sizes, gap.get("before"), gap.get("after")]
            out.writerow([f"{v:.4g}" if isinstance(v, float) else v for v in row])


def drawn(answers: dict[str, dict]) -> bytes:
    """The held-out gap of each machine before and after what is named is added."""
    with styled():
        figure = new_figure(size=(6.2, 3.4))
        ax = figure.axes[0]
        ax.axvline(1.0, color=QUIET, lw=0.8)
        for k, a in enumerate(answers.values()):
            before, after = a["gap"]["before"], a["gap"]["after"]
            ax.plot([before, after], [k, k], color=QUIET, lw=1.0)
            ax.plot(before, k, "o", mfc="white", color=COLOURS[0])
            ax.plot(after, k, "o", color=COLOURS[0])
        labels = [f"{name} {a['plant']}: {a['verdict'].replace('_', ' ')}" for name, a in answers.items()]
        ax.set_yticks(range(len(labels)), labels)
        ax.invert_yaxis()
        ax.set_xscale("log")
        ax.set_xlabel("held-out gap over noise floor (full: as named)")
        head(figure, "What nine machines lack, by our answers")
        return png(figure)


HEADER = (
    "machine", "plant", "verdict", "probability", "second", "its", "third", "its", "magnitude", "before", "after",
)  # fmt: skip


if __name__ == "__main__":
    main()
