"""What a fit refuses, with its sentences."""

import numpy as np
import pytest
from bench_nouns import Integrator, Rational, ThirdOrder

import loopshape as ls
from loopshape.identify.fit import fit, modes, structure_by_name


def frf_of(nf=20, valid=True, variance=1e-4, ny=1):
    f = np.geomspace(0.5, 10.0, nf)
    G = np.repeat((4.0 / (2j * np.pi * f))[:, None, None], ny, axis=1)
    covariance = np.tile(variance * np.eye(ny, dtype=complex), (nf, 1, 1)) * (np.abs(G[:, :1, :1]) ** 2)
    outputs = tuple(f"y{k}_rad" for k in range(ny))
    return ls.FRF(f, G, covariance, np.full(nf, valid), ("z_v",), outputs, "made up", recording="r1", loop="axis")


def refusal(call):
    with pytest.raises(ls.errors.WrongUseError) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize(("lines", "structure"), [(2, ThirdOrder()), (1, Integrator()), (4, Rational(2, 4))])
def test_too_few_lines(lines, structure):
    text = refusal(lambda: fit(frf_of(lines), structure))
    assert f"too few frequencies to fit {structure.name}" in text
    assert f"{lines} line" in text
    assert f"{len(structure.names)} parameters" in text


def test_a_structure_that_is_not_known():
    text = refusal(lambda: structure_by_name("second_order"))
    assert "a structure is not known" in text
    assert "'second_order'" in text
    assert "third_order_delay" in text


def test_a_weighting_that_is_not_known():
    text = refusal(lambda: fit(frf_of(), Integrator(), weighting="coherence"))
    assert "a weighting is not known" in text
    assert "use variance or relative" in text


@pytest.mark.parametrize("orders", [(3, 2, 0), (-1, 2, 0), (0, 21, 0), (0, 2, 3), (0, 2, -1)])
def test_orders_that_make_no_sense(orders):
    text = refusal(lambda: Rational(*orders))
    assert "0 <= numerator <= denominator <= 20" in text
    assert f"numerator {orders[0]}, denominator {orders[1]}, integrators {orders[2]}" in text


def test_a_frf_without_a_trusted_line():
    assert "no frequency of the FRF axis r1 is valid" in refusal(lambda: fit(frf_of(valid=False), Integrator()))


def test_a_band_without_lines():
    text = refusal(lambda: fit(frf_of(), Integrator(), band_hz=(20.0, 30.0)))
    assert "20 to 30 Hz" in text
    assert "0.5 to 10 Hz" in text


def test_a_band_may_hold_lines_that_are_not_trusted():
    assert fit(frf_of(valid=False), Integrator(), band_hz=(1.0, 5.0))["kappa"].value == pytest.approx(4.0)


def test_a_matrix_of_responses():
    assert "with several" in refusal(lambda: fit(frf_of(ny=2), Integrator()))


def test_a_parameter_that_the_structure_does_not_have():
    text = refusal(lambda: fit(frf_of(), Integrator())["zeta"])
    assert "'zeta'" in text
    assert "use one of kappa" in text


@pytest.mark.parametrize("weighting", ["variance", "relative"])
def test_a_frf_without_variance_is_answered_with_a_sentence(weighting):
    text = refusal(lambda: fit(frf_of(variance=0.0), Integrator(), weighting=weighting))
    assert "a fit weighs frequencies by their variance, which must be positive" in text
    assert "0 at 0.5 Hz" in text


def test_modes_of_a_fit_that_is_not_rational():
    with pytest.raises(ls.LoopshapeError):
        modes(fit(frf_of(), Integrator(True)))
