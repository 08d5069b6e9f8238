"""Two commands on one run at once end as if one had waited for the other, or one of them says why it does not.

The second command runs whole at a given step of the first: a reading, a writing, the taking of the run. Nothing is
left to chance, and what may come out is what the two give one after the other.
"""

import json
import shutil
from hashlib import sha256

import pytest
from bench import command
from wide_bench import commands, prepare

from loopshape.io import files, folder_lock

#: what changes files that others read
WRITERS = ("import --replace", "import another", "frf otherwise", "fit otherwise", "tune", "predict")
READERS = (
    "import", "import another", "import --replace", "frf", "frf otherwise", "fit", "tune", "predict", "check",
    "compare", "report", "figures", "plan", "bound", "schedule", "export", "verify", "gap",
)  # fmt: skip
QUICK = [
    ("frf", "import --replace"), ("frf", "import another"), ("frf", "frf otherwise"), ("fit", "frf otherwise"),
    ("fit", "fit otherwise"), ("fit", "import --replace"), ("check", "frf otherwise"), ("check", "tune"),
    ("tune", "import --replace"), ("predict", "import --replace"), ("compare", "predict"),
    ("import", "import --replace"), ("import --replace", "frf otherwise"), ("import --replace", "import another"),
    ("import another", "import another"), ("verify", "import --replace"), ("gap", "import --replace"),
]  # fmt: skip

#: of the commands that read or write other folders
WIDE = [
    ("measure", "measure otherwise"), ("measure otherwise", "measure"), ("simulate", "simulate otherwise"),
    ("import-frf", "import-frf --replace"), ("import-frf --replace", "import-frf of two"),
    ("interaction", "frf --matrix"), ("interaction", "import a third"), ("check --matrix", "frf --matrix"),
    ("check --matrix --junit", "import a third"), ("frf --matrix", "import a third"), ("gap", "measure"),
    ("check --save-verdict", "tune"), ("check --baseline", "check --save-verdict"), ("campaign", "campaign of more"),
    ("campaign of more", "frf of a machine"), ("campaign --merge", "campaign --part"),
    ("campaign", "import into a machine"), ("import into a machine", "campaign"),
]  # fmt: skip

#: campaigns among themselves, and beside what reads or writes one of their runs
CAMPAIGNS = ("campaign", "campaign of more", "campaign --part", "campaign --merge")
OF_A_MACHINE = ("frf of a machine", "verify a machine", "figures of a machine", "import into a machine")
SEVERAL = [(one, other) for one in CAMPAIGNS for other in CAMPAIGNS + OF_A_MACHINE]
SEVERAL += [(one, other) for one in OF_A_MACHINE for other in ("campaign", "campaign --merge")]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return prepare(tmp_path_factory.mktemp("pairs") / "whole")


@pytest.fixture(scope="module")
def place(bench):
    """Makes the same files anew, always at one place."""
    folder = bench.with_name("work")

    def make():
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(bench, folder)
        return commands(folder)

    make.folder = folder
    return make


def gated(at, then, passed=None):
    """Do `then` when the at-th gate is passed; note all gates in the file `passed`, if given."""
    count = 0

    def gate(name, function):
        def through(*given, **named):
            nonlocal count
            count += 1
            if passed is not None:
                passed.write_text(f"{passed.read_text() if passed.exists() else ''}{name}\n")
            if count == at:
                then()
            return function(*given, **named)

        return through

    files.look = gate("read", files.look)
    files._sync = gate("write", files._sync)
    folder_lock._open = gate("take", folder_lock._open)


def state(folder):
    """What a later command reads: words, tables, FRFs, fits, controllers and predictions, by their content."""
    run = folder / "run"
    paths = [run / "run.toml", run / "fits.json", folder / "controller.toml", folder / "prediction.npz"]
    paths += [folder / "verdict.json", folder / "several.xml", *run.glob("*.parquet"), *run.glob("frf/*.npz")]
    for name in ("two", "measured", "simulated", "theirs", "many", "parts"):
        paths += [p for p in (folder / name).rglob("*") if p.suffix in (".toml", ".parquet", ".npz", ".csv")]
    return {str(p.relative_to(folder)): sha256(p.read_bytes()).hexdigest() for p in paths if p.exists()}


def one_after_the_other(place, first, second):
    """Answers of both, and the state after them."""
    words = place()
    a, b = command(words[first]), command(words[second])
    return (a.code, a.out), (b.code, b.out), state(place.folder)


def at_once(place, first, second, at):
    """The first with the second within it; the second's answer comes through a file."""
    words = place()
    answer = place.folder / "answer.json"

    def second_whole():
        done = command(words[second])
        answer.write_text(json.dumps([done.code, done.out, done.err]))

    done = command(words[first], before=lambda: gated(at, second_whole))
    return done, json.loads(answer.read_text()), state(place.folder)


def gates(place, name):
    words = place()
    path = place.folder / "gates"
    command(words[name], before=lambda: gated(0, None, path))
    return path.read_text().split()


def refused(code, err):
    """A refusal is a sentence."""
    assert "Traceback" not in err, err
    if code == 2:
        assert any(line.startswith("loopshape: ") for line in err.splitlines())  # after its warnings
        assert err.rstrip().endswith(".")
    return code == 2


def check_pair(place, first, second, at):
    a, (b_code, _, b_err), found = at_once(place, first, second, at)
    said = f"{first} with {second} at {at}: {a.err} {b_err}"
    a_refused, b_refused = refused(a.code, a.err), refused(b_code, b_err)
    assert not (a_refused and b_refused), said
    if b_refused and second in CAMPAIGNS and command(commands(place.folder)[second]).code == 0:
        b_refused, found = False, state(place.folder)  # what it finished before is kept, and the same command went on
    place()
    if b_refused:
        alone = command(commands(place.folder)[first])
        assert ((alone.code, alone.out), state(place.folder)) == ((a.code, a.out), found), said
    elif a_refused:
        command(commands(place.folder)[second])
        assert found == state(place.folder), said
    else:
        (a1, _, ab), (_, a2, ba) = one_after_the_other(place, first, second), one_after_the_other(place, second, first)
        assert ((a.code, a.out), found) in ((a1, ab), (a2, ba)), said


def between_reading_and_writing(steps):
    """The first gate of writing, or the last reading."""
    return next((k for k, step in enumerate(steps, 1) if step in ("write", "take")), len(steps))


@pytest.mark.long
@pytest.mark.parametrize(("first", "second"), QUICK + WIDE)
def test_a_command_between_anothers_reading_and_writing(place, first, second):
    check_pair(place, first, second, between_reading_and_writing(gates(place, first)))


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.parametrize(("first", "second"), SEVERAL)
def test_a_campaign_at_every_step_of_another_command(place, first, second):
    for at in range(1, len(gates(place, first)) + 1):
        check_pair(place, first, second, at)


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.parametrize("second", WRITERS)
@pytest.mark.parametrize("first", READERS)
def test_a_command_at_every_step_of_another(place, first, second):
    steps = gates(place, first)
    for at in range(1, len(steps) + 1):
        check_pair(place, first, second, at)
