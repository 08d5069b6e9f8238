"""The examiner's arm is the arm of ARM.md where nothing is wrong with it, and departs from it as it is told."""

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import examiner.exam as exam
import numpy as np
import pandas as pd
import pytest
from conversions import deg, rad
from examiner import (
    BLOCKS,
    EFFECTS,
    KINDS,
    OUTSIDE,
    RANGES,
    UNITS,
    canonical,
    draw_case,
    make_run,
    seal,
    verdict,
)
from examiner.arm import BAR, OMEGA, P_A, P_B, P_C, STATES, SUPPLY_PA, THETA, Arm
from examiner.forms import FORMS, build, typical_load_n
from examiner.motion import rates
from examiner.record import at_rest, record
from examiner.session import ANGLE, PRESSURE, Plan, plans
from scipy.signal import lfilter

import loopshape as ls

SHARED = Path(os.environ.get("LOOPSHAPE_DATA", Path(__file__).parents[4] / "shared"))
REFERENCE = SHARED / "reference"
needs_reference = pytest.mark.skipif(not REFERENCE.is_dir(), reason="no ../shared/reference here")
EVERY = sorted(EFFECTS | OUTSIDE)
NEUTRAL = {"coupling_flexibility": 60.0}  # where an effect is next to nothing; the others' place is 0


def simulated(arm, y, setpoints, forced, open_from):
    n = setpoints.shape[0]
    zero, periods = np.zeros((n, 2)), n // 20 + 2
    sections = ANGLE.biquads(), PRESSURE.biquads()
    return record(arm, y, setpoints, zero, forced, open_from, np.zeros((n, 3)), np.zeros(periods), *sections, 0.0)


@lru_cache
def moving_plan() -> Plan:
    """A few seconds of the strongest multisine with the setpoint moved to both sides, then pulses with open loops."""
    plan = plans(np.random.default_rng(3))[1]
    n = 5000
    plan.setpoints[800:2200, 0], plan.setpoints[2200:3000, 0] = rad(12.0), rad(-12.0)
    forced = np.zeros((n, 2))
    forced[3600:3900, 0], forced[4100:4300, 0] = 0.25, -0.3
    return Plan(plan.info, plan.setpoints[:n], plan.injected[:n], forced)


@lru_cache
def short(name: str, magnitude: float, variant: int) -> np.ndarray:
    """Angle in deg and pressures in bar (n, 3) of a nominal arm with one effect, noise-free and without converters."""
    plan = moving_plan()
    labels = {name: magnitude} if name else {}
    arm = build(labels, np.random.default_rng(7), variant, ordinary=False)._replace(converters=0)
    n = plan.setpoints.shape[0]
    lost = np.random.default_rng(1).random(n // 20 + 2) < labels.get("lost_commands", 0.0)
    y = exam.start(arm, 0.0, 1.0)
    out, left = record(
        arm, y, plan.setpoints, plan.injected, plan.forced, 3500, np.zeros((n, 3)), lost.astype(float),
        ANGLE.biquads(), PRESSURE.biquads(), 200.0,
    )  # fmt: skip
    assert left == n
    return np.column_stack([deg(out[:, 0]), out[:, 1:3]])


def departure(name: str, magnitude: float, variant: int) -> float:
    """RMS departure from the healthy arm: 1 is 0.02 deg and 1 mbar, the sensors' noise."""
    return float(np.sqrt(np.mean(((short(name, magnitude, variant) - short("", 0.0, 0)) / [0.02, 1e-3, 1e-3]) ** 2)))


@needs_reference
def test_right_hand_side_is_that_of_the_reference():
    table = pd.read_parquet(REFERENCE / "rhs1.parquet")
    wanted = table[["d_p_c", "d_p_a", "d_p_b", "d_theta2", "d_w2"]].to_numpy()
    got = np.zeros_like(wanted)
    for k, row in enumerate(table.itertuples()):
        y, dy = at_rest(Arm(), row.theta2, row.p_a * BAR, row.p_b * BAR), np.zeros(STATES)
        y[P_C], y[OMEGA] = row.p_c * BAR, row.w2
        rates(Arm(), y, dy, np.array([row.in_a, row.out_a, row.in_b, row.out_b]), SUPPLY_PA, 1.0, 0.0)
        got[k] = dy[P_C] / BAR, dy[P_A] / BAR, dy[P_B] / BAR, dy[THETA], dy[OMEGA]
    np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-7)


@needs_reference
@pytest.mark.parametrize("name", ["open1", "closed1"])
def test_healthy_arm_meets_the_reference(name):
    table = pd.read_parquet(REFERENCE / f"{name}.parquet")
    n = len(table)
    setpoints, forced = np.zeros((n, 2)), np.zeros((n, 2))
    if name == "closed1":
        setpoints[:] = table[["r_theta2", "r_p"]]
    else:
        forced[:] = table[["z_theta2", "z_p"]]
    y = at_rest(Arm(), table.theta2[0], table.p_a[0] * BAR, table.p_b[0] * BAR)
    out, left = simulated(Arm(converters=0), y, setpoints, forced, n if name == "closed1" else 0)
    assert left == n
    assert deg(np.abs(out[:, 0] - table.theta2)).max() < 0.01
    assert np.abs(out[:, 1:3] - table[["p_a", "p_b"]].to_numpy()).max() < 2e-4
    assert np.abs(out[:, 3:] - table[["z_theta2", "z_p"]].to_numpy()).max() < 2e-3


