"""FRFs, controllers and requirements -> the loops on the lines that a check looks at, and what had to be assumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import Convergence
from loopshape.core.units import db, from_db
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF, Hold
from loopshape.data.response.model import Fit
from loopshape.data.response.smoothed import Scatter
from loopshape.identify.fit import modes
from loopshape.identify.matrix.equivalent_plant import equivalent_plant, square_part
from loopshape.identify.smooth.smoothing import merged, smoothed
from loopshape.loop.loop import Loop
from loopshape.loop.matrix import determinant
from loopshape.loop.predict.step_response import models_within
from loopshape.loop.stability.low_end import low_frequency_models, low_order
from loopshape.loop.stability.obstacles import Undecided
from loopshape.loop.stability.stability import unstable_count
from loopshape.loop.tolerances import TOL

#: why a fit is not used, most often
MORE_THAN_NOISE = "leaves more than noise"


def loops_of(
    frfs: Sequence[FRF],
    scheduled: Controller | Scheduled,
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    counted: bool = True,
) -> tuple[list[Loop], tuple[str, ...]]:
    """Loops on the lines that a check looks at, smoothed, and what it had to assume.

    Integrators of the plant come from the requirements, else from a fit of the same recording, else from phase
    and slope of the lowest lines; unstable poles from the requirements, else from the count of the loop that was
    recorded under its own controller, else there are none where the recording was made in open loop, else from a fit
    that leaves nothing but noise; otherwise they are not known. What had to be assumed is noted,
    of poles where they are `counted` here and not elsewhere. A schedule gives each its frozen controller.
    """
    if requirements.input_output_disk_margin is not None:
        what = "input_output_disk_margin is what several loops keep together"
        raise WrongUseError(what, f"loop {requirements.loop!r}", "ask for its disk_margin")
    found, notes = [], []
    unused: dict[str, list[Fit]] = {}
    for measured in frfs:
        controller = scheduled if isinstance(scheduled, Controller) else scheduled.at(measured.operating_point)
        band = requirements.band_hz
        frf, left_out = _without_zeros(measured, band)
        frf, fewer = _merged(frf)
        lines = frf.between(*band) if band else frf.valid_lines()
        if controller.rate_hz != frf.rate_hz and frf.rate_hz > 0.0:
            raise WrongUseError(
                f"the controller of loop {controller.loop} runs at another rate than the recording {frf.recording}",
                f"{controller.rate_hz:g} and {frf.rate_hz:g} Hz",
                "give the controller the recording's rate_hz: its coefficients hold at one rate alone",
            )
        if controller.added_hold and (frf.recorded_under is not None or frf.hold is Hold.INCLUDED):
            raise WrongUseError(
                f"the FRF {frf.recording} contains the hold already", "added_hold = true", "leave that key out"
            )
        fit, why = _fit_of(fits, frf, measured, requirements)
        if fit is not None and why:
            unused.setdefault(why, []).append(fit)
            fit = None
        beyond, model = beyond_lines(frf, lines), None if fit is None else fit.model
        plant, scatter = smoothed(frf, band)
        integrators, unstable, note = _open_loop_poles(plant, requirements, fit, beyond, lines, scatter)
        found.append(Loop(plant, controller, integrators, unstable, model, beyond, lines, scatter))
        words = (left_out, fewer, note if counted else "", _narrowed(frf, lines, controller))
        notes += [text for text in words if text]
    return found, tuple(dict.fromkeys([*(_unused(why, those) for why, those in unused.items()), *notes]))


def _unused(why: str, fits: Sequence[Fit]) -> str:
    """Why fits of some recordings are not used, in one sentence however many they are."""
    misfits = dict.fromkeys(f"{pick(fit.misfit_db for fit in fits):.2g}" for pick in (min, max))
    why += f" (misfit {' to '.join(misfits)} dB)" if why == MORE_THAN_NOISE else ""
    if len(fits) == 1:
        return f"the fit of {fits[0].recording} is not used: it {why}"
    return f"the fits of {len(fits)} recordings, {fits[0].recording} to {fits[-1].recording}, are not used: each {why}"


def _without_zeros(frf: FRF, band: tuple[float, float] | None) -> tuple[FRF, str]:
    """The lines that are not exactly zero, and a note of those left out; refuses an FRF that has no other."""
    lines = frf.between(*band) if band else frf.valid_lines()
    if not lines.siso.any():
        raise WrongUseError(
            f"the FRF of loop {frf.loop}, recording {frf.recording}, is exactly zero at every frequency used",
            f"{lines.siso.size} of {frf.frequency_hz.size} frequencies, all 0",
            "look at its signals (a dead sensor?) and at its valid band, then measure again",
        )
    zero = frf.siso == 0.0
    if not zero.any():
        return frf, ""
    first_hz = frf.frequency_hz[zero][0]
    note = f"lines of {frf.recording} that are exactly zero were left out: {zero.sum()}, the first at {first_hz:.4g} Hz"
    return frf.select(~zero), note


def _merged(frf: FRF) -> tuple[FRF, str]:
    """The FRF on the frequencies that a check reads, and a note where these are fewer than were measured."""
    fewer = merged(frf)
    if fewer is frf:
        return frf, ""
    many, few = frf.frequency_hz.size, fewer.frequency_hz.size
    return fewer, f"{many} frequencies of {frf.recording} were averaged to {few}, where they differ by noise alone"


def _narrowed(frf: FRF, lines: FRF, controller: Controller) -> str:
    """A note where valid lines outside the band used show |S| 1 dB larger than those within; else nothing."""
    outside = frf.valid & ~np.isin(frf.frequency_hz, lines.frequency_hz)
    outside &= frf.frequency_hz < 0.5 * controller.rate_hz
    if not outside.any():
        return ""
    near = np.abs(1.0 + controller.response(frf.frequency_hz[outside]) * frf.siso[outside])
    within = float(np.abs(1.0 + controller.response(lines.frequency_hz) * lines.siso).min())
    k = int(np.argmin(near))
    if near[k] > within / from_db(1.0):
        return ""
    return (
        f"{frf.recording} is used from {lines.frequency_hz[0]:.4g} to {lines.frequency_hz[-1]:.4g} Hz only (band_hz):"
        f" at {frf.frequency_hz[outside][k]:.4g} Hz, a valid frequency, |S| reads {-float(db(near[k])):.3g} dB"
    )


def beyond_lines(frf: FRF, lines: FRF) -> FRF | None:
    """Lines above those used, at the largest that their own 95 % circles allow: a check must not overlook them.

    Not those that are noise alone, known worse than to 100 %, unless lines above them are known to 30 %.
    """
    size = np.maximum(np.linalg.norm(frf.response, axis=(1, 2)), 1e-300)
    relative = np.sqrt(frf.variance.sum(axis=(1, 2))) / size
    above = frf.frequency_hz > lines.frequency_hz[-1]
    known = np.flatnonzero(above & (relative < TOL.known_beyond_std))
    rows = above & (relative <= TOL.noise_alone_std)
    rows[: known[-1] + 1 if known.size else 0] |= above[: known[-1] + 1 if known.size else 0]
    if not rows.any():
        return None
    found = frf.select(rows)
    return replace(found, response=found.response * (1.0 + TOL.radius_95 * relative[rows])[:, None, None])


def fit_of(frf: FRF, fits: Sequence[Fit]) -> Fit | None:
    """The fit made for this very FRF."""
    return next((x for x in fits if (x.recording, x.loop, x.frf_digest) == (frf.recording, frf.loop, frf.digest)), None)


def _fit_of(fits: Sequence[Fit], frf: FRF, measured: FRF, requirements: Requirements) -> tuple[Fit | None, str]:
    """The fit of the plant below the measured band, and why it may not speak for it: "" where it may.

    It was made for this FRF, ended well, leaves nothing but noise, contradicts no declaration, and its covariance tells
    the plant below the lowest line down to a thousandth of it.
    """
    mine = [x for x in fits if (x.recording, x.loop) == (frf.recording, frf.loop)]
    if not mine:
        return None, ""
    fit = mine[0]
    poles = ("unstable poles", requirements.unstable_poles, fit.model.unstable_poles())
    integrators = ("integrators", requirements.integrators, fit.model.integrators())
    against = next((x for x in (poles, integrators) if x[1] is not None and x[1] != x[2]), None)
    if fit.frf_digest not in ("", measured.digest):
        why = "was made for another FRF"
    elif fit.outcome is Convergence.NOT_CONVERGED:
        why = "did not converge"
    elif not fit.sufficient:
        why = MORE_THAN_NOISE
    elif against is not None:
        why = f"has {against[2]} {against[0]}, and {against[1]} are declared"
    elif _spread_below(fit, float(frf.frequency_hz[0])) > TOL.known_beyond_std:
        why = "is not known well enough to tell the plant below the lowest frequency"
    else:
        why = ""
    return fit, why


def _spread_below(fit: Fit, first_hz: float) -> float:
    """Largest relative deviation of a fit's response below a frequency in Hz, by its parameters' covariance."""
    f = np.geomspace(1e-3 * first_hz, first_hz, 20)
    drawn = np.array([model.response(f) for model in models_within(fit, TOL.deviation_draws, 0)])
    return float(np.sqrt(np.mean(np.abs(drawn / fit.model.response(f) - 1.0) ** 2, axis=0)).max())


def _open_loop_poles(
    frf: FRF, requirements: Requirements, fit: Fit | None, beyond: FRF | None, raw: FRF, scatter: Scatter
) -> tuple[int | None, int | None, str]:
    """Integrators and unstable poles of the plant (None: not known), and a note where they were assumed."""
    integrators, note = _integrators(frf, requirements, fit, raw)
    if requirements.unstable_poles is not None:
        return integrators, requirements.unstable_poles, note
    held = _held_poles(frf, integrators, fit, beyond, raw, scatter)
    if held is not None and held < 0:
        note = (
            f"the loop that was recorded at {frf.recording} would be unstable by this FRF: check sign, injection and"
            " integrators"
        )
        return None, None, note
    if held is not None:
        unstable, reason = held, "because the loop that was recorded was stable"
    elif frf.open_loop:
        unstable, reason = 0, "because it was recorded in open loop"
    elif fit is not None and fit.sufficient:
        counted, reason = unstable_by_fit(fit), "from its fit"
        if counted is None:
            unclear = f"the fit of {frf.recording} has unstable poles that its frequencies do not decide"
            return integrators, None, f"{note + '; ' if note else ''}{unclear}: declare unstable_poles"
        unstable = counted
    else:
        return integrators, None, note
    if unstable:
        word = "pole" if unstable == 1 else "poles"
        note = f"{note + '; ' if note else ''}plant taken to have {unstable} unstable {word}, {reason}"
    return integrators, unstable, note


def unstable_by_fit(fit: Fit) -> int | None:
    """Unstable poles of a plant by its fit; None where their 95 % intervals leave open whether they are any.

    That is a pair whose damping, or a real pole whose frequency, may as well have the other sign, and a real pole that
    may as well lie above the fit's lines. Those above them do not count: there they stand for what bends the phase, a
    hold, a delay, modes, and no loop whose bandwidth the lines hold would have let such a plant be measured.
    """
    unstable_hz, last_hz = fit.model.unstable_hz(), fit.band_hz[1]
    poles = [x for x in modes(fit) if x.name.startswith("pole")] if fit.structure.startswith("rational") else []
    for size, damping in zip(poles[::2], poles[1::2], strict=True):
        if size.value > last_hz or damping.value >= 0.0:
            continue
        low_hz, high_hz = size.interval
        if not (damping.interval[1] < 0.0 if damping.value > -1.0 else low_hz > 0.0 and high_hz <= last_hz):
            return None
    return int(np.sum(unstable_hz <= last_hz))


def _integrators(frf: FRF, requirements: Requirements, fit: Fit | None, raw: FRF) -> tuple[int | None, str]:
    """Declared, or the fit's, or what phase and slope of the lowest lines agree on.

    None where they do not, or where a model with so many that follows the raw lines has another sign at 0 Hz: then the
    plant turns below them, as lags do.
    """
    declared = requirements.integrators
    if fit is not None:
        return fit.model.integrators() if declared is None else declared, ""
    if declared is not None:
        return declared, ""
    by_phase, by_slope = low_order(frf)
    turned = abs((by_phase - by_slope) % 4.0 - 2.0) < TOL.integrators_agree
    by_phase = (by_phase - 1.5) % 4.0 - 0.5 if turned else by_phase
    integrators = round(by_phase)
    if abs(by_phase - integrators) > 0.4 or abs(by_slope - integrators) > 0.5 or integrators < 0:
        return (
            None,
            f"the plant's lowest frequencies look like {by_phase:.1f} integrators by phase and {by_slope:.1f} by slope",
        )
    word = "integrator" if integrators == 1 else "integrators"
    turns = any((model.num[0] < 0.0) != turned for model in low_frequency_models(raw, integrators))
    if integrators and (requirements.unstable_poles or turns):
        poles = "unstable poles" if requirements.unstable_poles else "lags"
        return None, (
            f"the plant's lowest frequencies look like {integrators} {word}, or like {poles} that lie below"
            " them: declare integrators"
        )
    sign = " and a reversed sign" if turned else ""
    return integrators, (
        f"plant taken to have {integrators} {word}{sign}, from its lowest frequencies: {by_phase:.1f} by phase,"
        f" {by_slope:.1f} by slope at {frf.frequency_hz[0]:.3g} Hz; declare integrators if that is not so"
    )


def _held_poles(
    frf: FRF, integrators: int | None, fit: Fit | None, beyond: FRF | None, raw: FRF, scatter: Scatter
) -> int | None:
    """Unstable poles of the plant by the count of the loop that was recorded, which stood; None where it cannot tell.

    A loop that stood has no unstable pole, so the encirclements of -1 by its own controller's L are the
    plant's unstable poles. Negative where no plant fits the count.
    """
    if frf.recorded_under is None or integrators is None or frf.frequency_hz[-1] >= 0.5 * frf.recorded_under.rate_hz:
        return None
    loop = Loop(frf, frf.recorded_under, integrators, 0, None if fit is None else fit.model, beyond, raw, scatter)
    missing = unstable_count(loop)
    return None if isinstance(missing, Undecided) else -missing


def points_of(frfs: Sequence[FRF]) -> list[str]:
    """Names of operating points, one an FRF; refuses two of one recording."""
    names = [frf.recording or f"frf {k + 1}" for k, frf in enumerate(frfs)]
    if len(set(names)) != len(names):
        raise WrongUseError("two FRFs of one loop come from the same recording", ", ".join(names))
    return names


class Closed(NamedTuple):
    """Loops that are closed: their part of each FRF and, in its order, controllers, and the recordings' or none."""

    frfs: tuple[FRF, ...]
    controllers: tuple[Controller | Scheduled, ...]
    recorded_under: tuple[Controller, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The loops by their controllers."""
        return tuple(one.loop for one in self.controllers)


def closed_loops(
    frfs: Sequence[FRF],
    controllers: Sequence[Controller | Scheduled],
    loops: Sequence[str] | None = None,
    recorded_under: Sequence[Controller] = (),
) -> Closed:
    """The loops that are closed, all of the FRFs by default; those left out stay open.

    One controller is that of a 1 x 1 FRF whatever their names. Refuses loops without a controller or an output.
    """
    alone = loops is None and len(controllers) == 1 and all(frf.response.shape[1:] == (1, 1) for frf in frfs)
    parts = [(x, (controllers[0].loop,)) if alone else square_part(x, loops, least=1) for x in frfs]
    every, known = {names for _, names in parts}, {one.loop: one for one in controllers}
    if len(every) > 1:
        raise WrongUseError(
            "the matrices are of different loops", "; ".join(", ".join(n) for n in sorted(every)), "name the loops"
        )
    names = parts[0][1]
    if missing := [name for name in names if name not in known]:
        raise WrongUseError(
            f"no controller for {', '.join(missing)}", f"controllers of {', '.join(known) or 'no loop'}",
            "add it, or name the loops that are closed; those left out stay open",
        )  # fmt: skip
    before = {one.loop: one for one in recorded_under}
    whole = all(len(frf.inputs) == len(names) for frf in frfs)  # those left out were closed then
    under = tuple(before[name] for name in names) if whole and set(names) <= set(before) else ()
    made = tuple(frf if len(names) > 1 or alone else replace(frf, loop=names[0]) for frf, _ in parts)
    return Closed(made, tuple(known[name] for name in names), under)


def matrix_loops(closed: Closed, together: Requirements) -> tuple[tuple[Loop, ...], list[str]]:
    """Several loops on the lines that a check looks at, one an FRF, and what had to be assumed of the plant.

    A schedule gives each its frozen controllers.
    """
    loops, notes = [], []
    for recording, frf in zip(points_of(closed.frfs), closed.frfs, strict=True):
        at = [c if isinstance(c, Controller) else c.at(frf.operating_point) for c in closed.controllers]
        made, note = _matrix_loop(replace(frf, recording=recording), at, together, closed.recorded_under)
        loops.append(made)
        notes += [f"{recording}: {text}" for text in note]
    return tuple(loops), notes


def _matrix_loop(
    frf: FRF, controllers: Sequence[Controller], together: Requirements, recorded_under: Sequence[Controller]
) -> tuple[Loop, list[str]]:
    """The loops on the lines that a check looks at, and what had to be assumed of the plant."""
    lines = frf.between(*together.band_hz) if together.band_hz else frf.valid_lines()
    poles = together.integrators, together.unstable_poles
    made = Loop(lines, controllers, *poles, beyond=beyond_lines(frf, lines), recorded_under=recorded_under)
    notes: list[str] = []
    if made.recorded_under and None in poles and isinstance(determinant.count_from_held(made), int):
        return replace(made, integrators=None), notes  # the recorded loops tell all, and nothing has to be assumed
    if together.integrators is None:
        integrators, note = determinant.read_integrators(made)
        made, notes = replace(made, integrators=integrators), [note]
    if together.unstable_poles is not None or made.integrators is None:
        return made, notes
    unstable, assumed = _recorded_poles_of_all(made)
    return replace(made, unstable_poles=unstable), [*notes, *assumed]


def _recorded_poles_of_all(loops: Loop) -> tuple[int | None, tuple[str, ...]]:
    """Unstable poles of the plant by the loops that were recorded, which stood; None where they do not tell."""
    if loops.plant.open_loop or not loops.recorded_under:
        return 0 if loops.plant.open_loop else None, ()
    count = determinant.encirclement_count(
        replace(loops, controllers=loops.recorded_under, recorded_under=(), unstable_poles=0)
    )
    if not isinstance(count, int):
        return None, ()
    if count > 0:
        note = "the loops that were recorded would be unstable by this FRF: check signs, injection and integrators"
        return None, (note,)
    word = {0: "no unstable poles", -1: "1 unstable pole"}.get(count, f"{-count} unstable poles")
    return -count, (f"plant taken to have {word}, because the loops that were recorded were stable",)


def equivalent_plants(name: str, loops: Sequence[Loop]) -> tuple[FRF, ...]:
    """The plant that a loop meets with all others closed, at each operating point."""
    made = (equivalent_plant(m.plant, m.names, name, {own.loop: own for own in m.controllers}) for m in loops)
    return tuple(replace(plant, recorded_under=None) for plant in made)
