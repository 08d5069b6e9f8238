"""S + T = 1 and the relations between the four sensitivities, for any plant and any controller."""

import numpy as np
import pytest
from bench_nouns import Block, Loop
from conversions import from_db
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import loopshape as ls
from loopshape.loop.margin.margins import margins

RATE = 500.0
frequencies = st.floats(0.05, 200.0)
blocks = st.one_of(
    st.builds(lambda g: Block("gain", {"gain": g}), st.floats(-100.0, 100.0).filter(lambda g: abs(g) > 1e-3)),
    st.builds(lambda a, b: Block("lead_lag", {"f1_hz": a, "f2_hz": b}), frequencies, frequencies),
    st.builds(lambda a, d: Block("low_pass_2", {"f_hz": a, "damping": d}), frequencies, st.floats(0.05, 2.0)),
    st.builds(lambda a: Block("pi", {"f_hz": a}), frequencies),
    st.builds(
        lambda a, b, c, d: Block("notch", {"f1_hz": a, "f2_hz": b, "damping1": c, "damping2": d}),
        frequencies, frequencies, st.floats(0.01, 1.0), st.floats(0.05, 3.0),
    ),
)  # fmt: skip


@st.composite
def loops(draw):
    """Any response on any lines under any controller; no model stands behind it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    f = np.sort(rng.uniform(0.1, 240.0, draw(st.integers(2, 60))))
    assume(np.all(np.diff(f) > 0.0))
    P = 10.0 ** rng.uniform(-3.0, 3.0, f.size) * np.exp(2j * np.pi * rng.random(f.size))
    P, known = P[:, None, None], np.ones(f.size, dtype=bool)
    frf = ls.FRF(f, P, 1e-8 * np.abs(P) ** 2 + 0j, known, ("z_v",), ("y_rad",), "made up", rate_hz=RATE)
    return Loop(
        frf, ls.Controller("axis", tuple(draw(st.lists(blocks, min_size=1, max_size=4))), RATE), unstable_poles=0
    )


@settings(max_examples=80, deadline=None)
@given(loops())
def test_s_plus_t_is_one_and_the_four_belong_together(loop):
    S, T = loop.S, loop.T
    big = np.maximum(np.abs(S), np.abs(T))
    np.testing.assert_allclose((S + T) / big, 1.0 / big, atol=1e-9)
    np.testing.assert_allclose(loop.CS * loop.plant.siso, T, rtol=1e-9)
    np.testing.assert_allclose(loop.PS * loop.C, T, rtol=1e-9)
    np.testing.assert_allclose(S * (1.0 + loop.L), 1.0, rtol=1e-9)


@pytest.mark.long
@settings(max_examples=15, deadline=None)
@given(loops())
def test_margins_bound_each_other(loop):
    # every crossing of the axis lies on a chord, and no chord comes nearer to -1 than the modulus margin
    found = margins(loop)
    m, last = found.modulus_margin, float(np.abs(loop.L[-1]))
    assert m <= np.abs(1.0 + loop.L).min() * (1.0 + 1e-9)
    assert from_db(found.complementary_peak_db) <= 1.0 + from_db(found.sensitivity_peak_db) * (1.0 + 1e-9)
    assert 1.0 - 1.0 / from_db(found.gain_margin_db) >= m - 1e-9
    if np.isfinite(found.gain_reduction_margin_db):
        assert from_db(found.gain_reduction_margin_db) - 1.0 >= m - 1e-9
    if last >= 1.0:  # where L goes above the last line nobody knows: no room at all
        assert (m, found.gain_margin_db) == (0.0, 0.0)
        for value in (found.phase_margin_deg, found.delay_margin_s):  # nan: the crossover lies below the first line
            assert value == 0.0 or (np.isnan(value) and found["control_peak_db"].value == np.inf)
        assert found.sensitivity_peak_db == np.inf
        return
    if m == 0.0:  # |L| starts below 1: nothing is known below the first line
        assert found.sensitivity_peak_db == np.inf
        return
    assert np.isclose(from_db(found.sensitivity_peak_db) * m, 1.0)
    assert m <= (1.0 - last) * (1.0 + 1e-9)
    assert from_db(found.gain_margin_db) <= (1.0 + 1e-9) / last
    assert from_db(found.complementary_peak_db) >= (1.0 - 1e-9) * last / (1.0 - last)
    if found.crossings_hz:
        assert found.delay_margin_s >= found.phase_margin_deg / 360.0 / found.crossings_hz[-1] * (1.0 - 1e-9)
        assert found.phase_margin_deg <= 180.0
    else:  # |L| starts below 1, and what it does below the lines nobody knows, or it stays below 1 down to 0 Hz
        unmeasured = np.isnan(found.phase_margin_deg) and np.isnan(found.delay_margin_s)
        assert unmeasured or (found.phase_margin_deg, found.delay_margin_s) == (np.inf, np.inf)


@settings(
    max_examples=8, deadline=None
)  # a response at random is the slowest there is: poles are looked for everywhere
@given(loops(), st.floats(0.1, 10.0))
def test_gain_moved_from_plant_to_controller_changes_nothing_of_the_loop(loop, gain):
    from dataclasses import replace

    plant = replace(loop.plant, response=gain * loop.plant.response, covariance=gain**2 * loop.plant.covariance)
    controller = replace(loop.controller, blocks=(*loop.controller.blocks, Block("gain", {"gain": 1.0 / gain})))
    moved = Loop(plant, controller, unstable_poles=0)
    np.testing.assert_allclose(moved.L, loop.L, rtol=1e-9)
    one, other = margins(moved), margins(loop)
    assert one.stable == other.stable
    np.testing.assert_allclose(one.modulus_margin, other.modulus_margin, rtol=1e-6, atol=1e-9)
