"""Files written whole or not at all, names that stay in their folder, TOML and JSON that say what is wrong."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import struct
import tokenize
import tomllib
import zipfile
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.json_ready import json_ready
from loopshape.io.input_guard import look, own, refuse_changed
from loopshape.io.toml_text import toml_text

PART = ".part"  # ending of a file that is still being written
_HOST = f"{zlib.crc32(platform.node().encode()):08x}"[:4]
_OF_A_PROCESS = re.compile(rf"\..*\.{_HOST}-(\d+)-[0-9a-f]{{8}}{re.escape(PART)}", re.DOTALL)  # of this machine
_OWN_PARTS: deque[Path] = deque(maxlen=64)  # what this process began to write of late
_LONGEST_TOML = 256 * 1024 * 1024  # bytes; a run of half a million recordings is shorter

#: what readers of damaged or foreign files raise
_DAMAGE: tuple[type[Exception], ...] = (
    OSError, ValueError, TypeError, LookupError, AttributeError, EOFError, ArithmeticError,
    NotImplementedError, RecursionError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile,
    SyntaxError, tokenize.TokenError,  # numpy parses the head of an array as Python
)  # fmt: skip


def short(value: object, limit: int = 160) -> str:
    """A value in one line that fits in a sentence."""
    text = " ".join(str(value).split())
    return text if len(text) <= limit else text[: limit - 3] + "..."


@contextmanager
def reading(path: Path, kind: str, *also: type[Exception]) -> Iterator[None]:
    """Turn what a reader raises over a missing or damaged file into `UnreadableInputError`; every reader stands in it.

    A pipe, a socket or a device is refused before it is opened, and a file that changed since it was read. `kind`
    completes "cannot be read as ..."; `also` are a reader's own exceptions.
    """
    look(path)
    try:
        yield
    except FileNotFoundError:
        raise UnreadableInputError("a file does not exist", str(path), "check its name") from None
    except IsADirectoryError:
        raise UnreadableInputError("a folder stands in the place of a file", str(path), "name the file") from None
    except PermissionError:
        raise UnreadableInputError("a file may not be read", str(path), "ask for permission to read it") from None
    except MemoryError as error:
        raise UnreadableInputError(
            f"memory is not enough to read {path} as {kind}",
            short(error) or "no size",
            "end other programs or read fewer columns; a file of a few kilobytes that asks for it is damaged",
        ) from None
    except (*_DAMAGE, *also) as error:
        raise UnreadableInputError(
            f"{path} cannot be read as {kind}",
            short(error) or type(error).__name__,
            "it is damaged or of another kind: write it again or name another file",
        ) from None


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary file beside `path`, then put it in place in one step.

    `path` holds the old content or the new one, never half of it. A folder or disk that cannot be written
    is refused with `UnreadableInputError`, a path without a name with `WrongUseError`; whatever `write` raises
    leaves no temporary file behind. Nothing is put in place where a file that was read has changed since.
    """
    fill(path, write)()


def fill(path: Path, write: Callable[[Path], None]) -> Callable[[], None]:
    """The first half of `write_whole`, which leaves nothing but the temporary file; gives the second half.

    That half waits for the disk, so another thread may do it meanwhile.
    """
    if not path.name:
        raise WrongUseError("an output file needs a name", f"an empty one or the folder {path}", "name a file")
    part = part_of(path)
    with _or_nothing(part, path):
        clear(path.parent)
        write(part)

    def put_in_place() -> None:
        with _or_nothing(part, path):
            put(part, path)

    return put_in_place


@contextmanager
def _or_nothing(part: Path, path: Path) -> Iterator[None]:
    """What fails or is interrupted leaves no temporary file; says why a path cannot be written."""
    try:
        with writing(path):
            yield
    except BaseException as error:
        with suppress(OSError):
            part.unlink()
        if isinstance(error, UnicodeEncodeError):
            raise WrongUseError("a file's name or its folder's is no text", ascii(str(path)), "rename it") from None
        raise


def put(part: Path, path: Path) -> None:
    """Put a whole file in its place in one step, where no file that was read has changed since."""
    _sync(part)
    refuse_changed()
    own(path)
    os.replace(part, path)
    _sync(path.parent)


def part_of(path: Path) -> Path:
    """Where this process writes what is to stand at a path: a hidden name beside it that no other one takes."""
    part = path.with_name(f".{path.name}.{_HOST}-{os.getpid()}-{os.urandom(4).hex()}{PART}")
    _OWN_PARTS.append(part)
    return part


def remove_own_parts() -> None:
    """Remove what this process is writing: its program is about to end in the midst of it."""
    for part in _OWN_PARTS:
        remove_part(part)


@contextmanager
def staged(folder: Path, what: str) -> Iterator[Path]:
    """A folder within a folder in which files are made that are moved together; gone afterwards."""
    stage = part_of(folder / what)
    clear(folder)
    try:
        make_folder(stage)
        yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)


@cache
def clear(folder: Path) -> None:
    """Remove what processes of this machine that were killed were writing in a folder; looked for once."""
    for left in folder.glob(f".*{PART}"):
        if (found := _OF_A_PROCESS.fullmatch(left.name)) and not _runs(int(found[1])):
            remove_part(left)


def remove_part(left: Path) -> None:
    """Remove a file or folder whose writing was cut short."""
    if left.is_dir() and not left.is_symlink():
        shutil.rmtree(left, ignore_errors=True)
    with suppress(OSError):
        left.unlink()


