"""Controllers with limits: the exported C and structured text answer bit for bit as the simulated law, and that as a PI
with anti-windup written out here."""

import re
import struct
import subprocess

import control
import numpy as np
import pytest
from bench_nouns import Block
from commands import invoked
from exported_controllers import RATE_HZ
from test_exported_c_is_the_controller_that_was_checked import FLAGS, compiler

import loopshape as ls
from loopshape.toolbox.formats.controllers.controller_words import identifier
from loopshape.toolbox.formats.controllers.limited import Running, limited

PID = Block("pid", {"gain": 0.8, "fi_hz": 0.7, "fd_hz": 3.0, "ff_hz": 19.0})
NOTCH = Block("notch", {"f1_hz": 4.5, "f2_hz": 6.1, "damping1": 0.05, "damping2": 0.8})
PI, LAG = Block("pi", {"f_hz": 0.7}), Block("low_pass_1", {"f_hz": 10.0})
SERIES = {
    "pi": (PI, NOTCH, LAG), "pid": (NOTCH, PID), "down": (Block("pid", {**PID.parameters, "gain": -0.8}), LAG),
    "proportional": (Block("gain", {"gain": 3.0}), LAG), "two": (PI, LAG, Block("pi", {"f_hz": 0.2})),
}  # fmt: skip
LIMITS = {
    "back": {"anti_windup": "back_calculation"}, "slow": {"anti_windup": "back_calculation", "tracking_s": 0.13},
    "conditional": {"anti_windup": "conditional"}, "rate": {"anti_windup": "back_calculation", "rate": 7.0},
}  # fmt: skip
CASES = [
    (f"{series}-{how}-{precision}", series, how, precision)
    for series in SERIES for how in LIMITS for precision in ("double", "single")
    if series != "two" or how == "conditional"
]  # fmt: skip
DOUBLE = [case[:3] for case in CASES if case[3] == "double"]
_MAIN = """
#include <stdio.h>
#include <string.h>
#include "{header}"

int main(int argc, char **argv)
{{
    {name}_state state;
    {kind} in, out;
    (void)argv;
    memset(&state, 0x55, sizeof state);
    {name}_reset(&state);
    if (argc == 2)
        {name}_start(&state, ({kind})0.25, ({kind})0.4);
    while (fread(&in, sizeof in, 1, stdin) == 1) {{
        out = {name}_step(&state, in);
        if (fwrite(&out, sizeof out, 1, stdout) != 1) return 4;
    }}
    return 0;
}}
"""


def made(name, series, how, precision):
    controller = ls.Controller(name, SERIES[series], RATE_HZ, precision=precision)
    return controller, ls.formats.OutputLimits(-0.5, 0.9, **LIMITS[how])


