"""A user's machine: `model.toml`, and beside it a Python file with the right-hand side, a MuJoCo model, or an FMU.

A servo axis needs no second file: its equations are known, `axis` says which.

The Python file is run, and so is the FMU's library: they are loaded only when a user names the model (`--model`), never
because a run does.
"""

from __future__ import annotations

import atexit
import os
import runpy
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.io.config_table import ConfigTable, read_words, said_in
from loopshape.io.files import clear, inside, part_of, reading, short
from loopshape.io.schema import read
from loopshape.io.size_limit import check_zip
from loopshape.toolbox.gap.nouns.axis import axis
from loopshape.toolbox.gap.nouns.machine import (
    LAW,
    MATTERS,
    Input,
    Kind,
    Mechanism,
    Model,
    ModelParameter,
    Output,
    Port,
    Unit,
)

FORMAT = "loopshape-model/1"
_KEYS = (
    "format",
    "name",
    "file",
    "function",
    "states",
    "window_s",
    "matters",
    "without",
    "parameter",
    "input",
    "output",
    "port",
    "kind",
)
_MUJOCO = ("format", "name", "mujoco", "window_s", "matters", "without", "spread", "sensors", "actuators", "kind")
_FMU = ("format", "name", "fmu", "window_s", "matters", "without", "parameter", "input", "output", "port", "kind")
_AXIS = (
    "format", "name", "axis", "window_s", "matters", "without", "effort", "position", "load_position", "numbers",
    "kind",
)  # fmt: skip
_SPREAD = ("mass", "damping", "armature", "frictionloss", "motor_constant")
_MOTOR = ("resistance", "torque_constant", "back_emf", "gear", "voltage", *LAW)


def read_model(path: Path) -> Model | Mechanism | Unit:
    """The model that a file describes, its Python file, MuJoCo model or FMU loaded from the same folder.

    Refuses unknown and missing keys, names that do not fit together, a file outside the folder, Python that does not
    run or lacks the function, a MuJoCo model that does not compile, and a file that is no FMU.
    """
    words = read_words(path, FORMAT)
    if "mujoco" in words.table:
        return _mechanism(path, words)
    if "fmu" in words.table:
        return _unit(path, words)
    if "axis" in words.table:
        return _axis(path, words)
    words.only(*_KEYS)
    words.need("file", "function", "states", "parameter", "input", "output")
    with said_in(path.name):
        return Model(
            name=words.text("name", path.stem),
            motion=_function(path.parent, words.text("file"), words.text("function")),
            states=words.list_of_texts("states"),
            parameters=tuple(_parameter(w) for w in words.tables("parameter")),
            inputs=tuple(_input(w) for w in words.tables("input")),
            outputs=tuple(_output(w) for w in words.tables("output")),
            ports=tuple(_port(w) for w in words.tables("port")),
            window_s=words.positive("window_s") if "window_s" in words.table else None,
            matters=words.positive("matters", MATTERS),
            without=words.list_of_texts("without"),
            kinds=tuple(_kind(path.parent, w) for w in words.tables("kind")),
        )


def _axis(path: Path, words: ConfigTable) -> Model:
    words.only(*_AXIS)
    words.need("effort", "position", "numbers")
    rotary = words.one_of("axis", ("rotary", "linear")) == "rotary"
    with said_in(path.name):
        made = axis(
            {name: _with_tolerance(words.inner("numbers"), name) for name in words.inner("numbers").table},
            _column(words.inner("effort"), "drive"),
            _sensor(words.inner("position"), "encoder", "position"),
            _sensor(words.inner("load_position"), "load_encoder", "load_position")
            if "load_position" in words.table
            else None,
            rotary=rotary,
            window_s=words.positive("window_s") if "window_s" in words.table else None,
            name=words.text("name", path.stem),
        )
        return replace(
            made, matters=words.positive("matters", MATTERS), without=words.list_of_texts("without"),
            kinds=tuple(_kind(path.parent, w) for w in words.tables("kind")),
        )  # fmt: skip


