"""The examples that travel with the package: studies, maps, requirements and the recordings of the tour."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

from loopshape.core.errors import WrongUseError


def examples_folder() -> Path:
    """The folder of the examples: in an installed package among its modules, in a clone beside them."""
    package = Path(str(files("loopshape")))
    installed = package / "examples"
    return installed if installed.is_dir() else package.parent / "examples"


def copy_examples(to: Path) -> list[Path]:
    """Copy all examples into a new folder; gives the folders in it. Refuses a path that exists."""
    if to.exists():
        raise WrongUseError("the examples are copied into a new folder", f"{to}, which exists", "name another: --out")
    shutil.copytree(examples_folder(), to, ignore=shutil.ignore_patterns("__pycache__"))
    return sorted(path for path in to.iterdir() if path.is_dir())
