"""A log that is too short says how long it has to be, and a log of that length is long enough."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

import loopshape as ls

RATE = 100.0


def log(n):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(n)
    return ls.Run.from_arrays(u=u, y=lfilter([0.0, 0.05], [1.0, -0.95], u), rate_hz=RATE)


@pytest.mark.parametrize("n", [2, 5, 9, 20, 39])
def test_frf_and_plan_say_how_many_samples_they_need(n):
    for verb in (ls.frf, lambda run: ls.planning.plan(run, std=0.02)):
        with pytest.raises(ls.errors.BadSignalError, match=f"received {n} samples in {n / RATE:g} s") as refused:
            verb(log(n))
        (least,) = re.findall(r"record (\d+) samples", str(refused.value))
        assert "too short" not in told(lambda n: ls.frf(log(n)), int(least))
        assert "too short" in told(lambda n: ls.frf(log(n)), int(least) - 1)


def told(verb, n):
    """What a verb says of a log of this length: nothing, or why not."""
    try:
        verb(n)
    except ls.errors.BadSignalError as error:
        return str(error)
    return ""


def test_a_log_too_short_to_plan_from_says_how_long_it_has_to_be():
    with pytest.raises(ls.errors.BadSignalError, match="too short to plan from") as refused:
        ls.planning.plan(log(60), std=0.02)
    (least,) = re.findall(r"record (\d+) samples", str(refused.value))
    assert "too short" not in told(lambda n: ls.planning.plan(log(n), std=0.02, at_hz=20.0), int(least))
