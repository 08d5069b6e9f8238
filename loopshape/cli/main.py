"""The command line: one file a command, heavy imports inside them, errors as one sentence and exit code 2."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from loopshape.cli import INTERRUPTED, script
from loopshape.cli.output import complain, for_any_terminal, safe
from loopshape.core.errors import LoopshapeError
from loopshape.core.interrupts import ENDED, ended_soon, interrupted, say_once
from loopshape.core.toolboxes import Command, found, function_at

HELP = """From closed-loop recordings of a motion system to a tuned, checked controller, and to why a simulation lies.

measure or import a run -> frf -> fit -> tune -> check -> predict; measure again -> compare; any run -> report, gap;
frf -> interaction, plan, export; controller -> shape, export-controller, bound, schedule.
Exit codes: 0 pass, 1 a requirement is missed or undecided or something is worse than a baseline, 2 wrong use or
unreadable input, 130 interrupted.
"""

#: headings of `--help`, in the order of the work
HEADINGS = ("Start", "Measure and import", "Estimate", "Design", "Verify", "Diagnose", "Exchange")
#: commands of the bench; those of toolboxes stand where these are found
OWN = (
    Command("Start", "examples", "loopshape.cli.examples:examples", "loopshape examples --out examples", 20),
    Command("Estimate", "frf", "loopshape.cli.estimate.frf:frf", "loopshape frf runs/axis", 10),
    Command("Estimate", "fit", "loopshape.cli.estimate.fit:fit", "loopshape fit runs/axis --structure auto", 20),
    Command(
        "Estimate",
        "interaction",
        "loopshape.cli.estimate.interaction:interaction",
        "loopshape interaction runs/arm2",
        30,
    ),
    Command(
        "Estimate",
        "figures",
        "loopshape.cli.estimate.figures:figures",
        "loopshape figures runs/axis --controller controller.toml",
        60,
    ),
    Command(
        "Design",
        "tune",
        "loopshape.cli.design.tune:tune",
        "loopshape tune runs/axis --require requirements.toml --out controller.toml",
        10,
    ),
    Command(
        "Design",
        "shape",
        "loopshape.cli.design.shape:shape",
        "loopshape shape runs/axis --require requirements.toml --out shape.html",
        20,
    ),
    Command("Design", "profiles", "loopshape.cli.design.profiles:profiles", "loopshape profiles --out mine.toml", 40),
    Command(
        "Verify",
        "check",
        "loopshape.cli.verify.check:check",
        "loopshape check runs/axis controller.toml --require requirements.toml",
        10,
    ),
    Command(
        "Verify",
        "predict",
        "loopshape.cli.verify.predict:predict",
        "loopshape predict runs/axis controller.toml --out prediction.npz",
        20,
    ),
    Command(
        "Verify", "compare", "loopshape.cli.verify.compare:compare", "loopshape compare runs/after prediction.npz", 30
    ),
    Command(
        "Verify",
        "report",
        "loopshape.cli.verify.report:report",
        "loopshape report runs/axis --controller controller.toml --require requirements.toml",
        40,
    ),
    Command("Verify", "verify", "loopshape.cli.verify.verify:verify", "loopshape verify runs/axis", 50),
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
            names = [one.name for one in commands]
            rows = [(name, self.commands[name].get_short_help_str(formatter.width - 22)) for name in names]
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=20)


app = typer.Typer(cls=Grouped, help=HELP, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)


def _all_commands() -> tuple[dict[str, list[Command]], list[str]]:
    """Commands of the bench and of toolboxes by heading, each added to the program, and what could not be loaded."""
    broken = list(found().broken)
    by_heading: dict[str, list[Command]] = {heading: [] for heading in HEADINGS}
    for one in sorted([*OWN, *(c for box in found().toolboxes.values() for c in box.commands)], key=lambda c: c.rank):
        try:
            if any(other.name == one.name for names in by_heading.values() for other in names):
                raise ValueError("there is a command of this name")
            app.command(one.name, epilog=f"Example: {one.example}")(function_at(one.at))
        except Exception as error:  # of a package that is not ours
            broken.append(f"the command {one.name} was left out: {type(error).__name__}: {error}")
        else:
            by_heading.setdefault(one.heading, []).append(one)
    return by_heading, broken


COMMANDS, BROKEN = _all_commands()


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
    for words in BROKEN:
        complain(words, "warning")
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
