"""Actuators at joints and dry friction in equations of motion: what MuJoCo's own engine makes of the model."""

import re

import numpy as np
import pytest
from bench_nouns import RecordingInfo
from scipy.integrate import solve_ivp

import loopshape as ls
from loopshape.toolbox.gap.mechanism.mechanism import machine
from loopshape.toolbox.gap.mechanism.numbers import Numbers
from loopshape.toolbox.gap.nouns.machine import Mechanism
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.following import extended, simulated, simulated_along
from loopshape.toolbox.gap.own.kernel import Driving

mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")

# an arm of a lift, a shoulder with a weak motor beside the actuator that is tried, and an elbow without any
XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0001" integrator="RK4"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="carriage">
      <joint name="lift" type="slide" axis="0 0 1" damping="4" stiffness="120"/>
      <geom type="box" size="0.1 0.06 0.04" mass="0.9"/>
      <body name="upper">
        <joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.02" ref="0.1" {joint}/>
        <geom name="upper_tube" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="{mass}"/>
        <body name="fore" pos="0 0 -0.3">
          <joint name="elbow" axis="0.2 1 0" damping="0.02" {elbow}/>
          <geom type="capsule" fromto="0 0 0 0 0.02 -0.25" size="0.02" mass="0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
  <sensor><jointpos name="angle" joint="shoulder"/></sensor>
</mujoco>
"""
KINDS = {
    "motor": '<motor ctrlrange="-0.4 0.3" forcerange="-2 1.5"',
    "position": '<position kp="12" kv="0.4"',
    "position, clamped": '<position kp="30" kv="0.4" ctrlrange="-0.5 0.4" forcerange="-1.5 2"',
    "position of a damping ratio": '<position kp="12" dampratio="0.7"',
    "position behind a filter": '<position kp="12" kv="0.4" timeconst="0.05"',
    "velocity": '<velocity kv="0.8"',
    "intvelocity": '<intvelocity kp="14" kv="0.2" actrange="-0.4 0.3"',
    "damper": '<damper kv="0.7" ctrlrange="0 1"',
    "cylinder": '<cylinder timeconst="0.07" area="3" bias="0.2 -1.5 -0.3"',
    "affine": '<general gaintype="affine" gainprm="2 0.7 -0.2" biastype="affine" biasprm="0.3 -4 -0.2"',
    "bias that is switched off": '<general gainprm="2 0.7 -0.2" biasprm="0.3 -4 -0.2"',
    "integrator": '<general dyntype="integrator" gainprm="3" actlimited="true" actrange="-0.2 0.3"',
    "filter": '<general dyntype="filter" dynprm="0.03" gainprm="3" forcerange="-1 0.5"',
    "filterexact": '<general dyntype="filterexact" dynprm="0.3" gainprm="3" biastype="affine" biasprm="0 0 -0.4"',
}


def text(kind, gear=1.0, more="", joint="", mass=0.6, elbow=""):
    own = f'{kind} name="tried" joint="shoulder" gear="{gear}"/>'
    return XML.format(actuators=f'{own}<motor name="up" joint="lift" gear="5"/>{more}', joint=joint, mass=mass,
                      elbow=elbow)  # fmt: skip


def built(xml, spread=None, **more):
    columns = {"tried": ("goal", 1.0), "up": ("up_n", 1.0)}
    spec = mujoco.MjSpec.from_string(xml)
    return machine(Mechanism("arm", spec, spread or {}, columns, {"angle": ("a_rad", 1.0)}, **more))


def driven(model, commands):
    """Inputs of a model (nu,) for commands by name: factors and limits as a recording's columns get them."""
    values = [i.factor * commands.get(i.name, 0.0) for i in model.inputs]
    return np.array([v if i.limits is None else np.clip(v, *i.limits)
                     for v, i in zip(values, model.inputs, strict=True)])  # fmt: skip


def stepped(xml, commands, hold, start):
    """States (rows, nq + nv + na) by MuJoCo's own steps, commands (rows, nu) each held for `hold` steps."""
    m = mujoco.MjModel.from_xml_string(xml)
    data, out = mujoco.MjData(m), []
    data.qpos[:], data.qvel[:] = start[: m.nq], start[m.nq : m.nq + m.nv]
    data.act[:] = start[m.nq + m.nv :]
    for row in commands:
        data.ctrl[:] = row
        mujoco.mj_step(m, data, hold)
        out.append(np.concatenate([data.qpos, data.qvel, data.act]))
    return np.array(out)


