"""Two loops on lines that hide a mode: neither a count of encirclements nor a margin looks across the hole."""

import numpy as np
import pytest
from scipy import signal

import loopshape as ls

RATE_HZ, MODE_HZ, DAMPING = 1000.0, 57.0, 0.004
MIX = np.array([[1.0, 0.4], [-0.3, 0.8]])
C = [ls.controller(ls.gain(g), rate_hz=RATE_HZ, loop=name) for name, g in (("a", 1.0), ("b", 1.0))]


def sampled(height: float) -> tuple[np.ndarray, np.ndarray]:
    """A mass with friction and a mode of this peak, held over each sample: numerator and denominator in z."""
    w = 2 * np.pi * MODE_HZ
    mode = np.array([1.0, 2 * DAMPING * w, w**2])
    den = np.polymul([1.0, 400.0, 0.0], mode)
    num = np.polyadd(16_000.0 * mode, height * 2 * DAMPING * w * np.array([1.0, 400.0, 0.0, 0.0]))
    b, a, _ = signal.cont2discrete((num, den), 1.0 / RATE_HZ)
    return b[0], a


def case(f: np.ndarray, height: float) -> tuple[ls.FRF, float]:
    """The plant's lines, and the largest closed-loop pole: both loops have the same dynamics, before the mixing."""
    b, a = sampled(height)
    G = signal.freqz(b, a, 2 * np.pi * f / RATE_HZ)[1]
    rng = np.random.default_rng(3)
    P = MIX[None] * G[:, None, None]
    noise = 0.02 * np.abs(P) * (rng.standard_normal(P.shape) + 1j * rng.standard_normal(P.shape)) / np.sqrt(2.0)
    frf = ls.FRF.from_arrays(f, P + noise, std=0.02 * np.abs(P), rate_hz=RATE_HZ, inputs=["a", "b"], outputs=["a", "b"])
    gains = np.diag([one.blocks[0].parameters["gain"] for one in C])
    polynomials = [np.polyadd(a, eigenvalue * b) for eigenvalue in np.linalg.eigvals(MIX @ gains)]
    return frf, max(np.abs(np.roots(one)).max() for one in polynomials)


SPARSE = MODE_HZ * 1.5 ** (np.arange(-11, 6) + 0.5)
FINE = np.geomspace(0.5, 400.0, 300)
GRIDS = {"sparse": SPARSE[SPARSE < 420.0], "hole": FINE[np.abs(np.log(FINE / MODE_HZ)) > 0.25]}
WHOLE = ls.Requirements(loop="", unstable_poles=0, integrators=2, disk_margin=0.5)


@pytest.mark.parametrize("lines", GRIDS)
def test_a_hidden_mode_that_makes_the_loops_unstable_is_not_passed(lines: str) -> None:
    frf, largest = case(GRIDS[lines], -2.0)
    assert largest > 1.0
    found = ls.check(frf, C, together=WHOLE)
    (m,) = found.margins.values()
    assert (m.stable, found.outcome) == ("undecided", ls.Outcome.UNDECIDED)
    low, high = m.stability_band_hz
    assert low <= MODE_HZ <= high
    assert any(low <= MODE_HZ <= high for low, high in m.missing_hz)
    (line,) = found.lines
    assert line.outcome is ls.Outcome.UNDECIDED
    assert line.measure_from_hz is not None


def test_fine_lines_through_the_mode_tell() -> None:
    for height, unstable in ((-2.0, True), (0.02, False)):
        frf, largest = case(FINE[FINE > 0.0], height)
        (m,) = ls.check(frf, C, together=WHOLE).margins.values()
        assert (largest > 1.0) == unstable
        assert m.missing_hz == ()
        assert m.stable in ("undecided", "unstable" if unstable else "stable")