def _runs(pid: int) -> bool:
    """Whether a process of this number runs; True where the system does not tell."""
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass
    return True


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """A folder or disk that cannot be written is refused with `UnreadableInputError`."""
    try:
        yield
    except OSError as error:
        raise UnreadableInputError(
            f"{path} cannot be written", error.strerror or short(error), "check the folder, its rights and the disk"
        ) from None


def write_all(handle: int, data: bytes) -> None:
    """Write it to its end: a full disk takes a part and says so at the next one only."""
    while data:
        data = data[os.write(handle, data) :]


def leave_memory(path: Path) -> None:
    """Tell the system that a file on the disk is not read soon: the memory that it takes serves the next one."""
    if hasattr(os, "posix_fadvise"):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(handle)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_bytes_whole(path: Path, data: bytes) -> None:
    """Write bytes whole or not at all, making the folder where it is missing."""
    make_folder(path.parent)

    def write(part: Path) -> None:
        part.write_bytes(data)

    write_whole(path, write)


def write_text_whole(path: Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all."""
    write_whole(path, lambda part: _write_text(part, text))


def _write_text(path: Path, text: str) -> None:
    try:
        data = text.encode("utf-8")
    except UnicodeEncodeError as error:
        near = error.object[max(error.start - 20, 0) : error.end + 20]
        raise WrongUseError("a text holds half a character", short(ascii(near)), "write names as UTF-8") from None
    path.write_bytes(data)


def examples_folder() -> Path:
    """The folder of the examples: in an installed package among its modules, in a clone beside them."""
    package = Path(__file__).parents[1]
    installed = package / "examples"
    return installed if installed.is_dir() else package.parent / "examples"


def copy_folder(source: Path, to: Path) -> None:
    """Copy a folder and what lies in it to a new place, without what Python compiled."""
    shutil.copytree(source, to, ignore=shutil.ignore_patterns("__pycache__"))


def make_folder(path: Path) -> None:
    """Make a folder and those above it; refuses where that is not possible."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnreadableInputError(
            f"the folder {path} cannot be made", error.strerror or short(error), "choose another place"
        ) from None


def plain_name(name: object, what: str) -> str:
    """The name itself if it is a plain file name; refuses separators, `..`, absolute paths, hidden names."""
    plain = isinstance(name, str) and 0 < len(name) <= 200 and name == name.strip() and not name.startswith(".")
    if not plain or any(c in '/\\:*?"<>|$^{}' or not c.isprintable() for c in str(name)):
        raise UnreadableInputError(
            f"{what} must be a plain name inside its folder",
            short(repr(name)),
            "leave out folders, separators, leading dots and special characters",
        )
    return str(name)


def inside(folder: Path, name: object, what: str) -> Path:
    """Path of a plain name in a folder; refuses a link that leads out of it."""
    path = folder / plain_name(name, what)
    with reading(path, "a file of its folder"):
        stays = path.resolve().parent == folder.resolve()
    if not stays:
        raise UnreadableInputError(
            f"{what} is a link that leaves its folder", short(repr(name)), "copy the file into the folder"
        )
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file; refuses one that is missing, damaged, or not TOML."""
    with reading(path, "TOML"), path.open("rb") as file:
        data = bytearray()
        while part := file.read(1 << 20):  # all at once would take the room of the longest file
            data += part
            if len(data) > _LONGEST_TOML:
                raise ValueError(f"more than {_LONGEST_TOML} bytes")
        text = data.decode("utf-8-sig")  # some editors put a byte order mark in front
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            _refuse_slip(path, text, str(error))
            raise


#: slips of the pen in TOML that a line shows, and their cure
_SLIPS = (
    (re.compile(r"[\w\"']+\s*=\s*[-+]?\d+,\d+\s*(#.*)?"), "write a decimal point: {}"),
    (re.compile(r".*=\s*[A-Za-zÄÖÜäöüß][^\"'\[\]{}]*(#.*)?"), 'put texts in quotes: "..." (truth is true or false)'),
    (re.compile(r"[\w.\"'-]+\s*:\s*\S.*"), "write key = value"),
)


def _refuse_slip(path: Path, text: str, message: str) -> None:
    """Refuse TOML that a frequent slip of the pen spoils, with its line and the cure; other damage is left to TOML."""
    found = re.search(r"at line (\d+)", message)
    line = text.splitlines()[int(found[1]) - 1].strip() if found else ""
    inner = re.search(r"=\s*([A-Za-z]\w*)\s*[,}]", line)
    if inner and inner[1] not in ("true", "false", "inf", "nan"):
        raise UnreadableInputError(f"{path} is no TOML", short(line), f'put texts in quotes: "{inner[1]}"')
    for pattern, cure in _SLIPS:
        if pattern.fullmatch(line):
            own = line.partition("=")[2].partition("#")[0].strip().replace(",", ".")
            raise UnreadableInputError(f"{path} is no TOML", short(line), cure.replace("{}", short(own)))


def write_toml(path: Path, data: Mapping[str, Any]) -> None:
    """Write a TOML file whole; `None` values are left out."""
    write_text_whole(path, toml_text(data))


def read_json(path: Path) -> Any:
    """Content of a JSON file; refuses one that is missing, damaged, or not JSON."""
    with reading(path, "JSON"):
        return json.loads(path.read_text(encoding="utf-8"))


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file whole.

    Dataclasses become objects and arrays become lists. Numbers that JSON cannot hold become the strings
    "nan", "inf" and "-inf", which `float` reads back.
    """
    write_text_whole(path, json.dumps(json_ready(data), indent=1, allow_nan=False, ensure_ascii=False) + "\n")
