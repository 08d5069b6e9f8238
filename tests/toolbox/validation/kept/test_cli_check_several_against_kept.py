"""`loopshape check --baseline` of several loops: the controllers' part, and the plant's."""

import json

import pytest
from coupled_run import checked, coupled_run, matrix
from run_files import write_controllers, write_matrices
from several_cases import gain

import loopshape as ls
from loopshape.testing import assert_controller


@pytest.fixture
def run(tmp_path):
    return coupled_run(tmp_path)


def test_a_verdict_on_all_loops_is_kept_and_compared(run):
    """The same again is unchanged; a gain lowered by 1 dB is the controllers' part, a fallen plant the plant's."""
    assert checked(run, "--no-figures", "--save-verdict", str(run / "kept.json")).exit_code == 0
    done = checked(run, "--no-figures", "--baseline", str(run / "kept.json"))
    assert done.exit_code == 0, done.output
    assert "Against the baseline: unchanged (0 margins worse, 0 better" in done.output
    (kept,) = ls.read(run / "kept.json")
    assert [part.loop for part in kept.parts] == ["a", "b", "a + b"]
    write_controllers(run / "c.toml", [gain("a", 1.5), gain("b")])
    compared = json.loads(checked(run, "--no-figures", "--baseline", str(run / "kept.json"), "--json").stdout)[
        "baseline"
    ]
    assert {x["loop"] for x in compared["margins"] if x["outcome"] == "worse"} == {"a", "b", "a + b"}
    assert compared["by_controller"] is None
    assert "loop a + b: other controllers, the same data" in compared["notes"]
    write_matrices(run, [matrix(0.5)])
    compared = json.loads(checked(run, "--no-figures", "--baseline", str(run / "kept.json"), "--json").stdout)[
        "baseline"
    ]
    parts = {name: {x["loop"] for x in compared[name]["margins"]} for name in ("by_controller", "by_plant")}
    assert parts == {"by_controller": {"a", "b", "a + b"}, "by_plant": {"a", "b", "a + b"}}
    whole, own, plant = (
        {
            (x["loop"], x["quantity"]): x["now"] - x["before"]
            for x in one["margins"]
            if None not in (x["now"], x["before"])
        }
        for one in (compared, compared["by_controller"], compared["by_plant"])
    )
    for key, change in whole.items():
        assert own[key] + plant[key] == pytest.approx(change, abs=1e-9), key
    with pytest.raises(AssertionError, match="Against the baseline: worse"):
        assert_controller(run, run / "c.toml", run / "r.toml", baseline=run / "kept.json")