def integrated(model, commands, hold_s, start, **values):
    """The same by scipy's integrator along the model's right-hand side."""
    p, x, out = model.derived(tuple((model.values() | values).values())), start, []
    names = ["tried", "up"]
    for row in commands:
        u = driven(model, dict(zip(names, row, strict=False)))
        x = solve_ivp(lambda t, y, u=u: model.motion(t, y, u, p), (0.0, hold_s), x, rtol=1e-8, atol=1e-10).y[:, -1]
        out.append(x)
    return np.array(out)


@pytest.mark.long
@pytest.mark.parametrize("gear", [1.0, -2.5])
@pytest.mark.parametrize("kind", KINDS)
def test_an_actuator_drives_the_arm_as_mujoco_steps_it(kind, gear):
    # MuJoCo's exact filter is of first order in the step: 10, 2.6, 0.64 mrad/s off at 100, 25, 6 us
    rng, xml = np.random.default_rng(1), text(KINDS[kind], gear)
    model = built(xml)
    states = len(model.states) - 6
    start = np.concatenate([[0.0, 0.3, -0.2], rng.normal(0.0, 0.5, 3), rng.uniform(-0.2, 0.2, states)])
    commands = np.column_stack([rng.uniform(-1.0, 1.0, 25), rng.uniform(-1.0, 1.0, 25)])
    finer = 10 if {"timeconst", "filterexact"} & set(re.split(r"\W", KINDS[kind])) else 1
    theirs = stepped(xml.replace('"0.0001"', f'"{1e-4 / finer}"'), commands, 200 * finer, start)
    mine = integrated(model, commands, 0.02, start)
    assert np.ptp(theirs[:, 1]) > 0.03
    np.testing.assert_allclose(mine, theirs, atol=3e-5 * finer * np.max(np.abs(theirs)))


KINDS_OF_RECORDS = {
    "motor": KINDS["motor"], "clamped": KINDS["position, clamped"],
    "of a mode faster than the ticks": '<position kp="900" kv="90" forcerange="-60 60"',
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS_OF_RECORDS)
def test_a_recorded_command_beyond_its_range_is_what_mujoco_makes_of_it(kind):
    xml = text(KINDS_OF_RECORDS[kind])
    model, rng = built(xml), np.random.default_rng(8)
    commands = np.repeat(np.column_stack([rng.uniform(-1.0, 1.0, 60), np.zeros(60)]), 10, axis=0)
    start = np.array([0.0, 0.3, -0.2, 0.1, 0.5, 0.0])
    angle = np.concatenate([[0.3], stepped(xml, commands, 20, start)[:-1, 1]])
    columns = {"goal": commands[:, 0], "up_n": commands[:, 1], "a_rad": angle}
    composed = Composed(model)
    f = simulated_along(composed, ls.Recording(RecordingInfo("r.parquet", "noise", "reference"), 500.0, columns), None)
    mine = simulated(composed, f, {}, extended(composed, f, start[None]))
    np.testing.assert_allclose(mine, f.measured, atol=2e-4)


def test_meshes_that_no_inertia_is_made_of_are_left_out_and_nothing_moves():
    corners = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
    xml = (
        text(KINDS["position"])
        .replace(
            "<worldbody>",
            f"""
      <asset><mesh name="cover" vertex="{corners}"/><mesh name="block" vertex="{corners}"/></asset><worldbody>
      <geom type="mesh" mesh="cover"/>""",
        )
        .replace(
            '<joint name="elbow"',
            """
      <geom type="mesh" mesh="block" density="700"/><joint name="elbow\"""",
        )
        .replace(
            '<body name="carriage">',
            """
      <body name="carriage"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="cover"/>""",
        )
    )
    spec = mujoco.MjSpec.from_string(xml)
    numbers = Numbers(Mechanism("arm", spec, {}, {}, {}))
    assert [mesh.name for mesh in numbers._light.meshes] == ["block"]
    built(xml)  # compares equations without them with the model that has them


