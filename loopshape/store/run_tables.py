"""`[[loop]]`, `[[recording]]` and `outputs` of a run folder's TOML, to nouns and back."""

from __future__ import annotations

from typing import Any

from loopshape.channel import sum_terms
from loopshape.controller import Block, Controller
from loopshape.errors import WrongUseError
from loopshape.experiment import INJECTIONS, KINDS, ROLES, LoopSetup, shared_unit
from loopshape.recording import RecordingInfo
from loopshape.store.files import plain_name
from loopshape.store.tables import check_ending
from loopshape.store.words import Words, refuse_doubles, said_in

LOOP_KEYS = ("name", "reference", "injected", "control", "output", "discretisation", "controller")
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
    """Controller of a table with `name`, `discretisation` ("tustin" if missing) and `controller`."""
    with said_in(words.where):
        return Controller(words.text("name"), read_blocks(words), rate_hz, words.text("discretisation", "tustin"))


def controller_table(controller: Controller) -> dict[str, Any]:
    """The keys `discretisation` and `controller`, as `read_controller` reads them."""
    return {
        "discretisation": controller.discretisation,
        "controller": [block.to_table() for block in controller.blocks],
    }


def read_loop(words: Words, rate_hz: float) -> LoopSetup:
    """One `[[loop]]`; `controller`, `discretisation`, `reference` and `injected` may be missing."""
    words.only(*LOOP_KEYS)
    words.need("name", "control", "output")
    with said_in(words.where):
        loop = LoopSetup(
            name=plain_name(words.text("name"), "the name of a loop"),
            reference=words.maybe_text("reference"),
            injected=words.maybe_text("injected"),
            control=words.text("control"),
            output=words.text("output"),
            controller=read_controller(words, rate_hz) if "controller" in words.table else None,
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
    return table | (controller_table(loop.controller) if loop.controller else {})


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
    words.only("file", *INFO_KEYS)
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
