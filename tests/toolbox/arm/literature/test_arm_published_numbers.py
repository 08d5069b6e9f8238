"""Numbers of S.N. van den Brink, DCT 2007.002, and of ARM.md, which restores its signs, each with its place.

A tolerance is half a unit of the last digit that the source prints.
"""

import numpy as np
import pytest
from bench_nouns import Loop
from source_controllers import angle_controller, third_order_plant

import loopshape as ls
from loopshape.loop.margin.margins import margins
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics.equilibrium import pressures
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.dynamics.model import muscle
from loopshape.toolbox.arm.source import EQUILIBRIA, value

F = np.geomspace(0.01, 100.0, 6000)


def loop_of(response, controller):
    covariance = np.zeros((F.size, 1, 1))
    frf = ls.FRF(F, response[:, None, None], covariance, F > 0.0, ("z_theta2_v",), ("theta2_rad",), "formula")
    return Loop(frf, controller, integrators=1, unstable_poles=0)


def test_flow_coefficients_of_table_3_3(arm_constants):
    c = arm_constants()
    root = np.sqrt(2.0 * 287.0 * 293.0)  # the kernel's beta carries the density's root along
    # ARM.md section 3; table 3.3 prints four digits
    for place, beta, digit in ((k.BETA_IN, 4.194e-7, 1e-10), (k.BETA_S, 7.088e-7, 1e-10), (k.BETA_OUT, 1.359e-6, 1e-9)):
        assert c[place] * root == pytest.approx(beta, abs=0.5 * digit)


@pytest.mark.parametrize(
    ("changes", "point", "f_hz", "zeta", "kappa"),
    [
        # ARM.md section 9.1: as printed, gauge gas law
        ({}, (0.0, 1.0), 5.21, 0.065, 1424.0),
        ({}, (30.0, 0.8), 4.14, 0.061, 2614.0),
        ({}, (-30.0, 0.8), 4.14, 0.061, None),
        # ARM.md section 9.3: absolute pressure in the gas law
        ({"gas_absolute_share": 1.0}, (0.0, 1.0), 5.73, None, None),
        ({"gas_absolute_share": 1.0}, (30.0, 0.8), 5.85, None, None),
    ],
)
def test_linearised_model(arm_constants, changes, point, f_hz, zeta, kappa):
    ours = linearise(arm_constants(**changes), *point).third_order()
    assert ours[1] == pytest.approx(f_hz, abs=0.005)
    if zeta is not None:
        assert ours[2] == pytest.approx(zeta, abs=0.0005)
    if kappa is not None:
        assert ours[0] == pytest.approx(kappa, abs=0.5)


def test_mirrored_equilibria_nearly_agree(arm_constants):
    """ARM.md section 9.1 gives one set for +-30 deg; the geometry (Ya = -49.7, Yb = 50.3 mm) parts them a little."""
    plus, minus = (linearise(arm_constants(), theta, 0.8).third_order() for theta in (30.0, -30.0))
    np.testing.assert_allclose(plus, minus, rtol=0.005)
    assert plus[0] != minus[0]


@pytest.mark.parametrize(("point", "f_hz"), [((0.0, 1.0), 6.0), ((30.0, 0.8), 6.5)])
def test_adiabatic_gas(arm_constants, point, f_hz):
    """ARM.md section 9.3: polytropic exponent 1.4."""
    c = arm_constants(gas_absolute_share=1.0, polytropic_exponent=1.4)
    assert linearise(c, *point).third_order()[1] == pytest.approx(f_hz, abs=0.05)


def test_absolute_gas_law_turns_the_trend_with_the_angle_round(arm_constants):
    """ARM.md sections 8 and 9.3: on the arm f rises away from 0 deg; the printed model's falls, as the source's did."""
    assert value("figure_4_15.measured.f") > value("figure_4_12.f")
    assert value("figure_4_15.simulated.f") < value("figure_4_14.f") - 1.0
    printed, absolute = (
        [linearise(arm_constants(gas_absolute_share=share), *p).third_order()[1] for p in ((0.0, 1.0), (30.0, 0.8))]
        for share in (0.0, 1.0)
    )
    assert printed[1] < printed[0] - 1.0
    assert absolute[1] > absolute[0] + 0.1


def test_kappa_depends_on_the_direction_of_flow(arm_constants):
    """ARM.md section 9.1: 2162 or 3067 at (30 deg, 0.8 bar), and their mean is kappa."""
    lin = linearise(arm_constants(), 30.0, 0.8)
    up = lin.third_order(np.array([lin.fill[0], lin.exhaust[1]]))[0]
    down = lin.third_order(np.array([lin.exhaust[0], lin.fill[1]]))[0]
    assert up == pytest.approx(2162.0, abs=0.5)
    assert down == pytest.approx(3067.0, abs=0.5)
    assert 0.5 * (up + down) == pytest.approx(lin.third_order()[0], rel=1e-12)


def test_exhaust_is_faster_than_filling(arm_constants):
    """ARM.md section 10: 1.49 against 0.92 bar/s per V at 0.5 bar."""
    lin = linearise(arm_constants(), 0.0, 1.0)
    np.testing.assert_allclose(lin.exhaust, 1.49, atol=0.005)
    np.testing.assert_allclose(lin.fill, 0.92, atol=0.005)


