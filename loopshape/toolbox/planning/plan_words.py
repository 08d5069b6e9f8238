"""A plan in words: what to do, what it reaches, what stands in the way, and what no plan can know."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from loopshape.core.units import db, deg
from loopshape.toolbox.rig.distortion import HOW

if TYPE_CHECKING:
    from loopshape.toolbox.planning.plan import Plan, Required
    from loopshape.toolbox.planning.plan_record import FirstRecord

_BINDS = {
    "amplitude": "the injected amplitude's limit",
    "input": "the plant input's limit",
    "output": "the output's limit",
    "distortion": "the distortion that the first record shows",
}
#: and what of a length that nothing binds
_LENGTHS = {"shortest": "no shorter record is sensible", "seconds": "length and resolution are as given"}


def accuracy(std: float) -> str:
    """A relative std of |G| in the three units that people use."""
    return f"{100.0 * std:.2g} % ({float(db(1.0 + std)):.2g} dB, {float(deg(std)):.2g} deg)"


def sentence(p: Plan) -> str:
    """What to do and what it reaches."""
    times = f"{p.realisations} realisations of " if p.realisations > 1 else ""
    does = (
        f"{p.lines_hz.size} lines from {p.lines_hz[0]:.3g} to {p.lines_hz[-1]:.3g} Hz, {times}{p.excitation.periods}"
        f" periods of {p.excitation.period_s:g} s ({p.duration_s:.4g} s with ramps), peak {p.excitation.amplitude:.3g}"
        f" {p.unit}"
    )
    there = f"at {p.crossover_hz:.3g} Hz"
    if p.satisfied and p.required.std is not None:
        return (
            f"{p.recording} already has a std of {accuracy(p.before)} {there}, within the required"
            f" {accuracy(p.required.std)}: no further experiment is proposed"
        )
    if p.reached:
        why = _LENGTHS.get(p.binds) or f"{_BINDS[p.binds]} sets the length"
        return f"{does}: std {there} from {accuracy(p.before)} to {accuracy(p.at_crossover)}; {why}"
    short = f"out of reach: {does} brings the std {there} to {accuracy(p.at_crossover)}"
    short += f", {p.short_by:.2g} times the required one; {p.needed_s:.3g} s would be needed"
    if p.binds == "distortion":
        return f"{short}: {_BINDS['distortion']} averages away over realisations only, or falls at another amplitude"
    times = f"{p.needed_amplitude / p.excitation.amplitude:.2g}"
    return f"{short}, or {times} times the amplitude, which {_BINDS[p.binds]} forbids"


def cannot_know(first: FirstRecord, required: Required, floor: float, amplitude: float) -> tuple[str, ...]:
    """What the plan rests on without knowing it."""
    found, notes = first.distortion, []
    if found is None:
        notes.append(
            "the first record does not repeat: distortion counts as noise in it, and in the plan as if it averaged out,"
            " which it does not"
        )
    elif not found.decidable:
        notes.append(f"the first record cannot separate distortion from the response: {found.verdict}")
    elif floor > 0.0:
        notes.append(f"distortion in the first record counts as a noise floor, {accuracy(floor)} at the crossover")
    known = first.frequency_hz[[0, -1]]
    if (required.f_low_hz or known[0]) < 0.999 * known[0] or (required.f_high_hz or known[1]) > 1.001 * known[1]:
        notes.append(
            f"the first record knows {known[0]:.3g} to {known[1]:.3g} Hz: beside that it is predicted as at its edge"
        )
    change = amplitude / first.amplitude
    if abs(np.log(change)) > 0.1:
        turns = (
            "falls and that of other distortion grows" if change > 1.0 else "grows and that of other distortion falls"
        )
        notes.append(
            f"the peak is {change:.2g} times that of the first record: friction's share {turns}, which the prediction"
            " does not hold"
        )
    elif floor > 0.0:
        notes.append("distortion depends on the frequencies too; the prediction takes it as in the first record")
    if required.kind != "odd":
        notes.append(f"these frequencies do not show distortion afterwards; for that: {HOW}")
    return tuple(notes)
