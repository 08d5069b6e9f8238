"""A hypothesis: effects in given forms, with manufacturing tolerance as nuisance: numbers fitted in a box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.gap.nouns.plant import SimulationModel


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """No form is the healthy machine. Numbers phi: what the forms free, in order, then the spread in -1..1."""

    plant: SimulationModel
    forms: tuple[EffectForm, ...] = ()

    @property
    def name(self) -> str:
        """Its effects in alphabetical order, joined by +; none without."""
        return "+".join(sorted(f.effect for f in self.forms)) or "none"

    @property
    def form(self) -> str:
        """Its forms in words."""
        return " + ".join(f.form for f in self.forms)

    @property
    def n_free(self) -> int:
        """How many numbers the forms free."""
        return sum(len(f.free) for f in self.forms)

    @cached_property
    def low(self) -> Array:
        """Lower bounds of phi."""
        return np.array([f.low for form in self.forms for f in form.free] + [-1.0] * len(self.plant.spread))

    @cached_property
    def high(self) -> Array:
        """Upper bounds of phi."""
        return np.array([f.high for form in self.forms for f in form.free] + [1.0] * len(self.plant.spread))

    def starts(self, base: Array) -> list[Array]:
        """Phi at every combination of the last form's starts; the forms before it and the spread as in `base`."""
        before = self.n_free - len(self.forms[-1].free)
        options = product(*(f.starts for f in self.forms[-1].free))
        return [np.concatenate([base[:before], values, base[before:]]) for values in options]

    def moves(self, phi: Array) -> dict[str, float]:
        """Parameters of the plant at phi."""
        out: dict[str, float] = {}
        at = 0
        for form in self.forms:
            out |= form.moves(phi[at : at + len(form.free)].tolist())
            at += len(form.free)
        for s, value in zip(self.plant.spread, phi[at:].tolist(), strict=True):
            for name in s.parameters:
                nominal = self.plant.parameters.rows[self.plant.parameters.index(name)].value
                out[name] = s.moved(out.get(name, nominal), value)
        return out

    def steps(self, phi: Array) -> Array:
        """Steps for finite differences, pointing into the box."""
        free = [f for form in self.forms for f in form.free]
        scale = [max(0.2 * max(abs(s) for s in f.starts), 0.01 * (f.high - f.low)) for f in free]
        share = np.array([f.step for f in free])
        own = share * np.maximum(np.abs(phi[: self.n_free]), scale)
        size = np.concatenate([own, np.full(len(self.plant.spread), 0.5)])
        return np.asarray(np.where(phi + size > self.high, -size, size))

    def magnitudes(self, phi: Array) -> list[float]:
        """One a form, in its unit."""
        out, at = [], 0
        for form in self.forms:
            out.append(form.magnitude(phi[at : at + len(form.free)].tolist()))
            at += len(form.free)
        return out


def candidates(plant: SimulationModel, base: Sequence[EffectForm] = ()) -> list[Hypothesis]:
    """One hypothesis a form of the catalogue, each beside the forms of `base`, whose effects do not repeat."""
    taken = {f.effect for f in base}
    return [Hypothesis(plant, (*base, f)) for f in plant.effects if f.effect not in taken]
