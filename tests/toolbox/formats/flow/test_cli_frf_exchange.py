"""export and import-frf end to end: a run's FRFs go out, come back, and are fitted, tuned, checked and drawn."""

import json
import shutil

import numpy as np
import pytest
from bench_nouns import TransferFunction
from commands import invoked
from run_files import read_frfs, write_frfs
from scipy.io import savemat

import loopshape as ls

RATE = 500.0
PLANT = TransferFunction([900.0], [1.0, 6.0, 0.0], 0.004)
REQUIRE = """
format = "loopshape-requirements/1"
[[loop]]
name = "axis"
phase_margin_deg = 40.0
sensitivity_peak_db = 6.0
integrators = 1
unstable_poles = 0
structure = [{ kind = "gain", gain = { min = 0.001, max = 1.0 } }]
"""


def loopshape(*words, code=0):
    """Run a command; a refusal must be a sentence of the project's own."""
    done = invoked(words)
    if code == 2:
        assert isinstance(done.exception, ls.LoopshapeError) or done.exit_code == 2
        return str(done.exception)
    assert done.exit_code == code, done.output + repr(done.exception)
    return done.stdout


def measured(recording="r01"):
    rng, f = np.random.default_rng(1), np.geomspace(0.5, 60.0, 80)
    G = PLANT.response(f)
    noise = 0.01 * np.abs(G) * (rng.standard_normal(80) + 1j * rng.standard_normal(80)) / np.sqrt(2.0)
    C = ((0.01 * np.abs(G)) ** 2)[:, None, None].astype(complex)
    return ls.FRF(
        f, (G + noise)[:, None, None], C, np.ones(80, dtype=bool), ("z_v",), ("y_rad",), "made up", recording, "axis",
        RATE, coherence=np.full(80, 0.99),
    )  # fmt: skip


@pytest.fixture
def run(tmp_path):
    write_frfs(tmp_path / "run", [measured(), measured("r02")])
    return tmp_path / "run"


@pytest.mark.long
@pytest.mark.parametrize(("to", "stated"), [("mat", ()), ("csv", ()), ("uff", ("--relative-std", 0.01))])
def test_out_and_back_through_the_whole_chain(run, tmp_path, to, stated):
    told = json.loads(loopshape("export", run, "--to", to, "--json"))
    assert [name.rsplit("/", 1)[1] for name in told["files"]] == [f"r01.axis.{to}", f"r02.axis.{to}"]
    assert bool(told["warnings"]) == (to == "uff")
    back = tmp_path / "back"
    for file in told["files"]:
        loopshape("import-frf", file, "--out", back, *stated, "-q")
    for mine, theirs in zip(read_frfs(back), read_frfs(run), strict=True):
        np.testing.assert_allclose(mine.response, theirs.response, rtol=1e-12)
        np.testing.assert_allclose(mine.covariance, theirs.covariance, rtol=0.1 if to == "uff" else 1e-12)
        assert (mine.recording, mine.loop, mine.rate_hz) == (theirs.recording, theirs.loop, RATE)
    loopshape("fit", back, "--structure", "integrator_delay", "-q")
    (back.parent / "require.toml").write_text(REQUIRE)
    loopshape("tune", back, "--require", tmp_path / "require.toml", "--out", tmp_path / "c.toml", "-q")
    said = loopshape("check", back, tmp_path / "c.toml", "--require", tmp_path / "require.toml")
    assert said.startswith("verdict: pass: ")
    assert json.loads(loopshape("figures", back, "--json"))["figures"]
    loopshape("export", back, "--to", "mat", "-q")
    loopshape("import-frf", told["files"][0], "--out", back, *stated, "-q")  # the same again


def test_a_users_measurement_of_the_continuous_plant_gets_the_hold(tmp_path):
    f = np.geomspace(0.5, 60.0, 60)
    savemat(tmp_path / "bench.mat", {"response": PLANT.response(f), "frequency_hz": f, "coherence": np.full(60, 0.98)})
    words = ("--inputs", "z_v", "--outputs", "y_rad", "--loop", "axis", "--averages", 20)
    file, out = tmp_path / "bench.mat", tmp_path / "run"
    told = json.loads(
        loopshape("import-frf", file, "--out", out, *words, "--rate-hz", RATE, "--hold", "--delay-s", 0.002, "--json")
    )
    assert told["frfs"][0]["loop"] == "axis"
    assert any("zero-order hold at 500 Hz and 0.002 s" in note for note in told["notes"])
    (one,) = read_frfs(out)
    wanted = PLANT.response(f) * np.sinc(f / RATE) * np.exp(-2j * np.pi * f * (0.001 + 0.002))
    np.testing.assert_allclose(one.siso, wanted)
    np.testing.assert_allclose(one.variance[:, 0, 0], np.abs(wanted) ** 2 * 0.02 / (0.98 * 19.0))
    loopshape("fit", out, "--structure", "integrator_delay", "-q")


