"""Lines without noise to speak of: intervals of margins hold what the chords between them leave; truths by roots."""

import sys
from pathlib import Path

import numpy as np
import pytest

STUDIES = Path(__file__).parents[4] / "experiments"


@pytest.mark.long
def test_intervals_of_lines_known_to_a_millionth_hold_the_truth(monkeypatch):
    for name in ("examiner_cases", "certificate"):
        monkeypatch.syspath_prepend(str(STUDIES / name))
    import between

    found = between.held(1e-6, 40, seed=5)
    for name in ("between", "spoiled", "run", "loops"):
        sys.modules.pop(name, None)
    assert len(found["gain_margin_db"]) >= 25
    assert np.mean([x for kept in found.values() for x in kept]) >= 0.9
