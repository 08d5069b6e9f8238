# %% [markdown]
"""
Many operating points
=====================

A machine is seldom one plant. This stage carries one of three payloads; one controller has to serve all of them, and
the requirements have to hold at each.
"""

# %%
import control
import matplotlib.pyplot as plt
import numpy as np

import loopshape as ls

RATE_HZ = 1000.0
PAYLOADS_KG = [0.5, 1.0, 4.0]


def stage(payload_kg):
    """Motor and load with a shaft between, friction at both, from force to the motor's position in mm/N."""
    m1, m2, k, c, d = 2.0, payload_kg, 2.0e4, 12.0, 20.0
    motor, load, shaft = (
        control.tf([m1, d, 0.0], [1.0]),
        control.tf([m2, d, 0.0], [1.0]),
        control.tf([c, k], [1.0]),
    )
    return control.ss(
        1e3
        * control.minreal(
            (load + shaft) / (motor * load + shaft * (motor + load)), verbose=False
        )
    )


# %% [markdown]
# One recording at each payload: a closed loop under a soft gain, noise injected at the controller's input.


# %%
def recorded(payload_kg, seed):
    """The run of 30 s with one payload."""
    rng = np.random.default_rng(seed)
    plant = control.c2d(stage(payload_kg), 1.0 / RATE_HZ)
    n = rng.standard_normal(30_000)
    t_s = np.arange(n.size) / RATE_HZ
    u = control.forced_response(
        control.feedback(control.ss([], [], [], [[0.2]], 1.0 / RATE_HZ), plant), t_s, n
    ).outputs
    y = control.forced_response(plant, t_s, u).outputs + 1e-4 * rng.standard_normal(n.size)
    name, point = f"payload-{payload_kg:g}kg", {"payload_kg": payload_kg}
    return ls.Run.from_arrays(
        u=u,
        y=y,
        excitation=n,
        rate_hz=RATE_HZ,
        recording=name.replace(".", "_"),
        operating_point=point,
    )


P = [ls.frf(recorded(payload_kg, k)) for k, payload_kg in enumerate(PAYLOADS_KG)]
P

# %%
figure, ax = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
for one in P:
    ax.loglog(
        one.frequency_hz, np.abs(one.siso), label=f"{one.operating_point['payload_kg']:g} kg"
    )
ax.set(xlabel="frequency [Hz]", ylabel="|P| [mm/N]", xlim=(0.5, 200.0))
ax.legend(title="payload")

# %% [markdown]
# A controller for the light stage alone, and what the check finds of it with the other payloads.

# %%
R = ls.Requirements(
    phase_margin_deg=35.0, sensitivity_peak_db=6.0, unstable_poles=0, integrators=1
)
structure = [
    ls.gain(),
    ls.lead_lag((0.5, 40.0), (10.0, 400.0)),
    ls.low_pass((40.0, 400.0), 0.7),
]
light = ls.tune(P[0], R, structure, starts=3)
ls.check(P, light, R)

# %% [markdown]
# One controller for all of them: slower, and passed at each.

# %%
C = ls.tune(P, R, structure, starts=3)
v = ls.check(P, C, R)
assert v.outcome is ls.Outcome.PASSED
print(
    f"bandwidth: {light.bandwidth_hz:.1f} Hz for the lightest payload alone, {C.bandwidth_hz:.1f} Hz for all"
)
v

# %%
ls.plot.nichols(P, C, R, verdict=v)

# %% [markdown]
# The worst case is drawn thick. ``loopshape schedule`` says what one controller for all costs at each point, and
# ``ls.limits.bound`` which bandwidth no linear controller of any order exceeds.
