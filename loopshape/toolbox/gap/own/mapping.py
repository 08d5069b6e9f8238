"""Are the columns mapped with the right sign, unit and zero? Told from the nominal model, before anything is fitted.

Some windows are followed as mapped, and with a column, or all of a kind, times a plain factor (a sign, radians for
degrees) or with its zero a quarter turn off. A slip is named where it takes most of the misfit away, more than any gain
that a wrong parameter could make, and more than its own neighbours. Misfits are geometric means in noise floors: all
windows tell, not the worst alone, and a column's factor is no factor of what is compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.gap.nouns.machine import is_angle
from loopshape.toolbox.gap.own import following
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.following import Followed

BOTH = {
    57.295779513: "as between degrees and radians", 1000.0: "a factor of a thousand", 100.0: "a factor of a hundred",
    2.0 * np.pi: "as between turns and radians",
}  # fmt: skip
OF_INPUTS = {9.80665: "as between kilograms force and newtons"}
OF_OUTPUTS = {9.5492966: "as between revolutions a minute and rad/s"}
CLEAR, NEAR = 2.0, 1.25  # misfits as mapped, and of neighbours, over that of a slip
ALIKE, SAME = 1.5, 3.0  # misfits of slips that cannot be told apart: of other columns, of factors alike where the
BESIDE, TWICE = 1.5, 2.0  # a neighbour's factor; factors that a gap beside the slip may confuse
FIRST, WINDOWS, STATES = 12, 48, 4  # windows for a first look at all slips and for the best, fewer of more states


@dataclass(frozen=True)
class Slip:
    """Columns of inputs and outputs (their places) times a factor, or off by a shift, and what that is in words."""

    inputs: tuple[int, ...] = ()
    outputs: tuple[int, ...] = ()
    factor: float = 1.0
    shift: float = 0.0
    words: str = ""

    @property
    def neighbours(self) -> tuple[Slip, Slip]:
        """The same columns with a factor, or a shift, that is no plain one."""
        both = (BESIDE, 1.0 / BESIDE)
        if self.shift:
            one, other = (replace(self, shift=q * self.shift) for q in both)
        else:
            one, other = (replace(self, factor=q * self.factor) for q in both)
        return one, other


def check(c: Composed, prepared: Sequence[Followed]) -> None:
    """Refuse columns whose sign, unit or zero is wrong by a plain slip; every other gap is left to the diagnosis."""
    some = _thinned(c, prepared, WINDOWS)
    mapped = misfit(c, some, Slip())
    if mapped < 5.0:  # floors, below which nothing is mapped wrongly
        return
    tried = _best(c, _thinned(c, prepared, FIRST), list(slips(c)))
    refined = 8
    tried = _best(c, some, [s for left, s in tried if left < SAME * tried[0][0]][:refined])
    least, best = tried[0]
    if mapped < CLEAR * least:
        return
    gains = (0.1, 0.33, 0.5, 1.5, 2.0, 3.0)  # what a wrong parameter may do instead
    gain = min(misfit(c, some, replace(s, factor=q)) for s in _columns(c) for q in gains)
    near, far = sorted(float(np.log(misfit(c, some, s) / least)) for s in best.neighbours)
    if gain > CLEAR * least and near > np.log(NEAR):
        same = SAME if near < 0.5 * far else 1.0  # misfits beside the best one say that a gap stands beside the slip
        _refuse(c, mapped, [(left, s) for left, s in tried if left <= (same if _same(s, best) else ALIKE) * least])


def _best(c: Composed, prepared: Sequence[Followed], every: Sequence[Slip]) -> list[tuple[float, Slip]]:
    """Misfits with slips, the least first."""
    return sorted(((misfit(c, prepared, s), s) for s in every), key=lambda one: one[0])


def _same(one: Slip, other: Slip) -> bool:
    """Whether two slips are factors alike of the same columns."""
    ratio = one.factor / other.factor
    return (one.inputs, one.outputs) == (other.inputs, other.outputs) and 1.0 / TWICE < ratio < TWICE


def misfit(c: Composed, prepared: Sequence[Followed], slip: Slip) -> float:
    """Geometric mean over windows and outputs of what the nominal model leaves, in noise floors, 1 for all below."""
    logs = []
    for one in prepared:
        f = _slipped(c, one, slip)
        with np.errstate(all="ignore"):  # a wrong unit may run away
            off = following.off(f, following.explained(c, f, {})).reshape(len(f.first), -1, f.y.shape[1])
        logs.append(np.log1p(np.mean(off**2, axis=1)).ravel())
    return float(np.exp(0.5 * np.mean(np.concatenate(logs))))


def slips(c: Composed) -> Iterator[Slip]:
    """Every plain slip of each column, of all inputs and of all outputs of one unit."""
    angles = [k for k, o in enumerate(c.model.outputs) if is_angle(o)]
    for where in _columns(c):
        yield replace(where, factor=-1.0, words="a sign is wrong")
        for value, words in _factors(c, where).items():
            for factor in (value, 1.0 / value):
                yield replace(where, factor=factor, words=f"a unit is wrong, {words}")
    for k in angles:
        for turn in (0.25, -0.25, 0.5, -0.5):
            words = f"its zero is off by {abs(turn):g} of a turn"
            yield Slip(outputs=(k,), shift=turn * 2.0 * np.pi, words=words)


def _columns(c: Composed) -> list[Slip]:
    """Each column that acts or is compared, and those that a person maps together."""
    inputs = [j for j, i in enumerate(c.model.inputs) if i.acts]
    units: dict[str, list[int]] = {}
    for k, o in enumerate(c.model.outputs):
        units.setdefault(o.unit, []).append(k)
    single = [*(Slip(inputs=(j,)) for j in inputs), *(Slip(outputs=(k,)) for k in range(len(c.model.outputs)))]
    together = [Slip(inputs=tuple(inputs))] * (len(inputs) > 1)
    return single + together + [Slip(outputs=tuple(same)) for same in units.values() if len(same) > 1]


def _factors(c: Composed, where: Slip) -> dict[float, str]:
    """Plain factors of a column, and those that the model states: taken twice, or left out."""
    model = c.model
    ends = [model.inputs[j] for j in where.inputs] + [model.outputs[k] for k in where.outputs]
    stated = {p.value: f"as large as the parameter {p.name}" for p in model.parameters if p.unit in ("1", "")}
    if len(ends) == 1:
        stated[ends[0].factor] = f"as large as the factor that {ends[0].name} has"
    own = {max(abs(v), 1.0 / abs(v)): words for v, words in stated.items() if v}
    # a number of the model below is no factor that is taken twice or left out
    return {v: words for v, words in own.items() if v > 3.0} | BOTH | (OF_INPUTS if where.inputs else OF_OUTPUTS)


def _thinned(c: Composed, prepared: Sequence[Followed], windows: int) -> list[Followed]:
    """The recordings with so many windows in all, fewer of a large model, evenly over each."""
    most = max(1, windows * STATES // max(STATES, len(c.model.states)) // len(prepared))
    out = []
    for f in prepared:
        kept = np.unique(np.linspace(0, len(f.first) - 1, min(most + 2, len(f.first) + 2)).astype(int)[1:-1])
        out.append(replace(f, first=f.first[kept], start=f.start[kept]))
    return out


def _slipped(c: Composed, f: Followed, slip: Slip) -> Followed:
    """The recording as it would be were its columns mapped otherwise."""
    u, y, start, ranges, floor = (x.copy() for x in (f.u, f.y, f.start, f.ranges, f.floor))
    u[:, slip.inputs] *= slip.factor
    for k in slip.outputs:
        place = c.model.states.index(c.model.outputs[k].state)
        y[:, k] = slip.factor * y[:, k] + slip.shift
        start[:, place] = slip.factor * start[:, place] + slip.shift
        for state in (place, c.speeds.get(place)):
            if state is not None:
                ranges[state] *= abs(slip.factor)
        if (speed := c.speeds.get(place)) is not None:
            start[:, speed] *= slip.factor
        floor[k] *= abs(slip.factor)
    return replace(f, u=u, y=y, start=start, ranges=ranges, floor=floor)


def _refuse(c: Composed, mapped: float, found: Sequence[tuple[float, Slip]]) -> None:
    """Say which columns are wrong and by how much; where several could be, all of them."""
    first, alike = found[0][1], sorted((s for _, s in found), key=lambda s: (s.outputs, s.inputs))
    names = list(dict.fromkeys(" and ".join(_own(c, s)) for s in alike))
    which = names[0] if len(names) == 1 else f"either {', '.join(names[:-1])} or {names[-1]}"
    many = len(names) > 1 or " and " in names[0]
    raise WrongUseError(
        f"{'columns are' if many else 'a column is'} mapped wrongly, {which}: {first.words}",
        f"{mapped:.3g} noise floors between model and recording, {found[0][0]:.3g} with it {_changed(first)}",
        "in model.toml, " + ", or ".join(_cure(c, s) for s in alike),
    )


def _own(c: Composed, slip: Slip) -> list[str]:
    """Names of the columns."""
    inputs = [str(c.model.inputs[j].column) for j in slip.inputs]
    return inputs + [c.model.outputs[k].column for k in slip.outputs]


def _changed(slip: Slip) -> str:
    return f"{slip.shift:+.4g} rad" if slip.shift else f"times {slip.factor:.6g}"


def _cure(c: Composed, slip: Slip) -> str:
    beside = " and ".join(f'column = "{name}"' for name in _own(c, slip))
    if slip.shift:
        return f"write offset = {slip.shift:.6g} beside {beside}"
    return f"multiply factor (1 where it is not written) beside {beside} by {slip.factor:.6g}"
