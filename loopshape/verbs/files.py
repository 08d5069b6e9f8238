"""Nouns out of files and into them: tables of other programs, FRFs, controllers, requirements."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.core.errors import WrongUseError
from loopshape.core.toolboxes import InFile
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.requirement.profile import Profile
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.run import Run
from loopshape.verbs.arguments import controller_of

if TYPE_CHECKING:
    from loopshape.design.tune import Tuning
    from loopshape.io.run.verify import Finding

_READERS = {
    ".json": "loopshape.io.write.verdicts:read_verdicts",
    ".toml": "loopshape.io.write.controllers:read_loop_controllers",
}
_FORMATS = {
    "loopshape-requirements": "loopshape.io.requirements:read_whole",
    "loopshape-profiles": "loopshape.io.requirements:read_profiles",
    "loopshape-fits": "loopshape.io.write.fits:read_fits",
    "loopshape-verdict": "loopshape.io.write.verdicts:read_verdicts",
}


def read(path: str | Path) -> Any:
    """What `write` and the commands wrote: the run in a folder, whose columns load when asked for, or a file's nouns.

    Controllers and schedules, or requirements, one a loop and those of all together last (.toml), predictions (.npz),
    verdicts or fits (.json), profiles by name, or one FRF (.csv, .mat, .uff, ...). Raises UnreadableInputError for what
    holds none of these or is damaged.

    Examples
    --------
    >>> import loopshape as ls, tempfile
    >>> C = ls.controller(ls.gain(2.0), rate_hz=1000.0, loop="x")
    >>> ls.read(ls.write(C, f"{tempfile.mkdtemp()}/controller.toml"))[0].blocks == C.blocks
    True
    """
    from loopshape.core.toolboxes import found, function_at
    from loopshape.io.files import read_json, read_toml
    from loopshape.io.run.run_folder import read_run

    place = Path(path)
    if place.is_dir() or not place.suffix:
        return read_run(place)
    kind = place.suffix.lower()
    if kind in (".toml", ".json"):
        words = (read_toml if kind == ".toml" else read_json)(place)
        named = str(words.get("format") if isinstance(words, dict) else None).split("/")[0]
        return function_at(_FORMATS.get(named, _READERS[kind]))(place)
    known, other = _READERS | found().all("files"), found().all("names").get("read_frf")
    if kind not in known and other is None:
        raise WrongUseError("a file of this kind is not read", str(path), f"give a folder, or {', '.join(known)}")
    return function_at(known.get(kind, f"{other}:read_frf"))(place)


def read_controllers(file: str | Path) -> tuple[Controller, ...]:
    """The controllers in a controller file (TOML), one a loop. Raises UnreadableInputError for another file."""
    from loopshape.io.write.controllers import read_controllers as read_file

    return read_file(Path(file))


def read_requirements(file: str | Path) -> tuple[Requirements, ...]:
    """The requirements in a file (TOML), one a loop. Raises UnreadableInputError for another file."""
    from loopshape.io.requirements import read_requirements as read_file

    return read_file(Path(file))


def profiles(file: str | Path | None = None) -> dict[str, Profile]:
    """Limits of standards and of practice by name, or those of a file (TOML, as `loopshape profiles --out` writes it).

    `profile.joined(R)` are requirements under which both hold. Raises UnreadableInputError for another file.

    Examples
    --------
    >>> import loopshape as ls
    >>> ls.profiles()["servo"].joined(ls.Requirements(phase_margin_deg=45))
    Requirements: phase_margin_deg at least 45, modulus_margin at least 0.5, sensitivity_peak_db at most 6
    """
    from loopshape.io.requirements import OWN, read_profiles

    return read_profiles(OWN if file is None else Path(file))


def write_profiles(path: str | Path) -> Path:
    """Write the file of profiles that comes along, to be changed; gives the path. Refuses one that is there."""
    from loopshape.io.files import make_folder, write_text_whole
    from loopshape.io.requirements import OWN

    out = Path(path)
    if out.exists():
        raise WrongUseError(f"{out} is there already", "profiles are not written over a file", "give another name")
    make_folder(out.parent)
    write_text_whole(out, OWN.read_text(encoding="utf-8"))
    return out


def verify(folder: str | Path, study: str | Path | None = None) -> list[Finding]:
    """Whether a run's files are those that were written, and whether a study is the one that it was made by."""
    from loopshape.io.run.verify import verify as look

    return look(Path(folder), None if study is None else Path(study))


