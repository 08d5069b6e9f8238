"""How long work is ended: by Ctrl-C, a request to terminate or a closed terminal, all in one way, and soon."""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Thread, current_thread, main_thread
from time import monotonic, sleep

ENDED = 130  # exit code of a program that was interrupted
SOON_S = 1.2  # from an interrupt on: compiled code and libraries hear none, and are not waited for longer


class _Heard:
    """What was heard since the program began: whether an exception told of it, and what must not be cut short."""

    guarded = raised = reported = expected = False
    at_s: float | None = None
    whole = 0
    """How many blocks are at work that end by themselves."""


@contextmanager
def interrupts() -> Iterator[None]:
    """Ctrl-C, a request to terminate and a closed terminal raise `KeyboardInterrupt`, once: no second disturbs the end.

    Also where a shell that started this in the background lets it ignore Ctrl-C's signal. A closed terminal is ignored
    where it was to be (`nohup`). Signals reach the main thread alone: in another nothing changes.
    """
    if current_thread() is not main_thread():
        yield
        return
    reported_once = False

    def interrupt(number: int, frame: object) -> None:
        nonlocal reported_once
        _Heard.raised = True
        if not reported_once:
            reported_once = True
            raise KeyboardInterrupt

    which = [signal.SIGINT, signal.SIGTERM]
    which += [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN else []
    before = [signal.signal(one, interrupt) for one in which]
    try:
        yield
    finally:
        for one, handler in zip(which, before, strict=True):
            signal.signal(one, handler)


@contextmanager
def unhurried() -> Iterator[None]:
    """What is done here ends by itself after an interrupt and is not cut short: a machine is vented first."""
    _Heard.whole += 1
    try:
        yield
    finally:
        _Heard.whole -= 1


@contextmanager
def undivided() -> Iterator[None]:
    """A few steps on the disk that belong together: an interrupt waits until they are done."""
    with unhurried():
        if current_thread() is not main_thread() or (before := signal.getsignal(signal.SIGINT)) is None:
            yield
            return
        seen: list[int] = []
        signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
            if seen:
                signal.raise_signal(signal.SIGINT)


def interrupted() -> bool:
    """Whether Ctrl-C was pressed in a program that `ended_soon` guards, whatever became of the exception."""
    return _Heard.at_s is not None and not _Heard.expected


@contextmanager
def until_interrupted() -> Iterator[None]:
    """What runs until Ctrl-C, which is its right end and no interruption."""
    _Heard.expected = True
    with suppress(KeyboardInterrupt), unhurried():
        yield


@contextmanager
def ended_soon(sentence: str, clean: Callable[[], None]) -> Iterator[None]:
    """A program that Ctrl-C ends within `SOON_S`, also while compiled code or a library hears no exception.

    Ctrl-C raises `KeyboardInterrupt` once. Where the program still runs after that time it is ended from a thread: with
    `sentence` on standard error, after `clean`, with exit code `ENDED`; what is `unhurried` is waited for. In any other
    thread than the main one nothing changes, nor where Ctrl-C is ignored.
    """
    if current_thread() is not main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    _Heard.guarded, _Heard.raised, _Heard.reported, _Heard.expected, _Heard.at_s = True, False, False, False, None
    here, there = socket.socketpair()
    there.setblocking(False)
    Thread(target=_end_late, args=(here, sentence, clean), daemon=True).start()
    before = signal.signal(signal.SIGINT, _raise_once)
    fd, hook = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False), sys.unraisablehook

    def lost(found: sys.UnraisableHookArgs) -> None:
        """An interrupt raised where Python raises nothing, in a callback, is not told: the thread ends the program."""
        if not (interrupted() and isinstance(found.exc_value, KeyboardInterrupt)):
            hook(found)

    sys.unraisablehook = lost
    try:
        yield
    finally:
        if not interrupted():  # else the thread watches over the program's end, too
            sys.unraisablehook = hook
            signal.set_wakeup_fd(fd)
            if signal.getsignal(signal.SIGINT) is _raise_once:  # else whoever changed it meant it
                signal.signal(signal.SIGINT, before)
            there.close()


def _raise_once(number: int, frame: object) -> None:
    _Heard.at_s = _Heard.at_s or monotonic()
    if not _Heard.raised:
        _Heard.raised = True
        raise KeyboardInterrupt


def _end_late(here: socket.socket, sentence: str, clean: Callable[[], None]) -> None:
    """End the program some time after the first signal that it hears; the system writes each into the socket."""
    if not here.recv(1):
        here.close()
        return
    _Heard.at_s = _Heard.at_s or monotonic()
    while monotonic() < _Heard.at_s + SOON_S or _Heard.whole:
        sleep(0.02)
    if _Heard.expected:
        return
    clean()
    say_once(sentence)
    os._exit(ENDED)


def say_once(sentence: str) -> None:
    """One sentence on standard error, by whoever is first to say it."""
    if not _Heard.reported:
        _Heard.reported = _Heard.guarded
        print(f"loopshape: {sentence}", file=sys.stderr, flush=True)
