"""The sentences a user gets when something cannot be done.

Every error says three things: what is wrong, what was received, and the way out. A command turns a
`LoopshapeError` into that sentence and exit code 2; a traceback is a defect.
"""


class LoopshapeError(Exception):
    """Something the user can put right: what is wrong, what was received, the way out."""

    def __init__(self, what: str, received: str = "", way_out: str = "") -> None:
        self.what, self.received, self.way_out = what, received, way_out
        parts = [what]
        if received:
            parts.append(f"received {received}")
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


class RigError(LoopshapeError):
    """A rig that does not answer, answers what it must not, or refuses: nothing moves until a person has looked."""
