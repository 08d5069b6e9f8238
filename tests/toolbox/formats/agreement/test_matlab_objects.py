"""Objects in MAT files: what mat-io writes (the layout of MATLAB's own files) is read back as signals with their time.

No file of MATLAB's own could be had here: the properties are those that MATLAB's public documents and readers name.
"""

import numpy as np
import pandas as pd
import pytest
from run_files import CsvShape

import loopshape as ls
from loopshape.toolbox.formats.drafts.draft_map import draft_map
from loopshape.toolbox.formats.tables.sources import Place, open_source

matio = pytest.importorskip("matio")
matclass = pytest.importorskip("matio.utils.matclass")
T = np.arange(400) / 50.0
X, U = np.sin(T), np.cos(3.0 * T)
VERSIONS = pytest.mark.parametrize("version", ["v7", "v7.3"])
DATASET = "Simulink.SimulationData.Dataset"


def thing(kind, properties):
    return matclass.MatlabOpaque(properties, kind)


def column(values):
    return np.asarray(values, dtype=float).reshape(-1, 1)


def number(value):
    return np.array([[float(value)]])


def series(values, unit="", stamps=None):
    """A timeseries; without stamps its TimeInfo states them, as MATLAB does for an even time."""
    even = {"Start_": number(0), "Increment_": number(0.02), "Length": number(400)}
    info = {"Units": "seconds", **(even if stamps is None else {})}
    return thing(
        "timeseries",
        {
            "Name": "unnamed", "Data_": values, "Time_": np.empty((0, 0)) if stamps is None else column(stamps),
            "TimeInfo": thing("tsdata.timemetadata", info), "DataInfo": thing("tsdata.datametadata", {"Units": unit}),
        },
    )  # fmt: skip


def element(name, values):
    inner = {"Name": name, "BlockPath": "model/x", "PortIndex": number(1), "Values": values}
    return thing("Simulink.SimulationData.Signal", inner)


def dataset(*elements):
    """What Dataset's own saving makes: a structure whose Storage is an object with a cell of elements."""
    cells = np.empty((1, len(elements)), dtype=object)
    cells[0, :] = elements
    storage = thing("Simulink.SimulationData.Storage.RamDatasetStorage", {"Version": number(2), "Elements": cells})
    saved = np.empty((1, 1), dtype=[("Name", "O"), ("Version", "O"), ("Storage", "O")])
    saved[0, 0] = ("logsout", number(3), storage)
    return thing(DATASET, {"any": saved})


def written(path, variables, version):
    matio.save_to_mat(str(path), mdict=variables, version=version, saveobj_classes=[DATASET])
    return path


def signal(source, name, column=None):
    return np.asarray(source.signal(Place(name, column)))


@VERSIONS
def test_a_timeseries_has_its_values_stamps_and_unit(version, tmp_path):
    wide = np.stack([X, U])[:, None, :]  # 2 x 1 x n: time goes last
    late = T + 0.001 * np.sin(T)
    held = {"pos": series(column(X), "rad"), "both": series(wide), "own": series(column(U), "V", late)}
    source = open_source(written(tmp_path / "a.mat", {**held, "fs": number(50)}, version), CsvShape())
    np.testing.assert_array_equal(signal(source, "pos"), X)
    np.testing.assert_allclose(signal(source, "time of pos"), T, atol=1e-12)
    np.testing.assert_array_equal(signal(source, "both", 2), U)
    np.testing.assert_array_equal(signal(source, "time of own"), late)
    np.testing.assert_array_equal(signal(source, "fs"), [50.0])
    assert {name: unit for name, unit in source.units().items() if unit != "s"} == {"pos": "rad", "own": "V"}


@VERSIONS
def test_elements_of_a_dataset_are_called_by_their_names(version, tmp_path):
    logs = dataset(element("drive", series(column(U), "V")), element("pos", series(column(X), "rad")))
    source = open_source(written(tmp_path / "a.mat", {"logsout": logs}, version), CsvShape())
    assert set(source.names) == {"logsout.drive", "logsout.pos", "time of logsout.drive", "time of logsout.pos"}
    np.testing.assert_array_equal(signal(source, "logsout.pos"), X)
    np.testing.assert_array_equal(signal(source, "logsout.drive"), U)


