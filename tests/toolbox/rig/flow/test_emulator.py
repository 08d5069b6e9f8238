"""The emulated target as a process: compiled once, started, spoken to over good and bad lines, and stopped."""

import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from emulated_cases import emulator, excited, needs_a_compiler, record, settings
from simulated_machines import plant_file
from target_cases import WARNINGS
from typer.testing import CliRunner

import loopshape as ls
from loopshape.core.folders import cache_folder
from loopshape.toolbox.rig import emulator as rig
from loopshape.toolbox.rig.emulator import Emulator, NoCompilerError, program, start, stop
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Request, State
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.target.target import arm as armed
from loopshape.toolbox.rig.target.target import configuration


def test_every_source_lies_in_the_package():
    here = Path(rig.__file__).parent / "c_target"
    code = rig.sources(rig.board())
    listed = {*rig.SOURCES, *rig.BOARD_SOURCES, *rig.FIRMWARE_SOURCES}
    assert listed == {str(p.relative_to(here)) for p in here.rglob("*") if p.is_file() and "build" not in p.parts}
    assert {*code} > {*rig.SOURCES, *rig.BOARD_SOURCES, "boards/arm_emulator.c"}
    assert all(code.values())


def test_a_plant_without_a_board_is_refused():
    with pytest.raises(
        ls.errors.WrongUseError, match=r"this plant has no emulator; received 'servo-axis'; use one of arm-1dof"
    ):
        rig.board("servo-axis")


def test_it_is_compiled_once(tmp_path, monkeypatch):
    needs_a_compiler()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = program()
    assert made.parent == cache_folder() == tmp_path / "loopshape"
    written = made.stat().st_mtime_ns
    monkeypatch.setattr(rig, "_compile", lambda *words: pytest.fail("compiled again"))
    assert program() == made
    assert made.stat().st_mtime_ns == written
    assert [p.name for p in made.parent.iterdir()] == [made.name]


