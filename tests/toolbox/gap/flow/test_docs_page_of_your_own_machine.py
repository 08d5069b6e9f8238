"""The page `docs/machine.md` followed to the letter: its two files, its command, a machine with dry friction."""

import json
import re
from pathlib import Path

import numpy as np
import own_machine
import pytest
from small_gap_run import loopshape

import loopshape as ls
from loopshape.toolbox.gap.mechanism.mechanism import machine
from loopshape.toolbox.gap.own.file import read_model

PAGE = (Path(__file__).parents[4] / "docs/machine.md").read_text()
XML = re.search(r"```xml\n(.*?)```", PAGE, re.S).group(1)
RUN_WORDS, WORDS, XML_WORDS = re.findall(r"```toml\n(.*?)```", PAGE, re.S)[:3]
CODE = re.search(r"```python\n(.*?)```", PAGE, re.S).group(1)
FILES = re.findall(r'file = "(\w+)\.csv"', RUN_WORDS)
COMMAND = re.search(r"<!-- winch -->\n```console\nloopshape (.*?)\n```", PAGE, re.S).group(1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "winch.py").write_text(CODE)
    (tmp_path / "model.toml").write_text(WORDS)
    return tmp_path


def test_the_example_is_short():
    assert CODE.count("\n") + WORDS.count("\n") <= 40


@pytest.mark.long
def test_the_example_runs_and_names_the_friction(folder, capsys):
    ls.write(own_machine.run_of(coulomb=0.03), folder / "runs/winch")
    assert loopshape(*COMMAND.split(), "--save-answer", "gap.json") == 0
    found = json.loads((folder / "gap.json").read_text())
    assert found["verdict"] == "coulomb_friction@bearing"
    assert found["where"]["place"] == "bearing"
    assert sum(r["probability"] for r in found["ranking"]) == pytest.approx(1.0)
    assert found["gap"]["shrink"] > 0.9
    assert (folder / "gap.png").read_bytes().startswith(b"\x89PNG")
    fix = found["fix"]
    assert (fix["of"], fix["is_verdict"], fix["file"], fix["function"]) == (found["verdict"], True, None, "gap_fix.py")
    rows = {row["parameter"]: row for row in fix["parameters"]}
    assert rows["port.bearing.coulomb"]["effect"] == found["verdict"]
    assert rows["port.bearing.coulomb"]["unit"] == "N m"
    assert rows["port.bearing.coulomb"]["new"] == found["ranking"][0]["magnitude"]
    assert rows["damping"]["effect"] is None
    assert rows["damping"]["old"] == 0.05
    space = {}
    exec((folder / "gap_fix.py").read_text(), space)
    assert space["PARAMETERS"]["damping"] == rows["damping"]["new"]
    memory = {}
    pushes = [space["force_at_bearing"](0.002 * k, 1.0, 0.0, 0.002 * k, memory) for k in range(200)]
    assert pushes[-1] == pytest.approx(-0.03, rel=0.2)
    said = " ".join(capsys.readouterr().out.split())
    assert f"fix: port.bearing.coulomb 0 -> {rows['port.bearing.coulomb']['new']:.4g} N m" in said
    assert "gap_fix.py)" in said


@pytest.mark.hour
@pytest.mark.long
def test_a_model_with_the_fix_taken_over_has_no_gap_any_more(folder):
    ls.write(own_machine.run_of(inertia=0.028), folder / "runs/winch")
    assert loopshape(*COMMAND.split(), "--save-answer", "gap.json", "--quiet") == 0
    first, space, words = json.loads((folder / "gap.json").read_text()), {}, WORDS
    assert first["verdict"] == "payload@lever"
    exec((folder / "gap_fix.py").read_text(), space)
    assert "load" in space["PARAMETERS"]
    for name, value in space["PARAMETERS"].items():
        words, count = re.subn(rf'(name = "{name}", value = )[\d.]+', rf"\g<1>{value!r}", words)
        assert count == 1
    (folder / "model.toml").write_text(words)
    assert loopshape(*COMMAND.split(), "--save-answer", "again.json", "--quiet") == 0
    again = json.loads((folder / "again.json").read_text())
    assert again["verdict"] == "none"
    assert again["fix"] is None
    assert first["gap"]["before"] > 10.0 * first["gap"]["after"]
    assert again["gap"]["before"] == pytest.approx(first["gap"]["after"], rel=0.05)