def test_a_model_without_gravity_has_none_and_leans_nowhere():
    xml = text(KINDS["motor"]).replace("integrator", 'gravity="0 0 -9" integrator')
    off = xml.replace("<worldbody>", '<option><flag gravity="disable"/></option><worldbody>')
    assert "tilt" in built(xml).values()
    assert "tilt" not in built(off).values()


def test_actuators_of_one_joint_add_up_below_what_the_joint_takes():
    more = '<velocity name="brake" joint="shoulder" kv="0.5"/>'
    xml = text(KINDS["position"], more=more, joint='actuatorfrcrange="-1 0.8"')
    model, rng = built(xml), np.random.default_rng(3)
    start, commands = np.array([0.0, 0.3, -0.2, 0.1, 0.5, 0.0]), rng.uniform(-1.0, 1.0, (25, 3)) * [1.0, 1.0, 0.0]
    mine, theirs = integrated(model, commands, 0.02, start), stepped(xml, commands, 200, start)
    np.testing.assert_allclose(mine, theirs, atol=3e-5 * np.max(np.abs(theirs)))


def accelerations(xml, qpos, qvel, ctrl):
    m = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(m)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
    mujoco.mj_forward(m, data)
    return data.qacc.copy()


@pytest.mark.parametrize(
    ("kind", "moved", "other"),
    [
        ('<position kp="12" kv="0.4"', {"gain_tried": 1.3}, '<position kp="15.6" kv="0.52"'),
        ('<position kp="12" kv="0.4"', {"kp_tried": 1.3}, '<position kp="15.6" kv="0.4"'),
        ('<position kp="12" dampratio="0.7"', {"mass_upper": 1.5}, None),
        ('<position kp="12" kv="0.4" forcerange="-3 3"', {"limit_tried": 2.0, "gain_tried": 1.3},
         '<position kp="15.6" kv="0.52" forcerange="-1 1"'),
        ('<velocity kv="2"', {"mass_upper": 0.8, "gain_tried": 0.5}, '<velocity kv="1"'),
    ],
)  # fmt: skip
def test_a_parameter_moves_the_equations_as_mujoco_compiles_the_changed_model(kind, moved, other):
    # the limit is of the effort at the joint: 1 N m times a gear of 2
    model = built(text(kind, 2.0))
    changed = text(other or kind, 2.0, mass=0.6 * moved.get("mass_upper", 1.0))
    p, rng = model.derived(tuple((model.values() | moved).values())), np.random.default_rng(1)
    for _ in range(6):
        q, v, ctrl = rng.normal(0.0, 0.4, 3), rng.normal(0.0, 1.0, 3), rng.uniform(-1.0, 1.0, 2)
        mine = model.motion(0.0, [*q, *v], driven(model, {"tried": ctrl[0], "up": ctrl[1]}), p)[3:]
        np.testing.assert_allclose(mine, accelerations(changed, q, v, ctrl), rtol=1e-6, atol=1e-8)


def test_units_of_commands_and_what_a_command_cannot_have():
    units = {kind: next(i for i in built(text(KINDS[kind])).inputs if i.name == "tried").unit for kind in KINDS}
    assert units["motor"] == "N m"
    assert units["position"] == units["position behind a filter"] == "rad"
    assert units["velocity"] == units["intvelocity"] == "rad/s"
    model = built(text(KINDS["position"]), {"motor_constant": {"tried": 0.05, "up": 0.02}})
    tried, up, shoulder, elbow = model.inputs
    assert tried.without == ("actuator_saturation", "dead_zone")
    assert pendulum(motors={"hinge": MOTOR}).inputs[0].without == ()
    assert (up.without, up.tolerance, shoulder.name, elbow.name) == ((), 0.02, "shoulder_effort", "elbow")
    gain = next(p for p in model.parameters if p.name == "gain_tried")
    assert (gain.tolerance, gain.effect) == (0.05, "actuator_gain_error@tried")
    ports = {port.name: port for port in model.ports}
    assert (ports["shoulder"].input, ports["shoulder"].motor_inertia) == ("shoulder_effort", "armature_shoulder")
    assert ports["elbow"].motor_inertia is None
    motor = {port.name: port for port in built(text(KINDS["motor"])).ports}["shoulder"]
    assert (motor.input, motor.motor_inertia) == ("tried", "armature_shoulder")


