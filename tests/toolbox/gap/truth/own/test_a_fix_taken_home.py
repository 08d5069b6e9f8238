"""A fix reloaded moves as predicted: the patched MJCF stepped by MuJoCo, the function around a user's right-hand side.

Predicted is what the diagnosis simulates with the effect's moves; the truth is `mj_step` of models that the test
writes by hand, and of patched ones.
"""

import ast
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.gap.commands.gap import write_beside
from loopshape.toolbox.gap.mechanism.fix import in_files
from loopshape.toolbox.gap.nouns.effect import NotWritten, fix_of
from loopshape.toolbox.gap.nouns.machine import Kind, Mechanism
from loopshape.toolbox.gap.own.catalogue import PortScale, Scales, forms
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.kernel import Driving
from loopshape.toolbox.gap.own.kinds import with_kinds
from loopshape.toolbox.gap.own.signals import actuated, sensed

STEP_S, ROWS, HOLD = 0.0005, 2400, 20
TIMES = STEP_S * np.arange(ROWS)
XML = """
<mujoco model="winch">
  <compiler angle="{angle}"/>
  <option timestep="0.0005" integrator="{engine}" gravity="{gravity}"/>
  <worldbody>
    <body name="lever" euler="0 {lean} 0">
      <joint name="bearing" type="hinge" axis="0 1 0" {joint}/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 {rod}" size="0.01" mass="{mass}" contype="0" conaffinity="0"/>
      {more}
      <body name="hand" pos="0 0 {rod}">
        <joint name="wrist" type="hinge" axis="0 1 0" damping="0.01" stiffness="0.5"/>
        <geom type="capsule" fromto="0 0 0 0.05 0 -0.15" size="0.01" mass="0.15" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>{motor}</actuator>
  <sensor><jointpos name="encoder" joint="bearing"/><jointpos name="wrist" joint="wrist"/></sensor>
</mujoco>
"""
PLAIN = {
    "angle": "radian", "gravity": "0 0 -9.81", "rod": "-0.3", "mass": "0.25", "more": "", "lean": "0", "engine": "RK4",
    "joint": 'damping="0.05" armature="0.0137" stiffness="0.8" springref="0.1"',
    "motor": '<motor name="drum" joint="bearing" gear="2"/>',
}  # fmt: skip
JOINT = 'damping="{}" armature="{}" stiffness="{}" springref="{}" frictionloss="{}"'
COLUMNS = {"drum": ("drum_v", 1.0)}
SENSORS = {"encoder": ("lever_rad", 1.0), "wrist": ("wrist_rad", 1.0)}


def written(**other):
    return XML.format(**(PLAIN | other))


@cache
def composed(model):
    return Composed(model)


@cache
def mechanism(text=None, kinds=()):
    mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    spec = mujoco.MjSpec.from_string(text or written())
    return Mechanism("winch", spec, {}, COLUMNS, SENSORS, kinds=kinds)


@cache
def machine_of(m):
    from loopshape.toolbox.gap.mechanism.mechanism import machine

    return with_kinds(machine(m), m.kinds)


def moved(model, moves):
    """The fix that a diagnosis hands over where it found these moves."""
    rows = composed(model).table.rows
    return fix_of((), moves, {row.name: (row.value, row.unit) for row in rows}, True)


def command():
    """A held multisine, in volts (n,)."""
    u = 0.3 * np.sin(9.0 * TIMES) + 0.2 * np.sin(23.0 * TIMES)
    return np.repeat(u[::HOLD], HOLD)


def stepped(text, *, force=None, signal=None, reading=None):
    """Sensors (n, 2) as MuJoCo steps them from rest; `force` of position, speed, effort and t, at the bearing."""
    mujoco = pytest.importorskip("mujoco")
    m = mujoco.MjModel.from_xml_string(text)
    data, u, out = mujoco.MjData(m), command(), []
    for k in range(ROWS):
        mujoco.mj_forward(m, data)
        out.append(data.sensordata.copy())
        q, v, t = data.qpos[0], data.qvel[0], k * STEP_S
        data.ctrl[0] = u[k] + (0.0 if signal is None else signal(q, v, 2.0 * u[k], t) / 2.0)
        data.qfrc_applied[0] = 0.0 if force is None else force(q, v, 2.0 * u[k], t)
        mujoco.mj_step(m, data)
    read = np.array(out)
    if reading is not None:
        read[:, 0] += [reading(0.0, 0.0, y, k * STEP_S) for k, y in enumerate(read[:, 0])]
    return read