def copy_examples(to: str | Path) -> list[Path]:
    """Copy the package's examples into a new folder; gives the folders in it. Refuses a path that exists."""
    from loopshape.io.files import copy_folder, examples_folder

    if Path(to).exists():
        raise WrongUseError("the examples are copied into a new folder", f"{to}, which exists", "name another: --out")
    copy_folder(examples_folder(), Path(to))
    return sorted(path for path in Path(to).iterdir() if path.is_dir())


def write(
    what: Run
    | Controller
    | Scheduled
    | Tuning
    | FRF
    | Fit
    | InFile
    | Profile
    | Requirements
    | Verdict
    | Sequence[Controller | Scheduled | Tuning | Fit | InFile | Profile | Requirements | Verdict],
    path: str | Path,
) -> Path:
    """Write one thing whole, so that `loopshape` commands and the readers here take it; gives the path.

    A run becomes a folder, an FRF a file of the kind that the ending names (.csv, .mat, .uff), a controller (a
    schedule, what `tune` found), requirements or profiles a file (.toml), a verdict (which `check --baseline` takes) or
    fits one (.json), predictions one (.npz). A sequence of one kind is one file, too: controllers, verdicts and
    requirements one a loop; requirements without a name are those of all loops together. Raises WrongUseError for
    other endings and things, and for what has no form in a file: a weight that is a function.

    Examples
    --------
    >>> import loopshape as ls, tempfile
    >>> R = ls.Requirements("x", phase_margin_deg=45, masks=(ls.Mask("S", ((0.1, -40.0), (10.0, 0.0))),))
    >>> ls.read(ls.write(R, f"{tempfile.mkdtemp()}/requirements.toml"))
    (Requirements x: phase_margin_deg at least 45, sensitivity_mask_db at most 0,)
    """
    from loopshape.core.toolboxes import found, function_at
    from loopshape.io.run.run_folder import write_run

    target = Path(path)
    every: Any = what if isinstance(what, list | tuple) else [what]
    if place := found().all("writers").get(type(what).__name__):
        function_at(place)(target, what)
    elif isinstance(what, Run):
        write_run(target, what)
    else:
        _write_all(target, [*map(controller_of, every)])
    return target


#: the nouns of a file, its ending, and what writes them
_WRITERS: tuple[tuple[type | tuple[type, ...], str, str], ...] = (
    ((Controller, Scheduled), ".toml", "loopshape.io.write.controllers:write_controllers"),
    (Requirements, ".toml", "loopshape.io.requirements:write_requirements"),
    (Profile, ".toml", "loopshape.io.requirements:write_profiles"),
    (Verdict, ".json", "loopshape.io.write.verdicts:write_verdicts"),
    (Fit, ".json", "loopshape.io.write.fits:write_fits"),
)


def _write_all(target: Path, every: list[Any]) -> None:
    """Write nouns of one kind; refuses others and another ending."""
    from loopshape.core.toolboxes import found, function_at

    first = next(iter(every), None)
    place = found().all("writers").get(f"{type(first).__name__}{getattr(first, 'ENDING', None)}")
    own = ((type(first), first.ENDING, place),) if first is not None and place else ()
    for kinds, ending, place in (*_WRITERS, *own):
        if all(isinstance(one, kinds) for one in every):
            if target.suffix.lower() != ending:
                raise WrongUseError(f"this is written as {ending}", target.name, f"name it {target.stem}{ending}")
            return function_at(place)(target, every)
    names = ", ".join(dict.fromkeys(type(one).__name__ for one in every))
    known = "controllers, requirements, profiles, predictions, verdicts or fits"
    if len(every) > 1:
        raise WrongUseError(f"one file holds {known}", names, "write others one by one")
    raise WrongUseError("there is no file for this", names, f"give a Run, an FRF, or {known}")
