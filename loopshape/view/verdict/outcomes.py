"""How an outcome looks: a marker, a colour and a word, told apart without colour; and cells by their room."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from loopshape.data.requirement.requirements import Margins
from loopshape.view.key import Entry
from loopshape.view.style import COLOURS, LIMIT

#: passed a filled circle, undecided a hollow diamond, failed a cross
MARKS: Mapping[str, dict[str, Any]] = {
    "passed": {"marker": "o", "color": COLOURS[0], "markersize": 4.0},
    "undecided": {"marker": "D", "color": COLOURS[1], "markerfacecolor": "white", "markersize": 4.0},
    "failed": {"marker": "x", "color": LIMIT, "markersize": 5.0, "markeredgewidth": 1.5},
}
#: from much room to none, then missed by ever more; each darker than the one before, so that grey paper keeps the order
_ROOM, _NEAR, _MISSED = ("#FFFFFF", "#B4D4EC"), ("#F6C37A", "#EFA94A"), ("#E8953A", "#B9410A", "#4A0F00")


def mark_entries(outcomes: set[str]) -> list[Entry]:
    """What the notes say of the marks that a picture holds."""
    return [(name, {"linestyle": "none", **look}) for name, look in MARKS.items() if name in outcomes]


def with_stability(outcome: str, margins: Margins | None) -> str:
    """A requirement's outcome at a point; where the loop is unstable or undecided, that."""
    stable = "stable" if margins is None else margins.stable
    return {"unstable": "failed", "undecided": "undecided" if outcome == "passed" else outcome}.get(stable, outcome)


def room_colours(steps: int) -> list[str]:
    """Colours of `steps` rising steps with room left, from white."""
    return ramp(_ROOM, steps)


def near_colours(steps: int) -> list[str]:
    """Colours of `steps` rising steps with little room left."""
    return ramp(_NEAR, steps)


def missed_colours(steps: int) -> list[str]:
    """Colours of `steps` rising steps beyond a limit."""
    return ramp(_MISSED, steps)


def ramp(nodes: tuple[str, ...], steps: int) -> list[str]:
    """`steps` colours evenly along some nodes."""
    at = np.linspace(0.0, 1.0, len(nodes))
    rgb = np.array([to_rgb(node) for node in nodes])
    t = np.linspace(0.0, 1.0, steps) if steps > 1 else np.array([0.5])
    mixed = np.stack([np.interp(t, at, rgb[:, k]) for k in range(3)], axis=1)
    return [to_hex((r, g, b)) for r, g, b in mixed]


def luminance(colour: str) -> float:
    """Relative luminance in [0, 1] (ITU-R BT.709, of linearised sRGB): what grey paper keeps of a colour."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def ink_on(colour: str) -> str:
    """Black or white, whichever reads on a colour."""
    return "black" if luminance(colour) > 0.25 else "white"
