"""A schedule runs on a target as it runs in the simulation: the emulated arm, the core in C, the target in Python."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from axis_study import experiment, measured, simulated, study_text, table, target, write_study
from emulated_cases import ARM_ON_A_TARGET, emulator, excited, record, settings
from python_target_line import Running
from python_target_schedule import Schedule
from target_cases import GAIN, LIMITS, MIXING, OUTPUTS, Bench, built
from two_targets import Second

import loopshape as ls
from loopshape.toolbox.rig.target.messages import Configuration, Identity, Request
from loopshape.toolbox.rig.target.scheduling import Scheduling
from loopshape.toolbox.rig.target.target import configuration
from loopshape.toolbox.schedules import gain_scheduled, kernel

SAME = 1e-12  # of a column's largest value, as of a controller that stays as it is
SIGNALS = [(loop, what) for what in gain_scheduled.Follows for loop in ("theta2", "p_ab")]
OVER_BOTH = (
    gain_scheduled.Variable("theta2_deg", (-10.0, 4.0, 15.0), "theta2"),
    gain_scheduled.Variable("p_ab_bar", (0.9, 1.2), "p_ab", gain_scheduled.Follows.OUTPUT),
)
WIDE = np.array([[-1e6, 1e6, np.inf]] * 5)


def schedule(loop, variables, lag_s=0.05, gain=4.0, blocks=2):
    """Nodes of a gain, an integrator and a notch (and low-passes, up to `blocks`) that move with the node."""
    nodes = int(np.prod([len(v.knots) for v in variables]))
    made = [
        ls.controller(
            ls.gain(gain * (1.0 + 0.3 * k)), ls.pi(0.3 + 0.02 * k), ls.notch(5.0 + 0.3 * k, 0.08, 1.0),
            *[ls.low_pass(30.0 + 2.0 * k + j, 0.7) for j in range(blocks)], rate_hz=1000.0, loop=loop,
        )
        for k in range(nodes)
    ]  # fmt: skip
    return ls.schedules.GainScheduled(loop, variables, tuple(made), lag_s)


def with_schedules(e, *schedules):
    """The experiment with these schedules in place of controllers."""
    by_loop = {one.loop: one for one in schedules}
    loops = tuple(
        replace(loop, controller=None, schedule=by_loop[loop.name]) if loop.name in by_loop else loop
        for loop in e.loops
    )
    return replace(e, loops=loops)


def moving(arm_experiment, n=4000):
    """Both references step over nodes and beyond the edges while both loops are excited."""
    references = np.tile([0.0, 1.0], (n, 1))
    references[800:, 0], references[2000:, 0], references[3000:, 0] = 0.12, 0.3, -0.2
    references[1400:, 1], references[2600:, 1] = 1.15, 0.95
    t = np.arange(n) / 1000.0
    injected = 0.01 * np.column_stack([np.sin(2 * np.pi * 3.1 * t), np.sin(2 * np.pi * 1.7 * t)])
    return arm_experiment((0.0, 1.0), n, references=references, injected=injected, injection="controller_input", seed=5)


@pytest.fixture(scope="module")
def port():
    with emulator() as port:
        yield port


@pytest.mark.parametrize(
    "schedules",
    [
        [schedule("theta2", (gain_scheduled.Variable("theta2_deg", (-10.0, 4.0, 15.0), "theta2"),))],
        [
            schedule("theta2", OVER_BOTH),
            schedule("p_ab", (gain_scheduled.Variable("p_ab_bar", (0.95, 1.1), "p_ab"),), 0.0, 0.2, 1),
        ],
    ],
    ids=["one variable", "both loops"],
)
def test_the_emulated_arm_is_the_simulated_one(arm, arm_experiment, port, schedules):
    e = with_schedules(moving(arm_experiment), *schedules)
    (found,), (expected,) = record(port, [e]), arm.simulate([e])
    for name in expected.columns:
        mine, theirs = found.column(name), expected.column(name)
        assert np.abs(mine - theirs).max() <= SAME * max(np.abs(theirs).max(), 1e-3), name
    plain = arm.simulate([moving(arm_experiment)])[0]
    assert np.abs(expected.column("z_theta2_v") - plain.column("z_theta2_v")).max() > 0.01  # the schedule counts


@pytest.mark.parametrize("injection", ["plant_input", "control"])
def test_other_injections_too(arm, arm_experiment, port, injection):
    e = with_schedules(excited(arm_experiment, 600, injection), schedule("theta2", OVER_BOTH))
    (found,), (expected,) = record(port, [e]), arm.simulate([e])
    for name in expected.columns:
        mine, theirs = found.column(name), expected.column(name)
        assert np.abs(mine - theirs).max() <= SAME * max(np.abs(theirs).max(), 1e-3), name


THREE = (
    gain_scheduled.Variable("theta2_deg", (-20.0, 0.0, 10.0, 40.0), "theta2", gain_scheduled.Follows.OUTPUT),
    gain_scheduled.Variable("p_ab_bar", (0.8, 1.3), "p_ab", gain_scheduled.Follows.OUTPUT),
    gain_scheduled.Variable("set_rad", (0.1,), "theta2"),
)


def bench_samples(bench, sensors, two):
    """Samples of the scripted board with these sensors (the first all zero), nothing injected, references at 0."""
    bench.arm(tuple(sensors[0]), watchdog_ms=60000, limits=WIDE, sections=two)
    return bench.watched(sensors)


@pytest.mark.parametrize("lag_s", [0.0, 0.02])
def test_the_c_core_is_the_target_in_python_to_the_last_bit_and_the_kernel(lag_s):
    """Three variables, eight corners, random sensors over the knots and beyond both edges; twelve sections."""
    rng = np.random.default_rng(4)
    walk = np.cumsum(0.03 * rng.standard_normal(2000))
    sensors = np.column_stack([walk, *0.5 + 0.2 * rng.standard_normal((2, 2000))])
    sensors[0] = 0.0
    one = schedule("theta2", THREE, lag_s, 0.3, 9)
    scheduling = Scheduling.of(one, ("theta2", "p_ab"))
    bench = Bench()
    samples = bench_samples(bench, sensors, (scheduling, GAIN))
    bench.close()
    assert len(samples) == len(sensors)
    np.testing.assert_array_equal(samples[:, 6:9], sensors)
    signals = np.column_stack([samples[:, 0:2], samples[:, 6], samples[:, 7] + samples[:, 8]])
    head, nodes = scheduling.payloads(0)
    second = Schedule.read(head, 2)
    for part in nodes:
        second.take(int.from_bytes(part[1:3], "little"), list(struct.iter_unpack("<6d", part[4:])))
    e = signals[:, 0] - signals[:, 2]
    np.testing.assert_array_equal(
        samples[:, 4], [second.step(s, x) for s, x in zip(signals.tolist(), e.tolist(), strict=True)]
    )
    expected = kernel.run(one.tables(SIGNALS), signals, e)
    np.testing.assert_allclose(samples[:, 4], expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())  # it may contract
    assert signals[:, 2].min() < np.radians(-20.0)
    assert signals[:, 2].max() > np.radians(40.0)


def two_variables(loops=2):
    """A small schedule for either target: two nodes, three sections."""
    one = schedule("axis", (gain_scheduled.Variable("axis_rad", (0.0, 1.0), "axis"),), blocks=0)
    return Scheduling.of(one, ("axis", "other")[:loops])


@pytest.fixture(params=["C", "Python"])
def either(request):
    """Either target, and a configuration for it with a schedule for its first loop."""
    if request.param == "Python":
        limits = np.array([[-1.0, 1.0, np.inf]] * 4)
        yield Second(), Configuration(np.eye(2), np.eye(2), (two_variables(), GAIN), limits, False, 100, 0.0)
    else:
        bench = Bench()
        yield bench, Configuration(OUTPUTS, MIXING, (two_variables(), GAIN), LIMITS, False, 100, 0.0)
        bench.close()


def test_the_digest_covers_schedules(either):
    one, configuration = either
    for what, payload in configuration.frames():
        one.ok(what, payload)
    theirs = int.from_bytes(one.ok(Request.READY)[:4], "little")
    assert theirs == configuration.digest
    changed = two_variables()
    rows = changed.rows.copy()
    rows[-1, -1] = np.nextafter(rows[-1, -1], 1.0)
    other = replace(configuration, sections=(replace(changed, rows=rows), GAIN))
    assert other.digest != theirs
    assert replace(configuration, sections=(replace(changed, share=0.5), GAIN)).digest != theirs


def test_another_order_is_refused(either):
    one, configuration = either
    configure, schedule, nodes, sections, *limits = configuration.frames()
    assert (schedule[0], nodes[0], sections[0]) == (Request.SCHEDULE, Request.NODES, Request.SECTIONS)
    assert one.no(*schedule) == 4
    one.ok(*configure)
    assert one.no(*nodes) == 3  # before its schedule
    assert one.no(Request.SCHEDULE, b"\1" + schedule[1][1:]) == 3  # the second loop's first
    one.ok(*schedule)
    assert one.no(*schedule) == 3  # twice
    assert one.no(Request.SECTIONS, b"\0" + sections[1][1:]) == 3  # it has a schedule
    assert one.no(*sections) == 3  # the rows are missing
    assert one.no(Request.READY) == 4
    half = struct.pack("<BHB", 0, 0, 4) + nodes[1][4 : 4 + 4 * 48]
    one.ok(Request.NODES, half)
    assert one.no(Request.NODES, half) == 3  # again
    assert one.no(Request.NODES, struct.pack("<BHB", 0, 4, 3) + bytes(3 * 48)) == 3  # more than there are
    one.ok(Request.NODES, struct.pack("<BHB", 0, 4, 2) + nodes[1][4 + 4 * 48 :])
    one.ok(*sections)
    assert one.no(*schedule) == 3
    for limit in limits:
        one.ok(*limit)
    assert int.from_bytes(one.ok(Request.READY)[:4], "little") != configuration.digest  # it came in other pieces


WRONG = [
    ((0, 0, 3, 0.5), 3), ((0, 4, 3, 0.5), 3), ((0, 1, 0, 0.5), 3), ((0, 1, 3, 0.0), 3), ((0, 1, 3, 1.5), 3),
    ((0, 1, 3, np.nan), 3), ((0, 1, 13, 0.5), 6), ((0, 2, 3, 0.5), 2), ((2, 1, 3, 0.5), 3),
]  # fmt: skip


@pytest.mark.parametrize(("head", "code"), WRONG)
def test_a_schedule_out_of_range_is_refused(either, head, code):
    one, configuration = either
    one.ok(*configuration.frames()[0])
    assert one.no(Request.SCHEDULE, struct.pack("<BBBd", *head) + struct.pack("<BdB2d", 0, 1.0, 2, 0.0, 1.0)) == code


VARIABLES = [(4, 1.0, 0.0, 1.0), (0, 0.0, 0.0, 1.0), (0, np.inf, 0.0, 1.0), (0, 1.0, 1.0, 1.0), (0, 1.0, 0.0, np.nan)]


@pytest.mark.parametrize("variable", VARIABLES)
def test_a_variable_out_of_range_is_refused(either, variable):
    one, configuration = either
    one.ok(*configuration.frames()[0])
    source, scale, *knots = variable
    payload = struct.pack("<BBBd", 0, 1, 3, 0.5) + struct.pack("<BdB2d", source, scale, 2, *knots)
    assert one.no(Request.SCHEDULE, payload) == 3
    assert one.no(Request.SCHEDULE, payload + b"\0") in (2, 3)
    assert one.no(Request.SCHEDULE, payload[:-1]) in (2, 3)
    one.ok(*configuration.frames()[1])  # what was refused left nothing behind


@pytest.mark.parametrize(("place", "value"), [(3, 0.0), (3 + 18, -1.0), (0, np.nan), (35, np.inf)])
def test_coefficients_that_cannot_run_are_refused(either, place, value):
    """a0 is 0, a0 changes its sign from one node to the next, or a number is none."""
    one, configuration = either
    configure, schedule, (what, nodes), *_ = configuration.frames()
    one.ok(*configure)
    one.ok(*schedule)
    at = 4 + 8 * place
    assert one.no(what, nodes[:at] + struct.pack("<d", value) + nodes[at + 8 :]) == 3
    one.ok(what, nodes)


@pytest.mark.long  # it compiles several
def test_what_a_target_does_not_hold_is_refused_with_its_own_code():
    small = Bench(built("-DTARGET_POOL=37"))  # two knots and 36 numbers are 38
    two = Configuration(OUTPUTS, MIXING, (two_variables(), GAIN), LIMITS, False, 100, 0.0).frames()
    small.ok(*two[0])
    assert small.no(*two[1]) == 6
    small.close()
    second = Second(schedule_rows=5)
    second.ok(*Configuration(np.eye(2), np.eye(2), (GAIN, GAIN), LIMITS[:0], False, 100, 0.0).frames()[0])
    assert second.no(*two[1]) == 6


@pytest.mark.parametrize("make", [lambda: Bench(built("-DTARGET_POOL=0")), lambda: Second(schedule_rows=0)])
def test_a_target_without_schedules_says_so_and_is_refused_in_a_sentence(make, arm, arm_experiment):
    one = make()
    me = Identity.read(one.ok(Request.IDENTIFY, b"\1\0"))
    assert not me.schedules
    assert one.no(Request.SCHEDULE, b"") == 8
    assert one.no(Request.NODES, b"") == 8
    one.close()
    e = with_schedules(moving(arm_experiment, 10), schedule("theta2", OVER_BOTH))
    with pytest.raises(
        ls.errors.WrongUseError, match="the target takes no schedule; received theta2; build the target anew"
    ):
        configuration(me, e.loops, settings(), 1000.0, {})


def test_both_targets_with_schedules_say_so(either):
    assert Identity.read(either[0].ok(Request.IDENTIFY, b"\1\0")).schedules


def test_a_schedule_that_follows_a_loop_that_is_not_there_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="follows a loop that is not there; received elbow"):
        Scheduling.of(schedule("theta2", (gain_scheduled.Variable("x", (0.0, 1.0), "elbow"),)), ("theta2", "p_ab"))


def test_knots_beyond_a_message_are_refused():
    one = Scheduling(0.5, 1, ((0, 1.0, tuple(range(123))),), np.ones((123, 6)))
    with pytest.raises(
        ls.errors.WrongUseError, match="the knots of a schedule fit into one message; received 123 knots"
    ):
        one.payloads(0)


ROOT = """
[[loop]]
name = "axis1"
output = "angle1_rad"
control = "z1_v"
lag_s = 0.05
over = [{ name = "axis1_deg", loop = "axis1", follows = "output", knots = [-5.0, 5.7, 9.0] }]
nodes = [
  { at = [-5.0], controller = [{ kind = "gain", gain = 9.0 }, { kind = "lead_lag", f1_hz = 5.0, f2_hz = 61.0 }] },
  { at = [5.7], controller = [{ kind = "gain", gain = 7.0 }, { kind = "lead_lag", f1_hz = 5.5, f2_hz = 55.0 }] },
  { at = [9.0], controller = [{ kind = "gain", gain = 8.0 }, { kind = "lead_lag", f1_hz = 4.5, f2_hz = 70.0 }] },
]
"""


def test_a_machine_that_its_study_describes(tmp_path):
    """No plant is named: the target in Python runs the schedule, the same machine in one loop is what it must do."""
    text = study_text(experiment("one", "reference"))
    plain = text[text.index("[[loop]]") : text.index("[[experiment]]")]
    study = write_study(tmp_path, text.replace(plain, ROOT))
    with Running(lambda: target(1)) as running:
        assert measured(study, tmp_path / "run", running.port) == []
    found, expected = table(tmp_path / "run", "one", "reference"), simulated(study, "one")
    for key, values in expected.items():
        np.testing.assert_allclose(found[key], values, rtol=0.0, atol=1e-11 * np.abs(values).max(), err_msg=key)
    assert np.degrees(found["s1"]).min() < 5.6
    assert np.degrees(found["s1"]).max() > 5.8  # it passes a knot


STUDY = """
format = "loopshape-study/1"
rig = "{rig}"
plant = "arm-1dof"
rate_hz = 1000.0
seed = 2
operating_points = [{{ theta2_deg = 2.0, p_ab_bar = 1.0 }}]
{more}
[[loop]]
name = "theta2"
lag_s = 0.02
over = [
  {{ name = "theta2_deg", loop = "theta2", follows = "reference", knots = [0.0, 8.0] }},
  {{ name = "p_ab_bar", loop = "p_ab", follows = "output", knots = [0.9, 1.1] }},
]
nodes = [
  {{ at = [0.0, 0.9], controller = [{{ kind = "gain", gain = 5.0 }}, {{ kind = "low_pass", order = 1, f_hz = 9.0 }}] }},
  {{ at = [0.0, 1.1], controller = [{{ kind = "gain", gain = 4.0 }}, {{ kind = "low_pass", order = 1, f_hz = 8.0 }}] }},
  {{ at = [8.0, 0.9], controller = [{{ kind = "gain", gain = 8.0 }}, {{ kind = "low_pass", order = 1, f_hz = 7.0 }}] }},
  {{ at = [8.0, 1.1], controller = [{{ kind = "gain", gain = 7.0 }}, {{ kind = "low_pass", order = 1, f_hz = 6.0 }}] }},
]
[[experiment]]
name = "moved"
duration_s = 1.5
references = {{ theta2 = {{ kind = "staircase", times_s = [0.3, 0.9], values_deg = [9.0, 4.0] }} }}
"""


@pytest.mark.parametrize(
    "decoupling", [None, {"theta2": {"theta2": 1.0, "p_ab": 0.3}, "p_ab": {"theta2": -0.2, "p_ab": 0.9}}]
)
def test_a_study_with_a_schedule_measures_alike_on_both_rigs(tmp_path, port, decoupling):
    """And a constant matrix behind the controllers, which is the commands' mixing on a target."""
    found = {}
    for rig, more in (("simulated", ""), ("target", ARM_ON_A_TARGET)):
        study = tmp_path / f"{rig}.toml"
        study.write_text(STUDY.format(rig=rig, more=more))
        words = {"port": port, "arm": True} if rig == "target" else {}
        found[rig] = ls.rig.measure(study, tmp_path / rig, decoupling=decoupling, **words).recording("moved")
    for name, expected in found["simulated"].columns.items():
        mine = found["target"].column(name)
        assert np.abs(mine - expected).max() <= SAME * max(np.abs(expected).max(), 1e-3), name
    u_a, z = found["target"].column("u_a_v"), [found["target"].column(name) for name in ("z_theta2_v", "z_p_v")]
    weights = decoupling or {"theta2": {"theta2": 1.0}, "p_ab": {"p_ab": 1.0}}
    by_hand = sum(
        weights[to].get(name, 0.0) * one for to in weights for name, one in zip(("theta2", "p_ab"), z, strict=True)
    )
    np.testing.assert_allclose(u_a, by_hand, rtol=0.0, atol=1e-12)
    assert np.ptp(z[0]) > 0.1
