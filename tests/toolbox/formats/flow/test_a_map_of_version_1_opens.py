"""A map kept as a version wrote it reads as it did then."""

from pathlib import Path

from loopshape.toolbox.formats.tables.import_map import read_map


def test_map_1():
    found = read_map(Path(__file__).parents[3] / "helpers/kept/map-1.toml", "log")
    x, r = found.columns
    assert (x.stored, x.scale, r.scale, found.from_row, found.csv.separator) == ("x_m", -0.001, 0.001, 2, "\t")
    assert (found.info.file, found.made[0].controller, found.resample) == ("r01.parquet", "axis", True)
