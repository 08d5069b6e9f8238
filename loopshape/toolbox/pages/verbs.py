"""The page on which loops are shaped by hand, and a run's report: from nouns and folders to a file of HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, overload

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.signal.run import Run
from loopshape.verbs.arguments import Plants, controller_of, plants_of, required_of
from loopshape.verbs.chain import point_disturbances

if TYPE_CHECKING:
    from loopshape.data.signal.disturbance import Disturbance
    from loopshape.design.tune import Tuning
    from loopshape.toolbox.pages.report.run_report import RunReport
    from loopshape.toolbox.pages.shape.widget import ShapeWidget

FIGURES_MB, MOST_MB = 0.7, 1e6  # pictures that a report carries, together, and the most that may be asked for


@overload
def shape(
    P: Plants | Mapping[str, FRF], C: Controller | Tuning | Sequence[Controller] | None = None,
    R: Requirements | Sequence[Requirements] | None = None, out: str | Path = "shape.html", *,
    fits: Sequence[Fit] = (), together: Requirements | None = None,
    disturbance: Disturbance | Run | str | Path | Sequence[Disturbance] | None = None,
) -> Path: ...  # fmt: skip


@overload
def shape(
    P: Plants | Mapping[str, FRF], C: Controller | Tuning | Sequence[Controller] | None,
    R: Requirements | Sequence[Requirements] | None, out: None, *,
    fits: Sequence[Fit] = (), together: Requirements | None = None,
    disturbance: Disturbance | Run | str | Path | Sequence[Disturbance] | None = None,
) -> ShapeWidget: ...  # fmt: skip


def shape(
    P: Plants | Mapping[str, FRF], C: Controller | Tuning | Sequence[Controller] | None = None,
    R: Requirements | Sequence[Requirements] | None = None, out: str | Path | None = "shape.html", *,
    fits: Sequence[Fit] = (), together: Requirements | None = None,
    disturbance: Disturbance | Run | str | Path | Sequence[Disturbance] | None = None,
) -> Path | ShapeWidget:  # fmt: skip
    """Write the page on which a loop is shaped by hand: one HTML file that works offline; gives its path.

    With None for `out` it is a widget instead, for the cell of a notebook (extra `notebook`): its `controller` and
    `requirements` (of several loops tuples) follow the page and the page follows them.

    `P`: an FRF, several, or a mapping from operating points to FRFs. Shaping starts from `C` (default: a gain
    of 1). Margins, intervals, stability and the detuning margin are computed in the page as `check` computes them; with
    `fits` it draws the step of each fit's loop. Several controllers (and requirements) are of the loops of a matrix
    FRF: each is shaped on the plant that it meets with the others closed; `together` declares that plant's poles. With
    what disturbs a single loop (`disturbance`, as of `check`) the page tells rms of error and input under each design.
    Raises WrongUseError as `check` does.

    Examples
    --------
    >>> import numpy as np, loopshape as ls, tempfile
    >>> f_hz = np.geomspace(0.5, 200.0, 100)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01)
    >>> page = ls.shape(P, ls.controller(ls.gain(2.0), rate_hz=1000.0), out=f"{tempfile.mkdtemp()}/shape.html")
    >>> page.name
    'shape.html'
    """
    from loopshape.toolbox.pages.shape.shaping import ShapedLoops, notebook_widget, write_page

    plants = plants_of([replace(frf, recording=name) for name, frf in P.items()] if isinstance(P, Mapping) else P)
    required, together = required_of(R, together)
    own = [controller_of(one) for one in (C if isinstance(C, Sequence) else (C,)) if one is not None]
    disturbed = point_disturbances(disturbance, plants[0].loop)
    loops = ShapedLoops(plants, tuple(required), together, fits=tuple(fits), disturbances=disturbed)
    if out is None:
        return notebook_widget(loops, own, "Shape")
    write_page(Path(out), loops.sessions(own), "Shape")
    return Path(out)


def figure_bytes(megabytes: float) -> int:
    """Size of the pictures that a report carries; refuses what is no size."""
    if not 0.0 <= megabytes <= MOST_MB:
        what = f"the size of the embedded pictures (figures_mb) is a number of 0 .. {MOST_MB:g} MB"
        raise WrongUseError(what, f"{megabytes:g} MB")
    return int(1e6 * megabytes)


def report(
    run_folder: str | Path,
    out: str | Path | None = None,
    *,
    controllers: str | Path | None = None,
    requirements: str | Path | None = None,
    diagram: str | Path | None = None,
    date: str | None = None,
    figures_mb: float = FIGURES_MB,
    author: str = "",
    matrix: bool = False,
) -> Path:
    """Write all that is known of a run folder as one HTML page that opens offline (default: report.html in it).

    With the files of `controllers` and `requirements` the page holds loops, margins and verdict; with that of a
    `diagram` its picture too, and the controller stands on what its tuned block meets. All loops of the plant's matrix
    are checked at once where `matrix`, or a table [several] of the requirements, asks for it. `date` and `author` stand
    at its head; `figures_mb` limits the pictures beside the main ones. Raises
    UnreadableInputError for a folder with neither recordings nor FRFs.
    """
    given = [None if x is None else Path(x) for x in (controllers, requirements, diagram)]
    path = Path(out or Path(run_folder) / "report.html")
    write_report(path, Path(run_folder), given, date, figures_mb, author, matrix)
    return path


def write_report(
    path: Path,
    folder: Path,
    given: Sequence[Path | None],
    date: str | None,
    figures_mb: float,
    author: str,
    matrix: bool,
) -> tuple[RunReport, int]:
    """Write a run's report from files of controllers, requirements and diagram; gives it and its size in bytes."""
    from loopshape.io.files import write_bytes_whole
    from loopshape.toolbox.pages.report.page import page
    from loopshape.toolbox.pages.report.report_inputs import gather

    day = date or datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    made = gather(folder, given[0], given[1], day, figure_bytes(figures_mb), given[2], author, matrix=matrix)
    data = page(made).encode("utf-8")
    write_bytes_whole(path, data)
    return made, len(data)
