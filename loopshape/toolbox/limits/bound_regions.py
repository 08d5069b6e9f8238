"""Where a plant's free parameter Q may lie at one frequency, from the limits of all plants that share the controller.

With S = s0 + s1 Q and CS = r0 + r1 Q of the plant whose parameter it is, another plant Pj under the same controller
has Sj = S/N, CSj = CS/N with N = S + Pj CS (N = 1 for the plant itself). So each limit reads
|a + b Q| <= m |c + d Q|: a disk, the outside of one, or a half-plane, and |Lj| >= 1 reads |S| <= |Pj| |CS|. Their
intersection is not convex; what counts is its convex hull, so nothing allowed is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.requirement.requirements import Requirements
from loopshape.loop.loop import Loop
from loopshape.toolbox.limits.bound_nodes import Ceilings, Nodes, ceiling_above, ceilings, spans

#: directions of the polygons' sides
SIDES = 48
DIRECTIONS: ComplexArray = np.exp(1j * TWO_PI * np.arange(SIDES) / SIDES)
#: alpha, Re beta, Im beta, gamma of a form that always holds
_HOLDS = np.array([0.0, 0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Regions:
    """What Q may be at each of n nodes: forms (n, m, 4) of all limits, the last that of |L| >= 1, and a disk about all.

    All that the forms leave lies within `extent` (n,) of `centre` (n,).
    """

    forms: Array
    centre: ComplexArray
    extent: Array

    def asked(self, crossing: bool) -> Array:
        """The forms with or without |L| >= 1."""
        return self.forms if crossing else self.forms[:, :-1]

    def polygons(self, *, crossing: bool) -> ComplexArray:
        """Vertices (n, SIDES) of polygons near the regions' convex hulls, as large on the average; nan where empty."""
        forms = self.asked(crossing)
        support = _in_batches(
            forms, _felt(forms, self.centre, self.extent), self.centre, self.extent, DIRECTIONS.reshape(1, -1)
        )
        turn = TWO_PI / SIDES
        about = DIRECTIONS * (support + 1j * (np.roll(support, -1, axis=1) - support * np.cos(turn)) / np.sin(turn))
        amid = about.mean(axis=1)[:, None]
        vertices = amid + (about - amid) * 0.5 * turn / np.tan(0.5 * turn)
        return np.asarray(self.centre[:, None] + self.extent[:, None] * vertices)

    def support(self, h: ComplexArray, *, crossing: bool) -> Array:
        """Largest Re(h Q) (n,) over the regions for h (n,), to rounding; nan where a region is empty."""
        forms = self.asked(crossing)
        along = np.asarray(np.conj(h) / np.maximum(np.abs(h), 1e-300), dtype=complex)
        felt = _felt(forms, self.centre, self.extent)
        found = _in_batches(forms, felt, self.centre, self.extent, along[:, None])[:, 0]
        return np.asarray(np.real(h * self.centre) + np.abs(h) * self.extent * found)

    def at(self, rows: np.ndarray) -> Regions:
        """The regions of some nodes."""
        return Regions(self.forms[rows], self.centre[rows], self.extent[rows])


def regions(at: Nodes, limits: Requirements, loops: Sequence[Loop]) -> Regions | None:
    """Regions at the nodes of a plant for the controllers that suit it and all `loops`; None where one is unbounded."""
    P, band = spans(loops, at.f)
    S, CS = (at.s0, at.s1), (at.r0, at.r1)
    own = own_ceilings(at, limits)
    mine = np.stack(_limits(S, CS, (np.ones_like(at.P), np.zeros_like(at.P)), own, at.f <= at.f[at.inside][-1]), axis=1)
    circles = _circles(mine)
    least = np.argmin(circles[1], axis=1)
    rows = np.arange(at.f.size)
    centre, extent = circles[0][rows, least], circles[1][rows, least]
    if not np.isfinite(extent).all():
        return None
    forms = [mine]
    for one, here in zip(P, band, strict=True):
        N = (at.s0 + one * at.r0, at.s1 + one * at.r1)
        if np.any(here & (N[1] != 0.0)):  # else it is the plant itself
            forms.append(np.stack(_limits(S, CS, N, ceilings(limits, at.f, one), here), axis=1))
    size = np.where(band, np.abs(P), np.inf).min(axis=0)
    # |L| >= 1 is asked as |L| >= 1 less this, which keeps its half-plane a (vast) circle
    unity = _form(S, (1.0 + 1e-5) * size, CS, np.asarray(band.any(axis=0)))
    return Regions(np.concatenate([*forms, unity[:, None]], axis=1), centre, extent)


