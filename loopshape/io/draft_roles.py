"""The likely part of each signal in a loop, by name, by sums and by who answers whom; each with a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loopshape.core.units import Array
from loopshape.identify.roles import answers, at_once, beyond_chance, differences, rises, rows_of_a_period
from loopshape.io.column_words import Role, role_weights

_AT_ONCE = 0.1  # correlation of what is new at the same row, from which on one signal passes to the other unmoved


@dataclass
class Roles:
    """Columns by part, keys of [recording], and the reasons; `period_rows` and `first_row` of what repeats, or 0."""

    by_role: dict[Role, str] = field(default_factory=dict)
    recording: dict[str, Any] = field(default_factory=lambda: {"kind": "noise", "injection": "control"})
    guesses: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    period_rows: int = 0
    first_row: int = 0

    def give(self, role: Role, name: str, why: str) -> None:
        """Let a column have a part."""
        self.by_role[role] = name
        self.guesses.append(f"{role.value} is {name!r}: {why}.")


@dataclass(frozen=True)
class _Seen:
    names: Sequence[str]
    values: Array
    answered: Mapping[str, float]

    def alone(self, name: str) -> bool:
        """Whether a signal seems to move by itself."""
        return bool(self.answered[name] < beyond_chance(*self.values.shape))

    def column(self, name: str) -> Array:
        return np.asarray(self.values[:, self.names.index(name)])


def find_roles(names: Sequence[str], values: Array, known: Mapping[Role, str] | None = None) -> Roles:
    """Parts of the columns (n, m) of one recording that move; what could not be told stands in `open`.

    `known` are parts that the format itself gives to columns.
    """
    seen = _Seen(names, values, dict(zip(names, answers(values).tolist(), strict=True)))
    roles = Roles()
    for role, name in (known or {}).items():
        if name in names:
            roles.give(role, name, "the log's format says so")
    _by_name(seen, roles)
    _by_differences(seen, roles)
    _by_answers(seen, roles)
    _experiment(seen, roles)
    return roles


def _by_name(seen: _Seen, roles: Roles) -> None:
    """Each part to the column whose name speaks most for it, the strongest first."""
    bids = [
        (weight, -k, role, name)
        for k, name in enumerate(seen.names)
        for role, weight in role_weights(name).items()
    ]  # fmt: skip
    free = [name for name in seen.names if name not in roles.by_role.values()]
    best = {name: max((b for b in bids if b[3] == name), default=None) for name in free}
    for bid in sorted((b for b in best.values() if b is not None), key=lambda b: (-b[0], -b[1])):
        _, _, role, name = bid
        if role in roles.by_role:
            roles.guesses.append(f"{name!r} could be the {role.value} too, by its name.")
        else:
            roles.give(role, name, "its name says so")


def _by_differences(seen: _Seen, roles: Roles) -> None:
    """An error that is reference less output tells both."""
    free = [name for name in seen.names if name not in roles.by_role.values()]
    for a, b, c in differences(seen.values) if len(seen.names) <= 12 else ():
        error, reference, output = (seen.names[k] for k in (a, b, c))
        taken = {role: roles.by_role.get(role) for role in (Role.ERROR, Role.REFERENCE, Role.OUTPUT)}
        if taken[Role.ERROR] != error:
            continue
        for role, name in ((Role.REFERENCE, reference), (Role.OUTPUT, output)):
            if taken[role] is None and name in free:
                roles.give(role, name, f"{error!r} is {reference!r} less {output!r}, row by row")


def _by_answers(seen: _Seen, roles: Roles) -> None:
    """What the names leave open, by who moves by itself and who answers."""
    free = [name for name in seen.names if name not in roles.by_role.values()]
    told = {name: seen.answered[name] for name in free if np.isfinite(seen.answered[name])}
    alone = [name for name in told if seen.alone(name)]
    driven = sorted((name for name in told if not seen.alone(name)), key=lambda name: -told[name])
    outer = Role.INJECTED in roles.by_role or Role.REFERENCE in roles.by_role
    if alone and not outer and len(driven) + sum(r in roles.by_role for r in (Role.CONTROL, Role.OUTPUT)) >= 2:
        roles.give(Role.INJECTED, alone.pop(0), "the past of the others says nothing of it, and of the rest it does")
    missing = [role for role in (Role.CONTROL, Role.OUTPUT) if role not in roles.by_role]
    if len(missing) == 2 and len(alone) == 2 and len(driven) == 1 and not outer:
        _passed_on(seen, roles, alone, driven[0])
    elif missing == [Role.CONTROL] and len(alone + driven) == 1:
        roles.give(Role.CONTROL, (alone + driven)[0], "the only signal left")
    elif missing == [Role.OUTPUT] and driven:
        roles.give(Role.OUTPUT, driven[0], "it answers the others, and no other signal answers them more")
    elif len(missing) == 2 and len(alone) == 1 and len(driven) == 1:
        roles.give(Role.CONTROL, alone[0], "the past of the others says nothing of it")
        roles.give(Role.OUTPUT, driven[0], f"it answers {alone[0]!r}")
    elif len(missing) == 2 and len(driven) == 2 and Role.INJECTED in roles.by_role:
        _apart(seen, roles, driven)


def _passed_on(seen: _Seen, roles: Roles, alone: Sequence[str], driven: str) -> None:
    """Of two signals that seem to move by themselves, at the same row, the control is that which answers a little."""
    first, second = sorted(alone, key=lambda name: seen.answered[name])
    size = at_once(seen.values, seen.names.index(first), seen.names.index(second))
    if abs(size) > _AT_ONCE:
        roles.give(Role.INJECTED, first, "of the two that others' past does not explain, it answers least")
        roles.give(Role.CONTROL, second, f"it follows {first!r} in the same row (correlation {size:.2f})")
        roles.give(Role.OUTPUT, driven, "it answers both, later")


def _apart(seen: _Seen, roles: Roles, pair: Sequence[str]) -> None:
    """Control and output of a pair: a controller passes the injected signal on in the same row, a plant does not."""
    source = seen.names.index(roles.by_role[Role.INJECTED])
    size = {name: abs(at_once(seen.values, source, seen.names.index(name))) for name in pair}
    first, second = sorted(pair, key=lambda name: -size[name])
    if size[first] > _AT_ONCE and size[first] > 3.0 * size[second]:
        roles.give(
            Role.CONTROL, first, f"it follows {roles.by_role[Role.INJECTED]!r} in the same row, as a controller does"
        )
        roles.give(Role.OUTPUT, second, "it follows later, as a plant does")


def _experiment(seen: _Seen, roles: Roles) -> None:
    """Where the excitation enters, of what kind it is, and whether a loop was closed."""
    by, source = roles.by_role, None
    if Role.CONTROL not in by or Role.OUTPUT not in by:
        return
    moved_alone = seen.alone(by[Role.CONTROL])
    if Role.INJECTED in by:
        source = by[Role.INJECTED]
        _injection(seen, roles, source)
    elif Role.REFERENCE in by:
        source = by[Role.REFERENCE]
        roles.recording |= {"injection": "reference", "closed_loop": True}
        roles.guesses.append(f"the loop was closed and {source!r} moved it: nothing was injected beside it.")
    else:
        source = by[Role.CONTROL]
        _open_or_closed(seen, roles, moved_alone)
    _kind(seen, roles, source)
    _reaches(seen, roles, source)


def _reaches(seen: _Seen, roles: Roles, source: str) -> None:
    """Ask for another recording where nothing of what moved is seen in the output."""
    output = roles.by_role[Role.OUTPUT]
    pair = np.stack([seen.column(source), seen.column(output)], axis=1)
    means = [pair[: len(pair) // m * m].reshape(-1, m, 2).mean(axis=1) for m in (1, 4, 16)]  # slow plants answer late
    shares = [float(answers(part)[1]) for part in means]
    share = float(np.nanmax([0.0, *shares]))
    seen_at_all = any(found >= beyond_chance(*part.shape) for found, part in zip(shares, means, strict=True))
    if np.isfinite(shares[0]) and not seen_at_all:  # nan: the output's own past leaves nothing open
        roles.open.append(
            f"nothing that {source!r} did is seen in {output!r} (it explains {max(100.0 * share, 0.0):.1f} % of what is"
            " new there), so no response can be identified: record again with a sweep or multisine over the loop's"
            " band, added to the reference or the control, large enough to be seen, and logged at the loop's rate."
        )


def _open_or_closed(seen: _Seen, roles: Roles, moved_alone: bool) -> None:
    control, measure = roles.by_role[Role.CONTROL], seen.answered[roles.by_role[Role.CONTROL]]
    roles.recording |= {"injection": "control", "closed_loop": False}
    if moved_alone:
        share = f"{max(100.0 * measure, 0.0):.1f} %"
        roles.guesses.append(
            f"the loop is taken for open: the output's past explains {share} of what is new in {control!r}, as good as"
            " nothing; a loop without noise at the output does no more, so please confirm."
        )
    elif np.isnan(measure):
        roles.guesses.append(
            f"the loop is taken for open, since no injected signal or reference was found; {control!r} alone does not"
            " tell: please confirm."
        )
    else:
        roles.open.append(
            f"the output's past explains {100 * measure:.1f} % of what is new in {control!r}, so a loop was closed, and"
            " no column holds the signal that was injected or the reference that moved: record it too, and name it."
        )


def _injection(seen: _Seen, roles: Roles, source: str) -> None:
    """Where the injected signal enters: a control that has it in the same row got it through the controller."""
    control = roles.by_role[Role.CONTROL]
    size = at_once(seen.values, seen.names.index(source), seen.names.index(control))
    if np.isnan(size):
        roles.recording |= {"injection": "controller_input", "closed_loop": True}
        roles.guesses.append(
            f"{source!r} is taken to enter at the controller's input; the data do not tell: please confirm."
        )
        return
    place = "controller_input" if abs(size) > _AT_ONCE else "plant_input"
    roles.recording |= {"injection": place, "closed_loop": True}
    follows = "follows it" if place == "controller_input" else "does not follow it"
    roles.guesses.append(
        f"{source!r} enters at {place}: {control!r} {follows} in the same row (correlation {size:.2f})."
    )


def _kind(seen: _Seen, roles: Roles, source: str) -> None:
    values = seen.column(source)
    period, first = rows_of_a_period(values)
    kind = "multisine" if period else "sweep" if rises(values) else "noise"
    roles.period_rows, roles.first_row = period, first
    roles.recording["kind"] = kind
    why = {
        "multisine": f"it repeats every {period} rows from row {first + 1} on",
        "sweep": "its frequency rises or falls steadily",
        "noise": "it neither repeats nor sweeps",
    }
    roles.guesses.append(f"the excitation {source!r} is of the kind {kind}: {why[kind]}.")
