"""Predictions: one loop as itself and as 1 x 1, a loop's own step, kept and read, with and without a fit."""

import json

import numpy as np
import pytest
from commands import loopshape
from predicted_loops import NEW, OLD, arm, measured
from scipy.signal import lfilter

import loopshape as ls

F = 0.05 * np.arange(2, 501)


def lines(seed: int) -> ls.FRF:
    return measured(np.random.default_rng(seed), F, arm().response(F), 0.01, OLD)


def test_without_a_fit_the_step_comes_from_the_lines_or_it_is_said_why_not() -> None:
    frf = lines(9)
    (whole,) = ls.predict(frf, NEW)
    (part,) = ls.predict(frf.between(1.5, 25.0), NEW)
    assert whole.step is not None
    assert whole.step.source == "FRF"
    assert whole.step.indicators.overshoot == pytest.approx(0.28, abs=0.03)
    assert part.step is None
    assert any("no fit" in note for note in part.notes)


@pytest.mark.parametrize("seed", range(3))
def test_one_plant_and_a_list_of_it_are_one_and_are_read_as_they_were_written(seed, tmp_path):
    P = lines(seed)
    (one,), (listed,) = ls.predict(P, NEW), ls.predict([P], [NEW])
    (back,) = ls.read(ls.write(one, tmp_path / "p.npz"))
    for other in (listed, back):
        assert json.dumps(other.to_dict(), default=str) == json.dumps(one.to_dict(), default=str)
        np.testing.assert_array_equal(other.sensitivity.response, one.sensitivity.response)
        np.testing.assert_array_equal(other.sensitivity.covariance, one.sensitivity.covariance)
        np.testing.assert_array_equal(other.step.response, one.step.response)


def test_the_step_of_a_loop_is_that_of_its_prediction():
    P = lines(4)
    (predicted,) = ls.predict(P, NEW)
    np.testing.assert_array_equal(ls.Loop(P, NEW).step().response, predicted.step.response)


def test_the_command_says_what_its_verb_gives(tmp_path):
    n = np.random.default_rng(1).standard_normal(20_000)
    run = ls.Run.from_arrays(u=n, y=lfilter([0.05], [1.0, -0.95], n), rate_hz=500.0)
    ls.write(run, tmp_path / "run")
    C = ls.controller(ls.gain(2.0), rate_hz=500.0, loop="loop")
    out = tmp_path / "p.npz"
    assert loopshape("frf", tmp_path / "run", "--no-figures").returncode == 0
    done = loopshape(
        "predict", tmp_path / "run", ls.write(C, tmp_path / "c.toml"), "--out", out, "--no-figures", "--json"
    )
    words, found = json.loads(done.stdout)["predictions"], [one.to_dict() for one in ls.predict(ls.frf(run), C)]
    assert [one["stability"] for one in words] == [one["stability"] for one in found]
    assert len(ls.read(out)) == 1
    for name, value in found[0]["step"]["indicators"].items() if found[0]["step"] else ():
        if isinstance(value, float):
            assert words[0]["step"]["indicators"][name] == pytest.approx(value, rel=1e-9)