def test_every_effect_has_a_form_a_block_and_a_unit():
    assert set(FORMS) == set(EVERY) == set(BLOCKS) == set(UNITS)
    assert len(EFFECTS) == 21
    assert set(RANGES) == set(EFFECTS)
    assert len(OUTSIDE) >= 6
    assert not set(EFFECTS) & set(OUTSIDE)


@pytest.mark.parametrize("variant", [0, 1])
@pytest.mark.parametrize("name", EVERY)
def test_an_effect_at_its_neutral_magnitude_is_the_healthy_arm(name, variant):
    e = (EFFECTS | OUTSIDE)[name]
    neutral = departure(name, NEUTRAL.get(name, 0.0), variant)
    assert neutral < 0.05 * max(departure(name, e.low, variant), departure(name, e.high, variant))


@pytest.mark.parametrize("variant", [0, 1])
@pytest.mark.parametrize("name", EVERY)
def test_a_larger_magnitude_departs_further(name, variant):
    e = (EFFECTS | OUTSIDE)[name]
    near, far = (e.high, e.low) if name == "coupling_flexibility" else (e.low, e.high)
    for sign in (1.0, -1.0) if e.signed else (1.0,):
        assert departure(name, sign * far, variant) > 1.15 * departure(name, sign * near, variant)
        assert departure(name, sign * far, variant) > 1.0


def test_typical_load_is_that_of_both_muscles_at_rest():
    assert 80.0 < typical_load_n() < 400.0


@lru_cache
def run(seed: int, *labels: tuple[str, float]):
    return make_run(dict(labels), seed)


def test_a_run_has_the_design_of_a_real_session():
    made = run(1)
    kinds = [r.info.kind for r in made.recordings]
    assert kinds == ["multisine"] * 5 + ["sweep", "staircase", "open_loop", "sweep", "staircase", "profile"]
    assert [r.info.name for r in made.recordings if r.info.role == "validation"] == ["rec09", "rec10", "rec11"]
    for r in made.recordings:
        time_s = r.column("t_s")
        assert time_s[0] == 0.0
        np.testing.assert_allclose(np.diff(time_s), 1e-3, atol=1e-9)
        assert deg(np.abs(r.column("theta2_rad")).max()) < 45.0
        pressures = np.concatenate([r.column("p_a_bar"), r.column("p_b_bar")])
        assert 0.1 < pressures.min() < pressures.max() < 1.25
        for z in (r.column("z_theta2_v"), r.column("z_p_v")):
            np.testing.assert_array_equal(z[: 1 if r.info.closed_loop else 0] * 2**13 % 1.0, 0.0)
        np.testing.assert_allclose(r.column("u_b_v"), r.column("z_p_v") - r.column("z_theta2_v"), atol=1e-12)


@pytest.mark.skipif(not (SHARED / "withheld").is_dir(), reason="no ../shared/withheld here")
def test_a_run_excites_as_much_as_a_real_session():
    for r in run(1).recordings:
        real = pd.read_parquet(SHARED / "withheld" / "s001" / r.info.file)
        assert set(real.columns) == set(r.columns)
        assert len(real) == pytest.approx(len(r.column("t_s")), rel=0.15)
        for name in ("n_theta2_rad", "n_p_ab_bar", "z_theta2_v", "theta2_rad", "p_a_bar"):
            ours, theirs = float(r.column(name).std()), float(real[name].std())
            assert ours == pytest.approx(theirs, rel=0.6, abs=2e-3)


def test_multisines_repeat_and_leave_lines_out():
    r = run(1).recording("rec01")
    n = r.column("n_theta2_rad")
    np.testing.assert_allclose(n[11000:21000], n[1000:11000], atol=1e-12)
    size = np.abs(np.fft.rfft(n[1000:11000]))
    excited = np.flatnonzero(size > 1e-6 * size.max())
    assert excited.size == 51
    assert np.all(excited % 2 == 1)


def test_control_follows_from_the_logged_signals():
    made = run(1)
    r, loop = made.recording("rec07"), made.loop("theta2")
    z = r.column("r_theta2_rad") + r.column("n_theta2_rad") - r.column("theta2_rad")
    for b0, b1, b2, a1, a2 in loop.controller.biquads():
        z = lfilter([b0, b1, b2], [1.0, a1, a2], z)
    # what was before the recording has died out after some seconds
    np.testing.assert_allclose(z[4000:], r.column("z_theta2_v")[4000:], atol=2.0**-13)


