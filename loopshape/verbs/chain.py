"""What a script does: read or make a run, estimate its FRFs, fit, tune, check. Each verb takes nouns and gives one.

A plant is an FRF, several where one controller serves several operating points, or a diagram, whose tuned block meets
the plant that `ls.diagrams.equivalent` finds; python-control's systems with data
(`control.frd`) are taken where their error is stated first: `ls.FRF.from_control`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, overload

from loopshape.core.errors import WrongUseError, refuse_unknown_keys
from loopshape.data.control.block import BlockTemplate
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.control.shorthand import bounded
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.run import Run
from loopshape.verbs.arguments import Plants, controller_of, equivalent_plants, plants_of, required_of
from loopshape.verbs.files import read
from loopshape.verbs.watch import Unwatched, Watch

if TYPE_CHECKING:
    from loopshape.data.signal.disturbance import Disturbance
    from loopshape.design.tune import Tuning
    from loopshape.design.turns import TunedLoops


def frfs(
    run: Run | str | Path, loop: str | None = None, *, realisations: bool = False, **settings: Any
) -> tuple[FRF, ...]:
    """FRFs of all recordings of a run that excite one loop (or `loop`), in order, with variance and valid band.

    With `realisations` multisines that are alike but for their phases give one FRF, whose variance holds what a
    nonlinear plant answers differently to each draw; a single one tells noise alone. They are taken by periods.

    `settings` and warnings as in `ls.estimate`, which gives remarks besides. Raises WrongUseError for a loop without
    recording, and BadSignalError for a record without excitation.
    """
    from loopshape.verbs.estimates import estimate

    return estimate(run, loop, realisations=realisations, matrix=False, **settings).frfs


def frf(run: Run | str | Path, loop: str | None = None, *, recording: str | None = None, **settings: Any) -> FRF:
    """The FRF of the one recording that excites `loop`, or of the recording that is named.

    From what enters the plant to the loop's output, by the estimator that is right under feedback (the ratio of both
    responses to the excitation); `settings` as in `frfs`. Raises WrongUseError where several recordings do.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> u = np.random.default_rng(1).standard_normal(60_000)
    >>> y = 0.5 * u
    >>> print(ls.frf(ls.Run.from_arrays(u=u, y=y, rate_hz=1000.0)).siso.real.mean().round(6))
    0.5
    """
    whole = run if isinstance(run, Run) else read(run)
    if recording is not None:
        one = whole.recording(recording)
        whole = replace(whole, recordings=(one,))
    found = frfs(whole, loop, **settings)
    if len(found) != 1:
        raise WrongUseError(
            "one FRF was requested from a run with several recordings"
            if found
            else "no recording excites this loop alone",
            ", ".join(one.recording for one in found) or f"loop {loop!r}",
            "name the recording, or take all with ls.frfs",
        )
    return found[0]


def fit(
    P: FRF,
    structure: str = "auto",
    *,
    R: Requirements | None = None,
    weighting: str = "variance",
    stable: bool | None = None,
    band_hz: tuple[float, float] | None = None,
    **orders: Any,
) -> Fit:
    """A low-order model of an FRF, with intervals and a test of what it leaves.

    `structure` is "auto", "third_order", "integrator" (each with "_delay" too) or "rational" with `numerator`,
    `denominator`, `integrators` and `delay`. With `stable` rational structures have
    no pole in the right half plane; None asks for that where `R` declares no unstable poles, else of FRFs that were
    recorded in open loop. `band_hz` replaces the valid band. Misleads where the
    structure is wrong: see `sufficient` and `misfit_db`, and `disputed` where few starts reached the optimum.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.5, 200.0, 100)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01)
    >>> bool(ls.fit(P, "rational", numerator=0, denominator=1).sufficient)
    True
    """
    from loopshape.identify.fit import ORDERS, fit_automatically, structure_by_name
    from loopshape.identify.fit import fit as fit_structure

    refuse_unknown_keys("a fit has no such option", orders, ORDERS)
    if stable is None and R is not None and R.unstable_poles is not None:
        stable = R.unstable_poles == 0
    if structure == "auto":
        return fit_automatically(P, weighting=weighting, band_hz=band_hz, stable=stable)
    chosen = structure_by_name(structure, **orders)
    return fit_structure(P, chosen, weighting=weighting, band_hz=band_hz, stable=stable)


class TuneOptions(TypedDict, total=False):
    """What disturbs one loop, how `tune` searches, and who is told."""

    disturbance: Disturbance | Run | str | Path | Sequence[Disturbance] | None
    seed: int
    starts: int
    grow: int
    least_gain: float
    watch: Watch | None


@overload
def tune(
    P: Plants, R: Requirements, structure: Sequence[BlockTemplate] | None = None, *, fits: Sequence[Fit] = (),
    start: Controller | Tuning | Sequence[Controller | Tuning] | None = None, **options: Unpack[TuneOptions],
) -> Tuning: ...  # fmt: skip


@overload
def tune(
    P: Plants, R: Sequence[Requirements], structure: Sequence[BlockTemplate] | None = None, *,
    fits: Sequence[Fit] = (), start: Controller | Tuning | Sequence[Controller | Tuning] | None = None,
    together: Requirements | None = None, recorded_under: Sequence[Controller] = (), **options: Unpack[TuneOptions],
) -> Tuning | TunedLoops: ...  # fmt: skip


def tune(
    P: Plants,
    R: Requirements | Sequence[Requirements],
    structure: Sequence[BlockTemplate] | None = None,
    *,
    fits: Sequence[Fit] = (),
    start: Controller | Tuning | Sequence[Controller | Tuning] | None = None,
    together: Requirements | None = None,
    recorded_under: Sequence[Controller] = (),
    seed: int = 0,
    starts: int = 16,
    grow: int = 0,
    least_gain: float = 0.01,
    disturbance: Disturbance | Run | str | Path | Sequence[Disturbance] | None = None,
    watch: Watch | None = None,
) -> Tuning | TunedLoops:
    """One controller of a structure for all plants: the largest worst-case bandwidth subject to all requirements.

    `structure` (default: that of `R`) is a sequence of blocks, `[ls.gain(), ls.lead_lag(), ls.notch()]`; what they
    leave open is tuned. `ls.check` and `ls.plot` take the result as the controller, `.controller` is it. Where the
    requirements cannot be met together `feasible` is False and `shortfall` says what to relax. Same input and seed,
    same controller; local searches, so a better optimum elsewhere is possible. With `grow` up to so many blocks are
    added to the structure, each the one that pays most, until one gains less than `least_gain` of the bandwidth; the
    result's `growth` shows what each brought. Raises WrongUseError where the number of the plant's unstable poles is
    not known.

    `disturbance` tells what disturbs the loop, as in `ls.check`: a limit `R.error_rms` is then kept too.

    With requirements of several loops, each with its structure (or `structure` for all), `P` is a square matrix FRF
    (`ls.frf_matrices`) or several, and the loops are tuned in turn, each with the others closed by their latest
    controllers; `start` then holds controllers to begin from, and those of loops without requirements stay. What comes
    out is a point that no loop improves on alone. `together` and `recorded_under` are as in `ls.check`.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 120)
    >>> s = 2j * np.pi * f_hz
    >>> P = ls.FRF.from_arrays(f_hz, 900.0 / s**2 * np.exp(-0.001 * s), relative_std=0.001, rate_hz=5000.0)
    >>> R = ls.Requirements(sensitivity_peak_db=6.0, control_peak_db=40.0, unstable_poles=0)
    >>> C = ls.tune(P, R, [ls.gain(), ls.lead_lag()], starts=4, grow=1)
    >>> [step.order for step in C.growth]
    [1, 3]
    """
    from loopshape.design.tune import Search
    from loopshape.design.tune import tune as tune_one
    from loopshape.design.turns import Known, tune_loops

    asked, together = required_of(R, together)
    asked = asked if structure is None else [replace(one, structure=tuple(structure)) for one in asked]
    initial = [controller_of(one) for one in (start if isinstance(start, Sequence) else (start,)) if one is not None]
    if len(initial) > len({one.loop for one in initial}):
        names = ", ".join(one.loop for one in initial)
        raise WrongUseError("a search begins at one controller a loop", names, "give each its own")
    search = Search(seed=seed, starts=starts, grow=grow, least_gain=least_gain)
    loops = [one.loop for one in asked] + [one.loop for one in initial if len(initial) > 1]
    if len(set(loops)) == 1:
        plants, one = equivalent_plants(P, asked[0] if together is None else asked[0].with_all(together))
        one = replace(one, structure=bounded(one.structure, plants))
        disturbed = point_disturbances(disturbance, plants[0].loop)
        return tune_one(plants, one, tuple(fits), search, start=(*initial, None)[0], disturbances=disturbed)
    known = Known(fits, recorded_under, point_disturbances(disturbance, *dict.fromkeys(loops)))
    with (watch or Unwatched()).progress("tune", 2 * len(asked)) as step:
        return tune_loops(plants_of(P), asked, initial, together, search, known, step=step)


def check(
    P: Plants,
    C: Controller | Scheduled | Tuning | Sequence[Controller | Scheduled | Tuning],
    R: Requirements | Sequence[Requirements] | None = None,
    *,
    fits: Sequence[Fit] = (),
    together: Requirements | None = None,
    loops: Sequence[str] | None = None,
    recorded_under: Sequence[Controller] = (),
    disturbance: Disturbance | Run | str | Path | Sequence[Disturbance] | None = None,
) -> Verdict:
    """Stability and margins with 95 % intervals at every operating point, and whether the requirements hold.

    The verdict's `outcome` is passed, failed, or undecided by these data; without `R` nothing is required. An unstable
    plant is told by `R.unstable_poles`, or counted from the loop that was recorded; where nothing tells, the verdict is
    undecided. Raises WrongUseError for a controller at another rate than the FRF.

    A schedule (`ls.schedules.gain_scheduled`) is checked at each FRF's operating point by the controller running there.

    With a sequence of controllers, one a loop, `P` is a square matrix FRF (`ls.frf_matrices`) and all loops are closed
    at once: each is checked with the others closed (`R`, one a loop), then all `together`: stability by det(I + L), and
    margins for changes of every loop at the same time. `loops` are those that are closed (default: all of the matrix);
    `recorded_under` are the controllers of the loops that were recorded: their count tells the plant's unstable poles
    where nothing declares them. The verdict's `each` is that of each loop. One controller in a list is one loop. Raises
    WrongUseError for a loop without a controller.

    `disturbance` tells what disturbs the loops: a run (or its folder) with recordings of the closed loops that nothing
    excites, under controllers that it knows, or `ls.Disturbance`, of several loops one each of the same time. Each
    operating point's `error_rms` is then the rms of the error under `C` with its interval, and `R.error_rms` limits it.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.5, 200.0, 100)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01, rate_hz=1000.0)
    >>> C = ls.controller(ls.gain(2.0), rate_hz=1000.0)
    >>> ls.check(P, C, ls.Requirements(modulus_margin=0.5, unstable_poles=0)).passed
    True
    """
    from loopshape.loop.verdict import check as check_loops

    given = C if isinstance(C, Sequence) else (C,)
    own = [one if isinstance(one, Scheduled) else controller_of(one) for one in given]
    asked, together = required_of(R, together)
    if len(own) == 1 and len(asked) < 2:
        plants, one = equivalent_plants(P, asked[0] if asked else Requirements(own[0].loop))
        asked = [one]
    else:
        plants = plants_of(P)
    names = loops or [one.loop for one in own]
    disturbed = point_disturbances(disturbance, *(names if len(names) > 1 or loops else [plants[0].loop]))
    return check_loops(
        plants, own, asked, tuple(fits), together=together, closed=loops, recorded_under=recorded_under,
        disturbances=disturbed,
    )  # fmt: skip


def point_disturbances(
    given: Disturbance | Run | str | Path | Sequence[Disturbance] | None, *loops: str
) -> tuple[Disturbance, ...]:
    """What disturbs loops, at each operating point: the longest recording there that shows it.

    Raises BadSignalError for a run without such a recording.
    """
    from loopshape.data.signal.disturbance import Disturbance
    from loopshape.identify.disturbance import disturbances_in

    if given is None:
        return ()
    if isinstance(given, Disturbance):
        return (given,)
    if isinstance(given, Run | str | Path):
        return disturbances_in(given if isinstance(given, Run) else read(given), *loops)
    return tuple(given)
