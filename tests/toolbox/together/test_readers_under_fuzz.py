"""Whatever stands in a file, a reader gives a result or a sentence: nothing else, nothing outside, memory bounded.

How many examples run is in `EXAMPLES`, the same ones every time. A warning of numpy over absurd numbers is no failure.
"""

import gzip
import itertools
import json
import os
import subprocess
import sys
import zipfile
import zlib

import numpy as np
import pytest
import tomli_w
from bench_nouns import Block, Estimate, LoopSetup, RecordingInfo, TransferFunction
from fuzz_cases import NAMES, damaged, said, tables, tree
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from run_files import (
    CsvShape,
    add_recording,
    check_recordings,
    finished,
    read_fits,
    read_frfs,
    read_journal,
    read_toml,
    start_run,
    verify,
    write_controllers,
    write_fits,
    write_frfs,
    write_text_whole,
)
from scipy.io import savemat
from simulated_machines import Arm1, import_file, plan, read_study

import loopshape as ls
from loopshape.io.run.journal import FILE as JOURNAL
from loopshape.io.run.journal import note
from loopshape.io.run.tables import TableColumns
from loopshape.toolbox.campaign.files import read_campaign
from loopshape.toolbox.formats.tables.sources import Place, open_source
from loopshape.toolbox.rig.effects import asked

pytestmark = pytest.mark.long

#: examples of each test, by what is broken; together some 6 000
EXAMPLES = {
    "run.toml words": 300, "run.toml bytes": 400, "study words": 500, "study bytes": 200, "target words": 300,
    "campaign words": 300, "map words": 400, "csv": 500, "csv bytes": 150, "mat bytes": 500, "mat made up": 200,
    "npz bytes": 300, "journal": 150, "controllers words": 300, "fits": 300, "frf bytes": 150, "frf words": 200,
    "in a child": 400,
}  # fmt: skip
RATE = 100.0
MOST_BYTES = 2_500_000_000  # of address space, where a reader is let loose on a bomb
BLOCK = Block("pi", {"f_hz": 1.0})
LOOP = LoopSetup("x", "r_x_m", "n_x_m", "z_v", "x_m", ls.Controller("x", (BLOCK,), RATE))


def examples(what):
    return settings(max_examples=EXAMPLES[what], suppress_health_check=list(HealthCheck))


def recording(name, seed=1):
    noise = np.random.default_rng(seed).normal(size=(4, 60))
    info = RecordingInfo(
        f"{name}.parquet", "multisine", "controller_input", excites="x", period_s=0.2, periodic_from_s=0.2,
        operating_point={"x_m": 0.1}, parameters={"mass_kg": 2.0},
    )  # fmt: skip
    return ls.Recording(info, RATE, dict(zip(COLUMNS, noise, strict=True)))


COLUMNS = ("r_x_m", "n_x_m", "z_v", "x_m")
WRITTEN = np.array([recording(name, k).column(c) for k, name in enumerate(("a", "b")) for c in COLUMNS])
HEADER = ls.Run(
    RATE, (LOOP,), (), "servo-axis", {"frequency_hz": 50.0, "dead_zone": 0.1},
    {"study_sha256": "0" * 64, "provenance": {"seed": 1}, "parameters": {"mass_kg": 1.0}, "notes": ["a note"]},
    ("x_m",),
)  # fmt: skip


@pytest.fixture(scope="module")
def area(tmp_path_factory):
    """A folder with a run, and one beside it that nobody may touch."""
    top = tmp_path_factory.mktemp("fuzz")
    (top / "outside").mkdir()
    start_run(top / "run", HEADER)
    for k, name in enumerate(("a", "b")):
        add_recording(top / "run", recording(name, k))
    (top / "outside" / "outside.parquet").write_bytes((top / "run" / "a.parquet").read_bytes())
    (top / "outside.parquet").write_bytes(b"nobody's")
    (top / "run" / "link.parquet").symlink_to(top / "outside" / "outside.parquet")
    (top / "run" / "folder.parquet").mkdir()
    return top


