"""The command line: one file a command, heavy imports inside them, errors as one sentence and exit code 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup

from loopshape.cli import INTERRUPTED, script
from loopshape.cli.design.profiles import profiles
from loopshape.cli.design.shape import shape
from loopshape.cli.design.tune import tune
from loopshape.cli.estimate.figures import figures
from loopshape.cli.estimate.fit import fit
from loopshape.cli.estimate.frf import frf
from loopshape.cli.estimate.interaction import interaction
from loopshape.cli.examples import examples
from loopshape.cli.output import complain, for_any_terminal, safe
from loopshape.cli.verify.check import check
from loopshape.cli.verify.compare import compare
from loopshape.cli.verify.predict import predict
from loopshape.cli.verify.report import report
from loopshape.cli.verify.verify import verify
from loopshape.core.errors import LoopshapeError
from loopshape.core.interrupts import ENDED, ended_soon, interrupted, say_once
from loopshape.toolbox.arm.commands.demo import demo
from loopshape.toolbox.arm.commands.equilibria import equilibria
from loopshape.toolbox.campaign.commands import campaign
from loopshape.toolbox.formats.commands.export import export, export_controller, export_excitation, firmware
from loopshape.toolbox.formats.commands.import_file import import_file
from loopshape.toolbox.formats.commands.import_frf import import_frf
from loopshape.toolbox.gap.commands.effects import effects
from loopshape.toolbox.gap.commands.gap import gap
from loopshape.toolbox.learning.commands.feedforward import feedforward
from loopshape.toolbox.learning.commands.learning import learning
from loopshape.toolbox.learning.commands.next_trial import next_trial
from loopshape.toolbox.limits.command import bound
from loopshape.toolbox.planning.commands.plan import plan
from loopshape.toolbox.planning.commands.tones import tones
from loopshape.toolbox.rig.commands.emulator import emulator
from loopshape.toolbox.rig.commands.measure import measure
from loopshape.toolbox.rig.commands.simulate import simulate
from loopshape.toolbox.rig.commands.stop import stop
from loopshape.toolbox.schedules.command import schedule

HELP = """From closed-loop recordings of a motion system to a tuned, checked controller, and to why a simulation lies.

