"""Controllers out to the target: one file a loop, all of the sections that `check` judges.

    controller_<loop>.json        JSON, format loopshape-biquads/1
    controller_<loop>.m       MATLAB: sections, gain, and a tf on request
    controller_<loop>.h       C99 and C++: coefficients, a state, a reset and a step function
    controller_<loop>.st      structured text of a PLC (IEC 61131-3): a function block
    controller_<loop>.TcPOU   the same for TwinCAT 3
    controller_<loop>.txt     a filter file of the LIGO control system (foton)
    controller_<loop>.npz     `sos` (sections, 6) for scipy.signal.sosfilt
    controller_<loop>_simulink.m   MATLAB: a script that builds a Simulink subsystem
    controller_<loop>.odrive, .sercos          parameters of a drive's loop (`toolbox.formats.controllers.drives`)
    controller_<loop>.params, .param, .cli     parameters of px4, ardupilot, betaflight (`firmware`)

Every file carries the controller's digest, rate, precision, prewarping and delay.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from loopshape import __version__
from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.data.control.controller import Block, Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.io.files import make_folder, write_bytes_whole, write_json, write_text_whole
from loopshape.toolbox.formats.controllers.controller_c import c_text
from loopshape.toolbox.formats.controllers.controller_foton import foton_text
from loopshape.toolbox.formats.controllers.controller_matlab import matlab_text, simulink_text
from loopshape.toolbox.formats.controllers.controller_st import st_text, twincat_text
from loopshape.toolbox.formats.controllers.controller_words import FORM, error_feedback, identifier
from loopshape.toolbox.formats.controllers.drives import drive_text
from loopshape.toolbox.formats.controllers.firmware import parameters_text
from loopshape.toolbox.formats.controllers.limited import LimitedLaw, OutputLimits, limited
from loopshape.toolbox.schedules.export import schedule_file

FORMAT = "loopshape-biquads/1"


def export_controllers(
    folder: Path, controllers: Sequence[Controller | Scheduled], to: str, limits: OutputLimits | None = None
) -> tuple[Path, ...]:
    """Write each controller or schedule to `folder` in a format of `WRITERS`; returns the files, in order.

    With `limits` their outputs are limited, in the formats of `LIMITED`.

    Nothing is written before all are made. Refuses an unknown format, no controller, two loops whose names become one
    (upper and lower case count as one, as on some disks), and sections that are unstable as they will run.
    """
    refuse_unknown("a format for controllers is not known", to, WRITERS)
    if not controllers:
        raise WrongUseError("there is no controller to export", "an empty list")
    if limits is not None and (to not in LIMITED or any(isinstance(one, Scheduled) for one in controllers)):
        raise WrongUseError(
            "limits of the output leave with single controllers in some formats alone", to,
            f"use {', '.join(LIMITED)}, or limit where the controller runs",
        )  # fmt: skip
    made = [schedule_file(one, to) if isinstance(one, Scheduled) else _file(one, to, limits) for one in controllers]
    names = [name for name, _ in made]
    for k, name in enumerate(names):
        if name.casefold() in (other.casefold() for other in names[:k]):
            raise WrongUseError("two loops would become one file", name, "give them names that differ in letters")
    make_folder(folder)
    for name, content in made:
        if isinstance(content, str):
            write_text_whole(folder / name, content)
        elif isinstance(content, bytes):
            write_bytes_whole(folder / name, content)
        else:
            write_json(folder / name, content)
    return tuple(folder / name for name in names)


def _file(one: Controller, to: str, limits: OutputLimits | None) -> tuple[str, str | bytes | dict[str, Any]]:
    """Name and content of a controller's file; refuses sections that are unstable as they will run."""
    ending, write = WRITERS[to]
    name = f"{identifier(one.loop)}{ending}"
    one.check_sections()
    return name, write(one) if limits is None else LIMITED[to](one, limited(one, limits))


def _limited_table(controller: Controller, law: LimitedLaw) -> dict[str, Any]:
    """The JSON object with the limits, and the order in which the sections run with them."""
    stated = {**asdict(law.limits), "rate": law.limits.rate if np.isfinite(law.limits.rate) else None}
    return biquads_table(controller) | {"limits": stated | {"order": list(law.order), "integrating": law.integrating}}


def biquads_table(controller: Controller) -> dict[str, Any]:
    """The JSON object `loopshape-biquads/1`: numbers that read back exactly, in decimal and hexadecimal."""
    c, form = controller, controller.number_format
    sections = c.biquads()
    integers = form.integers(sections) if form.fixed else [None] * len(sections)
    table: dict[str, Any] = {
        "format": FORMAT,
        "made_by": f"loopshape {__version__}",
        "loop": c.loop,
        "digest": c.digest,
        "rate_hz": float(c.rate_hz),
        "discretisation": c.discretisation,
        "prewarp_hz": c.prewarp_hz,
        "computation_delay_s": c.computation_delay_s,
        "added_hold": c.added_hold,
        "precision": c.precision,
        "form": FORM,
    }
    if form.fixed:
        table["fixed_point"] = {
            "integer_bits": form.integer_bits,
            "fraction_bits": form.fraction_bits,
            "signal_limit": form.signal_limit,
        }
    rows = zip(c.blocks, sections.tolist(), integers, strict=True)
    return table | {"sections": [_section(block, row, whole) for block, row, whole in rows]}


_NAMES = ("b0", "b1", "b2", "a1", "a2")


def _section(block: Block, row: list[float], integers: list[int] | None) -> dict[str, Any]:
    table: dict[str, Any] = dict(zip(_NAMES, row, strict=True))
    table["hex"] = {name: value.hex() for name, value in zip(_NAMES, row, strict=True)}
    if integers is not None:
        table["integers"] = dict(zip(_NAMES, integers, strict=True))
        table["error_feedback"] = list(error_feedback(row[3], row[4]))
    return table | {"block": block.to_table()}


def sos_bytes(controller: Controller) -> bytes:
    """NPZ with `sos` (sections, 6) as scipy takes it: b0 b1 b2 1 a1 a2; beside it rate, delay and digest."""
    sections = controller.biquads()
    file = BytesIO()
    np.savez(
        file, sos=np.insert(sections, 3, 1.0, axis=1), rate_hz=float(controller.rate_hz),
        computation_delay_s=controller.computation_delay_s, loop=controller.loop, digest=controller.digest,
        precision=controller.precision,
    )  # fmt: skip
    return file.getvalue()


#: format -> ending of the file, and its content: a text, bytes, or an object for JSON
WRITERS: dict[str, tuple[str, Callable[[Controller], str | bytes | dict[str, Any]]]] = {
    "json": (".json", biquads_table),
    "matlab": (".m", matlab_text),
    "simulink": ("_simulink.m", simulink_text),
    "c": (".h", c_text),
    "st": (".st", st_text),
    "twincat": (".TcPOU", twincat_text),
    "foton": (".txt", foton_text),
    "sos": (".npz", sos_bytes),
    "odrive": (".odrive", partial(drive_text, of="odrive")),
    "sercos": (".sercos", partial(drive_text, of="sercos")),
    "px4": (".params", partial(parameters_text, firmware="px4")),
    "ardupilot": (".param", partial(parameters_text, firmware="ardupilot")),
    "betaflight": (".cli", partial(parameters_text, firmware="betaflight")),
}
#: formats in which an output can be limited
LIMITED: dict[str, Callable[[Controller, LimitedLaw], str | dict[str, Any]]] = {
    "json": _limited_table,
    "c": c_text,
    "st": st_text,
    "twincat": twincat_text,
}
