"""A check against a kept verdict, its parts told apart where controller and data both changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from loopshape.core.errors import LoopshapeError
from loopshape.core.json_ready import Plain, keys
from loopshape.io.write.verdicts import read_verdicts
from loopshape.loop.verdict import LoopCheck
from loopshape.toolbox.validation.kept.baseline import bridge, compare
from loopshape.toolbox.validation.kept.changes import Change, Comparison


@dataclass(frozen=True)
class Baseline(Plain):
    """What became of a baseline: in all, and where controller and data both changed, the part of each.

    `by_controller` compares both controllers on the present data, `by_plant` the baseline's controller on both data.
    """

    IN_JSON = {"worse": "worse", **{key: f"whole.{key}" for key in Comparison.IN_JSON}} | keys(
        "by_controller", "by_plant"
    )

    whole: Comparison
    by_controller: Comparison | None = None
    by_plant: Comparison | None = None

    @property
    def parts(self) -> dict[str, Comparison]:
        """The comparisons by their titles, the whole first."""
        named = {
            "Against the baseline": self.whole,
            "Of this, by the controller (both on the present data)": self.by_controller,
            "Of this, by the plant (the baseline's controller on both data)": self.by_plant,
        }
        return {title: one for title, one in named.items() if one is not None}

    @property
    def worse(self) -> bool:
        """Whether something got worse, in all or by the controller, which other data do not hide."""
        return Change.WORSE in (self.whole.outcome, self.by_controller and self.by_controller.outcome)


def against(baseline: Path, loops: Sequence[LoopCheck]) -> Baseline:
    """Compare with a stored verdict.

    Where the controllers and the data have both changed, the baseline's controllers are checked on the present data
    too: what the controllers did and what the plant did are told apart. Where that check cannot be made, as at another
    rate, a note says so instead.
    """
    before, now = read_verdicts(baseline), [one.verdict for one in loops]
    whole, old = compare(before, now), {one.loop: one for one in before}
    bridges, notes = [], []
    for x in _of(loops, set(bridge(before, now))):
        try:
            bridges.append(x.under(old[x.verdict.loop].controllers))
        except LoopshapeError as error:
            why = f"{error.what} ({error.received})" if error.received else error.what
            notes.append(
                f"loop {x.verdict.loop}: the baseline's controller cannot be checked on the present data, so what the"
                f" controller did and what the plant did are not told apart: {why}"
            )
    whole, across = replace(whole, notes=(*whole.notes, *notes)), {one.loop for one in bridges}
    if not across:
        return Baseline(whole)
    return Baseline(
        whole,
        by_controller=compare(bridges, [x.verdict for x in _of(loops, across)]),
        by_plant=compare([one for one in before if one.loop in across], bridges),
    )


def _of(loops: Sequence[LoopCheck], names: set[str]) -> list[LoopCheck]:
    return [loop for loop in loops if loop.verdict.loop in names]
