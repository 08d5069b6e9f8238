"""Which recordings of a run belong together: realisations of one loop, and what spans a plant's matrix."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

from loopshape.data.signal.recording import Recording


def realisations(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Groups of periodic recordings that excite one loop, alike but for the draw of phases; others stand alone."""
    return _grouped(recordings, lambda r: (*_alike(r), r.info.excited, r.info.period_s or r.info.name))


def matrices(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Groups at one operating point that together excite two loops or more.

    Where a point has recordings of several kinds, those that excite all loops at once are taken, else periodic ones,
    else the rest.
    """
    found = []
    for group in _grouped(recordings, _alike):
        together = [r for r in group if r.info.excites_also]
        periodic = [r for r in group if r.info.period_s is not None and not r.info.excites_also]
        other = [r for r in group if r.info.period_s is None and not r.info.excites_also]
        spans = [g for g in (together, periodic, other) if len({n for r in g for n in r.info.excited}) > 1]
        found += spans[:1]
    return found


def _alike(r: Recording) -> tuple[Hashable, ...]:
    """What recordings that are taken together must share."""
    point, settings = sorted(r.info.operating_point.items()), sorted(r.info.parameters.items())
    return (tuple(point), tuple(settings), r.info.injection, r.info.closed_loop)


def _grouped(recordings: Sequence[Recording], key: Callable[[Recording], Hashable]) -> list[list[Recording]]:
    groups: dict[Hashable, list[Recording]] = {}
    for r in recordings:
        groups.setdefault(key(r), []).append(r)
    return list(groups.values())