measure or import a run -> frf -> fit -> tune -> check -> predict; measure again -> compare; any run -> report, gap;
frf -> interaction, plan, export; controller -> shape, export-controller, bound, schedule.
Exit codes: 0 pass, 1 a requirement is missed or undecided or something is worse than a baseline, 2 wrong use or
unreadable input, 130 interrupted.
"""

#: commands by what they are for: name, function, an example
COMMANDS: dict[str, tuple[tuple[str, Callable[..., None], str], ...]] = {
    "Start": (
        ("demo", demo, "loopshape demo --out demo"),
        ("examples", examples, "loopshape examples --out examples"),
    ),
    "Measure and import": (
        ("measure", measure, "loopshape measure examples/arm/identify.toml --out runs/arm"),
        ("simulate", simulate, "loopshape simulate examples/arm/steps.toml --out runs/steps --effect payload=20"),
        ("campaign", campaign, "loopshape campaign campaign.toml --out runs/many --workers 2"),
        ("import", import_file, "loopshape import recording.csv --map map.toml --out runs/axis"),
        ("import-frf", import_frf, "loopshape import-frf plant.mat --relative-std 0.02 --out runs/plant"),
        ("emulator", emulator, "loopshape emulator --tcp 4040"),
        ("stop", stop, "loopshape stop runs/arm"),
    ),
    "Estimate": (
        ("frf", frf, "loopshape frf runs/axis"),
        ("fit", fit, "loopshape fit runs/axis --structure auto"),
        ("interaction", interaction, "loopshape interaction runs/arm2"),
        ("plan", plan, "loopshape plan runs/axis --std-percent 5"),
        ("tones", tones, "loopshape tones runs/axis"),
        ("figures", figures, "loopshape figures runs/axis --controller controller.toml"),
    ),
    "Design": (
        ("tune", tune, "loopshape tune runs/axis --require requirements.toml --out controller.toml"),
        ("shape", shape, "loopshape shape runs/axis --require requirements.toml --out shape.html"),
        ("bound", bound, "loopshape bound runs/axis controller.toml --require requirements.toml"),
        ("profiles", profiles, "loopshape profiles --out mine.toml"),
        ("feedforward", feedforward, "loopshape feedforward runs/axis --band-hz 0.5 20 --out feedforward.json"),
        ("learning", learning, "loopshape learning runs/axis controller.toml --band-hz 0.5 20 --out learning.json"),
        ("next-trial", next_trial, "loopshape next-trial runs/move learning.json --out next.csv"),
        ("schedule", schedule, "loopshape schedule runs/axis --controller controller.toml --require requirements.toml"),
    ),
    "Verify": (
        ("check", check, "loopshape check runs/axis controller.toml --require requirements.toml"),
        ("predict", predict, "loopshape predict runs/axis controller.toml --out prediction.npz"),
        ("compare", compare, "loopshape compare runs/after prediction.npz"),
        ("report", report, "loopshape report runs/axis --controller controller.toml --require requirements.toml"),
        ("verify", verify, "loopshape verify runs/axis"),
    ),
    "Diagnose": (
        ("gap", gap, "loopshape gap runs/arm"),
        ("effects", effects, "loopshape effects arm-1dof"),
        ("equilibria", equilibria, "loopshape equilibria --out figures"),
    ),
    "Exchange": (
        ("export", export, "loopshape export runs/axis --to mat --out frfs"),
        ("export-controller", export_controller, "loopshape export-controller controller.toml --to c --out firmware"),
        (
            "firmware",
            firmware,
            "loopshape firmware px4.params --of px4 --rate-hz 1000 --out controller.toml",
        ),
        ("export-excitation", export_excitation, "loopshape export-excitation study.toml --to csv --out signals"),
    ),
}


def _shown(error: Exception) -> Exception:
    """An error of use with the words of the command line as a terminal may show them: not every typer sees to it."""
    if hasattr(error, "format_message") and isinstance(message := getattr(error, "message", None), str):
        error.message = safe(message)  # type: ignore[attr-defined]
    return error


class Grouped(TyperGroup):
    """The commands under headings, in the order of the work."""

    def invoke(self, ctx: Any) -> Any:
        """A command; an interrupt ends it in one sentence, whatever a library made of the exception."""
        try:
            done = super().invoke(ctx)
        except typer.Exit:
            raise
        except KeyboardInterrupt as stopped:
            said = str(stopped)
        except Exception as error:
            if not interrupted():
                raise _shown(error) from None
            said = ""
        else:
            if not interrupted():
                return done
            said = ""
        say_once(said or INTERRUPTED)
        raise typer.Exit(ENDED)

    def make_context(self, *args: Any, **words: Any) -> Any:
        """Of the program's own options; what is wrong with them steers no terminal."""
        try:
            return super().make_context(*args, **words)
        except Exception as error:
            raise _shown(error) from None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Each heading with its commands and what they do."""
        for heading, commands in COMMANDS.items():
            rows = [(name, self.commands[name].get_short_help_str(formatter.width - 22)) for name, _, _ in commands]
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=20)


app = typer.Typer(cls=Grouped, help=HELP, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)
for commands in COMMANDS.values():
    for name, function, example in commands:
        app.command(name, epilog=f"Example: {example}")(function)


def _print_version(asked: bool) -> None:
    if asked:
        from loopshape import __version__

        print(__version__)
        raise typer.Exit


@app.callback()
def program(
    version: bool = typer.Option(
        False, "--version", help="Print the version and stop.", is_eager=True, callback=_print_version
    ),
) -> None:
    """Options of the program itself."""


def run() -> None:
    """Entry point: what the user can put right becomes a sentence on standard error and exit code 2.

    So does the end of a command whose files another process changed after they were read.
    """
    from loopshape.io.files import remove_own_parts
    from loopshape.io.seen import noting, refuse_changed

    for_any_terminal()
    try:
        with noting(), ended_soon(INTERRUPTED, remove_own_parts):
            try:
                app()
            except SystemExit as ended:
                if ended.code in (None, 0, 1):
                    refuse_changed()
                raise
    except LoopshapeError as error:
        complain(error)
        raise SystemExit(2) from None
    except OSError as error:  # a disk or a file that the system refuses
        complain(f"the system refuses; received {error}; check the file, its rights and the disk.")
        raise SystemExit(2) from None


if __name__ == "__main__":
    script()
