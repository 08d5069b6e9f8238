"""Each bad controller, and the sentence that the user gets."""

import pytest

import loopshape as ls
from loopshape.data.control.controller import Block

GAIN = Block("gain", {"gain": 1.0})


@pytest.mark.parametrize("kind", ["pd", "low_pass", "", "Gain"])
def test_unknown_kind(kind):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"block is not known; received .*use one of gain, lead_lag, notch"
    ):
        Block(kind, {"gain": 1.0})


@pytest.mark.parametrize(
    "table",
    [
        {"kind": "pd"},
        {},
        {"kind": "low_pass", "f_hz": 1.0},
        {"kind": "low_pass", "order": 3, "f_hz": 1.0},
        {"kind": "gain", "order": 1, "gain": 1.0},
    ],
)
def test_unknown_table(table):
    with pytest.raises(ls.errors.WrongUseError, match=r"block is not known; received .*low_pass with order 1 or 2"):
        Block.from_table(table)


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("gain", {}),
        ("gain", {"p": 1.0}),
        ("gain", {"gain": 1.0, "f_hz": 2.0}),
        ("lead_lag", {"f1_hz": 1.0}),
        ("notch", {"f_hz": 1.0, "damping1": 0.1, "damping2": 1.0}),
    ],
)
def test_wrong_names(kind, parameters):
    with pytest.raises(
        ls.errors.WrongUseError, match=f"a {kind} block has the parameters .*name each once and no other"
    ):
        Block(kind, parameters)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "1", None, True, [1.0]])
def test_what_is_not_a_finite_number(value):
    with pytest.raises(ls.errors.WrongUseError, match="gain of a gain block must be a finite number; received"):
        Block("gain", {"gain": value})


@pytest.mark.parametrize(
    ("kind", "parameters", "name"),
    [
        ("lead_lag", {"f1_hz": 0.0, "f2_hz": 1.0}, "f1_hz"),
        ("lead_lag", {"f1_hz": 1.0, "f2_hz": -1.0}, "f2_hz"),
        ("notch", {"f1_hz": 1.0, "f2_hz": 1.0, "damping1": -0.1, "damping2": 1.0}, "damping1"),
        ("notch", {"f1_hz": 1.0, "f2_hz": 1.0, "damping1": 0.1, "damping2": 0.0}, "damping2"),
        ("low_pass_1", {"f_hz": -3.0}, "f_hz"),
        ("low_pass_2", {"f_hz": 3.0, "damping": 0.0}, "damping"),
        ("pi", {"f_hz": 0.0}, "f_hz"),
    ],
)
def test_what_is_not_positive(kind, parameters, name):
    with pytest.raises(ls.errors.WrongUseError, match=f"{name} of a {kind} block must be positive; received"):
        Block(kind, parameters)


def test_a_notch_without_numerator_damping_is_allowed():
    assert Block("notch", {"f1_hz": 1.0, "f2_hz": 1.0, "damping1": 0.0, "damping2": 1.0}).parameters["damping1"] == 0.0


@pytest.mark.parametrize("f_hz", [500.0, 700.0, [1.0, 500.0]])
def test_response_at_half_the_rate(f_hz):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"no response at or above 500 Hz; received .*ask below half the rate"
    ):
        ls.Controller("theta2", (GAIN,), 1000.0).response(f_hz)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_rate(rate_hz):
    with pytest.raises(ls.errors.WrongUseError, match="rate must be a positive finite number; received"):
        ls.Controller("theta2", (GAIN,), rate_hz)


def test_discretisation():
    with pytest.raises(ls.errors.WrongUseError, match="discretisation is not known; received 'zoh'; use tustin"):
        ls.Controller("theta2", (GAIN,), 1000.0, "zoh")


def test_no_block():
    with pytest.raises(
        ls.errors.WrongUseError, match="loop 'theta2' has no block; received an empty list; give at least a gain"
    ):
        ls.Controller("theta2", (), 1000.0)
