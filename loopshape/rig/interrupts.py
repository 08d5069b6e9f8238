"""How long work is ended: by Ctrl-C, a request to terminate or a closed terminal, all in one way."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def interrupts() -> Iterator[None]:
    """Ctrl-C, a request to terminate and a closed terminal raise `KeyboardInterrupt`, once: no second disturbs the end.

    Also where a shell that started this in the background lets it ignore Ctrl-C's signal. A closed terminal is ignored
    where it was to be (`nohup`). Signals reach the main thread alone: in another nothing changes.
    """
    if current_thread() is not main_thread():
        yield
        return
    told = False

    def interrupt(number: int, frame: object) -> None:
        nonlocal told
        if not told:
            told = True
            raise KeyboardInterrupt

    which = [signal.SIGINT, signal.SIGTERM]
    which += [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN else []
    before = [signal.signal(one, interrupt) for one in which]
    try:
        yield
    finally:
        for one, handler in zip(which, before, strict=True):
            signal.signal(one, handler)
