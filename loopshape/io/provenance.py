"""Where a file comes from: versions of what made it, the study, its seed, and hashes of what went in."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from loopshape import __version__
from loopshape.io.files import reading

_LIBRARIES = ("numpy", "scipy", "numba")
KEY = "provenance"
FileHash = Any  # of hashlib, which names no type of it


def versions() -> dict[str, str]:
    """Versions of loopshape, Python, and the libraries that results depend on."""
    return {"loopshape": __version__, "python": platform.python_version()} | {n: _version(n) for n in _LIBRARIES}


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def file_hash(path: Path) -> FileHash:
    """SHA-256 of a file's bytes, to which more can be added; refuses one that cannot be read."""
    with reading(path, "a file"), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256")


def file_sha256(path: Path) -> str:
    """Hash of a file's bytes; refuses one that cannot be read."""
    return file_hash(path).hexdigest()
