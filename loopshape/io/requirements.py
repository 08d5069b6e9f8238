"""Requirements files: what each loop must keep; and profiles of standards, those of the package and a user's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.data.requirement.profile import Profile
from loopshape.data.requirement.requirements import Requirements
from loopshape.io.config_table import read_file, refuse_doubles
from loopshape.io.files import write_toml
from loopshape.io.schema import table_of

FORMAT = "loopshape-requirements/1"
PROFILES = "loopshape-profiles/1"
#: the profiles that come with the package
OWN = Path(__file__).with_name("profiles.toml")


@dataclass(frozen=True)
class RequirementsFile:
    """What a file requires of each loop, and of all together."""

    loop: tuple[Requirements, ...]
    several: Requirements | None = None

    def __post_init__(self) -> None:
        if not self.loop or not all(one.loop for one in self.loop):
            raise WrongUseError("a requirements file requires nothing", "no [[loop]] with a name", "write one")
        refuse_doubles((one.loop for one in self.loop), "loop", "loops")
        if self.several is not None:
            self.several.of_all()


def read_requirements(path: Path) -> tuple[Requirements, ...]:
    """Requirements of a file, one a loop.

    Refuses another format, unknown keys, values of the wrong kind, no loop, and two of one name.
    """
    return read_required(path)[0]


def read_required(path: Path) -> tuple[tuple[Requirements, ...], Requirements | None]:
    """What a file requires of each loop, and of all together, None where it has no table `[several]`."""
    found = read_file(path, RequirementsFile, FORMAT)
    return found.loop, found.several


def write_requirements(path: Path, requirements: Sequence[Requirements]) -> None:
    """Write requirements whole, one a loop; one without a name is what all loops keep together.

    Refuses none with a name, two of one name, and weights that are systems or functions.
    """
    loops = [one for one in requirements if one.loop]
    rest = [one for one in requirements if not one.loop]
    if len(rest) > 1 or not loops:
        raise WrongUseError(
            "requirements in a file have the names of their loops", f"{len(rest)} without one", 'give it: loop = "..."'
        )
    RequirementsFile(tuple(loops), *rest)
    several = {k: v for one in rest for k, v in one.to_table().items() if k != "name"}
    table = {"format": FORMAT, "loop": [one.to_table() for one in loops]}
    write_toml(path, table | ({"several": several} if rest else {}))


def read_whole(path: Path) -> tuple[Requirements, ...]:
    """What a file requires of each loop, and last, without a name, of all together where it has a table `[several]`."""
    loops, together = read_required(path)
    return loops if together is None else (*loops, together)


@dataclass(frozen=True)
class ProfilesFile:
    """The profiles of a file."""

    profile: tuple[Profile, ...] = ()

    def __post_init__(self) -> None:
        if not self.profile:
            raise WrongUseError("a file of profiles holds none", "no [[profile]]", "write one with name and limits")
        refuse_doubles((one.name for one in self.profile), "profile", "profiles")


def read_profiles(path: Path = OWN) -> dict[str, Profile]:
    """Profiles of a file by name; refuses another format, unknown and missing keys, and two of one name."""
    return {one.name: one for one in read_file(path, ProfilesFile, PROFILES).profile}


def write_profiles(path: Path, profiles: Sequence[Profile]) -> None:
    """Write profiles whole; refuses none, and two of one name."""
    ProfilesFile(tuple(profiles))
    write_toml(path, {"format": PROFILES, "profile": [table_of(one) for one in profiles]})


def profile_of(name_or_file: str) -> Profile:
    """The profile that an option names: NAME of those that come along, FILE:NAME, or FILE that holds one alone."""
    file, colon, name = name_or_file.rpartition(":")
    if not colon and name_or_file.endswith(".toml"):
        file, name = name_or_file, ""
    known = read_profiles(Path(file)) if file else read_profiles()
    if not name and len(known) == 1:
        return next(iter(known.values()))
    refuse_unknown("a profile is not known", name or name_or_file, [*known, "FILE.toml:NAME"])
    return known[name]


def joined(name: str | None, requirements: Sequence[Requirements]) -> tuple[tuple[Requirements, ...], Profile | None]:
    """Requirements with a profile's limits beside them, and the profile; as they are where none is named."""
    chosen = None if name is None else profile_of(name)
    return tuple(requirements if chosen is None else map(chosen.joined, requirements)), chosen
