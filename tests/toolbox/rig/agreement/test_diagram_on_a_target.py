"""A diagram of controllers runs on a target as `simulate` runs it: the core in C, the target in Python, the arm."""

import struct
from dataclasses import replace

import control
import numpy as np
import pytest
from axis_study import experiment, study_text, table, target, write_study
from emulated_cases import ARM_ON_A_TARGET, emulator
from python_target_line import Running
from scipy.signal import lfilter
from target_cases import GAIN, LIMITS, MIXING, OUTPUTS, Bench, built
from two_targets import Second

import loopshape as ls
from loopshape.toolbox.rig.target.blocks import Block
from loopshape.toolbox.rig.target.messages import Configuration, Identity, Request, start_payload

RATE = 1000.0
COUPLING = 0.2
F_HZ = np.geomspace(0.5, 400.0, 60)
WIDE = np.array([[-1e6, 1e6, np.inf]] * 5)


def axes_model(count):
    """The machine of the target in Python: position and speed of each axis, every command on every axis."""
    one = np.array([[1.0, 1.0 / RATE], [0.0, 0.97]])
    mix = np.full((count, count), COUPLING) + (1.0 - COUPLING) * np.eye(count)
    B = np.kron(0.4 * mix, [[0.0], [1.0]])
    return control.ss(np.kron(np.eye(count), one), B, np.kron(np.eye(count), [[1.0, 0.0]]), 0.0 * mix, 1.0 / RATE)


def controller(*blocks, **words):
    return ls.controller(*blocks, rate_hz=RATE, **words)


def diagrams(name):
    """A diagram with its models, and the columns that its signals are."""
    one, two = axes_model(1), axes_model(2)
    P = ls.FRF.from_control(one, F_HZ, relative_std=0.01)
    G = ls.FRF.from_control(two, F_HZ, relative_std=0.01)
    C = controller(ls.gain(9.0), ls.lead_lag(5.0, 61.0))
    slow = controller(ls.gain(3.0), ls.lead_lag(4.0, 50.0))
    wires = {"r": "r_axis1_rad", "y": "angle1_rad", "u": "z1_v"}
    if name == "prefilter":
        return ls.diagrams.prefilter(P, controller(ls.low_pass(3.0, order=1))).with_part("C", C), {"P": one}, wires
    if name == "observer":
        nominal = control.tf([380.0], [1.0, 33.0, 0.0])
        D = ls.diagrams.disturbance_observer(P, nominal, ls.low_pass(4.0, 0.7)).with_part("C", slow)
        return D, {"P": one}, wires
    two_inputs = {"r": "r_axis1_rad", "y1": "angle1_rad", "y2": "angle2_rad", "u1": "z1_v", "u2": "z2_v"}
    if name == "dual stage":  # the fine one's displacement is added to the coarse one's error, as it is measured
        parts = (
            ls.diagrams.Part("C1", "e1", "u1", slow),
            ls.diagrams.Part("C2", "e", "u2", C),
            ls.diagrams.Part("P", ("u1", "u2"), ("y1", "y2"), G),
        )
        return ls.diagrams.Diagram(parts, {"y": "y1 + y2", "e": "r - y", "e1": "e + y2"}, "C1"), {"P": two}, two_inputs
    late = controller(ls.gain(1.0), computation_delay_s=0.3)
    parts = (  # a cascade whose inner controller also reads what both gave 300 samples ago, in a circle
        ls.diagrams.Part("outer", "e", "v", slow), ls.diagrams.Part("inner", "ei", "u1", controller(ls.gain(2.0))),
        ls.diagrams.Part("late", "both", "w", late),
        ls.diagrams.Part("second", "y2", "u2", controller(ls.gain(-1.0), ls.low_pass(90.0, 0.7))),
        ls.diagrams.Part("P", ("u1", "u2"), ("y1", "y2"), G),
    )  # fmt: skip
    sums = {"e": "r - y1", "ei": "v - y2 - w", "both": "u1 + u2"}
    weak = {"outer": controller(ls.gain(2.0)), "inner": controller(ls.gain(0.4))}
    D = ls.diagrams.Diagram(parts, sums, "outer")
    return D.with_part("outer", weak["outer"]).with_part("inner", weak["inner"]), {"P": two}, two_inputs