def own_ceilings(at: Nodes, limits: Requirements) -> Ceilings:
    """Ceilings of the plant itself: on |S| below its last line, on |CS| alone above it."""
    found = ceilings(limits, at.f, at.P)
    above = at.f > at.f[at.inside][-1]
    CS = found.CS.copy()
    CS[above] = ceiling_above(limits, at.f[above], at.P[above])
    return Ceilings(np.where(above, np.inf, found.S), CS, found.disk)


Affine = tuple[ComplexArray, ComplexArray]


def _limits(S: Affine, CS: Affine, N: Affine, most: Ceilings, where: np.ndarray) -> list[Array]:
    """Forms (n, 4) of the limits on |S/N|, |CS/N| and |S/N - 1/2|; for a plant itself that on |CS| holds everywhere."""
    middle = (S[0] - 0.5 * N[0], S[1] - 0.5 * N[1])
    itself = np.all(N[1] == 0.0)
    return [
        _form(S, most.S, N, where),
        _form(CS, most.CS, N, np.ones_like(where) if itself else where),
        _form(middle, np.full(where.size, most.disk), N, where),
    ]


def _form(left: Affine, most: Array, right: Affine, where: np.ndarray) -> Array:
    """|a + b Q| <= m |c + d Q| as alpha |Q|^2 + 2 Re(conj(beta) Q) + gamma <= 0.

    Gives (n, 4) of alpha, Re beta, Im beta, gamma. What is asked with m = inf, or not `where`, always holds.
    """
    (a, b), (c, d) = left, right
    asked = where & np.isfinite(most)
    m = np.where(asked, most, 0.0)
    beta = a * np.conj(b) - m**2 * c * np.conj(d)
    alpha, gamma = np.abs(b) ** 2 - (m * np.abs(d)) ** 2, np.abs(a) ** 2 - (m * np.abs(c)) ** 2
    return np.where(asked[:, None], np.stack([alpha, beta.real, beta.imag, gamma], axis=1), _HOLDS)


def _circles(forms: Array) -> tuple[ComplexArray, Array]:
    """Centres and radii of disks (n, m, 4); radius inf where a form is no disk."""
    disk = forms[..., 0] > 0.0
    alpha = np.where(disk, forms[..., 0], 1.0)
    centre = -(forms[..., 1] + 1j * forms[..., 2]) / alpha
    square = np.abs(centre) ** 2 - forms[..., 3] / alpha
    return np.asarray(centre), np.where(disk, np.sqrt(np.maximum(square, 0.0)), np.inf)


def _felt(forms: Array, centre: ComplexArray, extent: Array) -> np.ndarray:
    """Forms (n, m) that cut into the disk that everything lies in, and are not implied by another of their kind."""
    disk, middle, radius = _borders(forms, centre, extent)
    size = np.abs(middle)
    cuts = np.where(disk, size + 1.0 > radius * (1.0 - 1e-9), size < radius + 1.0) & (forms != _HOLDS).any(axis=2)
    apart = np.abs(middle[:, :, None] - middle[:, None])
    inner, outer = radius[:, :, None], radius[:, None]
    disk_within = apart + inner < outer  # the first lies inside the second
    implied = np.where(disk[:, None], disk_within, disk_within.transpose(0, 2, 1))
    alike = (disk[:, :, None] == disk[:, None]) & cuts[:, :, None]
    return np.asarray(cuts & ~(implied & alike).any(axis=1))


