"""
One controller for nine payloads
================================

A two-mass stage under nine payloads, each known to 2 %. One controller is tuned for all: the sensitivity stays below its
limit at each, and the worst case is drawn thick.
"""

import numpy as np

import loopshape as ls

F_HZ, RATE_HZ = np.geomspace(0.5, 400.0, 250), 1000.0


def response(payload_kg):
    """From force to the motor's position in mm/N, as recorded at 1 kHz: with hold and one period of delay."""
    m1, k, c, d = 2.0, 2.0e4, 12.0, 20.0
    s = 2j * np.pi * F_HZ
    motor, load, shaft = m1 * s**2 + d * s, payload_kg * s**2 + d * s, k + c * s
    delay = np.exp(-1.5 * s / RATE_HZ) * np.sinc(F_HZ / RATE_HZ)
    return 1e3 * (load + shaft) / (motor * load + shaft * (motor + load)) * delay


P = [
    ls.FRF.from_arrays(
        F_HZ, response(m), relative_std=0.02, rate_hz=RATE_HZ,
        recording=f"payload {m:.2g} kg", operating_point={"payload_kg": m},
    )
    for m in np.geomspace(0.5, 4.0, 9)
]  # fmt: skip
R = ls.Requirements(
    phase_margin_deg=35.0, sensitivity_peak_db=6.0, unstable_poles=0, integrators=1
)
C = ls.tune(
    P,
    R,
    [ls.gain(), ls.lead_lag((0.5, 40.0), (10.0, 400.0)), ls.low_pass((40.0, 400.0), 0.7)],
    starts=3,
)
v = ls.check(P, C, R)
v

# %%
# All open loops in the Nichols chart, clear of what the requirements forbid.

ls.plot.nichols(P, C, R, verdict=v)

# %%
# And their sensitivities.

ls.plot.sensitivities(P, C, R, verdict=v)