NAMES = ["prefilter", "observer", "dual stage", "delays"]
MOVING = 'references = { axis1 = { kind = "staircase", times_s = [0.2, 0.5], values_rad = [0.2, -0.1] } }'


@pytest.mark.parametrize("name", NAMES)
def test_the_target_in_python_is_the_simulation(tmp_path, name):
    """Closed, with setpoints that step and an injection at the controller's input, against the state space."""
    D, models, wires = diagrams(name)
    count = 1 if name in NAMES[:2] else 2
    study = write_study(tmp_path, study_text(experiment("one", more=MOVING), count=count, point=0.0))
    made = lambda: target(count, COUPLING)  # noqa: E731

    def quiet():
        one = made()
        one.machine.noise_rad = 0.0
        return one

    with Running(quiet) as running:
        ls.rig.measure(study, tmp_path / "run", port=running.port, arm=True, diagram=ls.diagrams.Wired(D, wires))
    found = table(tmp_path / "run", "one", count=count)
    first = next(n for n, c in wires.items() if c == "angle1_rad")
    signals = ls.diagrams.simulate(D, models, {"r": found["r1"], first: -found["n1"]})
    for signal, column in wires.items():
        if column.startswith("z"):
            z = found[f"z{column[1]}"]
            np.testing.assert_allclose(z, signals[signal], rtol=0.0, atol=1e-9 * np.abs(z).max(), err_msg=signal)
            assert np.abs(z).max() > 0.01
    np.testing.assert_allclose(found["s1"], signals[first] + found["n1"], rtol=0.0, atol=1e-9)


def on_bench(name):
    """The C core's blocks for a diagram: loop k has sensor k, both references stay at 0."""
    from bench_nouns import LoopSetup

    from loopshape.toolbox.rig.target.blocks import blocks

    D, models, wires = diagrams(name)
    loops = [LoopSetup(f"axis{k}", f"r_axis{k}_rad", None, f"z{k}_v", f"angle{k}_rad", None) for k in (1, 2)]
    return D, models, wires, blocks(ls.diagrams.Wired(D, wires), loops, RATE)


@pytest.mark.parametrize("name", NAMES)
def test_the_core_in_c_steps_as_the_simulation(name):
    """Fed with what the simulation measured under a disturbance at its output, it gives what entered the plants."""
    D, models, wires, (made, given) = on_bench(name)
    n = 700
    rng = np.random.default_rng(3)
    noise = np.r_[0.0, 0.1 * rng.standard_normal(n - 1)]
    first = next(s for s, c in wires.items() if c == "angle1_rad")
    signals = ls.diagrams.simulate(D, models, {"r": np.zeros(n), first: noise})
    sensors = np.zeros((n, 3))
    for signal, column in wires.items():
        if column.startswith("angle"):
            sensors[:, int(column[5]) - 1] = signals[signal]
    sections = tuple(given.get(f"axis{k}", GAIN) for k in (1, 2))
    bench = Bench(built())
    bench.arm(tuple(sensors[0]), watchdog_ms=60000, limits=WIDE, outputs=np.eye(2, 3), sections=sections, blocks=made)
    bench.ok(Request.BEGIN, start_payload(1, n, 1, 0, 0, False))
    bench.ok(Request.GO, struct.pack("<I", 1))
    while bench.status().tick == 0:
        bench.tick(1)
    for k in range(1, n, 100):
        lines = [f"s {a!r} {b!r} {c!r}\nt 1" for a, b, c in sensors[k : k + 100].tolist()]
        bench.now_ms += 100
        bench.lines(*lines, f"p {bench.now_ms}", f"p {bench.now_ms + 20}")
        bench.status(1, k)
    samples = bench.samples()
    bench.close()
    for signal, column in wires.items():
        if column.startswith("z"):
            z = samples[:, 4 + int(column[1]) - 1]
            expected = signals[signal]
            np.testing.assert_allclose(z, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max(), err_msg=signal)
            assert np.abs(z).max() > 1e-3


