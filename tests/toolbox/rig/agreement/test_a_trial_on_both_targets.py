"""A second controller beside a loop's own: both targets give what the formula gives, and go back at the same tick."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from python_target_trial import Trial as InPython
from scipy.signal import lfilter
from target_cases import Bench
from two_targets import Second

from loopshape.toolbox.rig.target.messages import Configuration, Identity, Reason, Request, State, start_payload
from loopshape.toolbox.rig.target.trial import Phase, Progress, Trial, Watch, Why

OTHER = np.array([[0.4, 0.1, 0.0, -0.5, 0.06], [1.2, -0.3, 0.0, -0.2, 0.0]])
INTEGRATOR = np.array([[0.3, -0.2, 0.0, -1.0, 0.0]])
WIDE = Watch(0.5, 20, 100_000, 100)
Z = 4  # the place of z of loop 0 in a sample of two loops


@pytest.fixture
def bench():
    b = Bench(pwm_hz=0.0)
    yield b
    b.close()


def recorded(bench, errors, trial, watch):
    """z (n,) of loop 0, whose own controller is a gain of 1, while its r - y is these errors, from the BLEND on."""
    bench.arm(trial=trial)
    bench.ok(Request.BLEND, watch.payload())
    table = np.column_stack([-np.asarray(errors), np.full(len(errors), 0.5), np.full(len(errors), 0.5)])
    bench.lines("s " + " ".join(map(repr, table[0].tolist())))
    return bench.watched(table)[:, Z]


def in_python(errors, trial, watch):
    """The same by the target in Python: z (n,), and its PROGRESS."""
    one = InPython(trial.loop, trial.track)
    one.take(0, [tuple(row) for row in trial.sections.tolist()])
    one.arm()
    one.blend(watch.payload())
    return np.array([one.step(e, e, e) for e in np.asarray(errors).tolist()]), Progress.read(one.progress())


def by_formula(errors, watch, sections):
    """own + share (other - own)."""
    share = watch.share * np.minimum((1 + np.arange(len(errors))) / max(watch.ramp, 1), 1.0)
    other = errors
    for b0, b1, b2, a1, a2 in sections:
        other = lfilter([b0, b1, b2], [1.0, a1, a2], other)
    return errors + share * (other - errors)


def progress(bench):
    return Progress.read(bench.ok(Request.PROGRESS))


@pytest.mark.parametrize("ramp", [0, 1, 37])
@pytest.mark.parametrize("sections", [OTHER, INTEGRATOR], ids=["other", "integrator"])
def test_a_share_of_the_other_controller_is_what_the_formula_says(bench, ramp, sections):
    errors = 0.1 * np.random.default_rng(1).standard_normal(200)
    watch = replace(WIDE, ramp=ramp)
    expected = by_formula(errors, watch, sections)
    z = recorded(bench, errors, Trial(0, sections), watch)
    np.testing.assert_allclose(z, expected, rtol=1e-12, atol=1e-14)
    second, said = in_python(errors, Trial(0, sections), watch)
    assert np.array_equal(second, z)
    assert (said.phase, said.share, said.ticks) == (Phase.ON_TRIAL, 0.5, 200)
    assert progress(bench) == said


def test_what_integrates_takes_over_without_a_bump(bench):
    """100 ticks with a constant error wind the other's integrator up; then 60 of a whole share, at once."""
    trial = Trial(0, np.array([[0.01, 0.0, 0.0, -1.0, 0.0]]), track=1.0)
    bench.arm(trial=trial)
    bench.tick(100, (-0.2, 0.5, 0.5))
    bench.ok(Request.BLEND, Watch(1.0, 0, 1000, 50).payload())
    z = bench.watched(np.tile([-0.2, 0.5, 0.5], (60, 1)))[:, Z]
    np.testing.assert_allclose(z, 0.2 + 0.002 * (1 + np.arange(60)), atol=1e-12)  # by 0.01 of 0.2 a tick, from 0.2 on


