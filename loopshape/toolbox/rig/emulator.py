"""The emulated target: the reference target in C with a simulated machine, compiled once and run as a process."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import cast

from loopshape.core.errors import LoopshapeError, WrongUseError
from loopshape.core.folders import cache_folder
from loopshape.core.toolboxes import found
from loopshape.toolbox.rig.registry import declared

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
SOURCES = (
    "bytes.h", "board.h", "target.h", "state.h", "frames.h", "frames.c", "target.c", "configure.c", "loops.c", "run.c",
    "schedule.c", "blocks.c", "stream.c", "trial.c",
)  # fmt: skip
BOARD_SOURCES = ("boards/line.h", "boards/line.c")
FIRMWARE_SOURCES = (
    *SOURCES,
    *(
        f"boards/cortex_m/{name}"
        for name in ("Makefile", "stm32f4.ld", "chip.h", "start.c", "stm32f4.c", "axis.c", "drive.c")
    ),
)


class NoCompilerError(LoopshapeError):
    """There is no C compiler, or it refused the target's sources."""


@dataclass(frozen=True)
class Board:
    """A machine simulated in C behind the target: where its sources lie, and what writes the plant's file.

    `plant_file` takes changed parameters, a point and ticks a second, and gives the text that the program reads.
    """

    package: str
    sources: tuple[str, ...]
    plant_file: Callable[..., str]


def board(name: str | None = None) -> Board:
    """The board that a toolbox declares for a plant, the first of all without a name; refuses another."""
    name = name or min(found().all("boards"))
    return cast("Board", declared("boards", name, "this plant has no emulator"))


@dataclass(frozen=True)
class Emulator:
    """How the emulated target runs. `plant` is the text of the plant's file (`Board.plant_file`) of a board.

    `tcp` is a port of 127.0.0.1 (0: any), None a pseudo-terminal. `drop`, `corrupt` and `duplicate` are probabilities a
    frame of a bad line; `die_after` and `mute_after` count ticks of recordings.
    """

    plant: str
    tcp: int | None = None
    real_time: bool = False
    number_bytes: int = 8
    drop: float = 0.0
    corrupt: float = 0.0
    duplicate: float = 0.0
    seed: int = 0
    die_after: int = 0
    mute_after: int = 0
    board: str | None = None

    def __post_init__(self) -> None:
        if self.number_bytes not in (4, 8):
            raise WrongUseError("numbers in transmission have 4 or 8 bytes", f"{self.number_bytes!r}")
        for name in ("drop", "corrupt", "duplicate"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise WrongUseError(f"{name} is a probability below 1", f"{getattr(self, name)!r}")
        if self.tcp is not None and not 0 <= self.tcp <= 65535:
            raise WrongUseError("a TCP port lies between 0 (any) and 65535", f"{self.tcp!r}")

    def words(self) -> list[str]:
        """Arguments of the program."""
        out = ["--plant", "-", "--until-eof"]
        out += ["--real-time"] if self.real_time else []
        out += ["--tcp", str(self.tcp)] if self.tcp is not None else []
        for name in ("drop", "corrupt", "duplicate", "seed", "die_after", "mute_after"):
            if getattr(self, name):
                out += [f"--{name.replace('_', '-')}", str(getattr(self, name))]
        return out


def sources(one: Board) -> dict[str, bytes]:
    """The C sources of the target and of a board, by the names that they are compiled by."""
    machine = files(one.package)
    made = own_sources((*SOURCES, *BOARD_SOURCES))
    return made | {f"boards/{Path(name).name}": (machine / name).read_bytes() for name in one.sources}


def own_sources(names: Iterable[str]) -> dict[str, bytes]:
    """Files of the target's folder."""
    return {name: (files("loopshape.toolbox.rig") / "c_target" / name).read_bytes() for name in names}


def compiler() -> list[str]:
    """The C compiler's command: `CC`, or cc. Refuses where there is none."""
    command = shlex.split(os.environ.get("CC", "")) or ["cc"]
    if shutil.which(command[0]) is None:
        raise NoCompilerError(
            "the emulator is compiled once on this machine and finds no C compiler",
            repr(command[0]),
            "install gcc or clang, or name one in the environment variable CC",
        )
    return command


def program(number_bytes: int = 8, plant: str | None = None) -> Path:
    """The compiled emulator of a plant; compiles it where this version has not been compiled by this compiler yet."""
    command = [
        *compiler(),
        *FLAGS,
        f"-DTARGET_NUMBER_BYTES={number_bytes}",
        "-DTARGET_ROWS=4096",
        "-DTARGET_TICKS=16384",
        "-DTARGET_POOL=65536",
    ]
    return kept(
        "emulator",
        [*command, version(command[0])],
        sources(board(plant)),
        lambda folder: _compile(command, folder),
    )


def kept(stem: str, words: Iterable[str], code: Mapping[str, bytes], build: Callable[[Path], Path]) -> Path:
    """The program that `build` makes of sources in a folder; built where these words and sources have not been yet."""
    key = hashlib.sha256("\0".join(words).encode())
    for text in code.values():
        key.update(text)
    path = cache_folder() / f"{stem}-{key.hexdigest()[:16]}"
    if path.exists():
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            for name, text in code.items():
                place = Path(folder) / name
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(text)
            os.replace(build(Path(folder)), path)  # whole or not at all
    except OSError as error:
        raise WrongUseError(
            "the emulator cannot be kept where it is compiled to", f"{path.parent}: {error}", "set XDG_CACHE_HOME"
        ) from None
    return path


def version(command: str) -> str:
    """What a compiler says of itself."""
    output = subprocess.run([command, "--version"], capture_output=True, text=True, check=False)
    return output.stdout


def _compile(command: list[str], folder: Path) -> Path:
    units = [str(path) for path in sorted(folder.rglob("*.c"))]
    output = subprocess.run(
        [*command, "-I.", *units, "-o", "made", "-lm"], cwd=folder, capture_output=True, text=True, check=False
    )
    if output.returncode:
        raise NoCompilerError("the emulator does not compile", output.stderr[-800:].strip(), "report it, please")
    return folder / "made"


def start(emulator: Emulator) -> tuple[subprocess.Popen[str], str]:
    """The emulator as a process, and its port: a terminal's path, or tcp://127.0.0.1:PORT. It ends with its input."""
    process = subprocess.Popen(
        [str(program(emulator.number_bytes, emulator.board)), *emulator.words()],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(emulator.plant)
        process.stdin.flush()
    except BrokenPipeError:
        pass  # it says why on its standard error
    port = process.stdout.readline().strip()
    if not port:
        why = stop(process)
        raise WrongUseError("the emulator did not start", why, "look at its options")
    return process, port


def stop(process: subprocess.Popen[str]) -> str:
    """End it, and give what it said on its standard error."""
    process.terminate()
    stop_s = 10.0
    _, output = process.communicate(timeout=stop_s)
    return output.strip()


@contextmanager
def running(emulator: Emulator) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process of an emulator and its port; it is stopped at the end."""
    process, port = start(emulator)
    try:
        yield process, port
    finally:
        stop(process)


@contextmanager
def emulated(emulator: Emulator) -> Iterator[str]:
    """The port of a running emulator; it is stopped at the end."""
    with running(emulator) as (_, port):
        yield port
