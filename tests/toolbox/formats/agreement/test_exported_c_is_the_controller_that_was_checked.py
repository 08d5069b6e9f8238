"""The exported C, compiled, answers bit for bit as `step` does, and `step` has the response that `check` judges."""

import os
import shlex
import shutil
import struct
import subprocess

import numpy as np
import pytest
from bench_nouns import Block, Precision
from exported_controllers import RATE_HZ, cases, inputs

import loopshape as ls
from loopshape.toolbox.formats.controllers.controller_export import export_controllers
from loopshape.toolbox.formats.controllers.controller_words import identifier, step

COMPILER = shlex.split(os.environ.get("CC", "cc"))
FLAGS = ("-std=c99", "-O0", "-ffp-contract=off", "-Wall", "-Wextra", "-pedantic", "-Werror")
SAMPLES = 4000
CASES = cases()
_MAIN = """
#include <stdint.h>
#include <stdio.h>
#include <string.h>
{includes}

int main(int argc, char **argv)
{{
    if (argc != 2) return 2;
{branches}
    return 3;
}}
"""
_BRANCH = """
    if (strcmp(argv[1], "{name}") == 0) {{
        {name}_state state;
        {kind} in, out;
        memset(&state, 0x55, sizeof state);
        {name}_reset(&state);
        while (fread(&in, sizeof in, 1, stdin) == 1) {{
            out = {name}_step(&state, in);
            if (fwrite(&out, sizeof out, 1, stdout) != 1) return 4;
        }}
        return 0;
    }}
"""


def kind(controller):
    return {"double": "double", "single": "float"}.get(controller.precision, "int32_t")


def compiler():
    if shutil.which(COMPILER[0]) is None:
        pytest.skip(f"no C compiler: {COMPILER[0]} is not here (set CC)")
    return COMPILER


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """One program with the headers of all controllers, which takes inputs on its standard input."""
    folder = tmp_path_factory.mktemp("c")
    paths = export_controllers(folder, list(CASES.values()), "c")
    branches = [_BRANCH.format(name=identifier(c.loop), kind=kind(c)) for c in CASES.values()]
    includes = "\n".join(f'#include "{path.name}"' for path in paths)
    (folder / "main.c").write_text(_MAIN.format(includes=includes, branches="".join(branches)))
    subprocess.run([*compiler(), *FLAGS, "main.c", "-o", "main"], cwd=folder, check=True)
    return folder / "main"


def answers(program, controller, given):
    dtype = {"double": np.float64, "float": np.float32, "int32_t": np.int32}[kind(controller)]
    done = subprocess.run(
        [program, identifier(controller.loop)], input=given.astype(dtype).tobytes(), capture_output=True, check=True
    )
    return np.frombuffer(done.stdout, dtype=dtype)


@pytest.mark.parametrize("name", CASES)
def test_compiled_c_answers_bit_for_bit(program, name):
    controller = CASES[name]
    given = inputs(controller, SAMPLES, seed=len(name))
    mine = step(controller, given)
    theirs = answers(program, controller, given)
    assert theirs.size == mine.size == SAMPLES
    assert np.ptp(mine) > 0
    assert theirs.astype(mine.dtype).tobytes() == mine.tobytes()


def test_some_of_these_signals_are_clipped():
    given = inputs(CASES["series-q5_27"], SAMPLES, seed=1)
    limit = CASES["series-q5_27"].number_format.signal_limit
    assert np.abs(given).max() > limit
    assert np.sum(np.abs(step(CASES["gain-q5_27"], given)) == limit) > 5


def test_double_is_the_rigs_kernel():
    from loopshape.core.kernels import biquads

    controller = CASES["series-double"]
    given, sections = inputs(controller, SAMPLES, seed=2), controller.biquads()
    kernel = biquads.run(sections, np.zeros((len(sections), 2)), given)
    np.testing.assert_allclose(kernel, step(controller, given), rtol=1e-9, atol=1e-9)  # it may contract


