"""Fits beside the run whose FRFs they describe: `fits.json`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.data.response.model import Estimate, Fit, TransferFunction
from loopshape.io.files import read_json, reading, write_json

FORMAT = "loopshape-fits/1"
FILE = "fits.json"


def write_fits(run_folder: Path, fits: Sequence[Fit]) -> Path:
    """Write all fits of a run, whole, in place of those before; returns the file.

    NaN and infinite numbers stand as "nan", "inf" and "-inf".
    """
    path = run_folder / FILE
    write_json(path, {"format": FORMAT, "loopshape": __version__, "fits": list(fits)})
    return path


def read_fits(run_folder: Path) -> tuple[Fit, ...]:
    """The fits of a run; refuses a run that has none, another format, and a damaged file."""
    path = run_folder / FILE
    if not path.exists():
        raise UnreadableInputError("a run has no fits yet", str(path), "fit its FRFs first: loopshape fit RUN")
    data = read_json(path)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", "another file", "fit the FRFs again")
    with reading(path, "fits", WrongUseError):
        return tuple(_fit(table) for table in data["fits"])


def _fit(table: dict[str, Any]) -> Fit:
    if unknown := set(table) - {f.name for f in fields(Fit)}:
        raise ValueError(f"unknown keys {', '.join(sorted(unknown))}")
    model, (low, high) = table["model"], table["band_hz"]
    n = len(table["parameters"])
    return Fit(
        structure=str(table["structure"]),
        model=TransferFunction(np.array(model["num"]), np.array(model["den"]), float(model["delay_s"])),
        parameters=tuple(
            Estimate(str(p["name"]), float(p["value"]), str(p["unit"]), float(p["std"])) for p in table["parameters"]
        ),
        covariance=np.array(table["covariance"], dtype=float).reshape(n, n),
        outcome=str(table["outcome"]),
        chi2_per_dof=float(table["chi2_per_dof"]),
        p_value=float(table["p_value"]),
        runs_p_value=float(table["runs_p_value"]),
        misfit_db=float(table["misfit_db"]),
        band_hz=(float(low), float(high)),
        lines=int(table["lines"]),
        recording=str(table["recording"]),
        loop=str(table["loop"]),
        operating_point={str(k): float(v) for k, v in table["operating_point"].items()},
        delay_free=bool(table["delay_free"]),
        starts=int(table.get("starts", 1)),
        starts_agreeing=int(table.get("starts_agreeing", 1)),
        frf_digest=str(table.get("frf_digest", "")),
        rig_parameters={str(k): float(v) for k, v in table.get("rig_parameters", {}).items()},
    )