@VERSIONS
@pytest.mark.filterwarnings("ignore::matio.utils.matclass.MatConvertWarning")
def test_tables_and_timetables_give_their_columns(version, tmp_path):
    table = pd.DataFrame({"drive": U, "pos": X, "note": ["a"] * 400})
    timed = pd.DataFrame({"drive": U, "pos": X}, index=pd.to_timedelta(1e3 * T, unit="ms").as_unit("ms"))
    source = open_source(written(tmp_path / "a.mat", {"T": table, "TT": timed}, version), CsvShape())
    np.testing.assert_array_equal(signal(source, "T.pos"), X)
    np.testing.assert_array_equal(signal(source, "TT.drive"), U)
    np.testing.assert_allclose(signal(source, "time of TT.pos"), T, atol=1e-9)


@VERSIONS
def test_lists_of_structures_and_cells_are_opened_alike(version, tmp_path):
    lines = np.zeros((1, 2), dtype=[("Data", "O"), ("Name", "O")])
    lines[0, 0], lines[0, 1] = (column(X), "pos"), (column(U), "drive")
    exp = np.zeros((1, 1), dtype=[("X", "O"), ("Y", "O")])
    axis = np.zeros((1, 1), dtype=[("Data", "O")])
    axis[0, 0] = (column(T),)
    exp[0, 0] = (axis, lines)
    source = open_source(written(tmp_path / "a.mat", {"exp": exp}, version), CsvShape())
    np.testing.assert_array_equal(signal(source, "exp.Y.drive.Data"), U)
    np.testing.assert_array_equal(signal(source, "exp.X.Data"), T)


@VERSIONS
def test_the_draft_of_a_simulink_log_takes_rate_units_and_parts(version, tmp_path):
    rng = np.random.default_rng(1)
    r, u, y = rng.standard_normal(400), np.zeros(400), np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
        u[k] = 2.0 * (r[k] - y[k])
    signals = (("ref", r, "rad"), ("u", u, "V"), ("pos", y, "rad"))
    logs = dataset(*(element(name, series(column(values), unit)) for name, values, unit in signals))
    draft = draft_map(written(tmp_path / "a.mat", {"logsout": logs}, version))
    assert draft.rate_hz == 50.0
    assert draft.roles == {"logsout.ref": "reference", "logsout.u": "control", "logsout.pos": "output"}
    assert not draft.open


@VERSIONS
def test_records_of_simulink_s_own_are_refused_with_the_way_out(version, tmp_path):
    saved = np.empty((1, 1), dtype=[("Name", "O"), ("Version", "O"), ("Storage", "O")])
    storage = thing("Simulink.SimulationData.Storage.MatFileDatasetStorage", {"Version": number(2)})
    saved[0, 0] = ("l", number(3), storage)
    file = written(tmp_path / "a.mat", {"logsout": thing(DATASET, {"any": saved})}, version)
    with pytest.raises(ls.LoopshapeError, match=r"Simulink's own records.*without -v7.3"):
        open_source(file, CsvShape())


@VERSIONS
def test_a_damaged_file_is_read_or_refused_and_nothing_else(version, tmp_path):
    logs = dataset(element("drive", series(column(U), "V")), element("pos", series(column(X), "rad")))
    file = written(tmp_path / "a.mat", {"logsout": logs}, version)
    good, rng, refused = file.read_bytes(), np.random.default_rng(1), 0
    for _ in range(60):
        bad = bytearray(good)
        for at in rng.integers(128, len(good), 3):
            bad[at] ^= 1 << rng.integers(8)
        file.write_bytes(bad)
        try:
            source = open_source(file, CsvShape())
            for name in source.names:
                source.load(name)
        except ls.LoopshapeError:
            refused += 1
    assert refused


def test_objects_that_point_at_each_other_end(tmp_path):
    """A class that keeps its parent: what lies deep stays closed, what lies near is read."""
    inner = thing("axis", {"gain": number(2), "trace": column(X)})
    for _ in range(12):
        inner = thing("axis", {"inner": inner, "trace": column(U)})
    source = open_source(written(tmp_path / "a.mat", {"machine": inner}, "v7"), CsvShape())
    np.testing.assert_array_equal(signal(source, "machine.trace"), U)
