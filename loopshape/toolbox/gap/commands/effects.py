"""`loopshape effects`: what a plant's nominal model leaves out, and what each of these does."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.effect import EffectForm

COLUMNS = ("effect", "block", "form", "words", "unit", "usual", "bounds", "source")


def effects(
    plant: Annotated[str, typer.Argument(help="A plant's name.")] = "arm-1dof",
    figure: Annotated[
        Path | None, typer.Option(help="Draw what each does (1-DoF arm; .png; pages NAME_1, NAME_2, ...).")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=MAGNITUDE]", help="Only this one in the figure; again for more, NAME:2 for form 2."
        ),
    ] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table as in docs/effects.md.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """List a plant's catalogue of effects. Of each its place, its forms and its usual magnitudes."""
    from loopshape.toolbox.rig import registry
    from loopshape.toolbox.rig.effects import catalogue

    output = Output(as_json, quiet)
    forms = catalogue(registry.plant(plant))
    rows = catalogue_rows(forms)
    if markdown:
        output.say(markdown_table(rows))
    else:
        output.table(f"Effects of {plant}", COLUMNS, rows)
    draw = figure and registry.declared("effect_pages", plant, "no page of effects is drawn of this plant")
    drawn = [str(file) for file in draw(figure, effect or ())] if draw else []
    if drawn:
        output.say("\n".join(drawn))
    cells = [dict(zip(COLUMNS, row, strict=True)) for row in rows]
    own = [{"unit": form.unit, "quantity": form.quantity or None} for form in forms]
    answer = [row | words for row, words in zip(cells, own, strict=True)]
    output.json({"plant": plant, "forms": answer, "figures": drawn})


def catalogue_rows(forms: Iterable[EffectForm]) -> list[list[Any]]:
    """The catalogue as cells: forms numbered within their effect, ranges in the unit."""
    from loopshape.toolbox.rig.effects import bounds

    rows: list[list[Any]] = []
    for form in forms:
        number = 1 + sum(row[0] == form.effect for row in rows)
        low, high = bounds(form)
        usual = "-" if form.usual in ((low, high), (0.0, float("inf"))) else f"{_sign(low)}{_range(*form.usual)}"
        rows.append(
            [
                form.effect,
                form.block,
                number,
                form.form,
                f"1 ({form.quantity})" if form.quantity else form.unit,
                usual,
                _range(low, high),
                form.source or "-",
            ]
        )
    return rows


def _sign(low: float) -> str:
    return "+-" if low < 0.0 else ""


def _range(low: float, high: float) -> str:
    return f"{low:.4g} to {high:.4g}"


def markdown_table(rows: Sequence[Sequence[Any]]) -> str:
    """The cells as a Markdown table; an effect's name and block stand once."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        cells = [str(cell) for cell in row]
        if row[2] > 1:
            cells[:2] = ["", ""]
        lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(lines)
