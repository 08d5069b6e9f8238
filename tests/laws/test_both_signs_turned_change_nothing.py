"""-P under -C is P under C: L is the same, and so is what is said of it (draws of the error begin elsewhere)."""

from dataclasses import replace

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
