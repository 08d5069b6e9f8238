"""`loopshape tones`: rms of each channel of a run, and tones that the excitation does not explain."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.verbs.pictures import figures_of

if TYPE_CHECKING:
    from loopshape.data.signal.run import Run
    from loopshape.toolbox.planning.tone.nouns import Tone, Tones

_RMS = ("recording", "channel", "unit", "rms", "95 % from", "to", "tones")
_TONE = (
    "recording", "channel", "f [Hz]", "amplitude", "growth [dB]", "", "from [s]", "to [s]", "chance",
)  # fmt: skip


def tones(
    run: RunFolder,
    channel: Annotated[
        list[str] | None, typer.Option(help="A column; may be given again. Default: errors, outputs and controls.")
    ] = None,
    chance: Annotated[
        float, typer.Option(min=1e-12, max=0.5, help="Chance of any tone being reported in a channel of noise alone.")
    ] = 0.01,
    figures: Annotated[bool, typer.Option(help="Draw the spectrum of each channel that holds a tone.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Rms and tonal disturbances of each channel.

    Frequency, amplitude and growth of each tone, without what the excitation causes.
    """
    from loopshape.io.run.run_folder import read_run
    from loopshape.toolbox.planning.tone.verbs import tones as tones_of

    output = Output(as_json, quiet)
    whole = read_run(run)
    found = tones_of(whole, channels=channel or (), chance=chance)
    report(found, output)
    drawn = draw(run, whole, found) if figures else []
    output.say("\n".join(["figures:", *drawn]) if drawn else "no figures drawn")
    output.json({"run": str(run), "channels": [one.to_dict() for one in found], "figures": drawn})


def report(found: Sequence[Tones], output: Output) -> None:
    """Table of rms, table of tones, and a warning for each that grows."""
    rows = [[x.recording, x.channel, x.unit, x.rms, *x.rms_interval, len(x.tones)] for x in found]
    output.table("Rms about the mean", _RMS, rows)
    tones = [_row(x, tone) for x in found for tone in x.tones]
    if tones:
        output.table("Tones that the excitation does not explain (amplitude in the middle, ± 95 %)", _TONE, tones)
    else:
        output.say("no tone that the excitation does not explain")
    output.warn(warning for x in found for warning in x.warnings)


def _row(x: Tones, tone: Tone) -> list[Any]:
    return [
        x.recording, x.channel, _with(tone.frequency_hz, tone.frequency_interval_hz),
        _with(tone.amplitude, tone.amplitude_interval) + f" {x.unit}", _with(tone.growth_db, tone.growth_interval_db),
        tone.growth.value, tone.from_s, tone.to_s, f"{tone.chance:.1g}",
    ]  # fmt: skip


def _with(value: float, interval: tuple[float, float]) -> str:
    from loopshape.view.labels import plus_minus

    return plus_minus(value, 0.5 * (interval[1] - interval[0]))


def draw(folder: Path, run: Run, found: Sequence[Tones]) -> list[str]:
    """A page for each channel that holds a tone."""
    from loopshape.toolbox.planning.tone.pictures import tones_page
    from loopshape.toolbox.planning.tone.verbs import signal_of
    from loopshape.verbs.pictures import save

    drawn = []
    for one in found:
        if one.tones:
            recording = run.recording(one.recording)
            name = f"tones_{one.recording}_{one.channel.replace(' ', '_')}.png"
            figure = tones_page(one, signal_of(run, recording, one), recording.rate_hz)
            drawn.append(str(save(figure, figures_of(folder) / name)))
    return drawn