def predicted(model, moves):
    """The same as the diagnosis simulates it."""
    c, nx, ny = composed(model), len(model.states), len(model.outputs)
    drive = np.zeros((ROWS, len(model.inputs)))
    drive[:, 0] = actuated(model.inputs[0].factor * command(), c.actuator(0, moves), STEP_S)
    x0, out = np.zeros((1, nx + 3 * len(model.ports))), np.empty((1, ROWS, nx))
    c.run(moves, c.values(moves), x0, Driving(np.zeros(1, dtype=np.int64), drive, STEP_S, 2), out)
    states = [out[0, :, model.states.index(o.state)] for o in model.outputs]
    return np.stack([sensed(states[k], c.sensor(k, moves), STEP_S) for k in range(ny)], axis=1)


def share(a, b, nominal):
    """Rms of what two motions differ by, as a share of what the effect does."""
    return float(np.sqrt(np.mean((a - b) ** 2)) / np.sqrt(np.mean((b - nominal) ** 2)))


CASES = {
    "mass": ({"mass_lever": 1.4}, {"mass": "0.35"}, 1e-3),
    "payload": ({"change.payload_hand": 0.08, "place_hand": 0.9},
                {"more": "", "hand": (0.08, (0.045, 0.0, -0.135))}, 1e-3),
    "viscous": ({"port.bearing.viscous": 0.03}, {"joint": JOINT.format(0.08, 0.0137, 0.8, 0.1, 0)}, 1e-3),
    "coulomb": ({"port.bearing.coulomb": 0.12, "port.bearing.coulomb_speed": 2e-3},
                {"joint": JOINT.format(0.05, 0.0137, 0.8, 0.1, 0.12)}, 0.06),
    "armature": ({"armature_bearing": 0.02}, {"joint": JOINT.format(0.05, 0.02, 0.8, 0.1, 0)}, 1e-3),
    "spring": ({"port.bearing.stiffness": 0.4, "port.bearing.rest": 0.4},
               {"joint": JOINT.format(0.05, 0.0137, 1.2, 0.2, 0)}, 1e-3),
    "offset": ({"port.bearing.offset": 0.16}, {"joint": JOINT.format(0.05, 0.0137, 0.8, 0.3, 0)}, 1e-3),
    "length": ({"change.length_lever": 0.06}, {"rod": "-0.36", "mass": "0.3"}, 1e-3),
    "gain": ({"input.drum.gain": 0.2}, {"motor": '<motor name="drum" joint="bearing" gear="2.4"/>'}, 1e-3),
    "limit": ({"input.drum.limit": 0.4},
              {"motor": '<motor name="drum" joint="bearing" gear="2" ctrlrange="-0.2 0.2" ctrllimited="true"/>'}, 1e-3),
    "tilt": ({"change.tilt": 0.15}, {"lean": "0.15"}, 1e-3),
    "lag": ({"input.drum.lag_ms": 15.0},
            {"motor": '<general name="drum" joint="bearing" gear="2" dyntype="filterexact" dynprm="0.015"/>'}, 0.02),
    "drag": ({"port.bearing.viscous": 0.05, "port.bearing.viscous_square": 0.6, "port.bearing.viscous_speed": 2.0},
             {"joint": JOINT.format("0.07 0.015", 0.0137, 0.8, 0.1, 0)}, 1e-3),
}  # fmt: skip


def in_hand(text, mass, at):
    geom = (
        f'<geom type="sphere" size="0.0001" mass="{mass}" pos="{at[0]} {at[1]} {at[2]}" contype="0" conaffinity="0"/>'
    )
    return text.replace('mass="0.15" contype="0" conaffinity="0"/>', f'mass="0.15" contype="0" conaffinity="0"/>{geom}')


