"""An FRF as a table: for people and spreadsheets (read back by `toolbox.formats.frf.frf_csv`)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from loopshape.core.units import Array
from loopshape.data.response.frf import FRF
from loopshape.io.config_table import refuse_doubles
from loopshape.io.files import write_text_whole
from loopshape.io.write.frf_words import frf_header

FORMAT = "loopshape-frf-csv/2"


def frf_csv(path: Path, frf: FRF, *, header: bool = False) -> None:
    """Write an FRF as a table: frequency_hz, re, im, std, coherence, valid (1 or 0).

    `std` is sqrt(E|d|²) of the complex error, in the response's unit. A larger FRF than 1 x 1 has re, im
    and std of each element, named by output and input, and before the coherence the covariances between elements p > q
    of vec(response), columns stacked and counted from 1, as cov_re_p_q and cov_im_p_q. Coherence is empty where there
    is none. With a `header` two lines that begin with # stand above, which hold what the columns do not say.
    """
    columns = _elements(frf) | _between_elements(frf)
    refuse_doubles([*columns], str(path), "columns")
    above = [f"# {FORMAT}", "# " + json.dumps({"lines": frf.frequency_hz.size} | frf_header(frf))] if header else []
    rows = [*above, ",".join([*columns, "coherence", "valid"])]
    for k, values in enumerate(zip(*columns.values(), strict=True)):
        coherence = "" if frf.coherence is None else repr(float(frf.coherence[k]))
        rows.append(",".join([*(repr(float(v)) for v in values), coherence, str(int(frf.valid[k]))]))
    write_text_whole(path, "\n".join(rows) + "\n")


def tails(outputs: tuple[str, ...], inputs: tuple[str, ...]) -> dict[tuple[int, int], str]:
    """Ending of the columns of each element (row, column), output by output."""
    one = len(outputs) == len(inputs) == 1
    return {(r, c): "" if one else f"_{y}_{u}" for r, y in enumerate(outputs) for c, u in enumerate(inputs)}


def _elements(frf: FRF) -> dict[str, Array]:
    columns: dict[str, Array] = {"frequency_hz": frf.frequency_hz}
    for (row, column), tail in tails(frf.outputs, frf.inputs).items():
        element = frf.response[:, row, column]
        refuse_doubles([*columns, f"re{tail}"], "an FRF's table", "columns")
        columns |= {f"re{tail}": element.real, f"im{tail}": element.imag}
        columns[f"std{tail}"] = np.sqrt(frf.variance[:, row, column])
    return columns


def _between_elements(frf: FRF) -> dict[str, Array]:
    columns: dict[str, Array] = {}
    for p in range(frf.covariance.shape[1]):
        for q in range(p):
            columns[f"cov_re_{p + 1}_{q + 1}"] = frf.covariance[:, p, q].real
            columns[f"cov_im_{p + 1}_{q + 1}"] = frf.covariance[:, p, q].imag
    return columns
