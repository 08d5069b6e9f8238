"""Loops that cannot be excited at once, and the sentence that the user gets."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, Experiment, LoopSetup
from study_signals import BandNoise, Multisine, Prbs, Sweep

import loopshape as ls
from loopshape.toolbox.rig.files.excitation_sets import realised, together
from loopshape.toolbox.rig.study import ExperimentTemplate, expanded

ONE = Multisine(0.5, 20.0, 4.0, 1.0)
HISS = BandNoise(0.5, 20.0, 40.0, 1.0, seed=1)


@pytest.mark.parametrize("other", [Sweep(0.5, 20.0, 10.0, 1.0), Prbs(7, 0.01, 1.0), HISS])
@pytest.mark.parametrize("swapped", [False, True])
def test_other_kinds_and_mixtures(other, swapped):
    signals = {"a": other, "b": ONE} if swapped else {"a": ONE, "b": other}
    with pytest.raises(
        ls.errors.WrongUseError,
        match=rf"alone or by noise alone; received .*{other.kind}.*; give each a multisine .* one loop",
    ):
        together(signals)


def test_sweeps_alone():
    with pytest.raises(ls.errors.WrongUseError, match="received a sweep, b sweep; give each a multisine"):
        together({"a": Sweep(0.5, 20.0, 10.0, 1.0), "b": Sweep(1.0, 20.0, 10.0, 1.0)})


def test_a_single_loop():
    with pytest.raises(
        ls.errors.WrongUseError, match="two or more; received a; for one loop write excites and excitation"
    ):
        together({"a": ONE})
    with pytest.raises(ls.errors.WrongUseError, match="two or more; received none"):
        together({})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"period_s": 8.0}, r"share their period, .*received a 4\.0 s, b 8\.0 s"),
        ({"periods": 3}, r"share their number of periods, .*received a 4, b 3"),
        ({"ramp_s": 2.0}, r"share their ramp, .*received a 1\.0 s, b 2\.0 s"),
        ({"f_high_hz": 20.5}, r"share their lines, .*received a and b differ at 20\.25, 20\.5 Hz"),
        ({"odd": True}, r"a and b differ at 0\.5, 1, 1\.5, 2, 2\.5 \.\.\. Hz"),
    ],
)
def test_multisines_that_are_not_alike(changes, words):
    with pytest.raises(
        ls.errors.WrongUseError, match=f"{words}; give them the same, or excite one loop after the other"
    ):
        together({"a": ONE, "b": replace(ONE, **changes)})


def test_noises_of_one_seed_or_of_two_lengths():
    with pytest.raises(
        ls.errors.WrongUseError, match=r"identical.*received a seed 1, b seed 1; give each loop another seed"
    ):
        together({"a": HISS, "b": BandNoise(1.0, 30.0, 40.0, 2.0, seed=1)})
    with pytest.raises(ls.errors.WrongUseError, match="one duration; received a 40 s, b 20 s; give them the same"):
        together({"a": HISS, "b": BandNoise(0.5, 20.0, 20.0, 1.0, seed=2)})


@pytest.mark.parametrize(
    ("signals", "received"), [({"a": HISS}, "a noise"), ({"a": Sweep(0.5, 20.0, 10.0, 1.0)}, "a sweep"), ({}, "no exc")]
)
def test_realisations_without_phases(signals, received):
    with pytest.raises(
        ls.errors.WrongUseError, match=f"phases are drawn anew; received {received}.*; use a multisine, or leave"
    ):
        realised(signals, 1)


@pytest.mark.parametrize("number", [0, -1, 1001])
def test_number_of_realisations(number):
    with pytest.raises(ls.errors.WrongUseError, match=f"are 1 to 1000; received {number}; leave it out for one"):
        expanded(ExperimentTemplate("e", "multisine", "plant_input", "a", ONE), number)


def test_templates_with_a_loop_too_many():
    with pytest.raises(
        ls.errors.WrongUseError, match="'e' excites further loops and no first one; received b; give excites"
    ):
        ExperimentTemplate("e", "multisine", "plant_input", excites_also={"b": ONE})
    with pytest.raises(ls.errors.WrongUseError, match="'e' excites a loop twice; received 'a'; name it once"):
        ExperimentTemplate("e", "multisine", "plant_input", "a", ONE, excites_also={"a": ONE})


@pytest.mark.parametrize(("turn", "turns"), [(0.25, 2), (1.0 / 3.0, 2), (float("nan"), 2), (0.5, 3), (0.0, 65)])
def test_turn_that_is_none_of_the_turns(turn, turns):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"whole multiple of 1/turns cycles.*received turn = .*give turns, for examp"
    ):
        Multisine(0.5, 20.0, 4.0, 1.0, turn=turn, turns=turns)
    with pytest.raises(ls.errors.WrongUseError, match="turns of a multisine must be positive"):
        Multisine(0.5, 20.0, 4.0, 1.0, turns=0)


@pytest.mark.parametrize(("excites", "also"), [(None, ("b",)), ("a", ("a",)), ("a", ("b", "b")), ("a", ("c",))])
def test_an_experiment_excites_each_of_its_loops_once(excites, also):
    gain = (Block("gain", {"gain": 1.0}),)
    loops = tuple(LoopSetup(x, None, None, f"z_{x}_v", f"{x}_m", ls.Controller(x, gain, 100.0)) for x in "ab")
    still = np.zeros((5, 2))
    with pytest.raises(
        ls.errors.WrongUseError, match=r"'e' excites each of its loops once at most.*; its loops are a, b"
    ):
        Experiment("e", "noise", loops, 100.0, still, still, "plant_input", {}, excites, excites_also=also)
