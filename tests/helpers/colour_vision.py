"""How colours look to those who see two of three primaries, and how far two colours lie apart.

Machado, Oliveira and Fernandes, IEEE Transactions on Visualization and Computer Graphics 15, 2009: matrices on linear
RGB at severity 1. CIEDE2000 as Sharma, Wu and Dalal write it, Color Research and Application 30, 2005.
"""

import numpy as np

VISION = {
    "all three": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
#: sRGB to XYZ over that of its white (IEC 61966-2-1, D65)
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab_of(colour: str, vision: str = "all three") -> np.ndarray:
    """CIELAB of #rrggbb as it is seen."""
    values = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    seen = np.clip(VISION[vision] @ linear, 0.0, 1.0)
    share = (_XYZ @ seen) / _XYZ.sum(axis=1)
    x, y, z = np.where(share > (6 / 29) ** 3, np.cbrt(share), share / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """CIEDE2000 of two colours in CIELAB; 1 is just seen side by side."""
    (L1, a1, b1), (L2, a2, b2) = one, other
    mean = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    stretch = 1.5 - 0.5 * np.sqrt(mean**7 / (mean**7 + 25.0**7))
    (C1, h1), (C2, h2) = (_polar(a * stretch, b) for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180.0) % 360.0 - 180.0 if C1 * C2 else 0.0
    dL, dC, dH = L2 - L1, C2 - C1, 2.0 * np.sqrt(C1 * C2) * np.sin(np.radians(0.5 * turn))
    L, C, h = 0.5 * (L1 + L2), 0.5 * (C1 + C2), (h1 + 0.5 * turn) % 360.0 if C1 * C2 else h1 + h2
    T = 1.0 - 0.17 * _cos(h - 30.0) + 0.24 * _cos(2 * h) + 0.32 * _cos(3 * h + 6.0) - 0.2 * _cos(4 * h - 63.0)
    SL, SC, SH = 1.0 + 0.015 * (L - 50.0) ** 2 / np.sqrt(20.0 + (L - 50.0) ** 2), 1.0 + 0.045 * C, 1.0 + 0.015 * C * T
    RC, away = 2.0 * np.sqrt(C**7 / (C**7 + 25.0**7)), 30.0 * np.exp(-(((h - 275.0) / 25.0) ** 2))
    RT = -np.sin(np.radians(2.0 * away)) * RC
    return float(np.sqrt((dL / SL) ** 2 + (dC / SC) ** 2 + (dH / SH) ** 2 + RT * (dC / SC) * (dH / SH)))


def _polar(a: float, b: float) -> tuple[float, float]:
    return float(np.hypot(a, b)), float(np.degrees(np.arctan2(b, a)) % 360.0)


def _cos(degrees: float) -> float:
    return float(np.cos(np.radians(degrees)))
