"""The one way our kernels are compiled, and kept on disk under names made from the source of all that they are made of.

With NUMBA_DISABLE_JIT=1 the plain functions beneath run instead. numba's own cache looks at a kernel's file and not at
the files it calls into: an edited callee ran as it was before. It also numbers its files by an index, which two
processes that compile at once write over for each other. Here a compiled form is one file, whole or absent, named by
its key; what its source does not name any more is removed.
"""

from __future__ import annotations

import hashlib
import inspect
import logging
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys
from numpy.typing import NDArray

from loopshape.core.folders import cache_folder

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
F = TypeVar("F", bound=Callable[..., Any])
PACKAGE = Path(__file__).resolve().parents[2]
#: `from a.b import c, d`, over several lines too, or `import a.b`
_IMPORTS = re.compile(r"^[ \t]*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n#]*)|import\s+([\w.]+))", re.MULTILINE)

#: what is imported for types alone: it does not run
_FOR_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:(?:[ \t].*)?\n)+", re.MULTILINE)


def compiled(function: F) -> F:
    """Compile with numba: kept on disk, without the interpreter's lock, IEEE division, contraction allowed."""
    return _compile(function)


def compiled_in_line(function: F) -> F:
    """As `compiled`, and put into its callers' code: for what a kernel calls many times a step."""
    return _compile(function, forceinline=True)


def compiled_reading(*written: str) -> Callable[[F], F]:
    """As `compiled`, for a kernel that writes into the arguments `written` alone.

    Kernels that call it share the form for read-only arrays, whether theirs may be written to or not.
    """
    return lambda function: _compile(function, written)


def _compile(function: F, written: tuple[str, ...] | None = None, **options: bool) -> F:
    """Compiled, with the ways in that somebody takes: none for C, none for Python where a kernel's name says so."""
    within = function.__name__.startswith("_") and function.__module__.startswith(f"{__package__}.")
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": within}  # a tenth of the time
    dispatcher = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"}, **options)(function)
    if dispatcher is not function:
        dispatcher._cache = keep(function) or dispatcher._cache
        _share_forms(dispatcher, written)
        if within:
            _refuse_python(dispatcher)
    return cast(F, dispatcher)


def _refuse_python(dispatcher: Any) -> None:
    """A kernel without a way in from Python: a call from there would end the process, and is refused."""

    def refuse(*_: Any, **__: Any) -> None:
        raise TypeError(f"{dispatcher.py_func.__qualname__} is called by kernels alone")

    dispatcher._compile_for_args = refuse
    dispatcher.add_overload = lambda made: dispatcher.overloads.update({tuple(made.signature.args): made})


def _share_forms(dispatcher: Any, written: tuple[str, ...] | None) -> None:
    """Kernels that call this one with 2 and with 3 share a compiled form; numba would make one for each constant."""
    names, template = list(inspect.signature(dispatcher.py_func).parameters), dispatcher.get_call_template

    def shared(name: str, kind: Any) -> Any:
        only_read = written is not None and name not in written and isinstance(kind, numba.types.Array)
        return kind.copy(readonly=True) if only_read else numba.types.unliteral(kind)

    def plain(args: Any, kws: Any) -> Any:
        by_place = [shared(name, kind) for name, kind in zip(names, args, strict=False)]
        return template(by_place, {name: shared(name, kind) for name, kind in kws.items()})

    dispatcher.get_call_template = plain