def through(twist, slip, play):
    """Effort through a spring of 40 N m/rad behind play."""
    bent = np.sign(twist) * max(abs(twist) - 0.5 * play, 0.0)
    return 0.0 if bent == 0.0 else 40.0 * bent + 0.05 * slip


def behind_a_coupling(xml, commands, hold, play):
    """Angles (rows, 2) of rotor and link, the link turning against the rotor by a second joint of its own."""
    second = '<joint name="twist" axis="0 1 0"/><geom name="upper_tube"'
    m = mujoco.MjModel.from_xml_string(xml.replace('<geom name="upper_tube"', second))
    data, out = mujoco.MjData(m), []
    at = {name: int(m.joint(name).qposadr[0]) for name in ("shoulder", "twist")}
    data.qpos[at["shoulder"]] = 0.1
    for row in commands:
        data.ctrl[:] = row
        out.append([data.qpos[at["shoulder"]], data.qpos[at["shoulder"]] + data.qpos[at["twist"]]])
        for _ in range(hold):
            data.qfrc_applied[at["twist"]] = through(-data.qpos[at["twist"]], -data.qvel[at["twist"]], play)
            mujoco.mj_step(m, data)
    return np.array(out)


@pytest.mark.parametrize("kind", ["position, clamped", "position behind a filter", "affine"])
def test_a_servo_behind_a_spring_or_play_sees_the_rotor_as_mujoco_steps_it(kind):
    xml, rng, hold = text(KINDS[kind]), np.random.default_rng(4), 20
    model = built(xml)
    c, at, armature, damping = Composed(model), "port.shoulder.", 0.02, 0.05
    moves = {
        at + "inertia": armature, "change.armature_shoulder": -armature * (1.0 - 1e-6),
        at + "motor_damping": damping, "change.damping_shoulder": -damping * (1.0 - 1e-6),
        at + "coupling": 40.0, at + "coupling_damping": 0.05,
    }  # fmt: skip
    commands = np.repeat(np.column_stack([rng.uniform(-0.6, 0.6, 20), np.zeros(20)]), 20, axis=0)
    drive = np.array([driven(model, {"tried": row[0]}) for row in commands])
    nx = len(model.states)
    x0, out = np.zeros((1, nx + 3 * len(model.ports))), np.empty((1, len(drive), nx))
    shoulder = model.states.index("shoulder")
    x0[0, shoulder] = x0[0, nx + 3 * [p.name for p in model.ports].index("shoulder") + 1] = 0.1
    for play in (0.0, 0.03):
        driving = Driving(np.zeros(1, dtype=np.int64), drive, 0.002, 20)
        c.run(moves | {at + "play": play}, c.values(moves), x0, driving, out)
        theirs = behind_a_coupling(xml, commands, hold, play)
        twist = np.max(np.abs(theirs[:, 1] - theirs[:, 0]))
        assert twist > 5e-3
        np.testing.assert_allclose(out[0, :, shoulder], theirs[:, 0], atol=0.03 * twist)


def test_friction_of_a_servos_gear_grows_with_the_effort_that_its_law_gives():
    xml = text(KINDS["position, clamped"])
    model, rng = built(xml), np.random.default_rng(5)
    c, at = Composed(model), "port.shoulder."
    commands = np.repeat(np.column_stack([rng.uniform(-0.6, 0.6, 20), np.zeros(20)]), 20, axis=0)
    m = mujoco.MjModel.from_xml_string(xml)
    data, theirs = mujoco.MjData(m), []
    shoulder = model.states.index("shoulder")
    data.qpos[shoulder] = 0.1
    for row in commands:
        data.ctrl[:] = row
        theirs.append(data.qpos[shoulder])
        for _ in range(20):
            mujoco.mj_forward(m, data)
            dry = (0.05 + 0.3 * abs(data.qfrc_actuator[shoulder])) * np.tanh(data.qvel[shoulder] / 0.05)
            data.qfrc_applied[shoulder] = -dry
            mujoco.mj_step(m, data)
    drive = np.array([driven(model, {"tried": row[0]}) for row in commands])
    nx = len(model.states)
    mine = []
    for share in (0.3, 0.0):
        x0, out = np.zeros((1, nx + 3 * len(model.ports))), np.empty((1, len(drive), nx))
        x0[0, shoulder] = 0.1
        moves = {at + "coulomb": 0.05, at + "coulomb_speed": 0.05, at + "load": share}
        c.run(moves, c.values({}), x0, Driving(np.zeros(1, dtype=np.int64), drive, 0.002, 20), out)
        mine.append(out[0, :, shoulder])
    effect = np.sqrt(np.mean((mine[1] - theirs) ** 2))
    assert np.sqrt(np.mean((mine[0] - theirs) ** 2)) < 0.02 * effect