HEAD = """
format = "loopshape-study/1"
rig = "target"
plant = "arm-1dof"
rate_hz = 1000.0
seed = 2
operating_points = [{ theta2_deg = 2.0, p_ab_bar = 1.0 }]
"""
MOVED = """[[experiment]]
name = "moved"
excites = "theta2"
injection = "controller_input"
references = { theta2 = { kind = "staircase", times_s = [0.3, 0.9], values_deg = [6.0, 1.0] } }
[experiment.excitation]
kind = "multisine"
f_low_hz = 2.0
f_high_hz = 30.0
period_s = 0.5
periods = 3
amplitude_deg = 0.5
ramp_s = 0.0
crest_iterations = 0
"""


@pytest.mark.parametrize("divisor", [1, 4])
def test_the_emulated_arm_under_a_diagram(tmp_path, divisor):
    """A filter of the setpoint before a controller of two blocks, at the tick's rate and at a quarter of it."""
    rate = RATE / divisor
    P = ls.FRF.from_control(
        control.tf([1.0], [0.1, 1.0]), np.geomspace(0.5, 100.0, 40), rate_hz=rate, relative_std=0.01
    )
    F, C = (
        ls.controller(ls.low_pass(2.0, order=1), rate_hz=rate),
        ls.controller(ls.gain(6.0), ls.low_pass(9.0, 0.7), rate_hz=rate),
    )
    wired = ls.diagrams.Wired(
        ls.diagrams.prefilter(P, F).with_part("C", C), {"r": "r_theta2_rad", "y": "theta2_rad", "u": "z_theta2_v"}
    )
    (tmp_path / "study.toml").write_text(HEAD + ARM_ON_A_TARGET + MOVED)
    with emulator() as port:
        run = ls.rig.measure(tmp_path / "study.toml", tmp_path / "run", port=port, arm=True, diagram=wired)
        (shown,) = ls.rig.connect(port).show(tmp_path / "study.toml", diagram=wired).experiments()
    names = ("r_theta2_rad", "theta2_rad", "n_theta2_rad", "z_theta2_v")
    r, y, n, z = (run.recording("moved").column(name) for name in names)
    e = through(F, r[::divisor]) - (y - n)[::divisor]
    np.testing.assert_allclose(z, np.repeat(through(C, e), divisor)[: z.size], rtol=0.0, atol=1e-11)
    assert np.ptp(z) > 0.1
    assert np.abs(n).max() > 0.001
    assert run.loops[0].controller is None
    assert run.extra["diagram"]["columns"]["u"] == "z_theta2_v"
    assert shown.loops[1].controller is not None  # the pressures' loop keeps its own


def through(C, signal):
    """A controller's answer from rest by scipy."""
    for b0, b1, b2, a1, a2 in C.biquads():
        signal = lfilter([b0, b1, b2], [1.0, a1, a2], signal)
    return signal


BLOCKS = (Block(((0, 1.0), (2, -1.0), (5, 0.1)), GAIN), Block(((4, 2.0),), np.zeros((0, 5)), 2, 3))


@pytest.fixture(params=["C", "Python"])
def either(request):
    """Either target with two loops, and a configuration for it: blocks for the first, sections for the second."""
    if request.param == "Python":
        limits = np.array([[-1.0, 1.0, np.inf]] * 4)
        yield Second(), Configuration(np.eye(2), np.eye(2), (0, GAIN), limits, False, 100, 0.0, blocks=BLOCKS)
    else:
        bench = Bench()
        yield bench, Configuration(OUTPUTS, MIXING, (0, GAIN), LIMITS, False, 100, 0.0, blocks=BLOCKS)
        bench.close()