def test_a_folder_as_the_page_shows_it_is_a_run(folder):
    run = folder / "runs/winch"
    run.mkdir(parents=True)
    with pytest.raises(ls.LoopshapeError, match="received winch without one; write one"):
        ls.read(run)
    (run / "run.toml").write_text(RUN_WORDS)
    rng = np.random.default_rng(1)
    tables = {name: np.column_stack([np.arange(900) / 500.0, rng.normal(size=(900, 2))]) for name in FILES}
    for name, table in tables.items():
        np.savetxt(run / f"{name}.csv", table, delimiter=",", header="time_s,torque_nm,lever_rad", comments="")
    found = ls.read(run)
    assert found.rate_hz == 500.0
    assert [r.info.role for r in found.recordings] == ["estimation", "estimation", "validation"]
    assert np.array_equal(found.recordings[1].column("lever_rad"), tables["slow"][:, 2])


@pytest.fixture
def winch(folder):
    (folder / "winch.xml").write_text(XML)
    (folder / "model.toml").write_text(XML_WORDS)
    return folder


def test_the_mujoco_example_is_short():
    assert XML.count("\n") + XML_WORDS.count("\n") <= 40


@pytest.mark.long
def test_the_mujoco_example_runs_and_names_the_friction(winch):
    mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    ls.write(own_machine.run_of(coulomb=0.03), winch / "runs/winch")
    assert loopshape(*COMMAND.split(), "--save-answer", "gap.json") == 0
    found = json.loads((winch / "gap.json").read_text())
    assert found["verdict"] == "coulomb_friction@bearing"
    assert found["ranking"][0]["magnitude"] == pytest.approx(0.03, rel=0.1)
    assert found["fix"]["file"] == "gap_fixed.xml"
    patched = mujoco.MjModel.from_xml_path(str(winch / "gap_fixed.xml"))
    moved = {(row["element"], row["name"], row["attribute"]): row["new"] for row in found["fix"]["attributes"]}
    assert patched.joint("bearing").damping[0] == pytest.approx(moved["joint", "bearing", "damping"], rel=1e-5)
    form = {row["parameter"] for row in found["fix"]["parameters"] if row["effect"]}
    left = {row["parameter"] for row in found["fix"]["left_to_you"]}
    assert patched.joint("bearing").frictionloss[0] == pytest.approx(
        0.0 if "port.bearing.coulomb" in left else found["ranking"][0]["magnitude"], rel=1e-5
    )
    assert left <= form


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("winch.xml", 'contype="0"', 'margin="1" contype="1"',
         "nothing of model touches; received geoms 0 of body world and rod near the initial position"),
        ("winch.xml", "</body>", "</body><body><freejoint name='float'/><geom size='1'/></body>",
         "model is a tree of hinges and slides; received free joint float"),
        ("winch.xml", "</body>", "<body name='wrist'><joint name='socket' type='ball'/><geom size='1'/></body></body>",
         "received ball joint socket; replace it by hinges and slides"),
        ("winch.xml", "<motor", "<muscle lengthrange='0 1'", "actuator drum of model acts at a joint in proportion to"
         " command and motion; received dyntype muscle; log its effort and replace it by <motor joint=...>"),
        ("winch.xml", "<motor", "<general biastype='user'", "received biastype user"),
        ("winch.xml", '<motor name="drum" joint="bearing"/>', '<general name="drum" body="lever"/>',
         "received one at a body lever"),
        ("winch.xml", "<actuator>", "<tendon><fixed name='coil'><joint joint='bearing' coef='1'/></fixed></tendon>"
         "<actuator><motor name='pull' tendon='coil'/>", "actuator pull of model acts at a joint in proportion to"
         " command and motion; received one at a tendon coil"),
        ("winch.xml", "<actuator>", "<tendon><fixed name='coil'><joint joint='bearing' coef='1'/></fixed></tendon>"
         "<actuator>", "model is a tree of hinges and slides; received tendon coil; leave it out"),
        ("winch.xml", "<actuator>", "<equality><connect name='pin' body1='lever' anchor='0 0 -0.3'/></equality>"
         "<actuator>", "received equality pin (connect); leave it out"),
        ("winch.xml", '<body name="lever"', '<body name="lever" gravcomp="1"', "received gravcomp of body lever"),
        ("winch.xml", "<compiler", '<option viscosity="0.1"/><compiler', "received a fluid of viscosity 0.1"),
        ("winch.xml", 'joint="bearing"/></sensor>', 'joint="gone"/></sensor>', "winch.xml does not compile in MuJoCo"),
        ("winch.xml", "jointpos", "jointactuatorfrc", "sensor encoder reads the position or the speed of a joint"),
        ("model.toml", "encoder =", "coder =", "sensor coder stands in model"),
        ("model.toml", 'column = "lever_rad"', 'column = "lever_rad", leaves = "0.4"', "leaves must be a finite"),
        ("model.toml", "mass =", "weight =", "unknown key; received 'weight'"),
        ("model.toml", '"winch.xml"', '"../winch.xml"', "the MuJoCo model"),
        ("model.toml", "lever = 0.03", "hoist = 0.03", "tolerances name what the model has; received mass of 'hoist'"),
        ("model.toml", "drum =", "crab =", "actuators of model.toml stand in the model; received 'crab'"),
        ("model.toml", 'column = "torque_nm"', 'column = "torque_nm", kp = 3', "no resistance, torque_constant"),
        ("model.toml", 'column = "torque_nm"', 'column = "u_v", resistance = 2, torque_constant = 0.1',
         "a motor by numbers stands at a joint, under its name, in place of an actuator; received 'drum'"),
        ("model.toml", "armature =", "frictionloss =", "received frictionloss of 'bearing'"),
    ],
)  # fmt: skip
def test_a_mujoco_model_that_does_not_fit_is_refused_in_a_sentence(winch, file, old, new, words):
    pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    text = (winch / file).read_text()
    assert old in text
    if "contype" in old:
        text = text.replace("<body name", '<geom type="plane" size="9 9 1" pos="0 0 0.1"/><body name')
    (winch / file).write_text(text.replace(old, new))
    with pytest.raises(ls.LoopshapeError, match=re.escape(words)):
        machine(read_model(winch / "model.toml"))


