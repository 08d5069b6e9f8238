"""Several loops of one plant: its matrix FRF, how much the loops interact, and the verdict on all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.core.errors import BadSignalError
from loopshape.data.response.frf import FRF
from loopshape.data.signal.run import Run
from loopshape.identify.settings import Settings, settings_of
from loopshape.verbs.files import read
from loopshape.verbs.watch import Unwatched, Watch

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.response.interaction import Interaction
    from loopshape.data.signal.recording import Recording


def frf_matrices(run: Run | str | Path, **settings: Any) -> tuple[FRF, ...]:
    """The plant's matrix FRF (nf, ny, nu) at each operating point whose recordings excite two loops or more.

    `settings` as in `frfs`. Raises BadSignalError for a run without such an operating point.
    """
    from loopshape.identify.frequency_response import excited_recordings

    whole = run if isinstance(run, Run) else read(run)
    return tuple(matrices_of(whole, excited_recordings(whole), settings_of(settings), Unwatched()))


def matrices_of(run: Run, recordings: Sequence[Recording], settings: Settings, watch: Watch) -> list[FRF]:
    """The plant's matrix from these recordings of a run, at each operating point."""
    from loopshape.identify.groups import matrices
    from loopshape.identify.matrix.matrix import estimate_matrix

    groups = matrices([r for r in recordings if r.info.ended_early is None])
    if not groups:
        raise BadSignalError(
            "no operating point of the run has recordings that excite two loops",
            ", ".join(f"{r.info.name}: {'+'.join(r.info.excited)}" for r in recordings),
            "excite each loop in a recording of its own, or several at once (excitations in a study)",
        )
    found = []
    with watch.progress("matrices", len(groups)) as step:
        for group in groups:
            found.append(estimate_matrix(run, group, settings))
            step(found[-1].loop)
    return found


def interaction(
    P: FRF,
    loops: Sequence[str] | None = None,
    controllers: Mapping[str, Controller] | None = None,
    *,
    outputs: Sequence[str] | None = None,
    limit_db: float = -20.0,
    bands: Sequence[tuple[float, float]] | None = None,
) -> Interaction:
    """Coupling between the loops of a matrix FRF, frequency by frequency, with 95 % bounds.

    Interaction coefficients, relative gains (Bristol, IEEE Trans. Automatic Control 11(1), 1966) and the plant that a
    loop meets with the others closed, by `controllers` where those are known, by loop. `outputs` are the loops' rows
    where names do not tell. Each of the `bands` in Hz (octaves by default) is judged against `limit_db`. Raises
    WrongUseError for an FRF of a single loop.
    """
    from loopshape.identify.matrix.interaction import interaction as interaction_of

    return interaction_of(P, loops, controllers, outputs=outputs, limit_db=limit_db, bands=bands)
