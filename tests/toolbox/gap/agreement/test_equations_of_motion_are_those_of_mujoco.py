"""Equations of motion written out from a MuJoCo model's numbers: trajectories as MuJoCo's own engine steps them."""

import numpy as np
import pytest
from bench_nouns import RecordingInfo

import loopshape as ls
from loopshape.toolbox.gap.mechanism.mechanism import machine
from loopshape.toolbox.gap.nouns.machine import Mechanism
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.following import extended, simulated, simulated_along

mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")

# a slide and a hinge on one body, oblique axes, a branch, a bracket without a joint, a spring, a geared motor
XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="RK4" gravity="0.4 0.3 -9.7"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="base" pos="0.1 0 1" euler="0.2 0.1 -0.3">
      <joint name="rail" type="slide" axis="1 0.2 0" damping="2"/>
      <joint name="yaw" type="hinge" axis="0.1 0.3 1" pos="0.05 0 0.02" damping="0.1" armature="0.02"/>
      <geom type="box" size="0.1 0.06 0.04" mass="1.1" pos="0.02 0.01 0"/>
      <body name="bracket" pos="0 0.2 0" euler="0 0.5 0">
        <geom type="sphere" size="0.03" mass="0.2" pos="0 0 0.05"/>
        <body name="arm" pos="0 0 0.1">
          <joint name="lift" type="hinge" axis="1 0 0" damping="0.05" stiffness="1.5" springref="0.2"/>
          <geom type="capsule" fromto="0 0 0 0 0.05 -0.3" size="0.01" mass="0.4"/>
        </body>
      </body>
      <body name="tail" pos="-0.2 0 0">
        <joint name="sway" type="hinge" axis="0 1 0" ref="0.1" damping="0.03"/>
        <geom type="capsule" fromto="0 0 0 -0.2 0 0" size="0.02" density="900"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="rail" gear="3"/><motor name="hoist" joint="lift"/></actuator>
  <sensor><jointpos name="x" joint="rail"/><jointpos name="l" joint="lift"/><jointvel name="s" joint="sway"/></sensor>
</mujoco>
"""
COLUMNS = {"drive": ("u_v", 1.0), "hoist": ("h_nm", 1.0)}
SENSORS = {"x": ("x_m", 1.0), "l": ("l_rad", 1.0), "s": ("s_rad_s", 1.0)}


def built(window_s=1.0):
    return machine(Mechanism("odd", mujoco.MjSpec.from_string(XML), {}, COLUMNS, SENSORS, window_s))


@pytest.mark.long
@pytest.mark.short
def test_a_replay_is_the_one_that_mujoco_steps():
    model, n, keep = built(), 1200, 2
    rng = np.random.default_rng(5)
    u = np.repeat(rng.normal(0.0, 0.4, (n // 20, 2)), 20, axis=0)
    m = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(m)
    data.qpos[:], data.qvel[:] = [0.1, 0.2, -0.3, 0.4], [0.1, -0.5, 1.0, 0.2]
    x0, rows = np.concatenate([data.qpos, data.qvel]), []
    for k in range(n):
        data.ctrl[:] = u[k]
        mujoco.mj_forward(m, data)
        rows.append(data.sensordata.copy())
        for _ in range(keep):
            mujoco.mj_step(m, data)
    theirs = np.array(rows)
    names = [column for column, _ in (*COLUMNS.values(), *SENSORS.values())]
    columns = dict(zip(names, np.hstack([u, theirs]).T, strict=True))
    info = RecordingInfo("r.parquet", "noise", "reference", operating_point={})
    composed = Composed(model)
    f = simulated_along(composed, ls.Recording(info, 1000.0, columns), None)
    x = np.tile(x0, (len(f.first), 1))
    mine = simulated(composed, f, {}, extended(composed, f, x))[0]
    np.testing.assert_allclose(mine, f.measured[0], atol=2e-6)


def test_parameters_move_what_they_are_named_after():
    model = built()
    moved = {"payload_arm": 0.3, "length_arm": 0.05, "mass_base": 1.1, "damping_yaw": 0.3, "armature_yaw": 0.05}
    values = model.values() | moved
    far = np.array([0.0, 0.05, -0.3])
    longer = 1.0 + 0.05 / np.linalg.norm(far)
    end = " ".join(f"{v:.17g}" for v in longer * far)
    other = XML.replace('fromto="0 0 0 0 0.05 -0.3" size="0.01" mass="0.4"/>',
                        f'fromto="0 0 0 {end}" size="0.01" mass="{0.4 * longer:.17g}"/>'
                        f'<geom type="sphere" size="1e-4" pos="{end}" mass="0.3"/>')  # fmt: skip
    rotor = ('damping="0.1" armature="0.02"', 'damping="0.3" armature="0.05"')
    other = other.replace('mass="1.1"', 'mass="1.21"').replace(*rotor)
    m = mujoco.MjModel.from_xml_string(other)
    data = mujoco.MjData(m)
    data.qpos[:], data.qvel[:], data.ctrl[:] = [0.1, 0.2, -0.3, 0.4], [0.1, -0.5, 1.0, 0.2], [0.3, -0.2]
    mujoco.mj_forward(m, data)
    u = [{"drive": 3.0 * 0.3, "hoist": -0.2}.get(i.name, 0.0) for i in model.inputs]
    mine = model.motion(0.0, [*data.qpos, *data.qvel], u, model.derived(tuple(values.values())))
    np.testing.assert_allclose(mine[4:], data.qacc, rtol=1e-6, atol=1e-7)


def test_a_lean_of_the_base_is_a_turn_about_the_first_hinge():
    xml = XML.replace('axis="0.1 0.3 1" pos="0.05 0 0.02"', 'axis="0 1 0"').replace('gravity="0.4 0.3 -9.7"', "")
    model = machine(Mechanism("odd", mujoco.MjSpec.from_string(xml), {}, COLUMNS, SENSORS))
    leaned = model.derived(tuple((model.values() | {"tilt": 0.1}).values()))
    gravity = [getattr(leaned, f"gravity_{k}") for k in (0, 2)]
    assert gravity == pytest.approx([9.81 * np.sin(0.1), -9.81 * np.cos(0.1)])
