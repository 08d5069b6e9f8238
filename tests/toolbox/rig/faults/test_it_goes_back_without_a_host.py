"""A trial whose host is gone: the target goes back by itself, in C and in Python, before its watchdog vents it."""

import time
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from axis_study import target as python_target
from emulated_cases import emulator, settings
from python_target_line import Running

from loopshape.toolbox.rig.target.armed import arm
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Configuration, Request, State
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.target.target import configuration, record
from loopshape.toolbox.rig.target.trial import Phase, Progress, Trial, Watch, Why

LEASE = 400  # ticks of 1 ms


def gone(port, make, watch):
    """A host that arms, begins a trial, pushes and is gone without a word; what the target says to the next one."""
    with open_link(port, 0) as link:
        session = Session(link)
        push = make(session)
        session.ask(Request.BLEND, watch.payload())
        push()
    until = time.monotonic() + 8.0  # before the watchdog; a busy machine's target is late
    while True:
        time.sleep(1.0)
        with open_link(port, 0) as link:
            session = Session(link)
            found = session.status(), Progress.read(session.ask(Request.PROGRESS))
        if found[1].phase is not Phase.ON_TRIAL or time.monotonic() > until:
            return found


def on_the_arm(arm_experiment, gain, pushed_deg=0.0):
    """The simulated arm's loop of the angle under its own controller, and so many times it on trial.

    An arm at rest between two steps of its encoder stays there under any controller: a push takes it out.
    """

    def make(session):
        e = arm_experiment((5.0, 1.0), 10)
        wanted = settings(watchdog_ms=10_000)
        sections = e.loops[0].controller.biquads().copy()
        sections[0, :3] *= gain
        plain = configuration(session.identity, e.loops, wanted, e.rate_hz, {})
        armed = arm(session, wanted, e.loops, Configuration(**{**vars(plain), "trial": Trial(0, sections)}))
        push = replace(e, references=np.tile([np.radians(pushed_deg), 1.0], (10, 1)))
        return lambda: (
            record(armed, push, 1, lambda *about: nullcontext(lambda rows: None), None) if pushed_deg else None
        )

    return make


def on_the_axis(gain):
    def make(session):
        one = np.eye(1)
        limits = np.array([[-7.0, 7.0, np.inf], [-100.0, 100.0, np.inf]])
        sections = np.array([[9.0 * 20.0, -9.0 * 19.0, 0.0, -0.7, 0.0]])  # a gain and a lead
        trial = Trial(0, sections * [gain, gain, gain, 1.0, 1.0])
        wanted = Configuration(one, one, (sections,), limits, False, 10_000, 0.0, trial=trial)
        session.ask(Request.ARM, session.configure(wanted))
        return lambda: None

    return make


@pytest.mark.long
@pytest.mark.parametrize("real_time", [True, False])
def test_in_c_it_goes_back_when_the_host_does_not_go_on(arm_experiment, real_time):
    with emulator(tcp=0, real_time=real_time) as port:
        status, found = gone(port, on_the_arm(arm_experiment, 1.1), Watch(0.5, 10, LEASE, 100))
    assert (status.state, found.phase, found.why, found.share) == (State.ARMED, Phase.WENT_BACK, Why.LEASE, 0.0)
    if real_time:
        assert found.ticks == LEASE


@pytest.mark.long
def test_in_c_it_goes_back_when_the_error_leaves_what_was_predicted(arm_experiment):
    """The sign turned: the loop runs away, and within a window of 50 ticks of what is watched it is back."""
    watch = Watch(1.0, 1, 60_000, 50, error_peak=np.radians(5.0), error_rms=np.radians(3.0))
    with emulator(tcp=0, real_time=True) as port:
        status, found = gone(port, on_the_arm(arm_experiment, -1.0, pushed_deg=2.0), watch)
    assert status.state is State.ARMED
    assert (found.phase, found.share) == (Phase.WENT_BACK, 0.0)
    assert found.why in (Why.ERROR_PEAK, Why.ERROR_RMS)
    assert np.degrees(abs(status.sensors[0])) < 15.0


def test_in_python_it_goes_back_too():
    for gain, watch, why in (
        (1.1, Watch(0.5, 10, LEASE, 100), (Why.LEASE,)),
        (-1.0, Watch(1.0, 1, 60_000, 50, error_peak=0.01, error_rms=0.005), (Why.ERROR_PEAK, Why.ERROR_RMS)),
    ):
        with Running(lambda: python_target(1, fast=False)) as line:
            status, found = gone(line.port, on_the_axis(gain), watch)
        assert (status.state, found.phase) == (State.ARMED, Phase.WENT_BACK)
        assert found.why in why
        assert abs(status.sensors[0]) < 0.1
