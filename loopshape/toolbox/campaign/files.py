"""Campaign files, and the table of machines beside the runs of one.

format = "loopshape-campaign/1"
study = "identify.toml"                   # a plain name beside this file
amplitudes = [0.5, 1.0, 2.0]              # factors on every excitation
effects = ["", "joint_friction=0.12", "gas_law + payload=0.1"]   # sets; "" is none, a bare name a usual magnitude
draws = 20                                # machines drawn from the manufacturing tolerance; 0: the nominal one
seed = 1
"""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.io.config_table import read_words
from loopshape.io.files import PART, inside, reading, short, write_text_whole, write_whole
from loopshape.io.folder_lock import alone
from loopshape.io.run.run_folder import INDEX
from loopshape.io.schema import value_of
from loopshape.toolbox.campaign.machines import Campaign, Machine, Part
from loopshape.toolbox.rig.files.study import read_study

FORMAT = "loopshape-campaign/1"
_PART_FOLDER = re.compile(r"part-(\d{1,6})-of-(\d{1,6})")
Asked = Callable[[str, Iterable[str]], Mapping[str, float]]


def read_campaign(path: Path, asked: Asked) -> tuple[Campaign, Path]:
    """The campaign in a file, and its study's file; `asked` turns a plant's name and words into magnitudes.

    Refuses another format, unknown keys, a study outside the folder or not simulated, and what the study refuses.
    """
    words = read_words(path, FORMAT)
    words.only("format", "study", "amplitudes", "effects", "draws", "seed")
    file = inside(path.parent, words.text("study"), "the study of a campaign")
    study = read_study(file)
    if study.rig != "simulated":
        raise WrongUseError("a campaign is simulated", f"rig = {study.rig!r}", "measure a target by `measure`")
    sets = value_of(tuple[str, ...], words.table.get("effects", [""]), "effects", words.where, own=True) or ("",)
    return Campaign(
        study,
        words.value("amplitudes", tuple[float, ...], (1.0,)),
        tuple(asked(study.plant, _names(one)) for one in sets),
        words.whole("draws", 0),
        words.whole("seed", 0),
    ), file


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split("+") if name.strip()]


def write_index(folder: Path, machines: Iterable[Machine]) -> None:
    """`index_of`, written."""
    index_of(folder, machines)()


def index_of(folder: Path, machines: Iterable[Machine]) -> Callable[[], None]:
    """Table of machines: what was drawn and what was added, which their runs do not say; gives what writes it whole.

    Refuses a folder that holds other things than a campaign, and one whose table has other machines: their recordings
    would pass for those of these.
    """
    rows = _index(list(machines))
    there = _index_there(folder)
    known = {tuple(row) for row in rows[1:]}
    if there and (there[0] != rows[0] or not known.issuperset(map(tuple, there[1:]))):
        raise WrongUseError(
            f"{folder} holds the machines of another campaign",
            _first_other(there, known) if there[0] == rows[0] else "other columns",
            "choose another folder, or delete this one; more draws may be added, nothing else",
        )
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return lambda: write_text_whole(folder / INDEX, text.getvalue())


def _first_other(there: list[list[str]], known: set[tuple[str, ...]]) -> str:
    return short(next((f"{row[0]} drawn or asked for otherwise" for row in there[1:] if tuple(row) not in known), ""))


def _index(machines: list[Machine]) -> list[list[str]]:
    """Header and rows."""
    hidden = sorted({name for machine in machines for name in machine.hidden})
    rows = [["machine", "draw", "amplitude", "effects", "seed", *hidden]]
    for machine in machines:
        effects = " + ".join(f"{name}={size!r}" for name, size in machine.study.effects.items())
        drawn = [repr(machine.hidden[name]) if name in machine.hidden else "" for name in hidden]
        rows.append(
            [machine.name, str(machine.draw), repr(machine.amplitude), effects, str(machine.study.seed), *drawn]
        )
    return rows


def _index_there(folder: Path) -> list[list[str]]:
    """The table in a folder, [] in an empty one; refuses a folder that is no campaign's."""
    path = folder / INDEX
    with reading(path, "a table of machines", csv.Error):
        foreign = sorted(
            p.name for p in folder.iterdir() if not (p.name.endswith(PART) or _PART_FOLDER.fullmatch(p.name))
        )
        if INDEX in foreign:
            rows = [row for row in csv.reader(path.read_text(encoding="utf-8").splitlines()) if row]
            if not rows or rows[0][:1] != ["machine"]:
                raise ValueError("it does not begin with the column machine")
            return rows
    if foreign:
        raise WrongUseError(
            "a folder that is no campaign is not written into",
            f"{folder}, which holds {short(', '.join(foreign[:5]))}",
            "choose a new or an empty folder",
        )
    return []


def parts(folder: Path) -> list[Path]:
    """Folders of a campaign's parts in order; refuses none, parts of different divisions, and missing ones."""
    found = _part_folders(folder)
    divisions = sorted({int(match[2]) for match in found})
    if len(divisions) != 1:
        raise WrongUseError(
            "all parts of one division are merged",
            f"{folder}, which holds parts of {' and of '.join(map(str, divisions)) or 'none'}",
            "record them with --part 1/8 to 8/8, and keep those of one division",
        )
    wanted = [Part(k + 1, divisions[0]) for k in range(divisions[0])]
    if missing := [part.name for part in wanted if not (folder / part.name).is_dir()]:
        raise WrongUseError("parts of the campaign are missing", short(", ".join(missing)), "record or copy them")
    return [folder / part.name for part in wanted]


def _part_folders(folder: Path) -> list[re.Match[str]]:
    """The names of parts in a campaign's folder."""
    with reading(folder, "a campaign's folder"):
        return [match for path in folder.iterdir() if (match := _PART_FOLDER.fullmatch(path.name))]


def same_file(source: Path, target: Path) -> None:
    """Put a table where a merged campaign has it: a further name of the file, a copy where that cannot be."""
    try:
        target.unlink(missing_ok=True)
        os.link(source, target)
    except OSError:
        write_whole(target, lambda part: _copy(source, part))


def _copy(source: Path, part: Path) -> None:
    shutil.copyfile(source, part)


def refuse_parts_at_work(folder: Path) -> None:
    """Refuse a campaign of which another process is recording a part."""
    for match in _part_folders(folder):
        with alone(folder / match[0]):
            pass


def remove_parts(folder: Path) -> None:
    """Remove the folders of parts, which were merged; refuses one that another process is writing."""
    for match in _part_folders(folder):
        with alone(folder / match[0]):
            shutil.rmtree(folder / match[0])