@pytest.fixture
def untouched(area):
    """Nothing beside the folders `run` and `given` changes."""

    def kept():
        mine = ("run", "given")
        return {
            name: mark for name, mark in tree(area).items() if os.path.relpath(name, area).split(os.sep)[0] not in mine
        }

    before = kept()
    yield
    assert kept() == before


def given_file(area, name, content):
    path = area / "given" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return path


def use_run(run, content):
    """All that reads and continues a run."""
    (run / "run.toml").write_bytes(content)
    said(lambda: finished(run))
    said(lambda: verify(run))
    said(lambda: check_recordings(ls.read(run)))
    said(lambda: start_run(run, HEADER))
    said(lambda: add_recording(run, recording("c", 3)))
    (run / "c.parquet").unlink(missing_ok=True)
    (run / JOURNAL).unlink(missing_ok=True)


@pytest.fixture(scope="module")
def run_table(area):
    return read_toml(area / "run" / "run.toml")


def with_own_words_again(run, table):
    """The samples (8, 60) of both recordings where run.toml says again what it said."""
    (run / "run.toml").write_bytes(tomli_w.dumps(table).encode())
    return np.array([ls.read(run).recording(name).column(c) for name in sorted(finished(run)) for c in COLUMNS])


@pytest.mark.long
def test_words_of_run_toml(area, run_table, untouched):
    @given(tables(run_table))
    @examples("run.toml words")
    def test(table):
        use_run(area / "run", tomli_w.dumps(table).encode())

    test()
    assert np.array_equal(with_own_words_again(area / "run", run_table), WRITTEN)


def test_bytes_of_run_toml(area, run_table, untouched):
    @given(damaged(tomli_w.dumps(run_table).encode()))
    @examples("run.toml bytes")
    def test(content):
        use_run(area / "run", content)

    test()
    assert np.array_equal(with_own_words_again(area / "run", run_table), WRITTEN)


@pytest.mark.parametrize("name", NAMES)
def test_no_name_of_a_recording_leads_out(area, run_table, untouched, name):
    entry = run_table["recording"][0] | {"file": name}
    use_run(area / "run", tomli_w.dumps(run_table | {"recording": [entry]}).encode())
    assert said(lambda: ls.read(area / "run"))


STUDY = {
    "format": "loopshape-study/1", "rig": "simulated", "plant": "arm-1dof", "rate_hz": 1000.0, "seed": 1,
    "solver": "edges", "operating_points": [{"theta2_deg": 0.0, "p_ab_bar": 1.0}],
    "parameters": {"m2_kg": 0.5}, "effects": {"gas_law": 0.8}, "pwm": {"frequency_hz": 50.0, "dead_zone": 0.01},
    "loop": [{"name": "theta2", "controller": [{"kind": "pi", "f_hz": 1.0}]}],
    "experiment": [
        {"name": "sweep", "excites": "theta2", "lead_s": 0.1, "tail_s": 0.1,
         "excitation": {"kind": "sweep", "f_low_hz": 0.5, "f_high_hz": 30.0, "duration_s": 1.0, "ramp_s": 0.1,
            "amplitude_deg": 5.0}},
        {"name": "both", "realisations": 2, "excitations": {
            "theta2": {"kind": "multisine", "f_low_hz": 1.0, "f_high_hz": 5.0, "period_s": 1.0, "ramp_s": 0.1,
            "amplitude_deg": 1.0},
            "p_ab": {"kind": "multisine", "f_low_hz": 1.0, "f_high_hz": 5.0, "period_s": 1.0, "ramp_s": 0.1,
            "amplitude_bar": 0.1}}},
        {"name": "prbs", "excites": "theta2", "role": "validation",
         "excitation": {"kind": "prbs", "order": 5, "clock_s": 0.01, "amplitude_deg": 1.0, "periods": 1}},
        {"name": "move", "duration_s": 2.0, "parameters": {"m2_kg": 0.6}, "references": {
            "theta2": {"kind": "staircase", "times_s": [0.0, 1.0], "values_deg": [0.0, 5.0]},
            "p_ab": {"kind": "profile", "times_s": [0.5], "values_bar": [1.1], "velocity_bar_s": 1.0,
                     "acceleration_bar_s2": 10.0, "jerk_bar_s3": 100.0}}},
        {"name": "open", "duration_s": 1.0, "control": {
            "theta2": {"kind": "staircase", "times_s": [0.0], "values_v": [0.1]}}},
    ],
}  # fmt: skip
TARGET = {
    "format": "loopshape-study/1", "rig": "target", "rate_hz": 1000.0, "operating_points": [{"axis_deg": 0.0}],
    "target": {
        "port": "tcp://127.0.0.1:4000", "baud": 921600, "on_limit": "vent", "watchdog_ms": 250, "soft_start_s": 2.0,
        "settle_s": 2.0, "place": True, "commands": {"u_v": {"axis": 1.0}},
    },
    "limits": {"axis": {"low_deg": -40.0, "high_deg": 40.0, "rate_deg_s": 800.0}, "u": {"low_v": -4.0, "high_v": 4.0}},
    "loop": [
        {"name": "axis", "output": "axis_rad", "control": "z_v", "controller": [{"kind": "gain", "gain": 1.0}]}
    ],
    "experiment": STUDY["experiment"][:1],
}  # fmt: skip


