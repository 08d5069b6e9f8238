"""A joint that a position servo drives, its link behind a spring, as MuJoCo steps it: named, with its size."""

import numpy as np
import pytest
from bench_nouns import RecordingInfo

import loopshape as ls

mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
RATE_HZ, STEPS = 250.0, 8
XML = """
<mujoco><compiler angle="radian"/><option timestep="0.0005" integrator="RK4"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody><body name="arm">
    <joint name="hinge" axis="0 1 0" damping="0.05" armature="0.004"/>{twist}
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
  </body></worldbody>
  <actuator><position name="servo" joint="hinge" kp="12" kv="0.3" forcerange="-3 3"/></actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
</mujoco>
"""
TOML = """
format = "loopshape-model/1"
mujoco = "servo.xml"
window_s = 0.8
[spread]
mass = { arm = 0.03 }
damping = { hinge = 0.10 }
armature = { hinge = 0.05 }
[actuators]
servo = { column = "goal_rad" }
[sensors]
angle = { column = "a_rad" }
"""


def stepped(xml, goal, stiff=0.0):
    """Angle (n,) of the rotor; the link turns against it by a second joint, through a spring of the test's."""
    m = mujoco.MjModel.from_xml_string(xml)
    data, out = mujoco.MjData(m), []
    for held in goal:
        out.append(data.sensordata[0] if out else 0.0)
        data.ctrl[0] = held
        for _ in range(STEPS):
            if stiff:
                data.qfrc_applied[1] = -stiff * data.qpos[1] - 0.01 * data.qvel[1]
            mujoco.mj_step(m, data)
        mujoco.mj_forward(m, data)
    return np.array(out)


def goal_of(k):
    rng, n = np.random.default_rng(k), 2000
    steps = 0.3 * np.repeat(rng.uniform(-1, 1, n // 50), 50)
    return steps + 0.2 * np.sin(2 * np.pi * rng.uniform(0.3, 3) * np.arange(n) / RATE_HZ)


def recorded(k, role, **coupling):
    goal, rng = goal_of(k), np.random.default_rng(50 + k)
    read = stepped(XML.format(twist='<joint name="twist" axis="0 1 0"/>'), goal, **coupling)
    info = RecordingInfo(f"r{k}.parquet", "noise", "control", role=role)
    return ls.Recording(info, RATE_HZ, {"goal_rad": goal, "a_rad": read + 2e-5 * rng.standard_normal(goal.size)})


@pytest.mark.hour
@pytest.mark.long
def test_a_spring_behind_a_position_servo_is_named_with_its_size_and_its_mjcf_moves_as_the_machine(tmp_path):
    (tmp_path / "servo.xml").write_text(XML.format(twist=""))
    (tmp_path / "model.toml").write_text(TOML)
    roles = {0: "estimation", 1: "estimation", 2: "estimation", 9: "validation"}
    run = ls.Run(RATE_HZ, (), [recorded(k, role, stiff=15.0) for k, role in roles.items()])
    found = ls.gap(run, model=tmp_path / "model.toml", table=False)
    assert found.verdict == "joint_flexibility@hinge"
    assert found.ranking[0].magnitude == pytest.approx(15.0, rel=0.15)
    assert found.gap.after < 0.1 * found.gap.before
    goal, machine = goal_of(9), XML.format(twist='<joint name="twist" axis="0 1 0"/>')
    mine, plain = (stepped(xml, goal) for xml in (found.fix.texts[found.fix.file], XML.format(twist="")))
    theirs = stepped(machine, goal, stiff=15.0)
    assert np.sqrt(np.mean((mine - theirs) ** 2)) < 0.05 * np.sqrt(np.mean((plain - theirs) ** 2))