def _with_tolerance(numbers: ConfigTable, name: str) -> float | tuple[float, float]:
    """A number as it stands, or the value and the tolerance of a table."""
    if not isinstance(numbers.table[name], dict):
        return numbers.number(name)
    w = numbers.inner(name)
    w.only("value", "tolerance")
    return (w.number("value"), w.number("tolerance")) if "tolerance" in w.table else w.number("value")


def _column(w: ConfigTable, name: str) -> Input:
    w.only("column", "factor", "tolerance")
    return Input(name, w.text("column"), _factor(w), w.number("tolerance", 0.0))


def _sensor(w: ConfigTable, name: str, state: str) -> Output:
    w.only("column", "factor", "offset", "leaves")
    return Output(name, state, w.text("column"), _factor(w), offset=w.number("offset", 0.0), leaves=_leaves(w))


def _mechanism(path: Path, words: ConfigTable) -> Mechanism:
    words.only(*_MUJOCO)
    words.need("sensors", "actuators")
    spread = words.inner("spread")
    spread.only(*_SPREAD)
    actuators = words.inner("actuators")
    with said_in(path.name):
        return Mechanism(
            name=words.text("name", path.stem),
            spec=_specification(path.parent, words.text("mujoco")),
            spread={kind: spread.numbers(kind) for kind in spread.table},
            actuators={n: (w.text("column"), _factor(w)) for n, w in _each(actuators, *_MOTOR)},
            sensors={
                n: (w.text("column"), _factor(w), w.number("offset", 0.0), _leaves(w))
                for n, w in _each(words.inner("sensors"), "offset", "leaves")
            },
            window_s=words.positive("window_s") if "window_s" in words.table else None,
            matters=words.positive("matters", MATTERS),
            without=words.list_of_texts("without"),
            kinds=tuple(_kind(path.parent, w) for w in words.tables("kind")),
            motors={n: m for n in actuators.table if (m := _motor(actuators.inner(n)))},
        )


def _motor(w: ConfigTable) -> dict[str, float]:
    """Numbers of a DC motor, none where an actuator has a column alone."""
    given = [key for key in _MOTOR if key in w.table]
    if given:
        w.need("resistance", "torque_constant")
    return {key: w.number(key) if key in LAW else w.positive(key) for key in given}


def _unit(path: Path, words: ConfigTable) -> Unit:
    words.only(*_FMU)
    words.need("parameter", "input", "output")
    folder, description = _unpacked(path.parent, words.text("fmu"))
    starts = {v.name: _number(v.start) for v in description.modelVariables}
    with said_in(path.name):
        return Unit(
            name=words.text("name", path.stem),
            folder=folder,
            description=description,
            parameters=tuple(_parameter(w, starts.get(w.text("name"))) for w in words.tables("parameter")),
            inputs=tuple(_input(w) for w in words.tables("input")),
            outputs=tuple(_output(w) for w in words.tables("output")),
            ports=tuple(_port(w) for w in words.tables("port")),
            window_s=words.positive("window_s") if "window_s" in words.table else None,
            matters=words.positive("matters", MATTERS),
            without=words.list_of_texts("without"),
            kinds=tuple(_kind(path.parent, w) for w in words.tables("kind")),
        )


def _number(start: str | None) -> float | None:
    """A start value as a number; None where the FMU states none."""
    try:
        return None if start is None else float(start)
    except ValueError:
        return None


def _named(folder: Path, file: str, kind: str) -> Path:
    """A file that model.toml names; refuses one outside its folder, and one that cannot be read."""
    path = inside(folder, file, kind)
    with reading(path, kind):
        path.read_bytes()
    return path


