"""Servos whose command is a position: what is wrong with the real one is named, with its size.

One truth is stepped by MuJoCo from a changed model, the other by the textbook's equations of a DC motor under a
firmware's law, in scipy; commands are sums of sines.
"""

import numpy as np
import pytest
from bench_nouns import RecordingInfo
from scipy.integrate import solve_ivp

import loopshape as ls
from loopshape.toolbox.gap.mechanism.fix import in_files
from loopshape.toolbox.gap.mechanism.mechanism import machine
from loopshape.toolbox.gap.nouns.effect import fix_of
from loopshape.toolbox.gap.nouns.machine import Mechanism
from loopshape.toolbox.gap.own import mapping
from loopshape.toolbox.gap.own.plant import OwnMachine

mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")

RATE_HZ = 500.0
XML = """<mujoco><compiler angle="radian"/><option timestep="0.0001" integrator="RK4"/><worldbody><body name="arm">
<joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.012" frictionloss="{dry}"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.6"/></body></worldbody>{actuator}</mujoco>"""
SERVO = '<actuator><position name="servo" joint="shoulder" kp="{kp}" kv="0.3" forcerange="-{most} {most}"/></actuator>'
SPREAD = {"mass": {"arm": 0.02}, "damping": {"shoulder": 0.1}, "frictionloss": {"shoulder": 0.1}}
MOTOR = {"resistance": 2.1, "torque_constant": 0.012, "gear": 120.0, "voltage": 7.4, "kp": 25.0, "kd": 0.2}


def xml(dry=0.05, kp=8.0, most=3.0):
    return XML.format(dry=dry, actuator=SERVO.format(kp=kp, most=most))


def goals(k, t):
    rng = np.random.default_rng(k)
    waves = [0.5 / (1.0 + f) * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0)) for f in rng.uniform(0.2, 5.0, 6)]
    return np.sum(waves, axis=0) + 0.4 * np.sin(0.6 * t + k)


def stepped(changed):
    """Angles by MuJoCo's own steps of a changed model, for commands each held for a tick."""

    def angles(command):
        m = mujoco.MjModel.from_xml_string(changed)
        data, out = mujoco.MjData(m), []
        for value in command:
            out.append(data.qpos[0])
            data.ctrl[0] = value
            mujoco.mj_step(m, data, 20)
        return np.array(out)

    return angles


def by_hand(command, dry=0.0):
    """Angles of the arm under the DC motor, and dry friction as a steep arctangent."""
    inertia = 0.6 * 0.15**2 + 0.012 + _CAPSULE

    def slope(_, x, goal):
        volts = float(np.clip(MOTOR["kp"] * (goal - x[0]) - MOTOR["kd"] * x[1], -MOTOR["voltage"], MOTOR["voltage"]))
        current = (volts - MOTOR["torque_constant"] * MOTOR["gear"] * x[1]) / MOTOR["resistance"]
        torque = MOTOR["gear"] * MOTOR["torque_constant"] * current - 0.05 * x[1]
        torque -= dry * 2.0 / np.pi * np.arctan(x[1] / 0.01) + 0.6 * 9.81 * 0.15 * np.sin(x[0])
        return x[1], torque / inertia

    x, out = np.zeros(2), []
    for goal in command:
        out.append(x[0])
        x = solve_ivp(slope, (0.0, 1.0 / RATE_HZ), x, args=(goal,), method="LSODA", rtol=1e-7, atol=1e-9).y[:, -1]
    return np.array(out)


def _inertia_about_centre():
    model = mujoco.MjModel.from_xml_string(xml())
    return float(model.body_inertia[1][0])


_CAPSULE = _inertia_about_centre()


def recorded(angles, seconds=8, count=5):
    """A run of an encoder with noise and steps, the last recording held out."""
    out, t = [], np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    for k in range(count):
        goal = goals(k, t)
        read = np.round((angles(goal) + 2e-4 * np.random.default_rng(50 + k).normal(size=t.size)) / 4e-4) * 4e-4
        info = RecordingInfo(f"r{k}.parquet", "noise", "reference",
                             role="validation" if k == count - 1 else "estimation")  # fmt: skip
        out.append(ls.Recording(info, RATE_HZ, {"goal_rad": goal, "a_rad": read}))
    return ls.Run(RATE_HZ, (), tuple(out))


