"""Controllers, discretised and continuous, against scipy, python-control and their own definition."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import loopshape as ls
from loopshape.core.kernels import biquads
from loopshape.data.control.controller import BLOCK_KINDS, Block, series_response

RATE_HZ = 1000.0
F = np.geomspace(0.01, 499.0, 300)
BLOCKS = {
    "gain": {"gain": -3.7},
    "lead_lag": {"f1_hz": 2.2, "f2_hz": 18.0},
    "notch": {"f1_hz": 4.5, "f2_hz": 6.1, "damping1": 0.05, "damping2": 5.0},
    "low_pass_1": {"f_hz": 10.0},
    "low_pass_2": {"f_hz": 190.0, "damping": 0.55},
    "pi": {"f_hz": 0.7},
    "pid": {"gain": -1.3, "fi_hz": 0.6, "fd_hz": 7.0, "ff_hz": 160.0},
    "section": {"n0": 2.0, "n1": -0.1, "n2": 0.003, "d0": 1.0, "d1": 0.02, "d2": 0.001},
}
SERIES = tuple(Block(kind, parameters) for kind, parameters in BLOCKS.items())


def transfer_function(kind, p):
    """Numerator and denominator in falling powers of s, as appendix H.1 writes them."""
    w = {name: 2.0 * np.pi * value for name, value in p.items() if name.endswith("_hz")}
    return {
        "gain": lambda: ([p["gain"]], [1.0]),
        "lead_lag": lambda: ([1.0 / w["f1_hz"], 1.0], [1.0 / w["f2_hz"], 1.0]),
        "notch": lambda: (
            [1.0 / w["f1_hz"] ** 2, 2.0 * p["damping1"] / w["f1_hz"], 1.0],
            [1.0 / w["f2_hz"] ** 2, 2.0 * p["damping2"] / w["f2_hz"], 1.0],
        ),
        "low_pass_1": lambda: ([1.0], [1.0 / w["f_hz"], 1.0]),
        "low_pass_2": lambda: ([1.0], [1.0 / w["f_hz"] ** 2, 2.0 * p["damping"] / w["f_hz"], 1.0]),
        "pi": lambda: ([1.0, w["f_hz"]], [1.0, 0.0]),
        "pid": lambda: (
            p["gain"]
            * (np.polymul([1.0, w["fi_hz"]], [1.0 / w["ff_hz"], 1.0]) + np.array([1.0 / w["fd_hz"], 0.0, 0.0])),
            [1.0 / w["ff_hz"], 1.0, 0.0],
        ),
        "section": lambda: ([p["n2"], p["n1"], p["n0"]], [p["d2"], p["d1"], p["d0"]]),
    }[kind]()


def of_sections(sections, f_hz):
    """Response of biquads (n, 5) with a0 = 1, by scipy."""
    sos = np.insert(sections, 3, 1.0, axis=1)
    return signal.freqz_sos(sos, worN=2.0 * np.pi * np.asarray(f_hz) / RATE_HZ)[1]


def test_every_kind_of_block_is_tested_here():
    assert set(BLOCKS) == set(BLOCK_KINDS)


@pytest.mark.parametrize("kind", BLOCKS)
def test_continuous_block_is_the_printed_transfer_function(kind):
    s = 2j * np.pi * F
    expected = signal.freqs(*transfer_function(kind, BLOCKS[kind]), worN=s.imag)[1]
    np.testing.assert_allclose(series_response([Block(kind, BLOCKS[kind])], s), expected, rtol=1e-12)


@pytest.mark.parametrize("kind", BLOCKS)
def test_discrete_block_is_scipy_s_bilinear(kind):
    ours = ls.Controller("one", (Block(kind, BLOCKS[kind]),), RATE_HZ)
    num, den = transfer_function(kind, BLOCKS[kind])
    b, a = signal.bilinear(num, den, fs=RATE_HZ)
    expected = signal.freqz(b, a, worN=2.0 * np.pi * F / RATE_HZ)[1]
    np.testing.assert_allclose(ours.response(F), expected, rtol=1e-7)  # polynomials in z near 1 lose digits
    (section,) = ours.biquads()
    trim = max(len(b), len(a))
    np.testing.assert_allclose(section[:trim], np.pad(b, (0, trim - len(b))), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(section[3 : 3 + trim - 1], np.pad(a, (0, trim - len(a)))[1:], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(section[trim:3], 0.0)


@pytest.mark.parametrize("kind", BLOCKS)
def test_discrete_block_is_python_control_s_tustin(kind):
    ours = ls.Controller("one", (Block(kind, BLOCKS[kind]),), RATE_HZ)
    theirs = control.sample_system(control.tf(*transfer_function(kind, BLOCKS[kind])), 1.0 / RATE_HZ, method="tustin")
    np.testing.assert_allclose(ours.response(F), theirs(np.exp(2j * np.pi * F / RATE_HZ)), rtol=1e-7)


@pytest.mark.parametrize("blocks", [(block,) for block in SERIES] + [SERIES])
def test_response_is_that_of_the_biquads(blocks):
    ours = ls.Controller("one", blocks, RATE_HZ)
    np.testing.assert_allclose(of_sections(ours.biquads(), F), ours.response(F), rtol=1e-7)


@settings(max_examples=100)
@given(
    f1=st.floats(0.01, 400.0),
    f2=st.floats(0.01, 400.0),
    b1=st.floats(0.0, 5.0),
    b2=st.floats(1e-3, 5.0),
    f=st.floats(0.5, 499.0),
)
def test_response_is_that_of_the_biquads_for_any_notch(f1, f2, b1, b2, f):
    block = Block("notch", {"f1_hz": f1, "f2_hz": f2, "damping1": b1, "damping2": b2})
    ours = ls.Controller("one", (block,), RATE_HZ)
    response = ours.response([f])
    np.testing.assert_allclose(of_sections(ours.biquads(), [f]), response, rtol=1e-5, atol=1e-9)


def test_warping_leaves_low_frequencies_and_pushes_the_rest_to_half_the_rate():
    ours = ls.Controller("one", SERIES, RATE_HZ)
    s = ours.s_at([1.0, 250.0, 499.999])
    assert s[0].imag == pytest.approx(2.0 * np.pi, rel=1e-5)
    assert s[1].imag == pytest.approx(2.0 * RATE_HZ, rel=1e-12)  # tan(pi/4) = 1
    assert s[2].imag > 1e8
    assert np.all(s.real == 0.0)


@pytest.mark.parametrize("blocks", [(block,) for block in SERIES] + [SERIES])
def test_controller_as_it_runs_is_scipy_s_filter(blocks):
    sections = ls.Controller("one", blocks, RATE_HZ).biquads()
    x = np.random.default_rng(1).standard_normal(3000)
    sos = np.insert(sections, 3, 1.0, axis=1)
    ours = biquads.run(sections, np.zeros((len(sections), 2)), x)
    np.testing.assert_allclose(ours, signal.sosfilt(sos, x), rtol=1e-9, atol=1e-9)


def test_controller_s_state_goes_on_where_it_stopped():
    sections = ls.Controller("one", SERIES, RATE_HZ).biquads()
    x = np.random.default_rng(2).standard_normal(100)
    whole = biquads.run(sections, np.zeros((len(sections), 2)), x)
    state = np.zeros((len(sections), 2))
    parts = [biquads.run(sections, state, x[:33]), biquads.run(sections, state, x[33:])]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in BLOCKS for name in BLOCKS[kind]])
def test_log_slopes_are_the_slopes(kind, name):
    s = np.array([0.3j, 5.0j, 28.0j, 400.0j, -2.0 + 40.0j])
    value = BLOCKS[kind][name]
    step = 1e-5 * abs(value)

    def log(v):
        return np.log(series_response([Block(kind, BLOCKS[kind] | {name: v})], s))

    central = (log(value + step) - log(value - step)) / (2.0 * step)
    slopes = Block(kind, BLOCKS[kind]).log_slopes(s)
    assert set(slopes) == set(BLOCKS[kind])
    # central differences: truncation 1e-10 relative, rounding 1e-16 of a logarithm of order 1 over 2e-5
    np.testing.assert_allclose(value * slopes[name], value * central, rtol=1e-6, atol=1e-10)


def test_integrators_are_counted():
    pi = Block("pi", {"f_hz": 1.0})
    assert [ls.Controller("one", (SERIES[0], *[pi] * n), RATE_HZ).integrators() for n in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("block", SERIES)
def test_table_and_back(block):
    assert Block.from_table(block.to_table()) == block