def test_the_digest_covers_blocks(either):
    one, configuration = either
    for what, payload in configuration.frames():
        one.ok(what, payload)
    assert int.from_bytes(one.ok(Request.READY)[:4], "little") == configuration.digest
    late = replace(configuration, blocks=(BLOCKS[0], replace(BLOCKS[1], delay=1)))
    assert len({configuration.digest, late.digest, replace(configuration, sections=(1, GAIN)).digest}) == 3
    assert Identity.read(one.ok(Request.IDENTIFY, b"\1\0")).blocks


def test_another_order_is_refused(either):
    one, configuration = either
    configure, first, second, output, sections, *limits = configuration.frames()
    assert one.no(*first) == 4
    one.ok(*configure)
    assert one.no(*second) == 3  # not the next one
    assert one.no(*output) == 3  # a block that is not there
    one.ok(*first)
    assert one.no(*first) == 3
    one.ok(*second)
    assert one.no(Request.OUTPUT, b"\0\2") == 3
    assert one.no(Request.OUTPUT, b"\1\0") == 3  # the second loop's comes later
    one.ok(*output)
    assert one.no(*output) == 3
    assert one.no(Request.SECTIONS, b"\0" + sections[1][1:]) == 3  # it has a block
    assert one.no(Request.BLOCK, b"\2" + second[1][1:]) == 3  # controllers have begun
    one.ok(*sections)
    for limit in limits:
        one.ok(*limit)
    one.ok(Request.READY)


def asked(one, configuration, *blocks):
    """Configured with these blocks for the first loop, up to READY."""
    for what, payload in replace(configuration, blocks=blocks).frames():
        one.ok(what, payload)


@pytest.mark.parametrize(
    ("blocks", "known"),
    [
        ([Block(((4, 1.0),), GAIN)], False), ([Block(((4, 1.0),), GAIN, 1)], True),
        ([Block(((5, 1.0),), GAIN), Block(((4, 1.0),), GAIN)], False),
        ([Block(((5, 1.0),), GAIN), Block(((4, 1.0),), GAIN, 1)], True), ([Block(((5, 1.0),), GAIN)], False),
    ],
)  # fmt: skip
def test_a_circle_needs_a_delay(either, blocks, known):
    asked(*either, *blocks)
    assert len(either[0].ok(Request.READY)) == 12 if known else either[0].no(Request.READY) == 4


@pytest.mark.parametrize(
    ("block", "code"),
    [
        (Block(((0, 1.0),), GAIN, 0, 0), 3), (Block((), GAIN), 3), (Block(((0, np.nan),), GAIN), 3),
        (Block(((200, 1.0),), GAIN), 3), (Block(((0, 1.0),), GAIN + np.inf), 3),
        (Block(((0, 1.0),), np.tile(GAIN, (13, 1))), 6),
    ],
)  # fmt: skip
def test_a_block_out_of_range_is_refused(either, block, code):
    one, configuration = either
    one.ok(*configuration.frames()[0])
    payload = block.payload(0)
    assert one.no(Request.BLOCK, payload) == code
    for cut in (payload[:-1], payload + b"\0", payload[:3], b""):
        assert one.no(Request.BLOCK, cut) == 2 or (code == 3 and cut)
    one.ok(*configuration.frames()[1])  # what was refused left nothing behind