def inputs(n=3000):
    rng = np.random.default_rng(3)
    return rng.standard_normal(n) * 10.0 ** rng.uniform(-3.0, 1.0, n) + np.repeat([0.0, 0.3, -0.8, 0.0], n // 4)


def run(controller, limits, given, start):
    law = Running(limited(controller, limits))
    if start:
        law.start(0.25, 0.4)
    return np.array([law.step(float(x)) for x in given])


@pytest.mark.parametrize(("name", "series", "how", "precision"), CASES, ids=[case[0] for case in CASES])
def test_c_answers_bit_for_bit(tmp_path, name, series, how, precision):
    controller, limits = made(name, series, how, precision)
    (path,) = ls.formats.export(controller, tmp_path, "c", limits)
    dtype, kind = (np.float64, "double") if precision == "double" else (np.float32, "float")
    (tmp_path / "main.c").write_text(_MAIN.format(header=path.name, name=identifier(name), kind=kind))
    subprocess.run([*compiler(), *FLAGS, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    given = inputs().astype(dtype)
    for arguments in ([], ["start"]):
        done = subprocess.run([tmp_path / "main", *arguments], input=given.tobytes(), capture_output=True, check=True)
        answer = np.frombuffer(done.stdout, dtype=dtype)
        np.testing.assert_array_equal(answer, run(controller, limits, given, bool(arguments)).astype(dtype))
        assert answer.min() >= -0.5
        assert answer.max() <= dtype(0.9)


def as_python(text):
    """A function block of structured text as a Python function of a dict of its variables."""
    code = text.split("END_VAR")[-1].split("END_FUNCTION_BLOCK")[0]
    code = re.sub(r"\(\*.*?\*\)", "", code)
    lines, depth = [], 0
    for statement in re.findall(r"\s*(IF .*? THEN|END_IF|[^;]+;)", code.replace("\n", " ")):
        one = statement.strip().rstrip(";")
        if one.startswith("END_IF"):
            depth -= 1
            one = one.removeprefix("END_IF").strip()
        if one.startswith("IF "):
            lines.append("    " * depth + "if " + one[3:-5].replace("NOT ", "not ") + ":")
            depth += 1
        elif one:
            lines.append("    " * depth + one.replace(":=", "="))
    return compile("\n".join(lines), "fb", "exec")


@pytest.mark.parametrize(("name", "series", "how"), DOUBLE, ids=[case[0] for case in DOUBLE])
def test_structured_text_answers_bit_for_bit(tmp_path, name, series, how):
    controller, limits = made(name, series, how, "double")
    (path,) = ls.formats.export(controller, tmp_path, "st", limits)
    text, given = path.read_text(), inputs(800)
    code = as_python(text)
    for start in (False, True):
        at = {found: 0.0 for found in re.findall(r"(\w+) : LREAL", text)} | {"bReset": True, "bStart": start}
        at |= {"fStart": 0.4, "fIn": 0.25}
        answers = []
        for k, value in enumerate(given):
            if k == 0 and start:  # the block starts with the error that it is given, and steps with it
                exec(code, {}, at)
                at |= {"bReset": False, "bStart": False}
                expected = Running(limited(controller, limits))
                expected.start(0.25, 0.4)
                assert at["fOut"] == expected.step(0.25)
            at["fIn"] = float(value)
            exec(code, {}, at)
            at |= {"bReset": False, "bStart": False}
            answers.append(at["fOut"])
        if start:
            np.testing.assert_array_equal(answers, [expected.step(float(x)) for x in given])
        else:
            np.testing.assert_array_equal(answers, run(controller, limits, given, False))


def test_without_reaching_a_limit_it_is_the_controller_itself():
    controller = ls.Controller("x", SERIES["pi"], RATE_HZ)
    given = 1e-3 * inputs(500)
    free = control.forced_response(ls.to_control(controller), U=given).outputs
    wide = ls.formats.OutputLimits(-1e3, 1e3)
    np.testing.assert_allclose(run(controller, wide, given, False), free, rtol=1e-9, atol=1e-12)


def test_a_pi_winds_back_as_its_velocity_form():
    """u += b0 e + b1 e_before from the output that was given, not from the one that was asked for."""
    w = 2 * np.pi * 0.7 / (2 * RATE_HZ)  # Tustin's corner, not prewarped
    controller = ls.Controller("x", (PI,), RATE_HZ)
    given, u, before, expected = inputs(400), 0.0, 0.0, []
    for e in given:
        u = float(np.clip(u + (1.0 + w) * e - (1.0 - w) * before, -0.5, 0.9))
        before = e
        expected.append(u)
    answer = run(controller, ls.formats.OutputLimits(-0.5, 0.9), given, False)
    np.testing.assert_allclose(answer, expected, atol=1e-9)


def test_it_takes_over_without_a_bump():
    for series, how in (("pi", "back"), ("pid", "conditional"), ("down", "rate")):
        controller, limits = made("x", series, how, "double")
        law = Running(limited(controller, limits))
        law.start(0.0, 0.4)
        np.testing.assert_allclose([law.step(0.0) for _ in range(50)], 0.4, atol=1e-12)


@pytest.mark.parametrize("beyond", [-5.0, 5.0])
def test_it_takes_over_beyond_the_limits_at_their_end(tmp_path, beyond):
    """The files say that the output stays within its ends; with a rate it came back from 5 over hundreds of samples."""
    controller, limits = made("x", "pid", "rate", "double")
    law, given = Running(limited(controller, limits)), inputs(400)
    law.start(0.25, beyond)
    expected = [law.step(float(x)) for x in given]
    assert min(expected) >= -0.5
    assert max(expected) <= 0.9
    (path,) = ls.formats.export(controller, tmp_path, "c", limits)
    text = _MAIN.format(header=path.name, name=identifier("x"), kind="double")
    (tmp_path / "main.c").write_text(text.replace("(double)0.4", f"(double){beyond}"))
    subprocess.run([*compiler(), *FLAGS, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "main", "start"], input=given.tobytes(), capture_output=True, check=True)
    np.testing.assert_array_equal(np.frombuffer(done.stdout), expected)
    (path,) = ls.formats.export(controller, tmp_path, "st", limits)
    at = {found: 0.0 for found in re.findall(r"(\w+) : LREAL", path.read_text())}
    at |= {"bReset": True, "bStart": True, "fStart": beyond, "fIn": 0.25}
    code, answers, again = as_python(path.read_text()), [], Running(limited(controller, limits))
    again.start(0.25, beyond)
    for value in (0.25, *given):
        at["fIn"] = float(value)
        exec(code, {}, at)
        at |= {"bReset": False, "bStart": False}
        answers.append(at["fOut"])
    np.testing.assert_array_equal(answers, [again.step(float(x)) for x in (0.25, *given)])


def test_structured_text_has_no_two_signs_in_a_row(tmp_path):
    """A section written with a negative denominator has coefficients that are minus zero."""
    turned = Block("section", {"n0": -1.0, "n1": 0.0, "n2": 0.0, "d0": -1.0, "d1": -0.1, "d2": 0.0})
    (path,) = ls.formats.export(ls.Controller("x", (turned, PI), RATE_HZ), tmp_path, "st")
    assert not re.search(r"[-+*] -", path.read_text())


def test_a_simulated_loop_has_the_delay_of_its_controller():
    """A delay of two samples that the verdict counts and the simulation did not; the truth is python-control's loop."""
    C = ls.controller(ls.gain(3.0), ls.pi(0.2), rate_hz=RATE_HZ, computation_delay_s=2.0 / RATE_HZ)
    P, r = control.tf([1.0], [0.1, 1.0, 0.0]), np.ones(300)
    L = control.sample_system(control.ss(P), 1.0 / RATE_HZ, method="zoh") * ls.to_control(C)
    truth = control.forced_response(control.feedback(L), U=r).outputs
    wide = ls.formats.OutputLimits(-1e6, 1e6)
    np.testing.assert_allclose(ls.formats.simulate(P, C, wide, setpoint=r).output, truth, atol=1e-8)
    odd = ls.controller(ls.gain(1.0), rate_hz=RATE_HZ, computation_delay_s=0.3 / RATE_HZ)
    with pytest.raises(ls.errors.WrongUseError, match="whole samples of delay"):
        ls.formats.simulate(P, odd, wide, setpoint=r)


def test_anti_windup_lets_a_step_come_back_sooner():
    P, C = (
        control.tf([1.0], [0.5, 1.0, 0.0]),
        ls.controller(ls.gain(3.0), ls.pi(0.2), ls.lead_lag(1.0, 10.0), rate_hz=RATE_HZ),
    )
    step = np.ones(1500)
    overshoot = {
        how: ls.formats.simulate(P, C, ls.formats.OutputLimits(-0.3, 0.3, **LIMITS[how]), setpoint=step).output.max()
        for how in ("back", "conditional")
    }
    free = ls.formats.simulate(P, C, ls.formats.OutputLimits(-1e6, 1e6), setpoint=step)
    assert free.limited_percent == 0.0
    wound = ls.formats.OutputLimits(-0.3, 0.3, tracking_s=1e9)  # an integrator that is hardly wound back
    assert max(overshoot.values()) < ls.formats.simulate(P, C, wound, setpoint=step).output.max() - 0.02


def test_the_command_writes_limits_and_refuses_what_has_none(tmp_path):
    ls.write(ls.controller(ls.gain(2.0), ls.pi(1.0), rate_hz=RATE_HZ, loop="axis"), tmp_path / "c.toml")
    words = ["export-controller", str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]
    done = invoked([*words, "--to", "c", "--limits=-1:1:50"])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "out" / "controller_axis.h").read_text()
    assert "from -1.0 to 1.0, and changes by 50.0 a second at most" in text
    for wrong in (["--to", "matlab", "--limits=-1:1"], ["--to", "c", "--limits=1:-1"], ["--to", "c", "--limits=a"],
                  ["--to", "c", "--limits=-1:1", "--anti-windup", "none"]):  # fmt: skip
        assert isinstance(invoked([*words, *wrong]).exception, ls.errors.WrongUseError)
    (twice,) = ls.read_controllers(tmp_path / "c.toml")
    with pytest.raises(ls.errors.WrongUseError, match="winds one integrator back"):
        ls.formats.export(ls.Controller("x", SERIES["two"], RATE_HZ), tmp_path, "c", ls.formats.OutputLimits(-1.0, 1.0))
    assert struct.calcsize("d") == 8
    assert twice.loop == "axis"