@pytest.mark.parametrize("name", CASES)
def test_each_header_stands_alone_in_c_and_cplusplus(tmp_path, name):
    (path,) = export_controllers(tmp_path, [CASES[name]], "c")
    (tmp_path / "one.c").write_text(f'#include "{path.name}"\n#include "{path.name}"\nint main(void) {{ return 0; }}\n')
    subprocess.run([*compiler(), *FLAGS, "-fsyntax-only", "one.c"], cwd=tmp_path, check=True)
    if shutil.which("c++") is None:
        pytest.skip("no C++ compiler: the header was compiled as C only")
    flags = ("-x", "c++", "-std=c++11", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only")
    subprocess.run(["c++", *flags, "one.c"], cwd=tmp_path, check=True)


def test_coefficients_at_the_ends_of_int32(tmp_path):
    ends = ls.Controller("ends", (Block("gain", {"gain": -2.0}), Block("gain", {"gain": 2.0 - 2.0**-30})), 1.0)
    ends = ls.Controller(ends.loop, ends.blocks, 1.0, precision="q2.30")
    (path,) = export_controllers(tmp_path, [ends], "c")
    text = _MAIN.format(
        includes=f'#include "{path.name}"', branches=_BRANCH.format(name="controller_ends", kind="int32_t")
    )
    (tmp_path / "main.c").write_text(text)
    flags = (*FLAGS, "-fsanitize=undefined", "-fno-sanitize-recover=all")
    built = subprocess.run(
        [*compiler(), *flags, "main.c", "-o", "main"], cwd=tmp_path, capture_output=True, check=False
    )
    if built.returncode:  # a compiler without the sanitiser
        subprocess.run([*compiler(), *FLAGS, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    given = np.array([2**31 - 1, -(2**31), 1, -1, 0, 12345, -(2**28), 2**28])
    np.testing.assert_array_equal(answers(tmp_path / "main", ends, given), step(ends, given))


def response_of(controller, size, n):
    """Response (n/2 - 1,) on lines f k/n by the answer to a step of `size`, its differences being the pulse response.

    A controller with an integrator has differences that settle too: those of the differences.
    """
    given = np.full(n, size)
    answer = step(controller, given.astype(np.int64) if controller.number_format.fixed else given).astype(float) / size
    pulse = np.diff(answer, prepend=0.0)
    lines = np.arange(1, n // 2)
    if not controller.integrators():
        return lines * RATE_HZ / n, np.fft.fft(pulse)[1 : n // 2]
    once = np.fft.fft(np.diff(pulse, prepend=0.0))[1 : n // 2]
    return lines * RATE_HZ / n, once / (1.0 - np.exp(-2j * np.pi * lines / n))


@pytest.mark.parametrize("name", CASES)
def test_step_has_the_response_that_is_checked(name):
    controller, form, n = CASES[name], CASES[name].number_format, 256
    size = float(form.signal_limit // 400) if form.fixed else 1.0  # the largest answer is below 200 times the step
    # an answer's rounding taken as noise of one unit (of 10 eps) a sample: sqrt(n) of it in the sum, times ten
    unit = 1.0 / size if form.fixed else 10.0 * {"double": 2.0**-53, "single": 2.0**-24}[form.name]
    f, found = response_of(controller, size, n)
    expected = controller.response(f)
    assert np.max(np.abs(found - expected)) < 10.0 * np.sqrt(n) * unit * np.max(np.abs(expected))


def test_a_fixed_point_integrator_loses_nothing():
    pi = ls.Controller("pi", (Block("pi", {"f_hz": 0.01}),), 1000.0, precision="q2.30")
    answer = step(pi, np.ones(200_000, dtype=np.int64))
    # one unit, held for 200 s, through (s + w)/s: 1 + 2 pi 0.01 200; a rounded output alone would stay at 1
    assert abs(answer[-1] - (1.0 + 2.0 * np.pi * 0.01 * 200.0)) <= 1.0


def test_hexadecimal_numbers_are_those_of_the_sections(tmp_path):
    import json

    for controller in CASES.values():
        (path,) = export_controllers(tmp_path, [controller], "json")
        table = json.loads(path.read_text())
        names = ("b0", "b1", "b2", "a1", "a2")
        decimal = [[one[name] for name in names] for one in table["sections"]]
        hexadecimal = [[float.fromhex(one["hex"][name]) for name in names] for one in table["sections"]]
        assert struct.pack(f"{len(decimal) * 5}d", *np.ravel(decimal)) == controller.biquads().tobytes()
        assert hexadecimal == decimal
        if controller.number_format.fixed:
            whole = [[one["integers"][name] for name in names] for one in table["sections"]]
            unit = 2.0 ** -table["fixed_point"]["fraction_bits"]
            np.testing.assert_array_equal(np.array(whole) * unit, decimal)


@pytest.mark.parametrize("bits", range(2, 46))
def test_no_sum_of_products_leaves_int64(bits):
    form = Precision.of(f"q1.{bits - 1}")
    product = 2 ** (bits - 1) * form.signal_limit  # of the largest coefficient and the largest signal
    rest = 2 * 2 ** (form.fraction_bits - 1)  # the largest error that is fed back, twice half a unit
    second = 2 * product + rest
    first = 2 * product + rest + second
    assert product + first + 2 ** (form.fraction_bits - 1) < 2**63
    assert form.signal_limit >= 2**15 - 1
