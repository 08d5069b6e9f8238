"""A rotary axis with gravity, spring and a load behind a coupling, simulated by scipy: swings and gaps."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import RecordingInfo
from scipy.integrate import solve_ivp

import loopshape as ls
from loopshape.toolbox.gap.own.composed import Composed

J, D, WEIGHT, SPRING, LOAD, LOAD_D, STIFF, COUPLING_D = 0.010, 0.03, 0.40, 0.5, 0.015, 0.02, 30.0, 0.03
ARM = {"inertia": J, "damping": D, "gravity": WEIGHT, "spring": SPRING}
TWO = ARM | {"load_inertia": LOAD, "load_damping": LOAD_D, "coupling_stiffness": STIFF, "coupling_damping": COUPLING_D}
RATE_HZ, SECONDS = 200.0, 10.0


def slopes(model, x):
    """Jacobian (nx, nx) of the motion by central differences, at rest at x with no effort."""
    composed = Composed(model)
    p, h = composed.values({}), 1e-6

    def f(at):
        return np.array(composed.motion(0.0, at, np.zeros(len(model.inputs)), p))

    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(x.size)], axis=1)


def test_an_arm_that_hangs_swings_at_the_root_of_spring_and_weight_over_inertia():
    poles = np.linalg.eigvals(slopes(ls.gap.axis(ARM, "torque_nm", "arm_rad"), np.zeros(2)))
    assert np.abs(poles[0]) == pytest.approx(np.sqrt((SPRING + WEIGHT) / J), rel=1e-5)
    assert poles.real == pytest.approx(-0.5 * D / J, rel=1e-5)


def test_an_arm_turned_by_half_a_turn_falls():
    upright = ls.gap.axis(ARM | {"hangs_at": np.pi, "spring": 0.0}, "torque_nm", "arm_rad")
    poles = np.linalg.eigvals(slopes(upright, np.zeros(2)))
    assert np.prod(poles).real == pytest.approx(-WEIGHT / J, rel=1e-5)


@pytest.mark.parametrize("rotary", [True, False])
def test_two_bodies_swing_as_their_matrices_of_mass_and_stiffness_say(rotary):
    model = ls.gap.axis(TWO, "torque_nm", "motor_rad", "load_rad", rotary=rotary)
    pull = SPRING + WEIGHT * rotary  # a weight that is the same everywhere is no spring
    K = np.array([[STIFF, -STIFF], [-STIFF, STIFF + pull]])
    C = np.array([[D + COUPLING_D, -COUPLING_D], [-COUPLING_D, LOAD_D + COUPLING_D]])
    M = np.diag([J, LOAD])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    found = np.sort_complex(np.linalg.eigvals(slopes(model, np.zeros(4))))
    assert found == pytest.approx(np.sort_complex(np.linalg.eigvals(A)), rel=1e-4)


def recorded(k, role="estimation", coulomb=0.0):
    """Both angles under a multisine of torque and a PD law, with dry friction of the load; by scipy's DOP853."""
    rng, n = np.random.default_rng(k), round(SECONDS * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    hz, phase = rng.uniform(0.2, 5.0, 8), rng.uniform(0.0, 6.28, 8)
    r = np.sum(0.3 / (1.0 + hz)[:, None] * np.sin(2 * np.pi * hz[:, None] * t + phase[:, None]), axis=0)
    x, torque, read = np.zeros(4), np.zeros(n), np.zeros((2, n))

    def slope(_, x, u):
        through = STIFF * (x[0] - x[2]) + COUPLING_D * (x[1] - x[3])
        dry = coulomb * np.tanh(x[3] / 0.005)
        pull = 1.01 * SPRING * x[2] + 0.99 * WEIGHT * np.sin(x[2])
        return [x[1], (u - 1.05 * D * x[1] - through) / J, x[3], (through - LOAD_D * x[3] - pull - dry) / (1.02 * LOAD)]

    for i in range(n):
        read[:, i] = x[[0, 2]] + 5e-5 * rng.standard_normal(2)
        speed = (read[0, i] - read[0, max(i - 2, 0)]) * RATE_HZ / 2
        torque[i] = 3.0 * (r[i] - read[0, i]) - 0.05 * speed
        x = solve_ivp(slope, (0.0, 1.0 / RATE_HZ), x, "DOP853", args=(torque[i],), rtol=1e-7, atol=1e-9).y[:, -1]
    info = RecordingInfo(f"r{k}.parquet", "noise", "reference", role=role, operating_point={"arm_rad": 0.0})
    return ls.Recording(info, RATE_HZ, {"torque_nm": torque, "motor_rad": read[0], "load_rad": read[1]})


@cache
def run(coulomb=0.0):
    own = [recorded(k, coulomb=coulomb) for k in range(3)]
    return ls.Run(RATE_HZ, (), (*own, recorded(9, "validation", coulomb)))


def diagnosed(coulomb=0.0):
    model = ls.gap.axis(TWO, "torque_nm", "motor_rad", "load_rad", window_s=0.8)
    return ls.gap(run(coulomb), model=model, table=False)


@pytest.mark.long
@pytest.mark.hour
def test_dry_friction_of_the_load_is_named_with_its_place_and_size():
    found = diagnosed(coulomb=0.03)
    assert found.verdict == "coulomb_friction@load"
    assert found.ranking[0].magnitude == pytest.approx(0.03, rel=0.15)
    assert found.gap.after < 1.0 < 5.0 < found.gap.before


@pytest.mark.long
@pytest.mark.hour
def test_an_axis_within_its_tolerances_has_no_gap():
    assert diagnosed().verdict == "none"


PAGE = (Path(__file__).parents[4] / "docs/machine.md").read_text()
MODEL_TOML = next(words for words in re.findall(r"```toml\n(.*?)```", PAGE, re.S) if "axis = " in words)


def written(folder, old="", new=""):
    (folder / "model.toml").write_text(MODEL_TOML.replace(old, new) if old else MODEL_TOML)
    from loopshape.toolbox.gap.own.file import read_model

    return read_model(folder / "model.toml")


def test_a_file_says_the_same(tmp_path):
    model = written(tmp_path)
    values = {p.name: (p.value, p.tolerance, p.unit) for p in model.parameters}
    assert values["inertia"] == (0.010, 0.03, "kg m2")
    assert values["coupling_stiffness"] == (30.0, 0.05, "N m/rad")
    assert values["spring"] == (0.0, 0.05, "N m/rad")
    assert [(o.column, o.state, o.factor) for o in model.outputs] == [
        ("motor_deg", "position", pytest.approx(np.pi / 180)), ("load_rad", "load_position", 1.0),
    ]  # fmt: skip
    assert [p.name for p in model.ports] == ["axis", "load"]


@pytest.mark.parametrize(("old", "new", "said"), [
    ('"rotary"', '"round"', "axis is not known; received 'round'; use rotary or linear"),
    ("gravity = 0.40", "gravitation = 0.40", "a number of the axis is not known; received 'gravitation'"),
    ("inertia = { value = 0.010, tolerance = 0.03 }", "", "no inertia"),
    ("coupling_stiffness = 30.0", "", "no coupling_stiffness"),
    ("damping = 0.03", "damping = 0.03\nmotor_inertia = 0.001", "motor_inertia is a part of a single body"),
    ('effort = { column = "torque_nm" }', "", "effort"),
    ("tolerance = 0.03", "tolerance = 3", "a share from 0 to 1"),
])  # fmt: skip
def test_a_wrong_file_is_refused_in_words(tmp_path, old, new, said):
    with pytest.raises(ls.errors.WrongUseError, match=said):
        written(tmp_path, old, new)
