"""One loop in a list is that loop: every public verb gives a scalar loop's numbers, intervals included."""

import json
from dataclasses import replace

import numpy as np
import pytest
from one_loop import LIMITS, RATE, F, S, drawn, same
from run_files import write_controllers, write_frfs, write_matrices

import loopshape as ls
from loopshape.verbs import runs

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
