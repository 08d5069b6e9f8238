"""Predictions in one file (npz): arrays by number, words in a JSON header; `predict` writes it, `compare` reads it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.json_ready import json_ready
from loopshape.core.outcomes import ClosedLoop
from loopshape.data.response.frf import FRF
from loopshape.data.result.step import Step
from loopshape.io.files import make_folder, reading, write_whole
from loopshape.io.schema import read
from loopshape.io.write.frf_words import arrays_in, frf_arrays, frf_header, frf_words, is_format
from loopshape.toolbox.validation.predicted.nouns import Prediction

FORMAT = "loopshape-predictions/2"
_STEP = ("time_s", "response", "low", "high")
#: |S| and its standard deviation beyond these are no closed loop's: their squares leave the numbers
_LEAST, _MOST = 1e-20, 1e20


def write_predictions(path: Path, predictions: Sequence[Prediction]) -> None:
    """Write predictions whole, in place of what was there; refuses none, and two of one loop and recording."""
    if not predictions:
        raise WrongUseError("there is no prediction to write", "an empty list", "predict from an FRF first")
    names = [(one.loop, one.recording) for one in predictions]
    if len(set(names)) != len(names):
        raise WrongUseError("two predictions are of one loop and recording", f"{len(names)} for {len(set(names))}")
    header = {"format": FORMAT, "predictions": [_words(one) for one in predictions]}
    arrays = {f"{k}.{name}": a for k, one in enumerate(predictions) for name, a in _arrays(one).items()}
    text = np.array(json.dumps(json_ready(header)))

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez_compressed(file, header=text, **arrays)

    make_folder(path.parent)
    write_whole(path, write)


def _arrays(one: Prediction) -> dict[str, Any]:
    step = {} if one.step is None else {f"step.{name}": getattr(one.step, name) for name in _STEP}
    return frf_arrays(one.sensitivity) | step


def _words(one: Prediction) -> dict[str, Any]:
    step = None
    if one.step is not None:
        step = {name: getattr(one.step, name) for name in ("indicators", "source", "unsettled", "notes")}
    return {
        "sensitivity": frf_header(one.sensitivity), "stability": one.stability, "notes": one.notes, "step": step,
    }  # fmt: skip


def read_predictions(path: Path) -> tuple[Prediction, ...]:
    """The predictions of a file, in order; refuses another format, damaged files and values that no loop has."""
    with reading(path, "predictions"), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        found = header["format"]
        arrays = {name: file[name] for name in file.files if name != "header"}
    if not is_format(found, FORMAT):
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", repr(found), "predict again")
    with reading(path, "predictions", WrongUseError):
        return tuple(_read(words, arrays, k, str(path)) for k, words in enumerate(header["predictions"]))


def _read(words: Mapping[str, Any], arrays: Mapping[str, Any], k: int, where: str) -> Prediction:
    own = arrays_in(arrays, f"{k}.")
    sensitivity = FRF(**own, **frf_words(words["sensitivity"], where))
    _refuse_sizes(sensitivity)
    step = None
    if words["step"] is not None:
        own = {name: arrays[f"{k}.step.{name}"] for name in _STEP}
        step = read(Step, {**words["step"], **own}, where, own=True)
        if not all(np.isfinite(getattr(step, name)).all() for name in _STEP):
            raise WrongUseError("a predicted step is of finite numbers", "NaN or infinity", "predict again")
    made = Prediction(sensitivity, ClosedLoop(words["stability"]), step, tuple(map(str, words["notes"])))
    made.controller  # noqa: B018  refuses a prediction without one
    return made


def _refuse_sizes(sensitivity: FRF) -> None:
    size, std = np.abs(sensitivity.response), np.sqrt(np.abs(sensitivity.covariance))
    if size.min() < _LEAST or size.max() > _MOST or std.max() > _MOST:
        raise WrongUseError(
            f"a predicted |S| lies in {_LEAST:g} .. {_MOST:g}",
            f"{size.min():g} .. {size.max():g}, standard deviation to {std.max():g}",
            "predict again",
        )
