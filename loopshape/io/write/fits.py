"""Fits beside the run whose FRFs they describe: `fits.json`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.data.response.model import Fit
from loopshape.io.files import read_json, reading, write_json
from loopshape.io.schema import read

FORMAT = "loopshape-fits/1"
FILE = "fits.json"


def write_fits(place: Path, fits: Sequence[Fit]) -> Path:
    """Write all fits of a run's folder, or of a file (.json), whole, in place of those before; returns the file.

    NaN and infinite numbers stand as "nan", "inf" and "-inf".
    """
    path = _file(place)
    write_json(path, {"format": FORMAT, "loopshape": __version__, "fits": list(fits)})
    return path


def _file(place: Path) -> Path:
    return place if place.suffix == ".json" and not place.is_dir() else place / FILE


def fits_of(run: Path) -> tuple[Fit, ...]:
    """The run's fits, none where nothing was fitted yet."""
    return read_fits(run) if (run / FILE).exists() else ()


def read_fits(place: Path) -> tuple[Fit, ...]:
    """The fits of a run's folder, or of a file; refuses a run that has none, another format, and a damaged file."""
    path = _file(place)
    if not path.exists():
        raise UnreadableInputError("a run has no fits yet", str(path), "fit its FRFs first: loopshape fit RUN")
    data = read_json(path)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", "another file", "fit the FRFs again")
    with reading(path, "fits", WrongUseError):
        found = [read(Fit, table, path.name, own=True) for table in data["fits"]]
        return tuple(replace(x, covariance=x.covariance.reshape([len(x.parameters)] * 2)) for x in found)
