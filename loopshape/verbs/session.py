"""The session around a command: how it is interrupted and how it ends, which commands there are, what it answers.

Nothing of weight is loaded with it: here the program begins.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from loopshape.core.interrupts import ENDED, ended_soon, interrupted, say_once

if TYPE_CHECKING:
    from loopshape.core.toolboxes import Command

INTERRUPTED = "interrupted; finished files are kept, nothing is half written; the same command begins anew or goes on"


def guarded(program: Callable[[], None]) -> None:
    """The program: an interrupt ends it in one sentence also while its commands are loaded, or what it made is told.

    Before these lines Python itself begins, and ends by the signal. Once the command is done, no Ctrl-C turns Python's
    own end into another one.
    """
    try:
        with ended_soon(INTERRUPTED, _clean):
            try:
                program()
            finally:
                signal.signal(signal.SIGINT, signal.SIG_IGN)
    except BaseException:
        if not interrupted():
            raise
        say_once(INTERRUPTED)
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        os._exit(ENDED)  # threads may be in compiled code still: Python's own end beside them was seen to abort


def _clean() -> None:
    """Remove what is half written, where anything was written yet."""
    remove = getattr(sys.modules.get("loopshape.io.files"), "remove_own_parts", None)
    if remove is not None:
        remove()


def session(command: Callable[[], object], complain: Callable[[object], None]) -> None:
    """A command to its end: what the user can put right becomes a sentence to complain of and exit code 2.

    So does the end of a command whose files another process changed after they were read.
    """
    from loopshape.core.errors import LoopshapeError
    from loopshape.io.files import remove_own_parts
    from loopshape.io.input_guard import noting, refuse_changed

    try:
        with noting(), ended_soon(INTERRUPTED, remove_own_parts):
            try:
                command()
            except SystemExit as ended:
                if ended.code in (None, 0, 1):
                    refuse_changed()
                raise
    except LoopshapeError as error:
        complain(error)
        raise SystemExit(2) from None
    except OSError as error:  # a disk or a file that the system refuses
        complain(f"the system refuses; received {error}; check the file, its rights and the disk.")
        raise SystemExit(2) from None


def ended_by(stopped: BaseException | None) -> int | None:
    """Exit code of a command that was interrupted, told once, whatever a library made of the exception; else None."""
    by_keyboard = isinstance(stopped, KeyboardInterrupt)
    if not (by_keyboard or interrupted()):
        return None
    say_once((str(stopped) if by_keyboard else "") or INTERRUPTED)
    return ENDED


def commands(
    package: str,
    own: Iterable[tuple[str, str, str, float]],
    headings: Iterable[str],
    add: Callable[[Command, Any], None],
) -> tuple[dict[str, list[Command]], list[str]]:
    """Commands of the bench and of toolboxes by heading, each added with its function, and what could not be loaded.

    Its `own` are rows (heading, module in the package, example, rank); the example begins with the command's name.
    """
    from loopshape.core.toolboxes import Command, found, function_at

    broken = list(found().broken)
    by_heading: dict[str, list[Command]] = {heading: [] for heading in headings}
    rows = [(heading, example.split()[0], module, example, rank) for heading, module, example, rank in own]
    all_of_them = [Command(h, name, f"{package}.{at}:{name}", f"loopshape {x}", rank) for h, name, at, x, rank in rows]
    all_of_them += [c for box in found().toolboxes.values() for c in box.commands]
    for one in sorted(all_of_them, key=lambda c: c.rank):
        try:
            if any(other.name == one.name for names in by_heading.values() for other in names):
                raise ValueError("there is a command of this name")
            add(one, function_at(one.at))
        except Exception as error:  # of a package that is not ours
            broken.append(f"the command {one.name} was left out: {type(error).__name__}: {error}")
        else:
            by_heading.setdefault(one.heading, []).append(one)
    return by_heading, broken


def answer(payload: Mapping[str, Any]) -> dict[str, Any]:
    """What a command answers in words that JSON knows; what is not known is null, never nan."""
    from loopshape.core.json_ready import json_ready

    made: dict[str, Any] = json_ready(payload, unknown=None)
    return made


def folded(words: str) -> list[str]:
    """Sentences folded at 80 columns, each line of `words` a paragraph; what follows its first row is indented."""
    from loopshape.data.result.verdict_words import folded as fold

    return [fold(line) for line in words.splitlines()]
