"""Hostile frames by the thousand, and by the million under `make test-long`: the target in C and both decoders."""

import subprocess
from pathlib import Path

import cortex_m_cases
import numpy as np
import pytest
from target_cases import CORE, SANITIZERS, TARGET, WARNINGS, compiler

from loopshape.toolbox.rig.target.frames import Frame, Receiver, opened

SIZES = ["-DTARGET_ROWS=64", "-DTARGET_TICKS=64", "-DTARGET_LOOPS=2", "-I", str(TARGET)]


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory):
    """The fuzzing program, with sanitizers where the compiler has them."""
    out = tmp_path_factory.mktemp("fuzzed") / "fuzzed_target"
    units = [str(Path(__file__).with_name("fuzzed_target.c")), *(str(TARGET / name) for name in CORE)]
    command = [*compiler(), *WARNINGS, "-O1", *SIZES]
    made = subprocess.run([*command, *SANITIZERS, *units, "-o", str(out), "-lm"], capture_output=True, check=False)
    if made.returncode:
        subprocess.run([*command, *units, "-o", str(out), "-lm"], check=True)
    return out


def executed(program, first, count):
    """Executions, frames, arms and vents; what it broke is in the error."""
    made = subprocess.run([program, str(first), str(count)], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr[-2000:]
    print(made.stdout)
    return [int(word) for word in made.stdout.split()]


@pytest.mark.long
def test_no_execution_moves_an_unarmed_machine_or_swallows_a_vent(fuzzed):
    count, frames, arms, vents = executed(fuzzed, 1, 20_000)
    assert count == 20_000
    assert frames > 100_000
    assert arms > 10_000
    assert vents > 5_000


@pytest.mark.long
@pytest.mark.parametrize("part", range(7))
def test_a_million_and_a_half_executions(fuzzed, part):
    assert executed(fuzzed, 10**6 * (part + 1), 200_000)[0] == 200_000


@pytest.mark.long
def test_the_cortex_m_does_in_each_execution_what_this_machine_does(fuzzed, tmp_path):
    """Frames, arms and vents are drawn by what the target answers: a bit of another state or number shows in them."""
    units = [Path(__file__).with_name("fuzzed_target.c"), *(TARGET / name for name in CORE)]
    said = cortex_m_cases.executed(tmp_path, units, SIZES, ["1", "5000"])
    assert [int(word) for word in said.split()] == executed(fuzzed, 1, 5000)


def taken_of(data):
    receiver = Receiver()
    return sum(1 for _ in receiver.take(data)), receiver.bad


def mutations(rng, count):
    """Frames of up to 40 bytes, each with one bit, byte or length changed, or cut, or two run into one."""
    frames = [Frame(int(rng.integers(128)), int(rng.integers(1, 65536)), rng.bytes(int(n))).encoded for n in range(40)]
    kinds, which = rng.integers(5, size=count).tolist(), rng.integers(40, size=count).tolist()
    places, values = rng.random(count).tolist(), rng.integers(1, 256, size=count).tolist()
    for kind, one, place, value in zip(kinds, which, places, values, strict=True):
        data = bytearray(frames[one])
        at = int(place * (len(data) - 1))
        if kind == 0:
            data[at] ^= 1 << value % 8
        elif kind == 1:
            data[at] ^= value
        elif kind == 2:
            data[0] = value
        elif kind == 3:
            del data[at]
        else:
            data = data[: at + 1] + frames[(one + value) % 40]
        yield bytes(data), frames[one]


def no_mutation_passes(seed, count):
    changed = 0
    for data, whole in mutations(np.random.default_rng(seed), count):
        pieces = [piece for piece in data.split(b"\0") if piece]
        found = [piece for piece in pieces if opened(piece) is not None]
        taken, bad = taken_of(data + b"\0")
        assert (taken, taken + bad) == (len(found), len(pieces))
        changed += data != whole
        # a CRC-32 sees any change of up to 32 bits in a row; what passes is a frame that was put in whole
        assert all(piece + b"\0" == whole or data.endswith(piece + b"\0") for piece in found)
    return changed


def test_no_changed_frame_is_taken_for_another():
    assert no_mutation_passes(1, 20_000) > 15_000


@pytest.mark.long
@pytest.mark.parametrize("part", range(10))
def test_two_million_changed_frames(part):
    assert no_mutation_passes(100 + part, 200_000) > 150_000
