"""Each bad input to a check of several loops, and the sentence the user gets."""

import numpy as np
import pytest
from bench_nouns import Block, Loop
from conversions import TWO_PI
from run_files import read_required
from several_cases import RATE_HZ, frf_of, gain

import loopshape as ls

F = np.geomspace(0.01, 100.0, 100)
G = np.array([[1.0, 0.3], [-0.3, 1.0]]) * (4.0 / (TWO_PI * 1j * F))[:, None, None]
BOTH = [gain("a"), gain("b")]


def frf(**fields):
    return frf_of(F, G, loop="a+b", **fields)


def test_no_matrix():
    with pytest.raises(ls.errors.WrongUseError, match=r"P of ls\.check must hold one at least"):
        ls.check([], BOTH)


def test_a_loop_without_a_controller():
    with pytest.raises(ls.errors.WrongUseError, match=r"no controller for b.*controllers of a.*left out stay open"):
        ls.check([frf()], BOTH[:1])


def test_requirements_of_a_loop_that_is_not_closed():
    with pytest.raises(ls.errors.WrongUseError, match=r"requirements are of no loop that is closed.*c.*loops: a, b"):
        ls.check([frf()], BOTH, [ls.Requirements("c", modulus_margin=0.5)])


def test_another_rate():
    slow = [ls.Controller(own.loop, own.blocks, 0.5 * RATE_HZ) for own in BOTH]
    with pytest.raises(ls.errors.WrongUseError, match=r"have one rate; received 500000 Hz, 1e\+06 Hz"):
        ls.check([frf()], slow)


def test_matrices_of_one_recording_twice():
    with pytest.raises(ls.errors.WrongUseError, match="two FRFs of one loop come from the same recording"):
        ls.check([frf(), frf()], BOTH)


def test_singular_values_where_the_outputs_have_different_units():
    mixed = frf(units=["rad", "bar"])
    found = ls.check([mixed], BOTH)
    assert np.isnan(found.margins["exact"].sensitivity_peak_db)
    assert any("different units" in text for text in found.warnings)
    with pytest.raises(
        ls.errors.WrongUseError, match=r"not defined where outputs have different units.*modulus_margin"
    ):
        ls.check([mixed], BOTH, together=ls.Requirements(sensitivity_peak_db=6.0))


def test_a_plant_that_is_not_square():
    with pytest.raises(ls.errors.WrongUseError, match="a square plant, and a controller for each"):
        Loop(frf(), (gain("a"),))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"input_output_disk_margin": 2.5}, "input_output_disk_margin of loop '' must not exceed 2"),
        ({"integrators": -1}, "integrators of several loops is a whole number from 0"),
        ({"gain_margin_db": 6.0}, r"all loops together are limited by disk_margin, .* alone; received gain_margin_db"),
        ({"masks": (ls.Mask("S", ((1.0, 6.0), (10.0, 6.0))),)}, "alone; received sensitivity_mask_db, masks"),
    ],
)
def test_values_that_make_no_sense(fields, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        ls.check([frf()], BOTH, together=ls.Requirements(**fields))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("gain_margin_db = 6.0", r"all loops together are limited by .* alone; received gain_margin_db"),
        ('disk_margin = "much"', "several: disk_margin must be a finite number; received 'much'"),
        ("integrators = 1.5", "several: integrators must be a whole number; received 1.5"),
        ("band_hz = 3.0", "band_hz must be a pair of numbers; received 3.0"),
        ("band_hz = [3.0, 1.0]", "band_hz is two rising frequencies"),
    ],
)
def test_a_bad_table(tmp_path, line, words):
    path = tmp_path / "r.toml"
    path.write_text(f'format = "loopshape-requirements/1"\n[[loop]]\nname = "a"\n[several]\n{line}\n')
    with pytest.raises(ls.errors.WrongUseError, match=words):
        read_required(path)


def test_a_line_above_half_the_rate():
    slow = [ls.Controller(name, (Block("gain", {"gain": 1.0}),), 150.0) for name in "ab"]
    other = type(frf())(F, G, frf().covariance, frf().valid, frf().inputs, frf().outputs, "m", "exact", "a+b", 150.0)
    with pytest.raises(ls.errors.WrongUseError, match="has no response at or above 75 Hz"):
        ls.check([other], slow)
