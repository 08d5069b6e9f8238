"""python-control's hinfsyn on a plant's fit: mixed sensitivity, the fastest design that passes the check on the FRF.

W1 asks for a loop that integrates up to a corner, W2 for the limit on |CS|, W3 for that on |T|. The corner is swept;
each controller runs by Tustin's rule at the plant's rate. hinfsyn needs slycot, which is not among the packages of
the project: `pip install slycot`.
"""

from __future__ import annotations

import control
import numpy as np

import loopshape as ls
from loopshape.core.units import TWO_PI, from_db
from loopshape.data.frf import FRF
from loopshape.data.model import Fit
from loopshape.data.requirements import Requirements
from loopshape.data.verdict import Verdict

#: corners of W1 in Hz, peaks of |S| that it allows, its lowest value over its highest
CORNERS_HZ, PEAKS_DB, LOW = np.geomspace(0.5, 40.0, 16), (3.0, 5.0), 1e-3
#: an integrator's pole is moved this far into the left half plane, in rad/s
AWAY = 1e-2


def plant(fit: Fit, rate_hz: float) -> control.StateSpace:
    """The fit with its delay and the hold by Padé, without poles on the imaginary axis."""
    num, poles = fit.model.num, np.roots(fit.model.den)
    den = np.real(np.poly(np.where(np.abs(poles) < AWAY, -AWAY, poles))) * fit.model.den[0]
    late = control.tf(*control.pade(fit.model.delay_s + 0.5 / rate_hz, 2))
    return control.ss(control.tf(num, den) * late)


def designs(fit: Fit, limits: Requirements, rate_hz: float) -> list[control.StateSpace]:
    """Controllers of all corners and peaks at the rate, slowest first."""
    G, out = plant(fit, rate_hz), []
    most_db = limits.control_peak_db if limits.control_peak_db is not None else limits.control_high_frequency_db
    W2 = control.tf([1.0 / from_db(most_db)], [1.0])
    W3 = control.tf([1.0 / from_db(limits.complementary_peak_db or 6.0)], [1.0])
    for corner in TWO_PI * CORNERS_HZ:
        for peak_db in PEAKS_DB:
            W1 = control.tf([1.0 / from_db(peak_db), corner], [1.0, corner * LOW])
            K, _, _, _ = control.hinfsyn(control.augw(G, W1, W2, W3), 1, 1)
            out.append(control.sample_system(K, 1.0 / rate_hz, "tustin"))
    return out


def best(frf: FRF, fit: Fit, limits: Requirements) -> tuple[Verdict, float] | None:
    """Verdict and bandwidth in Hz of the fastest design that passes; None where none does."""
    found = []
    for K in designs(fit, limits, frf.rate_hz):
        verdict = ls.check(frf, control.tf(K), limits, fits=[fit])
        if verdict.passed:
            found.append((verdict, min(m.bandwidth_hz for m in verdict.margins.values())))
    return max(found, key=lambda one: one[1], default=None)