@pytest.mark.long  # it compiles several
def test_what_a_target_does_not_hold_is_refused():
    frames = Configuration(OUTPUTS, MIXING, (0, GAIN), LIMITS, False, 100, 0.0, blocks=BLOCKS).frames()
    for flag, first in (("-DTARGET_POOL=14", BLOCKS[0]), ("-DTARGET_BLOCKS=1", BLOCKS[1]), ("-DTARGET_TERMS=2", None)):
        small = Bench(built(flag))
        small.ok(*frames[0])
        if first is not None:
            small.ok(Request.BLOCK, first.payload(0))
        assert small.no(Request.BLOCK, (BLOCKS[0] if first is None else BLOCKS[1]).payload(first is not None)) == 6, (
            flag
        )
        small.close()
    second = Second(most_blocks=0)
    assert second.no(*frames[1]) == 8
    assert not Identity.read(second.ok(Request.IDENTIFY, b"\1\0")).blocks


def refused(tmp_path, wired, words, rig="target", **board):
    """Measuring on the target in Python is refused with these words before anything moves."""
    study = write_study(tmp_path, study_text(count=1).replace('rig = "target"', f'rig = "{rig}"'))
    one = target(1, **board)
    with Running(lambda: one) as running, pytest.raises(ls.errors.WrongUseError, match=words):
        ls.rig.measure(study, tmp_path / "run", port=running.port, arm=True, diagram=wired)
    assert Request.CONFIGURE not in [kind for kind, _ in one.log]


def test_what_cannot_run_is_refused_in_a_sentence(tmp_path):
    D, _, wires = diagrams("prefilter")
    refused(
        tmp_path, ls.diagrams.Wired(D, wires), "the target takes no block diagram; received 2 blocks", most_blocks=0
    )
    refused(
        tmp_path, ls.diagrams.Wired(D, wires | {"y": "elbow_rad"}), "wired to no loop's column; received y is elbow_rad"
    )
    refused(
        tmp_path,
        ls.diagrams.Wired(D, {"y": "angle1_rad", "u": "z1_v"}),
        "not known on the target; received r comes from",
    )
    refused(
        tmp_path,
        ls.diagrams.Wired(D.with_part("C", None), wires),
        "not known on the target; received u is what C gives",
    )
    with pytest.raises(ls.errors.WrongUseError, match="no such signal; received x"):
        ls.diagrams.Wired(D, {"x": "angle1_rad"})
    loop = (
        ls.diagrams.Part("C", "e", "u", controller(ls.gain(1.0))),
        D.part("P"),
        ls.diagrams.Part("Q", "u", "q", controller(ls.gain(1.0))),
    )
    circle = ls.diagrams.Diagram(loop, {"e": "r - y - q"}, "C")
    refused(tmp_path, ls.diagrams.Wired(circle, wires), "controllers alone close a circle; received C, Q")
    third = ls.controller(ls.gain(1.0), rate_hz=300.0)
    P = ls.FRF.from_arrays(F_HZ[F_HZ < 140.0], 1.0 / (1.0 + 1j * F_HZ[F_HZ < 140.0]), relative_std=0.1, rate_hz=300.0)
    odd = ls.diagrams.Diagram(
        (ls.diagrams.Part("C", "e", "u", third), ls.diagrams.Part("P", "u", "y", P)), {"e": "r - y"}, "C"
    )
    refused(tmp_path, ls.diagrams.Wired(odd, wires), "a whole part of it; received 300 Hz, the target 1000 Hz")
    half = D.with_part("C", controller(ls.gain(1.0), computation_delay_s=0.0005))
    refused(
        tmp_path,
        ls.diagrams.Wired(half, wires),
        "the delay of C is no whole number of its samples up to 65535; received 0.5",
    )


def test_a_simulated_rig_refuses_a_diagram(tmp_path):
    D, _, wires = diagrams("prefilter")
    (tmp_path / "s.toml").write_text(HEAD.replace('"target"', '"simulated"') + MOVED)
    with pytest.raises(ls.errors.WrongUseError, match="runs a controller in each loop, no diagram"):
        ls.rig.measure(tmp_path / "s.toml", tmp_path / "run", diagram=ls.diagrams.Wired(D, wires))
