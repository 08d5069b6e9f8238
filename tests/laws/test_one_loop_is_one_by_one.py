"""One loop in a list is that loop: every public verb gives a scalar loop's numbers, intervals included."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from conversions import TWO_PI
from run_files import write_controllers, write_frfs, write_matrices

import loopshape as ls
from loopshape.verbs import runs

RATE = 1000.0
F = np.geomspace(0.5, 200.0, 160)
S = 1j * TWO_PI * F
LIMITS = {"phase_margin_deg": 40.0, "sensitivity_peak_db": 6.0, "disk_margin": 0.7, "bandwidth_hz": 3.0}


def drawn(seed):
    """A lag with a resonance and delay, measured with noise; a controller; integrators and unstable poles."""
    rng = np.random.default_rng(seed)
    k, order, w = float(rng.uniform(5.0, 40.0)), int(rng.integers(0, 2)), TWO_PI * float(rng.uniform(30.0, 90.0))
    G = k / (S if order else S + 3.0) * w**2 / (S**2 + 0.1 * w * S + w**2) * np.exp(-0.002 * S)
    std = float(rng.uniform(0.002, 0.03))
    noise = rng.standard_normal((2, F.size)) / 2**0.5
    P = ls.FRF.from_arrays(F, G * (1.0 + std * (noise[0] + 1j * noise[1])), relative_std=std, rate_hz=RATE, loop="x")
    C = ls.controller(ls.gain(float(rng.uniform(0.3, 1.5))), ls.lead_lag(5.0, 40.0), rate_hz=RATE, loop="x")
    return P, C, ls.Requirements("x", **LIMITS, integrators=order, unstable_poles=0)


def same(one, other, where=""):
    """Equal to 1e-12, whatever is nested in what."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key, value in one.items():
            same(value, other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for k, pair in enumerate(zip(one, other, strict=True)):
            same(*pair, f"{where}[{k}]")
    elif isinstance(one, float):
        assert other == pytest.approx(one, rel=1e-12, abs=1e-300, nan_ok=True), where
    else:
        assert one == other, where


CASES = pytest.mark.parametrize("seed", range(8))


@CASES
def test_check(seed):
    P, C, R = drawn(seed)
    one = ls.check(P, C, R).to_dict()
    assert any(m["intervals"] for m in one["margins"].values())
    same(one, ls.check([P], [C], [R]).to_dict())
    same(one, ls.check(P, [C], R, loops=["x"]).to_dict())
    poles = {"integrators": R.integrators, "unstable_poles": 0}
    bare = replace(R, integrators=None, unstable_poles=None)
    same(one, ls.check(P, [C], [bare], together=ls.Requirements(**poles)).to_dict())
    less = replace(R, disk_margin=None, sensitivity_peak_db=9.0)
    both = ls.Requirements(disk_margin=0.7, sensitivity_peak_db=6.0)
    same(one, ls.check(P, C, less, together=both).to_dict())


@CASES
def test_a_loop_of_a_matrix_with_the_others_open_is_that_loop(seed):
    P, C, R = drawn(seed)
    G = np.zeros((F.size, 2, 2), dtype=complex)
    G[:, 0, 0], G[:, 0, 1], G[:, 1, 1] = P.siso, 0.3 * P.siso, 2.0 / S
    covariance = np.zeros((F.size, 4, 4), dtype=complex)
    covariance[:, 0, 0] = P.variance[:, 0, 0]
    covariance[:, 3, 3] = 1e-4
    valid = np.ones(F.size, dtype=bool)
    names = ("u_v", "w_v"), ("x_m", "y_m")
    M = ls.FRF(F, G, covariance, valid, *names, "drawn", P.recording, "x+y", RATE)
    same(ls.check(P, C, R).to_dict(), ls.check(M, [C, replace(C, loop="y")], [R], loops=["x"]).to_dict())


@CASES
def test_loop(seed):
    P, C, _ = drawn(seed)
    one, listed = ls.Loop(P, C), ls.Loop(P, [C])
    for name in ("C", "L", "S", "T", "CS", "PS"):
        np.testing.assert_allclose(getattr(listed, name), getattr(one, name), rtol=1e-12)
    for name in ("open_loop", "sensitivity", "complementary", "process", "control"):
        frf = getattr(listed, name)
        np.testing.assert_allclose(frf.response, getattr(one, name).response, rtol=1e-12)
        np.testing.assert_allclose(frf.covariance, getattr(one, name).covariance, rtol=1e-12)
    np.testing.assert_allclose(listed.L_i[:, 0, 0], one.L, rtol=1e-12)
    np.testing.assert_allclose(listed.determinant, 1.0 + one.L, rtol=1e-12)


@CASES
def test_predict(seed):
    P, C, _ = drawn(seed)
    (one,), (listed,) = ls.predict(P, C), ls.predict([P], [C])
    same(one.to_dict(), listed.to_dict())
    np.testing.assert_allclose(listed.sensitivity.response, one.sensitivity.response, rtol=1e-12)
    np.testing.assert_allclose(listed.sensitivity.covariance, one.sensitivity.covariance, rtol=1e-12)


def test_tune():
    P, C, R = drawn(3)
    structure = [ls.gain(), ls.lead_lag()]
    one = ls.tune(P, R, structure, starts=2)
    same(one.to_dict(), ls.tune([P], [R], structure, starts=2).to_dict())
    begun = ls.tune(P, R, structure, start=C, starts=1)
    same(begun.to_dict(), ls.tune(P, [R], structure, start=[C], starts=1).to_dict())


def test_the_command(tmp_path):
    P, C, R = drawn(1)
    P = replace(P, recording="one")
    write_frfs(tmp_path / "single", [P])
    write_matrices(tmp_path / "matrix", [P])
    write_controllers(tmp_path / "c.toml", [C])
    limits = "\n".join(f"{name} = {value}" for name, value in LIMITS.items())
    loop = f'[[loop]]\nname = "x"\n{limits}\n'
    poles = f"integrators = {R.integrators}\nunstable_poles = 0\n"
    head = 'format = "loopshape-requirements/1"\n'
    (tmp_path / "r.toml").write_text(f"{head}{loop}{poles}")
    (tmp_path / "all.toml").write_text(f"{head}{loop}[several]\n{poles}")
    (one,) = runs.check(tmp_path / "single", tmp_path / "c.toml", tmp_path / "r.toml").checks.verdicts
    (matrix,) = runs.check(tmp_path / "matrix", tmp_path / "c.toml", tmp_path / "all.toml").checks.verdicts
    same(json.loads(json.dumps(one.to_dict())), json.loads(json.dumps(matrix.to_dict())))
    same(one.to_dict(), ls.check(P, C, R).to_dict())


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
