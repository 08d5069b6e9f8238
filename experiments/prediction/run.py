"""The arm under its shipped controllers: what was predicted of them, what 24 equilibria show, and whether they pass.

    python experiments/prediction/run.py            with examples/arm/controller.toml as it is
    python experiments/prediction/run.py --tune     tunes it first: on the FRFs of identify.toml, and where what then
                                                    ran does not pass, again on those and on what was measured of it

Runs are kept in out/prediction; what is there is not simulated again.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

import loopshape as ls
from loopshape.core.units import deg
from loopshape.data.requirement.requirements import LIMITS, Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.run import Run
from loopshape.design.tune import tune
from loopshape.identify.fit import fit, structure_by_name
from loopshape.identify.structures import Structure
from loopshape.io.files import write_bytes_whole
from loopshape.io.requirements import read_requirements
from loopshape.io.run.run_folder import read_run
from loopshape.io.write.controllers import read_controllers, write_controllers
from loopshape.loop.verdict import check
from loopshape.toolbox.validation.pictures import comparison_grid
from loopshape.toolbox.validation.predicted.file import write_predictions
from loopshape.toolbox.validation.predicted.nouns import Prediction
from loopshape.toolbox.validation.predicted.picture import prediction_page
from loopshape.toolbox.validation.predicted.predict import predict
from loopshape.toolbox.validation.remeasured import Remeasured, remeasure
from loopshape.view.style import png

sys.path.insert(0, str(Path(__file__).parents[1] / "lab"))
from plant_behind import plant_behind

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
ARM, OUT, FIGURES = ROOT / "examples" / "arm", ROOT / "out" / "prediction", ROOT / "figures" / HERE.name
CONTROLLER, REQUIRE = ARM / "controller.toml", ARM / "requirements.toml"
TOLERANCES_DB = (0.0, 1.0)
SPARE_DB, SPARE_DEG = 0.2, 0.7
KNOWN_HZ = {"theta2": 10.0, "p_ab": 5.0}
NAMES = {"theta2": "third_order", "p_ab": "integrator"}
STRUCTURES: dict[str, Structure] = {loop: structure_by_name(name) for loop, name in NAMES.items()}
COLUMNS = (
    "loop", "theta2_deg", "p_ab_bar", "supply_bar", "stands_at_deg", "peak_s_predicted_db", "peak_s_measured_db",
    "p_value", "outcome", "outcome_1db", "worst_low_hz", "worst_high_hz", "worst_s_db", "closed_loop", "peak_s_db",
    "phase_margin_deg", "gain_margin_db", "misses", "rise_predicted_s", "rise_up_s", "rise_down_s",
    "settling_predicted_s", "settling_up_s", "settling_down_s", "overshoot_predicted", "overshoot_up",
    "overshoot_down", "error_at_end", "settled", "ended_early",
)  # fmt: skip


def main() -> None:
    """Identify, fit, (tune,) predict, measure again, compare, check; a row for each loop and equilibrium."""
    frfs = ls.frfs(ls.rig.measure(ARM / "identify.toml", OUT / "arm"))
    fits = [ls.fit(frf, NAMES[frf.loop]) for frf in frfs]
    if "--tune" in sys.argv:
        tuned_twice(frfs, fits)
    run = verified(CONTROLLER)
    rows: list[list[Any]] = []
    for own, required in zip(read_controllers(CONTROLLER), read_requirements(REQUIRE), strict=True):
        made = predict([frf for frf in frfs if frf.loop == own.loop], own, fits)
        write_predictions(OUT / f"{own.loop}.npz", made)
        found = [remeasure(run, made, tolerance_db=t) for t in TOLERANCES_DB]
        verdict = checked(run, found[0], required)
        rows += [row(run, strict, loose, verdict, required) for strict, loose in zip(*found, strict=True)]
        report(own.loop, found, verdict)
        draw(made, found[1])
    with (HERE / "results.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


def verified(controllers: Path) -> Run:
    """The run of verify.toml under these controllers, in a folder of their own."""
    folder = OUT / f"verify-{sha256(controllers.read_bytes()).hexdigest()[:8]}"
    return ls.rig.measure(ARM / "verify.toml", folder, controllers=read_controllers(controllers))


def tuned_twice(frfs: Sequence[FRF], fits: Sequence[Fit]) -> None:
    """Tune on the identified plants; then, where the loop that ran does not pass, on these and what was measured of it.

    The second time with a little to spare: the loop that then runs is measured once more, with other errors.
    """
    wishes = read_requirements(REQUIRE)
    mine = {w.loop: [frf for frf in frfs if frf.loop == w.loop] for w in wishes}
    first = [tune(mine[w.loop], w, fits).controller for w in wishes]
    write_controllers(OUT / "first.toml", first)
    run = verified(OUT / "first.toml")
    final = []
    for own, required in zip(first, wishes, strict=True):
        found = remeasure(run, predict(mine[own.loop], own, fits, draws=2))
        print(
            f"{own.loop}, tuned on FRFs alone: check of what ran: {(verdict := checked(run, found, required)).outcome}"
        )
        if verdict.passed:
            final.append(own)
            continue
        again = [replace(p, recording=f"again-{p.recording}", recordings=()) for p in plants(run, found)]
        tuning = tune([*mine[own.loop], *again], with_spare(required), [*fits, *fitted(again)])
        print(f"  again on both: feasible {tuning.feasible}, lowest bandwidth {tuning.bandwidth_hz:.3g} Hz")
        final.append(tuning.controller if tuning.feasible else own)
    write_controllers(CONTROLLER, final)


def with_spare(required: Requirements) -> Requirements:
    """The same with a little more asked of the peak of |S| and of the phase margin.

    The plants are those whose first tuning counted no unstable pole: not each one measured again tells so itself.
    """
    peak, phase = required.sensitivity_peak_db, required.phase_margin_deg
    return replace(
        required, sensitivity_peak_db=None if peak is None else peak - SPARE_DB,
        phase_margin_deg=None if phase is None else phase + SPARE_DEG, unstable_poles=0,
    )  # fmt: skip


def plants(run: Run, found: Sequence[Remeasured]) -> list[FRF]:
    """The plants behind the sensitivities that were measured."""
    return [plant_behind(frf, run.loop(frf.loop).control) for one in found for frf in one.measured]


def fitted(frfs: Sequence[FRF]) -> list[Fit]:
    """Fits of the README's structures where the plants are known: they say how many integrators there are."""
    return [fit(frf, STRUCTURES[frf.loop], weighting="relative", band_hz=(0.0, KNOWN_HZ[frf.loop])) for frf in frfs]


