"""The command line: one file a command, heavy imports inside them, errors as one sentence and exit code 2."""

from __future__ import annotations

import sys

import typer

from loopshape.cli.bound import bound
from loopshape.cli.campaign import campaign
from loopshape.cli.check import check
from loopshape.cli.check_several import check_several
from loopshape.cli.compare import compare
from loopshape.cli.demo import demo
from loopshape.cli.effects import effects
from loopshape.cli.emulator import emulator
from loopshape.cli.equilibria import equilibria
from loopshape.cli.exam import exam
from loopshape.cli.export import export
from loopshape.cli.export_controller import export_controller
from loopshape.cli.export_excitation import export_excitation
from loopshape.cli.figures import figures
from loopshape.cli.fit import fit
from loopshape.cli.frf import frf
from loopshape.cli.gap import gap
from loopshape.cli.import_file import import_file
from loopshape.cli.import_frf import import_frf
from loopshape.cli.interaction import interaction
from loopshape.cli.measure import measure
from loopshape.cli.output import for_any_terminal
from loopshape.cli.plan import plan
from loopshape.cli.predict import predict
from loopshape.cli.report import report
from loopshape.cli.schedule import schedule
from loopshape.cli.simulate import simulate
from loopshape.cli.stop import stop
from loopshape.cli.study import study
from loopshape.cli.tune import tune
from loopshape.cli.verify import verify
from loopshape.core.errors import LoopshapeError

HELP = """From closed-loop recordings of a motion system to a tuned, checked controller, and to why a simulation lies.

measure or import a run -> frf -> fit -> tune -> check -> predict; measure again -> compare; any run -> report, gap;
frf -> interaction, plan, export; controller -> export-controller, bound, schedule; study runs the project's studies.
Exit codes: 0 pass, 1 a requirement is missed or undecided or something is worse than a baseline, 2 wrong use or
unreadable input.
"""

app = typer.Typer(
    help=HELP, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)
for command in (measure, simulate, frf, fit, tune, check, gap, exam, effects, figures, equilibria, demo):
    app.command()(command)
app.command("import")(import_file)
app.command("import-frf")(import_frf)
app.command()(export)
app.command("export-controller")(export_controller)
app.command("export-excitation")(export_excitation)
app.command()(interaction)
app.command()(plan)
app.command("check-several")(check_several)
app.command()(predict)
app.command()(compare)
app.command()(report)
app.command()(bound)
app.command()(schedule)
app.command()(campaign)
app.command()(study)
app.command()(stop)
app.command()(emulator)
app.command()(verify)


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
    from loopshape.io.seen import noting, refuse_changed

    for_any_terminal()
    try:
        with noting():
            try:
                app()
            except SystemExit as ended:
                if ended.code in (None, 0, 1):
                    refuse_changed()
                raise
    except LoopshapeError as error:
        print(f"loopshape: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except OSError as error:  # a disk or a file that the system refuses
        print(
            f"loopshape: the system refuses; received {error}; check the file, its rights and the disk.",
            file=sys.stderr,
        )
        raise SystemExit(2) from None


if __name__ == "__main__":
    run()
