"""The source's controller on the source's plant: van den Brink, DCT 2007.002, table 5.1, figures of ARM.md section 8.

The plant is what was measured on the arm at (0 deg, 1.0 bar), figure 4.12. The controller is one at the arm's 1 kHz;
the margins are ARM.md's own, computed with two digits, hence the tolerances of half a digit.
"""

import numpy as np
import pytest
from bench_nouns import Loop
from source_controllers import angle_controller, third_order_plant

import loopshape as ls
from loopshape.loop.margin.margins import margins
from loopshape.toolbox.arm.source import value

RATE = 1000.0
TABLE_5_1 = angle_controller()


def arm_frf(delay_s=0.0):
    f = np.geomspace(0.1, 100.0, 8000)
    G = third_order_plant("figure_4_12", delay_s).response(f)
    return ls.FRF(
        f, G[:, None, None], 1e-12 * np.abs(G[:, None, None]) ** 2 + 0j, np.ones(f.size, dtype=bool), ("z_v",),
        ("theta2_rad",), "exact", recording=f"delay {delay_s}", rate_hz=RATE,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("delay_s", "phase_deg", "gain_db", "peak_db"), [(0.0, 55.0, 10.7, 4.4), (0.0055, 50.0, 8.1, 5.4)]
)
def test_margins_of_the_published_pair(delay_s, phase_deg, gain_db, peak_db):
    found = margins(Loop(arm_frf(delay_s), TABLE_5_1, 1, unstable_poles=0))
    assert found.bandwidth_hz == pytest.approx(2.7, abs=0.05)
    assert found.phase_margin_deg == pytest.approx(phase_deg, abs=0.5)
    assert found.gain_margin_db == pytest.approx(gain_db, abs=0.05)
    assert found.sensitivity_peak_db == pytest.approx(peak_db, abs=0.05)
    assert found.stable == "stable"


def test_it_meets_the_sources_requirements_with_and_without_the_delay():
    required = ls.Requirements(
        "theta2",
        sensitivity_peak_db=value("required.sensitivity"),
        phase_margin_deg=value("required.phase_margin"),
        gain_margin_db=value("required.gain_margin"),
        bandwidth_hz=value("table_5_1.bandwidth_low"),
        integrators=1,
        unstable_poles=0,
    )
    verdict = ls.check([arm_frf(0.0), arm_frf(0.0055)], TABLE_5_1, required)
    assert verdict.passed
    assert {line.recording for line in verdict.lines} - {"delay 0.0"} == {"delay 0.0055"}  # the delayed one is worse
