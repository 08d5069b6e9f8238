"""The source's 24 equilibria of the 1-DoF arm (section 4.3, figure 4.13)."""

from __future__ import annotations

#: (theta2 in deg, p_AB in bar)
EQUILIBRIA: tuple[tuple[float, float], ...] = tuple(
    [(theta, p) for p in (0.8, 1.0, 1.2, 1.4) for theta in (-30.0, -15.0, 0.0, 15.0, 30.0)]
    + [(theta, 1.6) for theta in (-15.0, 0.0, 15.0)]
    + [(0.0, 1.8)]
)