def lengths(study):
    for template in study.experiments:
        yield template.lead_s + template.tail_s + (template.duration_s or 0.0)
        yield from (signal.duration_s + (signal.period_s or 0.0) for signal in template.excited.values())


def test_words_of_a_study(area, untouched):
    plant = Arm1()

    def use(path):
        study = read_study(path)
        if max(lengths(study)) * study.rate_hz < 100_000:  # longer ones are made, and take their time
            said(lambda: plan(study, plant))

    @given(tables(STUDY))
    @examples("study words")
    def test(table):
        said(lambda: use(given_file(area, "study.toml", tomli_w.dumps(table).encode())))

    assert plan(read_study(given_file(area, "study.toml", tomli_w.dumps(STUDY).encode())), plant)
    test()


@pytest.mark.parametrize("study", [STUDY, TARGET], ids=["simulated", "target"])
def test_bytes_of_a_study(area, untouched, study):
    @given(damaged(tomli_w.dumps(study).encode()))
    @examples("study bytes")
    def test(content):
        said(lambda: read_study(given_file(area, "study.toml", content)))

    test()


def test_words_of_a_target_and_its_limits(area, untouched):
    @given(tables(TARGET))
    @examples("target words")
    def test(table):
        said(lambda: read_study(given_file(area, "study.toml", tomli_w.dumps(table).encode())))

    assert read_study(given_file(area, "study.toml", tomli_w.dumps(TARGET).encode())).target
    test()


CAMPAIGN = {
    "format": "loopshape-campaign/1", "study": "study.toml", "amplitudes": [0.5, 1.0],
    "effects": ["", "gas_law=0.8", "gas_law + payload=0.1"], "draws": 2, "seed": 1,
}  # fmt: skip


def test_words_of_a_campaign(area, untouched):
    plant = Arm1()
    given_file(area, "study.toml", tomli_w.dumps(STUDY).encode())

    def use(path):
        read, _ = read_campaign(path, lambda plant, words: asked(Arm1(), words) if words else {})
        for machine in itertools.islice(read.machines(plant.spread, plant.parameters), 3):
            assert "/" not in machine.name

    @given(tables(CAMPAIGN))
    @examples("campaign words")
    def test(table):
        said(lambda: use(given_file(area, "campaign.toml", tomli_w.dumps(table).encode())))

    use(given_file(area, "campaign.toml", tomli_w.dumps(CAMPAIGN).encode()))
    test()


MAP = {
    "format": "loopshape-map/1", "rate_hz": 100.0, "plant": "servo-axis", "outputs": ["x_m"], "resample": True,
    "time": {"from": "t", "unit": "ms"}, "csv": {"separator": ";", "header": True, "skip_rows": 1, "decimal": ","},
    "pwm": {"frequency_hz": 50.0}, "parameters": {"mass_kg": 1.0},
    "columns": {"x_m": {"from": "a", "unit": "mm", "sign": -1, "gain": 2.0, "offset": 0.1},
                "z_v": {"from": "b", "unit": "V"}},
    "loop": [{"name": "x", "control": "z_v", "output": "x_m"}],
    "recording": {"name": "r01", "from_row": 2, "to_row": 40, "kind": "noise", "excites": "x", "injection": "control",
                  "closed_loop": False, "operating_point": {"x_m": 0.0}},
}  # fmt: skip


