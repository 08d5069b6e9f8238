"""-P under -C is P under C: L is the same, and so is what is said of it (draws of the error begin elsewhere)."""

from dataclasses import replace

import numpy as np
import pytest
import shaped_cases

import loopshape as ls

C = ls.controller(ls.gain(3.0), ls.lead_lag(5.0, 60.0), rate_hz=shaped_cases.RATE_HZ, loop="x")
SLOW = ls.controller(ls.gain(0.4), ls.pi(0.8), rate_hz=shaped_cases.RATE_HZ, loop="x")


def turned(P: ls.FRF) -> ls.FRF:
    return replace(P, response=-P.response)


@pytest.mark.parametrize("integrators", [None, "declared"])
@pytest.mark.parametrize("kind", ["lag", "minus", "sharp", "reversed", "sparse", "hole"])
@pytest.mark.parametrize("controller", [C, SLOW], ids=["lead", "integral"])
def test_both_signs_turned_change_nothing(kind: str, controller: ls.Controller, integrators: str | None) -> None:
    P = shaped_cases.plants(kind)[0]
    known = None if integrators is None else int(kind == "reversed")
    R = ls.Requirements("x", sensitivity_peak_db=6.0, bandwidth_hz=2.0, integrators=known, unstable_poles=0)
    other = replace(controller, blocks=(*controller.blocks, *ls.controller(ls.gain(-1.0), rate_hz=1e3).blocks))
    one, same = ls.check(P, controller, R), ls.check(turned(P), other, R)
    (m,), (n,) = one.margins.values(), same.margins.values()
    assert (m.stable, one.outcome) == (n.stable, same.outcome), (m.stability_reason, n.stability_reason)
    for name, read in m.items():
        assert n[name].span == pytest.approx(read.span, rel=1e-2, abs=0.02, nan_ok=True), name


def test_so_where_slope_and_phase_alone_tell_what_lies_below_the_lines() -> None:
    """A lag far below the lines, which no small model of them tells: its slope and phase agree up to the sign."""
    f, rng = np.geomspace(1.0, 450.0, 100), np.random.default_rng(6)
    s = 2j * np.pi * f
    noise = 1.0 + 0.003 * (rng.standard_normal(100) + 1j * rng.standard_normal(100)) / np.sqrt(2.0)
    P = noise / (s * (5.84 * s + 1.0) * (0.00142 * s + 1.0)) * np.exp(-0.0025 * s)
    R = ls.Requirements("x", unstable_poles=0, integrators=1)
    for sign in (1.0, -1.0):
        frf = ls.FRF.from_arrays(f, sign * P, relative_std=0.003, rate_hz=1000.0, loop="x")
        own = ls.controller(ls.gain(sign * 7796.0), ls.lead_lag(3.35, 30.2), rate_hz=1000.0, loop="x")
        (m,) = ls.check(frf, own, R).margins.values()
        assert m.stable == "stable", m.stability_reason