def test_nominal_length_and_damping_of_a_muscle(arm_constants):
    """ARM.md section 4: h0 = 2 L - s1 p/(s2 + p) and d = d0 + d1 p, at 0.9 bar."""
    c, damping = arm_constants(), value("damping_after_identification") + value("table_4_1.damping1") * 0.9
    h0 = 2.0 * 0.1274 - 0.117 * 0.9 / (0.232 + 0.9)
    assert muscle(c, 0.9e5, h0, 0.0, 1.0, c[k.TWO_L], 0.0)[0] == pytest.approx(0.0, abs=1e-9)
    assert muscle(c, 0.9e5, h0, 0.1, 1.0, c[k.TWO_L], 0.0)[0] == pytest.approx(0.1 * damping, rel=1e-9)


def test_stiffness_of_table_4_1(arm_constants):
    """(4.5) with table 4.1's digits, written out here once more, at 170 mm and 0.9 bar."""
    p, h = 0.9, 0.170
    b, k0, k1, k2, c0, c1 = (value(f"table_4_1.experiment.{x}") for x in ("b", "k0", "k1", "k2", "c0", "c1"))
    stiffness = 1e5 * (b * (c0 * k0 + c1 * k1 * h + k2 * h**2) + p * (k0 + k1 * h + k2 * h**2))
    c, h0 = arm_constants(), 2.0 * 0.1274 - 0.117 * p / (0.232 + p)
    assert muscle(c, 1e5 * p, h, 0.0, 1.0, c[k.TWO_L], 0.0)[0] == pytest.approx(stiffness * (h - h0), rel=1e-9)


def test_24_equilibria_of_section_4_3():
    """ARM.md section 7: -30..30 deg at 0.8 to 1.4 bar, -15..15 at 1.6, 0 at 1.8."""
    assert len(EQUILIBRIA) == len(set(EQUILIBRIA)) == value("identification.count")
    count = {p: sum(q == p for _, q in EQUILIBRIA) for p in (0.8, 1.0, 1.2, 1.4, 1.6, 1.8)}
    assert count == {0.8: 5, 1.0: 5, 1.2: 5, 1.4: 5, 1.6: 3, 1.8: 1}


def test_pressures_of_the_24_equilibria_lie_in_the_model_s_range(arm_constants):
    """ARM.md section 5: 0.15 to 1.2 bar."""
    pairs = [pressures(arm_constants(), *point) for point in EQUILIBRIA]
    assert 0.15 < np.min(pairs) < 0.2
    assert 1.1 < np.max(pairs) < 1.2


@pytest.mark.parametrize(
    ("delay_s", "crossover", "phase", "gain", "peak"), [(0.0, 2.7, 55.0, 10.7, 4.4), (5.5e-3, None, 50.0, 8.1, 5.4)]
)
def test_table_5_1_on_the_measured_plant(delay_s, crossover, phase, gain, peak):
    """ARM.md section 8: the fit of figure 4.12 under table 5.1's controller."""
    m = margins(loop_of(third_order_plant("figure_4_12", delay_s).response(F), angle_controller()))
    assert m.stable == "stable"
    assert m.phase_margin_deg == pytest.approx(phase, abs=0.5)
    assert m.gain_margin_db == pytest.approx(gain, abs=0.05)
    assert m.sensitivity_peak_db == pytest.approx(peak, abs=0.05)
    if crossover is not None:
        assert m.bandwidth_hz == pytest.approx(crossover, abs=0.05)


@pytest.fixture(scope="module")
def at_28_points(arm, arm_constants):
    """Margins of the default angle controller at -30..30 deg, 0.8..1.4 bar, on the linearisation."""
    controller = arm.default_controllers(1000.0)[0]
    c = arm_constants()
    points = [(theta, p) for p in (0.8, 1.0, 1.2, 1.4) for theta in range(-30, 31, 10)]
    return {q: margins(loop_of(linearise(c, *q).response(F)[:, 0, 0], controller)) for q in points}


def test_default_angle_controller_at_28_points(at_28_points):
    """ARM.md section 10: stable, crossover 0.8-2.1 Hz, phase margin 36-43 deg, |S| about 4 dB (9.6 at +-30, 0.8).

    The linearisation has no PWM delay, so the least phase margin here is 38 deg.
    """
    assert len(at_28_points) == 28
    assert {m.stable for m in at_28_points.values()} == {"stable"}
    crossovers = [m.bandwidth_hz for m in at_28_points.values()]
    assert min(crossovers) == pytest.approx(0.8, abs=0.05)
    assert max(crossovers) == pytest.approx(2.1, abs=0.05)
    phases = [m.phase_margin_deg for m in at_28_points.values()]
    assert min(phases) >= 36.0
    assert max(phases) == pytest.approx(43.0, abs=0.5)
    peaks = {q: m.sensitivity_peak_db for q, m in at_28_points.items()}
    assert max(peaks.pop((-30, 0.8)), peaks.pop((30, 0.8))) == pytest.approx(9.6, abs=0.1)
    np.testing.assert_allclose(list(peaks.values()), 4.0, atol=0.5)


def test_default_angle_controller_misses_the_source_s_requirements(at_28_points):
    """ARM.md sections 6 and 10: phase margin and |S| miss what is required, |S| at +-30 deg, 0.8 bar."""
    assert all(m.phase_margin_deg < value("required.phase_margin") for m in at_28_points.values())
    loud = {q for q, m in at_28_points.items() if m.sensitivity_peak_db > value("required.sensitivity")}
    assert loud == {(-30, 0.8), (30, 0.8)}
