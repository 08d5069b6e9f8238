"""Exported controllers answer as the checked one where others read them: PLC, foton, scipy; FRFs by h5py alone."""

import re
import xml.etree.ElementTree as ET
from itertools import pairwise

import h5py
import numpy as np
import pytest
from scipy.signal import sosfilt

import loopshape as ls
from loopshape.toolbox.formats.controllers.controller_export import export_controllers
from loopshape.toolbox.formats.controllers.controller_words import step
from loopshape.toolbox.formats.frf.frf_exchange import export_frfs, read_frf_file

BLOCKS = (ls.gain(-0.37), ls.lead_lag(2.2, 18.0), ls.notch(40.0, 0.05, 0.8), ls.pi(0.7))
C = ls.controller(*BLOCKS, rate_hz=1000.0, loop="theta 2")
SINGLE = ls.controller(*BLOCKS, rate_hz=1000.0, loop="theta 2", precision="single")
E = np.random.default_rng(2).standard_normal(60)


def exported(controller, to, folder):
    (path,) = export_controllers(folder, [controller], to)
    return path


def run_st(body, kind, inputs):
    """The body of a function block as a PLC runs it: one `name := expression;` after the other, without its reset."""
    body = re.sub(r"\(\*.*?\*\)", "", body, flags=re.DOTALL)
    body = re.sub(r"IF bReset THEN.*?END_IF", "", body, flags=re.DOTALL)
    rows = [row.strip() for row in body.split(";") if row.strip()]
    code = []
    for row in rows:
        name, expression = (part.strip() for part in row.split(":="))
        assert not re.search(r"[-+*]\s*[-+]", expression), expression  # no two signs in a row
        code.append(f"{name} = " + re.sub(r"(?<![\w.])(\d+\.\d+(?:e[-+]?\d+)?)", r"kind(\1)", expression))
    program = compile("\n".join(code), "st", "exec")
    names = set(re.findall(r"s\d+_\d", body))
    state = {"kind": kind} | dict.fromkeys(names, kind(0.0))
    out = []
    for value in inputs:
        state["fIn"] = kind(value)
        exec(program, {}, state)  # text of our own
        out.append(state["fOut"])
    return np.array(out)


@pytest.mark.parametrize(("controller", "kind", "word"), [(C, np.float64, "LREAL"), (SINGLE, np.float32, " REAL")])
def test_structured_text_is_the_controller_bit_for_bit(controller, kind, word, tmp_path):
    text = exported(controller, "st", tmp_path).read_text("ascii")
    assert text.endswith("END_FUNCTION_BLOCK\n")
    assert word in text
    assert "FUNCTION_BLOCK FB_controller_theta_2" in text
    declared = set(re.findall(r"^ +(\w+) :", text, re.MULTILINE))
    body = text.split("END_VAR\n")[-1].removesuffix("END_FUNCTION_BLOCK\n")
    assert set(re.findall(r"(\w+) :=", body)) <= declared
    np.testing.assert_array_equal(run_st(body, kind, E), step(controller, E))


def test_twincat_s_pou_holds_the_same_text(tmp_path):
    pou = ET.parse(exported(C, "twincat", tmp_path)).getroot().find("POU")
    assert re.fullmatch(r"\{[0-9a-f-]{36}\}", pou.get("Id"))
    together = pou.findtext("Declaration") + pou.findtext("Implementation/ST") + "END_FUNCTION_BLOCK\n"
    assert together == exported(C, "st", tmp_path).read_text("ascii")


def read_foton(text):
    """Rate and sections (n, 6) of the one filter, as the control system reads the file: gain, then a1 a2 b1 b2."""
    rows = [row.split() for row in text.splitlines() if row and not row.startswith("#")]
    assert len(rows[0]) == 12
    assert len(rows) == int(rows[0][3])
    gain, tails = float(rows[0][7]), [rows[0][8:], *rows[1:]]
    sections = [[1.0, float(b1), float(b2), 1.0, float(a1), float(a2)] for a1, a2, b1, b2 in tails]
    sections[0][:3] = [gain * b for b in sections[0][:3]]
    return float(re.search(r"^# SAMPLING \S+ (\d+)$", text, re.MULTILINE)[1]), np.array(sections)


