"""`plan --until` and `ls.planning.enough`: whether a log is enough, and how much more it takes."""

import json

import numpy as np
import pytest
from commands import loopshape
from scipy.signal import lfilter

import loopshape as ls

RATE = 1000.0


def log(seconds, noise=0.05):
    """A loop with a lag of 1 s under a gain of 20: crossover at 3.1 Hz, T known by the maker."""
    n, v = np.random.default_rng(1).standard_normal((2, int(seconds * RATE)))
    y = lfilter([0.0, 0.02], [1.0, -0.979], n)  # y = 0.999 y + 0.001 u, u = 20 (n - y)
    e = lfilter([1.0, -0.999], [1.0, -0.979], noise * v)
    return ls.Run.from_arrays(u=20.0 * (n - y - e), y=y + e, excitation=n, rate_hz=RATE)


def test_four_times_the_log_is_known_twice_as_well():
    short, long = (max(b.plant_std for b in ls.planning.enough(log(s), 0.5).bands[:5]) for s in (20.0, 320.0))
    assert short / long == pytest.approx(4.0, rel=0.4)


def test_what_more_it_takes_is_what_it_takes():
    asked = 0.008
    first = ls.planning.enough(log(20.0), asked)
    assert str(first.state) == "more"
    needed_s = first.elapsed_s + first.more_s
    assert str(ls.planning.enough(log(0.4 * needed_s), asked).state) == "more"
    assert str(ls.planning.enough(log(2.0 * needed_s), asked).state) == "accurate"


def test_a_verdict_that_is_decided_needs_no_more():
    C = ls.controller(ls.gain(20.0), rate_hz=RATE)
    R = ls.Requirements(sensitivity_peak_db=6.0, unstable_poles=0, integrators=0)
    found = ls.planning.enough(log(60.0), [R], controllers=C)
    assert (str(found.state), str(found.outcome), found.more_s) == ("decided", "passed", 0.0)


@pytest.mark.parametrize("n", [9, 39])
def test_a_log_that_is_too_short_is_refused_with_its_length(n):
    u = np.random.default_rng(0).standard_normal(n)
    run = ls.Run.from_arrays(u=u, y=lfilter([0.0, 0.05], [1.0, -0.95], u), rate_hz=100.0)
    with pytest.raises(ls.errors.BadSignalError, match=rf"received {n} samples .*; record 40 samples"):
        ls.planning.enough(run, 0.05)


def test_the_command_says_it_in_words_and_by_its_exit_code(tmp_path):
    ls.write(log(20.0), tmp_path / "run")
    more = loopshape("plan", tmp_path / "run", "--until", "S=0.1")
    assert more.returncode == 1
    assert "s more" in more.stdout
    enough = loopshape("plan", tmp_path / "run", "--until", "S=50", "--json")
    assert (enough.returncode, json.loads(enough.stdout)["state"]) == (0, "accurate")
