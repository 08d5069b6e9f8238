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
#: commands of the bench (heading, module, example, rank); those of toolboxes stand where these are found
OWN = (
    ("Start", "examples", "examples --out examples", 20),
    ("Estimate", "estimate.frf", "frf runs/axis", 10),
    ("Estimate", "estimate.fit", "fit runs/axis --structure auto", 20),
    ("Estimate", "estimate.figures", "figures runs/axis --controller controller.toml", 60),
    ("Design", "design.tune", "tune runs/axis --require requirements.toml --out controller.toml", 10),
    ("Design", "design.profiles", "profiles --out mine.toml", 40),
    ("Verify", "verify.check", "check runs/axis controller.toml --require requirements.toml", 10),
    ("Verify", "verify.verify", "verify runs/axis", 50),
)


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


app = typer.Typer(
    cls=Grouped,
    help=HELP,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"max_content_width": 120},  # a wide terminal shows each option on one line
)


def _add(command: Command, function: Any) -> None:
    app.command(command.name, epilog=f"Example: {command.example}")(function)


COMMANDS, BROKEN = commands("loopshape.cli", OWN, HEADINGS, _add)


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
