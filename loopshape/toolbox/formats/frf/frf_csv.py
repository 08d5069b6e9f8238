"""The table of an FRF that `io.write.frf_csv` writes, back with its whole covariance."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array
from loopshape.io.csv_text import CsvShape, CsvTable, read_csv_table
from loopshape.io.files import reading, short
from loopshape.io.write.frf_csv import FORMAT, tails
from loopshape.io.write.frf_words import RENAMED, is_format
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF, Stated
from loopshape.toolbox.formats.frf.frf_table import read_frf_table


def read_frf_csv(path: Path, stated: Stated | None = None) -> ForeignFRF:
    """A table as `frf_csv` writes it, or any with frequency_hz, re and im; others as `frf_table` reads them.

    One without the header lines says its channels' names in no column: larger than 1 x 1 they must be stated.
    Refuses columns that do not belong, cells that are missing or no numbers, and fewer rows than the header counted.
    """
    stated = stated or Stated()
    if not _is_ours(path):
        return read_frf_table(path)
    words, above = _header(path)
    table = read_csv_table(path, CsvShape(skip_rows=above))
    table = replace(table, names=tuple(RENAMED.get(name, name) for name in table.names))
    outputs, inputs = (tuple(words.get(name) or getattr(stated, name)) for name in ("outputs", "inputs"))
    if "re" in table.names or not (outputs and inputs):
        outputs, inputs = ("y",), ("u",)  # places only: the names come from the words or the user
    endings = tails(outputs, inputs)
    wanted = ["frequency_hz", *(f"{part}{tail}" for tail in endings.values() for part in ("re", "im"))]
    extra = [f"std{tail}" for tail in endings.values()]
    n = len(endings)
    cross = [f"cov_{part}_{p + 1}_{q + 1}" for p in range(n) for q in range(p) for part in ("re", "im")]
    _check_columns(table, wanted, [*extra, *cross, "coherence", "valid"])
    f = _column(table, "frequency_hz")
    if "lines" in words and words["lines"] != f.size:
        raise UnreadableInputError(f"{path} is cut short", f"{f.size} of {words['lines']} lines", "write it again")
    response = np.empty((f.size, len(outputs), len(inputs)), dtype=complex)
    for (row, column), tail in endings.items():
        response[:, row, column] = _column(table, f"re{tail}") + 1j * _column(table, f"im{tail}")
    arrays: dict[str, np.ndarray] = {}
    if all(name in table.names for name in extra):
        arrays["covariance"] = _covariance(table, extra, cross, len(outputs), len(inputs))
    if "valid" in table.names:
        arrays["valid"] = _mask(table)
    coherence = _perhaps(table, "coherence")
    if coherence is not None and n > 1:
        arrays["coherence"] = coherence
    keep = {k: v for k, v in words.items() if k != "lines"}
    return ForeignFRF(
        str(path), f, response, arrays, keep,
        element_coherence=None if coherence is None or n > 1 else coherence[:, None, None],
    )  # fmt: skip


def _is_ours(path: Path) -> bool:
    """Whether a table begins as those of `frf_csv` do: with its mark, or with frequency_hz and real parts."""
    with reading(path, "CSV"), path.open(encoding="utf-8-sig", errors="replace") as file:
        first, second = file.readline(), file.readline()
    names = [name.strip() for name in first.split(",")]
    parts = [name for name in names if name.split("_")[0] in ("re", "im")]
    marked = first.startswith("# loopshape-") or (first.startswith("#") and second.startswith("# {"))
    return marked or ("frequency_hz" in names and bool(parts or len(names) == 1))


def _header(path: Path) -> tuple[Mapping[str, Any], int]:
    """Words and number of the lines above the columns; none in a bare table."""
    with reading(path, "CSV"), path.open(encoding="utf-8-sig") as file:
        first = file.readline()
        if not first.startswith("#"):
            return {}, 0
        second = file.readline()
    if not is_format(first.strip("# \n\r"), FORMAT):
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", short(first), "remove such frequencies")
    with reading(path, "the words of an FRF's table"):
        words = json.loads(second.removeprefix("#"))
        if not isinstance(words, dict) or not isinstance(words["lines"], int):
            raise ValueError("no table of words")
        for name in ("outputs", "inputs"):
            if not isinstance(words[name], list) or not all(isinstance(x, str) and x for x in words[name]):
                raise ValueError(f"{name} is no list of names")
    return words, 2


def _check_columns(table: CsvTable, wanted: list[str], others: list[str]) -> None:
    missing = [name for name in wanted if name not in table.names]
    unknown = [name for name in table.names if name not in (*wanted, *others)]
    if missing or unknown:
        words = [f"no {', '.join(missing)}"] if missing else []
        words += [f"unknown {', '.join(map(repr, unknown))}"] if unknown else []
        raise UnreadableInputError(
            f"{table.path} is no table of an FRF", short("; ".join(words)),
            "it has the columns frequency_hz, re, im and perhaps std, coherence, valid; with several channels re, im"
            " and std end in _output_input, and the names are stated (--outputs, --inputs)",
        )  # fmt: skip


def _column(table: CsvTable, name: str) -> Array:
    """A column (n,) of finite numbers; refuses an empty cell, naming its row."""
    values = table.column(name)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size or not values.size:
        raise UnreadableInputError(
            f"column {name} of {table.path} must hold a number in every row",
            f"none in row {bad[0] + 1}" if bad.size else "no rows", "it is damaged: write it again",
        )  # fmt: skip
    return values


def _perhaps(table: CsvTable, name: str) -> Array | None:
    """A column that may be missing or empty throughout."""
    return None if name not in table.names or np.isnan(table.column(name)).all() else _column(table, name)


def _mask(table: CsvTable) -> np.ndarray:
    values = _column(table, "valid")
    if not np.isin(values, (0.0, 1.0)).all():
        raise UnreadableInputError(f"valid of {table.path} is 1 or 0", f"{values[~np.isin(values, (0, 1))][0]:g}")
    return np.asarray(values == 1.0)


def _covariance(table: CsvTable, std: list[str], cross: list[str], ny: int, nu: int) -> np.ndarray:
    """Covariance (nf, n, n) from the standard deviations, output by output, and what lies below the diagonal."""
    n = ny * nu
    each = np.stack([_column(table, name) for name in std], axis=1)
    if each.min() < 0.0:
        raise UnreadableInputError(f"a standard deviation of {table.path} is negative", f"{each.min():g}")
    made = np.zeros((len(each), n, n), dtype=complex)
    place = np.arange(n).reshape(nu, ny).T.ravel()  # of output by output in vec with columns stacked
    with np.errstate(over="ignore"):  # an FRF refuses what is not finite
        made[:, place, place] = each**2
    present = [name for name in cross if name in table.names]
    if present and len(present) != len(cross):
        raise UnreadableInputError(
            f"{table.path} holds a part of its covariance", f"{len(present)} of {len(cross)} columns", "write it again"
        )
    for re, im in zip(present[::2], present[1::2], strict=True):
        p, q = (int(k) - 1 for k in re.split("_")[2:])
        made[:, p, q] = _column(table, re) + 1j * _column(table, im)
        made[:, q, p] = made[:, p, q].conj()
    return made
