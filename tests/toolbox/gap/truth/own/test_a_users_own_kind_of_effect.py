"""A kind of effect in a user's own file: it acts as written, around any model, and is named where it is there."""

import re
from functools import cache

import numpy as np
import own_machine
import pytest

import loopshape as ls
from loopshape.toolbox.gap.mechanism.mechanism import machine
from loopshape.toolbox.gap.nouns.machine import Kind
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.file import read_model
from loopshape.toolbox.gap.own.kinds import with_kinds

CODE = '''import numpy as np


def cogging(q, v, n):
    """Torque of a magnet with n[1] poles a radian, n[0] at most."""
    return n[0] * np.sin(n[1] * q)
'''
WORDS = """
[[kind]]
name = "cogging"
port = "bearing"
file = "cogging.py"
function = "cogging"
number = [
  { name = "torque", unit = "N m", range = [-0.2, 0.2] },
  { name = "poles", value = 8.0, unit = "1/rad" },
]
"""
XML = """<mujoco><compiler angle="radian"/><worldbody><body name="lever">
<joint name="bearing" type="hinge" axis="0 1 0" damping="0.05" armature="0.0137" stiffness="0.8"/>
<geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.2039" contype="0" conaffinity="0"/>
</body></worldbody><actuator><motor name="drum" joint="bearing"/></actuator>
<sensor><jointpos name="encoder" joint="bearing"/></sensor></mujoco>"""
MUJOCO = """format = "loopshape-model/1"
mujoco = "winch.xml"
[spread]
[actuators]
drum = { column = "torque_nm" }
[sensors]
encoder = { column = "lever_rad" }
"""


def cogging(q, v, n):
    return n[0] * np.sin(n[1] * q)


@cache
def own(port="bearing"):
    numbers = (
        ls.gap.ModelParameter("torque", 0.0, "N m", range=(-0.2, 0.2)),
        ls.gap.ModelParameter("poles", 8.0, "1/rad"),
    )
    return with_kinds(own_machine.MODEL, [Kind("cogging", port, cogging, numbers)])


def test_its_force_acts_against_the_motion_and_is_nothing_at_zero():
    mine, plain = Composed(own()), Composed(own_machine.MODEL)
    assert mine.is_compiled
    x, u = np.array([0.3, -1.0]), np.array([0.2])
    moves = {"change.cogging_torque": 0.05, "change.cogging_poles": 1.0, "change.load": 0.1}
    pushed = u - 0.05 * np.sin(9.0 * 0.3)
    for m, drive in (({}, u), (moves, pushed)):
        known = {k: v for k, v in m.items() if k == "change.load"}
        expected = plain.motion(0.0, x, drive, plain.values(known))
        np.testing.assert_allclose(mine.motion(0.0, x, u, mine.values(m)), expected, rtol=1e-12)


def test_a_port_that_is_not_there_is_refused():
    with pytest.raises(
        ls.errors.WrongUseError, match=re.escape("kind cogging acts at a port of winch; received 'wheel'; it has")
    ):
        own("wheel")


def test_a_file_names_it_beside_a_mujoco_model(tmp_path):
    pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    (tmp_path / "winch.xml").write_text(XML)
    (tmp_path / "cogging.py").write_text(CODE)
    (tmp_path / "model.toml").write_text(MUJOCO + WORDS)
    read = read_model(tmp_path / "model.toml")
    plain, mine = machine(read), with_kinds(machine(read), read.kinds)
    assert mine.parameters[-2].effect == "cogging@bearing"
    found, expected = Composed(mine), Composed(plain)
    x, u, m = np.array([0.3, -1.0]), np.array([0.2]), {"change.cogging_torque": 0.05}
    pushed = u - 0.05 * np.sin(8.0 * 0.3)
    np.testing.assert_allclose(
        found.motion(0.0, x, u, found.values(m)), expected.motion(0.0, x, pushed, expected.values({})), rtol=1e-12
    )


@pytest.mark.long
def test_what_was_unknown_is_named_once_its_kind_is_given():
    found = ls.gap(own_machine.run_of(cogging=0.06), model=own(), table=False)
    assert found.verdict == "cogging@bearing"
    assert found.ranking[0].magnitude == pytest.approx(0.06, rel=0.1)