def test_words_of_a_map(area, untouched):
    rows = "\n".join(f"{10 * k};{k % 7},5;{k % 3}" for k in range(60))
    file = given_file(area, "data.csv", f"a bench\nt;a;b\n{rows}\n".encode())

    @given(tables(MAP))
    @examples("map words")
    def test(table):
        said(lambda: import_file(file, given_file(area, "map.toml", tomli_w.dumps(table).encode())))

    assert import_file(file, given_file(area, "map.toml", tomli_w.dumps(MAP).encode())).recordings
    test()


CELLS = st.one_of(
    st.floats().map(repr), st.integers().map(str), st.text(max_size=6),
    st.sampled_from([
        "", '"', '""', "'", "1,5", "1e999", "-inf", "nan", "NA", "True", "\0", "1" * 400, "0x10", "1_000", "1 000",
        "2026-01-01", "\t", "\ufeff", "1;2", "x" * 140_000, "1e-400", "+-1", "--1", "٣", "1j", "inf",
    ]),
)  # fmt: skip


@st.composite
def csv_files(draw):
    separator = draw(st.sampled_from([",", ";", "\t", " ", "|", "é", "\0"]))
    width = draw(st.integers(1, 4))
    ragged = draw(st.booleans())
    rows = draw(st.lists(st.lists(CELLS, min_size=0 if ragged else width, max_size=width), max_size=5))
    head = [draw(st.sampled_from(["t_s", "a", "b", "", "a b", '"a', "1", "x_m", "'"])) for _ in range(width)]
    text = draw(st.sampled_from(["\n", "\r\n", "\r"])).join(separator.join(row) for row in [head, *rows])
    return text.encode(draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"])), "replace"), separator


def use_source(path, shape=CsvShape()):  # noqa: B008
    """Every array of a file, as an import would take it."""
    source = open_source(path, shape)
    for k, name in enumerate(source.names[:20]):
        said(lambda name=name, k=k: source.signal(Place(None, k + 1) if source.numbered else Place(name)))
        said(lambda name=name: source.signal(Place(name, column=1)))


def use_table(path):
    columns = TableColumns(path, RATE)
    assert len(columns) == len(list(columns))
    for name in columns:
        said(lambda name=name: columns[name])


def test_csv_files_of_all_sorts(area, untouched):
    @given(csv_files(), st.booleans(), st.sampled_from([0, 1, 5, 2**40, 2**62]), st.sampled_from([".", ","]))
    @examples("csv")
    def test(made, header, skip, decimal):
        content, separator = made
        path = given_file(area, "a.csv", content)
        said(lambda: use_table(path))
        said(lambda: use_source(path, CsvShape(separator, header, skip, decimal)))

    test()


def test_bytes_of_a_packed_csv_file(area, untouched):
    text = "t_s,a\n" + "\n".join(f"{k / RATE},{k % 5}" for k in range(200))

    @given(damaged(gzip.compress(text.encode(), mtime=0)))
    @examples("csv bytes")
    def test(content):
        path = given_file(area, "a.csv.gz", content)
        said(lambda: use_table(path))
        said(lambda: use_source(path))

    test()


@pytest.mark.parametrize(
    "content", [b"", b"\n", b"a,b", b"a,b\n", b"\0" * 5000, b"t_s\n" * 3, b'"' * 10_000, b"," * 10_000]
)
def test_csv_files_that_hold_little(area, untouched, content):
    path = given_file(area, "a.csv", content)
    said(lambda: use_table(path))
    said(lambda: use_source(path))


@pytest.mark.long
@pytest.mark.hour
def test_a_csv_file_of_a_hundred_thousand_columns_is_read(area):
    wide = [f"c{k}" for k in range(100_000)]
    path = given_file(area, "wide.csv", (",".join(wide) + "\n" + ",".join(["1.5"] * len(wide)) + "\n").encode())
    columns = TableColumns(path)
    assert sum(columns[name][0] for name in wide[::10]) == 1.5 * 10_000


MAT = {
    "t": np.arange(20.0)[:, None], "z": np.ones((3, 4)) + 1j, "n": np.arange(6, dtype=np.int8), "s": "text",
    "c": np.array(["a", "b"], dtype=object), "st": {"f": np.arange(3.0)}, "e": np.zeros((0, 0)), "b": np.array([True]),
}  # fmt: skip


def mat(area, *, packed):
    savemat(area / "given.mat", MAT, do_compression=packed)
    content = (area / "given.mat").read_bytes()
    (area / "given.mat").unlink()
    return content


@pytest.mark.parametrize("packed", [False, True])
def test_bytes_of_a_mat_file(area, untouched, packed):
    @given(damaged(mat(area, packed=packed)))
    @examples("mat bytes")
    def test(content):
        said(lambda: use_source(given_file(area, "a.mat", content)))

    test()


MAT_HEAD = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + b"\x00\x01IM"
WORDS_OF_4 = st.sampled_from(
    [0, 1, 2, 4, 5, 6, 8, 9, 14, 15, 16, 2**16, 4 << 16 | 1, 2**31 - 1, 2**31, 2**32 - 1, 3, 7]
)


def test_mat_files_made_of_lying_lengths(area, untouched):
    """Words that a MAT file is made of, in any order, packed or not."""

    @given(st.lists(WORDS_OF_4, max_size=40), st.booleans())
    @examples("mat made up")
    def test(words, packed):
        body = b"".join(word.to_bytes(4, "little") for word in words)
        inner = (14).to_bytes(4, "little") + len(body).to_bytes(4, "little") + body
        if packed:
            small = zlib.compress(inner)
            inner = (15).to_bytes(4, "little") + len(small).to_bytes(4, "little") + small
        said(lambda: use_source(given_file(area, "a.mat", MAT_HEAD + inner)))

    test()


def test_bytes_of_a_npz_file(area, untouched):
    np.savez_compressed(area / "given.npz", a=np.arange(50.0), b=np.eye(4), t=np.array("text"))
    content = (area / "given.npz").read_bytes()
    (area / "given.npz").unlink()

    @given(damaged(content))
    @examples("npz bytes")
    def test(damage):
        said(lambda: use_source(given_file(area, "a.npz", damage)))

    test()


class Evil:
    def __reduce__(self):
        return os.mkdir, ("evil",)


def test_nothing_is_unpickled_and_no_name_in_a_npz_leads_out(area, untouched, monkeypatch):
    monkeypatch.chdir(area)
    path = area / "given" / "evil.npz"
    np.savez(path, a=np.array([Evil()], dtype=object))
    assert "holds" not in said(lambda: open_source(path, CsvShape()).signal(Place("a")))
    with zipfile.ZipFile(path, "w") as file:
        for name in ("../../outside/x.npy", "/etc/x.npy", "a\0b.npy"):
            file.writestr(name, b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'}")
    said(lambda: use_source(path))
    assert not (area / "evil").exists()


def test_bytes_of_a_journal(area, untouched):
    folder = area / "given" / "journal"
    folder.mkdir(exist_ok=True)
    (folder / JOURNAL).unlink(missing_ok=True)
    for k in range(3):
        note(folder, "finished", recording=f"r{k}", sha256="0" * 64)

    @given(damaged((folder / JOURNAL).read_bytes()))
    @examples("journal")
    def test(content):
        (folder / JOURNAL).write_bytes(content)
        lines, torn = read_journal(folder)
        assert len(lines) <= 20
        assert torn >= 0
        note(folder, "resumed")
        assert read_journal(folder)[0][-1]["event"] == "resumed"

    test()


def test_words_of_a_file_of_controllers(area, untouched):
    path = area / "given" / "controllers.toml"
    path.parent.mkdir(exist_ok=True)
    lag = Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 20.0})
    write_controllers(
        path, [ls.Controller("x", (BLOCK, lag), RATE, computation_delay_s=0.001), ls.Controller("y", (BLOCK,), RATE)]
    )
    whole = read_toml(path)

    @given(tables(whole))
    @examples("controllers words")
    def test(table):
        path.write_bytes(tomli_w.dumps(table).encode())
        said(lambda: [c.blocks for c in ls.read_controllers(path)])

    test()