def delay(text, attribute, late_s):
    """A model without delays: what it steps, with the command or the reading late by whole steps."""
    plain, n = stepped(text), round(late_s / STEP_S)
    if attribute == "reading":
        return plain, np.concatenate([np.repeat(plain[:1, 0], n), plain[:-n, 0]])
    return plain, stepped(text, signal=lambda q, v, effort, t: 2.0 * np.interp(t - late_s, TIMES, command()) - effort)


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_a_patched_mjcf_steps_as_predicted_and_as_one_written_by_hand(case):
    moves, other, tolerance = CASES[case]
    m = mechanism()
    if case == "drag" and np.ndim(m.spec.joint("bearing").damping) == 0:
        pytest.skip("this MuJoCo has no drag at joints")
    model = machine_of(m)
    fixed = in_files(moved(model, moves), model, m)
    hand = other.get("hand")
    truth = written(**{k: v for k, v in other.items() if k != "hand"})
    truth = in_hand(truth, *hand) if hand else truth
    plain, mine, by_hand = (stepped(text) for text in (written(), fixed.texts[fixed.file], truth))
    assert share(mine, by_hand, plain) < tolerance
    assert share(mine, predicted(model, moves), plain) < tolerance
    assert fixed.attributes
    assert {left.reason for left in fixed.left_to_you} <= {NotWritten.SHARPER}
    assert fixed.function is None


def test_a_patched_mjcf_is_late_as_predicted():
    """The command by an actuator's delay, the reading by a sensor's: MuJoCo 4 has attributes for both."""
    m = mechanism()
    model = machine_of(m)
    if not hasattr(m.spec.actuators[0], "delay"):
        pytest.skip("this MuJoCo has no delays")
    plain, late = delay(written(), "command", 0.012)
    fixed = in_files(moved(model, {"input.drum.delay_ms": 12.0}), model, m)
    assert share(stepped(fixed.texts["gap_fixed.xml"]), late, plain) < 0.03  # half a step
    assert share(predicted(model, {"input.drum.delay_ms": 12.0}), late, plain) < 0.02
    plain, late = delay(written(), "reading", 0.012)
    fixed = in_files(moved(model, {"output.encoder.delay_ms": 12.0}), model, m)
    assert share(stepped(fixed.texts["gap_fixed.xml"])[:, 0], late, plain[:, 0]) < 0.03  # half a step
    assert not fixed.left_to_you


@pytest.mark.long
@pytest.mark.parametrize("case", ["payload", "length", "viscous"])
def test_a_patched_mjcf_read_again_is_the_machine_that_was_predicted(case):
    moves, _, _ = CASES[case]
    m = mechanism()
    model = machine_of(m)
    fixed = in_files(moved(model, moves), model, m)
    again = machine_of(mechanism(fixed.texts[fixed.file]))
    plain = predicted(model, {})
    assert share(predicted(again, {}), predicted(model, moves), plain) < 0.01
    if hasattr(m.spec.compiler, "savecanonical"):  # older MuJoCo writes geoms without their ends
        assert {p.name for p in model.parameters} <= {p.name for p in again.parameters}


def test_a_flexible_joint_is_a_second_joint_about_the_same_axis():
    m = mechanism(written(joint='damping="0.05" armature="0.0137"'))
    model = machine_of(m)
    at = "port.bearing."
    moves = {
        at + "inertia": 0.0137,
        "change.armature_bearing": -0.0137 * (1 - 1e-6),
        at + "motor_damping": 0.05,
        "change.damping_bearing": -0.05 * (1 - 1e-6),
        at + "coupling": 20.0,
        at + "coupling_damping": 0.02,
    }
    fixed = in_files(moved(model, moves), model, m)
    assert not fixed.left_to_you
    plain, theirs = predicted(model, {}), predicted(model, moves)
    assert share(stepped(fixed.texts[fixed.file]), theirs, plain) < 0.02


def test_degrees_classes_and_the_rest_of_the_users_file_stay():
    m = mechanism(written(angle="degree", joint='damping="0.05" stiffness="0.8" springref="5"'))
    model = machine_of(m)
    fixed = in_files(moved(model, {"port.bearing.stiffness": 0.4, "port.bearing.rest": 0.2}), model, m)
    text = fixed.texts[fixed.file]
    mujoco = pytest.importorskip("mujoco")
    rest = (0.8 * np.deg2rad(5.0) + 0.4 * 0.2) / 1.2
    assert mujoco.MjModel.from_xml_string(text).joint("bearing").qpos_spring[0] == pytest.approx(rest, rel=1e-5)
    if hasattr(m.spec.compiler, "savecanonical"):
        assert 'angle="degree"' in text
        assert "fromto" in text


