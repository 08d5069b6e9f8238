"""The bench by itself, for `make test-bench`: the package without its toolboxes, as an installation leaves it.

python .ci/bench.py FOLDER    a folder for PYTHONPATH
"""

import shutil
import sys
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main(folder: Path) -> None:
    """Copy the package but its toolboxes, and state its entry points but theirs."""
    shutil.rmtree(folder, ignore_errors=True)
    left_out = shutil.ignore_patterns("toolbox", "node_modules", "__pycache__")
    shutil.copytree(ROOT / "loopshape", folder / "loopshape", ignore=left_out)
    installed = distribution("loopshape")
    info = folder / f"loopshape-{installed.version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(installed.read_text("METADATA") or "", encoding="utf-8")
    kept = [one for one in installed.entry_points if one.group != "loopshape.toolboxes"]
    groups = [f"[{one.group}]\n{one.name} = {one.value}\n" for one in kept]
    (info / "entry_points.txt").write_text("\n".join(groups), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
