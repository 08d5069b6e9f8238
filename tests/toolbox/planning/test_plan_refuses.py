"""What a planner cannot do, and the sentence that the user gets."""

import known_loops as known
import numpy as np
import pytest
from bench_nouns import LoopSetup
from study_signals import Multisine

import loopshape as ls
from loopshape.toolbox.planning.plan import plan
from loopshape.toolbox.planning.plan_nouns import Required
from loopshape.toolbox.planning.plan_record import first_record


@pytest.fixture(scope="module")
def record():
    signal = Multisine(0.5, 40.0, 10.0, 1.5, 4, ramp_s=1.0)
    n = signal.signal(known.RATE)
    z, y = known.run_loop("controller_input", n, 0.05 * np.random.default_rng(1).standard_normal(n.size))
    return first_record(known.record("controller_input", "multisine", n, z, y, period_s=10.0, from_s=1.0), known.LOOP)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ({"std": 0.0}, "std of a plan must be positive"),
        ({"std": 0.9}, "below 50 %"),
        ({"std": 0.01, "longest_s": -1.0}, "longest s of a plan must be positive"),
        ({"std": 0.01, "max_input": float("nan")}, "max input of a plan must be positive"),
        ({"std": 0.01, "kind": "even"}, "a kind of frequency grid is not known"),
    ],
)
def test_wishes_that_are_none(words, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence):
        Required(**words)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ({"at_hz": 45.0}, "does not know the response where it is wanted"),
        ({"at_hz": 6.0, "f_low_hz": 0.01}, "does not know the band"),
        ({"at_hz": 6.0, "f_low_hz": 8.0, "f_high_hz": 5.0}, "does not know the band"),
        ({"at_hz": 6.0, "max_input": 1e-4}, "plant's input leaves no room"),
        ({"at_hz": 6.0, "max_output": 1e-4}, "plant's output leaves no room"),
        ({"at_hz": 6.0, "longest_s": 3.0}, "no 4 periods of the lowest frequency"),
    ],
)
def test_wishes_beside_what_the_record_knows(record, words, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence):
        plan(record, Required(0.01, **words))


def test_a_crossover_needs_a_controller_and_a_loop_that_crosses(record):
    from dataclasses import replace

    from bench_nouns import Block

    unknown = LoopSetup("axis", "r_rad", "n_rad", "z_v", "y_rad", None)
    with pytest.raises(ls.errors.WrongUseError, match="--at HZ"):
        plan(replace(record, loop=unknown), Required(0.01))
    with pytest.raises(ls.errors.WrongUseError, match="no crossover where the first recording is sure"):
        plan(record, Required(0.01), ls.Controller("axis", (Block("gain", {"gain": 1e-6}),), known.RATE))


def test_a_record_that_only_shows_the_inverse_controller_is_refused():
    signal = Multisine(0.5, 40.0, 10.0, 1e-4, 2, ramp_s=1.0)
    n = signal.signal(known.RATE)
    z, y = known.run_loop("controller_input", n, np.random.default_rng(1).standard_normal(n.size))
    made = known.record("controller_input", "multisine", n, z, y, period_s=10.0, from_s=1.0)
    with pytest.raises(ls.LoopshapeError, match=r"is valid|does not exceed the noise"):
        first_record(made, known.LOOP)
