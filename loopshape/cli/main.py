"""The command line: one file a command, heavy imports inside them, errors as one sentence and exit code 2."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

from loopshape.cli import script
from loopshape.cli.output import complain, for_any_terminal, safe
from loopshape.verbs.session import commands, ended_by, session

if TYPE_CHECKING:
    from loopshape.core.toolboxes import Command

HELP = """From closed-loop recordings of a motion system to a tuned, checked controller, and to why a simulation lies.

measure or import a run -> frf -> fit -> tune -> check -> predict; measure again -> compare; any run -> report, gap;
frf -> interaction, plan, export; controller -> shape, export-controller, bound, schedule.
Exit codes: 0 pass, 1 a requirement is missed or undecided or something is worse than a baseline, 2 wrong use or
unreadable input, 130 interrupted.
"""

#: headings of `--help`, in the order of the work
HEADINGS = ("Start", "Measure and import", "Estimate", "Design", "Verify", "Diagnose", "Exchange")
#: commands of the bench (heading, name, function, example, rank); those of toolboxes stand where these are found
OWN = (
    ("Start", "examples", "loopshape.cli.examples:examples", "loopshape examples --out examples", 20),
    ("Estimate", "frf", "loopshape.cli.estimate.frf:frf", "loopshape frf runs/axis", 10),
    ("Estimate", "fit", "loopshape.cli.estimate.fit:fit", "loopshape fit runs/axis --structure auto", 20),
    ("Estimate", "interaction", "loopshape.cli.estimate.interaction:interaction", "loopshape interaction runs/arm2",
     30),
    ("Estimate", "figures", "loopshape.cli.estimate.figures:figures",
     "loopshape figures runs/axis --controller controller.toml", 60),
    ("Design", "tune", "loopshape.cli.design.tune:tune",
     "loopshape tune runs/axis --require requirements.toml --out controller.toml", 10),
    ("Design", "shape", "loopshape.cli.design.shape:shape",
     "loopshape shape runs/axis --require requirements.toml --out shape.html", 20),
    ("Design", "profiles", "loopshape.cli.design.profiles:profiles", "loopshape profiles --out mine.toml", 40),
    ("Verify", "check", "loopshape.cli.verify.check:check",
     "loopshape check runs/axis controller.toml --require requirements.toml", 10),
    ("Verify", "predict", "loopshape.cli.verify.predict:predict",
     "loopshape predict runs/axis controller.toml --out prediction.npz", 20),
    ("Verify", "compare", "loopshape.cli.verify.compare:compare", "loopshape compare runs/after prediction.npz", 30),
    ("Verify", "report", "loopshape.cli.verify.report:report",
     "loopshape report runs/axis --controller controller.toml --require requirements.toml", 40),
    ("Verify", "verify", "loopshape.cli.verify.verify:verify", "loopshape verify runs/axis", 50),
)  # fmt: skip


def _shown(error: Exception) -> Exception:
    """An error of use with the words of the command line as a terminal may show them: not every typer sees to it."""
    if hasattr(error, "format_message") and isinstance(message := getattr(error, "message", None), str):
        error.message = safe(message)  # type: ignore[attr-defined]
    return error


class Grouped(TyperGroup):
    """The commands under headings, in the order of the work."""

    def invoke(self, ctx: Any) -> Any:
        """A command; an interrupt ends it in one sentence, whatever a library made of the exception."""
        done, stopped = None, None
        try:
            done = super().invoke(ctx)
        except typer.Exit:
            raise
        except (Exception, KeyboardInterrupt) as error:
            stopped = error
        if (code := ended_by(stopped)) is not None:
            raise typer.Exit(code)
        if isinstance(stopped, Exception):
            raise _shown(stopped)
        return done

    def make_context(self, *args: Any, **words: Any) -> Any:
        """Of the program's own options; what is wrong with them steers no terminal."""
        try:
            return super().make_context(*args, **words)
        except Exception as error:
            raise _shown(error) from None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Each heading with its commands and what they do."""
        for heading, listed in COMMANDS.items():
            names = [one.name for one in listed]
            rows = [(name, self.commands[name].get_short_help_str(formatter.width - 22)) for name in names]
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=20)


app = typer.Typer(cls=Grouped, help=HELP, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)


def _add(command: Command, function: Any) -> None:
    app.command(command.name, epilog=f"Example: {command.example}")(function)


COMMANDS, BROKEN = commands(OWN, HEADINGS, _add)


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
    """Entry point: a command in its session; what its user can put right is a sentence on standard error."""
    for_any_terminal()
    for words in BROKEN:
        complain(words, "warning")
    session(app, complain)


if __name__ == "__main__":
    script()
