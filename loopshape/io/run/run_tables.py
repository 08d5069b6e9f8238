"""`[[loop]]`, `[[recording]]` and `outputs` of a run folder's TOML, to nouns and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from loopshape.core.errors import WrongUseError
from loopshape.core.toolboxes import needed
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import LoopSetup, shared_unit
from loopshape.data.signal.recording import RecordingInfo
from loopshape.io.config_table import ConfigTable, refuse_doubles, said_in
from loopshape.io.files import plain_name
from loopshape.io.run.tables import check_ending
from loopshape.io.schema import keys, read, table_of

#: keys of a controller's table, beside the name of its loop
CONTROLLER_KEYS = tuple(key for key in keys(Controller) if key != "name")


class Schedule:
    """A controller's table with `nodes`, which a toolbox reads."""

    MARK: ClassVar = "nodes"

    @staticmethod
    def read_by() -> type:
        """What reads it; refuses it where no toolbox does."""
        kind: type = needed("controllers", Schedule.MARK, "reads a schedule", "nodes")
        return kind


#: keys of a schedule's table, beside those of a controller
SCHEDULE_KEYS = ("over", "nodes", "lag_s")


@dataclass(frozen=True, kw_only=True)
class LoopTable:
    """One `[[loop]]`; its controller or schedule, `reference` and `injected` may be missing."""

    name: str
    reference: str | None = None
    injected: str | None = None
    control: str
    output: str
    decoupling: Mapping[str, float] = field(default_factory=dict)
    controller: Controller | Schedule | None = None
    ALSO_READ: ClassVar = (*CONTROLLER_KEYS, *SCHEDULE_KEYS)

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table with its controller or schedule as one of its own."""
        own = dict(table)
        moved = {key: own.pop(key) for key in (*cls.ALSO_READ, "rate_hz") if key in own}
        if "controller" in moved or "nodes" in moved:
            own["controller"] = moved | {"name": own.get("name")}
        elif lone := [key for key in moved if key not in ("discretisation", "rate_hz")]:
            raise WrongUseError(f"{lone[0]} goes with a controller", "no controller", "write its blocks")
        return own

    def made(self) -> LoopSetup:
        """The loop; refuses `computation_delay_s` and `added_hold`, which the recorded plant contains."""
        plain_name(self.name, "the name of a loop")
        one: Any = self.controller
        schedule = one if isinstance(one, Scheduled) else None
        own = None if one is None or schedule else _recorded(one)
        loop = LoopSetup(**{**vars(self), "controller": own, "schedule": schedule})
        _ = loop.output_unit  # refuses a sum of different units
        return loop


def controller_table(controller: Controller) -> dict[str, Any]:
    """The keys of a controller beside the name of its loop and its rate, blocks last; defaults are left out."""
    own = table_of(controller)
    blocks = own.pop("controller")
    return {key: own[key] for key in CONTROLLER_KEYS if key in own} | {"controller": blocks}


def _recorded(controller: Controller) -> Controller:
    """The controller itself; refuses a delay or a hold beside a plant whose recording contains both."""
    if controller.computation_delay_s or controller.added_hold:
        raise WrongUseError(
            "a recording from the logged z on contains the hold and the delay of its controller",
            f"computation_delay_s = {controller.computation_delay_s:g}, added_hold = {controller.added_hold}".lower(),
            "leave them out of a run; in a controller file they add what its plant's FRF does not contain",
        )
    return controller


def read_loops(words: ConfigTable, rate_hz: float) -> tuple[LoopSetup, ...]:
    """All `[[loop]]` of a file; refuses two of one name."""
    made: Any = [read(LoopTable, table.table, table.where, rate_hz=rate_hz) for table in words.tables("loop")]
    refuse_doubles((loop.name for loop in made), words.where, "loops")
    return tuple(made)


def read_outputs(words: ConfigTable) -> tuple[str, ...]:
    """The key `outputs`, empty where it is missing; each a column or a sum of columns of one known unit, once."""
    outputs = words.list_of_texts("outputs")
    with said_in(words.where):
        for output in outputs:
            _ = shared_unit(output, "one of outputs")
    refuse_doubles((" + ".join(sum_terms(output)) for output in outputs), words.where, "outputs")
    return outputs


def loop_table(loop: LoopSetup) -> dict[str, Any]:
    """The `[[loop]]` that `read_loops` reads."""
    own = {key: getattr(loop, key) for key in ("name", "reference", "injected", "control", "output")}
    table: dict[str, Any] = own | ({"decoupling": dict(loop.decoupling)} if loop.decoupling else {})
    if loop.schedule is not None:
        return table | loop.schedule.to_table()
    if loop.controller is None:
        return table
    with said_in(f"loop {loop.name!r}"):
        return table | controller_table(_recorded(loop.controller))


def read_info(table: Mapping[str, Any], where: str, loops: tuple[LoopSetup, ...], **elsewhere: Any) -> RecordingInfo:
    """What is stated of a recording; refuses unknown words, excited loops that are none or doubled."""
    found = read(RecordingInfo, table, where, **elsewhere)
    _check_excited(found, [loop.name for loop in loops], where)
    return found


def _check_excited(info: RecordingInfo, names: list[str], where: str) -> None:
    """Refuse an `excites_also` without `excites`, unknown loops in both, and a loop named twice."""
    excites, also = info.excites, info.excites_also
    if also and excites is None:
        raise WrongUseError(
            f"{where}: excites_also goes with excites",
            f"{', '.join(also)} alone",
            "name the first excited loop in excites and the others in excites_also",
        )
    given = {"excites": () if excites is None else (excites,), "excites_also": also}
    for key, loops in given.items():
        if unknown := [loop for loop in loops if loop not in names]:
            raise WrongUseError(
                f"{where}: {key} names no loop", repr(unknown[0]), f"its loops are {', '.join(names) or 'none'}"
            )
    excited = (excites, *also)
    if len(set(excited)) < len(excited):
        raise WrongUseError(
            f"{where}: an excited loop is named twice",
            ", ".join(str(loop) for loop in excited),
            "excites names the first loop, excites_also the others, each once",
        )


def read_recording(words: ConfigTable, loops: tuple[LoopSetup, ...]) -> RecordingInfo:
    """One `[[recording]]` of a run folder; its file is a plain name with a table's ending."""
    words.need("file")
    with said_in(words.where):
        check_ending(plain_name(words.table["file"], "the file of a recording"))
    return read_info({k: v for k, v in words.table.items() if k != "sha256"}, words.where, loops)


def recording_table(info: RecordingInfo) -> dict[str, Any]:
    """The `[[recording]]` that `read_recording` reads."""
    return {"file": info.file} | table_of(info)
