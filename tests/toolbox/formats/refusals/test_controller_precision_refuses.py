"""Each bad setting of a controller as it runs, each format that cannot hold it, and the sentence that the user gets."""

import re
from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup

import loopshape as ls
from loopshape.io.config_table import ConfigTable
from loopshape.io.run.run_tables import loop_table, read_loops
from loopshape.toolbox.formats.controllers.controller_export import export_controllers
from loopshape.toolbox.formats.controllers.controller_words import step

GAIN = Block("gain", {"gain": 1.0})
SLOW = Block("low_pass_1", {"f_hz": 0.001})


def make(*blocks, rate_hz=1000.0, **settings):
    return ls.Controller("theta2", blocks or (GAIN,), rate_hz, **settings)


@pytest.mark.parametrize("value", [0.0, -1.0, 500.0, 600.0, float("nan"), float("inf"), True, "5"])
def test_prewarp(value):
    with pytest.raises(
        ls.errors.WrongUseError, match="prewarp_hz of loop 'theta2' must lie above 0 and below half the rate, 500"
    ):
        make(prewarp_hz=value)


@pytest.mark.parametrize("value", [-1e-3, float("nan"), float("inf"), None, True])
def test_delay(value):
    with pytest.raises(
        ls.errors.WrongUseError, match="computation_delay_s of loop 'theta2' must not be negative; received"
    ):
        make(computation_delay_s=value)


@pytest.mark.parametrize("value", [1, None, "yes"])
def test_hold(value):
    with pytest.raises(ls.errors.WrongUseError, match="added_hold of loop 'theta2' must be true or false; received"):
        make(added_hold=value)


@pytest.mark.parametrize(
    "name", ["half", "", "Q2.30", "q0.32", "q2", "q2.0", "q2.44", "q99.99", "int32", "q-2.3", None]
)
def test_precision(name):
    with pytest.raises(
        ls.errors.WrongUseError, match=r'precision of coefficients is not known; received .*"qM.N" of at most 45'
    ):
        make(precision=name)


def test_coefficient_outside_the_range():
    lead = Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0})
    words = (
        "coefficient b0 of block 2 (lead_lag) of loop 'theta2' does not fit q2.30; received 7.79743, and its range is"
        ' -2 to 1.999999999; use "q4.28" or more bits.'
    )
    with pytest.raises(ls.errors.WrongUseError, match=re.escape(words)):
        make(GAIN, lead, precision="q2.30")
    assert make(GAIN, lead, precision="q4.28").biquads()[1, 0] == pytest.approx(7.79743, rel=1e-6)
    with pytest.raises(
        ls.errors.WrongUseError, match=r"does not fit q1.3; .*use more integer bits, or spread the gain"
    ):
        make(Block("gain", {"gain": 1e3}), precision="q1.3")
    with pytest.raises(ls.errors.WrongUseError, match=r"coefficient b0 of block 1 .* does not fit single"):
        make(Block("gain", {"gain": 1e39}), precision="single")


def test_the_range_s_own_ends():
    assert make(Block("gain", {"gain": -2.0}), precision="q2.30").biquads()[0, 0] == -2.0
    with pytest.raises(ls.errors.WrongUseError, match=r"does not fit q2.30"):  # it rounds to 2
        make(Block("gain", {"gain": 2.0 - 2.0**-32}), precision="q2.30")


UNSTABLE = "block 2 ({}) of loop 'theta2' has a pole on or outside the unit circle; received |z| = 1 when rounded to {}"


@pytest.mark.parametrize(
    ("kind", "parameters", "precision"),
    [
        ("lead_lag", {"f1_hz": 0.02, "f2_hz": 0.001}, "q2.14"),
        ("notch", {"f1_hz": 0.4, "f2_hz": 0.4, "damping1": 0.05, "damping2": 0.7}, "q2.14"),
        ("low_pass_1", {"f_hz": 1e-6}, "single"),
    ],
)
def test_poles_that_rounding_puts_on_the_unit_circle(kind, parameters, precision):
    with pytest.raises(
        ls.errors.WrongUseError, match=re.escape(UNSTABLE.format(kind, precision)) + ".*use a finer precision"
    ):
        make(GAIN, Block(kind, parameters), precision=precision)


@pytest.mark.parametrize(("f_hz", "precision"), [(0.001, "q2.14"), (1e-6, "single")])
def test_a_pi_whose_zero_rounds_onto_its_pole(f_hz, precision):
    with pytest.raises(ls.errors.WrongUseError, match=r"block 1 \(pi\) of loop 'theta2' has lost its integrator"):
        make(Block("pi", {"f_hz": f_hz}), precision=precision)