def test_what_a_good_model_leaves_stands_beside_the_column_whatever_the_model_is(winch):
    pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    (axis,) = re.findall(r"```toml\n(format[^`]*axis = [^`]*)```", PAGE)
    axis = axis.replace("[numbers]", "window_s = 0.8\n[numbers]")
    found = []
    for words, column in ((WORDS, "lever_rad"), (XML_WORDS, "lever_rad"), (axis, "load_rad")):
        stated = words.replace(f'column = "{column}"', f'column = "{column}", leaves = 0.004')
        (winch / "model.toml").write_text(stated)
        model = read_model(winch / "model.toml")
        found.append([o.leaves for o in (model if isinstance(model, ls.gap.Model) else machine(model)).outputs])
    assert found == [[0.004], [0.004], [None, 0.004]]


@pytest.mark.hour
@pytest.mark.long
def test_a_baseline_is_the_floor_of_the_command_and_the_answer_says_so(folder, capsys):
    ls.write(own_machine.run_of(2, cogging=0.02, inertia=0.028), folder / "runs/winch")
    ls.write(own_machine.run_of(2, cogging=0.02), folder / "runs/good")
    assert loopshape(*COMMAND.split(), "--baseline", "runs/good", "--save-answer", "gap.json") == 0
    found = json.loads((folder / "gap.json").read_text())
    assert found["verdict"] == "payload@lever"
    (floor,) = found["floors"]
    assert (floor["output"], floor["unit"], floor["source"]) == ("encoder", "rad", "baseline")
    said = " ".join(capsys.readouterr().out.split())
    assert f"floor: encoder {floor['rms']:.3g} rad, what the model leaves of the baseline" in said
    assert "left, floors" in said


@pytest.mark.parametrize(
    ("beside", "words"),
    [
        (["runs/other"], "received --baseline and a second run"),
        (["--identifiable"], "received --baseline and --identifiable"),
    ],
)
def test_a_baseline_goes_with_a_diagnosis(folder, capsys, beside, words):
    assert loopshape("gap", "runs/winch", *beside, "--baseline", "runs/good") == 2
    assert words in capsys.readouterr().err


def test_a_run_is_no_baseline_of_its_own(folder, capsys):
    ls.write(ls.Run(500.0, (), (own_machine.recorded(0),)), folder / "runs/winch")
    assert loopshape(*COMMAND.split(), "--baseline", folder / "runs/winch") == 2
    assert "a baseline is another run than the one to diagnose; received r0.parquet in both" in capsys.readouterr().err


