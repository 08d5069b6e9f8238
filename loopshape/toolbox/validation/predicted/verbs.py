"""What a controller will make of plants or of a run's loops: for scripts and for the command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.model import Fit
from loopshape.design.tune import Tuning
from loopshape.io.requirements import read_requirements
from loopshape.io.write.controllers import read_controllers
from loopshape.io.write.fits import fits_of
from loopshape.io.write.frfs import read_frfs
from loopshape.toolbox.validation.predicted.nouns import Prediction
from loopshape.toolbox.validation.predicted.predict import predict as predict_loops
from loopshape.verbs.arguments import Plants, controller_of, plants_of
from loopshape.verbs.watch import Unwatched, Watch


def predict(
    P: Plants,
    C: Controller | Tuning | Sequence[Controller | Tuning],
    R: Requirements | None = None,
    *,
    fits: Sequence[Fit] = (),
    seed: int = 0,
) -> tuple[Prediction, ...]:
    """S, T and the step of the closed loop under a controller that has not run yet, at each operating point.

    With intervals from the FRF's error. A step is that of a fit, or of the lines where they carry one and the
    loop is known to be stable: `R` declares the plant's integrators and unstable poles, nothing else of it counts. Same
    seed, same draws. Of several controllers, one a loop of a matrix FRF, each loop is predicted with the others closed.
    Refuses a negative seed.
    """
    if seed < 0:
        raise WrongUseError("seed must be 0 or above", f"{seed}")
    own = [controller_of(one) for one in (C if isinstance(C, Sequence) else (C,))]
    poles = R or Requirements()
    return tuple(
        predict_loops(
            plants_of(P),
            own,
            tuple(fits),
            integrators=poles.integrators,
            unstable_poles=poles.unstable_poles,
            seed=seed,
        )
    )


def predict_run(
    run: Path, controllers: Path, require: Path | None = None, *, seed: int = 0, watch: Watch | None = None
) -> tuple[Prediction, ...]:
    """What the controllers of a file will make of a run's loops; refuses a file without a loop that has an FRF."""
    asked = {} if require is None else {one.loop: one for one in read_requirements(require)}
    frfs, fits, read_in = read_frfs(run), fits_of(run), read_controllers(controllers)
    pairs = [(one, mine) for one in read_in if (mine := [frf for frf in frfs if frf.loop == one.loop])]
    if not pairs:
        raise WrongUseError(
            "the run has no FRF of a loop of these controllers",
            f"loops {', '.join(one.loop for one in read_in)} and FRFs of {', '.join({f.loop for f in frfs})}",
        )
    made: list[Prediction] = []
    with (watch or Unwatched()).progress("predict", len(pairs)) as step:
        for own, mine in pairs:
            made += predict(mine, own, asked.get(own.loop), fits=fits, seed=seed)
            step(own.loop)
    return tuple(made)


def draw_predictions(out: Path, made: Sequence[Prediction]) -> list[str]:
    """A page of each loop beside the file of its predictions."""
    from loopshape.toolbox.validation.predicted.picture import prediction_page
    from loopshape.verbs.pictures import save

    loops = dict.fromkeys(one.loop for one in made)
    pages = {name: prediction_page([one for one in made if one.loop == name]) for name in loops}
    return [str(save(page, out.parent / f"{out.stem}_{name}.png")) for name, page in pages.items()]
