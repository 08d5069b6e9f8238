"""FRFs and a new controller -> Predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import db
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.step import Step
from loopshape.loop.loop import Loop
from loopshape.loop.loops import closed_loops, equivalent_plants, fit_of, loops_of, matrix_loops
from loopshape.loop.matrix.determinant import closed_loops_stability
from loopshape.loop.predict.step_response import DRAWS, measured_sensitivity, predict_step, step_without_fit
from loopshape.loop.stability.stability import Stability, closed_loop_stability
from loopshape.toolbox.validation.predicted.nouns import Prediction


def predict(
    frfs: Sequence[FRF],
    controllers: Controller | Sequence[Controller],
    fits: Sequence[Fit] = (),
    *,
    integrators: int | None = None,
    unstable_poles: int | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> list[Prediction]:
    """What a controller will make of each measured plant of its loop: S from the FRF, the step from a fit of it.

    Without a fit the step comes straight from the lines, where they can carry one (`step_from_lines`).

    S goes over the plant's valid lines with the plant's covariance. **The prediction is of the plant as it was
    measured**: at that amplitude, about where it stood on average, and with the other loops closed by the controllers
    that they had then. A plant that answers larger signals otherwise, or whose loops interact and get new controllers
    together, will contradict it, and that is what a comparison is for. Of several controllers, one a loop of matrix
    FRFs, each loop's S is that with the others closed by theirs, and stable is what det(I + L) says of all.
    """
    every = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    if not frfs:
        names = ", ".join(repr(one.loop) for one in every)
        raise WrongUseError(f"there is no FRF of loop {names} to predict from", "", "measure or import one")
    closed = closed_loops(frfs, every)
    declared = Requirements(integrators=integrators, unstable_poles=unstable_poles)
    if len(closed.names) > 1:
        whole, more = matrix_loops(closed, declared)
        counts = [closed_loops_stability(loop) for loop in whole]
        parts = [(own, equivalent_plants(own.loop, whole)) for own in every if own.loop in closed.names]
    else:
        more, counts, parts = [], [], [(every[0], closed.frfs)]
    made = []
    for own, plants in parts:
        loops, notes = loops_of(plants, own, replace(declared, loop=own.loop), fits, counted=len(parts) == 1)
        texts = ("stability: " + "; ".join((*more, *notes)),) if more or notes else ()
        stable = counts if len(parts) > 1 else [closed_loop_stability(loop) for loop in loops]
        for loop, stability, frf in zip(loops, stable, plants, strict=True):
            made.append(_one(loop, stability, fit_of(frf, fits), texts, draws, seed, integrators is None))
    return made


def _one(
    loop: Loop, stability: Stability, fit: Fit | None, notes: tuple[str, ...], draws: int, seed: int, guessed: bool
) -> Prediction:
    S = measured_sensitivity(loop)
    if stability.outcome is not ClosedLoop.STABLE:
        notes += (f"the loop is {stability.outcome}: {stability.reason}",)
    if fit is None:
        step, why = step_without_fit(loop, S, stability.outcome, guessed=guessed, seed=seed)
        return Prediction(S, stability.outcome, step, notes + why)
    step = predict_step(fit, loop.controller, draws=draws, seed=seed)
    if step is None:
        return Prediction(S, stability.outcome, None, (*notes, "the fit's loop does not come to rest: no step"))
    return Prediction(S, stability.outcome, _with_doubt(step, S, fit), notes)


def _with_doubt(step: Step, S: FRF, fit: Fit) -> Step:
    """A note where the fit's S is another than that of the lines: a step rests on it."""
    assert S.recorded_under is not None
    f = S.frequency_hz
    apart = np.abs(db((1.0 + S.recorded_under.response(f) * fit.model.response(f)) * S.siso))
    std = db(1.0 + S.relative_std[:, 0, 0])
    k = int(np.argmax(np.maximum(apart - 2.0 * std, 0.0)))
    fit_apart_db = 1.0  # how far a fit's S may lie from the lines' before a step from it is doubted, in dB
    if apart[k] - 2.0 * std[k] < fit_apart_db:
        return step
    note = f"the fit's |S| lies up to {apart[k]:.2g} dB from that of the measured FRF, at {f[k]:.3g} Hz"
    return replace(step, notes=(*step.notes, f"{note}: the step rests on the fit"))
