"""One file a command. Here the program begins: before anything of weight is loaded, Ctrl-C is listened to."""

from __future__ import annotations

import gc

from loopshape.verbs.session import guarded


def script() -> None:
    """The program, whose commands are loaded within."""
    guarded(_run)


def _run() -> None:
    gc.set_threshold(200_000)  # one command leaves little to collect; looking for it took a twentieth of `check`
    from loopshape.cli.main import run

    run()