@pytest.mark.long
@pytest.mark.parametrize("kind", ["motor", "position"])
def test_dry_friction_of_a_joint_holds_and_slides_as_in_mujoco(kind):
    kinds = {"motor": "<motor", "position": '<position kp="12" kv="0.4"'}
    xml = text(kinds[kind], joint='frictionloss="0.5"', elbow='frictionloss="0.05"')
    model, hold = built(xml), 200
    t = np.arange(200) * 0.02
    swing = {"motor": 1.6, "position": 0.7}[kind] * np.sin(2.0 * np.pi * 0.5 * t)
    commands, start = np.column_stack([swing, np.zeros(t.size)]), np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    mine, theirs = integrated(model, commands, 0.02, start), stepped(xml, commands, hold, start)
    free = integrated(model, commands, 0.02, start, frictionloss_shoulder=0.0, frictionloss_elbow=0.0)
    off = np.sqrt(np.mean((mine - theirs)[:, 1:3] ** 2, axis=0))
    without = np.sqrt(np.mean((free - theirs)[:, 1:3] ** 2, axis=0))
    assert np.all(off < 0.03 * without), (off, without)


def test_dry_friction_has_a_tolerance_and_a_name():
    xml = text("<motor", joint='frictionloss="0.5"')
    model = built(xml, {"frictionloss": {"shoulder": 0.2}})
    found = next(p for p in model.parameters if p.name == "frictionloss_shoulder")
    assert (found.value, found.tolerance, found.unit) == (0.5, 0.2, "N m")
    assert (found.effect, found.range) == ("coulomb_friction@shoulder", (-0.5, 2.0))


MOTOR = {"resistance": 2.1, "torque_constant": 0.012, "gear": 120.0, "voltage": 6.0}
PENDULUM = """<{root}><compiler angle="radian"/><worldbody><body name="bob">
<joint name="hinge" axis="0 1 0" damping="0.02" armature="0.01"/>
<geom type="sphere" size="0.04" pos="0 0 -0.2" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
{actuator}</{root}>"""


def pendulum(actuator="", **more):
    spec = mujoco.MjSpec.from_string(PENDULUM.format(root="mujoco", actuator=actuator))
    return machine(Mechanism("servo", spec, {}, {"hinge": ("u", 1.0)}, {"hinge": ("a_rad", 1.0)}, **more))


def by_hand(motor, command, x):
    """Angle, speed and integral of a pendulum under a DC motor with a firmware's law, from the textbook."""
    q, v, s = x
    volts = command
    if "kp" in motor:
        volts = motor["kp"] * (command - q) + motor.get("ki", 0.0) * s - motor.get("kd", 0.0) * v
    volts = float(np.clip(volts, -motor["voltage"], motor["voltage"]))
    current = (volts - motor.get("back_emf", motor["torque_constant"]) * motor["gear"] * v) / motor["resistance"]
    torque = motor["gear"] * motor["torque_constant"] * current
    inertia = 0.5 * 0.2**2 + 0.4 * 0.5 * 0.04**2 + 0.01
    return v, (torque - 0.02 * v - 0.5 * 9.81 * 0.2 * np.sin(q)) / inertia, command - q


@pytest.mark.parametrize("law", [{}, {"kp": 20.0}, {"kp": 20.0, "kd": 0.5}, {"kp": 9.0, "ki": 12.0, "kd": 0.2},
                                 {"back_emf": 0.015}])  # fmt: skip