def diagnosed(angles, **by_numbers):
    spec = mujoco.MjSpec.from_string(XML.format(dry=0.0, actuator="") if by_numbers else xml())
    name = "shoulder" if by_numbers else "servo"
    spread = {k: v for k, v in SPREAD.items() if k != "frictionloss"} if by_numbers else SPREAD
    columns, sensors = {name: ("goal_rad", 1.0)}, {"shoulder": ("a_rad", 1.0)}
    spread = spread | {"motor_constant": {name: 0.03}}
    model = machine(Mechanism("servo", spec, spread, columns, sensors, 0.8, **by_numbers))
    return ls.gap(recorded(angles), model=model, table=False)


def test_a_fix_of_a_servo_stands_in_its_model_as_by_hand():
    mechanism = Mechanism(
        "servo",
        mujoco.MjSpec.from_string(xml()),
        SPREAD,
        {"servo": ("goal_rad", 1.0)},
        {"shoulder": ("a_rad", 1.0)},
        0.8,
    )
    model = machine(mechanism)
    moves = {"kp_servo": 0.75, "limit_servo": 1.0, "frictionloss_shoulder": 0.2}
    fix = in_files(fix_of((), moves, {p.name: (p.value, p.unit) for p in model.parameters}, True), model, mechanism)
    goal = goals(1, np.arange(1000) / RATE_HZ)
    nominal, by_hand_, fixed = (
        stepped(text)(goal) for text in (xml(), xml(dry=0.2, kp=6.0, most=1.0), fix.texts["gap_fixed.xml"])
    )
    assert fix.left_to_you == ()
    assert np.abs(nominal - by_hand_).max() > 0.05  # it shows
    assert fixed == pytest.approx(by_hand_, abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize(
    ("changed", "effect", "size"),
    [
        pytest.param({}, "none", None, marks=pytest.mark.hour),
        pytest.param({"dry": 0.2}, "coulomb_friction@shoulder", 0.15, marks=pytest.mark.hour),
        ({"kp": 6.0}, "actuator_gain_error@servo", -0.25),
        pytest.param({"most": 1.0}, "actuator_saturation@servo", -2.0, marks=pytest.mark.hour),
    ],
)
def test_what_is_wrong_with_a_servo_of_mujoco_is_named_with_its_size(changed, effect, size):
    found = diagnosed(stepped(xml(**changed)))
    assert found.verdict == effect
    if size is not None:
        assert found.ranking[0].magnitude == pytest.approx(size, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize(
    ("dry", "effect"), [pytest.param(0.0, "none", marks=pytest.mark.hour), (0.1, "coulomb_friction@shoulder")]
)
def test_dry_friction_of_a_servo_by_numbers_is_named_with_its_size(dry, effect):
    found = diagnosed(lambda command: by_hand(command, dry), motors={"shoulder": MOTOR})
    assert found.verdict == effect
    if dry:
        assert found.ranking[0].magnitude == pytest.approx(dry, rel=0.1)


STICKING = """<mujoco><option timestep="0.0002" integrator="RK4"/><worldbody><body>
<joint name="rail" type="slide" axis="1 0 0" damping="5" frictionloss="3"/><geom size="0.1" mass="1"/>
</body></worldbody><actuator><motor name="drive" joint="rail"/></actuator></mujoco>"""


@pytest.mark.long
def test_a_right_mapping_of_an_axis_that_sticks_is_not_taken_for_a_wrong_unit():
    # about rest dry friction lets nothing move: there the axis seems to go 43 times as far as its motor should move it
    wave, m = np.sin(2.0 * np.pi * 0.7 * np.arange(4000) / RATE_HZ), mujoco.MjModel.from_xml_string(STICKING)
    force, data, x = 8.0 * np.sign(wave) * (np.abs(wave) > 0.3), mujoco.MjData(m), []
    for u in force:
        x.append(data.qpos[0])
        data.ctrl[0] = u
        mujoco.mj_step(m, data, 10)
    read = np.array(x) + 1e-5 * np.random.default_rng(1).normal(size=len(x))
    run = ls.Run(RATE_HZ, (), (ls.Recording(RecordingInfo("r.parquet", "noise", "reference"), RATE_HZ,
                                      {"f_n": force, "x_m": read}),))  # fmt: skip

    def checked(factor):
        spec, sensors = mujoco.MjSpec.from_string(STICKING), {"rail": ("x_m", 1.0)}
        plant = OwnMachine(machine(Mechanism("axis", spec, {}, {"drive": ("f_n", factor)}, sensors, 0.8)))
        mapping.check(plant.composed, [plant.prepare(run.recordings[0], run, None)])

    checked(1.0)
    with pytest.raises(ls.errors.WrongUseError, match="a sign is wrong"):
        checked(-1.0)
