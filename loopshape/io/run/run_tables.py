"""`[[loop]]`, `[[recording]]` and `outputs` of a run folder's TOML, to nouns and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from itertools import product
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Block, Controller
from loopshape.data.control.gain_scheduled import LAG_S, Follows, GainScheduled, Variable
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import INJECTIONS, KINDS, ROLES, ExperimentSettings, LoopSetup, shared_unit
from loopshape.data.signal.recording import RecordingInfo
from loopshape.io.config_table import ConfigTable, refuse_doubles, said_in
from loopshape.io.files import plain_name
from loopshape.io.run.tables import check_ending

#: keys of a controller's table, beside the name of its loop
CONTROLLER_KEYS = ("discretisation", "prewarp_hz", "computation_delay_s", "added_hold", "precision", "controller")
#: keys of a schedule's table in place of `controller`
SCHEDULE_KEYS = ("over", "lag_s", "nodes")
LOOP_KEYS = ("name", "reference", "injected", "control", "output", *CONTROLLER_KEYS, *SCHEDULE_KEYS, "decoupling")


@dataclass(frozen=True)
class Key:
    """A key of `[[recording]]` and field of `RecordingInfo`: how it is read, and how the field's value is written.

    A value written as None is left out of the file.
    """

    name: str
    read: Callable[[ConfigTable], Any]
    write: Callable[[Any], Any] = lambda value: value


def _closed_loop(words: ConfigTable) -> bool:
    injection = words.one_of("injection", INJECTIONS)
    closed_loop = words.truth("closed_loop", injection != "control")
    if closed_loop == (injection == "control"):
        raise WrongUseError(
            f'{words.where}: closed_loop = false goes with injection = "control", and with no other',
            f"closed_loop = {str(closed_loop).lower()} and injection = {injection!r}",
            "say what was done",
        )
    return closed_loop


def _from_zero(words: ConfigTable) -> float | None:
    from_s = words.maybe_number("periodic_from_s")
    if from_s is not None and from_s < 0.0:
        raise WrongUseError(f"{words.where}: periodic_from_s must not be negative", f"{from_s:g}")
    return from_s


def _filled(values: Mapping[str, float]) -> dict[str, float] | None:
    return dict(values) or None


#: what `run.toml` says of a recording beside its file, in the order in which it is written
INFO = (
    Key("role", lambda words: words.one_of("role", ROLES, "estimation")),
    Key("kind", lambda words: words.one_of("kind", KINDS)),
    Key("excites", lambda words: words.maybe_text("excites")),
    Key("excites_also", lambda words: words.list_of_texts("excites_also"), lambda loops: list(loops) or None),
    Key("injection", lambda words: words.one_of("injection", INJECTIONS)),
    Key("closed_loop", _closed_loop),
    Key("operating_point", lambda words: words.numbers("operating_point"), _filled),
    Key("period_s", lambda words: words.positive("period_s") if "period_s" in words.table else None),
    Key("periodic_from_s", _from_zero),
    Key("parameters", lambda words: words.numbers("parameters"), _filled),
    Key("ended_early", lambda words: words.maybe_text("ended_early")),
)
INFO_KEYS = tuple(key.name for key in INFO)
#: what a study's experiment says in the same words
TOLD = tuple(key for key in INFO if key.name in (f.name for f in fields(ExperimentSettings)))


def read_blocks(words: ConfigTable) -> tuple[Block, ...]:
    """Blocks of the key `controller`; refuses an empty list."""
    words.need("controller")
    blocks = []
    for table in words.tables("controller"):
        table.text("kind")
        with said_in(table.where):
            blocks.append(Block.from_table(table.table))
    if not blocks:
        raise WrongUseError(f"{words.where}: a controller has no block", "an empty list", "give at least a gain")
    return tuple(blocks)


def read_controller(words: ConfigTable, rate_hz: float) -> Controller:
    """Controller of a table with `name`, `controller`, and what else of `CONTROLLER_KEYS` is not at its default."""
    with said_in(words.where):
        return Controller(
            words.text("name"),
            read_blocks(words),
            rate_hz,
            words.text("discretisation", "tustin"),
            prewarp_hz=words.maybe_number("prewarp_hz"),
            computation_delay_s=words.number("computation_delay_s", 0.0),
            added_hold=words.truth("added_hold", False),
            precision=words.text("precision", "double"),
        )


def controller_table(controller: Controller) -> dict[str, Any]:
    """The keys of a controller, as `read_controller` reads them; those at their default are left out."""
    own = {
        "prewarp_hz": controller.prewarp_hz,
        "computation_delay_s": controller.computation_delay_s or None,
        "added_hold": controller.added_hold or None,
        "precision": None if controller.precision == "double" else controller.precision,
    }
    return {
        "discretisation": controller.discretisation,
        **{key: value for key, value in own.items() if value is not None},
        "controller": [block.to_table() for block in controller.blocks],
    }


def read_schedule(words: ConfigTable, rate_hz: float) -> GainScheduled:
    """The schedule of a table with `over` and `nodes`: a controller in each node of a grid, in any order."""
    words.need("over", "nodes")
    variables = tuple(_variable(table) for table in words.tables("over"))
    shared = {key: words.table[key] for key in CONTROLLER_KEYS[:-1] if key in words.table}
    placed = {}
    for node in words.tables("nodes"):
        node.only("at", "controller")
        one = ConfigTable(
            {"name": words.text("name"), "controller": node.table.get("controller"), **shared}, node.where
        )
        placed[tuple(node.list_of_numbers("at"))] = read_controller(one, rate_hz)
    with said_in(words.where):
        wanted = list(product(*(v.knots for v in variables)))
        if set(placed) != set(wanted):
            odd = sorted(set(placed) ^ set(wanted))[0]
            raise WrongUseError(
                "the nodes of a schedule are all that its knots make, and no other",
                f"{'none' if odd in wanted else 'one'} at {', '.join(f'{x:g}' for x in odd)}",
                "write one controller for each",
            )
        return GainScheduled(
            words.text("name"), variables, tuple(placed[x] for x in wanted), words.number("lag_s", LAG_S)
        )


def _variable(words: ConfigTable) -> Variable:
    words.only("name", "loop", "follows", "knots")
    words.need("name", "loop", "knots")
    with said_in(words.where):
        follows = Follows(words.one_of("follows", tuple(Follows), Follows.REFERENCE))
        return Variable(words.text("name"), tuple(words.list_of_numbers("knots")), words.text("loop"), follows)


def schedule_table(schedule: GainScheduled) -> dict[str, Any]:
    """The keys of a schedule, as `read_schedule` reads them."""
    shared = controller_table(schedule.controllers[0])
    del shared["controller"]
    nodes = zip(schedule.nodes, schedule.controllers, strict=True)
    return shared | {
        "lag_s": schedule.lag_s,
        "over": [
            {"name": v.name, "loop": v.loop, "follows": v.follows.value, "knots": list(v.knots)}
            for v in schedule.variables
        ],
        "nodes": [
            {"at": list(at.values()), "controller": [block.to_table() for block in one.blocks]} for at, one in nodes
        ],
    }


def read_decoupling(words: ConfigTable) -> dict[str, float]:
    """Weights, by loop, of the key `decoupling`; empty where it is missing."""
    return words.numbers("decoupling")


def _read_recorded(words: ConfigTable, rate_hz: float) -> Controller | None:
    """The controller of a run's loop, None without one."""
    if "controller" in words.table:
        return _recorded(read_controller(words, rate_hz))
    if lone := [key for key in CONTROLLER_KEYS[1:] if key in words.table]:
        raise WrongUseError(f"{lone[0]} goes with a controller", "no controller", "write its blocks")
    return None


