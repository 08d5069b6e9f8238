"""TDMS files of LabVIEW: their channels as signals, read by npTDMS (extra `tdms`).

A signal is `GROUP/CHANNEL`; where a channel states its rate (waveform), its stamps are `time of GROUP/CHANNEL`, in s.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import reading
from loopshape.io.size_limit import check_growth
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF


def read_tdms(path: Path) -> dict[str, np.ndarray]:
    """Signals (n,) of numbers, scaled, and stamps by name. Refuses a missing extra, and a damaged file."""
    found: dict[str, np.ndarray] = {}
    with _channels(path) as channels:
        check_growth(path, 8 * sum(len(channel) for channel in channels))
        for channel in channels:
            name, values = f"{channel.group_name}/{channel.name}", np.asarray(channel[:])
            if values.dtype.kind not in "biuf" or not values.size:
                continue
            found[name] = values
            if "wf_increment" in channel.properties:
                start = float(channel.properties.get("wf_start_offset", 0.0))
                found[TIME_OF + name] = start + float(channel.properties["wf_increment"]) * np.arange(values.size)
    return found


def tdms_units(path: Path) -> dict[str, str]:
    """The unit that each channel states (`unit_string`), and s of the stamps."""
    with _channels(path) as channels:
        names = {f"{c.group_name}/{c.name}": str(c.properties.get("unit_string", "")) for c in channels}
    return names | {TIME_OF + name: "s" for name in names}


@contextmanager
def _channels(path: Path) -> Iterator[list[Any]]:
    """All channels, open; refuses a missing extra."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise UnreadableInputError(
            "a TDMS file needs npTDMS", path.name, "install it: pip install 'loopshape[tdms]'"
        ) from None
    with reading(path, "TDMS", Exception), path.open("rb") as raw, TdmsFile.open(raw) as file:
        yield [channel for group in file.groups() for channel in group.channels()]
