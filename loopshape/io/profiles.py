"""Profiles of standards: the file that comes with the package, and a user's own."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from pathlib import Path

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.data.requirement.profile import Profile, Zone
from loopshape.data.requirement.requirements import Requirements
from loopshape.io.config_table import ConfigTable, read_words, refuse_doubles, said_in

FORMAT = "loopshape-profiles/1"
#: the file that comes with the package
OWN = Path(__file__).with_name("profiles.toml")
_TEXTS = ("name", "title", "standard", "edition", "clause", "source", "confirm")


def read_profiles(path: Path = OWN) -> dict[str, Profile]:
    """Profiles of a file by name; refuses another format, unknown and missing keys, and two of one name."""
    words = read_words(path, FORMAT)
    words.only("format", "profile")
    found = [_profile(table) for table in words.tables("profile")]
    if not found:
        raise WrongUseError(f"{path.name} holds no profile", "no [[profile]]", "write one with name and limits")
    refuse_doubles((one.name for one in found), path.name, "profiles")
    return {one.name: one for one in found}


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


def _profile(words: ConfigTable) -> Profile:
    words.only(*_TEXTS, "limits", "unread", "remarks", "zones")
    words.need("limits")
    texts = {key: words.text(key) for key in _TEXTS}
    unread, limits = words.list_of_texts("unread"), words.numbers("limits")
    if strange := sorted(set(unread) - set(limits)):
        raise WrongUseError(f"{words.where}: unread names what is no limit", ", ".join(strange), "name limits of it")
    zones = tuple(_zone(zone) for zone in words.tables("zones"))
    with said_in(words.where):
        return Profile(**texts, limits=limits, unread=unread, remarks=words.list_of_texts("remarks"), zones=zones)


def _zone(words: ConfigTable) -> Zone:
    words.only("name", "up_to_db", "means")
    up_to = words.maybe_number("up_to_db")
    return Zone(words.text("name"), inf if up_to is None else up_to, words.text("means"))


def joined(name: str | None, requirements: Sequence[Requirements]) -> tuple[tuple[Requirements, ...], Profile | None]:
    """Requirements with a profile's limits beside them, and the profile; as they are where none is named."""
    chosen = None if name is None else profile_of(name)
    return tuple(requirements if chosen is None else map(chosen.joined, requirements)), chosen
