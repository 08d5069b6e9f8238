"""A command as a user gives it, by the entry point of the program, in this process: its libraries are loaded once."""

import io
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess
from unittest import mock

from typer.testing import CliRunner, Result

from loopshape.cli import main
from loopshape.io import input_guard

ROOT = Path(__file__).parents[2]


def loopshape(*words: object, cwd: Path = ROOT) -> CompletedProcess[str]:
    """Run the command; how it ended, with the exit code and the words of a process of its own."""
    with chdir(cwd), _nothing_read_yet():
        code, out, err = said_by(words).split("\0", 2)
    return CompletedProcess([str(word) for word in words], int(code), out, err)


def said_by(words: tuple[object, ...]) -> str:
    """Exit code, output and complaints of a command, as one text."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with redirect_stdout(out), redirect_stderr(err), mock.patch.object(sys, "argv", ["loopshape", *map(str, words)]):
        try:
            main.run()
        except SystemExit as ended:
            code = ended.code or 0
        except BaseException:
            code = 70
            traceback.print_exc(file=err)
    return f"{code}\0{out.getvalue()}\0{err.getvalue()}"


def invoked(words: Sequence[object], **settings: object) -> Result:
    """What typer's runner tells of a command, with the exception that a refusal is."""
    return CliRunner().invoke(main.app, [str(word) for word in words], **settings)


@contextmanager
def _nothing_read_yet() -> Iterator[None]:
    """A process of its own has read no file and holds no folder yet."""
    with mock.patch.object(input_guard, "_noted", None), mock.patch.object(input_guard, "_alone", 0):
        yield
