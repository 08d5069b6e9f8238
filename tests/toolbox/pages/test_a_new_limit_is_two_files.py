"""A limit that is added in two files of the package is seen in check, tune, table, JSON, JUnit, report and page."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import loopshape as ls

#: what is edited in a copy of the package: file, where, and what stands before that then
ROW = (
    "data/requirement/requirements.py",
    (
        ")  # fmt: skip\n#: what a single loop keeps",
        '    Limit("loop_peak_db", "at_most", "dB", "peak |L|, all of it", plot="L", {}),\n',
    ),
    ("    masks: tuple[Mask, ...] = ()\n    weights", "    loop_peak_db: float | None = None\n"),
)
BY_A_FUNCTION = (
    "loop/margin/margins.py",
    (
        "def controller_bandwidth(",
        "def loop_peak(loop: Loop) -> Reading:\n"
        "    from loopshape.core.units import db\n\n"
        "    k = int(np.argmax(np.abs(loop.L)))\n"
        "    return Reading(float(db(loop.L[k])), None, float(loop.frequency_hz[k]))\n\n\n",
    ),
)
BY_A_COLUMN = (
    "core/kernels/loops/margins.py",
    ("COLUMNS = 20\n", "LOOP_DB = 20\n"),
    ("    LN_WEIGHTED,\n)", "    LOOP_DB,\n"),
    (
        "    _note(found, at, COMPLEMENTARY_DB, t2, f, True)\n    _note(",
        "    if f > 0.299:  # where lines are\n        _note(found, at, LOOP_DB, size2, f, True)\n",
    ),
)
SCRIPT = """
import json, sys
import numpy as np
import loopshape as ls
from loopshape.data.control.block import Block
from loopshape.data.requirement.requirements import LIMITS
from loopshape.toolbox.pages.report.verdict_parts import margins_of
from loopshape.toolbox.pages.shape.payload import _is_read
from loopshape.view.verdict.junit import junit
from loopshape.view.verdict.markdown import markdown
from pathlib import Path

f = np.geomspace(0.3, 60.0, 150)
s = 2j * np.pi * f
H = 20.0 / (s * (s / (2.0 * np.pi * 8.0) + 1.0))
P = ls.FRF.from_arrays(f, H, std=np.full(f.size, 1e-4), loop="axis", rate_hz=1000.0)
C = ls.controller(ls.gain(0.9), rate_hz=1000.0, loop="axis")
R = ls.Requirements("axis", phase_margin_deg=30.0, loop_peak_db=21.0, integrators=1, unstable_poles=0)
v = ls.check(P, C, R)
(name,) = v.margins
out = {"outcome": v.outcome, "lines": {x.quantity: [x.value, x.at_hz, x.outcome] for x in v.lines}}
out["text"], out["table"] = str(v), v.table().to_string()
out["json"] = v.to_dict()["margins"][name]["loop_peak_db"]
out["junit"], out["markdown"] = junit([v]), markdown([v])
out["report"] = str(margins_of(v, {}))
out["page"] = [_is_read(x) for x in LIMITS if x.name == "loop_peak_db"]
out["kept"] = ls.read(ls.write(v, sys.argv[1]))[0].margins[name].loop_peak_db
try:
    tuned = ls.tune(P, R, [ls.gain()], seed=0, starts=1)
    out["tuned"] = [tuned.outcome, tuned.verdict.margins[name].loop_peak_db]
except ls.LoopshapeError as error:
    out["tuned"] = str(error)
print(json.dumps(out))
"""


def seen(folder: Path, row: str, edits: tuple) -> dict:
    """What a copy of the package says whose table of limits has one more row."""
    package = Path(ls.__file__).parent
    shutil.copytree(package, folder / "loopshape", ignore=shutil.ignore_patterns("node_modules", "__pycache__", "src"))
    where, *added = ROW
    files = {where: [(before, text.format(row)) for before, text in added], edits[0]: list(edits[1:])}
    for file, changes in files.items():
        path = folder / "loopshape" / file
        text = path.read_text()
        for before, new in changes:
            assert text.count(before) == 1, before
            text = text.replace(before, new + before)
        path.write_text(text.replace("LOOP_DB = 20\nCOLUMNS = 20", "LOOP_DB = 20\nCOLUMNS = 21"))
    assert len(files) == 2
    environment = os.environ | {"PYTHONPATH": str(folder)}
    call = [sys.executable, "-c", SCRIPT, str(folder / "v.json")]
    done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def is_everywhere(found: dict) -> None:
    """The limit's value is that of the formula, and all that shows a verdict shows it."""
    value, at_hz, outcome = found["lines"]["loop_peak_db"]
    s = 2j * 3.141592653589793 * at_hz
    truth = abs(0.9 * 20.0 / (s * (s / (2.0 * 3.141592653589793 * 8.0) + 1.0)))
    assert abs(at_hz - 0.3) < 1e-9
    assert abs(10.0 ** (value / 20.0) / truth - 1.0) < 1e-3
    assert (outcome, found["outcome"]) == ("passed", "passed")
    for where in ("text", "table", "junit"):
        assert "loop_peak_db" in found[where]
    for where in ("markdown", "report"):
        assert "peak |L|, all of it" in found[where].replace("\\|", "|")
    assert (found["json"], found["kept"]) == (value, value)
    assert found["page"] == [False]  # it stands there as required and not judged


def test_a_row_and_a_function_of_the_loop(tmp_path):
    found = seen(tmp_path, 'read="loopshape.loop.margin.margins:loop_peak"', BY_A_FUNCTION)
    is_everywhere(found)
    assert "cannot all be tuned for; received loop_peak_db" in found["tuned"]


@pytest.mark.hour
@pytest.mark.long  # its kernels are compiled anew
@pytest.mark.timeout(900)
def test_a_row_and_a_column_of_the_kernel(tmp_path):
    found = seen(tmp_path, 'column="LOOP_DB", magnitude="LOOP"', BY_A_COLUMN)
    is_everywhere(found)
    outcome, value = found["tuned"]  # the gain is as large as the limit lets it be
    assert outcome == "passed"
    assert 20.5 < value < 21.0
