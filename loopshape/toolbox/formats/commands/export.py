"""`loopshape export`, `export-controller`, `export-excitation`: FRFs, controllers, signals for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, DiagramFile, Output, Quiet, RunFolder
from loopshape.toolbox.rig.commands.measure import StudyFile

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.control.scheduled import Scheduled
    from loopshape.toolbox.formats.controllers.limited import OutputLimits

BACK = "back_calculation"


def export(
    run: RunFolder,
    to: Annotated[str, typer.Option(help="mat (MATLAB), hdf5, csv, or uff (type 58; needs the extra uff).")],
    out: Annotated[Path | None, typer.Option(help="Folder to write into; default: export in the run.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write each FRF of a run as a file. All of them or none; import-frf reads them back."""
    from loopshape.io.files import inside
    from loopshape.io.write.frfs import FOLDER, MATRICES, has_any, read_frfs, read_matrices
    from loopshape.toolbox.formats.frf.frf_exchange import export_frfs

    output = Output(as_json, quiet)
    folder = out or inside(run, "export", "the folder of exported FRFs")
    matrices = read_matrices(run) if has_any(run, MATRICES) else ()
    single = read_frfs(run) if not matrices or has_any(run, FOLDER) else ()
    frfs = (*single, *matrices)
    paths, lost = export_frfs(frfs, to, folder)
    columns = ["file", "recording", "loop", "outputs", "inputs", "lines"]
    rows = [
        [path.name, one.recording, one.loop, ", ".join(one.outputs), ", ".join(one.inputs), one.frequency_hz.size]
        for path, one in zip(paths, frfs, strict=True)
    ]
    output.table(f"FRFs in {folder}", columns, rows)
    output.warn(lost)
    output.json({"run": str(run), "format": to, "files": paths, "warnings": lost})