def frf():
    f = np.geomspace(0.1, 40.0, 30)
    return ls.FRF(
        f, (20.0 / (2j * np.pi * f))[:, None, None], np.full((f.size, 1, 1), 1e-8 + 0j), np.full(f.size, True),
        ("z_v",), ("x_m",), "made up", recording="a", loop="x", rate_hz=RATE,
    )  # fmt: skip


def test_a_file_of_fits(area, untouched):
    model = TransferFunction(np.array([1.0]), np.array([1.0, 2.0]), 0.01)
    one = ls.Fit(
        structure="lag", model=model, parameters=(Estimate("gain", 1.0, "1", 0.1),), covariance=np.eye(1),
        outcome="converged", chi2_per_dof=1.0, p_value=0.5, runs_p_value=0.5, misfit_db=0.1, band_hz=(0.1, 10.0),
        lines=30, recording="a", loop="x", operating_point={"x_m": 0.0}, delay_free=True,
    )  # fmt: skip
    folder = area / "given"
    folder.mkdir(exist_ok=True)
    whole = json.loads(write_fits(folder, [one]).read_text())

    def use(text):
        (folder / "fits.json").write_text(text)
        said(lambda: read_fits(folder))

    @given(tables(whole), damaged(json.dumps(whole).encode()))
    @examples("fits")
    def test(table, content):
        use(json.dumps(table, default=str))
        use(content.decode("latin-1"))

    assert read_fits(folder)
    test()


