"""A step that takes long shows on a terminal that it goes on, and why its first time takes longer."""

import io
import logging

from loopshape.cli.output import Output


class Terminal(io.StringIO):
    """Standard error of somebody who looks."""

    def isatty(self):
        return True


def test_a_long_step_shows_its_time_and_that_it_compiles(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stderr", seen := Terminal())
    kernels = logging.getLogger("loopshape.kernels")
    with Output().progress("tune motor", 1):
        assert "tune motor" in seen.getvalue()
        kernels.info("compiling %s", "a kernel")
    assert "0:00:0" in seen.getvalue()
    assert "compiling, on first use only" in seen.getvalue()
    before = seen.getvalue()
    kernels.info("compiling %s", "another")
    assert seen.getvalue() == before


def test_nothing_is_shown_where_nobody_looks(capsys):
    with Output().progress("tune motor", 1) as step:
        step("done")
    assert capsys.readouterr() == ("", "")
