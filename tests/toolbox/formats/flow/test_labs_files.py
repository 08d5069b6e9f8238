"""Files that labs have come in, and signals go out, unchanged: MDF in; MATLAB, C and tables out."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import invoked
from run_files import CsvShape
from scipy.io import loadmat
from simulated_machines import Arm1, experiment, plan, read_study

import loopshape as ls
from loopshape.toolbox.formats.tables.sources import Place, open_source

RATE = 200.0
MAP = """
format = "loopshape-map/1"
rate_hz = 200.0
time = { from = "time of angle", unit = "s" }
[columns]
axis_rad = { from = "angle", unit = "deg" }
u_axis_v = { from = "command", unit = "V" }
[[loop]]
name = "axis"
control = "u_axis_v"
output = "axis_rad"
[recording]
kind = "noise"
excites = "axis"
injection = "control"
"""


@pytest.fixture(scope="module")
def mdf(tmp_path_factory):
    asammdf = pytest.importorskip("asammdf", reason="the extra `mdf` is not installed")
    path = tmp_path_factory.mktemp("mdf") / "bench.mf4"
    t = np.arange(2000) / RATE
    rng = np.random.default_rng(1)
    file = asammdf.MDF(version="4.10")
    file.append([
        asammdf.Signal(rng.normal(size=2000), t, name="angle", unit="deg"),
        asammdf.Signal(rng.normal(size=2000), t, name="command", unit="V"),
    ])  # fmt: skip
    file.append([asammdf.Signal(np.arange(20.0), t[::100], name="temperature", unit="degC")])
    file.save(path, overwrite=True)
    file.close()
    return path


def test_channels_of_an_mdf_file_and_their_times(mdf):
    source = open_source(mdf, CsvShape())
    assert set(source.names) == {f"{p}{n}" for n in ("angle", "command", "temperature") for p in ("", "time of ")}
    assert source.signal(Place("angle")).tolist() == np.random.default_rng(1).normal(size=2000).tolist()
    assert source.signal(Place("time of temperature")) == pytest.approx(np.arange(20) * 0.5)


def test_a_channel_of_two_groups_is_left_out_and_named(tmp_path):
    asammdf = pytest.importorskip("asammdf", reason="the extra `mdf` is not installed")
    t, file = np.arange(200) / RATE, asammdf.MDF(version="4.10")
    for names in (("angle", "twice"), ("command", "twice")):
        file.append([asammdf.Signal(np.sin(t), t, name=name) for name in names])
    file.save(tmp_path / "a.mf4", overwrite=True)
    file.close()
    source = open_source(tmp_path / "a.mf4", CsvShape())
    assert "twice" not in source.names
    assert source.closed == ("twice (of 2 groups)",)


@pytest.mark.short
def test_an_mdf_file_becomes_a_run(mdf, tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    result = invoked(["import", str(mdf), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "run")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "run" / "bench.parquet").is_file()


DAMAGED = """
import sys, numpy as np
from pathlib import Path
from loopshape.core.errors import LoopshapeError
from loopshape.io.csv_text import CsvShape
from loopshape.toolbox.formats.tables.sources import Place, open_source
whole, folder, refused = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]), 0
for seed in range(60):
    rng = np.random.default_rng(seed)
    content = bytearray(whole[: rng.integers(len(whole))] if seed % 3 == 0 else whole)
    for place in rng.integers(0, len(content), 1 + seed % 8) if content else ():
        content[place] = rng.integers(256)
    path = folder / f"{seed}.mf4"
    path.write_bytes(bytes(content))
    try:
        source = open_source(path, CsvShape())
        for name in source.names:
            source.signal(Place(name))
    except LoopshapeError:
        refused += 1
print(refused)
"""


@pytest.mark.long
def test_a_damaged_mdf_file_ends_in_a_sentence(mdf, tmp_path):
    """In a process of its own: what the reader does to damaged files is its own affair."""
    said = subprocess.run(
        [sys.executable, "-c", DAMAGED, str(mdf), str(tmp_path)], capture_output=True, text=True, timeout=300
    )
    assert said.returncode == 0, said.stderr[-2000:]
    assert int(said.stdout) > 15  # those cut short at the least


STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 10.0, p_ab_bar = 1.0 }]
[[experiment]]
name = "angle"
excites = "theta2"
lead_s = 0.1
excitation = { kind="multisine", f_low_hz=1, f_high_hz=9, period_s=1, ramp_s=0.1, periods=1, amplitude_deg=2}
"""


@pytest.fixture
def exported(tmp_path):
    def export(to):
        (tmp_path / "study.toml").write_text(STUDY)
        words = ["export-excitation", str(tmp_path / "study.toml"), "--to", to, "--out", str(tmp_path / "out")]
        result = invoked(words)
        if isinstance(result.exception, ls.LoopshapeError):
            raise result.exception
        (path,) = (tmp_path / "out").iterdir()
        return path

    return export


@pytest.fixture
def asked(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study, plant = read_study(tmp_path / "study.toml"), Arm1()
    return experiment(study, plant, plan(study, plant)[0])


def test_signals_as_a_table_read_back_exactly(exported, asked):
    table = np.genfromtxt(exported("csv"), delimiter=",", names=True)
    assert (table["n_theta2_rad"] == asked.injected[:, 0]).all()
    assert (table["r_theta2_rad"] == asked.references[:, 0]).all()
    assert table["t_s"][-1] == pytest.approx(asked.duration_s - 0.001)


def test_signals_for_simulink_are_time_and_value(exported, asked):
    held = loadmat(exported("mat"))
    assert held["n_theta2_rad"].shape == (asked.samples, 2)
    assert (held["n_theta2_rad"][:, 1] == asked.injected[:, 0]).all()
    assert (held["r_p_ab_bar"][:, 1] == 1.0).all()
    assert held["rate_hz"].item() == 1000.0


@pytest.mark.short
def test_signals_in_c_are_the_signals_to_single_precision(exported, asked, tmp_path):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    header = exported("c")
    program = tmp_path / "print.c"
    program.write_text(
        f'#include "{header}"\n#include <stdio.h>\nint main(void) {{ int k; for (k = 0; k < ANGLE_SAMPLES; k++) '
        'printf("%.9g\\n", angle_n_theta2_rad[k]); printf("%.17g\\n", ANGLE_R_THETA2_RAD); return 0; }\n'
    )
    subprocess.run([compiler, "-std=c99", "-Wall", "-Werror", str(program), "-o", str(tmp_path / "print")], check=True)
    said = subprocess.run([str(tmp_path / "print")], check=True, capture_output=True, text=True).stdout.split()
    assert (np.float32([float(v) for v in said[:-1]]) == np.float32(asked.injected[:, 0])).all()
    assert float(said[-1]) == asked.references[0, 0]


def test_an_unknown_format_is_refused(exported):
    with pytest.raises(ls.LoopshapeError, match="a format for signals is not known; received 'xls'"):
        exported("xls")


def test_a_file_of_an_unknown_kind_names_those_that_are_read(tmp_path):
    with pytest.raises(ls.errors.UnreadableInputError, match=r"\.mat, \.npz, \.parquet, \.mf4, \.mdf"):
        open_source(Path(tmp_path / "a.xls"), CsvShape())
