"""What a target is told and when: nothing moves unasked, limits end a run, and whatever ends the host vents first."""

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from axis_study import experiment, measured, simulated, study_text, table, target, write_study
from bench_nouns import Block
from commands import invoked
from python_target import ALIVE, ARM, ARMED, BEGIN, BY_WATCHDOG, FAULT, GO, IDLE, RUNNING, SETPOINT, VENT
from python_target_line import Running
from run_files import finished, read_journal, write_verdicts
from verdict_cases import checked, line, margins

import loopshape as ls
from loopshape.core.interrupts import interrupts
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.settings import spoken
from loopshape.toolbox.rig.target.blocks import Block as Computed
from loopshape.toolbox.rig.target.blocks import own_radius
from loopshape.toolbox.rig.verbs.stop import MARK

EXPERIMENTS = (
    experiment("small", period_s=0.25),
    experiment("large", period_s=0.25, amplitude=0.2),
    experiment("after", period_s=0.25),
)
#: "large" passes an angle of 0.16 rad that no signal asks for: nobody sees that before
AT_THE_PLANT = (
    EXPERIMENTS[0],
    experiment("large", injection="plant_input", unit="v", amplitude=4.0, period_s=0.25),
    EXPERIMENTS[2],
)
REAL = ("place = false", "settle_s = 0.1", "soft_start_s = 0.1")


def real(**board):
    return target(fast=False, emulated=False, **board)


def told(running):
    return [kind for kind, _ in running.log]


def command(*words):
    """Exit code, standard output, and what was said on standard error, as the shell sees them."""
    result = invoked(words)
    if isinstance(result.exception, ls.LoopshapeError):
        return 2, result.stdout, str(result.exception)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def until(what, seconds=30.0, process=None):
    end = time.monotonic() + seconds
    while not what():
        assert process is None or process.poll() is None, process.stderr.read()
        assert time.monotonic() < end, f"nothing came of it in {seconds} s"
        time.sleep(0.005)


def test_nothing_moves_unless_it_is_armed_by_hand(tmp_path):
    study = write_study(tmp_path, study_text(*EXPERIMENTS))
    with Running(real) as running:
        code, said, error = command("measure", study, "--out", tmp_path / "run", "--port", running.port)
        assert code == 2
        assert "no motion; received no word to arm; look at what is about to happen, then add --arm" in error
        assert not {ARM, SETPOINT, BEGIN, GO} & set(told(running))
        assert running.target.state == IDLE
    for words in (
        "a real machine",
        "1000 Hz",
        "angle1_rad",
        "-171.9 to 171.9 deg",
        "-40 to 40 V",
        "vents",
        "large",
        "axis1 11.46 deg",
    ):
        assert words in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("way", ["--json", "--quiet"])
