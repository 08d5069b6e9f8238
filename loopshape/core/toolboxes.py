"""Toolboxes: what stands beside the bench and is found by the entry points `loopshape.toolboxes`.

Each entry point names one `Toolbox`, made of words alone: what they name is imported when it is used. A package of
somebody else's declares one likewise, in its pyproject.toml:

    [project.entry-points."loopshape.toolboxes"]
    mine = "my_package:TOOLBOX"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Protocol, runtime_checkable

from loopshape.core.errors import WrongUseError

GROUP = "loopshape.toolboxes"


@runtime_checkable
class InFile(Protocol):
    """A noun of a toolbox that `loopshape.write` writes, one or several in a file of its ending."""

    ENDING: ClassVar[str]


@dataclass(frozen=True)
class Command:
    """A command of the program: under which heading of `--help`, its name, its function, an example.

    `at` is "module:function". Commands of one heading are listed by `rank`, then by name.
    """

    heading: str
    name: str
    at: str
    example: str
    rank: float = 100.0


@dataclass(frozen=True)
class Toolbox:
    """What a toolbox adds: its commands, its public names (name to module), and who reads files of which ending.

    `names` are those of `loopshape.<toolbox>`, `verbs` stand beside the bench's own as `loopshape.<name>`. `readers`
    lead from an ending (".xyz") to a function "module:function" that takes a path and gives arrays by name; `loopshape
    import` uses them. `writers` lead from the name of a noun's class ("FRF") to a function that takes a path and the
    noun, for `loopshape.write`; of nouns with an `ENDING` from both ("Prediction.npz") to one that takes several, which
    `files` lead back from the ending for `loopshape.read`. `formats` lead from the first words of a file (`format =
    "mine/1"`) to a function that takes its path and the folder of a run, and gives the noun: of it a block diagram is
    found. `controllers` lead from the key that makes a controller's table another kind ("nodes") to the class that
    reads it, in any file of ours. `comparisons` lead from what was kept ("verdict") to a function that takes its file
    and what a check found now, and gives a `Baseline`. `searches` lead from what a tuning may do besides ("grow") to
    what does it. `parts` lead from a section's title to a function that takes the report of a run and gives its HTML,
    or None. A noun with a method `figure` is drawn by `loopshape.plot`, several of a kind by its `figure_of`. `looks`
    lead from a kind of remark to a function that takes a run, its recordings and their FRFs, and gives `Remark`s:
    `loopshape frf` and `loopshape.estimate` tell them. `pictures` lead from the beginning of a file's name to a
    function that takes a loop's operating points, requirements (or None) and verdict, and gives a figure: `check` and
    `figures` draw it where there are several points.
    From a plant's name in a study, `plants` lead to what makes the simulated rig, `boards` to that of the emulator,
    `effect_pages` to a function that draws what its effects do.
    """

    name: str
    purpose: str
    commands: tuple[Command, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    verbs: Mapping[str, str] = field(default_factory=dict)
    readers: Mapping[str, str] = field(default_factory=dict)
    writers: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    formats: Mapping[str, str] = field(default_factory=dict)
    controllers: Mapping[str, str] = field(default_factory=dict)
    comparisons: Mapping[str, str] = field(default_factory=dict)
    searches: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, str] = field(default_factory=dict)
    looks: Mapping[str, str] = field(default_factory=dict)
    pictures: Mapping[str, str] = field(default_factory=dict)
    plants: Mapping[str, str] = field(default_factory=dict)
    boards: Mapping[str, str] = field(default_factory=dict)
    effect_pages: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Installed:
    """The toolboxes of this installation, by name, and a sentence for each that could not be used."""

    toolboxes: Mapping[str, Toolbox]
    broken: tuple[str, ...]

    def all(self, what: str) -> dict[str, str]:
        """One of the mappings (names, readers, ...) of all toolboxes; ours come first."""
        return {key: at for one in [*self.toolboxes.values()][::-1] for key, at in getattr(one, what).items()}


@cache
def found() -> Installed:
    """What is installed. A toolbox that cannot be loaded, or is none, is left out and said."""
    made: dict[str, Toolbox] = {}
    broken: list[str] = []
    for point in sorted(entry_points(group=GROUP), key=lambda one: (not one.value.startswith("loopshape."), one.name)):
        try:
            made[_new(point.name, made)] = _loaded(point)
        except Exception as error:  # whatever a stranger's module does when it is imported
            broken.append(_sentence(point, error))
    return Installed(made, tuple(broken))


def _new(name: str, made: Mapping[str, Toolbox]) -> str:
    """The name of a toolbox, none of those that are there: nobody replaces ours."""
    if name in made:
        raise ValueError("there is a toolbox of this name")
    return name


def _loaded(point: EntryPoint) -> Toolbox:
    one = point.load()
    if not isinstance(one, Toolbox):
        raise TypeError(f"{point.value} is a {type(one).__name__} and no loopshape.core.toolboxes.Toolbox")
    return one


def _sentence(point: EntryPoint, error: Exception) -> str:
    package = "" if point.dist is None else f" of the package {point.dist.name}"
    reason = f"{type(error).__name__}: {error}".splitlines()[0]
    return f"the toolbox {point.name}{package} was left out: {reason}"


def function_at(place: str) -> Any:
    """What stands at "module:function"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def needed(what: str, key: str, does: str, received: str) -> Any:
    """The function of a toolbox that cannot be done without: what it `does`; refuses where none has it."""
    if (place := found().all(what).get(key)) is None:
        way_out = "install loopshape whole, or leave it out"
        raise WrongUseError(f"no toolbox of this installation {does}", received, way_out)
    return function_at(place)
