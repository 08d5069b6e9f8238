"""The sentences a user gets when something cannot be done.

Every error says three things: what is wrong, what was received, and the way out. A command turns a
`LoopshapeError` into that sentence and exit code 2; a traceback is a defect.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

#: characters of what was received that a sentence shows
LONGEST = 1000


class LoopshapeError(Exception):
    """Something the user can put right: what is wrong, what was received, the way out."""

    def __init__(self, what: str, received: str = "", way_out: str = "") -> None:
        self.what, self.received, self.way_out = what, received, way_out
        parts = [what]
        if received:
            parts.append(f"received {received if len(received) <= LONGEST else received[:LONGEST] + ' ...'}")
        if way_out:
            parts.append(way_out)
        super().__init__("; ".join(parts) + ".")

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        """As a worker process sends it back: whole."""
        return type(self), (self.what, self.received, self.way_out)


class UnreadableInputError(LoopshapeError):
    """A file that is missing, damaged, foreign, or reaches outside its folder."""


class BadSignalError(LoopshapeError):
    """A recording that cannot carry the estimate asked of it: gaps, NaNs, constant, saturated, too short."""


class WrongUseError(LoopshapeError):
    """A call or a file whose words do not fit: unknown names, keys, units, kinds, rates."""


class WrongCallError(WrongUseError, TypeError):
    """A call with an argument too many, one missing or one of another name: what Python has a TypeError for."""


class RigError(LoopshapeError):
    """A rig that does not answer, answers what it must not, or refuses: nothing moves until a person has looked."""


def meant(word: object, known: Iterable[str]) -> str:
    """The beginning of a way out, "did you mean 'local'? ", for a near miss; "" where nothing known is near."""
    plain = {_plain(one): one for one in known}
    near = get_close_matches(_plain(word), plain, 1, 0.6) if isinstance(word, str) and len(word) < 100 else []
    near = near or [one for one in plain if one.startswith(f"{_plain(word)}_")]  # without its unit
    return f"did you mean {plain[near[0]]!r}? " if near else ""


def _plain(word: object) -> str:
    return "_".join(str(word).lower().replace("-", " ").replace("_", " ").split())


def one_of(words: list[str]) -> str:
    """Words as a sentence lists them."""
    return " or ".join(words) if len(words) < 3 else ", ".join(words)


def refuse_unknown(what: str, word: object, known: Iterable[str], use: str = "use") -> None:
    """Refuse a word that is none of `known`, letter for letter; a near miss is named, and never taken for it."""
    words = [str(one) for one in known]
    if not isinstance(word, str) or str(word) not in words:
        received = repr(word)
        received = received if len(received) < 80 else f"{received[:77]}..."
        raise WrongUseError(what, received, f"{meant(word, words)}{use} {one_of(words)}")


def refuse_unknown_keys(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names that are none of `known`: keywords and keys."""
    words = list(known)
    for name in given:
        refuse_unknown(what, name, words, "known are")


def an(name: str) -> str:
    """The name with its article: an FRF, an integrator, a gain."""
    return f"an {name}" if name[:3] in ("FRF", "FRD", "FMU") or name[:1] in "AEIOaeio" else f"a {name}"
