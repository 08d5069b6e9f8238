"""An FRF as an HDF5 file that h5py alone reads: lines first, covariance and provenance beside; docs/frf_hdf5.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError
from loopshape.data.response.frf import FRF
from loopshape.io.files import reading, short, write_whole
from loopshape.io.size_limit import check_growth
from loopshape.io.write.frf_words import PERHAPS, RENAMED, frf_arrays, frf_header, is_format
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF

FORMAT = "loopshape-frf-hdf5/2"
_ALONE = ("method", "recording", "loop", "rate_hz", "averages", "variance_freedom", "hold", "open_loop")
_LISTS = ("inputs", "outputs", "notes", "recordings")
_DIMENSIONS = {"frequency_hz": 1, "response": 3, "covariance": 3, "valid": 1}


def write_frf_hdf5(path: Path, frf: FRF) -> tuple[str, ...]:
    """Write all that an FRF holds; names, method and the like as attributes, everything of it as JSON in `header`."""
    import h5py

    header = frf_header(frf)

    def write(part: Path) -> None:
        with h5py.File(part, "w") as file:
            for name, values in frf_arrays(frf).items():
                file[name] = values.astype(np.uint8) if values.dtype == bool else values
            file["frequency_hz"].attrs["unit"] = "Hz"
            for name in _LISTS:
                file.create_dataset(name, data=list(header[name]), dtype=h5py.string_dtype())
            stated = {name: header[name] for name in _ALONE if header[name] is not None}
            made = {"format": FORMAT, "made_by": f"loopshape {__version__}", "header": json.dumps(header)}
            for name, value in (stated | made).items():
                file.attrs[name] = str(value) if isinstance(value, str) else value
            for name in ("operating_point", "parameters"):
                group = file.create_group(name)
                for key, value in header[name].items():
                    group.attrs[key] = value

    write_whole(path, write)
    return ()


def read_frf_hdf5(path: Path) -> ForeignFRF:
    """The FRF of such a file, or of one with `frequency_hz` and `response` (lines, outputs, inputs) alone.

    Refuses another format, arrays of other dimensions, and links out of the file.
    """
    import h5py

    with reading(path, "HDF5"):
        path.open("rb").close()
        with h5py.File(path, "r") as file:
            words = _words(path, file)
            arrays = {
                RENAMED.get(name, name): _array(path, file, name)
                for name in (*_DIMENSIONS, *PERHAPS, *RENAMED)
                if name in file
            }
    if missing := [name for name in ("frequency_hz", "response") if name not in arrays]:
        raise UnreadableInputError(
            f"{path.name} holds no FRF", f"no {', '.join(missing)}", "write both, lines first: docs/frf_hdf5.md"
        )
    f, response = arrays.pop("frequency_hz").astype(float), arrays.pop("response").astype(complex)
    if "valid" in arrays:
        arrays["valid"] = arrays["valid"] != 0
    return ForeignFRF(str(path), f, response, arrays, words)


def _words(path: Path, file: Any) -> dict[str, Any]:
    text = str(file.attrs.get("format", ""))
    if text and not is_format(text, FORMAT):
        raise UnreadableInputError(f"{path.name} is not of the format {FORMAT}", short(text), "take format out of it")
    words = json.loads(str(file.attrs.get("header", "{}")))
    if not isinstance(words, dict):
        raise ValueError("header is no table")
    return words


def _array(path: Path, file: Any, name: str) -> np.ndarray:
    """An array of this file itself; refuses links, other dimensions and what is no number."""
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink) or not isinstance(file[name], h5py.Dataset):
        raise ValueError(f"{name} is no array of this file")
    check_growth(path, file[name].nbytes)
    values = np.asarray(file[name][()])
    if values.dtype.kind not in "biufc" or values.ndim != _DIMENSIONS.get(name, values.ndim):
        raise ValueError(f"{name} is {values.dtype} with {values.ndim} dimensions")
    return values