def checked(run: Run, found: Sequence[Remeasured], required: Requirements) -> Verdict:
    """The loops that ran, held against what was asked: plants behind their measured sensitivities, with their fits."""
    mine = plants(run, found)
    return check(mine, found[0].prediction.controller, required, fitted(mine))


def row(run: Run, strict: Remeasured, loose: Remeasured, verdict: Verdict, required: Requirements) -> list[Any]:
    """One loop at one equilibrium."""
    S, (frf,), (c,) = strict.prediction.sensitivity, strict.measured, strict.comparisons
    margins, band = verdict.margins[frf.recording], loose.comparisons[0].worst
    info = run.recording(frf.recording).info
    where = [] if band is None else [round(band.low_hz, 3), round(band.high_hz, 3), round(band.sensitivity_db, 2)]
    return [
        S.loop, S.operating_point["theta2_deg"], S.operating_point["p_ab_bar"], S.parameters.get("supply_bar", 1.0),
        round(stood_at(S.recording), 2), round(c.predicted_peak_db, 2), round(c.measured_peak_db, 2),
        f"{c.p_value:.2g}", c.outcome, loose.comparisons[0].outcome, *where, margins.stable,
        round(margins.sensitivity_peak_db, 2), round(margins.phase_margin_deg, 1),
        round(margins.gain_margin_db, 2), " ".join(misses(margins, required)),
        *step_cells(strict), info.ended_early or "",
    ]  # fmt: skip


def stood_at(name: str) -> float:
    """Angle in deg at which the arm stood on average while it was identified."""
    return float(deg(read_run(OUT / "arm").recording(name).column("theta2_rad").mean()))


def misses(margins: Margins, required: Requirements) -> list[str]:
    """Requirements whose value at this equilibrium misses what is required, whatever its interval."""
    return [
        limit.name for limit in LIMITS if (w := getattr(required, limit.name)) is not None
        and (getattr(margins, limit.name) < w if limit.sense == "at_least" else getattr(margins, limit.name) > w)
    ]  # fmt: skip


def step_cells(one: Remeasured) -> list[Any]:
    """Predicted indicators, and medians over the measured steps up and down."""
    predicted = one.prediction.step
    cells: list[Any] = []
    for name in ("rise_time_s", "settling_time_5_s", "overshoot"):
        cells.append(float("nan") if predicted is None else round(getattr(predicted.indicators, name), 3))
        for sign in (1.0, -1.0):
            cells.append(_median([getattr(s.measured, name) for s in one.steps if s.size * sign > 0.0]))
    cells.append(_median([s.measured.steady_state_error for s in one.steps]))
    settled = sum(s.measured.outcome == "settled" for s in one.steps)
    return [*cells, f"{settled} of {len(one.steps)}"]


def _median(values: Sequence[float]) -> float:
    return round(float(np.median(values)), 3) if values else float("nan")


def report(loop: str, found: Sequence[Sequence[Remeasured]], verdict: Verdict) -> None:
    """A few lines for people."""
    for tolerance, every in zip(TOLERANCES_DB, found, strict=True):
        outcomes = [one.comparisons[0].outcome for one in every]
        print(f"{loop}, tolerance {tolerance:g} dB: {outcomes.count('confirmed')} of {len(outcomes)} confirmed")
    print(f"{loop}: check of what ran: {verdict.outcome}")
    for name in verdict.unstable:
        print(f"  {name}: {verdict.margins[name].stable}, {verdict.margins[name].stability_reason}")
    for line in verdict.lines:
        print(
            f"  {line.quantity}: required {line.required:g}, worst {line.value:.3g} at {line.recording}, {line.outcome}"
        )
    steps = [s for one in found[0] for s in one.steps]
    print(f"{loop}: {sum(s.measured.outcome == 'settled' for s in steps)} of {len(steps)} steps settle")


def draw(made: Sequence[Prediction], found: Sequence[Remeasured]) -> None:
    """Predicted pages, sensitivities and steps of one loop."""
    loop = made[0].loop
    measured: list[FRF] = [one.measured[0] for one in found]
    pages = {
        "predicted": prediction_page(made),
        "compared": comparison_grid(made, measured, [one.comparisons[0] for one in found]),
    }
    for name, figure in pages.items():
        write_bytes_whole(FIGURES / f"{name}_{loop}.png", png(figure))


if __name__ == "__main__":
    main()
