"""JSON of commands is strict: what is not known is null, what is unlimited the word inf; no bare NaN, no word nan."""

import json

import pytest

from loopshape.cli.output import Output
from loopshape.design.relax import Relaxation, Shortfall


def strict(text: str) -> dict:
    """JSON as a strict reader takes it."""

    def refused(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refused)


def test_numbers_that_are_not_known_are_null(capsys: pytest.CaptureFixture[str]) -> None:
    nowhere = Relaxation("phase_margin_deg", "deg", 45.0, float("nan"), False, float("nan"))
    unstable = Shortfall(False, float("nan"), float("nan"), (), (), (nowhere,))
    Output(as_json=True).json({"shortfall": unstable, "gain_margin_db": float("inf"), "each": [1.0, float("nan")]})
    found = strict(capsys.readouterr().out)
    assert found["shortfall"]["miss"] is None
    assert found["shortfall"]["relaxations"][0]["reachable"] is None
    assert found["shortfall"]["relaxations"][0]["required"] == 45.0
    assert (found["gain_margin_db"], found["each"]) == ("inf", [1.0, None])
