"""What an estimate of a run's FRFs gives: the FRFs, the plant's matrices, and what a user has to know of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from loopshape.data.response.frf import FRF


@dataclass(frozen=True, eq=False)
class Remark:
    """What a look at a run and its FRFs found: of which `kind`, its sentence, and whether it is a warning.

    `data` is what stands for it in JSON, the sentence by default.
    """

    kind: str
    sentence: str
    warning: bool = False
    data: Any = None


@dataclass(frozen=True, eq=False)
class Estimates:
    """FRFs of single loops, the plant's matrix at each operating point, warnings, and remarks of other kinds."""

    frfs: tuple[FRF, ...]
    matrices: tuple[FRF, ...] = ()
    warnings: tuple[str, ...] = ()
    remarks: tuple[Remark, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What the FRFs say of themselves, each with its recording."""
        return [f"{one.recording}: {note}" for one in [*self.frfs, *self.matrices] for note in one.notes]

    def to_dict(self) -> dict[str, Any]:
        """Warnings and remarks by kind for JSON; the FRFs by recording, loop and digest."""
        frfs = [{"recording": one.recording, "loop": one.loop, "digest": one.digest} for one in self.frfs]
        kinds = dict.fromkeys(["distortion", "levels", *(one.kind for one in self.remarks)])
        return {"frfs": frfs, "warnings": [*self.warnings, *self.notes]} | {kind: self.of(kind) for kind in kinds}

    def of(self, kind: str) -> Sequence[Any]:
        """The remarks of one kind, as JSON has them."""
        return [one.sentence if one.data is None else one.data for one in self.remarks if one.kind == kind]
