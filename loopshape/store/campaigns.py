"""Campaign files, and the table of machines beside the runs of one.

format = "loopshape-campaign/1"
study = "identify.toml"                   # a plain name beside this file
amplitudes = [0.5, 1.0, 2.0]              # factors on every excitation
effects = ["", "joint_friction=0.12", "gas_law + payload=0.1"]   # sets; "" is none, a bare name a usual magnitude
draws = 20                                # machines of the ordinary spread; 0: the nominal one
seed = 1
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from loopshape.campaign import Campaign, Machine
from loopshape.store.files import inside, write_text_whole
from loopshape.store.study import read_study
from loopshape.store.words import read_words

FORMAT = "loopshape-campaign/1"
INDEX = "index.csv"
Asked = Callable[[str, Iterable[str]], Mapping[str, float]]


def read_campaign(path: Path, asked: Asked) -> tuple[Campaign, Path]:
    """The campaign in a file, and its study's file; `asked` turns a plant's name and words into magnitudes.

    Refuses another format, unknown keys, a study outside the folder, and what the study refuses.
    """
    words = read_words(path, FORMAT)
    words.only("format", "study", "amplitudes", "effects", "draws", "seed")
    file = inside(path.parent, words.text("study"), "the study of a campaign")
    study = read_study(file)
    sets = words.list_of_texts_or_empty("effects") or ("",)
    return Campaign(
        study,
        words.list_of_numbers("amplitudes") if "amplitudes" in words.table else (1.0,),
        tuple(asked(study.plant, _names(one)) for one in sets),
        words.whole("draws", 0),
        words.whole("seed", 0),
    ), file


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split("+") if name.strip()]


def write_index(folder: Path, machines: Iterable[Machine]) -> None:
    """Table of machines: what was drawn and what was added, which their runs do not say; whole or not at all."""
    listed = list(machines)
    hidden = sorted({name for machine in listed for name in machine.hidden})
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["machine", "draw", "amplitude", "effects", *hidden])
    for machine in listed:
        effects = " + ".join(f"{name}={size!r}" for name, size in machine.study.effects.items())
        drawn = [repr(machine.hidden[name]) if name in machine.hidden else "" for name in hidden]
        table.writerow([machine.name, machine.draw, repr(machine.amplitude), effects, *drawn])
    write_text_whole(folder / INDEX, text.getvalue())
