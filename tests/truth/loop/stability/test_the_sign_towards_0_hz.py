"""A plant of the wrong sign feeds back positively, which is named; a zero below the lines may hide which sign it is."""

import numpy as np
import pytest

import loopshape as ls

RATE_HZ = 10_000.0
F = np.geomspace(0.5, 400.0, 160)


def check(num: list[float], den: list[float], gain: float, **declared: int) -> tuple[ls.Margins, bool]:
    """Margins of a plant far below half the rate under a gain, and whether the loop is stable by its poles."""
    s = 2j * np.pi * F
    rng = np.random.default_rng(2)
    P = np.polyval(num, s) / np.polyval(den, s)
    noise = 1.0 + 0.002 * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
    frf = ls.FRF.from_arrays(F, P * noise, relative_std=0.003, rate_hz=RATE_HZ, loop="x")
    C = ls.controller(ls.gain(gain), rate_hz=RATE_HZ, loop="x")
    (m,) = ls.check(frf, C, ls.Requirements("x", unstable_poles=0, **declared)).margins.values()
    return m, bool(np.roots(np.polyadd(den, gain * np.array(num))).real.max() < 0.0)


LAG = [1.0, 2 * np.pi * 60.0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("integrators", [1, 2])
def test_one_sign_of_a_controller_feeds_back_positively(integrators: int, sign: float) -> None:
    lead = [1.0, 10.0] if integrators == 2 else [1.0]
    num = (sign * 2e4 * np.array(lead)).tolist()
    den = np.polymul(LAG, np.r_[1.0, np.zeros(integrators)]).tolist()
    for gain in (1.0, -1.0):
        m, stable = check(num, den, gain, integrators=integrators)
        assert stable == (gain * sign > 0.0)
        assert m.stable == ("stable" if stable else "unstable")
        assert ("the feedback is positive" in m.stability_reason) == (not stable)


LEAD = ls.lead_lag(0.25, 2.2)
#: integrators, zeros and poles in rad/s, first line in Hz, controller: all with a zero in the right half plane below
HIDDEN = {
    "amid a lag": (2, 0.17, (2.87, 679.0), 0.3, (LEAD,), 0.75),
    "beside the first line": (2, 14.8, (5.2, 692.0), 3.0, (ls.lead_lag(8.1, 72.8),), 24.0),
    "under an integral action": (0, 0.62, (1.76, 25.9, 409.0), 1.0, (ls.pi(1.0),), 4.2),
}


@pytest.mark.parametrize("name", HIDDEN)
@pytest.mark.parametrize("lines", [60, 120, 240])
def test_a_zero_in_the_right_half_plane_below_the_lines_is_not_taken_for_one_in_the_left(name: str, lines: int) -> None:
    """Towards 0 Hz L is -k/s^n, so that 1 + L has a real zero on the right, whatever lines say."""
    integrators, zero, poles, first_hz, blocks, crossover_hz = HIDDEN[name]

    def plant(s: np.ndarray) -> np.ndarray:
        return (1.0 - s / zero) / np.prod([1.0 + s / p for p in poles], axis=0) / s**integrators

    f = np.geomspace(first_hz, 400.0, lines)
    C = ls.controller(ls.gain(1.0), *blocks, rate_hz=RATE_HZ, loop="x")
    at = np.array([crossover_hz])
    L = C.response(at)[0] * plant(2j * np.pi * at)[0]
    positive = plant(np.array([1e-6 + 0j]))[0].real > 0.0
    assert positive
    C = ls.controller(ls.gain(-1.0 / abs(L)), *blocks, rate_hz=RATE_HZ, loop="x")
    rng = np.random.default_rng(lines)
    noise = 1.0 + 0.002 * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    P = ls.FRF.from_arrays(f, plant(2j * np.pi * f) * noise, relative_std=0.003, rate_hz=RATE_HZ, loop="x")
    (m,) = ls.check(P, C, ls.Requirements("x", unstable_poles=0, integrators=integrators)).margins.values()
    assert m.stable in ("undecided", "unstable"), m.stability_reason
