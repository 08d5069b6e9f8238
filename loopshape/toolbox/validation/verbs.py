"""Predictions against a run under the predicted controllers, or FRFs of two runs against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

from loopshape.core.errors import WrongUseError
from loopshape.data.response.frf import FRF
from loopshape.data.signal.run import Run
from loopshape.identify.settings import Settings
from loopshape.io.write.frfs import FOLDER, has_any, read_frfs
from loopshape.toolbox.validation.comparison import compare_all
from loopshape.toolbox.validation.nouns import Agreement, Comparison
from loopshape.toolbox.validation.predicted.file import read_predictions
from loopshape.toolbox.validation.predicted.nouns import Prediction
from loopshape.toolbox.validation.remeasured import Remeasured, remeasure
from loopshape.verbs.arguments import plants_of
from loopshape.verbs.files import read


@overload
def compare(
    run: FRF | Sequence[FRF], predictions: FRF | Sequence[FRF], *, tolerance_db: float = 0.0
) -> list[Comparison]: ...
@overload
def compare(
    run: Run | str | Path, predictions: Sequence[Prediction], *, tolerance_db: float = 0.0, frfs: Sequence[FRF] = (),
    resolution_hz: float | None = None,
) -> list[Remeasured]: ...  # fmt: skip
def compare(
    run: Run | str | Path | FRF | Sequence[FRF],
    predictions: Sequence[Prediction] | FRF | Sequence[FRF],
    *,
    tolerance_db: float = 0.0,
    frfs: Sequence[FRF] = (),
    resolution_hz: float | None = None,
) -> list[Remeasured] | list[Comparison]:
    """Predictions against a run that was recorded under the predicted controllers: S, steps and profiles.

    Each has `comparisons` with an outcome; all together reject true predictions 5 % of the time. Deviations of |S|
    of the rms size `tolerance_db` count as none. `frfs` are those of the run that name their controller: they serve
    where it has no recording that excites the loop; `resolution_hz` is that of new estimates. Raises WrongUseError
    where no recording belongs to a prediction.

    Two FRFs, or FRFs of two runs (also of import-frf), are compared as plants: each of the second with each of the
    first that is of its loop and operating point.
    """
    from loopshape.toolbox.validation.predicted.nouns import Prediction

    listed = (predictions,) if isinstance(predictions, FRF) else tuple(predictions)
    plants = [x for x in listed if isinstance(x, FRF)]
    predictions = [x for x in listed if isinstance(x, Prediction)]
    if len(predictions if isinstance(run, Run | str | Path) else plants) < len(listed):
        raise WrongUseError(
            "a run is compared with predictions, FRFs with FRFs", "both kinds", "make predictions by ls.predict"
        )
    if not isinstance(run, Run | str | Path):
        return compare_all(plants_of(run), plants, tolerance_db=tolerance_db)
    return remeasure(
        run if isinstance(run, Run) else read(run), predictions, frfs=frfs,
        settings=Settings(resolution_hz=resolution_hz), tolerance_db=tolerance_db,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """A run against predictions, each with all that was measured of it, or its FRFs against those of another run."""

    comparisons: tuple[Comparison, ...]
    predictions: tuple[Remeasured, ...] | None = None

    @property
    def outcome(self) -> Agreement:
        """The worst of all comparisons."""
        found = [one.outcome for one in self.comparisons]
        return Agreement.worst(found) if found else Agreement.CANNOT_TELL

    @property
    def confirmed(self) -> bool:
        """Whether all comparisons confirm what was predicted."""
        return self.outcome is Agreement.CONFIRMED


def compare_run(
    run: Path, prediction: Path, *, tolerance_db: float = 0.0, resolution_hz: float | None = None
) -> ComparedRun:
    """A run against a file of predictions, or its FRFs against those of another run; settings as in `ls.compare`."""
    if has_any(prediction, FOLDER):
        return ComparedRun(tuple(compare(read_frfs(run), read_frfs(prediction), tolerance_db=tolerance_db)))
    frfs: tuple[FRF, ...] = read_frfs(run) if has_any(run, FOLDER) else ()
    found = compare(
        read(run), read_predictions(prediction), frfs=frfs, resolution_hz=resolution_hz, tolerance_db=tolerance_db
    )
    return ComparedRun(tuple(c for one in found for c in one.comparisons), tuple(found))