def test_what_is_not_shown_is_not_armed_by_a_word(tmp_path, way, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    study = write_study(tmp_path, study_text())
    with Running(real) as running:
        code, said, _ = command("measure", study, "--out", tmp_path / "run", "--port", running.port, way)
        assert (code, said) == (2, "")
        assert ARM not in told(running)


def passed(study, name, key, at, rate):
    """Tick, value of the first sample of a column beyond `at`, in value or in rate over ten ticks."""
    values = simulated(study, name)[key]
    if rate:
        before = np.concatenate([np.full(10, values[0]), values[:-10]])
        values = np.abs(values - before) * 1000.0 / 10
    tick = int(np.argmax(np.abs(values) > at))
    assert tick > 0
    return tick, values[tick]


LIMITS = [
    ("s1", False, "angle", "low_rad = -3.0, high_rad = 0.16", 0.16, "limit of angle1_rad"),
    ("s1", True, "angle", "low_rad = -3.0, high_rad = 3.0, rate_rad_s = 4.0", 4.0, "rate limit of angle1_rad"),
    ("u1", False, "drive", "low_v = -8.0, high_v = 8.0", 8.0, "limit of drive1_v"),
    ("u1", True, "drive", "low_v = -40.0, high_v = 40.0, rate_v_s = 700.0", 700.0, "rate limit of drive1_v"),
]


@pytest.mark.parametrize(("key", "rate", "where", "limits", "at", "words"), LIMITS)
@pytest.mark.parametrize("ignores", [False, True])
def test_a_limit_ends_the_recording_at_its_tick_and_says_by_how_much(
    tmp_path, key, rate, where, limits, at, words, ignores
):
    asked, injection = (AT_THE_PLANT, "plant_input") if key == "s1" and not rate else (EXPERIMENTS, "controller_input")
    text = study_text(*asked, target=["soft_start_s = 1.0"], **{where: limits})
    study, run = write_study(tmp_path, text), tmp_path / "run"
    with Running(lambda: target(ignores_limits=ignores)) as running:
        ended = measured(study, run, running.port)
        assert (VENT in told(running)) == ignores
    tick, value = passed(study, "large", key, at, rate)
    at = at if value > 0.0 else -at
    assert len(ended) == 1
    unit, per = ("rad", "/s" if rate else "") if key == "s1" else ("v", "/s" if rate else "")
    found_said, by, limit = (spoken(one, unit) + per for one in (value, abs(value - at), at))
    when = f"at tick {tick} ({tick / 1000.0:.3f} s)"
    assert ended[0].startswith(f"large: {words} {when}: {found_said}, by {by} beyond {limit}")
    assert ("the target did not act, the host vented it" in ended[0]) == ignores
    assert finished(run) == {"small", "large", "after"}  # emulated: armed anew
    found, expected = table(run, "large", injection), simulated(study, "large")
    assert found["s1"].size == tick + 1
    for one in ("s1", "r1"):
        np.testing.assert_array_equal(found[one], expected[one][: tick + 1])
    np.testing.assert_array_equal(table(run, "after")["u1"], simulated(study, "after")["u1"])


@pytest.mark.long
@pytest.mark.parametrize("on_limit", ["vent", "hold"])
def test_a_real_machine_stops_there_and_waits_for_a_person(tmp_path, on_limit):
    text = study_text(
        *AT_THE_PLANT, target=(*REAL, f'on_limit = "{on_limit}"'), angle="low_rad = -3.0, high_rad = 0.16"
    )
    study, run = write_study(tmp_path, text), tmp_path / "run"
    with Running(real) as running:
        words = ("measure", study, "--out", run, "--port", running.port, "--arm")
        code, _, error = command(*words)
        assert code == 1
        way = "vented at a limit" if on_limit == "vent" else "held at a limit and was vented after it"
        assert f"the machine {way}, and 1 of 3 recordings were not made" in error
        assert "received after; look at the machine and clear the fault (loopshape stop tcp://" in error
        assert finished(run) == {"small", "large"}
        assert "limit of angle1_rad at tick" in ls.read(run).recording("large").info.ended_early
        assert (running.target.state, running.target.held) == (FAULT, False)  # nothing is held without a host
        assert (VENT in told(running)) == (on_limit == "hold")
        code, _, error = command(*words)
        assert code == 2
        assert "the target is not idle; received fault, limit; look at the machine, then `loopshape stop" in error
        assert command("stop", running.port, "--clear")[0] == 0
        assert (running.target.state, running.target.held) == (IDLE, False)
        running.target.machine.place([0.3])  # vented it may have come back within the limits
        with pytest.raises(
            ls.errors.RigError, match=r"refuses ARM; received out of range: angle1_rad is 0\.\d+, outside"
        ):
            measured(study, run, running.port)
        running.target.machine.place([0.0])  # by hand
        code, _, error = command(*words)
        assert code == 1
        assert "large: limit of angle1_rad at tick" in error
    assert finished(run) == {"small", "large", "after"}
    code, said, _ = command("verify", run)
    assert code == 0, said


def test_a_last_recording_at_a_limit_is_an_end_at_a_limit_too(tmp_path):
    text = study_text(*AT_THE_PLANT[:2], target=REAL, angle="low_rad = -3.0, high_rad = 0.16")
    study = write_study(tmp_path, text)
    with Running(real) as running:
        code, said, _ = command("measure", study, "--out", tmp_path / "run", "--port", running.port, "--arm", "--json")
        assert code == 1
        warnings = json.loads(said)["warnings"]
        assert any(
            one.startswith("the machine vented at a limit in the last recording; received limit of") for one in warnings
        )
        assert any(one.startswith("large: limit of angle1_rad") for one in warnings)


def test_a_limit_on_the_way_to_a_recording_is_said(tmp_path):
    text = study_text(target=REAL, angle="low_rad = -3.0, high_rad = 3.0, rate_rad_s = 0.02")
    with (
        Running(real) as running,
        pytest.raises(
            ls.errors.RigError,
            match=r"way to 'one'; received fault, rate limit of angle1_rad at tick \d+ .* beyond 1\.146 deg/s",
        ),
    ):
        measured(write_study(tmp_path, text), tmp_path / "run", running.port)
    assert finished(tmp_path / "run") == set()


def test_an_operating_point_beyond_the_limits_is_refused_before_anything_moves(tmp_path):
    text = study_text(target=REAL, angle="low_rad = -0.05, high_rad = 0.05")
    sentence = "the setpoint of axis1 in 'one' lies outside its limits; received 5.73 deg, limits -2.865 to 2.865 deg"
    with Running(real) as running, pytest.raises(ls.errors.WrongUseError, match=sentence):
        measured(write_study(tmp_path, text), tmp_path / "run", running.port)
    assert not {ARM, SETPOINT, BEGIN, GO} & set(told(running))


LONG = study_text(
    experiment("short", period_s=0.25), experiment("long", periods=120), experiment("after"),
    target=(*REAL, "watchdog_ms = 1000"),
)  # fmt: skip


@contextmanager
def started(study, run, port, *, ignoring=False):
    """`loopshape measure` as a process of its own; `ignoring` Ctrl-C, as a shell starts it in the background."""
    words = [sys.executable, "-m", "loopshape.cli.main", "measure", study, "--out", run, "--port", port, "--arm"]
    before = signal.signal(signal.SIGINT, signal.SIG_IGN if ignoring else signal.default_int_handler)
    try:
        process = subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finally:
        signal.signal(signal.SIGINT, before)
    with process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.long
@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM", "SIGHUP", "stop", "SIGKILL"])
def test_whatever_ends_the_host_the_machine_is_vented(tmp_path, how):
    study, run = write_study(tmp_path, LONG), tmp_path / "run"
    with Running(real) as running, started(study, run, running.port, ignoring=how == "stop") as process:
        until(lambda: finished(run) == {"short"} and running.target.state == RUNNING, process=process)
        until(lambda: running.target.recording.tick > 100)
        if how == "stop":
            code, said, _ = command("stop", run)
            assert code == 0
            assert f"process {process.pid} was asked to stop" in said
        else:
            process.send_signal(getattr(signal, how))
        _, error = process.communicate(timeout=10)
        until(lambda: running.target.state == FAULT, 4.0)
        if how == "SIGKILL":
            assert VENT not in told(running)
            assert running.target.fault == BY_WATCHDOG
        else:
            assert process.returncode == 130
            assert VENT in told(running)
            assert "stopped and vented" in error
            assert "Traceback" not in error
            assert not (run / MARK).exists()
        assert finished(run) == {"short"}
        assert ls.read(run).recording("short").info.ended_early is None
        if how == "SIGKILL":
            assert command("stop", running.port, "--clear")[0] == 0
            text = LONG.replace("periods = 120", "periods = 2")
            with pytest.raises(
                ls.errors.WrongUseError, match="already holds another run"
            ):  # another study is another run
                measured(write_study(tmp_path, text), run, running.port)
    assert command("verify", run)[0] == 0


def test_a_second_interrupt_does_not_disturb_the_vent():
    before = signal.getsignal(signal.SIGINT)
    with interrupts():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_stop_through_a_port(tmp_path):
    with Running(real) as running:
        code, said, _ = command("stop", running.port)
        assert (code, running.target.state) == (0, FAULT)
        assert "vented; the target is in state fault" in said
        assert told(running)[0] == VENT  # before any question
        code, said, _ = command("stop", running.port, "--clear", "--json")
        assert (code, running.target.state) == (0, IDLE)
        assert json.loads(said) == {"done": "vented; the target is in state idle"}
    code, _, error = command("stop", tmp_path, "--clear")
    assert (code, "cleared through the target's port" in error) == (2, True)
    code, _, error = command("stop", tmp_path)
    assert (code, "nothing is measured into this run" in error) == (2, True)


def test_the_reference_moves_no_faster_than_the_soft_start(tmp_path):
    seen = []

    def watched():
        one = real()
        tick = one.tick
        one.tick = lambda: (tick(), seen.append((one.state, list(getattr(one, "reference", [0.0])))))[0]
        return one

    text = study_text(target=("place = false", "settle_s = 0.1", "soft_start_s = 0.4"))
    with Running(watched) as running:
        measured(write_study(tmp_path, text), tmp_path / "run", running.port)
    moved = np.array([r[0] for state, r in seen if state == ARMED])
    assert np.abs(np.diff(moved)).max() <= 0.1 / 400 * 1.01
    assert abs(moved[0]) < 0.01  # bumpless: it starts where the machine is
    assert moved[-1] == 0.1
    assert running.target.state == IDLE


def test_a_target_that_understood_something_else_is_not_armed(tmp_path):
    def another():
        one = real()
        ready = one._ready
        one._ready = lambda payload: bytes(b ^ 1 for b in ready(payload))
        return one

    with Running(another) as running:
        with pytest.raises(
            ls.errors.RigError, match=r"understood another configuration; received digest .*; do not arm it"
        ):
            measured(write_study(tmp_path, study_text(target=REAL)), tmp_path / "run", running.port)
        assert ARM not in told(running)


@pytest.mark.parametrize("state", [ARMED, FAULT])
def test_a_real_target_that_is_not_idle_is_left_alone(tmp_path, state):
    def busy():
        one = real()
        one.state = state
        one._watch = one.watch
        one.watch = lambda: None
        one.tick = lambda: None
        return one

    with Running(busy) as running:
        with pytest.raises(ls.errors.RigError, match="the target is not idle"):
            measured(write_study(tmp_path, study_text(target=REAL)), tmp_path / "run", running.port)
        assert set(told(running)) == {1, ALIVE}
        assert running.target.state == state


def test_a_host_that_writes_for_long_is_still_there(tmp_path, monkeypatch):
    from loopshape.io.run import run_folder

    add = run_folder.add_recording
    monkeypatch.setattr(run_folder, "add_recording", lambda *a, **k: (time.sleep(1.5), add(*a, **k)))
    text = study_text(*EXPERIMENTS[::2], target=(*REAL, "watchdog_ms = 500"))
    with Running(real) as running:
        measured(write_study(tmp_path, text), tmp_path / "run", running.port)
    assert finished(tmp_path / "run") == {"small", "after"}


def test_a_run_that_is_whole_needs_no_target(tmp_path):
    study, run = write_study(tmp_path, study_text()), tmp_path / "run"
    with Running(target) as running:
        code, said, _ = command("measure", study, "--out", run, "--port", running.port, "--arm", "--json")
        assert code == 0
        assert json.loads(said)["frfs"][0]["recording"] == "one"
    code, said, error = command("measure", study, "--out", run, "--port", "tcp://127.0.0.1:1", "--quiet")
    assert (code, said, error) == (0, "", "")
    assert command("verify", run, "--study", study)[0] == 0


def test_while_one_measures_another_is_refused_and_disturbs_nothing(tmp_path):
    study, run = write_study(tmp_path, LONG), tmp_path / "run"
    with Running(real) as running, started(study, run, running.port) as process:
        until(lambda: finished(run) == {"short"}, process=process)
        with pytest.raises(ls.errors.WrongUseError, match="another process is writing this run"):
            measured(study, run, running.port)
        assert (run / MARK).exists()
        assert command("stop", run)[0] == 0
        process.communicate(timeout=10)
        assert process.returncode == 130


def test_sentences_come_in_three_breaths(tmp_path):
    said = []
    for make, text in (
        (real, study_text(target=REAL, angle="low_rad = -0.05, high_rad = 0.05")),
        (lambda: real(most_sections=1), study_text(target=REAL)),
        (lambda: real(most_loops=0), study_text(target=REAL)),
        (lambda: real(number_bytes=3), study_text(target=REAL)),
    ):
        with Running(make) as running, pytest.raises(ls.LoopshapeError) as caught:
            measured(write_study(tmp_path, text), tmp_path / "run", running.port)
        said.append(caught.value)
    for one in said:
        assert all((one.what, one.received, one.way_out)), one


def shown(study, run, running, *more):
    """What --show says and warns of; nothing moves."""
    code, said, warned = command("measure", study, "--out", run, "--port", running.port, "--show", *more)
    assert not {ARM, SETPOINT, BEGIN, GO} & set(told(running))
    return code, said, warned


NARROW = {"angle": "low_rad = -0.7, high_rad = 0.7"}
SLOW = {"drive": "low_v = -40.0, high_v = 40.0, rate_v_s = 500.0"}
BEYOND = [
    ("controller_input", "rad", 1.0, NARROW, "the excitation of axis1 in 'one' asks for what lies outside"),
    ("plant_input", "v", 60.0, {}, "the excitation in 'one' passes the limits of drive1_v by itself"),
    ("control", "v", 45.0, {}, "the excitation in 'one' passes the limits of drive1_v by itself"),
    ("control", "v", 20.0, SLOW, "the excitation in 'one' changes drive1_v faster than its limit"),
]


@pytest.mark.parametrize(("injection", "unit", "amplitude", "limits", "words"), BEYOND)
def test_an_excitation_beyond_the_limits_is_refused_before_anything_moves(
    tmp_path, injection, unit, amplitude, limits, words
):
    """Shown or armed; a twentieth of it is not refused."""
    for part, refused in ((1.0, True), (0.05, False)):
        folder = tmp_path / str(part)
        folder.mkdir()
        asked = experiment(injection=injection, unit=unit, amplitude=part * amplitude)
        study = write_study(folder, study_text(asked, target=REAL, **limits))
        with Running(real) as running:
            code, _, why = shown(study, folder / "run", running)
            assert (code, words in why) == ((2, True) if refused else (0, False)), why
            if refused:
                with pytest.raises(ls.errors.WrongUseError, match=words):
                    measured(study, folder / "run", running.port)
                assert ARM not in told(running)


def verdict_on(folder, study, outcome="passed", gain=1.0, loop="axis1"):
    """A kept verdict on the study's controller, its gain multiplied by a factor."""
    gains, *rest = read_study(study).loops[0].controller.blocks
    blocks = (Block("gain", {"gain": gain * gains.parameters["gain"]}), *rest)
    one = checked({"one": margins()}, [line(outcome=outcome)], loop, ls.Controller("axis1", blocks, 1000.0))
    write_verdicts(folder / "verdict.json", [one])
    return folder / "verdict.json"


def test_without_a_verdict_measuring_says_so(tmp_path):
    study = write_study(tmp_path, study_text(target=REAL))
    with Running(real) as running:
        code, _, warned = shown(study, tmp_path / "run", running)
        assert (code, "loop axis1: no verdict is given on its controller" in warned) == (0, True)
        code, _, warned = shown(study, tmp_path / "run", running, "--verdict", verdict_on(tmp_path, study))
        assert (code, "verdict" in warned) == (0, False)
        ls.rig.measure(study, tmp_path / "run", port=running.port, arm=True)
    (armed,) = [entry for entry in read_journal(tmp_path / "run")[0] if entry["event"] == "armed"]
    assert ["no verdict is given" in note for note in armed["notes"]] == [True]
    assert armed["allow_unverified"] is False


DOUBTFUL = [
    ({"outcome": "failed"}, "loop axis1: the verdict in verdict.json is failed"),
    ({"outcome": "undecided"}, "loop axis1: the verdict in verdict.json is undecided"),
    ({"gain": 500.0}, "loop axis1: the verdict in verdict.json is of another controller"),
    ({"loop": "axis2"}, "loop axis1: no verdict on it in verdict.json"),
]


@pytest.mark.long
@pytest.mark.parametrize(("change", "words"), DOUBTFUL)
def test_a_verdict_that_does_not_pass_these_controllers_is_refused_or_allowed_by_name(tmp_path, change, words):
    study, run = write_study(tmp_path, study_text(target=REAL)), tmp_path / "run"
    kept = verdict_on(tmp_path, study, **change)
    with Running(real) as running:
        code, _, why = shown(study, run, running, "--verdict", kept)
        assert (code, words in why, "--allow-unverified" in why) == (2, True, True)
        armed = ("measure", study, "--out", run, "--port", running.port, "--arm", "--verdict", kept)
        code, _, why = command(*armed)
        assert (code, words in why) == (2, True)
        assert ARM not in told(running)
        assert not run.exists()
        code, _, why = shown(study, run, running, "--verdict", kept, "--allow-unverified")
        assert (code, words in why) == (0, True)
        assert command(*armed, "--allow-unverified")[0] == 0
    (entry,) = [entry for entry in read_journal(run)[0] if entry["event"] == "armed"]
    assert (entry["notes"], entry["allow_unverified"]) == ([words], True)


def circle(gain):
    """A controller that reads what it gave five samples ago: z^5 = -gain."""
    late = ls.Controller("axis1", (Block("gain", {"gain": gain}),), 1000.0, computation_delay_s=5e-3)
    plant = ls.FRF.from_arrays([1.0, 2.0], [1.0, 0.5j], relative_std=0.01)
    parts = (
        ls.diagrams.Part("C", "e", "u", ls.Controller("axis1", (Block("gain", {"gain": 1.0}),), 1000.0)),
        ls.diagrams.Part("L", "u", "w", late), ls.diagrams.Part("P", "u", "y", plant),
    )  # fmt: skip
    wires = {"r": "r_axis1_rad", "y": "angle1_rad", "u": "z1_v"}
    return ls.diagrams.Wired(ls.diagrams.Diagram(parts, {"e": "r - y - w"}, "C"), wires)


@pytest.mark.parametrize("late", [1, 2, 7])
@pytest.mark.parametrize("weight", [-1.2, -0.9, 0.5, 1.05])
def test_the_poles_of_blocks_alone_are_those_of_their_equation(late, weight):
    """v = weight z^-late H v with H = 1/(1 - 0.6 z^-1): z^late - 0.6 z^(late-1) - weight = 0."""
    section = np.array([[1.0, 0.0, 0.0, -0.6, 0.0]])
    equation = np.zeros(late + 1)
    equation[:2] = 1.0, -0.6
    equation[-1] -= weight
    expected = np.abs(np.roots(equation)).max()
    assert own_radius([Computed(((2, weight), (0, 1.0)), section, late)], 2) == pytest.approx(expected, rel=1e-9)
    through = [Computed(((3, weight),), section), Computed(((2, 1.0),), np.zeros((0, 5)), late)]
    assert own_radius(through, 2) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("gain", "stable"), [(0.9, True), (1.2, False)])
def test_a_diagram_that_is_unstable_by_itself_is_refused(tmp_path, gain, stable):
    study = write_study(tmp_path, study_text(target=REAL, point=0.0))
    with Running(real) as running:
        machine, wired = ls.rig.connect(running.port), circle(gain)
        if stable:
            machine.show(study, diagram=wired)
            return
        with pytest.raises(ls.errors.WrongUseError, match=r"alone are unstable, \|z\| = 1\.0371"):  # 1.2 ** 0.2
            machine.show(study, diagram=wired)
        notes = machine.show(study, diagram=wired, allow_unverified=True).notes
        assert any("alone are unstable" in note for note in notes)


def test_an_older_target_is_armed_and_named(tmp_path):
    """It gives no number, and its ARM is the digest alone."""
    study = write_study(tmp_path, study_text(target=REAL))
    with Running(lambda: real(guarded=False)) as running:
        _, _, warned = shown(study, tmp_path / "run", running)
        assert "older than this host: recorded bytes can arm it; build it anew" in warned
        assert measured(study, tmp_path / "run", running.port) == []
    assert finished(tmp_path / "run") == {"one"}