def _unpacked(folder: Path, file: str) -> tuple[str, Any]:
    """The FMU unpacked into a folder that is removed at the end, or after a kill by the next; and its description."""
    path = _named(folder, file, "the FMU")
    try:
        import fmpy
    except ImportError:
        raise WrongUseError(
            "an FMU needs the package FMPy", "it is not installed", "pip install loopshape[fmu]"
        ) from None
    try:
        check_zip(path)
        description = fmpy.read_model_description(str(path))
        clear(Path(tempfile.gettempdir()))
        target = str(part_of(Path(tempfile.gettempdir()) / "loopshape-fmu"))
        os.mkdir(target, mode=0o700)
        atexit.register(shutil.rmtree, target, ignore_errors=True)
        fmpy.extract(str(path), target)
    except Exception as error:  # FMPy raises plain exceptions
        raise UnreadableInputError(f"{file} is no FMU", short(str(error)), "export it anew") from error
    return target, description


def _each(w: ConfigTable, *also: str) -> Iterator[tuple[str, ConfigTable]]:
    """Name and table of each column, its factor and what else it may have."""
    for name in w.table:
        own = w.inner(name)
        own.only("column", "factor", *also)
        yield name, own


def _specification(folder: Path, file: str) -> Any:
    """The MuJoCo model, or the URDF, as an `MjSpec` that compiles; nothing touches in a URDF."""
    path = _named(folder, file, "the MuJoCo model")
    try:
        import mujoco
    except ImportError:
        raise WrongUseError(
            "a MuJoCo model needs the package mujoco", "it is not installed", "pip install loopshape[mujoco]"
        ) from None
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
        for geom in spec.geoms if path.suffix.lower() == ".urdf" else ():
            geom.contype = geom.conaffinity = 0
    except ValueError as error:
        raise UnreadableInputError(f"{file} does not compile in MuJoCo", short(str(error))) from error
    return spec


def _function(folder: Path, file: str, name: str) -> Callable[..., Any]:
    """The function of this name in a Python file of the folder; the file is run."""
    path = _named(folder, file, "the Python file of a model")
    try:
        found = runpy.run_path(str(path)).get(name)
    except (Exception, SystemExit) as error:  # a user's code may raise anything, and end the command
        raise UnreadableInputError(
            f"{file} does not run", f"{type(error).__name__}: {error}", f"run it with python {file}"
        ) from error
    if not callable(found):
        raise WrongUseError(f"{file} has no function {name}", repr(found), "write it, or correct the key function")
    return found


def _parameter(w: ConfigTable, start: float | None = None) -> ModelParameter:
    """A parameter; where the simulator states a start value, that is its nominal one."""
    return read(ModelParameter, ({} if start is None else {"value": start}) | dict(w.table), w.where)


def _kind(folder: Path, w: ConfigTable) -> Kind:
    """A kind of effect of the user's own; its Python file is run."""
    w.only("name", "port", "file", "function", "number")
    numbers = tuple(_parameter(n, 0.0 if "range" in n.table else None) for n in w.tables("number"))
    return Kind(w.text("name"), w.text("port"), _function(folder, w.text("file"), w.text("function")), numbers)


def _factor(w: ConfigTable) -> float:
    """The unit's and the sign's factor; 0 is refused."""
    value = w.number("factor", 1.0)
    if value == 0.0:
        raise WrongUseError(
            f"{w.where}: a factor is not 0", "0", "negative turns the sign, 0.01745329 makes deg to rad"
        )
    return value


def _input(w: ConfigTable) -> Input:
    _factor(w)
    return read(Input, {"unit": "1", **w.table}, w.where)


def _output(w: ConfigTable) -> Output:
    _factor(w)
    return read(Output, {"unit": "1", **w.table}, w.where)


def _leaves(w: ConfigTable) -> float | None:
    """Rms that a good model leaves of an output, None where that is not stated."""
    return w.positive("leaves") if "leaves" in w.table else None


def _port(w: ConfigTable) -> Port:
    return read(Port, {"unit": "1", **w.table}, w.where)
