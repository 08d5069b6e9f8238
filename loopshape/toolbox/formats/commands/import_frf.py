"""`loopshape import-frf`: an FRF that somebody else measured, as fit, tune, check and figures take it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.response.frf import FRF


def import_frf(
    file: Annotated[
        Path, typer.Argument(help="MAT, HDF5, CSV and other tables, UFF, Touchstone, LIGO XML.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="The folder to write, or to add to; fit and check take it as a run.")],
    recording: Annotated[str, typer.Option(help="Its name; default: the file's.")] = "",
    loop: Annotated[str, typer.Option(help="Its loop's name, as requirements name it; default: the outputs.")] = "",
    inputs: Annotated[str, typer.Option(help="Names with units, z_v,w_nm; default: the file's.")] = "",
    outputs: Annotated[str, typer.Option(help="Names with units, y_rad,x_m; default: the file's.")] = "",
    pick: Annotated[list[str] | None, typer.Option(help="OUTPUT/INPUT to take; may be repeated.")] = None,
    relative_std: Annotated[float | None, typer.Option(help="sqrt(E|d|²)/|G|, where the file holds no error.")] = None,
    averages: Annotated[float | None, typer.Option(help="Averages behind the file's coherence.")] = None,
    rate_hz: Annotated[float, typer.Option(help="Rate of the loop; tune needs it.")] = 0.0,
    negative: Annotated[
        bool, typer.Option("--negative", help="Flip the sign (measured with negative feedback).")
    ] = False,
    complete_loop: Annotated[
        Path | None, typer.Option(help="Measured as L = C P under this controller (TOML): divide it out.")
    ] = None,
    hold: Annotated[bool, typer.Option("--hold", help="Measured as continuous: multiply the hold in.")] = False,
    delay_s: Annotated[float, typer.Option(help="With --hold: delay of the computation.")] = 0.0,
    replace: Annotated[bool, typer.Option("--replace", help="Put it in place of that of the same name.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Import an FRF from a file, with its error.

    The error is the file's or a stated one; the files' keys are in docs/frf_files.md.
    """
    from loopshape.core.errors import WrongUseError
    from loopshape.toolbox.formats.frf.frf_exchange import add_frfs, read_frf_file
    from loopshape.toolbox.formats.frf.frf_foreign import Stated

    if (hold and not rate_hz) or (delay_s and not hold):
        raise WrongUseError("a hold is that of a rate, and a delay goes with it", "", "say --hold with --rate-hz")
    recorded_under = None if complete_loop is None else _controller(complete_loop, loop)
    stated = Stated(
        relative_std, averages, _names(inputs), _names(outputs), recording, loop, 0.0 if hold else rate_hz, negative,
        recorded_under,
    )  # fmt: skip
    found = read_frf_file(file, stated)
    if hold:
        from loopshape.data.algebra import with_hold

        found = with_hold(found, rate_hz, delay_s)
    frfs = _picked(found, pick or [], loop)
    _check_units(frfs)
    paths = add_frfs(out, frfs, replace_same=replace)
    _report(out, frfs, paths, Output(as_json, quiet))


def _controller(file: Path, loop: str) -> Controller:
    """The controller under which a loop was measured: of the loop's name, or the only one."""
    from loopshape.io.write.check_files import controller_of
    from loopshape.io.write.controllers import read_controllers

    found = read_controllers(file)
    return found[0] if len(found) == 1 else controller_of(found, loop)


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _picked(frf: FRF, pairs: list[str], loop: str) -> list[FRF]:
    """The requested elements, each a loop of its own; all in one without any."""
    from dataclasses import replace

    from loopshape.core.errors import WrongUseError
    from loopshape.data.algebra import channels
    from loopshape.data.response.frf_arrays import valid_frequencies

    if not pairs:
        return [frf]
    if loop and len(pairs) > 1:
        raise WrongUseError(
            "several elements are several loops", f"--loop {loop}", "import them one by one, or without"
        )
    found = []
    for pair in pairs:
        output, slash, source = pair.partition("/")
        if not slash:
            raise WrongUseError("an element is picked by its output and input", repr(pair), "write OUTPUT/INPUT")
        one = replace(channels(frf, [output.strip()], [source.strip()]), loop=loop or output.strip())
        if len(frf.inputs) == 1 and frf.multiple_coherence is not None:  # each output is as sure as its own coherence
            one = replace(one, valid=valid_frequencies(one.frequency_hz, one.response, one.covariance))
        found.append(one)
    return found


def _check_units(frfs: list[FRF]) -> None:
    """Names must end in their unit: fits and pictures read it there."""
    from loopshape.core.errors import WrongUseError
    from loopshape.data.signal.channel import Channel

    for frf in frfs:
        for option, names in (("--inputs", frf.inputs), ("--outputs", frf.outputs)):
            try:
                _ = [Channel.from_column(name) for name in names]
            except WrongUseError as error:
                raise WrongUseError(error.what, error.received, f"{error.way_out}, and name all by {option}") from None


def _report(out: Path, frfs: list[FRF], paths: tuple[Path, ...], output: Output) -> None:
    import numpy as np

    columns = ["recording", "loop", "outputs", "inputs", "valid from [Hz]", "to [Hz]", "lines", "median std [dB]"]
    rows = []
    for one in frfs:
        std = one.modulus_std[:, 0, 0]
        spread = float(20.0 * np.log10(1.0 + np.median(std)))
        low, high = one.valid_band_hz
        names = [", ".join(one.outputs), ", ".join(one.inputs)]
        rows.append([one.recording, one.loop, *names, low, high, int(one.frequency_hz.size), spread])
    output.table(f"Imported into {out}", columns, rows)
    notes = [f"{one.recording}: {note}" for one in frfs for note in one.notes]
    for note in notes:
        output.say(note)
    warnings = [
        f"{one.loop} has several channels: fit, tune and check take one output and input (--pick OUTPUT/INPUT)"
        for one in frfs
        if one.response.shape[1:] != (1, 1)
    ]
    warnings += [
        f"no line of {one.loop} is known to 10 %: fit and check need a band" for one in frfs if not one.valid.any()
    ]
    output.warn(warnings)
    keys = ("recording", "loop", "outputs", "inputs", "valid_from_hz", "valid_to_hz", "lines", "median_std_db")
    output.json(
        {
            "run": str(out),
            "frfs": [dict(zip(keys, row, strict=True)) | {"file": str(p)} for row, p in zip(rows, paths, strict=True)],
            "notes": notes,
            "warnings": warnings,
        }
    )
