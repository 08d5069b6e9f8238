"""Recordings of other programs read as the numbers that the format's own library, or its definition, wrote."""

import base64
import json
import os
import runpy
import wave
from pathlib import Path

import h5py
import numpy as np
import pytest
from run_files import CsvShape
from scipy.io import savemat
from scipy.stats import f as f_distribution

import loopshape as ls
from loopshape.toolbox.formats.drafts.draft_map import draft_map
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.sources import Place, open_source

SHARED = Path(os.environ.get("LOOPSHAPE_DATA") or Path(__file__).parents[4] / ".." / "shared" / "data")
T = np.arange(400) / 50.0
X, U = np.sin(T), np.cos(3.0 * T)


def signal(file, name):
    return np.asarray(open_source(file, CsvShape()).signal(Place(name)))


def real(*parts):
    path = SHARED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no {path.name} in ../shared/data: recordings of real machines are not shipped")
    return path


def test_a_scope_s_structure_in_a_mat_file_is_read_by_its_labels(tmp_path):
    """Simulink's structure with time: signals(k).values and signals(k).label."""
    lines = np.zeros(2, dtype=[("values", "O"), ("label", "O"), ("dimensions", "O")])
    lines[0], lines[1] = (X[:, None], "pos", 1), (U[:, None], "drive", 1)
    scope = {"time": T[:, None], "signals": lines, "blockName": "model/Scope"}
    savemat(tmp_path / "a.mat", {"ScopeData": scope, "fs": 50.0}, do_compression=True)
    np.testing.assert_array_equal(signal(tmp_path / "a.mat", "ScopeData.signals.pos.values"), X)
    np.testing.assert_array_equal(signal(tmp_path / "a.mat", "ScopeData.signals.drive.values"), U)


def test_structures_without_labels_are_counted_and_lie_within_each_other(tmp_path):
    lines = np.zeros(2, dtype=[("Data", "O")])
    lines[0], lines[1] = (X,), (U,)
    savemat(tmp_path / "a.mat", {"exp": {"X": {"Data": T}, "Y": lines, "note": "text"}})
    np.testing.assert_array_equal(signal(tmp_path / "a.mat", "exp.X.Data"), T)
    np.testing.assert_array_equal(signal(tmp_path / "a.mat", "exp.Y(2).Data"), U)


