"""FRFs go out to MATLAB, tables, universal files and python-control, and come back the same."""

import csv
import json
from dataclasses import replace

import control
import h5py
import numpy as np
import pytest
from bench_nouns import Block
from scipy.io import loadmat, savemat

import loopshape as ls
from loopshape.io.write.frf_csv import frf_csv
from loopshape.io.write.frf_words import PERHAPS, frf_header
from loopshape.toolbox.formats.frf.frf_exchange import FORMATS, export_frfs, read_frf_file
from loopshape.toolbox.formats.frf.frf_foreign import Stated
from loopshape.toolbox.formats.frf.frf_mat import write_frf_mat
from loopshape.toolbox.formats.frf.frf_uff import write_frf_uff


def frf(ny=2, nu=2, nf=6, **words):
    rng = np.random.default_rng(3)
    n = ny * nu
    root = rng.standard_normal((nf, n, n)) + 1j * rng.standard_normal((nf, n, n))
    G = rng.standard_normal((nf, ny, nu)) + 1j * rng.standard_normal((nf, ny, nu))
    C = 1e-4 * root @ root.conj().transpose(0, 2, 1)
    f = np.array([0.1, 1 / 3, 1.0, 2.0, 5.0, 12.3456789012])[:nf]
    most = {
        "recording": "r01",
        "loop": "theta2",
        "rate_hz": 1000.0,
        "operating_point": {"theta2_deg": 10.0},
        "parameters": {"supply_bar": 1.25},
        "notes": ("first, °C", "second"),
        "averages": 12.0,
        "method_numbers": {"sweep_s": 202.5, "rationals_percent": 41.0},
        "variance_freedom": 22.0,
        "line_overlap": 1.94,
        "recorded_under": ls.Controller("theta2", (Block("gain", {"gain": 0.5}),), 1000.0),
    }
    return ls.FRF(
        f, G, C, np.arange(nf) % 2 == 0, tuple(f"z{k}_v" for k in range(nu)), tuple(f"y{k}_rad" for k in range(ny)),
        "local polynomial", **(most | words),
    )  # fmt: skip


def assert_response(one, two, rtol=1e-12):
    np.testing.assert_allclose(one.frequency_hz, two.frequency_hz, rtol=rtol)
    np.testing.assert_allclose(one.response, two.response, rtol=rtol, atol=0)


def assert_covariance(one, two):
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-12, atol=1e-12 * np.abs(two.covariance).max())


def assert_words(one, two):
    mine, theirs = frf_header(one), frf_header(two)
    assert {**mine, "notes": []} == {**theirs, "notes": []}
    assert tuple(theirs["notes"]) == tuple(mine["notes"][: len(theirs["notes"])])  # an import adds its own


