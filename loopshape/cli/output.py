"""What commands say: tables for people, JSON for scripts, progress while long work runs, errors as sentences."""

from __future__ import annotations

import codecs
import io
import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from loopshape.verbs.session import answer, folded

#: what a terminal shows that does not know a sign
ASCII_SIGNS = {
    "±": "+-", "²": "^2", "³": "^3", "·": "*", "∞": "inf", "≥": ">=", "≤": "<=", "≈": "~", "−": "-", "–": "-",
    "→": "->", "…": "...", "γ": "gamma", "π": "pi", "θ": "theta", "µ": "u",
}  # fmt: skip

#: what could steer a terminal (escapes, a carriage return, turned writing) and what is shown in its place
STEERING = {k: ascii(chr(k))[1:-1] for k in (*range(9), *range(11, 32), *range(127, 160), *range(0x202A, 0x202F),
                                             *range(0x2066, 0x206A))}  # fmt: skip

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
Details = Annotated[bool, typer.Option("--details", help="Print every table after the verdict.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
ProfileName = Annotated[
    str | None, typer.Option("--profile", help="A standard's limits too: NAME of `loopshape profiles`, or FILE:NAME.")
]
DiagramFile = Annotated[
    Path | None, typer.Option("--diagram", help="A block diagram (TOML): the plant is what its tuned block meets.")
]
RunFolder = Annotated[Path, typer.Argument(help="A run folder.", show_default=False)]


@dataclass(frozen=True)
class Output:
    """Where a command's words go: tables, one JSON object, or nowhere."""

    as_json: bool = False
    quiet: bool = False

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """A table with right-aligned numbers."""
        if self.as_json or self.quiet:
            return
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        made = Table(box=None, pad_edge=False)
        rows = [list(row) for row in rows]
        for k, name in enumerate(columns):
            number = all(isinstance(row[k], (int, float)) for row in rows)
            made.add_column(Text(safe(name)), no_wrap=True, justify="right" if number else "left")
        for row in rows:
            made.add_row(*(Text(safe(text(cell))) for cell in row))
        print(safe(title))
        Console(width=400, soft_wrap=True).print(
            made, crop=False, no_wrap=True
        )  # a narrow terminal folds, nothing is cut
        print()

    def tables(self, tables: Iterable[tuple[str, Sequence[str], Iterable[Sequence[Any]]]]) -> None:
        """Several of them, each with its title, columns and rows."""
        for one in tables:
            self.table(*one)

    def say(self, line: str) -> None:
        """One line."""
        if not (self.as_json or self.quiet):
            print(safe(line))

    def paragraph(self, words: str) -> None:
        """Sentences folded at 80 columns, each line of `words` a paragraph; what follows its first row is indented."""
        for line in folded(words):
            self.say(line)

    def warn(self, lines: Iterable[str]) -> None:
        """Warnings, each once, to standard error, beside JSON too; quiet prints nothing but errors."""
        if self.quiet:
            return
        for line in dict.fromkeys(lines):
            complain(line, "warning")

    def json(self, payload: Mapping[str, Any]) -> None:
        """The JSON object of this command, where it was asked for; what is not known is null, never nan."""
        if self.as_json:
            print(json.dumps(answer(payload), allow_nan=False))

    @contextmanager
    def progress(self, label: str, total: int) -> Iterator[Callable[[str], None]]:
        """A bar on standard error, of one step the time gone by; call what it gives with a word after each step."""
        if self.as_json or self.quiet or not sys.stderr.isatty():
            yield lambda word: None
            return
        from rich import progress
        from rich.console import Console

        steps = (progress.BarColumn(), progress.MofNCompleteColumn(), progress.TimeRemainingColumn())
        columns = steps if total > 1 else (progress.TimeElapsedColumn(),)
        words, kernels = progress.TextColumn("{task.description}"), logging.getLogger("loopshape.kernels")
        console = Console(stderr=True)
        with progress.Progress(progress.SpinnerColumn("line"), words, *columns, console=console, transient=True) as bar:
            task = bar.add_task(label, total=total)

            def compiling(record: logging.LogRecord) -> bool:
                bar.update(task, description=f"{label} (compiling, on first use only)")
                return False

            kernels.setLevel(logging.INFO)
            kernels.addFilter(compiling)
            try:
                yield lambda word: bar.update(task, advance=1, description=safe(f"{label}: {word}"))
            finally:
                kernels.removeFilter(compiling)


def safe(words: str) -> str:
    """Text of a file that steers no terminal: its escapes are shown, not obeyed."""
    return words.translate(STEERING)


def complain(words: object, who: str = "loopshape") -> None:
    """A sentence on standard error."""
    print(safe(f"{who}: {words}"), file=sys.stderr)


def for_any_terminal() -> None:
    """Let no print end in an error where the terminal knows fewer signs: signs become words, letters their number."""
    codecs.register_error("plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


def _plain(error: UnicodeError) -> tuple[str | bytes, int]:
    """What stands for the signs that cannot be written."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    signs = error.object[error.start : error.end]
    return "".join(ASCII_SIGNS.get(sign) or ascii(sign)[1:-1] for sign in signs), error.end


def text(cell: Any) -> str:
    """A cell as people read it: four figures, no noise."""
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return "0" if abs(cell) < 1e-6 else f"{cell:.4g}"
    return str(cell)


def point(operating_point: Mapping[str, float], parameters: Mapping[str, float] | None = None) -> str:
    """An operating point in a few letters: values with the units that end their names; and the rig's settings."""
    text = ", ".join(f"{value:g} {name.rsplit('_', 1)[-1]}" for name, value in operating_point.items()) or "-"
    settings = ", ".join(f"{name} {value:g}" for name, value in (parameters or {}).items())
    return f"{text} ({settings})" if settings else text
