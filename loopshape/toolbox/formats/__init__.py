"""Files of other programs: logs, FRFs and controllers in and out, and drafts of maps.

Somebody's file comes in, columns or nouns go out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.formats.controllers.limited import OutputLimits as OutputLimits
    from loopshape.toolbox.formats.verbs import export as export
    from loopshape.toolbox.formats.verbs import read_frf as read_frf
    from loopshape.toolbox.formats.verbs import read_table as read_table
    from loopshape.toolbox.formats.verbs import simulate as simulate

TOOLBOX = Toolbox(
    "formats",
    "Files of other programs: logs, FRFs and controllers in and out, and drafts of maps",
    commands=(
        Command(
            "Measure and import",
            "import",
            "loopshape.toolbox.formats.commands.import_file:import_file",
            "loopshape import recording.csv --map map.toml --out runs/axis",
            40,
        ),
        Command(
            "Measure and import",
            "import-frf",
            "loopshape.toolbox.formats.commands.import_frf:import_frf",
            "loopshape import-frf plant.mat --relative-std 0.02 --out runs/plant",
            50,
        ),
        Command(
            "Exchange",
            "export",
            "loopshape.toolbox.formats.commands.export:export",
            "loopshape export runs/axis --to mat --out frfs",
            10,
        ),
        Command(
            "Exchange",
            "export-controller",
            "loopshape.toolbox.formats.commands.export:export_controller",
            "loopshape export-controller controller.toml --to c --out firmware",
            20,
        ),
        Command(
            "Exchange",
            "firmware",
            "loopshape.toolbox.formats.commands.export:firmware",
            "loopshape firmware px4.params --of px4 --rate-hz 1000 --out controller.toml",
            30,
        ),
        Command(
            "Exchange",
            "export-excitation",
            "loopshape.toolbox.formats.commands.export:export_excitation",
            "loopshape export-excitation study.toml --to csv --out signals",
            40,
        ),
    ),
    names={
        "OutputLimits": "loopshape.toolbox.formats.controllers.limited",
        "export": "loopshape.toolbox.formats.verbs",
        "read_frf": "loopshape.toolbox.formats.verbs",
        "read_table": "loopshape.toolbox.formats.verbs",
        "simulate": "loopshape.toolbox.formats.verbs",
    },
    writers={"FRF": "loopshape.toolbox.formats.frf.frf_exchange:write_frf_file"},
)
