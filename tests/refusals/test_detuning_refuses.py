"""A detuning margin that makes no sense is refused, in the noun and in the file."""

import json
from dataclasses import replace

import pytest
from bench_nouns import Detuning, Lost, MovedResonance, Reach
from run_files import read_verdicts, write_verdicts
from verdict_cases import checked, margins

import loopshape as ls

DETUNING = Detuning(
    up=Reach(1.5, False, "gain_margin_db", (1.2, 1.7)),
    down=Reach(20.0, True, "", (19.0, 20.0)),
    resonances=(
        MovedResonance(58.8, 0.004, Reach(1.0, False, "stability", (0.9, 1.1)), Reach(9.0, True, "", (9.0, 9.0))),
    ),
    drawn=True,
    lost=Lost(2.0, "gain_margin_db", "dB", 7.9, 0.5, 5.0, 58.8, 58.84, 3, "notch"),
)


@pytest.mark.parametrize("percent", [-1.0, 0.0, float("nan"), float("inf"), 20.5])
def test_a_shift_that_makes_no_sense(percent):
    with pytest.raises(ls.errors.WrongUseError, match="detuning_percent of loop 'axis' must"):
        ls.Requirements("axis", detuning_percent=percent)
    ls.Requirements("axis", detuning_percent=20.0)


@pytest.mark.parametrize("written", ['"2 %"', "true", "-2.0", "nan", "30", "[1, 2]"])
def test_a_file_with_a_shift_that_makes_no_sense(written, tmp_path):
    path = tmp_path / "r.toml"
    text = 'format = "loopshape-requirements/1"\n[[loop]]\nname = "axis"\ndetuning_percent = '
    path.write_text(text + written)
    with pytest.raises((ls.errors.WrongUseError, ls.errors.UnreadableInputError), match="detuning_percent"):
        ls.read_requirements(path)
    path.write_text(f"{text}2.5")
    assert ls.read_requirements(path)[0].detuning_percent == 2.5


def test_a_verdict_with_a_detuning_comes_back_and_a_damaged_one_is_refused(tmp_path):
    path = tmp_path / "v.json"
    found = replace(margins({"detuning_percent": 1.5}), detuning=DETUNING)
    write_verdicts(path, [checked({"r1": found})])
    (back,) = read_verdicts(path)
    assert back.margins["r1"].detuning == DETUNING
    whole = json.loads(path.read_text())
    for damage in (5, "x", {"up": 1}, {"up": {"percent": "much"}}, []):
        whole["loops"][0]["margins"]["r1"]["detuning"] = damage
        path.write_text(json.dumps(whole))
        with pytest.raises(ls.errors.UnreadableInputError, match="cannot be read as verdicts"):
            read_verdicts(path)
