"""The compiled kernels and the plain functions beneath them (NUMBA_DISABLE_JIT=1) give the same log."""

import os
import subprocess
import sys

import numpy as np
import pytest

SCRIPT = """
import sys
import numpy as np
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import Experiment
from loopshape.toolbox.gap.noise import advance, normal_pair, start_state
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.closed_loop import run

arm = Arm1()
injected = np.zeros((300, 2))
injected[:, 0] = 0.05 * np.sin(0.03 * np.arange(300))
loops = arm.loop_setups(arm.default_controllers(1000.0), "controller_input")
e = Experiment("one", "none", loops, 1000.0, np.tile([0.15, 1.1], (300, 1)), injected, "controller_input",
               {"theta2_deg": 5.0, "p_ab_bar": 1.0}, seed=3)
out = {"compiled": np.array(hasattr(run, "py_func"))}
first = {form.effect: form for form in reversed(arm.effects)}
last = {form.effect: form for form in arm.effects}
for way, forms in (("edges", {}), ("grid", {}), ("first", first), ("last", last)):
    solver = "grid" if way == "grid" else "edges"
    moves = [form.at(form.scale * form.free[0].starts[0]).moves for form in forms.values()]
    changes = {name: value for move in moves for name, value in move.items()} | {"converter_bits": 0.0}
    (r,) = arm.simulate([e], solver=solver, changes=changes, states=True)
    out |= {f"{way} {name}": r.columns[name] for name in r.columns}
out["normal"], state = np.empty(3000), start_state(5, 2)
for k in range(0, 3000, 2):
    state, out["normal"][k], out["normal"][k + 1] = normal_pair(state)
states = [state]
for _ in range(1000):
    states.append(int(advance(states[-1])))
out["state"] = np.array(states, dtype=np.uint64)
np.savez(sys.argv[1], **out)
"""


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    logs = {}
    for jit in ("0", "1"):
        path = tmp_path_factory.mktemp("logs") / f"{jit}.npz"
        environment = os.environ | {"NUMBA_DISABLE_JIT": jit}
        subprocess.run([sys.executable, "-W", "error", "-c", SCRIPT, path], env=environment, check=True, timeout=300)
        with np.load(path) as file:
            logs[jit] = dict(file)
    assert logs["0"].pop("compiled")
    assert not logs["1"].pop("compiled")
    return logs["0"], logs["1"]


def test_random_numbers_are_the_same_bits(both):
    compiled, plain = both
    np.testing.assert_array_equal(compiled["state"], plain["state"])
    np.testing.assert_array_equal(compiled["normal"], plain["normal"])


@pytest.mark.parametrize("way", ["edges", "grid", "first", "last"])
def test_closed_loop_log_is_the_same(both, way):
    """By both solvers, and with all effects on: each by its first form, and by its last."""
    compiled, plain = both
    names = [name for name in compiled if name.startswith(way)]
    assert len(names) == 17
    for name in names:
        size = np.abs(plain[name]).max()
        # compiled code may contract a b + c, which leaves 1e-16 at each step
        np.testing.assert_allclose(compiled[name], plain[name], rtol=0.0, atol=1e-12 * size, err_msg=name)
    assert np.abs(plain[f"{way} z_theta2_v"]).max() > 0.1
