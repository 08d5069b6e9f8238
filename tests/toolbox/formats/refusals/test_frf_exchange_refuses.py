"""FRF files that are damaged, foreign or say too little: a sentence each, never a traceback."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import savemat

import loopshape as ls
from loopshape.toolbox.formats.frf.frf_exchange import export_frfs, read_frf_file
from loopshape.toolbox.formats.frf.frf_foreign import Stated
from loopshape.toolbox.formats.frf.frf_uff import read_frf_uff

F = np.arange(1.0, 7.0)
SURE = Stated(relative_std=0.1)


def frf(ny=2, nu=2):
    rng = np.random.default_rng(0)
    G = rng.standard_normal((6, ny, nu)) + 1j * rng.standard_normal((6, ny, nu))
    C = np.tile(0.01 * np.eye(ny * nu), (6, 1, 1)).astype(complex)
    names = tuple(f"u{k}_v" for k in range(nu)), tuple(f"y{k}_m" for k in range(ny))
    return ls.FRF(F, G, C, np.ones(6, dtype=bool), *names, "made up", "r01", "x", 100.0)


def no(path, *words, stated=SURE, error=ls.LoopshapeError):
    with pytest.raises(error) as caught:
        read_frf_file(path, stated)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize("to", ["mat", "csv", "uff"])
@pytest.mark.parametrize("size", [(1, 1), (2, 2)])
def test_damaged_files_never_give_a_traceback(tmp_path, to, size):
    made = replace(frf(*size), coherence=np.full(6, 0.9))
    (path,), _ = export_frfs([made], to, tmp_path)
    whole, rng = path.read_bytes(), np.random.default_rng(1)
    for cut in (*rng.integers(1, len(whole), 60), 1, 5, 127, 128, 129):
        flipped = bytearray(whole)
        flipped[min(cut, len(whole)) - 1] ^= 0x55
        for damaged in (whole[:cut], bytes(flipped)):
            path.write_bytes(damaged)
            with suppress(ls.LoopshapeError):
                read_frf_file(path, SURE if to == "uff" else None)
    for cut in (len(whole) // 3, len(whole) // 2, len(whole) - 30):
        path.write_bytes(whole[:cut])
        no(path, stated=SURE if to == "uff" else None)


@pytest.mark.parametrize("to", ["mat", "csv", "uff"])
@pytest.mark.parametrize("content", [b"", b"\x00" * 300, b"PK\x03\x04" + b"x" * 90, b"\xff\xfe" * 200, b"a,b\n1,2\n"])
def test_foreign_content(tmp_path, to, content):
    path = tmp_path / f"a.{to}"
    path.write_bytes(content)
    no(path, "a.", error=ls.errors.UnreadableInputError)
    no(tmp_path / f"none.{to}", "does not exist", error=ls.errors.UnreadableInputError)


def test_mat_files_that_are_no_frf(tmp_path):
    path, one = tmp_path / "a.mat", {"response": np.ones((2, 2, 6)) * 1j, "frequency_hz": F}

    def refused(words, *said, drop=()):
        savemat(path, {k: v for k, v in (one | words).items() if k not in drop})
        no(path, *said)

    refused({}, "gives its frequencies once", "response", drop=["frequency_hz"])
    refused({"frequency": F}, "gives its frequencies once")
    refused({}, "holds no response", drop=["response"])
    refused(
        {"response": np.ones((6, 2, 2))}, "goes over its 6 lines last", "6 x 2 x 2", "outputs x inputs x frequencies"
    )
    refused({"response": {"a": 1.0}}, "response of", "not an array of numbers")
    refused({"response": "text"}, "not an array of numbers")
    refused({"frequency_hz": F * 1j}, "a vector of real numbers")
    refused({"frequency_hz": F[::-1]}, "strictly increasing")
    refused({"frequency_hz": "frequency"}, "a vector of real numbers")
    refused({"response": np.full((2, 2, 6), np.nan)}, "values that are not numbers", "1 Hz")
    refused({"format": "other/9"}, "not of the format loopshape-frf-mat/2", "'other/9'")
    refused({"header": "{"}, "the words of an FRF")
    refused({"header": '{"rate_hz": [1]}'}, "words cannot be read")
    refused({"inputs": np.array(["a"], dtype=object)}, "it has 2 inputs")
    refused({"covariance": np.ones((3, 3, 6))}, "relative standard deviation was stated", "leave the statement out")
    savemat(path, {"response": np.ones(6), "frequency": F, "frequency_unit": "kHz"})
    no(path, "frequency_unit", "'kHz'", "use Hz or rad/s")
    savemat(path, one | {"covariance": np.ones((3, 3, 6))})
    no(path, "a covariance is", stated=None)
    skew = np.tile([[1.0, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], (6, 1, 1)).transpose(1, 2, 0)
    savemat(path, one | {"covariance": skew})
    no(path, "not Hermitian", stated=None)


def test_nobody_knows_how_sure_it_is(tmp_path):
    path = tmp_path / "a.mat"
    savemat(path, {"response": np.ones(6) + 0j, "frequency_hz": F})
    no(path, "the error of this FRF", "neither covariance nor coherence", "--relative-std", stated=None)
    savemat(path, {"response": np.ones(6) + 0j, "frequency_hz": F, "coherence": np.full(6, 0.9)})
    no(path, "without the number of averages", "--averages", stated=None)
    assert read_frf_file(path, Stated(averages=10)).variance[0, 0, 0] == pytest.approx(0.1 / (0.9 * 9))
    savemat(path, {"response": np.ones(6) + 0j, "frequency_hz": F, "coherence": np.full(6, 1.2)})
    no(path, "between 0 and 1", stated=Stated(averages=10))
    no(path, "averages above 1", stated=Stated(averages=1))
    (unsure,), _ = export_frfs([frf()], "uff", tmp_path)
    no(unsure, "neither covariance nor coherence", stated=None)


def test_tables_that_are_no_frf(tmp_path):
    (path,), _ = export_frfs([frf()], "csv", tmp_path)
    whole = path.read_text()
    lines = whole.splitlines()

    def refused(text, *said, stated=None):
        path.write_text(text)
        no(path, *said, stated=stated)

    refused("\n".join(lines[:-1]) + "\n", "is cut short", "5 of 6 lines")
    refused(whole.replace("loopshape-frf-csv/2", "other/1"), "not of the format loopshape-frf-csv/2")
    refused(whole.replace("re_y0_m_u0_v", "re_y9_m_u0_v"), "no table of an FRF", "no re_y0_m_u0_v", "'re_y9_m_u0_v'")
    refused(whole.replace("cov_re_2_1", "valid"), "a name of its own")
    refused("\n".join(lines[2:]) + "\n", "no table of an FRF", "--outputs")
    refused(whole.replace(lines[5].split(",")[1], "", 1), "a number in every row", "row 3")
    refused(whole.replace(lines[5].split(",")[1], "one", 1), "not numbers", "'one'")
    refused("# loopshape-frf-csv/2\n# [1]\n" + "\n".join(lines[2:]), "the words of an FRF's table")
    refused("\n".join([*lines[:5], lines[5][:-1] + "2", *lines[6:]]) + "\n", "valid", "1 or 0")
    refused("frequency_hz,re,im,std\n1,1,0,-1\n", "is negative")
    refused("frequency_hz,re,im\n2,1,0\n1,1,0\n", "strictly increasing", stated=SURE)
    refused("frequency_hz,re,im\n", "a header and no rows", stated=SURE)


def test_universal_files_that_are_no_matrix(tmp_path):
    import pyuff

    path = tmp_path / "a.uff"
    one = {
        "type": 58, "binary": 0, "func_type": 4, "rsp_node": 1, "rsp_dir": 3, "ref_node": 1, "ref_dir": 3, "x": F,
        "data": np.ones(6) * 1j, "abscissa_spec_data_type": 18, "orddenom_spec_data_type": 0,
    }  # fmt: skip

    def refused(sets, *said):
        pyuff.UFF(str(path)).write_sets([dict(s) for s in sets], mode="overwrite")
        no(path, *said)

    refused([one, one], "holds one pair twice")
    refused([one | {"func_type": 2, "data": np.ones(6)}], "holds no frequency response", "types 2")
    refused([one, one | {"rsp_node": 2, "ref_node": 2}], "no whole matrix", "no function of node 1 by node 2")
    refused([one, one | {"rsp_node": 2, "x": 2 * F}], "no whole matrix", "other frequencies")
    refused([one | {"data": np.ones(6)}], "real numbers")
    refused([one | {"abscissa_spec_data_type": 17}], "which is no frequency")
    pyuff.UFF(str(path)).write_sets([dict(one), one | {"rsp_node": 2}], mode="overwrite")
    whole = path.read_bytes()
    path.write_bytes(whole.rstrip()[:-2])
    no(path, "cut short")
    path.write_bytes(whole.replace(b"         6         6", b"         6         7", 1))
    no(path, "a function of 7 points has 6 values")


def test_universal_files_are_read_up_to_a_size_and_need_pyuff(tmp_path, monkeypatch):
    (path,), _ = export_frfs([frf(1, 1)], "uff", tmp_path)
    monkeypatch.setattr("loopshape.toolbox.formats.frf.frf_uff.LIMIT_BYTES", 100)
    no(path, "are read at most")
    monkeypatch.setitem(__import__("sys").modules, "pyuff", None)
    with pytest.raises(ls.errors.WrongUseError, match=r"the library pyuff.*pip install 'loopshape\[uff\]'"):
        read_frf_uff(path)


def test_names_that_no_file_can_carry(tmp_path):
    with pytest.raises(ls.errors.UnreadableInputError, match="plain name"):
        export_frfs([replace(frf(), recording="../r01")], "mat", tmp_path)
    with pytest.raises(ls.errors.WrongUseError, match="two FRFs have one name"):
        export_frfs([frf(), frf()], "mat", tmp_path)
    with pytest.raises(ls.errors.WrongUseError, match="80 plain letters"):
        export_frfs([replace(frf(1, 1), inputs=("ü_v",))], "uff", tmp_path)
    assert not list(tmp_path.iterdir())


def test_python_control_needs_an_error():
    with pytest.raises(ls.errors.WrongUseError, match="only frequency response data"):
        ls.from_control(3.0, relative_std=0.1)
    import control

    with pytest.raises(ls.errors.WrongUseError, match="the error of this FRF"):
        ls.from_control(control.frd(np.ones(6) * 1j, F))
