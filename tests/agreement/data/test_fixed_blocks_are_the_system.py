"""Blocks made of other programs' systems run as these do, digit for digit or after Tustin's rule, and are exported."""

import control
import numpy as np
import pytest
from conversions import angular
from scipy import signal

import loopshape as ls
from loopshape.data.control.controller import Block

RATE = 1000.0
F = np.geomspace(0.1, 480.0, 60)
SOS = signal.ellip(5, 0.5, 40.0, 80.0, fs=RATE, output="sos")
TF = control.tf([2.0, 30.0, 900.0], [1.0, 40.0, 900.0, 0.0])
LATE = control.tf([0.4], [1.0, -0.5, 0.06], 1.0 / RATE)  # two samples late


def controller(blocks, **more):
    return ls.controller(*blocks, rate_hz=RATE, loop="x", **more)


@pytest.mark.parametrize("prewarp", [None, 60.0])
def test_discrete_sections_run_digit_for_digit(prewarp):
    made = controller(ls.fixed(SOS, rate_hz=RATE, prewarp_hz=prewarp), prewarp_hz=prewarp)
    expected = np.delete(SOS, 3, axis=1)
    np.testing.assert_allclose(made.biquads(), expected, rtol=1e-9, atol=1e-12)
    _, H = signal.freqz_sos(SOS, worN=F, fs=RATE)
    np.testing.assert_allclose(made.response(F), H, rtol=1e-8, atol=1e-12)
    noise = np.random.default_rng(0).standard_normal(400)
    ran = signal.sosfilt(np.insert(made.biquads(), 3, 1.0, axis=1), noise)
    np.testing.assert_allclose(ran, signal.sosfilt(SOS, noise), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "system",
    [
        LATE,
        control.ss(LATE),
        signal.dlti([0.3, -0.1], [1.0, -1.6, 0.68], dt=1.0 / RATE),
        control.tf([0.2, 0.2], [1.0, -1.0], 1.0 / RATE),
        signal.dlti(*signal.cheby1(3, 1.0, 0.2, output="zpk"), dt=1.0 / RATE),
    ],
    ids=["transfer function", "state space", "scipy", "integrator", "zeros at half the rate"],
)
def test_a_discrete_system_has_its_own_response_at_its_rate(system):
    if hasattr(system, "frequency_response"):
        H = system.frequency_response(angular(F)).frdata.ravel()
    else:
        H = system.freqresp(w=angular(F) / RATE)[1]
    np.testing.assert_allclose(controller(ls.fixed(system)).response(F), H, rtol=1e-8)


@pytest.mark.parametrize(
    ("system", "num", "den"),
    [
        (TF, [2.0, 30.0, 900.0], [1.0, 40.0, 900.0, 0.0]),
        (control.ss(TF), [2.0, 30.0, 900.0], [1.0, 40.0, 900.0, 0.0]),
        (([-3.0, -3.0], [-5.0, -4.0 + 9.0j, -4.0 - 9.0j], 7.0), [7.0, 42.0, 63.0], [1.0, 13.0, 137.0, 485.0]),
        (signal.lti([5.0], [1.0, 2.0, 0.0, 0.0]), [5.0], [1.0, 2.0, 0.0, 0.0]),
    ],
    ids=["transfer function", "state space", "zeros, poles, gain", "two integrators"],
)
def test_a_continuous_system_runs_after_tustins_rule(system, num, den):
    made = controller(ls.fixed(system), prewarp_hz=50.0)
    s = made.s_at(F)
    np.testing.assert_allclose(made.response(F), np.polyval(num, s) / np.polyval(den, s), rtol=1e-8)


def test_integrators_are_counted_and_kept_to_the_last_digit():
    assert controller(ls.fixed(TF)).integrators() == 1
    assert controller(ls.fixed(signal.lti([5.0], [1.0, 2.0, 0.0, 0.0]))).integrators() == 2
    for precision in ("double", "single", "q3.28"):
        for blocks in ((ls.pid(0.05, 0.5, 8.0, 200.0),), ls.fixed(control.tf([1.0, 3.0], [1.0, 300.0, 0.0]))):
            made = controller(blocks, precision=precision)
            rows = made.biquads()
            integrating = rows[np.argmin(np.abs(1.0 + rows[:, 3] + rows[:, 4]))]
            assert 1.0 + integrating[3] + integrating[4] == 0.0


def test_blocks_go_to_files_and_come_back(tmp_path):
    made = controller((ls.pid(-2.0, 0.5, 8.0, 200.0), *ls.fixed(SOS, rate_hz=RATE)))
    ls.write(made, tmp_path / "c.toml")
    (back,) = ls.read_controllers(tmp_path / "c.toml")
    assert back.digest == made.digest


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (control.tf([1.0], [1.0, -3.0]), "must be stable"),
        (control.tf([1.0], [1.0, 0.0, 4.0]), "must be stable"),
        (control.tf([1.0, 0.0, 1.0], [1.0, 3.0]), "improper"),
        (control.tf([1.0], [1.0, 1.0], 1.0 / RATE), "half the rate"),
        (control.tf([1.0], [1.0, -1.1], 1.0 / RATE), "must be stable"),
        (([], [0.0, 0.0, 0.0], 1.0), "two integrators"),
        ((np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "one input"),
        (control.tf([1.0], [1.0, -0.5], True), "needs its rate"),
        ("1/(s + 1)", "comes from a system"),
    ],
)
def test_what_cannot_run_is_refused(system, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        ls.fixed(system)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((1.0, 0.0, 1.0, 1.0, 1.0, 0.0), "more zeros than poles"),
        ((0.0, 0.0, 0.0, 1.0, 1.0, 0.0), "a numerator"),
        ((0.0, 1.0, 0.0, 0.0, 1.0, 1.0), "cancel the factor"),
        ((1.0, 0.0, 0.0, 1.0, -1.0, 0.0), "must be stable"),
        ((1.0, 0.0, 0.0, 0.0, -1.0, 1.0), "must be stable"),
    ],
)
def test_a_section_that_cannot_run_is_refused(numbers, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        Block("section", dict(zip(("n0", "n1", "n2", "d0", "d1", "d2"), numbers, strict=True)))


@pytest.mark.long
def test_a_structure_with_fixed_blocks_and_a_pid_is_tuned_and_passes():
    plant = ls.FRF.from_control(
        control.tf([4e4], [1.0, 20.0, 0.0]), np.geomspace(0.5, 300.0, 200), rate_hz=RATE, loop="x", recording="r"
    )
    asked = ls.Requirements("x", phase_margin_deg=40.0, sensitivity_peak_db=6.0, unstable_poles=0)
    low_pass = ls.fixed(signal.butter(2, 200.0, fs=RATE, output="sos"), rate_hz=RATE)
    made = ls.tune(plant, asked, [ls.pid(fi_hz=0.1, ff_hz=300.0), *low_pass], starts=1)
    assert made.verdict.passed
    assert [block.kind for block in made.controller.blocks] == ["pid", "section"]
    assert made.controller.integrators() == 1