def test_foton_s_filter_is_the_controller(tmp_path):
    rate, sections = read_foton(exported(C, "foton", tmp_path).read_text())
    assert rate == 1000.0
    np.testing.assert_allclose(sosfilt(sections, E), step(C, E), rtol=1e-9, atol=1e-12)
    alone = ls.controller(ls.gain(2.5), rate_hz=1000.0, loop="x")
    np.testing.assert_allclose(sosfilt(read_foton(exported(alone, "foton", tmp_path).read_text())[1], E), 2.5 * E)


def test_what_foton_cannot_hold_is_refused(tmp_path):
    many = ls.controller(*[ls.lead_lag(1.0, 2.0)] * 11, rate_hz=1000.0, loop="x")
    for one in (many, ls.controller(ls.gain(1.0), rate_hz=0.5, loop="x")):
        with pytest.raises(ls.errors.WrongUseError, match="foton"):
            exported(one, "foton", tmp_path)


def test_scipy_runs_the_sections_as_they_are(tmp_path):
    with np.load(exported(C, "sos", tmp_path)) as file:
        np.testing.assert_allclose(sosfilt(file["sos"], E), step(C, E), rtol=1e-9, atol=1e-12)
        assert (float(file["rate_hz"]), str(file["digest"])) == (1000.0, C.digest)


def test_simulink_s_blocks_in_series_are_the_controller(tmp_path):
    text = exported(C, "simulink", tmp_path).read_text()
    rows = re.findall(r"\[path '/(\w+)'\], 'Numerator', '\[(.*?)\]', 'Denominator', '\[(.*?)\]'", text)
    sections = [[float(x) for x in f"{b} {a}".split()] for _, b, a in rows]
    gain = float(re.search(r"'Gain', '(.*?)'", text)[1])
    np.testing.assert_allclose(gain * sosfilt(sections, E), step(C, E), rtol=1e-9, atol=1e-12)
    wires = re.findall(r"add_line\(path, '(\w+)/1', '(\w+)/1'\)", text)
    names = ["In1", "gain", *(name for name, _, _ in rows), "Out1"]
    assert wires == list(pairwise(names))
    assert "'SampleTime', '1/1000.0'" in text


F = np.array([1.0, 2.0, 4.0])


def made():
    H = np.exp(-0.1j * F)[:, None, None] * np.array([[1.0, 0.2], [0.1j, 2.0], [0.0, 1.0]])
    return ls.FRF.from_arrays(
        F, H, relative_std=0.05, rate_hz=1000.0, inputs=("a_v", "b_v"), outputs=("x_m", "y_m", "z_m")
    )


def test_h5py_alone_reads_a_frf_with_its_covariance_and_provenance(tmp_path):
    P = made()
    (path,), lost = export_frfs([P], "hdf5", tmp_path)
    assert (path.suffix, lost) == (".h5", ())
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["frequency_hz"][()], P.frequency_hz)
        np.testing.assert_array_equal(file["response"][()], P.response)
        np.testing.assert_array_equal(file["covariance"][()], P.covariance)
        assert [name.decode() for name in file["outputs"]] == list(P.outputs)
        assert file.attrs["rate_hz"] == 1000.0
        assert file.attrs["method"] == P.method
        assert file.attrs["made_by"].startswith("loopshape ")
    back = read_frf_file(path)
    np.testing.assert_array_equal(back.covariance, P.covariance)
    assert (back.inputs, back.outputs, back.method) == (P.inputs, P.outputs, P.method)


def test_hdf5_of_others_and_damaged_files(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["frequency_hz"], file["response"] = F, np.ones((3, 1, 1), complex)
    with pytest.raises(ls.LoopshapeError, match="relative-std"):
        read_frf_file(path)
    with h5py.File(path, "w") as file:
        file["frequency_hz"], file["response"] = F, h5py.ExternalLink("other.h5", "x")
    with pytest.raises(ls.errors.UnreadableInputError):
        read_frf_file(path)
    export_frfs([made()], "hdf5", tmp_path)
    (path,) = tmp_path.glob("all*.h5")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for k in range(30):
        content = bytearray(whole[: rng.integers(len(whole))] if k % 3 == 0 else whole)
        for place in rng.integers(0, max(len(content), 1), 5):
            if content:
                content[place] = rng.integers(256)
        path.write_bytes(bytes(content))
        try:
            read_frf_file(path)
        except ls.LoopshapeError:
            continue