URDF = """<robot name="arm">
  <link name="base"/>
  <link name="lever"><inertial><origin xyz="0 0 -0.15"/><mass value="0.2"/>
    <inertia ixx="0.002" iyy="0.002" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.3"/></geometry></collision></link>
  <link name="tip"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.3"/></geometry></collision></link>
  <joint name="bearing" type="revolute"><parent link="base"/><child link="lever"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="5" velocity="9"/><dynamics damping="0.05" friction="0.02"/></joint>
  <joint name="wrist" type="continuous"><parent link="lever"/><child link="tip"/><origin xyz="0 0 -0.3"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""


@pytest.mark.short
def test_a_urdf_is_a_machine_with_an_effort_at_every_joint(winch):
    pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    (winch / "arm.urdf").write_text(URDF)
    (winch / "model.toml").write_text(
        'format = "loopshape-model/1"\nmujoco = "arm.urdf"\n[spread]\nfrictionloss = { bearing = 0.2 }\n'
        '[actuators]\nbearing = { column = "torque_nm" }\n'
        '[sensors]\nbearing = { column = "q_rad" }\nwrist_speed = { column = "w_rad_s" }\n'
    )
    found = machine(read_model(winch / "model.toml"))
    assert [(i.name, i.column, i.limits) for i in found.inputs] == [
        ("bearing", "torque_nm", (-5.0, 5.0)), ("wrist", None, None)
    ]  # fmt: skip
    assert [(o.name, o.state, o.unit) for o in found.outputs] == [
        ("bearing", "bearing", "rad"), ("wrist_speed", "wrist_speed", "rad/s")
    ]  # fmt: skip
    assert {"frictionloss_bearing": 0.02, "damping_bearing": 0.05}.items() <= found.values().items()
    p = found.derived(tuple((found.values() | {"frictionloss_bearing": 0.0}).values()))
    rates = found.motion(0.0, [0.3, 0.0, 0.0, 0.0], np.array([0.4, 0.0]), p)
    # two links, the outer one balanced at its joint: it keeps its speed about the world
    inertia, weight = 0.002 + 0.2 * 0.15**2 + 0.1 * 0.3**2, 9.81 * (0.2 * 0.15 + 0.1 * 0.3)
    slope = (0.4 - weight * np.sin(0.3)) / inertia
    assert rates[2:] == pytest.approx((slope, -slope))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('file = "winch.py"', 'file = "../winch.py"', "the Python file of a model"),
        ('file = "winch.py"', 'file = "none.py"', "none.py"),
        ('function = "motion"', 'function = "moves"', "winch.py has no function moves"),
        ('state = "angle"', 'state = "angel"', "the state of output encoder is not known; received 'angel'"),
        ('input = "drum"', 'input = "drumm"', "the input of port bearing is not known; received 'drumm'"),
        ('name = "load", value = 0.0', 'name = "load", vale = 0.0', "unknown key"),
        ('column = "lever_rad"', 'column = "lever_rad", leaves = -0.4', "leaves must be positive; received -0.4"),
        ('column = "lever_rad"', 'column = "lever_rad", leaves = [0.4]', "leaves must be a finite number"),
        ('column = "lever_rad"', 'column = "lever_rad", leave = 0.4', "unknown key; received 'leave'; did you mean"),
        ("window_s = 0.8", "leaves = 0.4", "unknown key; received 'leaves'"),
        (", range = [0.0, 1.0]", "", "parameter load is 0, so nothing tells how far it may be off"),
        ("range = [0.0, 1.0]", "range = [1.0, 0.0]", "is two rising numbers"),
        ('column = "torque_nm"', 'column = "torque_nm", factor = 0', "a factor is not 0"),
        ("window_s = 0.8", "window_s = 0", "window_s"),
        ('format = "loopshape-model/1"\n', "", "loopshape-model/1"),
        ("tolerance = 0.10", "tolerance = 10.0", "the tolerance of damping is a share from 0 to 1"),
        ('["angle", "speed"]', "[]", "model.toml"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(folder, old, new, words):
    assert old in WORDS
    (folder / "model.toml").write_text(WORDS.replace(old, new))
    with pytest.raises(ls.LoopshapeError, match=re.escape(words)):
        read_model(folder / "model.toml")


def test_python_that_does_not_run_is_refused_in_a_sentence(folder):
    (folder / "winch.py").write_text("import no_such_thing_at_all\n")
    with pytest.raises(ls.LoopshapeError, match=r"winch.py does not run; received ModuleNotFoundError"):
        read_model(folder / "model.toml")


def test_a_run_never_loads_a_python_file_that_it_names_itself(folder):
    (folder / "winch.py").write_text("raise SystemExit('loaded')\n")
    ls.write(ls.Run.from_arrays(u=np.ones(4000), y=np.ones(4000), rate_hz=500.0), folder / "run")
    text = (folder / "run/run.toml").read_text()
    (folder / "run/run.toml").write_text('plant = "winch"\n' + text + '\n[model]\nfile = "../model.toml"\n')
    assert loopshape("gap", folder / "run") == 2


def test_a_model_of_version_1_opens():
    made = read_model(Path(__file__).parents[3] / "helpers/kept/model-1.toml")
    assert made.values()["inertia"] == pytest.approx(2.0)
    assert (made.inputs[0].factor, made.outputs[0].offset, made.window_s) == (2.0, 0.1, 0.5)
