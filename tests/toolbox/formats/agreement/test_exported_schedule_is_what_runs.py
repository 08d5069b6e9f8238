"""A schedule exported as C99 and as JSON answers as the one that runs here, while the operating point moves."""

import ctypes
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.schedules import gain_scheduled, kernel

DRIVER = """
#include "controller_theta.h"
void run(int n, const double *e, const double *at, double *out)
{
    controller_theta_state state;
    int k;
    controller_theta_reset(&state);
    for (k = 0; k < n; k++) {
        out[k] = controller_theta_step(&state, e[k], at + 2 * k);
    }
}
"""


def node(gain: float, f_hz: float) -> ls.Controller:
    blocks = (ls.pi(0.3), ls.gain(gain), ls.notch(f_hz, 0.05, 2.0), ls.lead_lag(1.0, 3.0 * f_hz))
    return ls.controller(*blocks, rate_hz=1000.0, loop="theta")


@pytest.fixture
def moving() -> tuple[ls.schedules.GainScheduled, np.ndarray, np.ndarray, np.ndarray]:
    """A schedule over two variables, errors, where the operating point is, and what it answers."""
    points = [{"theta_deg": t, "p_bar": p} for t in (-30.0, 0.0, 30.0) for p in (0.8, 1.4)]
    nodes = [node(4.0 + k, 5.0 + 0.3 * k) for k in range(6)]
    C = ls.schedules.gain_scheduled(nodes, points, {"theta_deg": "theta", "p_bar": "p"}, lag_s=0.02)
    t = np.arange(3000) / 1000.0
    at = np.stack([50.0 * np.sin(3.0 * t), 1.1 + 0.4 * np.cos(2.0 * t)], axis=1)
    error = np.random.default_rng(3).standard_normal(t.size)
    tables = C.tables([("theta", gain_scheduled.Follows.REFERENCE), ("p", gain_scheduled.Follows.REFERENCE)])
    answer = kernel.run(tables, np.stack([np.radians(at[:, 0]), at[:, 1]], axis=1), error)
    return C, error, at, answer


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_header_answers_as_the_kernel(moving, tmp_path: Path):
    C, error, at, answer = moving
    ls.formats.export(C, tmp_path, "c")
    (tmp_path / "driver.c").write_text(DRIVER)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", tmp_path / "d.so", tmp_path / "driver.c"], check=True, timeout=60)
    out = np.empty(error.size)
    pointer = [a.ctypes.data_as(ctypes.c_void_p) for a in (error, np.ascontiguousarray(at), out)]
    ctypes.CDLL(str(tmp_path / "d.so")).run(error.size, *pointer)
    np.testing.assert_allclose(out, answer, rtol=0.0, atol=1e-9 * np.abs(answer).max())


def test_the_json_has_all_that_is_needed(moving, tmp_path: Path):
    """Interpolated by numpy from the file alone at a frozen operating point, against the response of `at`."""
    C, *_ = moving
    (path,) = ls.formats.export(C, tmp_path, "json")
    told = json.loads(path.read_text())
    assert [v["name"] for v in told["variables"]] == ["theta_deg", "p_bar"]
    weights = {(0.0, 0.8): 0.375, (0.0, 1.4): 0.375, (30.0, 0.8): 0.125, (30.0, 1.4): 0.125}  # at 7.5 deg, 1.1 bar
    six = sum(weights.get(tuple(n["at"].values()), 0.0) * np.array(n["sections"]) for n in told["nodes"])
    z = np.exp(-2j * np.pi * 4.0 / told["rate_hz"])
    response = np.prod((six[:, :3] @ [1, z, z**2]) / (six[:, 3:] @ [1, z, z**2]))
    expected = C.at({"theta_deg": 7.5, "p_bar": 1.1}).response(np.array([4.0]))[0]
    assert response == pytest.approx(expected, rel=1e-9)


def test_a_format_without_schedules_is_refused(moving, tmp_path: Path):
    with pytest.raises(ls.errors.WrongUseError, match="not written in every format"):
        ls.formats.export(moving[0], tmp_path, "matlab")
