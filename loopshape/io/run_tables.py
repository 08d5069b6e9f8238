"""`[[loop]]`, `[[recording]]` and `outputs` of a run folder's TOML, to nouns and back."""

from __future__ import annotations

from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.channel import sum_terms
from loopshape.data.controller import Block, Controller
from loopshape.data.experiment import INJECTIONS, KINDS, ROLES, LoopSetup, shared_unit
from loopshape.data.recording import RecordingInfo
from loopshape.io.files import plain_name
from loopshape.io.tables import check_ending
from loopshape.io.words import Words, refuse_doubles, said_in

#: keys of a controller's table, beside the name of its loop
CONTROLLER_KEYS = ("discretisation", "prewarp_hz", "computation_delay_s", "added_hold", "precision", "controller")
LOOP_KEYS = ("name", "reference", "injected", "control", "output", *CONTROLLER_KEYS)
INFO_KEYS = (
    "role", "kind", "excites", "excites_also", "injection", "closed_loop", "operating_point", "period_s",
    "periodic_from_s", "parameters", "ended_early",
)  # fmt: skip


def read_blocks(words: Words) -> tuple[Block, ...]:
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


def read_controller(words: Words, rate_hz: float) -> Controller:
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


def _read_recorded(words: Words, rate_hz: float) -> Controller | None:
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


def read_loop(words: Words, rate_hz: float) -> LoopSetup:
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
            controller=_read_recorded(words, rate_hz),
        )
        _ = loop.output_unit  # refuses a sum of different units
    return loop


def read_loops(words: Words, rate_hz: float) -> tuple[LoopSetup, ...]:
    """All `[[loop]]` of a file; refuses two of one name."""
    loops = tuple(read_loop(table, rate_hz) for table in words.tables("loop"))
    refuse_doubles((loop.name for loop in loops), words.where, "loops")
    return loops


def read_outputs(words: Words) -> tuple[str, ...]:
    """The key `outputs`, empty where it is missing; each a column or a sum of columns of one known unit, once."""
    outputs = words.list_of_texts("outputs")
    with said_in(words.where):
        for output in outputs:
            _ = shared_unit(output, "one of outputs")
    refuse_doubles((" + ".join(sum_terms(output)) for output in outputs), words.where, "outputs")
    return outputs


def loop_table(loop: LoopSetup) -> dict[str, Any]:
    """The `[[loop]]` that `read_loop` reads."""
    table = {
        "name": loop.name,
        "reference": loop.reference,
        "injected": loop.injected,
        "control": loop.control,
        "output": loop.output,
    }
    if loop.controller is None:
        return table
    with said_in(f"loop {loop.name!r}"):
        return table | controller_table(_recorded(loop.controller))


def read_info(words: Words, file: str, loops: tuple[LoopSetup, ...]) -> RecordingInfo:
    """What is said of a recording beside its file; refuses unknown words, excited loops that are none or doubled."""
    words.need("kind", "injection")
    excites, *excites_also = _read_excited(words, [loop.name for loop in loops])
    injection = words.one_of("injection", INJECTIONS)
    closed_loop = words.truth("closed_loop", injection != "control")
    if closed_loop == (injection == "control"):
        raise WrongUseError(
            f'{words.where}: closed_loop = false goes with injection = "control", and with no other',
            f"closed_loop = {str(closed_loop).lower()} and injection = {injection!r}",
            "say what was done",
        )
    periodic_from_s = words.maybe_number("periodic_from_s")
    if periodic_from_s is not None and periodic_from_s < 0.0:
        raise WrongUseError(f"{words.where}: periodic_from_s must not be negative", f"{periodic_from_s:g}")
    return RecordingInfo(
        file=file,
        kind=words.one_of("kind", KINDS),
        injection=injection,
        role=words.one_of("role", ROLES, "estimation"),
        excites=excites,
        excites_also=tuple(str(loop) for loop in excites_also),
        closed_loop=closed_loop,
        operating_point=words.numbers("operating_point"),
        period_s=words.positive("period_s") if "period_s" in words.table else None,
        periodic_from_s=periodic_from_s,
        parameters=words.numbers("parameters"),
        ended_early=words.maybe_text("ended_early"),
    )


def _read_excited(words: Words, names: list[str]) -> tuple[str | None, ...]:
    """The loop in `excites`, None where there is none, and those in `excites_also`."""
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
    return excited


def read_recording(words: Words, loops: tuple[LoopSetup, ...]) -> RecordingInfo:
    """One `[[recording]]` of a run folder; its file is a plain name with a table's ending."""
    words.only("file", "sha256", *INFO_KEYS)
    words.need("file", "kind", "injection")
    with said_in(words.where):
        file = check_ending(plain_name(words.table["file"], "the file of a recording"))
    return read_info(words, file, loops)


def recording_table(info: RecordingInfo) -> dict[str, Any]:
    """The `[[recording]]` that `read_recording` reads; None is left out by the writer."""
    return {
        "file": info.file,
        "role": info.role,
        "kind": info.kind,
        "excites": info.excites,
        "excites_also": list(info.excites_also) or None,
        "injection": info.injection,
        "closed_loop": info.closed_loop,
        "operating_point": dict(info.operating_point) or None,
        "period_s": info.period_s,
        "periodic_from_s": info.periodic_from_s,
        "parameters": dict(info.parameters) or None,
        "ended_early": info.ended_early,
    }