SIZES = [(1, 1, 6), (2, 2, 6), (2, 3, 6), (3, 1, 2), (1, 1, 1), (2, 2, 1)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("to", ["mat", "csv"])
def test_mat_and_csv_keep_response_and_covariance(tmp_path, size, to):
    made = frf(*size)
    before = made.response.copy(), made.covariance.copy()
    (path,), lost = export_frfs([made], to, tmp_path)
    assert (path.name, lost) == (f"r01.theta2.{to}", ())
    back = read_frf_file(path)
    assert_response(back, made)
    assert_covariance(back, made)
    assert_words(back, made)
    np.testing.assert_array_equal(back.valid, made.valid)
    np.testing.assert_array_equal(made.response, before[0])
    np.testing.assert_array_equal(made.covariance, before[1])


@pytest.mark.short
@pytest.mark.parametrize("size", [(1, 1, 6), (2, 3, 6), (2, 2, 1)])
def test_mat_keeps_every_array(tmp_path, size):
    ny, nu, nf = size
    rng, made = np.random.default_rng(1), frf(*size)
    more = {name: rng.random(nf) for name in ("coherence", "input_power", "output_power")}
    more |= {"cross_power": rng.random(nf) * 1j, "noise_covariance": 0.5 * made.covariance}
    more |= {"multiple_coherence": rng.random((nf, ny)), "partial_coherence": rng.random((nf, ny, nu))}
    made = replace(made, **more)
    write_frf_mat(tmp_path / "a.mat", made)
    back = read_frf_file(tmp_path / "a.mat")
    for name in PERHAPS:
        np.testing.assert_array_equal(getattr(back, name), getattr(made, name), err_msg=name)
    _, lost = export_frfs([made], "csv", tmp_path)
    assert "noise_covariance" in lost[0]


def test_matlab_sees_outputs_inputs_lines_and_names(tmp_path):
    made = replace(frf(2, 3), coherence=np.full(6, 0.9))
    write_frf_mat(tmp_path / "a.mat", made)
    seen = loadmat(tmp_path / "a.mat")
    assert seen["response"].shape == (2, 3, 6)
    assert seen["response"][1, 2, 4] == made.response[4, 1, 2]
    assert seen["covariance"].shape == (6, 6, 6)
    assert seen["frequency_hz"].shape == seen["coherence"].shape == seen["valid"].shape == (6, 1)
    assert [str(cell[0]) for cell in seen["inputs"][:, 0]] == ["z0_v", "z1_v", "z2_v"]
    assert seen["method"][0] == "local polynomial"
    # covariance is that of response(:): columns stacked, as MATLAB stacks them
    vec = seen["response"][:, :, 4].ravel(order="F")
    np.testing.assert_array_equal(vec, made.response[4].ravel(order="F"))


@pytest.mark.parametrize("compressed", [False, True])
def test_a_users_own_mat_file(tmp_path, compressed):
    f, G = np.arange(1.0, 9.0), np.exp(1j * np.arange(8.0))
    path, stated = tmp_path / "mine.mat", Stated(relative_std=0.05, inputs=("u_v",), outputs=("y_m",), loop="axis")
    for response in (G, G[:, None], G[None, :], G[None, None, :]):
        savemat(path, {"response": response, "frequency": f}, do_compression=compressed)
        back = read_frf_file(path, stated)
        np.testing.assert_array_equal(back.siso, G)
        np.testing.assert_allclose(back.variance[:, 0, 0], 0.0025)
        assert (back.recording, back.loop, back.inputs) == ("mine", "axis", ("u_v",))
        assert "frequency was taken to be in Hz: frequency_unit says otherwise" in back.notes
        assert back.valid.all()
    savemat(path, {"response": G, "frequency": f, "frequency_unit": "rad/s"})
    np.testing.assert_allclose(read_frf_file(path, stated).frequency_hz, f / (2 * np.pi))
    savemat(path, {"response": G, "omega_rad_s": f, "std": np.full(8, 0.1), "inputs": "u_v", "averages": 7.0})
    back = read_frf_file(path)
    np.testing.assert_allclose(back.variance[:, 0, 0], 0.01)
    assert (back.inputs, back.outputs, back.averages) == (("u_v",), ("y1_1",), 7.0)
    assert "the outputs have no names: called y1_1, without a unit" in back.notes


@pytest.mark.short
def test_a_users_own_mat_file_of_version_7_3(tmp_path):
    G = np.arange(24.0).reshape(2, 3, 4) * (1 + 2j)
    pair = np.dtype([("real", "f8"), ("imag", "f8")])
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["response"] = np.array([(x.real, x.imag) for x in G.T.ravel()], dtype=pair).reshape(4, 3, 2)
        file["frequency_hz"] = np.arange(1.0, 5.0)[None, :]
    back = read_frf_file(tmp_path / "a.mat", Stated(relative_std=0.1))
    np.testing.assert_array_equal(back.response, np.moveaxis(G, -1, 0))


def test_an_analysers_coherence_gives_the_error_with_the_averages():
    """The stated rule against Welch averages of a known noise."""
    from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF, frf_of

    rng, K, runs = np.random.default_rng(0), 16, 4000
    u = rng.standard_normal((runs, K)) + 1j * rng.standard_normal((runs, K))
    y = 2.0 * u + 0.8 * (rng.standard_normal((runs, K)) + 1j * rng.standard_normal((runs, K)))
    uu, yy, yu = (np.abs(u) ** 2).mean(1), (np.abs(y) ** 2).mean(1), (y * u.conj()).mean(1)
    G, g2 = yu / uu, np.abs(yu) ** 2 / (uu * yy)
    f = np.arange(1.0, runs + 1.0)
    found = ForeignFRF("here", f, G[:, None, None], element_coherence=g2[:, None, None])
    made = frf_of(found, Stated(averages=K))
    assert made.variance.mean() == pytest.approx(np.mean(np.abs(G - 2.0) ** 2), rel=0.05)
    assert (made.averages, made.variance_freedom) == (16.0, 30.0)
    np.testing.assert_array_equal(made.coherence, g2)


def test_lines_at_zero_are_left_out_with_a_note(tmp_path):
    savemat(tmp_path / "a.mat", {"response": np.append(np.nan, np.ones(4)), "frequency_hz": np.arange(5.0)})
    back = read_frf_file(tmp_path / "a.mat", Stated(relative_std=0.1))
    assert back.frequency_hz.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert "the value at 0 Hz was left out" in back.notes


def test_a_table_without_words(tmp_path):
    made = replace(frf(), coherence=None)
    frf_csv(tmp_path / "bare.csv", made)
    with (tmp_path / "bare.csv").open(newline="") as file:
        head = next(csv.reader(file))
    assert {"cov_re_2_1", "cov_im_4_3"} <= set(head)
    back = read_frf_file(tmp_path / "bare.csv", Stated(inputs=made.inputs, outputs=made.outputs))
    assert_response(back, made)
    assert_covariance(back, made)
    (tmp_path / "least.csv").write_text("frequency_hz, re, im\n1, 1, 0\n2, 0, -1\n3, -0.5, 0\n")
    back = read_frf_file(tmp_path / "least.csv", Stated(relative_std=0.02))
    assert back.siso.tolist() == [1.0, -1j, -0.5]


@pytest.mark.short
@pytest.mark.parametrize("size", [(1, 1, 6), (2, 2, 6), (3, 1, 6)])
def test_universal_files_keep_the_response_and_say_what_they_lose(tmp_path, size):
    made = frf(*size)
    if size == (1, 1, 6):
        made = replace(made, coherence=np.linspace(0.5, 0.9, 6))
    if size == (3, 1, 6):
        made = replace(made, multiple_coherence=np.linspace(0.5, 0.9, 18).reshape(6, 3))
    lost = write_frf_uff(tmp_path / "a.uff", made)
    assert "a universal file holds no covariance" in lost[0]
    stated = Stated(relative_std=0.1) if size == (2, 2, 6) else None
    back = read_frf_file(tmp_path / "a.uff", stated)
    assert_response(back, made)
    for name in ("inputs", "outputs", "recording", "loop", "rate_hz", "averages", "coherence", "multiple_coherence"):
        np.testing.assert_array_equal(getattr(back, name), getattr(made, name))
    if size == (1, 1, 6):
        g2 = made.coherence
        np.testing.assert_allclose(back.variance[:, 0, 0], np.abs(made.siso) ** 2 * (1 - g2) / (g2 * 11.0))


def test_a_universal_file_of_an_analyser(tmp_path):
    """Text, even spacing from 0 Hz, single precision, nodes and directions, a function of another kind."""
    import pyuff

    f, G = np.arange(0.0, 10.0), np.exp(-0.3j * np.arange(10.0))
    base = {"type": 58, "binary": 0, "x": f, "abscissa_spacing": 1, "abscissa_spec_data_type": 18, "load_case_id": 0}
    base |= {"ref_node": 1, "ref_dir": 3, "orddenom_spec_data_type": 13, "id1": "hammer test", "ver_num": 0}
    sets = [
        base | {"func_type": 4, "rsp_node": node, "rsp_dir": way, "data": G * node, "ord_data_type": 5}
        for node, way in ((1, 3), (2, -3))
    ]
    sets.append(base | {"func_type": 2, "rsp_node": 1, "rsp_dir": 3, "data": np.abs(G), "ord_data_type": 2})
    pyuff.UFF(str(tmp_path / "a.unv")).write_sets(sets, mode="overwrite", force_double=False)
    back = read_frf_file(tmp_path / "a.unv", Stated(relative_std=0.05))
    np.testing.assert_allclose(back.response[:, :, 0], np.outer(G[1:], [1.0, 2.0]), rtol=1e-5)
    assert (back.outputs, back.inputs) == (("y1_z_1", "y2_minus_z_1"), ("u1_z_1",))
    assert back.method == "hammer test"
    assert any("1 functions of a.unv are neither FRF nor coherence" in note for note in back.notes)


def test_the_head_of_a_binary_universal_file_counts_its_bytes(tmp_path):
    write_frf_uff(tmp_path / "a.uff", replace(frf(1, 1), coherence=np.full(6, 0.5)))
    raw = (tmp_path / "a.uff").read_bytes()
    heads = [line.split() for line in raw.split(b"\n") if line.startswith(b"    58b")]
    assert [(head[2], head[3], head[4]) for head in heads] == [(b"2", b"11", b"144"), (b"2", b"11", b"96")]


@pytest.mark.short
def test_python_control_and_back():
    made = frf(2, 3)
    frd = ls.to_control(made)
    assert frd.frdata.shape == (2, 3, 6)
    np.testing.assert_allclose(frd.omega, 2 * np.pi * made.frequency_hz)
    assert (frd.dt, frd.input_labels) == (1e-3, list(made.inputs))
    back = ls.from_control(frd, covariance=made.covariance, recording="r01", loop="theta2")
    assert_response(back, made)
    assert_covariance(back, made)
    assert (back.inputs, back.outputs, back.rate_hz) == (made.inputs, made.outputs, pytest.approx(1000.0))
    frd.frdata[0, 0, 0] = 99.0
    assert back.response[0, 0, 0] != 99.0 != made.response[0, 0, 0]


@pytest.mark.short
def test_a_model_of_python_control_has_no_error():
    plant = control.tf([1.0], [1.0, 0.4, 1.0])
    made = ls.from_control(control.frd(plant, np.geomspace(0.1, 10.0, 30)), relative_std=0.0, outputs=("y_m",))
    assert not made.covariance.any()
    assert made.rate_hz == 0.0
    f = made.frequency_hz
    np.testing.assert_allclose(made.siso, plant(2j * np.pi * f))


def test_an_export_is_whole_or_not_at_all(tmp_path):
    good, bad = frf(1, 1), frf(1, 1, recording="r" * 60 + "0" * 30)
    (tmp_path / "r01.theta2.uff").write_text("old")
    with pytest.raises(Exception, match="80 plain letters"):
        export_frfs([good, bad], "uff", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["r01.theta2.uff"]
    assert (tmp_path / "r01.theta2.uff").read_text() == "old"
    paths, _ = export_frfs([good, replace(good, recording="r02")], "uff", tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(p.name for p in paths)


def test_every_format_is_documented():
    from pathlib import Path

    docs = Path(__file__).parents[4] / "docs"
    text = (docs / "frf_files.md").read_text() + (docs / "files.md").read_text()
    for kind in FORMATS.values():
        assert kind.ending in text
    header = json.loads(json.dumps(frf_header(frf())))
    assert all(f"`{word}`" in text or word in text for word in header)


@pytest.mark.parametrize(
    ("word", "per_hz"), [("hz", 1.0), ("freq", 1.0), ("f", 1.0), ("w", 2 * np.pi), ("omega", 2 * np.pi)]
)
def test_a_mat_file_in_other_words_is_taken_with_a_note(tmp_path, word, per_hz):
    f_hz = np.geomspace(1.0, 100.0, 50)
    H = 1.0 / (1.0 + 1j * f_hz / 10.0)
    savemat(tmp_path / "a.mat", {word: per_hz * f_hz, "fresp": H, "coh": np.ones(50)})
    found = read_frf_file(tmp_path / "a.mat", Stated(relative_std=0.01))
    np.testing.assert_allclose(found.frequency_hz, f_hz, rtol=1e-12)
    np.testing.assert_allclose(found.response[:, 0, 0], H, rtol=1e-12)
    assert any(f"taken from {word}" in note for note in found.notes)
    assert any("response was taken from fresp" in note for note in found.notes)


def test_two_complex_variables_are_no_response(tmp_path):
    savemat(tmp_path / "a.mat", {"hz": np.arange(1.0, 9.0), "a": 1j * np.ones(8), "b": 1j * np.ones(8)})
    with pytest.raises(ls.errors.UnreadableInputError, match="holds no response"):
        read_frf_file(tmp_path / "a.mat", Stated(relative_std=0.01))


def test_a_controller_becomes_its_tustin_sections_in_python_control() -> None:
    rate, f = 1000.0, np.geomspace(0.5, 400.0, 40)
    made = ls.to_control(
        ls.controller(
            ls.gain(3.0), ls.lead_lag(8.0, 90.0), ls.notch(40.0, 0.05, 0.6), ls.pi(0.5), rate_hz=rate,
            computation_delay_s=0.002,
        )
    )  # fmt: skip
    z = np.exp(2j * np.pi * f / rate)
    s, w = 2.0 * rate * (z - 1.0) / (z + 1.0), 2.0 * np.pi * 40.0
    by_hand = 3.0 * (1.0 + s / (2 * np.pi * 8.0)) / (1.0 + s / (2 * np.pi * 90.0)) * (s + np.pi) / s / z**2
    by_hand *= (s * s + 0.1 * w * s + w * w) / (s * s + 1.2 * w * s + w * w)
    assert made.dt == 1.0 / rate
    assert made(z) == pytest.approx(by_hand, rel=1e-9)
    with pytest.raises(ls.errors.WrongUseError, match="whole samples of delay"):
        ls.to_control(ls.controller(ls.gain(1.0), rate_hz=rate, computation_delay_s=0.0004))


def test_a_model_of_python_control_is_fitted_and_its_default_names_serve() -> None:
    P = ls.FRF.from_control(
        control.tf([900.0], [1.0, 8.0, 0.0]), np.geomspace(0.2, 400.0, 250), relative_std=0.01, rate_hz=2000.0
    )
    found = ls.fit(P, "rational", numerator=0, denominator=2, integrators=1)
    assert found.model.num[-1] == pytest.approx(900.0, rel=1e-6)
    assert found.model.den[1] == pytest.approx(8.0, rel=1e-6)
    assert found.sufficient
    assert "nothing but noise" in repr(found)
    assert ls.fit(P, "third_order")["kappa"].unit.endswith("s3)")


def test_run_frf_controller_and_requirements_agree_without_names() -> None:
    C = ls.controller(ls.gain(0.2), rate_hz=1000.0)
    f_hz = np.geomspace(0.5, 200.0, 100)
    P = ls.FRF.from_arrays(f_hz, 10.0 / (2j * np.pi * f_hz), relative_std=0.01, rate_hz=1000.0)
    n = np.random.default_rng(1).standard_normal((2, 5000))
    quiet = ls.Run.from_arrays(u=n[0], y=n[1], reference=0.0 * n[0], rate_hz=1000.0, controller=C)
    R = ls.Requirements(error_rms=2.0, integrators=1, unstable_poles=0)
    assert np.isfinite(ls.check(P, C, R, disturbance=quiet).margins["frf 1"].error_rms)
