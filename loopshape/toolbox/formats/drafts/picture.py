"""The picture of a draft map: each signal over time, titled with the part that it seems to have."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from loopshape.core.units import Array
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, new_figure, styled

_MOST = 10  # signals drawn
_POINTS = 4000  # of a signal, as lowest and highest of each stretch


@styled()
def draft(
    signals: Mapping[str, Array], roles: Mapping[str, str], units: Mapping[str, str], rate_hz: float = 0.0
) -> Figure:
    """Signals (n,) by name over time (over rows without a rate), those with a part first and in its colour."""
    order = sorted(signals, key=lambda name: (name not in roles, roles.get(name, "")))[:_MOST]
    fig = new_figure(len(order), 1, (FULL_WIDTH_IN, 0.6 + 1.0 * len(order)), sharex=True)
    for ax, name in zip(fig.axes, order, strict=True):
        rows, values = _outline(np.asarray(signals[name], dtype=float))
        ax.plot(
            rows / rate_hz if rate_hz else rows, values, color=COLOURS[0] if name in roles else "0.6", linewidth=0.7
        )
        unit = f" [{units[name]}]" if units.get(name) and units[name] not in name else ""
        ax.set_title(f"{roles.get(name, 'no part found')}: {name}{unit}", loc="left", fontsize=8)
        ax.margins(x=0.0, y=0.1)
    fig.axes[-1].set_xlabel("time [s]" if rate_hz else "row")
    return fig


def _outline(values: Array) -> tuple[Array, Array]:
    """Rows and values of a signal, of a long one the lowest and highest of each stretch."""
    n = values.size
    if n <= _POINTS:
        return np.arange(n, dtype=float), values
    step = -(-n // (_POINTS // 2))
    whole = values[: n // step * step].reshape(-1, step)
    ends = np.stack([whole.min(axis=1), whole.max(axis=1)], axis=1).ravel()
    return np.repeat(np.arange(whole.shape[0]) * float(step), 2), ends