def _borders(forms: Array, centre: ComplexArray, extent: Array) -> tuple[np.ndarray, ComplexArray, Array]:
    """Which forms (n, m, 4) are disks, and the circles that bound them, in units of the reach about the centre."""
    alpha, beta, gamma = forms[..., 0], forms[..., 1] + 1j * forms[..., 2], forms[..., 3]
    c, r = centre[:, None], extent[:, None]
    gamma = (alpha * np.abs(c) ** 2 + 2.0 * np.real(np.conj(beta) * c) + gamma) / r**2
    beta = (beta + alpha * c) / r
    # a border straighter than this (inverse radius over the region's size) counts as this curved, outwards
    straight = 1e-6
    curved = np.maximum(np.abs(beta), np.abs(gamma)) * straight
    alpha = np.where(np.abs(alpha) < curved, -curved, alpha)
    middle = -beta / alpha
    return alpha > 0.0, middle, np.sqrt(np.maximum(np.abs(middle) ** 2 - gamma / alpha, 0.0))


def _in_batches(forms: Array, felt: np.ndarray, centre: ComplexArray, extent: Array, directions: ComplexArray) -> Array:
    """Support (n, d) of what the felt forms leave, in batches of nodes with as many of them."""
    directions = np.broadcast_to(directions, (centre.size, directions.shape[1]))
    found = np.empty(directions.shape)
    counts = felt.sum(axis=1)
    for count in np.unique(counts):
        every = np.flatnonzero(counts == count)
        for rows in np.array_split(every, max(1, every.size * int(count) ** 2 // 20_000)):
            chosen = forms[rows][felt[rows]].reshape(rows.size, count, 4)
            found[rows] = _support(chosen, centre[rows], extent[rows], directions[rows])
    return found


def _support(forms: Array, centre: ComplexArray, extent: Array, directions: ComplexArray) -> Array:
    """Support (n, d) of what all forms (n, m, 4) leave in directions (n, d), in units of the reach about the centre.

    It is reached at an extreme point of one disk or where two borders meet; nan where nothing is left.
    """
    disk, middle, radius = _borders(forms, centre, extent)
    extremes = np.where(disk[..., None], middle[..., None] + radius[..., None] * directions[:, None], np.nan)
    points = np.concatenate([extremes.reshape(centre.size, -1), _meetings(middle, radius)], axis=1)
    beyond = np.abs(points[:, :, None] - middle[:, None]) - radius[:, None]
    held = np.where(disk[:, None], beyond <= 1e-8, beyond >= -1e-8).all(axis=2)  # false for nan
    first = np.argsort(~held, axis=1, kind="stable")[:, : max(1, int(held.sum(axis=1).max()))]
    points, held = np.take_along_axis(points, first, axis=1), np.take_along_axis(held, first, axis=1)
    along = np.real(np.conj(directions)[:, None] * np.where(held, points, 0.0)[..., None])
    support = np.where(held[..., None], along, -np.inf).max(axis=1)
    return np.where(np.isfinite(support), support, np.nan)


def _meetings(middle: ComplexArray, radius: Array) -> ComplexArray:
    """Points (n, m (m - 1)) where two of the circles (n, m) meet, nan where they do not."""
    i, j = np.triu_indices(middle.shape[1], 1)
    between = middle[:, j] - middle[:, i]
    apart = np.where(between == 0.0, np.nan, np.abs(between))
    ri, rj = radius[:, i], radius[:, j]
    along = (apart**2 + ri**2 - rj**2) / (2.0 * apart)
    across = np.sqrt(np.where(np.abs(along) <= ri, ri**2 - along**2, np.nan))
    ahead = between / np.where(np.isnan(apart), 1.0, apart)
    found = middle[:, i] + ahead * along
    return np.concatenate([found + 1j * ahead * across, found - 1j * ahead * across], axis=1)
