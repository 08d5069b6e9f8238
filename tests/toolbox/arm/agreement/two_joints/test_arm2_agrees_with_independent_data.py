"""The 2-DoF arm and an independent implementation of ARM.md (`shared/reference`) say the same."""

import json

import numpy as np
import pandas as pd
import pytest
from arm2_cases import ARM, MIDDLE, QUIET, experiment, numbers

from loopshape.toolbox.arm.dynamics.equilibrium2 import rest2
from loopshape.toolbox.arm.dynamics.model2 import derivatives2

#: ours -> theirs; in the trajectories `p_cap` is the capacity
PRESSURES = {"p_a": "p_a", "p_b": "p_b", "p_c": "p_c", "p_d": "p_d", "p_capacity": "p_cap"}
CONTROLS = {"z_theta1_v": "z_1", "z_theta2_v": "z_2", "z_p_a_v": "z_a", "z_p_c_v": "z_c"}


@pytest.fixture(scope="module")
def reference(shared):
    folder = shared / "reference"
    if not (folder / "rhs2.parquet").is_file():
        pytest.skip("the shared folder holds no reference data of two joints")
    return folder


def test_every_derivative_at_300_random_states(reference):
    table = pd.read_parquet(reference / "rhs2.parquet")
    pa = table[["p_c", "p_a", "p_b", "p_cc", "p_d"]].to_numpy() * 1e5  # here `p_c` is the capacity, `p_cc` muscle C
    states = np.hstack([pa, table[["theta1", "theta2", "w1", "w2"]].to_numpy()])
    valves = table[[f"{way}_{m}" for way in ("in", "out") for m in "abcd"]].to_numpy() > 0.5
    c = numbers()
    ours = np.array([derivatives2(c, x, tuple(v)) for x, v in zip(states, valves, strict=True)])
    theirs = table[[f"d_{name}" for name in ("p_c", "p_a", "p_b", "p_cc", "p_d", "w1", "w2")]].to_numpy() * (
        [1e5] * 5 + [1.0, 1.0]
    )
    assert len(table) == 300
    # measured 3e-11, where an acceleration all but vanishes; relative to each column's largest 4e-15
    np.testing.assert_allclose(np.delete(ours, (5, 6), axis=1), theirs, rtol=1e-9)  # zeros must be zeros
    np.testing.assert_array_equal(ours[:, 5:7], states[:, 7:9])


def test_the_equilibrium_that_both_start_from(reference):
    first = pd.read_parquet(reference / "open2.parquet").iloc[0]
    x = rest2(numbers(), *MIDDLE, 1e5)
    np.testing.assert_allclose(1e-5 * x[:5], [first[k] for k in ("p_cap", "p_a", "p_b", "p_c", "p_d")], rtol=1e-9)


def test_default_controllers_are_the_reference_ones(reference):
    tables = json.loads((reference / "controllers.json").read_text())["two"]
    names = {"p": "gain", "fl_hz": "f_hz", "zeta": "damping", "b1": "damping1", "b2": "damping2"}
    kinds = {"lowpass1": "low_pass_1", "lowpass2": "low_pass_2"}
    assert set(tables) == set(ARM.loops)
    for controller in ARM.default_controllers(1000.0):
        for block, table in zip(controller.blocks, tables[controller.loop], strict=True):
            values = {names.get(k, k): v for k, v in table.items() if k != "type"}
            if "fn_hz" in values:
                values["f1_hz"] = values["f2_hz"] = values.pop("fn_hz")
            assert (block.kind, dict(block.parameters)) == (kinds.get(table["type"], table["type"]), values)


def trajectory(reference, name, steps):
    """Worst differences of a whole trajectory: angles in deg, pressures in bar, controls in V."""
    table = pd.read_parquet(reference / f"{name}.parquet")
    if name == "open2":
        fields = {"injection": "control", "injected": table[["z_1", "z_2", "z_a", "z_c"]].to_numpy()}
    else:
        fields = {"references": table[["r_1", "r_2", "r_a", "r_c"]].to_numpy()}
    (r,) = ARM.simulate([experiment(MIDDLE, len(table), **fields)], changes=QUIET, steps_per_tick=steps, states=True)
    assert r.info.ended_early is None
    assert np.ptp(np.degrees(table[["theta1", "theta2"]].to_numpy()), axis=0).min() > 8.0  # it moves
    angle = max(np.degrees(np.abs(r.column(f"true_theta{j}_rad") - table[f"theta{j}"])).max() for j in (1, 2))
    pressure = max(np.abs(r.column(f"true_{ours}_bar") - table[k]).max() for ours, k in PRESSURES.items())
    control = max(np.abs(r.column(ours) - table[k]).max() for ours, k in CONTROLS.items())
    return angle, pressure, control


@pytest.mark.long
@pytest.mark.parametrize("name", ["open2", "closed2"])
def test_trajectories_agree_to_what_the_step_explains(reference, name):
    one, twenty = (trajectory(reference, name, steps) for steps in (1, 20))
    # measured at 1 ms: 6e-8 deg, 2.2e-9 bar (the capacity, at the root of p_in - p_c), 6e-9 V
    np.testing.assert_array_less(one, (2.5e-7, 1e-8, 3e-8))
    # nothing else is left: at the reference's own step of 0.05 ms measured 2e-11 deg, 1.5e-13 bar, 1.5e-12 V
    np.testing.assert_array_less(twenty, (2e-10, 2e-12, 2e-11))