def test_bytes_of_a_frf(area, untouched):
    run = area / "given" / "frfs"
    run.mkdir(parents=True, exist_ok=True)
    (path,) = write_frfs(run, [frf()])

    @given(damaged(path.read_bytes()))
    @examples("frf bytes")
    def test(content):
        path.write_bytes(content)
        said(lambda: read_frfs(run))

    test()


def test_words_of_a_frf(area, untouched):
    run = area / "given" / "words"
    run.mkdir(parents=True, exist_ok=True)
    (path,) = write_frfs(run, [frf()])
    with np.load(path) as file:
        arrays = dict(file)
    whole = json.loads(str(arrays.pop("header")))

    @given(tables(whole))
    @examples("frf words")
    def test(table):
        np.savez(path, header=np.array(json.dumps(table, default=str)), **arrays)
        said(lambda: read_frfs(run))

    test()


IN_A_CHILD = """
import resource, sys, warnings
from pathlib import Path
import numpy as np
from loopshape.core.errors import LoopshapeError
from loopshape.io.csv_text import CsvShape
from loopshape.toolbox.formats.tables.sources import Place, open_source
warnings.simplefilter("ignore")
resource.setrlimit(resource.RLIMIT_AS, (MOST, MOST))
whole, folder, tries, refused = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]), int(sys.argv[3]), 0
said = ""
path = folder / ("damaged-" + Path(sys.argv[1]).name)
for seed in range(tries):
    rng = np.random.default_rng(seed)
    content = bytearray(whole[: rng.integers(len(whole))] if seed % 5 == 4 else whole)
    for place in rng.integers(0, max(len(content), 1), 1 + seed % 6):
        if content and seed:
            at, size = place if seed % 2 else place % min(len(content), 2048), 4 if seed % 3 == 0 else 1
            content[at : at + size] = rng.bytes(size) if seed % 7 else b"\\xff" * size
    path.write_bytes(bytes(content))
    print(seed, file=sys.stderr, flush=True)
    try:
        source = open_source(path, CsvShape())
        for name in source.names:
            try:
                source.signal(Place(name))
            except LoopshapeError as error:
                refused, said = refused + 1, error
    except LoopshapeError as error:
        refused, said = refused + 1, error
most_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
status = Path("/proc/self/status")
if status.exists():  # ru_maxrss begins with what the parent had; this is the child's own
    most_kb = next(int(x.split()[1]) for x in status.read_text().splitlines() if x.startswith("VmHWM"))
print(refused, most_kb, said)
""".replace("MOST", str(MOST_BYTES))