def test_structures_of_v7_3_are_read_and_links_out_of_the_file_are_not(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = X
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["log/inner/u"] = U[:, None]
        file["log/out"] = h5py.ExternalLink("other.h5", "secret")
        file["log/again"] = h5py.SoftLink("/log")
    assert open_source(tmp_path / "a.mat", CsvShape()).names == ("log.inner.u",)
    np.testing.assert_array_equal(signal(tmp_path / "a.mat", "log.inner.u"), U)


def test_json_of_arrays_and_of_rows(tmp_path):
    told = {"fs": 50, "signals": {"pos": X.tolist(), "drive": [None, *U[1:].tolist()]}, "name": "run 3"}
    (tmp_path / "a.json").write_text(json.dumps(told))
    np.testing.assert_array_equal(signal(tmp_path / "a.json", "signals.pos"), X)
    assert np.isnan(signal(tmp_path / "a.json", "signals.drive")[0])
    (tmp_path / "b.json").write_text(json.dumps({"rows": [{"t": t, "x": x} for t, x in zip(T, X, strict=True)]}))
    np.testing.assert_array_equal(signal(tmp_path / "b.json", "rows.x"), X)
    for text, word in (("{", "cannot be read as JSON"), ('{"a": "b"}', "no list of numbers"), ("[" * 10**5, "JSON")):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(ls.errors.UnreadableInputError, match=word):
            signal(tmp_path / "c.json", "a")


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_wav_of_every_width_is_a_share_of_full_scale(width, tmp_path):
    whole = np.round(0.9 * np.stack([X, U], axis=1) * 2 ** (8 * width - 1)).astype(np.int64)
    raw = (whole + 128 * (width == 1)).astype("<i8").view(np.uint8).reshape(-1, 8)[:, :width]
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(width)
        file.setframerate(50)
        file.writeframes(raw.tobytes())
    np.testing.assert_array_equal(signal(tmp_path / "a.wav", "channel 2"), whole[:, 1] / 2.0 ** (8 * width - 1))
    assert draft_map(tmp_path / "a.wav").rate_hz == 50.0
    (tmp_path / "b.wav").write_bytes((tmp_path / "a.wav").read_bytes()[:100])
    with pytest.raises(ls.errors.UnreadableInputError, match="WAV"):
        signal(tmp_path / "b.wav", "channel 1")


def test_tdms_as_nptdms_writes_it(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    step = {"wf_increment": 0.02}
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as file:
        file.write_segment(
            [
                nptdms.ChannelObject("axis", "pos", X, properties=step),
                nptdms.ChannelObject("axis", "drive", (1000 * U).astype(np.int16), properties=step),
                nptdms.ChannelObject("axis", "remark", ["a", "b"]),
            ]
        )
    np.testing.assert_array_equal(signal(tmp_path / "a.tdms", "axis/pos"), X)
    np.testing.assert_array_equal(signal(tmp_path / "a.tdms", "axis/drive"), (1000 * U).astype(np.int16))
    assert draft_map(tmp_path / "a.tdms").rate_hz == 50.0
    (tmp_path / "b.tdms").write_bytes(b"TDSm" + bytes(60))
    with pytest.raises(ls.LoopshapeError, match=r"TDMS|no signals"):
        draft_map(tmp_path / "b.tdms")


def test_columns_with_stamps_of_their_own_come_to_one_rate_and_the_cost_is_said(tmp_path):
    slow = T[::5]
    np.savez(tmp_path / "a.npz", t=T, u=U, t_slow=slow, x=2.0 * slow)
    (tmp_path / "m.toml").write_text(
        'format = "loopshape-map/1"\nrate_hz = 50.0\ntime = { from = "t", unit = "s" }\n[columns]\n'
        'u_v = { from = "u", unit = "V" }\nx_m = { from = "x", unit = "m", time = "t_slow" }\n'
        '[[loop]]\nname = "a"\ncontrol = "u_v"\noutput = "x_m"\n[recording]\nkind = "noise"\ninjection = "control"\n'
    )
    run = import_file(tmp_path / "a.npz", tmp_path / "m.toml")
    inside = slow[-1] >= T
    np.testing.assert_allclose(run.recordings[0].column("x_m")[inside], 2.0 * T[inside], atol=1e-12)
    assert any("own 10 Hz" in note and "delay" in note for note in run.extra["notes"])


def test_a_flight_log_without_excitation_is_an_open_question():
    pytest.importorskip("pyulog")
    draft = draft_map(real("px4", "sample_log_small.ulg"))
    assert draft.roles == {
        "vehicle_rates_setpoint.roll": "reference", "actuator_controls_0.control[0]": "control",
        "vehicle_angular_velocity.xyz[0]": "output",
    }  # fmt: skip
    (question,) = draft.open
    assert "no response can be identified" in question
    assert "sweep or multisine" in question


def test_a_ulog_as_pyulog_reads_it(tmp_path):
    pyulog = pytest.importorskip("pyulog")
    file = real("px4", "sample_log_small.ulg")
    topic = pyulog.ULog(str(file)).get_dataset("vehicle_angular_velocity").data
    np.testing.assert_array_equal(signal(file, "vehicle_angular_velocity.xyz[1]"), topic["xyz[1]"])
    stamps = signal(file, "time of vehicle_angular_velocity")
    np.testing.assert_allclose(np.diff(stamps), 1e-6 * np.diff(topic["timestamp"].astype(float)), atol=1e-9)
    (tmp_path / "a.ulg").write_bytes(file.read_bytes()[:10])
    with pytest.raises(ls.errors.UnreadableInputError, match="ULog"):
        signal(tmp_path / "a.ulg", "x")


def array(kind, values):
    dims = "".join(f"<Dim>{n}</Dim>" for n in values.shape)
    text = base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
    return f'<Array Type="{kind}">{dims}<Stream Encoding="LittleEndian,base64">{text}</Stream></Array>'


def result(k, subtype, others, body):
    words = {"Subtype": subtype, "f0": 0, "df": 0.5, "Window": 1, "Averages": 5, "N": 20, "ChannelA": "K1:EXC"}
    words |= {f"ChannelB[{j + 1}]": name for j, name in enumerate(others)}
    text = "".join(f'<Param Name="{name}">{value}</Param>' for name, value in words.items())
    return f'<LIGO_LW Name="Result[{k}]" Type="Spectrum">{text}{body}</LIGO_LW>'


def diagnostics(H, gamma2):
    """A file of a test whose channels answer with H (2, 20): density a, cross-spectra A B* = a² conj(H)."""
    a, others = np.full(20, 3.0, "<f4"), ["K1:Y-ONE", "K1:Y-TWO"]
    cross = (9.0 * np.conj(H)).astype("<c8")
    test = (
        '<Param Name="StimulusChannel[0]">K1:EXC</Param><Param Name="Overlap">0.5</Param><Param Name="Window">1</Param>'
    )
    parts = [
        f'<LIGO_LW Name="Test" Type="TestParameter">{test}</LIGO_LW>', result(0, 1, [], array("float", a)),
        result(1, 2, others, array("floatComplex", cross)),
        result(2, 3, others, array("float", np.tile(gamma2, (2, 1)).astype("<f4"))),
    ]  # fmt: skip
    return f'<?xml version="1.0"?><LIGO_LW Name="Diagnostics Test">{"".join(parts)}</LIGO_LW>'


def test_a_diagnostics_test_gives_responses_and_their_error(tmp_path):
    f = 0.5 * np.arange(20)
    H = np.stack([1.0 / (1.0 + 1j * f), 0.1 * np.exp(-0.3j * f)])
    (tmp_path / "a.xml").write_text(diagnostics(H, np.full(20, 0.8)))
    P = ls.formats.read_frf(tmp_path / "a.xml")
    assert (P.outputs, P.inputs) == (("K1_Y_ONE_1", "K1_Y_TWO_1"), ("K1_EXC_1",))
    np.testing.assert_allclose(P.response[:, :, 0], H.T[1:], rtol=1e-6)
    averages = 5.0 / (1.0 + 2.0 / 36.0 * (1.0 - 1.0 / 5.0))
    np.testing.assert_allclose(P.variance[:, 0, 0], np.abs(H[0, 1:]) ** 2 * 0.25 / (averages - 1.0), rtol=1e-5)


def test_xml_that_is_no_diagnostics_file_or_grows_is_refused(tmp_path):
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><LIGO_LW>&b;</LIGO_LW>'
    for text, word in ((bomb, "entities"), ("<html/>", "LIGO_LW"), ("<LIGO_LW>", "XML"), ("<LIGO_LW/>", "excitation")):
        (tmp_path / "a.xml").write_text(text)
        with pytest.raises(ls.errors.UnreadableInputError, match=word):
            ls.formats.read_frf(tmp_path / "a.xml")


def test_intervals_of_five_averages_cover_kagra_s_scatter_between_lines():
    """Where |H| is smooth, a line off the mean of its neighbours two bandwidths away is noise: F(2, 2 (K - 1))."""
    inside = []
    for name in ("TML", "TMP"):
        P = ls.formats.read_frf(real("kagra", f"BS_{name}_exc_20200730a.xml"))
        assert len(P.outputs) == 12
        for j in [j for j, output in enumerate(P.outputs) if "OPLEV_PIT" in output or "OPLEV_YAW" in output]:
            smooth = P.frequency_hz > 3.0
            H, v = P.response[smooth, j, 0], P.variance[smooth, j, 0]
            d = H[4:-4] - 0.5 * (H[:-8] + H[8:])
            inside.append(np.abs(d) ** 2 / (v[4:-4] + 0.25 * (v[:-8] + v[8:])))
    for share in (0.5, 0.95):
        limit = f_distribution.ppf(share, 2.0, 2.0 * (P.averages - 1.0))
        assert (
            abs(float(np.mean(np.concatenate(inside) < limit)) - share) < 0.05
        )  # 4 x 889 lines, of which a third count


def test_a_repeat_92_minutes_later_lies_within_the_intervals_of_five_averages():
    """KAGRA's crew measured twice; under a Hann window one line in 1.94 is worth one, and three sigma are allowed."""
    first = ls.formats.read_frf(real("kagra", "BS_TML_exc_20200730a.xml"))
    pairs = runpy.run_path(str(Path(__file__).parents[4] / "experiments" / "kagra" / "run.py"))["measured_twice"](first)
    lines = [one.frequency_hz.size for one in pairs]
    assert lines == [144, 162, 162]
    for share in (0.5, 0.95):
        found = float(np.average([one.within(share) for one in pairs], weights=lines))
        assert abs(found - share) < 3.0 * np.sqrt(share * (1.0 - share) * first.line_overlap / sum(lines))
