"""Controllers that the tests of exports share: each kind of block, a series with one integrator, each precision."""

import numpy as np
from bench_nouns import Block

import loopshape as ls

RATE_HZ = 100.0  # low, so that 16 bits hold the poles too
BLOCKS = {
    "gain": Block("gain", {"gain": -3.7}),
    "lead_lag": Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0}),
    "notch": Block("notch", {"f1_hz": 4.5, "f2_hz": 6.1, "damping1": 0.05, "damping2": 0.8}),
    "low_pass_1": Block("low_pass_1", {"f_hz": 10.0}),
    "low_pass_2": Block("low_pass_2", {"f_hz": 19.0, "damping": 0.55}),
    "pi": Block("pi", {"f_hz": 0.7}),
    "pid": Block("pid", {"gain": 0.8, "fi_hz": 0.7, "fd_hz": 3.0, "ff_hz": 19.0}),
    "section": Block("section", {"n0": 1.0, "n1": 0.05, "n2": 0.001, "d0": 1.0, "d1": 0.05, "d2": 0.002}),
}
PRECISIONS = ("double", "single", "q5.27", "q5.11", "q5.35")


def cases():
    """Controllers by a name: each block alone, and all in series, with `prewarp_hz`, in each precision."""
    made = {}
    for precision in PRECISIONS:
        short = precision.replace(".", "_")
        for kind, block in BLOCKS.items():
            made[f"{kind}-{short}"] = ls.Controller(f"{kind}-{short}", (block,), RATE_HZ, precision=precision)
        series = tuple(block for kind, block in BLOCKS.items() if kind != "pid")  # one integrator
        made[f"series-{short}"] = ls.Controller(f"series-{short}", series, RATE_HZ, prewarp_hz=5.0, precision=precision)
    return made


def inputs(controller, n, seed):
    """Random inputs (n,) over many sizes, in the controller's own numbers; of fixed point some reach its limits."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(n) * 10.0 ** rng.uniform(-6.0, 3.0, n)
    if not controller.number_format.fixed:
        return values.astype(np.float32 if controller.precision == "single" else np.float64)
    whole = np.rint(values * 1e4).astype(np.int64)
    whole[:: n // 10] = np.resize([2**31 - 1, -(2**31), controller.number_format.signal_limit], whole[:: n // 10].size)
    return np.clip(whole, -(2**31), 2**31 - 1)