def test_a_block_that_lets_nothing_pass():
    with pytest.raises(
        ls.errors.WrongUseError, match=r"block 1 \(low_pass_1\) .* lets nothing pass; .*q2.14 rounds to 0"
    ):
        make(Block("low_pass_1", {"f_hz": 0.001}), precision="q2.14")
    with pytest.raises(ls.errors.WrongUseError, match="lets nothing pass"):
        make(Block("gain", {"gain": 1e-50}), precision="single")
    assert make(Block("gain", {"gain": 0.0}), precision="single").biquads()[0, 0] == 0.0  # asked for


def test_a_double_that_runs_unstably_is_not_exported(tmp_path):
    slowest = ls.Controller("x", (Block("low_pass_1", {"f_hz": 1e-14}),), 1000.0)
    with pytest.raises(ls.errors.WrongUseError, match=r"pole on or outside the unit circle.*rounded to double"):
        export_controllers(tmp_path / "out", [make(), slowest], "c")
    assert not (tmp_path / "out").exists()


def test_step():
    with pytest.raises(
        ls.errors.WrongUseError, match=r"q2.14 answers to whole numbers; received float64; scale and round"
    ):
        step(make(precision="q2.14"), [0.5])
    with pytest.raises(ls.errors.WrongUseError, match="one signal"):
        step(make(), np.zeros((2, 2)))


def test_export(tmp_path):
    def no(controllers, to, words):
        with pytest.raises(ls.errors.WrongUseError, match=words):
            export_controllers(tmp_path / "out", controllers, to)
        assert not (tmp_path / "out").exists()

    def named(name):
        return ls.Controller(name, (GAIN,), 1000.0)

    no(
        [make()],
        "C",
        "format for controllers is not known; received 'C'; did you mean 'c'. use json, matlab, simulink, c",
    )
    no([], "c", "no controller")
    no([named("a b"), named("a_b")], "c", "two loops would become one file; received controller_a_b.h")
    no([named("Axis"), named("axis")], "json", "two loops would become one file")
    no([named("!?")], "matlab", r"makes no identifier; received '!\?'")


LOOP = {
    "name": "axis",
    "injected": "n_m",
    "control": "z_v",
    "output": "y_m",
    "controller": [{"kind": "gain", "gain": 1.0}],
}


def test_a_run_s_loop_has_no_delay_or_hold_of_its_own():
    for setting in ({"computation_delay_s": 1e-3}, {"added_hold": True}):
        with pytest.raises(
            ls.errors.WrongUseError, match=r"contains the hold and the delay of its controller.*leave them out of a"
        ):
            read_loops(ConfigTable({"loop": [LOOP | setting]}, "run.toml"), 100.0)
    late = ls.Controller("axis", (GAIN,), 100.0, computation_delay_s=1e-3)
    with pytest.raises(
        ls.errors.WrongUseError, match=r"loop 'axis': a recording .*computation_delay_s = 0.001, added_hold = false"
    ):
        loop_table(LoopSetup("axis", None, "n_m", "z_v", "y_m", late))
    recorded = replace(late, computation_delay_s=0.0, added_hold=False)
    assert "computation_delay_s" not in loop_table(LoopSetup("axis", None, "n_m", "z_v", "y_m", recorded))


def test_settings_without_a_controller():
    bare = {key: value for key, value in LOOP.items() if key != "controller"}
    for key, value in (("prewarp_hz", 5.0), ("precision", "single")):
        with pytest.raises(
            ls.errors.WrongUseError, match=f"run.toml, loop .*: {key} goes with a controller; received no controller"
        ):
            read_loops(ConfigTable({"loop": [bare | {key: value}]}, "run.toml"), 100.0)


FILE = """
format = "loopshape-controllers/1"
rate_hz = 100.0
[[loop]]
name = "x"
controller = [{ kind = "gain", gain = 1.0 }]
"""


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("prewarp = 5.0", "unknown key; received 'prewarp'; .*known are .*prewarp_hz"),
        ('prewarp_hz = "5"', "prewarp_hz must be a finite number; received '5'"),
        (
            "prewarp_hz = 50.0",
            "c.toml, loop 'x'.*prewarp_hz of loop 'x' must lie above 0 and below half the rate, 50 Hz",
        ),
        ("computation_delay_s = -1", "computation_delay_s of loop 'x' must not be negative"),
        ("added_hold = 1", "added_hold must be true or false"),
        ("precision = 32", "precision must be a text"),
        ('precision = "q1.31"', 'coefficient b0 of block 1 .* does not fit q1.31.*use "q2.30"'),
    ],
)
def test_controller_files(tmp_path, line, words):
    (tmp_path / "c.toml").write_text(f"{FILE}{line}\n")
    with pytest.raises(ls.errors.WrongUseError, match=words):
        ls.read_controllers(tmp_path / "c.toml")
