"""A sweep's FRF of the simulated arm agrees with the linearisation, corrected for how the valves were used."""

from pathlib import Path

import numpy as np
import pytest
from arm_sweep import command_amplitude, expected_angle_response
from simulated_machines import experiment, header, plan, read_study

from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.arm.dynamics.linear import linearise

STUDY = Path(__file__).parents[4] / "experiments" / "arm_against_linearisation" / "slow_pressure.toml"


@pytest.fixture(scope="module")
def measured(arm):
    """FRF between 0.3 and 10 Hz and its recording, at (0 deg, 1.0 bar) and (-30 deg, 0.8 bar), slow pressure loop."""
    study = read_study(STUDY)
    run = header(study, arm)
    todo = [experiment(study, arm, planned) for k, planned in enumerate(plan(study, arm)) if k in (0, 2)]
    out = []
    for recording in arm.simulate(todo):
        frf = estimate_frf(recording, run.loop("theta2"))
        out.append((frf.select(frf.valid & (frf.frequency_hz > 0.3) & (frf.frequency_hz < 10.0)), recording, run))
    return out


#: of the response: the linearisation leaves friction out, which makes 1 deg of phase at 0.3 Hz, whatever the estimator
FRICTION = 0.02


def share_within(frf, model, own_error=0.0):
    """Share of lines whose error lies within the FRF's 95 % circle about a model known to a share of itself."""
    error = np.abs(frf.siso - model)
    return np.mean(error < np.sqrt(-np.log(0.05) * frf.variance[:, 0, 0]) + own_error * np.abs(model))


def test_nine_lines_in_ten_lie_within_their_95_percent_and_what_the_linearisation_leaves_out(measured):
    for frf, recording, run in measured:
        assert frf.frequency_hz.size > 150
        assert share_within(frf, expected_angle_response(frf, recording, run.loop("p_ab")), FRICTION) > 0.9


def test_the_bare_linearisation_does_not_agree(measured, arm_constants):
    for frf, recording, _ in measured:
        bare = linearise(arm_constants(), **recording.info.operating_point).response(frf.frequency_hz)[:, 0, 0]
        assert share_within(frf, bare) < 0.6


def test_the_amplitude_of_z_follows_from_the_log(measured):
    # a gain of 0.5 V/rad before 0.1 rad of sweep: 0.05 V times |S|, which is 1 at high frequency
    frf, recording, _ = measured[0]
    amplitude = command_amplitude(frf, recording)
    np.testing.assert_allclose(amplitude[frf.frequency_hz > 7.0], 0.05, rtol=0.05)
