"""The compiled kernel of two joints and the plain functions beneath it (NUMBA_DISABLE_JIT=1) give the same log."""

import os
import subprocess
import sys

import numpy as np

SCRIPT = """
import sys
sys.path[:0] = sys.argv[2].split("|")
import numpy as np
from arm2_cases import ARM, experiment
from loopshape.toolbox.arm.dynamics.closed_loop2 import run2

injected = np.zeros((300, 4))
injected[:, :2] = 0.05 * np.sin(np.outer(np.arange(300), [0.03, 0.02]))
e = experiment((2.0, 3.0, 0.45, 0.4), 300, setpoint=(3.0, 5.0, 0.5, 0.45), injection="controller_input",
               injected=injected, seed=3)
out = {"compiled": np.array(hasattr(run2, "py_func"))}
for name, more in (("printed", {}), ("absolute", {"gas_absolute_share": 1.0, "polytropic_exponent": 1.4})):
    (r,) = ARM.simulate([e], changes={"converter_bits": 0.0} | more, states=True)
    assert r.info.ended_early is None
    out |= {f"{name} {column}": r.columns[column] for column in r.columns}
np.savez(sys.argv[1], **out)
"""


def test_closed_loop_log_is_the_same(tmp_path):
    logs = []
    for jit in ("0", "1"):
        path = tmp_path / f"{jit}.npz"
        environment = os.environ | {"NUMBA_DISABLE_JIT": jit}
        command = [sys.executable, "-W", "error", "-c", SCRIPT, path, "|".join(sys.path)]
        subprocess.run(command, env=environment, check=True, timeout=300)
        with np.load(path) as file:
            logs.append(dict(file))
    compiled, plain = logs
    assert compiled.pop("compiled")
    assert not plain.pop("compiled")
    assert len(compiled) == 2 * 32
    for name, values in compiled.items():
        size = np.abs(plain[name]).max()
        # compiled code may contract a b + c, which leaves 1e-16 at each step
        np.testing.assert_allclose(values, plain[name], rtol=0.0, atol=1e-12 * size, err_msg=name)
    assert np.abs(plain["printed z_theta1_v"]).max() > 0.1
    assert np.abs(plain["printed true_theta2_rad"] - plain["absolute true_theta2_rad"]).max() > 1e-5
