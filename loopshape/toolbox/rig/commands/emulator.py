"""`loopshape emulator`: a real-time target without a machine, for trying out a measurement before the real one."""

from __future__ import annotations

from typing import Annotated

import typer

from loopshape.core.interrupts import interrupts, until_interrupted


def emulator(
    tcp: Annotated[int | None, typer.Option(help="Port of 127.0.0.1 (0: any) instead of a pseudo-terminal.")] = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="One second a second, not as fast as it can.")] = False,
    number_bytes: Annotated[int, typer.Option(help="Bytes of a number in transmission: 4 or 8.")] = 8,
    rate_hz: Annotated[float | None, typer.Option(help="Ticks a second (default 1000; of a board 2000).")] = None,
    change: Annotated[list[str] | None, typer.Option(help="A parameter of the arm, as payload_kg=0.2; again.")] = None,
    at: Annotated[
        list[str] | None, typer.Option(help="Where it stands before it is armed, as p_ab_bar=1.2; again.")
    ] = None,
    drop: Annotated[float, typer.Option(help="Probability that a frame is lost, each way.")] = 0.0,
    corrupt: Annotated[float, typer.Option(help="Probability that a frame is corrupted, each way.")] = 0.0,
    duplicate: Annotated[float, typer.Option(help="Probability that a frame comes twice, each way.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the transmission errors.")] = 0,
    board: Annotated[
        str | None, typer.Option(help="cortex_m: the firmware of a Cortex-M4F, a motor axis in it.")
    ] = None,
) -> None:
    """Emulate a target that drives a simulated arm.

    Prints the port for `loopshape measure --port`; runs until Ctrl-C.
    """
    from loopshape.toolbox.rig import cortex_m
    from loopshape.toolbox.rig.emulator import Emulator, running
    from loopshape.toolbox.rig.emulator import board as board_of

    if board is not None:
        arm = {"change": change, "at": at, "drop": drop, "corrupt": corrupt, "duplicate": duplicate, "seed": seed}
        started = cortex_m.chosen(board, tcp or 0, rate_hz, arm | {"number_bytes": number_bytes != 8})
    else:
        changes = _numbers(change or [], "a change is a parameter and its value", "payload_kg=0.2")
        point = _numbers(at or [], "a point is a coordinate and its value", "p_ab_bar=1.2")
        plant = board_of().plant_file(changes, point, rate_hz or 1000.0)
        started = running(Emulator(plant, tcp, real_time, number_bytes, drop, corrupt, duplicate, seed))
    with until_interrupted(), interrupts(), started as (process, port):
        print(port, flush=True)
        process.wait()


def _numbers(words: list[str], what: str, example: str) -> dict[str, float]:
    from loopshape.core.errors import WrongUseError

    out = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            out[name] = float(value)
        except ValueError:
            raise WrongUseError(what, repr(word), example) from None
    return out