def test_what_mjcf_cannot_say_is_left_to_a_function_and_named_by_a_field():
    moves = {"port.bearing.coulomb": 0.1, "port.bearing.coulomb_speed": 0.01, "port.bearing.stribeck": 0.5,
             "port.bearing.stribeck_speed": 0.2, "mass_lever": 1.02, "output.encoder.gain": 0.03}  # fmt: skip
    m = mechanism()
    model = machine_of(m)
    fixed = in_files(moved(model, moves), model, m)
    left = {row.parameter: row.reason for row in fixed.left_to_you}
    assert left == dict.fromkeys(moves.keys() - {"mass_lever"}, NotWritten.NO_ATTRIBUTE)
    assert fixed.file == "gap_fixed.xml"
    assert fixed.function == "gap_fix.py"
    space = run(fixed.texts["gap_fix.py"])
    assert space["PARAMETERS"] == {}
    whole = stepped(fixed.texts[fixed.file], force=kept(space["force_at_bearing"]),
                    reading=kept(space["reading_of_encoder"]))  # fmt: skip
    assert share(whole, predicted(model, moves), predicted(model, {})) < 0.03


def cogging(q, v, n):
    """A user's own kind."""
    return n[0] * np.sin(n[1] * q)


def test_a_kind_of_the_users_own_is_left_with_its_numbers():
    numbers = (
        ls.gap.ModelParameter("torque", 0.0, "N m", range=(-0.2, 0.2)),
        ls.gap.ModelParameter("poles", 8.0, "1/rad"),
    )
    m = replace(mechanism(), kinds=(Kind("cogging", "bearing", cogging, numbers),))
    model = machine_of(m)
    fixed = in_files(moved(model, {"change.cogging_torque": 0.07, "mass_lever": 1.02}), model, m)
    assert [row.parameter for row in fixed.left_to_you] == ["cogging_torque"]
    assert run(fixed.texts[fixed.function])["PARAMETERS"] == {"cogging_torque": 0.07}
    assert fixed.parameters[0].old == 0.0


def test_names_of_a_model_never_become_code():
    evil = 'b"""\n__import__("os").abort()\n"""'
    port = replace(WINCH.ports[0], name=evil, unit=evil)
    model = replace(WINCH, name=evil, ports=(port,), inputs=(replace(WINCH.inputs[0], unit=evil),))
    fixed = in_files(moved(model, {f"port.{evil}.offset": 0.1, "input.drum.gain": 0.2}), model, None)
    tree = ast.parse(fixed.texts["gap_fix.py"])
    assert [type(part).__name__ for part in tree.body] == ["Expr", "Import", "Assign", "FunctionDef", "FunctionDef"]
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Name) and node.id == "__import__"]


def test_a_file_of_the_users_is_kept(tmp_path):
    own = tmp_path / "gap_fix.py"
    own.write_text("mine = 1\n")
    assert write_beside(own, "x = 1\n") == "gap_fix_2.py"
    assert write_beside(own, "x = 1\n") == "gap_fix_2.py"
    assert write_beside(own, "x = 2\n") == "gap_fix_3.py"
    assert own.read_text() == "mine = 1\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gap_fix.py", "gap_fix_2.py", "gap_fix_3.py"]


@pytest.mark.filterwarnings("ignore:.*settotalmass")
def test_a_model_that_scales_its_masses_is_not_patched_but_said_to_be_left():
    text = written().replace('<compiler angle="radian"/>', '<compiler angle="radian" settotalmass="0.4"/>')
    m = mechanism(text)
    model = machine_of(m)
    fixed = in_files(moved(model, {"change.payload_hand": 0.08}), model, m)
    assert fixed.file is None
    assert [(row.parameter, row.reason) for row in fixed.left_to_you] == [("payload_hand", NotWritten.REFUSED)]
    assert run(fixed.texts["gap_fix.py"])["PARAMETERS"] == {"payload_hand": 0.08}


INERTIAL = '<inertial pos="0.01 0 -0.1" mass="0.3" diaginertia="6e-3 5.8e-3 4e-4" euler="0.2 0.1 0"/>'


