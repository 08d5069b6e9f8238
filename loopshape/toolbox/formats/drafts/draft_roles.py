"""The likely part of each signal in a loop, by name, by sums and by the direction of causality; each with a sentence.

A name is a hint and measurements decide: a copy of another column is left out, what answers others is not external, and
what only hints and leftovers tell of control and output the direction of causality must confirm, or it is asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loopshape.core.errors import LoopshapeError
from loopshape.core.units import Array
from loopshape.data.signal.excitation_kind import is_sweep, rows_of_a_period
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.quality.quality import MOST_ROWS, inverse_note, loop_feedback, signal_feedback
from loopshape.identify.settings import Settings
from loopshape.identify.tolerances import TOL
from loopshape.toolbox.formats.drafts.column_words import TELLING, Role, role_weights
from loopshape.toolbox.formats.drafts.roles import (
    adds,
    answers,
    at_once,
    beyond_chance,
    copies,
    differences,
    drives,
)

_AT_ONCE = 0.1  # correlation of what is new at the same row, from which on one signal passes to the other unmoved
_EXTERNAL = (Role.REFERENCE, Role.INJECTED)
#: which of two equal columns is kept
_RANK = {Role.TIME: 0, Role.OUTPUT: 4, Role.CONTROL: 4, Role.REFERENCE: 3, Role.INJECTED: 2, Role.ERROR: 1}


@dataclass
class Roles:
    """Columns by part, keys of [recording], and the reasons; `period_rows` and `first_row` of what repeats, or 0.

    `hinted` are parts that a name alone hints at, `unsure` those and what was left over; `copies` equal other columns.
    """

    by_role: dict[Role, str] = field(default_factory=dict)
    recording: dict[str, Any] = field(default_factory=lambda: {"kind": "noise", "injection": "control"})
    guesses: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    unsure: set[Role] = field(default_factory=set)
    hinted: set[Role] = field(default_factory=set)
    copies: list[str] = field(default_factory=list)
    period_rows: int = 0
    first_row: int = 0

    def give(self, role: Role, name: str, why: str, *, sure: bool = True) -> None:
        """Let a column have a part."""
        self.by_role[role] = name
        self.guesses.append(f"{role.value} is {name!r}: {why}.")
        self.unsure = self.unsure - {role} if sure else self.unsure | {role}


@dataclass(frozen=True)
class _Seen:
    names: Sequence[str]
    values: Array
    answered: Mapping[str, float]
    brought: frozenset[str]  # columns from stamps of their own: their rows know of later ones

    def alone(self, name: str) -> bool:
        """Whether a signal seems to move by itself."""
        return bool(self.answered[name] < beyond_chance(*self.values.shape))

    def column(self, name: str) -> Array:
        return np.asarray(self.values[:, self.names.index(name)])

    def drives(self, first: str, second: str) -> int:
        """1 where the second answers the first, -1 where the first answers the second, 0 where nothing tells."""
        return drives(self.values, self.names.index(first), self.names.index(second))

    def at_once(self, first: str, second: str) -> float:
        """Correlation of what is new in two columns at the same row."""
        return at_once(self.values, self.names.index(first), self.names.index(second))


def find_roles(
    names: Sequence[str], values: Array, known: Mapping[Role, str] | None = None, brought: Sequence[str] = ()
) -> Roles:
    """Parts of the columns (n, m) of one recording that move; what could not be told stands in `open`.

    `known` are parts that the format itself gives to columns, `brought` columns made from other stamps.
    """
    roles = Roles()
    if not known:
        names, values = _without_copies(names, values, roles)
    seen = _Seen(names, values, dict(zip(names, answers(values).tolist(), strict=True)), frozenset(brought))
    for role, name in (known or {}).items():
        if name in names:
            roles.give(role, name, "the log's format says so")
    _by_name(seen, roles)
    _by_differences(seen, roles)
    _by_answers(seen, roles)
    _confirm(seen, roles)
    _experiment(seen, roles)
    if not roles.open and not known and (swapped := _swapped(seen, roles)):
        roles.open.append(f"{swapped}: write control and output under [[loop]] as they are.")
    return roles


def _without_copies(names: Sequence[str], values: Array, roles: Roles) -> tuple[Sequence[str], Array]:
    """Names and columns without those that equal another, or are a multiple that is called alike.

    Of two the one stays whose name says more of the loop. A multiple alone is no copy: so a proportional controller
    answers.
    """
    left: dict[str, str] = {}
    for a, b, factor in copies(values):
        first, second = sorted((names[a], names[b]), key=_rank, reverse=True)
        parts = (_best(first)[0], _best(second)[0])
        if first in left or (factor != 1.0 and (parts[0] is None or parts[0] != parts[1])):
            continue
        left[second] = first
        size = factor if second == names[b] else 1.0 / factor
        how = "it equals" if factor == 1.0 else f"but for a constant it is {size:.6g} times"
        roles.guesses.append(f"{second!r} is left out: {how} {first!r}, row by row.")
        if set(parts) == {Role.CONTROL, Role.OUTPUT}:
            roles.open.append(f"{first!r} and {second!r} hold the same signal: which is it, control or output?")
    roles.copies = list(left)
    keep = [k for k, name in enumerate(names) if name not in left]
    return [names[k] for k in keep], values[:, keep]


def _best(name: str) -> tuple[Role | None, float]:
    """The part that a name speaks for most, and how much."""
    weights = role_weights(name)
    return max(weights.items(), key=lambda item: (item[1], item[0])) if weights else (None, 0.0)


def _rank(name: str) -> tuple[int, float]:
    """How much a name says of a loop: first of which part, then how loudly."""
    role, weight = _best(name)
    return (_RANK[role] if role is not None and weight >= TELLING else 0), weight


def _by_name(seen: _Seen, roles: Roles) -> None:
    """Each part to the column whose name speaks most for it, the strongest first; what answers is not external."""
    bids = {name: _best(name) for name in seen.names if name not in roles.by_role.values()}
    for name in sorted(bids, key=lambda name: -bids[name][1]):  # stable: of equal names the first
        role, weight = bids[name]
        if role is None:
            continue
        if role in _EXTERNAL and (other := _answered_by(seen, name, weight)):
            roles.guesses.append(
                f"{name!r} is not taken for {role.value}, though its name says so: it answers {other!r}."
            )
            if weight >= TELLING:
                roles.open.append(
                    f"{name!r} is called {role.value}, but it answers {other!r}, so it did not move the loop from"
                    " outside: write what did (injected, reference), or that nothing did, under [[loop]]."
                )
            continue
        if role in roles.by_role:
            roles.guesses.append(f"{name!r} could be the {role.value} too, by its name.")
            if role in roles.unsure and weight == bids[roles.by_role[role]][1]:
                roles.open.append(f"{roles.by_role[role]!r} and {name!r} could both be the {role.value}: write which.")
        else:
            sure = weight >= TELLING
            roles.give(role, name, "its name says so" if sure else "its name hints at it", sure=sure)
            roles.hinted |= set() if sure else {role}


def _answered_by(seen: _Seen, name: str, weight: float) -> str:
    """A column that a supposedly external one answers, "" for none; telling names of other set points do not count."""
    for other in seen.names:
        role, size = _best(other)
        beside = role in _EXTERNAL and size >= TELLING and weight >= TELLING
        if other != name and not beside and seen.drives(other, name) == 1:
            return other
    return ""


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
    decidable = {name: seen.answered[name] for name in free if np.isfinite(seen.answered[name])}
    alone = [name for name in decidable if seen.alone(name)]
    driven = sorted((name for name in decidable if not seen.alone(name)), key=lambda name: -decidable[name])
    outer = Role.INJECTED in roles.by_role or Role.REFERENCE in roles.by_role
    inner = [*driven, *(roles.by_role[role] for role in (Role.CONTROL, Role.OUTPUT) if role in roles.by_role)]
    moving = [] if outer or len(inner) < 2 else [name for name in alone if _moves(seen, name, inner)]
    if moving:
        why = "the past of the others says nothing of it, and of the rest it does"
        roles.give(Role.INJECTED, moving[0], why, sure=False)
        alone.remove(moving[0])
    if not roles.by_role and len(free) == 2 and (way := seen.drives(*free)):
        control, output = free if way == 1 else reversed(free)
        roles.give(Role.CONTROL, control, f"measured: {output!r} answers it, and not the other way round", sure=False)
        roles.give(Role.OUTPUT, output, f"it answers {control!r}", sure=False)
        return
    missing = [role for role in (Role.CONTROL, Role.OUTPUT) if role not in roles.by_role]
    if len(missing) == 2 and len(alone) == 2 and len(driven) == 1 and not outer:
        _passed_on(seen, roles, alone, driven[0])
    elif missing == [Role.CONTROL] and len(alone + driven) == 1:
        roles.give(Role.CONTROL, (alone + driven)[0], "the only signal left", sure=False)
    elif missing == [Role.OUTPUT] and driven:
        roles.give(Role.OUTPUT, driven[0], "it answers the others, and no other signal answers them more", sure=False)
    elif len(missing) == 2 and len(alone) == 1 and len(driven) == 1:
        roles.give(Role.CONTROL, alone[0], "the past of the others says nothing of it", sure=False)
        roles.give(Role.OUTPUT, driven[0], f"it answers {alone[0]!r}", sure=False)
    elif len(missing) == 2 and len(driven) == 2 and Role.INJECTED in roles.by_role:
        first, second = sorted(driven, key=lambda name: -abs(_passes(seen, roles.by_role[Role.INJECTED], name)))
        roles.give(Role.CONTROL, first, "of the two signals left more of what was injected is in its rows", sure=False)
        roles.give(Role.OUTPUT, second, "the other of them", sure=False)


def _moves(seen: _Seen, name: str, others: Sequence[str]) -> bool:
    """Whether something answers a signal that moves by itself, in the same row or later."""
    return any(seen.drives(name, other) == 1 or abs(_passes(seen, name, other)) > _AT_ONCE for other in others)


def _passed_on(seen: _Seen, roles: Roles, alone: Sequence[str], driven: str) -> None:
    """Of two signals that seem to move by themselves, at the same row, the control is that which answers a little."""
    first, second = sorted(alone, key=lambda name: seen.answered[name])
    if abs(_passes(seen, first, second)) > _AT_ONCE:
        roles.give(Role.INJECTED, first, "of the two that others' past does not explain, it answers least", sure=False)
        roles.give(
            Role.CONTROL, second, f"it follows {first!r} in the same row ({_alike(seen, first, second)})", sure=False
        )
        roles.give(Role.OUTPUT, driven, "it answers both, later", sure=False)


def _passes(seen: _Seen, source: str, name: str) -> float:
    """What of a source is in the same row of a signal; 0 where it is not told."""
    return float(np.nan_to_num(seen.at_once(source, name)))


def _alike(seen: _Seen, one: str, two: str) -> str:
    """The measured correlations of two columns at the same row."""
    whole = float(np.corrcoef(seen.column(one), seen.column(two))[0, 1])
    return f"correlation {whole:.2f}, of what is new in them {seen.at_once(one, two):.2f}"


def _confirm(seen: _Seen, roles: Roles) -> None:
    """Let measurements confirm control and output that names do not tell for sure; turn them round, or ask."""
    by = roles.by_role
    if Role.CONTROL not in by or Role.OUTPUT not in by or not roles.unsure & {Role.CONTROL, Role.OUTPUT}:
        return
    control, output = by[Role.CONTROL], by[Role.OUTPUT]
    source = by.get(Role.INJECTED, by.get(Role.REFERENCE))
    rivals = set(seen.names) - set(by.values())
    in_doubt = roles.unsure & {Role.CONTROL, Role.OUTPUT, *_EXTERNAL}
    told_one = {Role.CONTROL, Role.OUTPUT} - in_doubt
    if source is not None and not rivals and told_one and in_doubt <= roles.hinted:
        return  # no other signal is left, and the names hint at each part
    way = 0 if any(_linked(seen, name, (control, output)) for name in rivals) else seen.drives(control, output)
    if source is None and way == 1:
        roles.guesses.append(f"measured: {output!r} answers {control!r}, and not the other way round.")
        return
    if source is None and way == -1 and {Role.CONTROL, Role.OUTPUT} <= roles.unsure:
        roles.give(Role.CONTROL, output, f"measured: {control!r} answers it, and not the other way round")
        roles.give(Role.OUTPUT, control, f"it answers {output!r}")
        return
    if source is not None and not _unnamed(roles) and _source_is_told(seen, roles, source, control):
        first, second = (abs(_passes(seen, source, name)) for name in (control, output))
        apart = 3.0  # times as much as in the output is seen of a source in the same row of the control
        if first > _AT_ONCE and first > apart * second:
            roles.guesses.append(
                f"measured: {control!r} follows {source!r} in the same row, as a controller does"
                f" ({_alike(seen, source, control)}); {output!r} follows later, as a plant does."
            )
            return
    roles.open.append(
        f"whether {control!r} is the control and {output!r} the output of the loop, names and measurements do not tell"
        " for sure: write both under [[loop]], as they are."
    )


def _linked(seen: _Seen, name: str, others: Sequence[str]) -> bool:
    """Whether a signal without a part is of the same loop: it answers others, or they it."""
    return not seen.alone(name) or any(seen.drives(name, other) for other in others) or _moves(seen, name, others)


def _source_is_told(seen: _Seen, roles: Roles, source: str, control: str) -> bool:
    """Whether a name tells what moved the loop, or that moves by itself and the control does not."""
    sure = any(role not in roles.unsure for role in _EXTERNAL if roles.by_role.get(role) == source)
    return sure or (seen.alone(source) and not seen.alone(control))


def _unnamed(roles: Roles) -> bool:
    """Whether no name tells any part for sure: two sensors behind one drive look like control and output then."""
    return set(roles.by_role) <= roles.unsure


def _experiment(seen: _Seen, roles: Roles) -> None:
    """Where the excitation enters, of what kind it is, and whether a loop was closed."""
    by, source = roles.by_role, None
    if Role.CONTROL not in by or Role.OUTPUT not in by:
        roles.recording = {"kind": roles.recording["kind"]}
        return
    if Role.INJECTED in by:
        source = by[Role.INJECTED]
        _injection(seen, roles, source)
    elif Role.REFERENCE in by:
        source = by[Role.REFERENCE]
        roles.recording |= {"injection": "reference", "closed_loop": True}
        roles.guesses.append(f"the loop was closed and {source!r} moved it: nothing was injected beside it.")
    else:
        source = by[Role.CONTROL]
        _open_or_closed(seen, roles)
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


def _open_or_closed(seen: _Seen, roles: Roles) -> None:
    """By the test that `frf` makes: noise of the output must come back in the control, beyond what repeats or sweeps.

    A controller that answers within the row is seen where the plant does not: it is taken not to where the output's
    past explains the control.
    """
    control, output = (roles.by_role[role] for role in (Role.CONTROL, Role.OUTPUT))
    roles.recording |= {"injection": "control", "closed_loop": False}
    try:
        signals = seen.column(control), seen.column(output), None, 1e-4, repr(control)  # of calling an open loop closed
        found = signal_feedback(*signals)
        if not found.detected and not seen.alone(control):
            later = signal_feedback(*signals, later=True)
            found = later if later.detected else found
    except LoopshapeError:
        found = None
    if found is not None and found.detected:
        roles.open.append(
            f"{control!r} answers noise of {output!r} (p = {found.probability:.1e}), so a loop was closed, and no"
            " column holds the signal that was injected or the reference that moved: record it too, and name it."
        )
    elif found is not None and found.decidable:
        roles.guesses.append(
            f"the loop is taken for open: {found.sentence}; a loop without noise at the output shows no more, so please"
            " confirm."
        )
    else:
        roles.guesses.append(
            f"the loop is taken for open, since no injected signal or reference was found; {control!r} alone does not"
            " tell: please confirm."
        )


def _injection(seen: _Seen, roles: Roles, source: str) -> None:
    """Where the injected signal enters: does it reach the output through the control alone?"""
    control, output = roles.by_role[Role.CONTROL], roles.by_role[Role.OUTPUT]
    size = seen.at_once(source, control)
    beside = adds(seen.values, *(seen.names.index(name) for name in (source, control, output)))
    at_controller = abs(size) > _AT_ONCE
    if np.isnan(size):  # nothing is new in one of them
        # of what control and output leave open of the output, from which on a source enters beside the control
        at_controller = not beside > 0.5
    roles.recording |= {"injection": "controller_input" if at_controller else "plant_input", "closed_loop": True}
    if np.isnan(size) and (at_controller or rows_of_a_period(seen.column(source))[0]):
        roles.open.append(
            f"where {source!r} enters is not known: nothing is new in it or in {control!r}. Write injection"
            " (controller_input, plant_input, or reference where the control was logged behind the sum)."
        )
        return
    through = np.isnan(beside) or beside < beyond_chance(seen.values.shape[0], 2)
    if seen.brought & {source, control, output}:
        through = at_controller  # rows that know of later ones tell nothing of it
    follows = "follows it" if at_controller else "does not follow it"
    share = "nothing" if through else f"{100.0 * beside:.1f} %"
    roles.guesses.append(
        f"{source!r} enters at {roles.recording['injection']}: {control!r} {follows} in the same row"
        f" ({_alike(seen, source, control)}), and beside {control!r} it explains {share} of what is new in {output!r}."
    )
    small = 0.2  # of the same, up to which a sweep or few lags may be the cause
    if through != at_controller or (not through and beside < small):
        roles.open.append(
            f"where {source!r} enters is not known: {control!r} {follows} in the same row, and beside {control!r} it"
            f" explains {share} of what is new in {output!r}: write injection (controller_input, plant_input, or"
            " reference where the control was logged behind the sum)."
        )


def _swapped(seen: _Seen, roles: Roles) -> str:
    """What `frf` would report of swapped columns, "" for nothing: measured here, at a rate of 1 Hz."""
    by = roles.by_role
    parts = [role for role in (Role.CONTROL, Role.OUTPUT, Role.REFERENCE, Role.INJECTED) if role in by]
    if not {Role.CONTROL, Role.OUTPUT} <= set(parts):
        return ""
    rows = min(MOST_ROWS, seen.values.shape[0])
    columns = {f"{role.value}_1": seen.column(by[role])[:rows] for role in parts}
    words = {key: roles.recording[key] for key in ("kind", "injection", "closed_loop")}
    period, first = (float(roles.period_rows), float(roles.first_row)) if roles.period_rows else (None, None)
    own = {role.value: f"{role.value}_1" if role in parts else None for role in (*parts, *_EXTERNAL)}
    try:
        info = RecordingInfo(file="draft", excites="loop", period_s=period, periodic_from_s=first, **words)
        loop = LoopSetup("loop", own["reference"], own["injected"], "control_1", "output_1", None)
        recording = Recording(info, 1.0, {"t_s": np.arange(rows, dtype=np.float64), **columns})
        method = "auto" if roles.period_rows else "welch"
        P = estimate_frf(recording, loop, Settings(method=method))
        found = inverse_note(recording, loop, P.frequency_hz[P.valid], P.siso[P.valid])
        if not found and not info.closed_loop and loop_feedback(recording, loop, 1e-4).explained > TOL.before_its_cause:
            found = ("much of the output comes before its cause",)
    except LoopshapeError:
        return ""  # `frf` will say what is wrong with the recording
    what = f"{by[Role.CONTROL]!r} and {by[Role.OUTPUT]!r} seem to be swapped"
    return f"{what}: as drafted the response is the inverse of a plant's, or its output comes first" if found else ""


def _kind(seen: _Seen, roles: Roles, source: str) -> None:
    values = seen.column(source)
    period, first = rows_of_a_period(values)
    kind = "multisine" if period else "sweep" if is_sweep(values) else "noise"
    roles.period_rows, roles.first_row = period, first
    roles.recording["kind"] = kind
    why = {
        "multisine": f"it repeats every {period} rows from row {first + 1} on",
        "sweep": "its frequency rises or falls steadily",
        "noise": "it neither repeats nor sweeps",
    }
    roles.guesses.append(f"the excitation {source!r} is of the kind {kind}: {why[kind]}.")
