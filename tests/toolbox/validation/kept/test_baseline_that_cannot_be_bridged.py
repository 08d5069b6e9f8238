"""A baseline that cannot be bridged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block
from run_files import write_verdicts

import loopshape as ls
from loopshape.loop.verdict import LoopCheck, check_loops
from loopshape.toolbox.validation.kept.against import against

OWN = ls.Controller("a", (Block("gain", {"gain": 1.0}),), 1000.0)
WISHED = ls.Requirements("a", phase_margin_deg=10.0, integrators=1)


def frf(gain: float, rate_hz: float) -> ls.FRF:
    f = np.geomspace(0.01, 10.0, 60)
    P = gain / (2j * np.pi * f)
    return ls.FRF(
        f, P[:, None, None], (1e-6 * np.abs(P) ** 2)[:, None, None].astype(complex), np.ones(60, dtype=bool), ("z_v",),
        ("a_rad",), "made", recording="r", loop="a", rate_hz=rate_hz,
    )  # fmt: skip


def judged(gain: float, controller: ls.Controller) -> LoopCheck:
    one = frf(gain, controller.rate_hz)
    return check_loops([one], controller, WISHED)


@pytest.mark.parametrize(("rate_hz", "told_apart"), [(500.0, False), (1000.0, True)])
def test_a_baseline_at_another_rate_is_compared_and_not_taken_apart(
    tmp_path: Path, rate_hz: float, told_apart: bool
) -> None:
    before = replace(OWN, rate_hz=rate_hz, blocks=(Block("gain", {"gain": 1.5}),))
    write_verdicts(tmp_path / "v.json", [judged(2.0, before).verdict])
    found = against(tmp_path / "v.json", [judged(1.0, OWN)])
    assert (found.by_controller is not None, found.by_plant is not None) == (told_apart, told_apart)
    assert any("not told apart" in note for note in found.whole.notes) is not told_apart
    assert found.whole.margins
