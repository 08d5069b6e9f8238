"""Matrix FRFs, controllers and requirements -> Verdict: each loop with the others closed, and all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.control.loop import Loop
from loopshape.data.requirement.requirements import Requirements, SeveralRequirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.identify.matrix.equivalent_plant import equivalent_plant
from loopshape.identify.matrix.interaction import square_part
from loopshape.loop.matrix.determinant import closed_loops_stability, count_from_held, encirclement_count
from loopshape.loop.matrix.several_low_end import read_integrators
from loopshape.loop.matrix.several_margins import several_margins
from loopshape.loop.stability.stability import unstable_count
from loopshape.loop.verdict import beyond_lines, check, loops_of, points_of, worst_lines


def check_several(
    frfs: Sequence[FRF],
    controllers: Sequence[Controller],
    requirements: Sequence[Requirements] = (),
    several: SeveralRequirements | None = None,
    *,
    loops: Sequence[str] | None = None,
    held: Sequence[Controller] = (),
) -> Verdict:
    """Check the controllers of several loops against the requirements of each and of all, at every operating point.

    `frfs` are square matrix FRFs (or such that `loops` makes square), one an operating point; loops that `loops` leaves
    out stay open. Each loop's limits are checked on the plant that it meets with all others closed; whether that is
    stable only the count of det(I + L) says, not the single loop's own. `held` are the controllers under which the
    recordings stood: their count tells the plant's unstable poles where the requirements do not.

    Refuses loops without a controller or an output, requirements of loops that are not there, several rates, and limits
    on singular values where the outputs have different units.
    """
    several = several or SeveralRequirements()
    matrices, notes = loop_matrices(frfs, controllers, several, loops=loops, held=held)
    return verdict_on_matrices(matrices, requirements, several, notes)


def verdict_on_matrices(
    matrices: Mapping[str, Loop],
    requirements: Sequence[Requirements],
    several: SeveralRequirements,
    notes: Sequence[str] = (),
) -> Verdict:
    """The verdict on loops (one operating point at least) as `loop_matrices` makes them."""
    names = next(iter(matrices.values())).names
    _refuse_strays(requirements, names)
    margins = {recording: several_margins(matrix) for recording, matrix in matrices.items()}
    said = [f"{recording}: {text}" for recording, m in margins.items() for text in m.notes]
    _refuse_mixed(several, margins)
    by_loop = {required.loop: required for required in requirements}
    each = tuple(_one(name, matrices, margins, by_loop.get(name)) for name in names)
    warnings = tuple(dict.fromkeys([*notes, *said]))
    return Verdict(" + ".join(names), worst_lines(dict.fromkeys(margins, several), margins), margins, warnings, each)


def loop_matrices(
    frfs: Sequence[FRF],
    controllers: Sequence[Controller],
    several: SeveralRequirements,
    *,
    loops: Sequence[str] | None = None,
    held: Sequence[Controller] = (),
) -> tuple[dict[str, Loop], list[str]]:
    """The loops on the lines that a check looks at, by recording, and what had to be assumed of the plant."""
    if not frfs:
        raise WrongUseError("there is no matrix FRF to check", "", "estimate it: loopshape frf RUN --matrix")
    parts, names = _square(frfs, loops)
    chosen = _controllers(names, controllers)
    stood = held if all(len(frf.inputs) == len(names) for frf in frfs) else ()  # those left out were closed then
    matrices, notes = {}, []
    for recording, frf in zip(points_of(frfs), parts, strict=True):
        matrices[recording], note = _loop_matrix(frf, chosen, names, several, stood)
        notes += [f"{recording}: {text}" for text in note]
    return matrices, notes


def _square(frfs: Sequence[FRF], loops: Sequence[str] | None) -> tuple[list[FRF], tuple[str, ...]]:
    if loops is not None and len(loops) < 2:
        raise WrongUseError("several loops are two at least", ", ".join(loops), "one alone: loopshape check")
    parts = [square_part(frf, loops) for frf in frfs]
    every = {names for _, names in parts}
    if len(every) > 1:
        raise WrongUseError(
            "the matrices are of different loops", "; ".join(", ".join(n) for n in sorted(every)), "name the loops"
        )
    return [frf for frf, _ in parts], parts[0][1]


def _controllers(names: Sequence[str], controllers: Sequence[Controller]) -> tuple[Controller, ...]:
    known = {one.loop: one for one in controllers}
    if missing := [name for name in names if name not in known]:
        raise WrongUseError(
            f"no controller for {', '.join(missing)}", f"controllers of {', '.join(known) or 'no loop'}",
            "add it, or name the loops that are closed; those left out stay open",
        )  # fmt: skip
    return tuple(known[name] for name in names)


def _refuse_strays(requirements: Sequence[Requirements], names: Sequence[str]) -> None:
    if strays := [required.loop for required in requirements if required.loop not in names]:
        what = "requirements are of no loop that is closed"
        raise WrongUseError(what, ", ".join(strays), f"loops: {', '.join(names)}")


def _refuse_mixed(several: SeveralRequirements, margins: Mapping[str, Margins]) -> None:
    """Refuse limits on what is not defined: singular values where the outputs have different units."""
    for name in (limit.name for limit in several.limits if getattr(several, limit.name) is not None):
        if any(np.isnan(m[name].value) for m in margins.values()):
            raise WrongUseError(
                f"{name} is not defined where outputs have different units",
                f"loops {', '.join(next(iter(margins.values())).loops)}",
                "ask for modulus_margin or disk_margin, which do not depend on units",
            )


def _loop_matrix(
    frf: FRF,
    controllers: tuple[Controller, ...],
    names: tuple[str, ...],
    several: SeveralRequirements,
    held: Sequence[Controller],
) -> tuple[Loop, list[str]]:
    """The loops on the lines that a check looks at, and what had to be assumed of the plant."""
    lines = frf.between(*several.band_hz) if several.band_hz else frf.valid_lines()
    known = {one.loop: one for one in held}
    stood = tuple(known[name] for name in names) if set(names) <= set(known) else ()
    poles = several.integrators, several.unstable_poles
    made = Loop(lines, controllers, *poles, beyond=beyond_lines(frf, lines), recorded_under=stood)
    notes: list[str] = []
    declared = several.integrators is not None and several.unstable_poles is not None
    if made.recorded_under and not declared and isinstance(count_from_held(made), int):
        return replace(made, integrators=None), notes  # the recorded loops tell all, and nothing has to be assumed
    if several.integrators is None:
        integrators, note = read_integrators(made)
        made, notes = replace(made, integrators=integrators), [note]
    if several.unstable_poles is not None or made.integrators is None:
        return made, notes
    unstable, told = _held_poles(made)
    return replace(made, unstable_poles=unstable), [*notes, *told]


def _held_poles(loops: Loop) -> tuple[int | None, tuple[str, ...]]:
    """Unstable poles of the plant by the loops that were recorded, which stood; None where they do not tell."""
    if loops.plant.open_loop:
        return 0, ()
    if not loops.recorded_under:
        return None, ()
    count = encirclement_count(replace(loops, controllers=loops.recorded_under, recorded_under=(), unstable_poles=0))
    if not isinstance(count, int):
        return None, ()
    if count > 0:
        note = "the loops that were recorded would be unstable by this FRF: check signs, injection and integrators"
        return None, (note,)
    word = {0: "no unstable poles", -1: "1 unstable pole"}.get(count, f"{-count} unstable poles")
    return -count, (f"plant taken to have {word}, because the loops that were recorded were stable",)


def _one(
    name: str,
    matrices: Mapping[str, Loop],
    margins: Mapping[str, Margins],
    required: Requirements | None,
) -> Verdict:
    """A loop's verdict with all others closed; whether it is stable is what the count of all loops says."""
    required = replace(required or Requirements(name), integrators=None, unstable_poles=None)
    controllers = {own.loop: own for m in matrices.values() for own in m.controllers}
    found = check(plants_met(name, matrices), controllers[name], required, detuned=False, counted=False)
    together = {
        recording: replace(
            found.margins[recording],
            stable=m.stable,
            stability_reason="by the count of all loops at once",
            stability_band_hz=None,
        )
        for recording, m in margins.items()
    }
    return replace(found, margins=together)


def plants_met(name: str, matrices: Mapping[str, Loop]) -> tuple[FRF, ...]:
    """The plant that a loop meets with all others closed, at each operating point."""
    return tuple(
        replace(
            equivalent_plant(m.plant, m.names, name, {own.loop: own for own in m.controllers}).closed,
            recording=recording,
            recorded_under=None,
        )
        for recording, m in matrices.items()
    )


def unstable_poles_met(name: str, matrices: Mapping[str, Loop], required: Requirements) -> int | None:
    """Unstable poles of the plants that a loop meets with all others closed, None where they are not known.

    Those of all loops closed, by det(I + L), and as many more as L of this loop alone encircles -1. None too where
    operating points differ.
    """
    asked, counts = replace(required, integrators=None, unstable_poles=0), set()
    for plant, m in zip(plants_met(name, matrices), matrices.values(), strict=True):
        (own,) = (one for one in m.controllers if one.loop == name)
        (loop,), _ = loops_of([plant], own, asked, counted=False)
        together = closed_loops_stability(m).unstable_poles
        alone = None if loop.integrators is None else unstable_count(loop)
        if together is None or not isinstance(alone, int):
            return None
        counts.add(together - alone)
    found = counts.pop()
    return found if not counts and found >= 0 else None
