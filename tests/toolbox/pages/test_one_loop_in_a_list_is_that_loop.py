"""One loop in a list, or the matrix of one loop, makes the same pages as the loop."""

import re
from dataclasses import replace

import pytest
from one_loop import drawn
from run_files import write_frfs, write_matrices

import loopshape as ls


@pytest.mark.parametrize("seed", range(2))
def test_shape(tmp_path, seed):
    P, C, R = drawn(seed)
    pages = [ls.shape(P, C, R, tmp_path / "one.html"), ls.shape([P], [C], [R], tmp_path / "list.html")]
    bare, poles = replace(R, integrators=None, unstable_poles=None), {"integrators": R.integrators, "unstable_poles": 0}
    pages.append(ls.shape([P], [C], [bare], tmp_path / "all.html", together=ls.Requirements(**poles)))
    one, *others = (path.read_bytes() for path in pages)
    assert others == [one, one]


def test_report(tmp_path):
    """A run's matrix of one loop is shown as its FRF of that loop: the same verdict, margins and certificate."""
    P, C, R = drawn(1)
    P = replace(P, recording="one")
    write_frfs(tmp_path / "run", [P])
    write_matrices(tmp_path / "all" / "run", [P])
    ls.write(C, tmp_path / "c.toml")
    ls.write(R, tmp_path / "r.toml")
    given = {"controllers": tmp_path / "c.toml", "requirements": tmp_path / "r.toml", "date": "2020-01-01"}
    pages = [
        ls.report(folder, tmp_path / "x.html", **given).read_text()
        for folder in (tmp_path / "run", tmp_path / "all" / "run")
    ]
    one, matrix = (
        [re.sub(r"<[^>]+>", "", part) for part in re.findall(r"<table.*?</table>", page, re.S)] for page in pages
    )
    shown = [
        table for table in one if table.startswith(("Requirements of loop", "Margins of", "Peaks and", "Closed loop"))
    ]
    assert len(shown) == 4
    assert [table for table in shown if table not in matrix] == []
