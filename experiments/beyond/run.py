"""What the source recommends and never did: higher supply, scheduling, feedforward, pre-stress; gains and prices."""

from __future__ import annotations

import csv
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from beyond_draw import draw_supply, draw_tracking  # noqa: E402
from beyond_feedforward import by_supply_rows, error_rows, kind_rows, path, preview_rows, recordings_shown  # noqa: E402
from beyond_prestress import prestress_rows  # noqa: E402
from beyond_scores import scores  # noqa: E402
from beyond_supply import at_supply, point_rows, pressure_controller, supply_row  # noqa: E402

from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.io.requirements import read_requirements  # noqa: E402
from loopshape.io.write.controllers import read_controllers  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.view.style import png  # noqa: E402

ROOT = HERE.parent.parent
FIGURES = ROOT / "figures" / HERE.name
EXAMPLES = ROOT / "examples" / "arm"


def main() -> None:
    """Supplies, then feedforward, then pre-stress; tables, figures, scores."""
    settings = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
    asked = read_requirements(EXAMPLES / "requirements.toml")[0]
    study, seed = read_study(HERE / "study.toml"), settings["seed"]
    found = [at_supply(study, asked, bar, settings["supply"] | {"seed": seed}) for bar in settings["supply"]["bar"]]
    tables: dict[str, list[dict]] = {
        "supply": [supply_row(one) for one in found],
        "points": [row for one in found for row in point_rows(one)],
        "small_steps": [row for one in found for row in one.small],
        "large_steps": [row for one in found for row in one.large],
    }
    feed = settings["feedforward"]
    point = 0.0, feed["p_ab_bar"]
    shipped = read_controllers(EXAMPLES / "controller.toml")
    own = found[0].chosen[point], next(c for c in shipped if c.loop == "p_ab")
    ways = [path(feed, limits) for limits in feed["limits"]]
    fitted = found[0].fitted[point]
    tables["tracking"] = kind_rows(ways, fitted, shipped, own, feed, seed)
    robust = {one.supply_bar: (one.robust, pressure_controller(one.supply_bar)) for one in found}
    tables["tracking_by_supply"] = by_supply_rows(ways, robust, feed, seed)
    shown = ways[feed["shown"]]
    tables["errors"] = error_rows(shown, fitted, shipped, feed, seed)
    tables["previews"] = preview_rows(shown, fitted, shipped, feed, seed)
    tables["prestress"] = prestress_rows(settings["prestress"])
    for name, rows in tables.items():
        write(name, rows)
    write("scores", scores(tables))
    write_bytes_whole(FIGURES / "supply.png", png(draw_supply(tables)))
    recordings = recordings_shown(shown, fitted, shipped, feed, seed)
    write_bytes_whole(FIGURES / "tracking.png", png(draw_tracking(shown, recordings, tables)))


def write(name: str, rows: Sequence[Mapping[str, object]]) -> None:
    """A small table beside this file, also shown; cells that a row does not have stay empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [columns, *([rounded(row.get(key, "")) for key in columns] for row in rows)]
    with (HERE / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)
    print(f"-- {name}")
    for line in lines:
        print("  ".join(str(cell) for cell in line))


def rounded(cell: object) -> object:
    """Four figures, and nothing where there is no number."""
    if isinstance(cell, float):
        return f"{cell:.4g}" if np.isfinite(cell) else ""
    return cell


if __name__ == "__main__":
    main()