CASES = {
    "error_peak": (dict(error_peak=0.3), Why.ERROR_PEAK, lambda k: 0.31 if k == 61 else 0.1, 61),
    "control_low": (dict(control_low=-0.2, control_high=0.2), Why.CONTROL_RANGE, lambda k: max(-0.01 * k, -0.9), None),
    # squares of 0.01 fill less than the first window's 1.4641; from tick 100 on 0.04 a tick: more after 37 of them
    "rms": (dict(error_rms=0.121), Why.ERROR_RMS, lambda k: 0.2 if k >= 100 else 0.1, 136),
    "growth": (dict(error_rms=1.0, growth=3.0, window=20), Why.GROWTH, lambda k: min(0.05 * 2.0 ** (k // 20), 0.9), 79),
    "lease": (dict(lease=70), Why.LEASE, lambda k: 0.1, 69),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_it_goes_back_at_the_tick_that_passes_and_says_why(bench, case):
    words, why, error, at = CASES[case]
    watch, trial = replace(WIDE, **words), Trial(0, OTHER)
    errors = np.array([error(k) for k in range(160)])
    expected = by_formula(errors, watch, OTHER)
    if at is None:
        at = int(np.flatnonzero(np.abs(expected) > 0.2)[0])
    second, said = in_python(errors, trial, watch)
    z = recorded(bench, errors, trial, watch)
    ended, mine = bench.ended(), progress(bench)
    assert (ended.reason, ended.tick, ended.ticks, ended.index) == (Reason.TRIAL, at, at + 1, None)
    assert (mine.phase, mine.why, mine.share, mine.ticks) == (Phase.WENT_BACK, why, 0.0, at + 1)
    assert (said.phase, said.why, said.ticks) == (mine.phase, mine.why, mine.ticks)
    np.testing.assert_allclose(z[:at], expected[:at], rtol=1e-12)
    assert z[at] == errors[at]  # its own controller, in the very tick
    assert bench.status().state is State.ARMED
    assert (said.value, said.limit) == pytest.approx((mine.value, mine.limit))
    assert np.array_equal(second[: z.size], z)


def test_once_back_it_stays_and_only_a_new_configuration_tries_again(bench):
    bench.arm(trial=Trial(0, OTHER))
    bench.ok(Request.BLEND, replace(WIDE, error_peak=0.1).payload())
    bench.tick(3, (-0.2, 0.5, 0.5))
    assert bench.ended().reason is Reason.TRIAL  # without a recording too
    assert bench.no(Request.BLEND, WIDE.payload()) == 1
    bench.ok(Request.DISARM)
    bench.arm(trial=Trial(0, OTHER))
    assert progress(bench).phase is Phase.OWN
    bench.ok(Request.BLEND, WIDE.payload())


@pytest.mark.parametrize("target", ["C", "Python"])
def test_what_a_target_refuses(bench, target):
    one = bench if target == "C" else Second()
    wide = WIDE.payload()
    assert one.no(Request.BLEND, wide) == 1  # not armed
    limits = np.array([[-1.0, 1.0, inf]] * 4)
    gain = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
    both = (
        bench.configuration
        if target == "C"
        else Configuration(np.eye(2), np.eye(2), (gain, gain), limits, False, 9999, 0.0)
    )
    both = replace(both, watchdog_ms=9999)
    outside = np.array([[1.0, 0.0, 0.0, -2.1, 1.05]])
    frames = both.frames()
    for what, payload in frames[:-1]:
        one.ok(what, payload)
    assert one.no(Request.TRIAL, Trial(0, OTHER).payloads()[0]) == 3  # before the limits
    one.ok(*frames[-1])
    assert one.no(Request.TRIAL, Trial(2, OTHER).payloads()[0]) == 3
    assert one.no(Request.TRIAL, Trial(0, outside).payloads()[0]) == 3
    assert one.no(Request.TRIAL, Trial(0, OTHER * nan).payloads()[0]) == 3
    assert one.no(Request.TRIAL, Trial(0, OTHER, 1.5).payloads()[0]) == 3
    assert one.no(Request.TRIAL, Trial(0, OTHER).payloads()[0][:-1]) == 2
    with_trial = replace(both, trial=Trial(1, OTHER, 0.1))
    for without in (both, with_trial):
        for what, payload in without.frames():
            one.ok(what, payload)
        ready = one.ok(Request.READY)
        assert int.from_bytes(ready[:4], "little") == without.digest
        one.ok(Request.ARM, ready)
        if without is both:
            assert one.no(Request.BLEND, wide) == 4
            one.ok(Request.DISARM)
    bad = (dict(share=1.1), dict(share=-0.1), dict(share=nan), dict(lease=0), dict(window=0), dict(error_peak=0.0),
           dict(error_rms=nan), dict(growth=1.0), dict(control_low=1.0, control_high=1.0))  # fmt: skip
    for words in bad:
        assert one.no(Request.BLEND, replace(WIDE, **words).payload()) == 3, words
    assert one.no(Request.BLEND, wide[:-1]) == 2
    one.ok(Request.BLEND, replace(WIDE, ramp=0).payload())
    assert Identity.read(one.ok(Request.IDENTIFY, b"\1\0")).trials
    if target == "C":
        bench.tick(1)
        assert bench.no(Request.BEGIN, start_payload(3, 5, 2, 2, 0, False)) == 3  # open loops
    one.ok(Request.BLEND, Watch(1.0, 0, 0, 1).payload())
    assert Progress.read(one.ok(Request.PROGRESS)).phase is Phase.STAYS
    assert one.no(Request.BLEND, wide) == 1
