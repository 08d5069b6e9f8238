"""Empty names, numbers out of reach, dead sensors and half characters are refused with a sentence."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block, BlockTemplate
from run_files import read_frfs, read_toml, write_frfs, write_text_whole

import loopshape as ls


def frf_of(**changes):
    f = np.geomspace(0.1, 100.0, 200)
    made = ls.FRF(
        f, (20.0 / (2j * np.pi * f))[:, None, None], np.full((f.size, 1, 1), 1e-8 + 0j), np.full(f.size, True),
        ("z_v",), ("y_rad",), "made up", recording="r1", loop="axis", rate_hz=1000.0,
    )  # fmt: skip
    return replace(made, **changes)


def with_zeros(rows, valid=True):
    made = frf_of()
    response, mask = np.array(made.response), np.array(made.valid)
    response[rows], mask[rows] = 0.0, valid
    return replace(made, response=response, valid=mask)


def checked(frf, **required):
    controller = ls.Controller("axis", (Block("gain", {"gain": 1.0}),), 1000.0)
    return ls.check(
        [frf], controller, ls.Requirements("axis", phase_margin_deg=30.0, **{"unstable_poles": 0} | required)
    )


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_an_output_file_without_a_name(path):
    with pytest.raises(ls.errors.WrongUseError, match="an output file needs a name"):
        write_text_whole(Path(path), "words")


@pytest.mark.parametrize(
    ("kind", "parameters", "name"),
    [
        ("low_pass_2", {"f_hz": 1e160, "damping": 0.7}, "f_hz"),
        ("low_pass_1", {"f_hz": 1.01e9}, "f_hz"),
        ("gain", {"gain": -1e101}, "gain"),
        ("gain", {"gain": 10**400}, "gain"),
    ],
)
def test_a_block_beyond_what_can_be_computed(kind, parameters, name):
    with pytest.raises(ls.errors.WrongUseError, match=f"{name} of a {kind} block must not exceed"):
        Block(kind, parameters)


@pytest.mark.parametrize(
    "table", [{"kind": "pi", "f_hz": {"min": 1.0, "max": 1e160}}, {"kind": "gain", "gain": {"min": 1.0, "max": 1e101}}]
)
def test_a_free_parameter_beyond_what_can_be_computed(table):
    with pytest.raises(ls.errors.WrongUseError, match="block must not exceed"):
        BlockTemplate.from_table(table)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"line_overlap": float("nan")}, "line overlap"),
        ({"line_overlap": float("inf")}, "line overlap"),
        ({"line_overlap": 0.5}, "line overlap"),
        ({"variance_freedom": float("nan")}, "degrees of freedom"),
        ({"variance_freedom": 0.0}, "degrees of freedom"),
        ({"variance_pooled": 0}, "pooled over at least 1"),
        ({"rate_hz": float("nan")}, "rate of an FRF"),
        ({"rate_hz": -1.0}, "rate of an FRF"),
        ({"operating_point": {"x_m": float("nan")}}, "x_m of an FRF's operating point"),
    ],
)
def test_words_of_a_frf_that_make_no_sense(changes, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence):
        frf_of(**changes)


@pytest.mark.parametrize("kind", [int, float])
def test_a_real_response_is_refused_for_it_may_be_a_magnitude(kind):
    with pytest.raises(ls.errors.WrongUseError, match=r"response of an FRF must be complex.*write H \+ 0j"):
        frf_of(response=np.ones((200, 1, 1), dtype=kind))


def test_a_dead_sensor():
    with pytest.raises(ls.errors.WrongUseError, match="the FRF of loop axis, recording r1, is exactly zero at every"):
        checked(with_zeros(slice(None)))


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("rows", [[0], [100], [199]])
@pytest.mark.parametrize("required", [{}, {"band_hz": (0.1, 100.0)}, {"integrators": 1}])
def test_a_zero_line_among_good_ones_is_left_out_and_said(rows, valid, required):
    verdict = checked(with_zeros(rows, valid), **required)
    assert verdict.outcome == "passed"
    assert any("exactly zero were left out: 1" in text for text in verdict.warnings)


def test_half_a_character_in_a_frf(tmp_path):
    (path,) = write_frfs(tmp_path, [frf_of()])
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header"))) | {"recording": "r\ud800"}
    np.savez(path, header=np.array(json.dumps(header)), **arrays)
    with pytest.raises(ls.errors.UnreadableInputError, match="holds half a character"):
        read_frfs(tmp_path)


def test_a_run_that_does_not_exist(tmp_path):
    with pytest.raises(ls.errors.UnreadableInputError, match="folder does not exist"):
        read_frfs(tmp_path / "none")
    with pytest.raises(ls.errors.UnreadableInputError, match="no FRF yet"):
        read_frfs(tmp_path)


def test_a_byte_order_mark_before_toml_is_accepted(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\r\n")
    assert read_toml(path) == {"a": 1}


@pytest.mark.parametrize(("name", "most"), [("phase_margin_deg", 180.0), ("modulus_margin", 1.0), ("disk_margin", 2.0)])
def test_a_margin_that_no_loop_has(name, most):
    ls.Requirements("axis", **{name: most})
    with pytest.raises(ls.errors.WrongUseError, match=f"{name} of loop 'axis' must not exceed {most:g}"):
        ls.Requirements("axis", **{name: 1.001 * most})