def test_elements_of_a_matrix_become_loops(tmp_path):
    f = np.arange(1.0, 30.0)
    G = np.stack([[PLANT.response(f), 0.1 * PLANT.response(f)], [0.2 * PLANT.response(f), 2.0 * PLANT.response(f)]])
    savemat(tmp_path / "m.mat", {"response": G, "frequency_hz": f})
    words = ("import-frf", tmp_path / "m.mat", "--relative-std", 0.02, "--inputs", "a_v,b_v", "--outputs", "a_m,b_m")
    whole = invoked([str(w) for w in (*words, "--out", tmp_path / "whole")])
    assert "a_m+b_m has several channels" in whole.stderr
    loopshape(*words, "--out", tmp_path / "run", "--pick", "a_m/a_v", "--pick", "b_m/b_v", "-q")
    a, b = read_frfs(tmp_path / "run")
    assert (a.loop, b.loop, a.inputs) == ("a_m", "b_m", ("a_v",))
    np.testing.assert_allclose(b.siso, 2.0 * PLANT.response(f))
    loopshape("fit", tmp_path / "run", "--structure", "integrator_delay", "-q")
    assert "pick an element" in loopshape("fit", tmp_path / "whole", code=2)
    assert "OUTPUT/INPUT" in loopshape(*words, "--out", tmp_path / "x", "--pick", "a_m", code=2)
    assert "use the names a_m, b_m" in loopshape(*words, "--out", tmp_path / "x", "--pick", "c_m/a_v", code=2)


def test_refusals_are_sentences(run, tmp_path):
    f = np.arange(1.0, 9.0)
    savemat(tmp_path / "m.mat", {"response": np.ones(8) + 0j, "frequency_hz": f})
    (tmp_path / "m.npz").write_bytes(b"x")
    mat, out = tmp_path / "m.mat", tmp_path / "new"
    named = ("--inputs", "z_v", "--outputs", "y_rad", "--relative-std", 0.1)
    for words, said in (
        (("export", run, "--to", "xls"), "use mat, csv, uff"),
        (("export", tmp_path / "none", "--to", "mat"), "does not exist"),
        (("import-frf", mat, "--out", out), "the error of this FRF is not given"),
        (("import-frf", mat, "--out", out, "--relative-std", "-1"), "must not be negative"),
        (("import-frf", mat, "--out", out, "--averages", "20"), "neither covariance nor coherence"),
        (("import-frf", tmp_path / "no.mat", "--out", out, *named), "does not exist"),
        (("import-frf", tmp_path / "m.npz", "--out", out, *named), "use .mat, .csv, .uff, .unv"),
        (("import-frf", mat, "--out", out, *named, "--loop", "../x"), "plain name"),
        (("import-frf", mat, "--out", out, "--relative-std", 0.1, "--inputs", "z"), "must end in its unit"),
        (("import-frf", mat, "--out", out, *named, "--hold"), "a hold is that of a rate"),
        (("import-frf", mat, "--out", out, *named, "--delay-s", 0.1), "a hold is that of a rate"),
        (("import-frf", mat, "--out", out, *named, "--rate-hz", -1), "a rate must not be negative"),
    ):
        assert said in loopshape(*words, code=2), words
    assert not out.exists()


def test_what_stands_in_a_folder_is_not_mixed_up(run, tmp_path):
    f = np.arange(1.0, 9.0)
    savemat(tmp_path / "m.mat", {"response": np.ones(8) + 0j, "frequency_hz": f})
    words = ("import-frf", tmp_path / "m.mat", "--inputs", "z_v", "--outputs", "y_rad", "--relative-std")
    out = tmp_path / "new"
    loopshape(*words, 0.1, "--out", out, "-q")
    assert "another FRF" in loopshape(*words, 0.2, "--out", out, code=2)
    loopshape(*words, 0.2, "--out", out, "--replace", "-q")
    assert read_frfs(out)[0].variance[0, 0, 0] == pytest.approx(0.04)
    assert "folder that is no run" in loopshape(*words, 0.1, "--out", tmp_path, code=2)
    shutil.copytree(out, tmp_path / "real")
    (tmp_path / "real" / "run.toml").write_text('format = "loopshape-run/1"\nrate_hz = 500.0\n')
    assert "others are not mixed in" in loopshape(*words, 0.1, "--out", tmp_path / "real", code=2)


def test_quiet_is_quiet(run, tmp_path):
    assert loopshape("export", run, "--to", "mat", "--out", tmp_path / "o", "--quiet") == ""
    assert loopshape("import-frf", tmp_path / "o" / "r01.axis.mat", "--out", tmp_path / "b", "--quiet") == ""


def test_two_imported_frfs_are_compared(tmp_path):
    """20 log10(1.06) is 0.51 dB: an imported FRF that is 6 % larger, known to 1 %, is another plant's."""
    rng, f = np.random.default_rng(3), np.geomspace(0.5, 60.0, 80)
    for name, gain in (("before", 1.0), ("again", 1.0), ("after", 1.06)):
        G = gain * PLANT.response(f)
        G = G * (1.0 + 0.01 * (rng.standard_normal(80) + 1j * rng.standard_normal(80)) / np.sqrt(2.0))
        np.savetxt(
            tmp_path / f"{name}.csv", np.column_stack([f, G.real, G.imag]), delimiter=",", comments="",
            header="frequency_hz,real,imag",
        )  # fmt: skip
        loopshape(
            "import-frf", tmp_path / f"{name}.csv", "--relative-std", 0.01, "--loop", "axis", "--out", tmp_path / name
        )
    same = json.loads(loopshape("compare", tmp_path / "before", tmp_path / "again", "--json"))
    other = json.loads(loopshape("compare", tmp_path / "before", tmp_path / "after", "--json", code=1))
    assert (same["outcome"], other["outcome"]) == ("confirmed", "refuted")
    assert abs(np.mean([band["sensitivity_db"] for band in other["comparisons"][0]["bands"]]) - 0.51) < 0.05
    assert ls.compare(*(read_frfs(tmp_path / name) for name in ("before", "again")))[0].outcome == "confirmed"
