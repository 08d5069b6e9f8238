"""A new controller takes over on a target share by share, or the target goes back; what it does is journaled."""

import json

import numpy as np
import pytest
from axis_study import experiment, study_text, target, write_study
from python_target_line import Running
from python_target_trial import KEPT, WENT_BACK

import loopshape as ls

REQUIRED = ls.Requirements("axis1", sensitivity_peak_db=6.0, unstable_poles=0, integrators=1)
MOTOR = ["watchdog_ms = 5000"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = study_text(experiment(period_s=1.0, periods=6), target=MOTOR).replace("f_high_hz = 60.0", "f_high_hz = 300.0")
    return write_study(tmp_path_factory.mktemp("study"), text)


@pytest.fixture(scope="module")
def run(study, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "old"
    with Running(lambda: target(1)) as line:
        ls.rig.measure(study, out, port=line.port, arm=True)
    return out


def new(gain, corner_hz=5.0):
    blocks = (ls.gain(gain), ls.lead_lag(corner_hz, 61.0), ls.low_pass(200.0, order=1))
    return ls.controller(*blocks, rate_hz=1000.0, loop="axis1")


def journal(out):
    return [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]


def test_one_that_does_what_was_predicted_is_adopted(study, run, tmp_path):
    with Running(lambda: target(1)) as line:
        found = ls.rig.adopt(run, new(11.0), study, tmp_path / "out", port=line.port, requirements=[REQUIRED], arm=True)
        assert found.outcome == "adopted", found.reason
        assert [one.share for one in found.steps] == [0.0, 0.25, 0.5, 1.0]
        assert line.target.settings.trial.phase == KEPT
    for one in found.steps[1:]:
        low, high = one.expected.error_rms
        assert 0.8 * low < one.error_rms < 1.2 * high
    assert [line["event"] for line in journal(tmp_path / "out")] == ["armed", *["share"] * 4, "adopted"]
    half = ls.read(tmp_path / "out" / "a050")
    np.testing.assert_allclose(
        half.loop("axis1").controller.response([3.0, 30.0]),
        0.5 * (new(9.0).response([3.0, 30.0]) + new(11.0).response([3.0, 30.0])), rtol=1e-9,
    )  # fmt: skip
