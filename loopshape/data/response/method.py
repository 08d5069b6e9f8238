"""The methods of many estimates in one line."""

from __future__ import annotations

from collections.abc import Sequence

from loopshape.data.response.frf import FRF

#: what each number of a method says, in the order of the sentence
_PHRASES = {
    "sweep_s": ("local fits of sweeps of {} s", ".4g"),
    "rationals_percent": ("{} % rationals", ".0f"),
    "record_s": ("local fits of records of {} s", ".4g"),
    "resolution_hz": ("frequencies {} Hz apart", ".3g"),
    "segment_s": ("Welch, segments of {} s", ".4g"),
    "averages": ("{} averages", ".1f"),
    "periods": ("{} periods", ".0f"),
    "period_s": ("of {} s", ".4g"),
    "realisations": ("{} realisations", ".0f"),
}


def in_short(frfs: Sequence[FRF]) -> str:
    """How FRFs were measured: the sentence that all share, else one with the ranges of its numbers for each kind.

    Kinds are told apart by which numbers a method has; methods without numbers, as those of other programs, are
    counted. Estimator and sweep's harmonics stand in each `FRF.method` alone.
    """
    if len({frf.method for frf in frfs}) < 2:
        return frfs[0].method if frfs else ""
    kinds: dict[tuple[str, ...], list[FRF]] = {}
    for frf in frfs:
        kinds.setdefault(tuple(name for name in _PHRASES if name in frf.method_numbers), []).append(frf)
    return "; ".join(_kind(names, mine) for names, mine in kinds.items())


def by_loop(frfs: Sequence[FRF]) -> list[str]:
    """The same, a line for each loop; one for all where all share it."""
    if len({frf.method for frf in frfs}) < 2:
        return [frfs[0].method] if frfs else []
    loops = dict.fromkeys(frf.loop for frf in frfs)
    return [f"{loop}: ".lstrip(": ") + in_short([frf for frf in frfs if frf.loop == loop]) for loop in loops]


def _kind(names: Sequence[str], frfs: Sequence[FRF]) -> str:
    count, methods = f"{len(frfs)} estimate{'s' * (len(frfs) > 1)}", {frf.method for frf in frfs}
    if len(methods) == 1:
        return f"{count}: {methods.pop()}"
    if not names:
        return f"{count} by {len(methods)} methods"
    phrases = [_phrase(name, [frf.method_numbers[name] for frf in frfs]) for name in names]
    return f"{count}: {', '.join(phrases)}".replace(" periods, of", " periods of")


def _phrase(name: str, values: Sequence[float]) -> str:
    text, form = _PHRASES[name]
    ends = dict.fromkeys((format(min(values), form), format(max(values), form)))
    return text.format("-".join(ends))