def export_controller(
    controller: Annotated[Path, typer.Argument(help="A controller file, as tune writes it.", show_default=False)],
    to: Annotated[str, typer.Option(help="The program or machine that it is for, as listed above.")],
    out: Annotated[Path, typer.Option(help="Folder to write into, one file a loop.")],
    diagram: DiagramFile = None,
    run: Annotated[Path | None, typer.Option(help="With --diagram: the run that holds the FRFs of its plants.")] = None,
    limits: Annotated[
        str | None, typer.Option(help="Output limits LOW:HIGH or LOW:HIGH:RATE per s (c, st, twincat, json).")
    ] = None,
    anti_windup: Annotated[str, typer.Option(help="With --limits: back_calculation or conditional.")] = BACK,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write each controller of a file as it runs. Its sections, rounded to its precision, as check takes them.

    With --diagram the file's controller is that of its tuned block, and all blocks are written with one step that leads
    from what is measured to what enters the plants (c or json).

    Of --to: json, matlab, simulink, c, st, twincat, foton, sos, px4, ardupilot, betaflight, odrive or sercos.
    """
    from loopshape.data.control.controller import Controller

    output = Output(as_json, quiet)
    written, whole = _written(controller, to, out, diagram, run, limits, anti_windup)
    found = list(written)
    controllers = [one for one in found if isinstance(one, Controller)]
    paths = [written[one] for one in controllers]
    for one in (one for one in found if not isinstance(one, Controller)):
        output.say(f"{written[one]}: {one}")
    columns = ["file", "loop", "digest", "precision", "sections", "moved by rounding [%]"]
    rows = [
        [path.name, one.loop, one.digest, one.precision, len(one.blocks), 100.0 * one.moved_by_rounding()]
        for path, one in zip(paths, controllers, strict=True)
    ]
    if rows:
        output.table(f"Controllers in {out}", columns, rows)
    if whole is not None:
        output.say(f"the step from what is measured to what enters the plants: {whole}")
    keys = ("file", "loop", "digest", "precision", "sections", "moved_by_rounding_percent")
    answer = [dict(zip(keys, [str(path), *row[1:]], strict=True)) for path, row in zip(paths, rows, strict=True)]
    output.json(
        {
            "controllers": str(controller),
            "format": to,
            "exported": answer,
            "schedules": [written[one] for one in found if one not in controllers],
            "diagram": whole,
        }
    )


def _written(
    controller: Path, to: str, out: Path, diagram: Path | None, run: Path | None, limits: str | None, anti_windup: str
) -> tuple[dict[Controller | Scheduled, Path], Path | None]:
    """Each controller's file, and that of the diagram that leads from one to the other."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.write.check_files import controller_of
    from loopshape.io.write.controllers import read_controllers, read_loop_controllers
    from loopshape.toolbox.diagrams.diagram_c import controllers_of, export_diagram
    from loopshape.toolbox.diagrams.files import read_diagram
    from loopshape.toolbox.formats.controllers.controller_export import export_controllers

    if (diagram is None) != (run is None):
        raise WrongUseError("a diagram is exported with the run that holds its plants", "one of them", "give both")
    if diagram is None or run is None:
        found = read_loop_controllers(controller)
        return dict(zip(found, export_controllers(out, found, to, _limits(limits, anti_windup)), strict=True)), None
    if limits is not None:
        raise WrongUseError("the limits of a diagram's outputs belong to its caller", limits, "leave --limits out")
    D = read_diagram(diagram, run)
    D = D.with_part(D.tuned, controller_of(read_controllers(controller), D.tuned))
    *files, whole = export_diagram(out, D, to)
    return dict(zip(controllers_of(D), files, strict=True)), whole


def _limits(text: str | None, anti_windup: str) -> OutputLimits | None:
    """Limits of an output from LOW:HIGH or LOW:HIGH:RATE."""
    from loopshape.core.errors import WrongUseError, refuse_unknown
    from loopshape.toolbox.formats.controllers.limited import AntiWindup, OutputLimits

    refuse_unknown("anti-windup of a controller is not known", anti_windup, list(AntiWindup))
    if text is None:
        return None
    try:
        low, high, rate = (float(part) for part in f"{text}:inf".split(":")[:3])
    except ValueError:
        raise WrongUseError("limits are LOW:HIGH or LOW:HIGH:RATE", text, "for example --limits=-10:10:200") from None
    return OutputLimits(low, high, rate, AntiWindup(anti_windup))


def export_excitation(
    study: StudyFile,
    to: Annotated[str, typer.Option(help="csv, mat (MATLAB and Simulink), or c (a C99 header).")],
    out: Annotated[Path, typer.Option(help="Folder to write into, one file an experiment.")],
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write a study's injected signals and setpoints. Sample by sample, for a rig that loads files."""
    from loopshape.toolbox.formats.controllers.excitation_export import export_signals
    from loopshape.toolbox.rig import registry
    from loopshape.toolbox.rig.described import DescribedRig
    from loopshape.toolbox.rig.files.study import read_study
    from loopshape.toolbox.rig.simulated import experiment, plan

    output, read = Output(as_json, quiet), read_study(study)
    plant = DescribedRig(read.loops) if read.loops else registry.plant(read.plant)
    made = [experiment(read, plant, planned) for planned in plan(read, plant)]
    paths = export_signals(out, made, to)
    rows = [(path.name, e.injection, e.samples, e.rate_hz) for path, e in zip(paths, made, strict=True)]
    output.table(f"Signals in {out}", ("file", "injection", "samples", "Hz"), rows)
    output.json({"study": str(study), "format": to, "exported": paths})


def firmware(
    parameters: Annotated[Path, typer.Argument(help="Parameters, as a ground station or `dump` writes them.")],
    of: Annotated[str, typer.Option(help="px4, ardupilot, betaflight, odrive or sercos.")],
    rate_hz: Annotated[float, typer.Option(help="Rate of the loop.")],
    out: Annotated[Path, typer.Option(help="The controller file to write.")],
    axis: Annotated[str, typer.Option(help="roll, pitch or yaw; of drives position, velocity or current.")] = "roll",
    notch: Annotated[
        list[str] | None,
        typer.Option(help="A dynamic notch, FREQUENCY:WIDTH in Hz (betaflight: FREQUENCY:Q)."),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Read a firmware's or a drive's loop as a controller.

    export-controller writes its parameters back.
    """
    from loopshape.io.write.controllers import write_controllers
    from loopshape.toolbox.formats.controllers.drives import controller_of_parameters
    from loopshape.toolbox.formats.controllers.firmware import left_out, read_parameters, with_notches

    output, given = Output(as_json, quiet), read_parameters(parameters)
    made, missing = controller_of_parameters(given, of, axis, rate_hz), left_out(given, of, axis)
    made = with_notches(made, notch or (), of)
    write_controllers(out, [made], {"firmware": of, "parameters": parameters.name, "left_out": list(missing)})
    rows = [[block.kind, ", ".join(f"{k} {v:.6g}" for k, v in block.parameters.items())] for block in made.blocks]
    output.table(f"Loop {axis} of {of} in {out}", ["block", "parameters"], rows)
    output.warn(missing)
    answer = {"controller": str(out), "firmware": of, "axis": axis, "warnings": list(missing)}
    output.json(answer | {"blocks": made.blocks})