def test_a_motor_by_numbers_is_the_one_of_the_textbook(law):
    motor, rng = MOTOR | law, np.random.default_rng(4)
    model = pendulum(motors={"hinge": motor})
    p = model.derived(tuple(model.values().values()))
    assert model.inputs[0].unit == ("rad" if "kp" in law else "V")
    for _ in range(50):  # voltages on both sides of the supply's, integrals within it
        x = np.append(rng.normal(0.0, [0.5, 3.0]), rng.uniform(-0.4, 0.4))
        command = rng.normal(0.0, 0.6 if "kp" in law else 5.0)
        u = np.array([command if model.inputs[0].limits is None else np.clip(command, *model.inputs[0].limits), 0.0])
        mine = model.motion(0.0, x[: len(model.states)], u, p)
        np.testing.assert_allclose(mine, by_hand(motor, command, x)[: len(model.states)], rtol=1e-9, atol=1e-9)
    held = motor["gear"] * motor["torque_constant"] * motor["voltage"] / motor["resistance"]
    assert model.values().get("limit_hinge", held) == pytest.approx(held)


@pytest.mark.skipif(not hasattr(mujoco.mjtGain, "mjGAIN_DCMOTOR"), reason="MuJoCo without <dcmotor>")
def test_a_motor_of_volts_is_the_one_of_mujoco():
    own = pendulum(motors={"hinge": MOTOR})
    tag = (f'<actuator><dcmotor joint="hinge" motorconst="{MOTOR["torque_constant"]}" input="voltage" '
           f'resistance="{MOTOR["resistance"]}" gear="120" ctrlrange="-6 6"/></actuator>')  # fmt: skip
    m = mujoco.MjModel.from_xml_string(PENDULUM.format(root="mujoco", actuator=tag))
    data, p, rng = mujoco.MjData(m), own.derived(tuple(own.values().values())), np.random.default_rng(2)
    for _ in range(5):
        data.qpos[:], data.qvel[:], data.ctrl[:] = rng.normal(), rng.normal(0.0, 4.0), rng.uniform(-6.0, 6.0)
        mujoco.mj_forward(m, data)
        mine = own.motion(0.0, [*data.qpos, *data.qvel], np.array([data.ctrl[0], 0.0]), p)
        np.testing.assert_allclose(mine[1], data.qacc[0], rtol=1e-7)


def test_an_integral_of_a_firmware_stops_where_the_supply_does():
    model = pendulum(motors={"hinge": MOTOR | {"kp": 9.0, "ki": 12.0}})
    p = model.derived(tuple(model.values().values()))
    rate = [model.motion(0.0, [0.0, 0.0, s], np.array([0.4, 0.0]), p)[2] for s in (-0.5, 0.49, 0.51)]
    assert rate == pytest.approx([0.4, 0.4, 0.0])


def test_a_joint_may_be_a_motor_and_a_sensor_without_being_one_in_the_model():
    model = pendulum()
    assert [(i.name, i.column, i.unit) for i in model.inputs] == [("hinge", "u", "N m")]
    assert [(o.name, o.state) for o in model.outputs] == [("hinge", "hinge")]
    p = model.derived(tuple(model.values().values()))
    inertia = 0.5 * 0.2**2 + 0.4 * 0.5 * 0.04**2 + 0.01
    assert model.motion(0.0, [0.0, 0.0], np.array([0.3]), p)[1] == pytest.approx(0.3 / inertia)


@pytest.mark.long
def test_the_state_of_a_filter_is_known_from_the_commands():
    # told from the motion it would be one with a speed: at the first compared sample it has long been forgotten
    xml = text(KINDS["filter"].replace("0.03", "0.05"))
    model, rng = built(xml, window_s=0.5), np.random.default_rng(9)
    commands = np.repeat(np.column_stack([rng.uniform(-0.5, 0.5, 100), np.zeros(100)]), 10, axis=0)
    rows = np.vstack([np.zeros(7), stepped(xml, commands, 20, np.zeros(7))[:-1]])
    columns = {"goal": commands[:, 0], "up_n": commands[:, 1], "a_rad": rows[:, 1]}
    composed = Composed(model)
    f = simulated_along(composed, ls.Recording(RecordingInfo("r.parquet", "noise", "reference"), 500.0, columns), None)
    state = model.states.index("tried_activation")
    assert composed.lags == pytest.approx({state: 1.0 / 0.05})
    assert f.first[0] == 75
    np.testing.assert_allclose(f.start[:, state], rows[f.first, 6], atol=0.03)
    assert state not in composed.free_states({})


def test_a_state_that_holds_what_it_was_given_is_estimated():
    composed = Composed(built(text(KINDS["intvelocity"])))
    state = composed.model.states.index("tried_activation")
    assert (composed.lags, state in composed.free_states({})) == ({}, True)