class Kept:
    """What numba's dispatcher asks of a cache, for one function: each signature on each kind of processor a file."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        file = Path(inspect.getfile(function))
        place = hashlib.sha256(str(file).encode()).hexdigest()[:8]
        self._folder = folder
        self._file = f"{function.__module__}-{place}-"
        self._stem = f"{self._file}{source_key(file)}-"
        self._function = function

    @property
    def cache_path(self) -> str:
        """The folder of the compiled forms."""
        return str(self._folder)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The compiled form for a signature; None where there is none or its file is damaged."""
        rtsys.initialize(target)  # what compiled code runs on; the rest of numba is for compiling, and half its start
        data = _whole(self._path(signature, target.codegen()))
        if data is not None:
            return CompileResult._rebuild(target, *pickle.loads(data))
        logging.getLogger("loopshape.kernels").info("compiling %s", self._function.__qualname__)  # seconds, and once
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep a compiled form; a folder that takes no more is no reason to stop. Forms of older source are removed."""
        if result.library.has_dynamic_globals:
            return
        *parts, environments = result._reduce()  # numba's own hold nothing, and each would load the module it is of
        data = numba.core.serialize.dumps((*parts, tuple(one for one in environments if one.consts)))
        try:
            _write_whole(self._path(signature, result.codegen), data)
            self._remove_older()
        except OSError:
            pass

    def flush(self) -> None:
        """Nothing: a new compilation writes over the old one."""

    def _path(self, signature: Any, codegen: Any) -> Path:
        line = self._function.__code__.co_firstlineno
        form = repr((line, signature, codegen.magic_tuple(), numba.__version__, sys.version_info[:2]))
        key = hashlib.sha256(form.encode()).hexdigest()[:16]
        return self._folder / f"{self._stem}{self._function.__qualname__}-{key}"

    def _remove_older(self) -> None:
        for path in self._folder.glob(f"{self._file}*"):
            if not path.name.startswith(self._stem):
                path.unlink(missing_ok=True)


def keep(function: Callable[..., Any]) -> Kept | None:
    """A cache for a function; None where it is made of more than a file's source, or no folder can be written."""
    folder = _folder()
    of_a_file = function.__closure__ is None and Path(inspect.getfile(function)).is_file()
    return Kept(function, folder) if of_a_file and folder is not None else None


@cache
def source_key(file: Path) -> str:
    """Key of the source beneath the functions of a file."""
    key = hashlib.sha256()
    for path in sorted(sources(file)):
        key.update(hashlib.sha256(path.read_bytes()).digest())
    return key.hexdigest()[:16]


def sources(file: Path) -> set[Path]:
    """A file and all that it imports from the package or from beside itself, however deep."""
    found, left = set[Path](), [file]
    while left:
        file = left.pop()
        if file not in found:
            found.add(file)
            left += _imported(file)
    return found


@cache
def _imported(file: Path) -> tuple[Path, ...]:
    """The files that a file imports: the package's by their full names, those beside it by their own."""
    out = []
    for origin, names, plain in _IMPORTS.findall(_FOR_TYPES.sub("", file.read_text(encoding="utf-8"))):
        parts = (origin or plain).split(".")
        base = PACKAGE.parent if parts[0] == PACKAGE.name else file.parent
        module = base.joinpath(*parts)
        paths = [module, *(module / name for name in re.findall(r"\w+", names)), *_above(module, base)]
        out += [f for path in paths for f in (path.with_suffix(".py"), path / "__init__.py") if f.is_file()]
    return tuple(out)


def _above(module: Path, base: Path) -> Iterator[Path]:
    """The packages that a module lies in: Python runs them first."""
    while (module := module.parent) != base and module.is_relative_to(base):
        yield module


@cache
def _folder() -> Path | None:
    """NUMBA_CACHE_DIR, the package's own __pycache__, or the user's cache: the first that can be written."""
    for folder in _folders():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        return folder
    return None


def _folders() -> Iterator[Path]:
    if numba.config.CACHE_DIR:
        yield Path(numba.config.CACHE_DIR) / "loopshape"
    else:
        yield PACKAGE / "__pycache__" / "kernels"
    try:
        yield cache_folder() / "kernels"
    except RuntimeError:  # a user without a home
        return


def _whole(path: Path) -> bytes | None:
    """What was written to a file; None where it is absent, cut short or changed."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return content[32:] if hashlib.sha256(content[32:]).digest() == content[:32] else None


def _write_whole(path: Path, data: bytes) -> None:
    """Write a file that is there as a whole or not at all."""
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f"{path.name}.")
    try:
        with open(handle, "wb") as f:
            f.write(hashlib.sha256(data).digest() + data)
        os.replace(part, path)
    except OSError:
        Path(part).unlink(missing_ok=True)
        raise
