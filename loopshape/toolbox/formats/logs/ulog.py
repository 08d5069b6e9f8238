"""ULog files of PX4: their messages as signals, read by pyulog (extra `ulog`).

A signal is `TOPIC.FIELD`, of a further instance `TOPIC#1.FIELD`; the stamps of a topic are `time of TOPIC`, in s since
the log's first message. Topics have rates of their own.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Collection
from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import reading
from loopshape.io.size_limit import check_growth
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF

#: axes of a rate loop; of their signals the newest names stand first below
_AXES = ("roll", "pitch", "yaw")


def read_ulog(path: Path) -> dict[str, np.ndarray]:
    """Signals (n,) and stamps by name. Refuses a missing extra, and a damaged file."""
    try:
        from pyulog import ULog
    except ImportError:
        raise UnreadableInputError(
            "a ULog file needs pyulog", path.name, "install it: pip install 'loopshape[ulog]'"
        ) from None
    output = contextlib.redirect_stdout(io.StringIO())  # pyulog prints what it meets
    with reading(path, "ULog", Exception), output, path.open("rb") as file:
        log = ULog(file)
        check_growth(path, sum(values.nbytes for topic in log.data_list for values in topic.data.values()))
    if not log.data_list:
        raise UnreadableInputError(f"{path.name} holds no messages", "an empty log", "log again")
    first = min(int(topic.data["timestamp"][0]) for topic in log.data_list if topic.data["timestamp"].size)
    found: dict[str, np.ndarray] = {}
    per_s = 1e6  # stamps count microseconds
    for topic in log.data_list:
        name = topic.name if topic.multi_id == 0 else f"{topic.name}#{topic.multi_id}"
        found |= {f"{name}.{field}": values for field, values in topic.data.items() if field != "timestamp"}
        found[TIME_OF + name] = (topic.data["timestamp"].astype(np.int64) - first) / per_s
    return found


def rate_loop(names: Collection[str], axis: int) -> dict[str, str]:
    """Names of reference, control and output of one axis (0 roll) of PX4's rate loop, as far as a log holds them."""
    wanted = {
        "reference": (f"vehicle_rates_setpoint.{_AXES[axis]}",),
        "control": (f"vehicle_torque_setpoint.xyz[{axis}]", f"actuator_controls_0.control[{axis}]"),
        "output": (f"vehicle_angular_velocity.xyz[{axis}]", f"sensor_combined.gyro_rad[{axis}]"),
    }
    found = {part: next((n for n in known if n in names), None) for part, known in wanted.items()}
    return {part: name for part, name in found.items() if name is not None}