def _recorded(controller: Controller) -> Controller:
    """The controller itself; refuses a delay or a hold beside a plant whose recording contains both."""
    if controller.computation_delay_s or controller.added_hold:
        raise WrongUseError(
            "a recording from the logged z on contains the hold and the delay of its controller",
            f"computation_delay_s = {controller.computation_delay_s:g}, added_hold = {controller.added_hold}".lower(),
            "leave them out of a run; in a controller file they add what its plant's FRF does not contain",
        )
    return controller


def read_loop(words: ConfigTable, rate_hz: float) -> LoopSetup:
    """One `[[loop]]`; the controller and its keys, `reference` and `injected` may be missing.

    Refuses `computation_delay_s` and `added_hold`: the recorded plant contains both.
    """
    words.only(*LOOP_KEYS)
    words.need("name", "control", "output")
    with said_in(words.where):
        loop = LoopSetup(
            name=plain_name(words.text("name"), "the name of a loop"),
            reference=words.maybe_text("reference"),
            injected=words.maybe_text("injected"),
            control=words.text("control"),
            output=words.text("output"),
            controller=None if "nodes" in words.table else _read_recorded(words, rate_hz),
            schedule=read_schedule(words, rate_hz) if "nodes" in words.table else None,
            decoupling=read_decoupling(words),
        )
        _ = loop.output_unit  # refuses a sum of different units
    return loop


