"""A study that moves setpoints or drives commands and excites nothing is measured; there is just no FRF."""

import json

import pytest
from commands import invoked

import loopshape as ls

STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }]
[[experiment]]
name = "moves"
duration_s = 0.5
"""


@pytest.mark.parametrize(
    "signals",
    [
        "references = { theta2 = { kind = 'staircase', times_s = [0.1], values_deg = [2.0] } }",
        "control = { theta2 = { kind = 'staircase', times_s = [0.1], values_v = [0.2] } }",
    ],
)
def test_it_is_recorded_and_said(tmp_path, signals):
    (tmp_path / "study.toml").write_text(STUDY + signals + "\n")
    words = ["measure", str(tmp_path / "study.toml"), "--out", str(tmp_path / "run")]
    result = invoked(words)
    assert result.exit_code == 0, result.output
    assert "no recording excites a loop" in result.stdout
    assert len(ls.read(tmp_path / "run").recordings) == 1
    again = invoked([*words, "--json"])
    assert json.loads(again.stdout) == {"run": str(tmp_path / "run"), "ended_early": []}
