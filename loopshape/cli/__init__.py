"""One file a command. Here the program begins: before anything of weight is loaded, Ctrl-C is listened to."""

from __future__ import annotations

import signal
import sys

from loopshape.core.interrupts import ENDED, ended_soon, interrupted, say_once

INTERRUPTED = "interrupted; finished files are kept, nothing is half written; the same command begins anew or goes on"


def script() -> None:
    """The program: an interrupt ends it in one sentence also while its commands are loaded, or what it made is told.

    Before these lines Python itself begins, and ends by the signal. Once the command is done, no Ctrl-C turns Python's
    own end into another one.
    """
    try:
        with ended_soon(INTERRUPTED, _clean):
            try:
                from loopshape.cli.main import run

                run()
            finally:
                signal.signal(signal.SIGINT, signal.SIG_IGN)
    except BaseException:
        if not interrupted():
            raise
        exec("")  # Python notes an interrupt within `exec`, as dataclasses use it, and ends by the signal; undone
        say_once(INTERRUPTED)
        raise SystemExit(ENDED) from None


def _clean() -> None:
    """Remove what is half written, where anything was written yet."""
    remove = getattr(sys.modules.get("loopshape.io.files"), "remove_own_parts", None)
    if remove is not None:
        remove()
