"""Files of iterative learning: the filters (JSON), and the feedforward of a trial sample by sample (CSV, Parquet).

A feedforward has the columns `t_s` and `feedforward_<unit>`; a study names its file beside itself:

    feedforward = { x = "next.csv" }
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.io.files import read_json, reading, write_json, write_text_whole
from loopshape.io.run.tables import TIME, TableColumns
from loopshape.toolbox.learning.next_trial import NextTrial
from loopshape.toolbox.learning.noun import Learning
from loopshape.toolbox.learning.taps import Feedforward
from loopshape.toolbox.rig.excitation.setpoints import Sampled

FORMAT = "loopshape-learning/1"
_COLUMN = "feedforward_"


def write_learning(path: Path, made: Learning) -> None:
    """Write the filters whole, with their condition at each frequency."""
    write_json(path, {"format": FORMAT, **made.to_dict()})


def read_learning(path: Path) -> Learning:
    """The filters of a file; refuses another format and a damaged file."""
    data = read_json(path)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise UnreadableInputError(
            f"{path} is not of the format {FORMAT}", "another file", "make it by loopshape learning"
        )
    with reading(path, "filters of learning"):
        F = data["filter"]
        taps, f, error, high = (
            np.array(F[k], dtype=float) for k in ("taps", "frequency_hz", "inverse_error", "inverse_high")
        )
        low, end = F["band_hz"]
        rate_hz = float(F["rate_hz"])
        own = Feedforward(taps, int(F["preview"]), rate_hz, (float(low), float(end)), f, error, high, str(F["loop"]))
        keys = ("smoothing", "frequency_hz", "factor", "factor_low", "factor_high")
        return Learning(own, *(np.array(data[k], dtype=float) for k in keys))


def write_feedforward(path: Path, trial: NextTrial) -> None:
    """Write the next trial's feedforward as CSV, whole; refuses another ending."""
    if path.suffix != ".csv":
        raise WrongUseError("a feedforward is written as CSV", repr(path.name), "end its name in .csv")
    t = np.arange(trial.feedforward.size) / trial.rate_hz
    rows = (f"{a!r},{b!r}" for a, b in zip(t.tolist(), trial.feedforward.tolist(), strict=True))
    write_text_whole(path, "\n".join([f"{TIME},{_COLUMN}{trial.unit}", *rows]) + "\n")


def read_feedforward(path: Path, rate_hz: float) -> tuple[Sampled, str]:
    """A feedforward at a rate and its unit's suffix; refuses other columns, another rate, and what are no numbers."""
    columns = TableColumns(path, rate_hz)
    names = [name for name in columns.names if name != TIME]
    if TIME not in columns or len(names) != 1 or not names[0].startswith(_COLUMN):
        raise UnreadableInputError(
            f"{path} holds no feedforward", f"columns {', '.join(columns.names)}", f"name them {TIME}, {_COLUMN}<unit>"
        )
    values = np.array(columns[names[0]], dtype=float)
    if not np.isfinite(values).all():
        raise UnreadableInputError(f"{path} holds values that are not numbers", names[0], "write it again")
    return Sampled(values, rate_hz), names[0].removeprefix(_COLUMN)
