"""One host has a target's place; no other one, silent or busy, keeps a stop or the next host away from it."""

import re
import socket
import time
from contextlib import ExitStack, contextmanager

import pytest
from axis_study import target
from commands import invoked
from emulated_cases import emulator, settings
from python_target_line import Running

import loopshape as ls
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Reason, Response, State
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.target.target import arm as armed
from loopshape.toolbox.rig.target.target import configuration


@contextmanager
def emulated():
    with emulator(tcp=0) as port:
        yield port


@contextmanager
def in_python():
    with Running(lambda: target(fast=False, emulated=False)) as running:
        yield running.port


TARGETS = pytest.mark.parametrize("a_target", [emulated, in_python])


def silent(port):
    """A connection that says nothing."""
    return socket.create_connection(("127.0.0.1", int(re.search(r":(\d+)$", port)[1])), timeout=5.0)


def stopped(port):
    """`loopshape stop PORT`: what it says, and how long it took."""
    begun = time.monotonic()
    result = invoked(["stop", port])
    assert result.exit_code == 0, result.exception
    return result.stdout, time.monotonic() - begun


@pytest.mark.long
@TARGETS
@pytest.mark.parametrize("age_s", [0.0, 1.2])
@pytest.mark.parametrize("count", [1, 7])
def test_silent_connections_keep_no_stop_away(a_target, age_s, count):
    with a_target() as port, ExitStack() as open_ones:
        for _ in range(count):
            open_ones.enter_context(silent(port))
        time.sleep(age_s)
        said, took_s = stopped(port)
        assert said.startswith("vented")
        assert took_s < 2.5
        time.sleep(1.1)
        with open_link(port, 0) as link:  # the idle one has lost its place
            status = Session(link).status()
    assert (status.state, status.fault) == (State.FAULT, Reason.EMERGENCY_STOP)


def test_a_stop_reaches_a_target_that_another_host_drives(arm_experiment):
    loops, ends = arm_experiment((0.0, 1.0), 1).loops, []
    with emulated() as port, open_link(port, 0) as link:
        session = Session(link)
        wanted = settings(watchdog_ms=10000)
        armed(session, wanted, loops, configuration(session.identity, loops, wanted, 1000.0, {}))
        session.unasked = lambda f: ends.append(session.ended(f)) if f.type == Response.ENDED else None
        with session.kept_alive(0.1):
            said, _ = stopped(port)
        assert said == "vented; another host is connected, which is told\n"
        assert session.status().state is State.FAULT  # it keeps its place, and is told
        assert ends[0].reason is Reason.EMERGENCY_STOP


@TARGETS
def test_another_host_is_told_why_it_has_to_wait(a_target):
    with a_target() as port, open_link(port, 0) as link:
        session = Session(link)
        session.status()
        with (
            session.kept_alive(0.1),
            open_link(port, 0) as second,
            pytest.raises(ls.errors.RigError, match="refuses ALIVE; received another host is connected"),
        ):
            Session(second).status()
        assert session.status().state is State.IDLE


@TARGETS
def test_the_next_host_comes_straight_after_a_close(a_target):
    took_s = []
    with a_target() as port:
        for _ in range(40):
            begun = time.monotonic()
            with open_link(port, 0) as link:
                assert Session(link).status().state is State.IDLE
            took_s.append(time.monotonic() - begun)
    assert max(took_s) < 1.0
    print(f"slowest of 40: {1e3 * max(took_s):.0f} ms")


@pytest.mark.long
@TARGETS
def test_a_host_that_speaks_keeps_its_place(a_target):
    with a_target() as port, open_link(port, 0) as link, ExitStack() as others:
        session = Session(link)
        for k in range(20):
            session.status()
            if k % 5 == 0:
                others.enter_context(silent(port))
            time.sleep(0.1)
        assert session.status().state is State.IDLE
