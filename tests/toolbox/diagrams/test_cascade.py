"""A cascade: the outer loop's plant, its error, and the stability of both loops together, against known models."""

import control
import numpy as np
import pytest
from conversions import angular

import loopshape as ls
from loopshape.data.algebra import channels

RATE = 2000.0
F = np.geomspace(0.2, 400.0, 250)
MOTOR = control.tf([60.0], [1.0, 12.0])  # u to speed
LOAD = control.tf([60.0 * 900.0], np.polymul([1.0, 12.0, 0.0], [1.0, 6.0, 900.0]))  # u to the load's angle
INNER = ls.controller(ls.gain(1.5), ls.pi(3.0), rate_hz=RATE, loop="speed")
ASKED = ls.Requirements("speed", unstable_poles=0, integrators=0, phase_margin_deg=40.0)


def both(motor=MOTOR, load=LOAD, std=0.0, seed=0):
    """FRFs of the held plant, from u to speed and angle, with joint noise of both."""
    z = [control.c2d(one, 1.0 / RATE) for one in (motor, load)]
    response = np.stack([one(np.exp(1j * angular(F) / RATE)) for one in z], axis=1)[:, :, None]
    rng = np.random.default_rng(seed)
    root = std * np.array([[1.0, 0.0], [0.8, 0.6]])
    noise = (rng.standard_normal((F.size, 2)) + 1j * rng.standard_normal((F.size, 2))) / np.sqrt(2.0) @ root.T
    sizes = np.abs(response[:, :, 0])
    covariance = sizes[:, :, None] * (root @ root.T) * sizes[:, None, :]
    return ls.FRF.from_arrays(
        F, response + (sizes * noise)[:, :, None], covariance=covariance + 0j, rate_hz=RATE, recording="r",
        inputs=("u",), outputs=("speed", "angle"),
    )  # fmt: skip


def in_z(controller):
    """A controller as a transfer function in z."""
    made = control.tf([1.0], [1.0], 1.0 / RATE)
    for b0, b1, b2, a1, a2 in controller.biquads():
        made = made * control.tf([b0, b1, b2], [1.0, a1, a2], 1.0 / RATE)
    return made


def test_the_outer_plant_is_that_of_the_closed_inner_loop():
    found = ls.diagrams.equivalent(ls.diagrams.cascade(both(), INNER, ASKED))
    assert found.inner["speed"].passed
    z = np.exp(1j * angular(F) / RATE)
    G1, G2 = (control.c2d(one, 1.0 / RATE)(z) for one in (MOTOR, LOAD))
    C = in_z(INNER)(z)
    (outer,) = found.plants
    np.testing.assert_allclose(outer.siso, G2 * C / (1.0 + G1 * C), rtol=1e-9)
    assert outer.outputs == ("angle",)
    assert outer.loop == "outer"


def test_errors_that_both_measurements_share_are_counted_once():
    def met(seed):
        return ls.diagrams.transfer(
            ls.diagrams.cascade(both(std=0.01, seed=seed), INNER), "r1", "angle", opened=("outer",)
        )

    drawn = np.array([met(k).siso for k in range(80)])
    told = met(0).variance[:, 0, 0]
    ratio = np.var(drawn, axis=0) / told
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.04)


def test_an_outer_loop_that_is_tuned_is_stable_with_the_inner_one_closed():
    structure = ls.diagrams.cascade(both(std=0.003), INNER, ASKED)
    required = ls.Requirements("outer", phase_margin_deg=45.0, sensitivity_peak_db=6.0)
    made = ls.tune(structure, required, [ls.gain(), ls.lead_lag()], starts=2)
    assert made.verdict.passed
    G1, G2 = (control.c2d(control.ss(one), 1.0 / RATE) for one in (MOTOR, LOAD))
    through = control.feedback(control.ss(in_z(INNER)), G1)  # C1/(1 + C1 G1)
    poles = control.poles(control.feedback(G2 * through * control.ss(in_z(made.controller)), 1))
    assert np.abs(poles).max() < 1.0
    assert made.verdict.margins["r"].bandwidth_hz > 0.5


def test_an_inner_loop_that_is_not_stable_and_other_shapes_are_refused():
    fast = ls.controller(ls.gain(200.0), ls.pi(300.0), rate_hz=RATE)
    with pytest.raises(ls.errors.WrongUseError, match="certified stable"):
        ls.diagrams.equivalent(ls.diagrams.cascade(both(), fast, ASKED))
    with pytest.raises(ls.errors.WrongUseError, match="one actuator to two sensors"):
        ls.diagrams.cascade(channels(both(), ["speed"]), INNER, ASKED)