@pytest.mark.long
@pytest.mark.parametrize("payload", [0.1, -0.05])
@pytest.mark.parametrize("inertial", ["", INERTIAL])
def test_a_payload_stands_in_the_inertia_of_a_body_that_states_it_and_may_be_less_than_nothing(payload, inertial):
    m = mechanism(written(more=inertial, rod="-0.3"))
    model = machine_of(m)
    moves = {"change.payload_lever": payload, "mass_lever": 1.1}
    fixed = in_files(moved(model, moves), model, m)
    assert not fixed.left_to_you
    plain = stepped(written(more=inertial))
    assert share(stepped(fixed.texts[fixed.file]), predicted(model, moves), plain) < 0.01


def run(text):
    """The functions of a file that stands alone."""
    imported = {a.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import) for a in node.names}
    assert imported == {"numpy"}
    space = {}
    exec(compile(text, "gap_fix.py", "exec"), space)
    return space


def kept(function):
    """A function with its memory."""
    memory = {}
    return lambda q, v, u, t: function(q, v, u, t, memory)


def motion(t, x, u, p):
    """A lever on a spring, hanging from a drum."""
    return x[1], (u[0] - p.damping * x[1] - p.spring * x[0] - 0.3 * np.sin(x[0])) / (p.rotor + p.inertia)


WINCH = ls.gap.Model(
    "winch", motion, ("angle", "speed"),
    (
        ls.gap.ModelParameter("inertia", 0.012, "kg m2", 0.03, "none"),
        ls.gap.ModelParameter("rotor", 0.008, "kg m2", 0.03, "none"),
        ls.gap.ModelParameter("damping", 0.05, "N m s/rad"), ls.gap.ModelParameter("spring", 0.8, "N m/rad"),
    ),
    (ls.gap.Input("drum", "drum_v", unit="N m"),), (ls.gap.Output("encoder", "angle", "lever_rad", unit="rad"),),
    (ls.gap.Port("bearing", "drum", "angle", "speed", "rotor", "N m", "damping"),),
)  # fmt: skip
SCALES = Scales(1.0, {"drum": (0.5, 0.2)}, {"encoder": 0.5}, {"bearing": PortScale(0.3, 3.0, -0.5, 0.5)})
FORMS = {f"{form.effect}, {form.form}": form for form in forms(WINCH, SCALES)}


def around(text, *, sub=4):
    """A user's loop: the right-hand side by Runge-Kutta with the file's functions around it, from rest."""
    space, u, x, out = run(text), command(), np.zeros(2), []
    p = type("P", (), WINCH.values() | space["PARAMETERS"])
    names = ("command_of_drum", "force_at_bearing", "reading_of_encoder")
    late, push, read = (kept(space[name]) if name in space else (lambda q, v, u, t: 0.0) for name in names)
    motor = next((f for name, f in space.items() if name == "force_at_bearing"), None)
    memory = {}
    if motor is not None:
        push = lambda q, v, u, t: motor(q, v, u, t, memory)  # noqa: E731
    h = STEP_S / sub
    for k in range(ROWS):
        seen = memory.get("motor", x[0])
        out.append(seen + read(x[0], x[1], seen, k * STEP_S))
        given = u[k] + late(x[0], x[1], u[k], k * STEP_S)
        for s in range(sub):
            t = k * STEP_S + s * h
            force = push(x[0], x[1], given, t)
            a = np.array(motion(t, x, [given + force], p))
            b = np.array(motion(t, x + 0.5 * h * a, [given + force], p))
            x = x + h * b
    return np.array(out)[:, None]


@pytest.mark.long
@pytest.mark.parametrize("name", FORMS)
def test_every_form_of_the_catalogue_as_a_function_moves_a_right_hand_side_as_predicted(name):
    form = FORMS[name]
    start = 0 if form.effect == "joint_flexibility@bearing" else -1  # soft enough to be seen
    moves = form.moves([f.starts[start] for f in form.free])
    fixed = in_files(moved(WINCH, moves), WINCH, None)
    assert list(fixed.texts) == ["gap_fix.py"]
    assert fixed.function == "gap_fix.py"
    assert fixed.file is None
    mine, theirs, plain = around(fixed.texts["gap_fix.py"]), predicted(WINCH, moves), predicted(WINCH, {})
    assert share(mine, theirs, plain) < 0.02
