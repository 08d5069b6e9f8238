"""Requirements files: what each loop must keep."""

from __future__ import annotations

from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.data.requirement.requirements import Requirements, SeveralRequirements
from loopshape.io.config_table import ConfigTable, is_number, read_words, refuse_doubles, said_in

FORMAT = "loopshape-requirements/1"


def read_requirements(path: Path) -> tuple[Requirements, ...]:
    """Requirements of a file, one a loop.

    Refuses another format, unknown keys, values of the wrong kind, no loop, and two of one name.
    """
    return read_required(path)[0]


def read_required(path: Path) -> tuple[tuple[Requirements, ...], SeveralRequirements | None]:
    """What a file requires of each loop, and of all together, None where it has no table `[several]`."""
    words = read_words(path, FORMAT)
    words.only("format", "loop", "several")
    words.need("loop")
    requirements = tuple(_read(table) for table in words.tables("loop"))
    if not requirements:
        raise WrongUseError(f"{path.name} requires nothing", "no [[loop]]", "write a [[loop]] with a name")
    refuse_doubles((one.loop for one in requirements), path.name, "loops")
    return requirements, _several(words.inner("several")) if "several" in words.table else None


def _several(words: ConfigTable) -> SeveralRequirements:
    if "band_hz" in words.table:
        words.list_of_numbers("band_hz")
    for key in words.table:
        if key not in ("band_hz", "integrators", "unstable_poles"):  # whole numbers are the noun's to check
            words.number(key)
    with said_in(words.where):
        return SeveralRequirements.from_table(words.table)


def _read(words: ConfigTable) -> Requirements:
    words.text("name")
    for block in words.tables("structure"):
        _check_block(block)
    for mask in words.tables("masks"):
        mask.only("response", "points", "sense")
    for weight in words.tables("weights"):
        weight.only("response", "points", "blocks")
        for block in weight.tables("blocks"):
            _check_block(block)
    for one in words.tables("at"):
        for mask in one.tables("masks"):
            mask.only("response", "points", "sense")
    if "band_hz" in words.table:
        words.list_of_numbers("band_hz")
    for key, value in words.table.items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            words.number(key)  # refuses inf and nan
    with said_in(words.where):
        return Requirements.from_table(words.table)


def _check_block(words: ConfigTable) -> None:
    """Refuse a parameter that is no number, no table of numbers and no parameter's name."""
    words.text("kind")
    for key, value in words.table.items():
        if isinstance(value, dict):
            words.numbers(key)
        elif not is_number(value) and not isinstance(value, str):
            raise WrongUseError(
                f"{words.where}: {key} is a number, a table with min and max, or a parameter's name", repr(value)
            )
