"""The scoreboard: each table and figure of the source, what it says, what we get, and whether they agree.

Reads `items.csv` (what the source has), `loopshape/toolbox/arm/source.csv` (its numbers) and each study's `scores.csv`;
writes `experiments/README.md`. It computes nothing: a score is what its study wrote.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.source import number

HERE = Path(__file__).parent
STUDIES = HERE.parents[1]
VERDICTS = ("agrees", "partly", "differs", "not comparable")
COLUMNS = ("item", "quantity", "source", "ours", "verdict", "why")
OPEN = "open"  # an item with a study that has not scored it
CHAPTERS = (
    ("Robots and the arm (chapters 1, 2)", ("1", "2")),
    ("Physical model (chapter 3)", ("3",)),
    ("Identification and validation (chapter 4)", ("4",)),
    ("Feedback control (chapter 5)", ("5",)),
    ("Conclusions (abstract, chapter 6)", ("abstract", "6")),
    ("Parts and muscles (appendices A, B)", ("A", "B")),
    ("PWM (appendix C)", ("C",)),
    ("Pneumatics (appendix D)", ("D",)),
    ("Muscle and bodies (appendices E, F)", ("E", "F")),
    ("Muscle bench (appendix G)", ("G",)),
    ("Controllers, joint 1, two joints (appendix H)", ("H",)),
)
KEY = re.compile(r"\{([^{}]+)\}")


@dataclass(frozen=True)
class Item:
    """A table, figure or section of the source, the studies that answer it, or a note why none does."""

    name: str
    page: str
    shows: str
    studies: tuple[str, ...]
    note: str

    @property
    def chapter(self) -> str:
        """What stands in the heading: "4" of figure 4.12, "G" of figure G.1, "6" of chapter 6."""
        word = self.name.split(",")[0].split()[-1]
        return word.split(".")[0]


@dataclass(frozen=True)
class Score:
    """One line of a study's `scores.csv`; `source` has numbers by their keys in braces."""

    study: str
    item: str
    quantity: str
    source: str
    ours: str
    verdict: str
    why: str

    @property
    def says(self) -> str:
        """What the source says, its numbers as printed."""
        return KEY.sub(lambda found: str(number(found.group(1))), self.source)


def items() -> list[Item]:
    """All tables, figures and sections that the source can be asked about, in its order."""
    with (HERE / "items.csv").open(newline="", encoding="utf-8") as file:
        return [
            Item(r["item"], r["page"], r["shows"], tuple(r["study"].split()), r["note"]) for r in csv.DictReader(file)
        ]


def scores(folder: Path = STUDIES) -> list[Score]:
    """What the studies scored. Refuses a file with other columns or an unknown verdict."""
    return [score for path in sorted(folder.glob("*/scores.csv")) for score in _read(path)]


def _read(path: Path) -> Iterator[Score]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = csv.DictReader(file)
        if tuple(rows.fieldnames or ()) != COLUMNS:
            raise UnreadableInputError(
                "a study's scores have other columns", f"{path}: {rows.fieldnames}", ",".join(COLUMNS)
            )
        for row in rows:
            if row["verdict"] not in VERDICTS:
                raise UnreadableInputError("a score has no known verdict", f"{path}: {row}", ", ".join(VERDICTS))
            yield Score(path.parent.name, **row)


def page(all_items: Sequence[Item], all_scores: Sequence[Score]) -> str:
    """The whole of `experiments/README.md`."""
    parts = [(HERE / "intro.md").read_text(encoding="utf-8").rstrip(), _counts(all_items, all_scores)]
    for title, chapters in CHAPTERS:
        mine = [item for item in all_items if item.chapter in chapters]
        parts += [f"### {title}", _table(mine, all_scores), _reasons(mine, all_scores)]
    parts += ["## All studies", _studies()]
    return "\n\n".join(part for part in parts if part) + "\n"


def _counts(all_items: Sequence[Item], all_scores: Sequence[Score]) -> str:
    count = Counter(score.verdict for score in all_scores)
    drawn = sum(not item.studies for item in all_items)
    said = ", ".join(f"{count[verdict]} {verdict}" for verdict in VERDICTS)
    return f"**{len(all_scores)} comparisons: {said}.** {drawn} lines are drawings, or the model's own parameters."


def _table(mine: Sequence[Item], all_scores: Sequence[Score]) -> str:
    lines = ["| source, page | what | it says | we get | verdict | study |", "|---|---|---|---|---|---|"]
    for item in mine:
        found = [score for score in all_scores if score.item == item.name]
        lines += [_line(item, score, first=k == 0) for k, score in enumerate(found)] or [_without(item)]
    return "\n".join(lines)


def _line(item: Item, score: Score, first: bool) -> str:
    head = f"**{item.name}**, {item.page}" if first else ""
    cells = (head, score.quantity, score.says, score.ours, score.verdict, f"[{score.study}]({score.study}/README.md)")
    return "| " + " | ".join(_cell(cell) for cell in cells) + " |"


def _without(item: Item) -> str:
    verdict, study = (OPEN, ", ".join(item.studies)) if item.studies else ("", "")
    return "| " + " | ".join((f"**{item.name}**, {item.page}", item.shows, "", item.note, verdict, study)) + " |"


def _reasons(mine: Sequence[Item], all_scores: Sequence[Score]) -> str:
    names = {item.name for item in mine}
    told = [score for score in all_scores if score.item in names and score.verdict != "agrees"]
    lines = [f"- **{score.item}, {score.quantity}** ({score.verdict}): {score.why}" for score in told]
    parts = ["Where and why they do not agree:", "", *lines] if lines else []
    rules = [
        f"- **{s.item}, {s.quantity}**: {s.why}"
        for s in all_scores
        if s.item in names and s.verdict == "agrees" and s.why
    ]
    parts += (
        ["", "<details><summary>By which rule the others agree</summary>", "", *rules, "", "</details>"]
        if rules
        else []
    )
    return "\n".join(parts).strip("\n")


def _studies() -> str:
    folders = sorted(path.parent for path in STUDIES.glob("*/README.md"))
    lines = ["| study | its question |", "|---|---|"]
    return "\n".join(lines + [f"| [{f.name}]({f.name}/README.md) | {_cell(_title(f))} |" for f in folders])


def _title(folder: Path) -> str:
    first = (folder / "README.md").read_text(encoding="utf-8").splitlines()[0]
    return first.lstrip("# ")


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main() -> None:
    """Write the page and say what is open."""
    all_items, all_scores = items(), scores()
    write_bytes_whole(STUDIES / "README.md", page(all_items, all_scores).encode())
    scored = {score.item for score in all_scores}
    missing = [item.name for item in all_items if item.studies and item.name not in scored]
    print(_counts(all_items, all_scores))
    print("open: " + (", ".join(missing) or "nothing"))


if __name__ == "__main__":
    main()
