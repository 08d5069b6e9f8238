"""Are the channels mapped with the right sign and unit? Told from the nominal model, before anything is fitted.

Within the windows the measured motion is the free motion from some initial state, and for each input its share of the
forced motion times a gain, 1 if all is as mapped. Gains follow by least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.model.own import following
from loopshape.model.own.composed import Composed
from loopshape.model.own.following import Followed

KNOWN = {
    57.2957795: "degrees and radians", 1000.0: "a factor of a thousand", 100.0: "a factor of a hundred",
    9.80665: "kilograms force and newtons", 9.5492966: "revolutions a minute and rad/s", 6.2831853: "turns and radians",
}  # fmt: skip
NEAR = 0.32  # of a known factor: half-way between 57 and 100
CLEAR = 0.5  # share of the motion that inputs explain, below which signs and units are not judged
SMALL = 1e-3  # of the input: a unit that is wrong must not drive the model out of its range
WIDE = 5.0  # a gain beyond is no parameter's error


@dataclass(frozen=True)
class Gain:
    """Gain of an output to an input, 1 where the mapping is right, and the share of the motion that it explains."""

    input: str
    output: str
    gain: float
    share: float


def check(c: Composed, prepared: Sequence[Followed]) -> None:
    """Refuse a mapping whose sign or unit is wrong; what inputs hardly explain is left to the diagnosis."""
    for g in gains(c, prepared):
        if g.share < CLEAR:
            continue
        if g.gain < 0.0:
            raise WrongUseError(
                f"{g.output} moves against what {g.input} should do: a sign is wrong",
                f"gain {g.gain:.3g} where the model has 1", "turn the factor of one of the two columns around",
            )  # fmt: skip
        factor = max(g.gain, 1.0 / max(g.gain, 1e-12))
        if factor > WIDE:
            known = min(KNOWN, key=lambda k: abs(np.log(factor / k)))
            near = abs(np.log(factor / known)) < np.log(1.0 + NEAR)
            raise WrongUseError(
                f"{g.output} moves {g.gain:.3g} times as far as {g.input} should move it: a unit is wrong",
                f"a ratio as between {KNOWN[known]}" if near else f"a ratio of {factor:.3g}",
                "correct the factor of the column, or the parameters",
            )  # fmt: skip


def gains(c: Composed, prepared: Sequence[Followed]) -> list[Gain]:
    """One for each output and the input that explains most of its forced motion."""
    seen: list[Array] = []
    shares: list[Array] = []
    for f in prepared:
        measured, forced = _without_free_motion(c, f)
        seen.append(measured)
        shares.append(forced)
    out = []
    for k, o in enumerate(c.model.outputs):
        y = np.concatenate([m[..., k].ravel() for m in seen])
        a = np.concatenate([np.moveaxis(s[..., k], 0, -1).reshape(-1, s.shape[0]) for s in shares])
        found, *_ = np.linalg.lstsq(a, y, rcond=1e-9)
        powers = np.array([np.sum((a[:, j] * found[j]) ** 2) for j in range(a.shape[1])])
        j = int(np.argmax(powers))
        explained = 1.0 - float(np.sum((y - a @ found) ** 2) / max(float(np.sum(y**2)), 1e-300))
        out.append(Gain(c.model.inputs[j].name, o.name, float(found[j]), explained))
    return out


def _without_free_motion(c: Composed, f: Followed) -> tuple[Array, Array]:
    """Measured motion (windows, blocks, ny) and forced motion by input (nu, windows, blocks, ny) over the floor.

    What initial states explain is taken out of both.
    """
    idle = replace(f, u=np.zeros_like(f.u))
    _, slopes, x0, _ = following.shot(c, idle, {})
    rest = following.simulated(c, idle, {}, x0)
    parts = []
    for j in range(f.u.shape[1]):
        alone = np.zeros_like(f.u)
        alone[:, j] = SMALL * f.u[:, j]
        forced = following.simulated(c, replace(f, u=alone), {}, x0) - rest
        parts.append(_freed(slopes, forced / (SMALL * f.floor)))
    return _freed(slopes, (f.measured - rest) / f.floor), np.array(parts)


def _freed(slopes: Array, values: Array) -> Array:
    """Values (windows, blocks, ny) less what slopes (windows, values, states) explain."""
    flat = np.nan_to_num(values.reshape(len(values), -1), posinf=0.0, neginf=0.0)
    basis, _ = np.linalg.qr(slopes)
    inside = np.einsum("wvi,wui,wu->wv", basis, basis, flat, optimize=True)
    return np.asarray((flat - inside).reshape(values.shape))
