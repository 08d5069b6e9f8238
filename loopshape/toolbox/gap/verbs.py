"""Where a run leaves the model of its plant, or one of your own, and which effect causes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from loopshape.core.errors import WrongUseError
from loopshape.data.response.frf import FRF
from loopshape.data.signal.run import Run
from loopshape.verbs.files import read

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.effect import Fix
    from loopshape.toolbox.gap.nouns.gap_report import GapReport, Visible
    from loopshape.toolbox.gap.nouns.machine import Model
    from loopshape.toolbox.gap.nouns.plant import SimulationModel


def gap(
    run: Run | FRF | Sequence[FRF] | str | Path,
    *,
    model: Model | str | Path | None = None,
    baseline: Run | str | Path | None = None,
    table: bool = True,
    name: str | None = None,
    say: Callable[[str], None] = lambda step: None,
) -> GapReport:
    """Where a simulation leaves the machine, which effect causes it, and how far the gap shrinks with it added.

    `model` is a machine of your own, or the path of its `model.toml`, whose Python file is run (or whose MuJoCo model
    or FMU is read). Without it the run names its plant's model (`plant` in run.toml: an arm, or the servo axis). "none"
    and "unknown" are answers. `table` false leaves out the table of closed loops, which takes the longest.

    `baseline` is a run of the same machine known to be good, moved as in the run: what a model of your own leaves there
    within a window is the floor of every output that states none (`leaves` of `Output`), and no effect is named for it.

    FRFs, or a folder of import-frf, take the place of a run where the `model` is linear: every fourth of eight combs of
    lines is held out, the floor is the FRF's own error, and effects that no FRF shows are not looked for (notes).

    Raises WrongUseError for a run without a plant, for a model whose columns are mapped with a wrong sign, unit or
    zero, and for a baseline of other columns or another rate. A file of the model that changes meanwhile is told in the
    notes: the answer is of the model as it was read.
    """
    from loopshape.io.input_guard import changed, read_once
    from loopshape.toolbox.gap.diagnose.diagnose import diagnose
    from loopshape.toolbox.gap.nouns.gap_report import FloorSource
    from loopshape.toolbox.gap.own.linear import NOTE, LinearMachine

    good = baseline if isinstance(baseline, Run) or baseline is None else read(baseline)
    with read_once() as files:
        plant, whole, with_files = _simulation_model(run, model)
    label = name or (Path(run).name if isinstance(run, str | Path) else "run")
    found = diagnose(plant, whole, label, baseline=good, table=table, say=say)
    if isinstance(plant, LinearMachine):
        floors = tuple(replace(floor, source=FloorSource.FRF) for floor in found.floors)
        found = replace(found, floors=floors, proposal=None, notes=[*found.notes, NOTE])
    if later := [Path(path).name for path in changed(files)]:
        note = f"{', '.join(later)} changed meanwhile: the answer is of the model as it was read at the start"
        found = replace(found, notes=[*found.notes, note])
    return found if found.fix is None else replace(found, fix=with_files(found.fix))


def identifiability(
    run: Run | FRF | Sequence[FRF] | str | Path,
    *,
    model: Model | str | Path | None = None,
    say: Callable[[str], None] = lambda step: None,
) -> list[Visible]:
    """How small each effect may be to be seen in recordings, and which others look like it there; before a diagnosis.

    `least` of each is in its unit, None where it moves nothing; `alike` are effects whose signature is the same within
    a cosine of 0.95, so that these recordings will not tell them apart. Sizes are by straight lines, and of a machine
    without other faults. Raises as `gap`.

    >>> import numpy as np, loopshape as ls
    >>> from loopshape.data.signal.recording import Recording, RecordingInfo
    >>> rng, rate_hz = np.random.default_rng(0), 500.0
    >>> u = np.repeat(rng.normal(0.0, 0.1, 200), 10)
    >>> v = np.cumsum(u) / rate_hz / 0.02
    >>> y = np.cumsum(v) / rate_hz + 1e-5 * rng.standard_normal(u.size)
    >>> info = RecordingInfo("r.parquet", "noise", "control")
    >>> run = ls.Run(rate_hz, (), (Recording(info, rate_hz, {"torque_nm": u, "angle_rad": y}),))
    >>> axis = ls.gap.axis({"inertia": 0.02, "damping": 0.001}, "torque_nm", "angle_rad", window_s=0.4)
    >>> found = ls.gap.identifiability(run, model=axis)
    >>> "sensor_delay@encoder" in next(x for x in found if x.effect == "actuator_delay@drive").alike
    True
    """
    from loopshape.toolbox.gap.diagnose import identifiability as found

    plant, whole, _ = _simulation_model(run, model)
    return found.identifiability(plant, whole, say=say)


def _measured(run: Run | FRF | Sequence[FRF] | str | Path) -> Run | tuple[FRF, ...]:
    """A run, or the FRFs that were given in its place or stand alone in a folder."""
    from loopshape.io.run.run_folder import has_run
    from loopshape.io.write.frfs import FOLDER, has_any, read_frfs

    if isinstance(run, Run):
        return run
    if isinstance(run, str | Path):
        alone = not has_run(Path(run)) and has_any(Path(run), FOLDER)
        return read_frfs(Path(run)) if alone else read(run)
    return (run,) if isinstance(run, FRF) else tuple(run)


def _simulation_model(
    given: Run | FRF | Sequence[FRF] | str | Path, model: Model | str | Path | None
) -> tuple[SimulationModel, Run, Callable[[Fix], Fix]]:
    """The user's machine, or the plant that the run names; the run; and what puts a fix of it into files."""
    from loopshape.toolbox.gap.mechanism.fix import in_files
    from loopshape.toolbox.gap.mechanism.mechanism import machine
    from loopshape.toolbox.gap.mechanism.mockup import machine_of
    from loopshape.toolbox.gap.nouns.machine import Mechanism, Unit
    from loopshape.toolbox.gap.own.file import read_model
    from loopshape.toolbox.gap.own.kinds import with_kinds
    from loopshape.toolbox.gap.own.linear import simulable
    from loopshape.toolbox.gap.own.plant import OwnMachine
    from loopshape.toolbox.rig.registry import diagnosable

    run = _measured(given)
    if model is not None:
        own = read_model(Path(model)) if isinstance(model, str | Path) else model
        kinds = own.kinds if isinstance(run, Run) else ()  # nobody knows whether a user's own kind is linear
        if isinstance(own, Unit):
            own = machine_of(own)
        mechanism = own if isinstance(own, Mechanism) else None
        whole = with_kinds(machine(own) if isinstance(own, Mechanism) else own, kinds)
        plant, run = (OwnMachine(whole), run) if isinstance(run, Run) else simulable(whole, run)
        return plant, run, lambda fix: in_files(fix, whole, mechanism)
    if not isinstance(run, Run):
        raise WrongUseError(
            "FRFs are compared with a linear model of your own", "FRFs without a model", "give it: --model model.toml"
        )
    if run.plant is None:
        raise WrongUseError(
            "the run names no plant, so there is no model to compare with",
            "no key plant in run.toml",
            "name one (plant = ...), give a model of your own (--model model.toml), "
            "or a second run: loopshape gap RUN_REAL RUN_SIM",
        )
    return diagnosable(run.plant), run, lambda fix: fix
