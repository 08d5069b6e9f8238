"""What could act at a place without a name: shapes over what was measured there, as pushes that a model answers.

At a force port a force over speed (finest about 0), over position, and in proportion to the acceleration; at an input
what is added to it over its own size, and what comes late; at a sensor the same of what it reads. All are taken along
the measured motion, so a push is a signal that is known before anything is simulated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.signal import savgol_filter

from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.machine import Model
from loopshape.toolbox.gap.own import following, kernel
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.following import Followed, Push

SPEEDS, POSITIONS, SIZES = 6, 12, 9  # knots a side of 0, over the travel, over the range of a signal
FINER = 7  # knots over the travel for each of these, where a force changes within it (cogging)


@dataclass(frozen=True, eq=False)
class Axis:
    """A shape over one quantity: hat functions at `knots` (k,); without knots in proportion to it, one a column."""

    over: str
    knots: Array

    @property
    def merged(self) -> Array:
        """Sizes at all knots (k, few) by those at every `FINER`-th, over position; else each by its own."""
        few = self.knots[:: FINER if self.over == "position" else 1]
        if not few.size:
            return np.eye(1)
        return np.stack([np.interp(self.knots, few, row) for row in np.eye(few.size)], axis=1)

    def values(self, x: Array) -> Array:
        """Hat functions (n, k) of x (n,), level beyond the outer knots."""
        return np.stack([np.interp(x, self.knots, row) for row in np.eye(self.knots.size)], axis=1)


def places(model: Model) -> tuple[str, ...]:
    """Ports whose position is measured, inputs that an actuator gives, and sensors."""
    seen = {o.state for o in model.outputs}
    ports = [p.name for p in model.ports if p.position in seen]
    inputs = [i.name for i in model.inputs if i.acts]
    return tuple(dict.fromkeys([*ports, *inputs, *(o.name for o in model.outputs)]))


@dataclass(frozen=True, eq=False)
class Shapes:
    """The shapes that a nameless force or signal may have at each place of a machine, fixed by all its recordings.

    `loads` has the mean size of each port's input.
    """

    composed: Composed
    axes: Mapping[str, tuple[Axis, ...]]
    loads: Mapping[str, float]

    @classmethod
    def of(cls, c: Composed, prepared: Sequence[Followed]) -> Shapes:
        """Knots where these recordings have been."""
        axes = {}
        for place in places(c.model):
            signals = [_signals(c, f, place) for f in prepared]
            joined = {over: np.concatenate([s[over] for s in signals]) for over in signals[0]}
            axes[place] = tuple(Axis(over, _knots(over, x)) for over, x in joined.items())
        size, inputs = np.abs(np.concatenate([f.u for f in prepared])).mean(axis=0), [i.name for i in c.model.inputs]
        return cls(c, axes, {p.name: float(size[inputs.index(p.input)]) for p in c.model.ports})

    def least(self, f: Followed) -> float:
        """The share of the motion within a window that matters, in floors, over all outputs."""
        motion = f.measured.std(axis=1).mean(axis=0)
        return float(self.composed.model.matters * np.sqrt(np.mean((motion / f.floor) ** 2)))

    def units(self, place: str, over: str) -> tuple[str, str]:
        """Unit of what acts at a place, its port's, input's or output's, and of what it is over."""
        model = self.composed.model
        port = next((p for p in model.ports if p.name == place), None)
        if port is None:
            units = {o.name: o.unit for o in model.outputs} | {i.name: i.unit for i in model.inputs}
            return units[place], units[place]
        position = next((o.unit for o in model.outputs if o.state == port.position), "")
        return port.unit, f"{position}/s" if over == "speed" and position else position

    def named(self, place: str, over: str, x: Array, m: Mapping[str, float]) -> Array | None:
        """The force of friction over speed, or of springs over position, at a port; None where neither is moved.

        What grows with the load is drawn at its mean size, driving and driven back half of the time each.
        """
        port = next((j for j, p in enumerate(self.composed.model.ports) if p.name == place), None)
        if port is None or over not in ("speed", "position"):
            return None
        f, still = self.composed.forces(m), self.composed.forces({})
        q, v = (np.zeros_like(x), x) if over == "speed" else (x, np.zeros_like(x))
        ways = [
            [_force(f, port, *at, u) - _force(still, port, *at, u) for at in zip(q, v, strict=True)]
            for u in (self.loads[place], -self.loads[place])
        ]
        force = np.mean(ways, axis=0)
        return force if np.ptp(force) > 0.0 else None

    def merged(self, place: str) -> tuple[Array, ...]:
        """Sizes of all shapes at a place (k, few) by fewer, smooth over position, then by each its own."""
        smooth = block_diag(*(axis.merged for axis in self.axes[place]))
        return (smooth,) if smooth.shape[0] == smooth.shape[1] else (smooth, np.eye(len(smooth)))

    def columns(self, f: Followed, m: Mapping[str, float]) -> dict[str, Array]:
        """What each shape at a place does to the outputs (n, k), output by output, in their units a unit of push."""
        pushes, factors, counts = [], [], []
        small = 1e-3  # of the largest that is measured: pushes so small are straight lines
        for place, axes in self.axes.items():
            signals = _signals(self.composed, f, place)
            rows = np.concatenate([_columns(axis, signals[axis.over]) for axis in axes], axis=1)
            scales = np.maximum(np.abs(rows).max(axis=0), 1e-300)
            step = small * _size(self.composed, f, place)
            pushes += [self._push(f, place, step * column) for column in (rows / scales).T]
            factors.append(scales / step)
            counts.append(len(scales))
        moved = following.pushed(self.composed, f, m, pushes)
        moved = moved.reshape(len(f.first), -1, f.y.shape[1], len(pushes)) * f.floor[:, None] * np.concatenate(factors)
        moved = np.concatenate([moved[:, :, k].reshape(-1, len(pushes)) for k in range(f.y.shape[1])])
        return dict(zip(self.axes, np.split(moved, np.cumsum(counts)[:-1], axis=1), strict=True))

    def _push(self, f: Followed, place: str, values: Array) -> Push:
        """A push of values (n,) in time at a place."""
        model = self.composed.model
        out = {o.name: k for k, o in enumerate(model.outputs)}
        ports, inputs = {p.name: p.input for p in model.ports}, [i.name for i in model.inputs]
        if place in ports or place in inputs:
            u = np.zeros_like(f.u)
            u[:, inputs.index(ports.get(place, place))] = values
            return Push(u=u)
        y = np.zeros((len(f.y), f.y.shape[1]))
        y[:, out[place]] = values
        return Push(y=f.blocks(y[f.first[:, None] + np.arange(f.length)]))