def in_a_child(path, folder, tries=1):
    """Refusals, most memory, and the last sentence, by a child that reads a file damaged so often, first not at all."""
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "ARROW_DEFAULT_MEMORY_POOL": "system",
    }
    done = subprocess.run(
        [sys.executable, "-c", IN_A_CHILD, str(path), str(folder), str(tries)],
        capture_output=True, text=True, timeout=200, env=environment, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"at {done.stderr[-1500:]}"
    refused, most_kb, sentence = done.stdout.split(" ", 2)
    return int(refused), int(most_kb), sentence


def write_hdf5(path, arrays, **more):
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values, **more)


def write_parquet(path, arrays):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({name: pa.array(values) for name, values in arrays.items()}), path, compression="zstd")


@pytest.mark.parametrize("ending", ["mat", "parquet"])
def test_readers_that_others_compiled_do_not_end_the_process(area, untouched, tmp_path, ending):
    rng = np.random.default_rng(1)
    path = tmp_path / f"whole.{ending}"
    arrays = {"a": rng.normal(size=300), "b": np.arange(300)}
    if ending == "mat":
        write_hdf5(path, arrays, compression="gzip")
    else:
        write_parquet(path, arrays)
    assert in_a_child(path, tmp_path, EXAMPLES["in a child"] // 2)[0] > 20


def bomb_mat(path):
    """A deflated block that stands on its own may be repeated as often as one likes."""
    zeros = zlib.compressobj(9)
    start = zeros.compress(b"".join(n.to_bytes(4, "little") for n in (14, 2**32 - 64)))
    start += zeros.flush(zlib.Z_FULL_FLUSH)
    block = zeros.compress(bytes(2**24)) + zeros.flush(zlib.Z_FULL_FLUSH)
    packed = start + 240 * block
    path.write_bytes(MAT_HEAD + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed)


def bomb_npz(path):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (41943040,), }".ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file, file.open("a.npy", "w") as member:
        member.write(b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
        for _ in range(20):
            member.write(bytes(2**24))


def bomb_gz(path):
    path.write_bytes(gzip.compress(b"a\n") + 100 * gzip.compress(b"0.0000000000000000000000\n" * 1_400_000))


def bomb_hdf5(path):
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("a", shape=(2**29,), dtype="f8", chunks=(2**20,), compression="gzip", fillvalue=1.0)


def bomb_parquet(path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    zeros = pa.table({"a": pa.array(np.zeros(2**24))})
    with pq.ParquetWriter(path, zeros.schema, compression="zstd") as file:
        for _ in range(3):
            file.write_table(zeros)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("a.mat", bomb_mat),
        ("a.npz", bomb_npz),
        ("h.mat", bomb_hdf5),
        ("a.csv.gz", bomb_gz),
    ],
    ids=["mat5", "npz", "hdf5", "csv.gz"],
)
def test_a_small_file_that_would_fill_the_memory_is_refused(area, tmp_path, name, make):
    make(tmp_path / name)
    assert (tmp_path / name).stat().st_size < 20_000_000
    refused, most_kb, sentence = in_a_child(tmp_path / name, tmp_path)
    assert refused == 1
    assert "would become" in sentence
    assert most_kb < 1_200_000


def test_a_small_parquet_file_that_would_fill_the_memory_is_refused_when_its_rows_are_read(tmp_path):
    bomb_parquet(tmp_path / "a.parquet")
    _, most_kb, _ = in_a_child(tmp_path / "a.parquet", tmp_path)
    assert most_kb < 400_000  # its 50 million rows are 403 MB: a long file is opened and not read
    signal = open_source(tmp_path / "a.parquet", CsvShape()).signal(Place("a"))
    assert "would become 402653184" in said(lambda: signal[2**25 : 2**25 + 9])


def test_a_text_with_half_a_character_is_refused_and_nothing_is_left(tmp_path):
    assert "half a character" in said(lambda: write_text_whole(tmp_path / "a.toml", "x\udcff"))
    assert list(tmp_path.iterdir()) == []