def read_loops(words: ConfigTable, rate_hz: float) -> tuple[LoopSetup, ...]:
    """All `[[loop]]` of a file; refuses two of one name."""
    loops = tuple(read_loop(table, rate_hz) for table in words.tables("loop"))
    refuse_doubles((loop.name for loop in loops), words.where, "loops")
    return loops


def read_outputs(words: ConfigTable) -> tuple[str, ...]:
    """The key `outputs`, empty where it is missing; each a column or a sum of columns of one known unit, once."""
    outputs = words.list_of_texts("outputs")
    with said_in(words.where):
        for output in outputs:
            _ = shared_unit(output, "one of outputs")
    refuse_doubles((" + ".join(sum_terms(output)) for output in outputs), words.where, "outputs")
    return outputs


def loop_table(loop: LoopSetup) -> dict[str, Any]:
    """The `[[loop]]` that `read_loop` reads."""
    table: dict[str, Any] = {
        "name": loop.name,
        "reference": loop.reference,
        "injected": loop.injected,
        "control": loop.control,
        "output": loop.output,
    }
    if loop.decoupling:
        table["decoupling"] = dict(loop.decoupling)
    if loop.schedule is not None:
        return table | schedule_table(loop.schedule)
    if loop.controller is None:
        return table
    with said_in(f"loop {loop.name!r}"):
        return table | controller_table(_recorded(loop.controller))


def read_info(words: ConfigTable, file: str, loops: tuple[LoopSetup, ...]) -> RecordingInfo:
    """What is stated of a recording beside its file; refuses unknown words, excited loops that are none or doubled."""
    words.need("kind", "injection")
    _check_excited(words, [loop.name for loop in loops])
    return RecordingInfo(file, **{key.name: key.read(words) for key in INFO})


def _check_excited(words: ConfigTable, names: list[str]) -> None:
    """Refuse an `excites_also` without `excites`, unknown loops in both, and a loop named twice."""
    excites, also = words.maybe_text("excites"), words.list_of_texts("excites_also")
    if also and excites is None:
        raise WrongUseError(
            f"{words.where}: excites_also goes with excites",
            f"{', '.join(also)} alone",
            "name the first excited loop in excites and the others in excites_also",
        )
    given = {"excites": () if excites is None else (excites,), "excites_also": also}
    for key, loops in given.items():
        if unknown := [loop for loop in loops if loop not in names]:
            raise WrongUseError(
                f"{words.where}: {key} names no loop", repr(unknown[0]), f"its loops are {', '.join(names) or 'none'}"
            )
    excited = (excites, *also)
    if len(set(excited)) < len(excited):
        raise WrongUseError(
            f"{words.where}: an excited loop is named twice",
            ", ".join(str(loop) for loop in excited),
            "excites names the first loop, excites_also the others, each once",
        )


def read_recording(words: ConfigTable, loops: tuple[LoopSetup, ...]) -> RecordingInfo:
    """One `[[recording]]` of a run folder; its file is a plain name with a table's ending."""
    words.only("file", "sha256", *INFO_KEYS)
    words.need("file", "kind", "injection")
    with said_in(words.where):
        file = check_ending(plain_name(words.table["file"], "the file of a recording"))
    return read_info(words, file, loops)


def recording_table(info: RecordingInfo) -> dict[str, Any]:
    """The `[[recording]]` that `read_recording` reads; None is left out by the writer."""
    return {"file": info.file} | {key.name: key.write(getattr(info, key.name)) for key in INFO}
