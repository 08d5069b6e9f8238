"""The parts that look between lines, and what stands in their place: nothing, or an answer that is left open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from loopshape.identify.smooth import smoothing
from loopshape.loop.margin import between
from loopshape.loop.stability import holes, obstacles
from loopshape.loop.tolerances import TOL

Site = tuple[ModuleType | type, str]


@dataclass(frozen=True)
class Part:
    """A part switched off: where it speaks, by which answers of it, and what stands in its place."""

    name: str
    how: str
    site: Site
    speaks: Callable[[Any], bool]
    instead: Mapping[Site, Any]

    @contextmanager
    def off(self) -> Iterator[None]:
        """The package without the part."""
        with ExitStack() as stack:
            for (where, name), value in self.instead.items():
                stack.enter_context(patch.object(where, name, value))
            yield


@contextmanager
def heard(parts: tuple[Part, ...], said: set[str]) -> Iterator[None]:
    """The package as it is; sites whose answer says something are put into `said`."""

    def listening(part: Part) -> Callable[..., Any]:
        own = getattr(*part.site)

        def asked(*args: Any, **kwargs: Any) -> Any:
            out = own(*args, **kwargs)
            if part.speaks(out):
                said.add(f"{part.site[0].__name__}.{part.site[1]}")
            return out

        return asked

    with ExitStack() as stack:
        for part in {p.site: p for p in parts}.values():
            stack.enter_context(patch.object(*part.site, listening(part)))
        yield


def _near_enough(loop: Any, path: Any) -> list[SimpleNamespace]:
    """Stretches that several resonances might explain, near enough to -1 to matter, without a look at what they are."""
    found = obstacles.cluster_bands_in(loop)
    if not found:
        return []
    f, near = loop.frequency_hz, obstacles._nearest(path)
    C = obstacles._larger(np.abs(loop.C))
    radius = C * np.minimum(np.diff(f) / (obstacles.SHARPEST * f[:-1]), TOL.unseen_peak)
    return [
        SimpleNamespace(first=x.low, last=x.high, left=None)
        for x in found
        if np.any((obstacles.polynomial_residual(loop, x) * radius > near)[x.low : x.high])
    ]


def _rough(loop: Any, path: Any) -> list[SimpleNamespace]:
    """The same by the root mean square that one pole leaves of the lines about each gap."""
    size, scatter = obstacles.interpolation_residuals(loop)
    if not (size > 0.0).any():
        return []
    f, near = loop.frequency_hz, obstacles._nearest(path)
    radius = np.minimum(np.diff(f) / (obstacles.SHARPEST * f[:-1]), TOL.unseen_peak)
    gaps = np.flatnonzero(~scatter & (obstacles._larger(np.abs(loop.C)) * size * radius > near))
    return [SimpleNamespace(first=int(gaps[0]), last=int(gaps[-1]) + 1, left=None)] if gaps.size else []


def _left_open(loop: Any, path: Any, clusters: Any) -> Any:
    f = loop.frequency_hz
    nothing = np.zeros(max(f.size - 1, 0), dtype=bool)
    open_ = obstacles._unexplained(float(f[clusters[0].first]), float(f[clusters[0].last])) if clusters else None
    return 0, nothing, open_


SAMPLING = (obstacles, "_clusters")
HIDDEN, PAST = (obstacles, "hidden_in"), (obstacles, "_past_clusters")
PARTS = (
    Part("several resonances together", "left out", SAMPLING, bool, {SAMPLING: lambda *_: []}),
    Part("several resonances together", "left open", SAMPLING, bool, {SAMPLING: _near_enough, PAST: _left_open}),
    Part("several resonances together", "left open by gaps", SAMPLING, bool, {SAMPLING: _rough, PAST: _left_open}),
    Part("one resonance by its tails", "left out", HIDDEN, bool, {HIDDEN: lambda loop: ()}),
    Part("lines that scatter", "left out", (obstacles, "_scatters"), lambda x: x is not None,
         {(obstacles, "_scatters"): lambda *_: None}),
    Part("scatter told from resonances", "left out", (obstacles, "scattered"), lambda x: bool(np.any(x)),
         {(obstacles, "scattered"): lambda f, *_, **__: np.zeros(max(f.size - 1, 0), dtype=bool)}),
    Part("holes by what tails would show", "left out", (holes, "_unseen"), lambda x: x is not None,
         {(holes, "_unseen"): lambda loop: None}),
    Part("narrow resonances of the plant", "left out", (smoothing, "pole_terms"), bool,
         {(smoothing, "pole_terms"): lambda frf, v: ()}),
    Part("narrow resonances of the controller", "left out", (between, "_controller_places"), lambda x: x.size > 0,
         {(between, "_controller_places"): lambda *_: np.zeros(0)}),
    Part("places between lines", "left out", (between, "_interpolated"), lambda x: True, {(between, "STEP"): 1e12}),
)  # fmt: skip
