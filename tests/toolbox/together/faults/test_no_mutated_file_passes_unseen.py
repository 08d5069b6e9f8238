"""Files of every kind that a command reads, damaged in 1,358 ways, each given to the commands that read it.

Each ends in its result or in a sentence, in time; no file that is not its own changes; and where a checksum tells the
damage, no result differs from that of the whole file.
"""

import gzip
import json
import os
import shutil
import signal
import warnings
from functools import cache

import numpy as np
import pandas as pd
import pytest
from bench import in_a_child, said_by
from mutations import mutated
from scipy.io import savemat
from wide_bench import commands, prepare

from loopshape.io import files, input_guard

LIMIT_S = 20.0
KINDS = ("csv.gz", "npz", "mat", "h.mat", "mf4", "parquet")
#: each file with the commands that read it
READ = {
    "run/run.toml": ("verify", "check", "frf otherwise", "import another"),
    "run/a.parquet": ("frf", "frf otherwise", "verify", "gap"),
    "run/fits.json": ("check", "fit", "verify"),
    "run/frf/a.axis.npz": ("fit otherwise", "check", "export"),
    "run/journal.jsonl": ("verify", "import another"),
    "controller.toml": ("check", "export-controller"),
    "require.toml": ("check", "check --save-verdict"),
    "verdict.json": ("check --baseline",),
    "prediction.npz": ("compare",),
    "map.toml": ("import --replace of csv",),
    "a.csv": ("import --replace of csv",),
    **{f"given/a.{kind}": (f"import --replace of {kind}",) for kind in KINDS},
    "given/a.axis.csv": ("import-frf",),
    "given/a.axis.mat": ("import-frf --replace",),
    "given/a.axis.uff": ("import-frf of two",),
    "study.toml": ("export-excitation", "measure"),
    "campaign.toml": ("campaign --merge",),
    "two/matrix/of_a+of_b.a+b.npz": ("interaction", "check --matrix"),
    "several.toml": ("check --matrix",),
    "both.toml": ("check --matrix",),
}
#: files that carry a checksum of their content
CHECKED = (
    "run/a.parquet", "run/frf/a.axis.npz", "prediction.npz", "given/a.csv.gz", "given/a.npz", "given/a.mat",
    "two/matrix/of_a+of_b.a+b.npz",
)  # fmt: skip
#: files of a user's words, in which a number's place takes a finite number and nothing else
WORDS = ("map.toml", "require.toml", "controller.toml", "several.toml", "both.toml", "study.toml", "campaign.toml")
QUICK, ALL = 4, 1358
LONG = {file: range(QUICK, QUICK + (ALL - QUICK * len(READ) + k) // len(READ)) for k, file in enumerate(READ)}
pytestmark = [pytest.mark.long, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]


class TooLate(BaseException):
    """A command that did not end in time."""


def test_they_are_so_many():
    assert QUICK * len(READ) + sum(map(len, LONG.values())) == ALL


@pytest.fixture(scope="module")
def area(tmp_path_factory):
    """A folder of files, and one beside it that is nobody's."""
    top = tmp_path_factory.mktemp("mutated")
    folder = prepare(top / "whole")
    give_in_all_formats(folder)
    (top / "outside").mkdir()
    (top / "outside" / "a.parquet").write_bytes((folder / "run" / "a.parquet").read_bytes())
    (top / "outside" / "mine").write_text("mine")
    return top


def give_in_all_formats(folder):
    """The recording as files of other programs."""
    asammdf, h5py = (pytest.importorskip(name) for name in ("asammdf", "h5py"))
    given = folder / "given"
    rows = np.loadtxt(folder / "a.csv", delimiter=",", skiprows=1)
    signals = dict(zip("rzy", rows.T, strict=True))
    given.joinpath("a.csv.gz").write_bytes(gzip.compress((folder / "a.csv").read_bytes()))
    np.savez_compressed(given / "a.npz", **signals)
    savemat(given / "a.mat", signals, do_compression=True)
    with h5py.File(given / "a.h.mat", "w") as file:
        for name, values in signals.items():
            file.create_dataset(name, data=values, compression="gzip")
    pd.DataFrame(signals).to_parquet(given / "a.parquet")
    with asammdf.MDF(version="4.10") as mdf:
        t = np.arange(len(rows)) / 200.0
        mdf.append([asammdf.Signal(values, t, name=name) for name, values in signals.items()])
        mdf.save(given / "a.mf4")


def all_commands(folder):
    """The bench's, and imports of each kind of file."""
    take = {f"import --replace of {kind}": folder / "given" / f"a.{kind}" for kind in KINDS}
    take["import --replace of csv"] = folder / "a.csv"
    more = {
        name: ("import", path, "--map", folder / "map.toml", "--out", folder / "fresh", "--replace")
        for name, path in take.items()
    }
    merge = ("campaign", folder / "campaign.toml", "--out", folder / "many", "--merge")
    return commands(folder) | more | {"campaign --merge": merge}


def tree(top):
    """Every file's content by its path."""
    return {str(path.relative_to(top)): path.read_bytes() for path in top.rglob("*") if path.is_file()}


def told(folder, name):
    """A command's exit code, output and complaints, within its time."""

    def late(*_):
        raise TooLate

    input_guard._noted, input_guard._alone = None, 0
    files.clear.cache_clear()
    signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            code, out, err = said_by(all_commands(folder)[name]).split("\0", 2)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    return int(code), out, err


def results(found):
    """The tables, FRFs and fits among files."""
    endings = (".parquet", ".npz", "fits.json", ".csv")
    return {name: content for name, content in found.items() if name.endswith(endings)}


def whole_command(area, name):
    """What a command says of whole files, and the files before and after it."""
    work = fresh(area)
    before = tree(area)
    return told(work, name), before, tree(area)


def fresh(area):
    shutil.rmtree(area / "work", ignore_errors=True)
    return shutil.copytree(area / "whole", area / "work")


def wrong(area, file, seed, whole):
    """What is wrong with the end of a command over a mutated file: "" where nothing is."""
    name = READ[file][seed % len(READ[file])]
    said, before, after = whole(name)
    work = fresh(area)
    content, what, nonsense = mutated(file, (work / file).read_bytes(), seed)
    (work / file).write_bytes(content)
    code, out, err = told(work, name)
    found, its = tree(area), f"work/{file}"
    mine = {path for path in {*before, *after} if before.get(path) != after.get(path)} | {its}
    mine |= {f"work/{one}" for one in ("junit.xml", "verdict.json", "verdict.md")}  # written anew each time
    tops = {path.split("/")[1] for path in mine}
    faults = []
    if code not in (0, 1, 2) or "Traceback" in err:
        faults.append(f"code {code}: {err[-1500:]}")
    if code == 2 and not (err.splitlines()[-1].startswith("loopshape: ") and err.rstrip().endswith(".")):
        faults.append(f"no sentence: {err[-500:]}")
    if lost := [path for path in before if path not in mine and found.get(path) != before[path]]:
        faults.append(f"changed {lost}")
    if strange := [p for p in found if p not in before and (p.split("/")[0] != "work" or p.split("/")[1] not in tops)]:
        faults.append(f"made {strange}")
    if code != 2 and nonsense and file in WORDS:
        faults.append(f"took nonsense, code {code}")
    if code != 2 and file in CHECKED and name != "verify":
        del found[its]
        same = {path: content for path, content in results(after).items() if path != its}
        if (code, out) != said[:2] or results(found) != same:
            faults.append(f"took damage, code {code}")
    return f"{file} by {name}, mutation {seed}, {what}: {'; '.join(faults)}" if faults else ""


def tried(area, cases):
    """What is wrong with all of these mutations of files, done by a child that may die of one."""
    at = area.with_name("at")

    def work():
        whole = cache(lambda name: whole_command(area, name))
        found = []
        for file, seed in cases:
            at.write_text(f"{file} {seed}")
            found.append(wrong(area, file, seed, whole))
        return json.dumps([one for one in found if one])

    text, status = in_a_child(work)
    assert status == 0, f"a child ended by {at.read_text()}"
    return json.loads(text)


def test_some_mutations_of_every_kind_of_file(area):
    assert tried(area, [(file, seed) for file in READ for seed in range(QUICK)]) == []


@pytest.mark.long
@pytest.mark.parametrize("file", [pytest.param(x, marks=pytest.mark.hour) if x.endswith("mf4") else x for x in READ])
def test_mutations_of_a_kind_of_file(area, file):
    assert tried(area, [(file, seed) for seed in LONG[file]]) == []
