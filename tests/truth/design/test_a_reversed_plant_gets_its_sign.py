"""A plant wired the other way round is tuned as the plant itself, by a gain of -1; holes end undecided."""

import numpy as np
import pytest
import shaped_cases

import loopshape as ls

F = np.geomspace(0.5, 300.0, 120)
STRUCTURE = [ls.gain(), ls.lead_lag()]


def plant(sign: float) -> ls.FRF:
    s = 2j * np.pi * F
    return ls.FRF.from_arrays(F, sign * 40.0 / (s * (1.0 + s / 200.0)), relative_std=0.01, rate_hz=1000.0, loop="x")


@pytest.mark.parametrize("declared", [{"integrators": 1}, {}])
def test_it_is_tuned_as_the_plant_itself(declared: dict[str, int]) -> None:
    R = ls.Requirements("x", phase_margin_deg=40.0, sensitivity_peak_db=6.0, unstable_poles=0, **declared)
    one, other = (ls.tune(plant(sign), R, STRUCTURE, starts=4) for sign in (1.0, -1.0))
    gain, lead, turn = other.controller.blocks
    assert turn.parameters == {"gain": -1.0}
    for mine, its in zip(one.controller.blocks, (gain, lead), strict=True):
        assert its.parameters == pytest.approx(mine.parameters, rel=1e-2)  # draws of the error begin elsewhere
    w1, w2 = (2 * np.pi * lead.parameters[x] for x in ("f1_hz", "f2_hz"))
    k = -40.0 * -gain.parameters["gain"]  # of the plant times the controller
    closed = np.polyadd(np.polymul([1 / 200.0, 1.0, 0.0], [1 / w2, 1.0]), k * np.array([1 / w1, 1.0]))
    assert np.roots(closed).real.max() < 0.0
    assert other.outcome is ls.Outcome.PASSED
    assert any("reversed sign" in words for words in other.verdict.warnings)
    again = ls.tune(plant(-1.0), R, STRUCTURE, start=other)
    assert again.bandwidth_hz >= other.bandwidth_hz * (1.0 - 1e-6)
    assert len(again.controller.blocks) == 3


def test_a_sign_of_ones_own_stays() -> None:
    R = ls.Requirements("x", phase_margin_deg=40.0, sensitivity_peak_db=6.0, unstable_poles=0, integrators=1)
    found = ls.tune(plant(-1.0), R, [ls.gain(-1.0), *STRUCTURE], starts=4)
    assert [block.kind for block in found.controller.blocks] == ["gain", "gain", "lead_lag"]
    assert found.outcome is ls.Outcome.PASSED


@pytest.mark.parametrize("kind", ["hole", "sparse"])
def test_lines_that_hide_a_resonance_end_undecided(kind: str) -> None:
    R = ls.Requirements("x", phase_margin_deg=30.0, sensitivity_peak_db=6.0, integrators=0, unstable_poles=0)
    found = ls.tune(shaped_cases.plants(kind), R, STRUCTURE, starts=4)
    assert found.outcome is ls.Outcome.UNDECIDED
    assert any(line.measure_from_hz is not None for line in found.verdict.lines)