@pytest.mark.long
def test_same_seed_same_run_and_another_seed_another():
    again, other = make_run({}, 1), make_run({}, 2)
    for a, b, c in zip(run(1).recordings, again.recordings, other.recordings, strict=True):
        for name in a.columns:
            np.testing.assert_array_equal(a.column(name), b.column(name))
        assert not np.array_equal(a.column("theta2_rad")[:7000], c.column("theta2_rad")[:7000])


@pytest.mark.long
def test_effects_leave_the_signals_of_a_seed_alone():
    healthy, heavy = run(1), make_run({"payload": 60.0}, 1)
    for a, b in zip(healthy.recordings, heavy.recordings, strict=True):
        np.testing.assert_array_equal(a.column("n_theta2_rad"), b.column("n_theta2_rad"))
        np.testing.assert_array_equal(a.column("r_theta2_rad"), b.column("r_theta2_rad"))
        assert not np.array_equal(a.column("theta2_rad"), b.column("theta2_rad"))


def test_effects_compose():
    plan = {"payload": 60.0, "leak": 0.2}
    arm = build(plan, np.random.default_rng(1), 0)
    assert arm.payload_kg == pytest.approx(0.06)
    assert arm.leak_form == 1


def test_spread_is_the_ordinary_one():
    arms = [build({}, np.random.default_rng(k), 0) for k in range(200)]
    radii = np.array([[np.sqrt(a.beta_in_m2 / Arm().beta_in_m2), a.stiffness_a, a.damping] for a in arms])
    masses = np.array([a.body_nm / Arm().body_nm for a in arms])
    assert np.all(np.abs(radii - 1.0).max(axis=0) <= [0.02, 0.03, 0.2])
    assert np.all(np.abs(radii - 1.0).max(axis=0) > [0.018, 0.027, 0.18])
    assert 0.009 < np.abs(masses - 1.0).max() <= 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_drawn_cases_are_what_their_kind_says(kind):
    rng = np.random.default_rng(0)
    for _ in range(200):
        labels = draw_case(kind, rng)
        assert len(labels) == {"single": 1, "healthy": 0, "unknown": 1, "pair": 2}[kind]
        assert len({BLOCKS[name] for name in labels}) == len(labels)
        for name, magnitude in labels.items():
            e = (EFFECTS | OUTSIDE)[name]
            assert e.low * 0.999 <= abs(magnitude) <= e.high * 1.001
            assert magnitude > 0.0 or e.signed
        assert (verdict(labels) == "unknown") == (kind == "unknown")


def test_a_seal_depends_on_labels_and_nonce_alone():
    a, b = {"leak": 0.2, "payload": 50}, {"payload": 50.0, "leak": 0.2}
    assert canonical(a) == canonical(b) == '{"leak":0.2,"payload":50.0}'
    assert seal(a, "x") == seal(b, "x")
    assert len({seal(a, "x"), seal(a, "y"), seal({}, "x")}) == 3
    assert verdict(b) == "leak+payload"
    assert verdict({}) == "none"


def test_refuses_what_it_does_not_have():
    with pytest.raises(ls.errors.WrongUseError, match="no such effect"):
        make_run({"gremlin": 1.0}, 1)
    with pytest.raises(ls.errors.WrongUseError, match="kind is not known"):
        draw_case("triple", np.random.default_rng(0))
    with pytest.raises(ls.errors.WrongUseError, match="left its range"):
        make_run({"payload": 2000.0}, 1)


def test_knows_no_plant():
    folder = Path(exam.__file__).parent
    for word in ("loopshape.toolbox",):
        assert not [f.name for f in folder.glob("*.py") if word in f.read_text(encoding="utf-8")]


PLAIN = """
import numpy as np
from examiner.exam import start
from examiner.forms import build
from examiner.record import record
from examiner.session import ANGLE, PRESSURE
labels = {"hose_lag": 3.0, "valve_delay": 4.0, "braid_hysteresis": 5.0, "joint_friction": 0.2, "muscle_creep": 0.2,
          "choked_flow": 0.5, "backlash": 0.5, "angle_sensor_lag": 10.0, "coupling_flexibility": 15.0, "leak": 0.2}
for variant in (0, 1):
    arm = build(labels, np.random.default_rng(1), variant)
    n = 60
    setpoints = np.tile([0.05, 1.0], (n, 1))
    zero = np.zeros((n, 2))
    out, _ = record(arm, start(arm, 0.0, 1.0), setpoints, zero, zero, n, np.zeros((n, 3)), np.zeros(5),
                    ANGLE.biquads(), PRESSURE.biquads(), 0.0)
    print(repr(float(np.abs(out).sum())))
"""


@pytest.mark.long
def test_plain_python_gives_what_the_compiled_kernel_gives():
    plain, compiled = (
        subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(Path(exam.__file__).parents[1])!r}){PLAIN}"],
            env=os.environ | {"NUMBA_DISABLE_JIT": off}, capture_output=True, text=True, check=True,
        ).stdout.split()
        for off in ("1", "0")
    )  # fmt: skip
    np.testing.assert_allclose(np.array(plain, dtype=float), np.array(compiled, dtype=float), rtol=1e-6)