def test_without_a_compiler_it_says_so(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(
        NoCompilerError, match=r"finds no C compiler; received 'no-such-compiler'; install gcc or clang"
    ):
        program()


def test_a_compiler_that_fails_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", "false")
    with pytest.raises(NoCompilerError, match="does not compile"):
        program()
    assert list((tmp_path / "loopshape").iterdir()) == []


def test_effects_that_it_does_not_know_are_refused():
    with pytest.raises(ls.errors.WrongUseError, match=r"does not know every effect; received coulomb_nm"):
        plant_file({"coulomb_nm": 0.2, "payload_kg": 0.1})


@pytest.mark.parametrize("words", [{"number_bytes": 2}, {"drop": 1.0}, {"corrupt": -0.1}, {"tcp": 70000}])
def test_options_out_of_range_are_refused(words):
    with pytest.raises(ls.errors.WrongUseError):
        Emulator(plant_file(), **words)


def test_a_plant_without_a_rest_does_not_start():
    needs_a_compiler()
    with pytest.raises(ls.errors.WrongUseError, match="cannot stand there"):
        plant_file(start={"theta2_deg": 80.0})
    text = re.sub("start .*", "start 1.4 1.0", plant_file())
    with pytest.raises(ls.errors.WrongUseError, match="no rest where it shall start"):
        start(Emulator(text))


@pytest.mark.parametrize("bytes_each", [4, 8])
def test_its_sources_compile_without_a_warning(tmp_path, bytes_each):
    needs_a_compiler()
    (tmp_path / "boards").mkdir()
    for name, text in rig.sources(rig.board()).items():
        (tmp_path / name).write_bytes(text)
    units = [*tmp_path.rglob("*.c")]
    flags = [*WARNINGS, f"-DTARGET_NUMBER_BYTES={bytes_each}", "-I", tmp_path, "-o", tmp_path / "made", "-lm"]
    subprocess.run([*rig.compiler(), *units, *flags], check=True)


def test_a_folder_that_cannot_be_written_is_an_error_in_words(tmp_path, monkeypatch):
    needs_a_compiler()
    (tmp_path / "loopshape").write_text("a file in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(ls.errors.WrongUseError, match="set XDG_CACHE_HOME"):
        program()


@pytest.mark.parametrize(
    ("text", "said"),
    [("end", "a word is missing"), ("foo 1", "unknown word"), ("start 1", "a number is missing"),
     ("start 1 2 3", "too many numbers")],
)  # fmt: skip
def test_a_damaged_plants_file_is_refused(text, said):
    needs_a_compiler()
    whole = f"loopshape-plant 1\n{text}\n"
    command = [program(), "--plant", "-"]
    ran = subprocess.run(command, input=whole, capture_output=True, text=True, check=False, timeout=10)
    assert ran.returncode == 2
    assert said in ran.stderr


@pytest.mark.parametrize("address", ["0.0.0.0:5000", "192.168.1.2:0", "example.org:80", "::1:5000", "99999", "x"])
def test_tcp_beyond_this_machine_is_refused(address):
    needs_a_compiler()
    command = [str(program()), "--plant", "-", "--tcp", address]
    ran = subprocess.run(command, input=plant_file(), capture_output=True, text=True, check=False, timeout=10)
    assert ran.returncode == 2
    assert "127.0.0.1 alone" in ran.stderr or "a number in its range" in ran.stderr


def addresses():
    """Other addresses of this machine than 127.0.0.1."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
            return [probe.getsockname()[0], "127.0.0.2"]
        except OSError:
            return ["127.0.0.2"]


def test_it_listens_on_one_address_alone_and_to_one_host():
    with emulator(tcp=0) as port:
        number = int(re.fullmatch(r"tcp://127\.0\.0\.1:(\d+)", port)[1])
        for other in addresses():
            with pytest.raises(OSError), socket.create_connection((other, number), timeout=1.0):
                pass
        with open_link(port, 0) as link:
            session = Session(link)
            with (
                session.kept_alive(0.2),
                socket.create_connection(("127.0.0.1", number), timeout=4.0) as second,
            ):
                assert second.recv(1) == b""  # sent away
            assert session.status().state is State.IDLE
        with open_link(port, 0) as link:
            assert Session(link).status().state is State.IDLE


def test_it_ends_with_whoever_started_it():
    needs_a_compiler()
    process, _ = start(Emulator(plant_file()))
    process.stdin.close()
    assert process.wait(5) == 0
    process.stdout.close()
    process.stderr.close()


def test_a_bad_line_loses_nothing(arm, arm_experiment):
    e = excited(arm_experiment, 2500)
    with emulator(drop=0.02, corrupt=0.02, duplicate=0.05, seed=4) as port:
        (found,) = record(port, [e])
    (expected,) = arm.simulate([e])
    for name in expected.columns:
        np.testing.assert_allclose(found.column(name), expected.column(name), atol=1e-9)


@pytest.mark.parametrize("how", ["die_after", "mute_after"])
def test_a_target_that_dies_or_falls_silent_is_an_error_in_words(arm_experiment, how):
    e = excited(arm_experiment, 3000)
    with emulator(**{how: 500}) as port, pytest.raises(ls.errors.RigError, match=r"lost|does not answer|answers"):
        record(port, [e], watchdog_ms=1000)


def test_a_host_that_vanishes_finds_the_machine_safe(arm_experiment):
    e = excited(arm_experiment, 10)
    with emulator() as port:
        wanted = settings(watchdog_ms=100)
        with open_link(port, 0) as link:
            session = Session(link)
            armed(session, wanted, e.loops, configuration(session.identity, e.loops, wanted, 1000.0, {}))
            assert session.status().state is State.ARMED
        time.sleep(0.25)
        with open_link(port, 0) as link:
            status = Session(link).status()
            assert (status.state, status.fault) == (State.FAULT, 4)


def test_in_real_time_a_second_takes_a_second(arm, arm_experiment):
    e = excited(arm_experiment, 800)
    with emulator(real_time=True) as port:
        begun = time.monotonic()
        (found,) = record(port, [e])
        took = time.monotonic() - begun
    assert 0.78 < took < 3.0
    (expected,) = arm.simulate([e])
    if found.info.ended_early is None:  # a machine that is too busy for 50 ms may be late with a row
        np.testing.assert_allclose(found.column("theta2_rad"), expected.column("theta2_rad"), atol=1e-9)


def test_without_placing_it_moves_there_softly_and_stays(arm_experiment):
    made = [arm_experiment((4.0, 1.05), 400), arm_experiment((4.0, 1.05), 400)]
    with emulator() as port:
        first, second = record(port, made, place=False, soft_start_s=0.5, settle_s=0.5)
    for found in (first, second):
        assert found.info.ended_early is None
        assert np.abs(np.degrees(found.column("theta2_rad")) - 4.0).max() < 1.0
        assert np.abs(found.column("p_a_bar") + found.column("p_b_bar") - 1.05).max() < 0.05


def test_vented_the_muscles_empty_and_idle_it_stands_again(arm_experiment):
    loops = arm_experiment((0.0, 1.0), 1).loops
    with emulator(real_time=True) as port, open_link(port, 0) as link:
        session = Session(link)
        armed(session, settings(), loops, configuration(session.identity, loops, settings(), 1000.0, {}))
        before = session.status().sensors
        session.ask(Request.VENT)
        time.sleep(0.1)
        vented = session.status().sensors
        assert vented[1] < 0.9 * before[1]
        session.ask(Request.CLEAR)
        time.sleep(0.02)
        np.testing.assert_allclose(session.status().sensors, before, atol=0.02)


@pytest.mark.long
@pytest.mark.parametrize("ignoring", [False, True])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_command_prints_the_port_and_runs_until_it_is_told_to_end(how, ignoring):
    """Also where Ctrl-C's signal was ignored as it was started, as a shell does in the background."""
    needs_a_compiler()
    code = "import typer; from loopshape.toolbox.rig.commands.emulator import emulator; typer.run(emulator)"
    command = [sys.executable, "-c", code, "--tcp", "0", "--change", "payload_kg=0.1"]
    before = signal.signal(signal.SIGINT, signal.SIG_IGN if ignoring else signal.default_int_handler)
    try:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    finally:
        signal.signal(signal.SIGINT, before)
    with process:
        try:
            port = process.stdout.readline().strip()
            with open_link(port, 0) as link:
                assert Session(link).identity.board == "arm-1dof emulator"
            process.send_signal(how)
            assert process.wait(10) == 0
        finally:
            process.kill()
    with pytest.raises(ls.errors.RigError, match="no target answers there"):
        open_link(port, 0)


def test_the_command_refuses_what_is_no_change():
    import typer

    from loopshape.toolbox.rig.commands.emulator import emulator as command

    app = typer.Typer()
    app.command()(command)
    answer = CliRunner().invoke(app, ["--change", "payload_kg"])
    assert isinstance(answer.exception, ls.LoopshapeError)
    assert "a parameter and its value" in str(answer.exception)


def test_what_is_stopped_says_its_last_words():
    needs_a_compiler()
    process, port = start(Emulator(plant_file()))
    assert port.startswith("/dev/")
    assert stop(process) == ""
    assert process.returncode == -signal.SIGTERM