def _force(f: Array, j: int, q: float, v: float, u: float) -> float:
    """Force of the effects at a port while it slides under a load u: bristles bent as far as they bend."""
    bent = f[j, kernel.BRISTLES] * kernel.level(f, j, v) * np.sign(v) / max(f[j, kernel.COULOMB], 1e-300)
    return -float(kernel.friction(f, j, v, bent, u) + kernel.resisting(f, j, q, v))


def _columns(axis: Axis, x: Array) -> Array:
    return axis.values(x) if axis.knots.size else x[:, None]


def _size(c: Composed, f: Followed, place: str) -> float:
    """How large what acts at a place is, for steps: its command, else any command, else what is read."""
    model = c.model
    outputs = {o.name: k for k, o in enumerate(model.outputs)}
    ports, inputs = {p.name: p.input for p in model.ports}, [i.name for i in model.inputs]
    if place in outputs and place not in ports and place not in inputs:
        return max(float(np.ptp(f.y[:, outputs[place]])), 1e-12)
    own = float(np.abs(f.u[:, inputs.index(ports.get(place, place))]).max())
    return own or float(np.abs(f.u).max()) or 1.0


def _signals(c: Composed, f: Followed, place: str) -> dict[str, Array]:
    """What a push at a place may depend on, (n,) by name."""
    model = c.model
    port = next((p for p in model.ports if p.name == place), None)
    if port is not None:
        k = next(k for k, o in enumerate(model.outputs) if o.state == port.position)
        q = f.y[:, k]
        return {"speed": _slope(f, q, 1), "position": q, "acceleration": _slope(f, q, 2)}
    inputs = [i.name for i in model.inputs]
    if place in inputs:
        u = f.u[:, inputs.index(place)]
        late = {f"late by {share:g} windows": _late(f, u, share) - u for share in (0.01, 0.03, 0.1)}  # of a window
        return {"command": u, **late}
    y = f.y[:, [o.name for o in model.outputs].index(place)]
    return {"reading": y, "slope": _slope(f, y, 1), "curvature": _slope(f, y, 2)}


def _slope(f: Followed, y: Array, order: int) -> Array:
    """The `order`-th derivative of y (n,), by parabolas over the lead of a window."""
    width = min(max(f.lead | 1, 5), (y.size - 1) | 1)
    return np.asarray(savgol_filter(y, width, 2, deriv=order, delta=f.tick_s))


def _late(f: Followed, u: Array, share: float) -> Array:
    n = max(1, round(share * f.length))
    return np.concatenate([np.full(n, u[0]), u[:-n]])


def _knots(over: str, x: Array) -> Array:
    """Where hats stand: over speed as quantiles of its size, twice beside 0; over the rest evenly; none for factors."""
    if over == "speed":
        sizes = np.quantile(np.abs(x), np.linspace(0.05, 0.995, SPEEDS))
        sizes = np.unique(np.maximum(sizes, 1e-3 * sizes[-1] + 1e-300))
        return np.concatenate([-sizes[::-1], sizes])
    if over in ("position", "command", "reading"):
        low, high = np.quantile(x, [0.005, 0.995])
        count = (POSITIONS - 1) * FINER + 1 if over == "position" else SIZES
        return np.linspace(low, max(high, low + 1e-9), count)
    return np.zeros(0)
