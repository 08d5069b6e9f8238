"""What quiet leaves."""

import pytest

from loopshape.cli.output import Output


def test_quiet_keeps_warnings_back_and_json_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    for output, said in ((Output(quiet=True), ""), (Output(as_json=True), "warning: a\n"), (Output(), "warning: a\n")):
        output.warn(["a", "a"])
        assert capsys.readouterr().err == said
