"""A schedule as the target's protocol carries it: SCHEDULE with its variables, then NODES with the sections."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.control.scheduled import Scheduled
from loopshape.toolbox.rig.target.frames import LONGEST_PAYLOAD
from loopshape.toolbox.schedules.gain_scheduled import Follows, GainScheduled

ROWS_A_FRAME = (LONGEST_PAYLOAD - 4) // 48


@dataclass(frozen=True)
class Scheduling:
    """A loop's controller that follows an operating point.

    `variables` are (source, scale, knots): source k is the reference of loop k, loops + k its output, in the columns'
    units. `rows` (nodes x sections, 6) hold b0 b1 b2 a0 a1 a2, the last variable fastest; `share` is the lag's a tick.
    """

    share: float
    sections: int
    variables: tuple[tuple[int, float, tuple[float, ...]], ...]
    rows: Array

    @classmethod
    def of(cls, one: Scheduled, loops: Sequence[str]) -> Scheduling:
        """A schedule for a target that closes these loops. Refuses a variable that follows none of them."""
        assert isinstance(one, GainScheduled)
        if unknown := sorted({v.loop for v in one.variables} - set(loops)):
            raise WrongUseError(
                f"the schedule of loop {one.loop!r} follows a loop that is not there",
                ", ".join(unknown), f"loops are {', '.join(loops)}",
            )  # fmt: skip
        variables = tuple(
            (loops.index(v.loop) + len(loops) * (v.follows is Follows.OUTPUT), v.per_stored, v.knots)
            for v in one.variables
        )
        table = one.coefficients
        return cls(one.share, table.shape[1], variables, table.reshape(-1, 6))

    def payloads(self, loop: int) -> tuple[bytes, list[bytes]]:
        """Payload of SCHEDULE, and those of NODES, of the loop at this place."""
        head = struct.pack("<BBBd", loop, len(self.variables), self.sections, self.share)
        for source, scale, knots in self.variables:
            head += struct.pack(f"<BdB{len(knots)}d", source, scale, len(knots), *knots)
        if len(head) > LONGEST_PAYLOAD:
            raise WrongUseError(
                "the knots of a schedule fit into one message",
                f"{sum(len(knots) for *_, knots in self.variables)} knots", "use fewer: about 118 in all",
            )  # fmt: skip
        pieces = [(k, self.rows[k : k + ROWS_A_FRAME]) for k in range(0, len(self.rows), ROWS_A_FRAME)]
        nodes = [struct.pack("<BHB", loop, k, len(part)) + np.asarray(part, "<f8").tobytes() for k, part in pieces]
        return head, nodes
