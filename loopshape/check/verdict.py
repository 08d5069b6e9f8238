"""FRFs, controller and requirements -> Verdict: each requirement at its worst operating point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loopshape.check.margins import margins
from loopshape.controller import Controller
from loopshape.errors import WrongUseError
from loopshape.frf import FRF
from loopshape.loop import Loop
from loopshape.model import Fit
from loopshape.requirements import LIMITS, Limit, Line, Margins, Requirements, Verdict
from loopshape.units import deg

#: a fit that misses its lines by more than this, rms, says nothing of the plant below them
WITNESS_DB = 6.0


def loops_of(
    frfs: Sequence[FRF], controller: Controller, requirements: Requirements, fits: Sequence[Fit] = ()
) -> tuple[list[Loop], tuple[str, ...]]:
    """Loops on the lines that a check looks at, and what it had to assume.

    Integrators of the plant come from the requirements, else from a fit of the same recording, else from
    the phase of the lowest lines, and then a note says so.
    """
    found, notes = [], []
    for frf in frfs:
        lines = frf.between(*requirements.band_hz) if requirements.band_hz else frf.trusted_lines()
        if controller.rate_hz != frf.rate_hz and frf.rate_hz > 0.0:
            raise WrongUseError(
                f"the controller of loop {controller.loop} runs at another rate than the recording {frf.recording}",
                f"{controller.rate_hz:g} and {frf.rate_hz:g} Hz",
            )
        fit = next((x for x in fits if (x.recording, x.loop) == (frf.recording, frf.loop) and _witness(x)), None)
        integrators, unstable, note = _open_loop_poles(lines, requirements, fit)
        found.append(Loop(lines, controller, integrators, unstable, None if fit is None else fit.model))
        notes += [note] if note else []
    return found, tuple(dict.fromkeys(notes))


def _witness(fit: Fit) -> bool:
    """Whether a fit may speak for the plant outside the measured band: it ended well and follows the lines."""
    return fit.outcome != "not_converged" and fit.misfit_db < WITNESS_DB


def _open_loop_poles(frf: FRF, requirements: Requirements, fit: Fit | None) -> tuple[int, int, str]:
    """Integrators and unstable poles of the plant, and a note where they had to be assumed."""
    declared = requirements.integrators
    if fit is not None:
        return fit.model.integrators() if declared is None else declared, fit.model.unstable_poles(), ""
    if declared is not None:
        return declared, 0, ""
    lowest = frf.siso[: max(3, frf.siso.size // 20)]
    integrators = round(float(np.median(-deg(np.angle(lowest)) % 360.0)) / 90.0) % 4
    return integrators, 0, f"plant taken to have {integrators} integrators, from the phase at its lowest lines"


def check(frfs: Sequence[FRF], controller: Controller, requirements: Requirements, fits: Sequence[Fit] = ()) -> Verdict:
    """Hold a controller against its requirements at every operating point measured.

    Every line says wished, found, spare, and where it is worst. A loop that is unstable, or whose stability
    the data cannot decide, fails. Margins are taken at face value: from noisy FRFs they err on the safe side.
    """
    if not frfs:
        raise WrongUseError(f"there is no FRF of loop {requirements.loop!r} to check", "", "measure or import one")
    loops, notes = loops_of(frfs, controller, requirements, fits)
    found = {
        name: margins(loop, high_frequency_from_hz=requirements.control_high_frequency_from_hz)
        for name, loop in zip(_names(frfs), loops, strict=True)
    }
    lines = [
        _line(limit, wished, found) for limit in LIMITS if (wished := getattr(requirements, limit.name)) is not None
    ]
    return Verdict(requirements.loop, tuple(lines), found, notes)


def _names(frfs: Sequence[FRF]) -> list[str]:
    names = [frf.recording or f"frf {k + 1}" for k, frf in enumerate(frfs)]
    if len(set(names)) != len(names):
        raise WrongUseError("two FRFs of one loop come from the same recording", ", ".join(names))
    return names


def _line(limit: Limit, wished: float, found: Mapping[str, Margins]) -> Line:
    sign = 1.0 if limit.sense == "at_least" else -1.0
    spare = {name: sign * (getattr(m, limit.name) - wished) for name, m in found.items()}
    worst = min(spare, key=lambda name: spare[name])
    margin = found[worst]
    return Line(
        quantity=limit.name,
        unit=limit.unit,
        wished=wished,
        found=getattr(margin, limit.name),
        spare=spare[worst],
        passed=spare[worst] >= 0.0,
        recording=worst,
        at_hz=margin.at_hz.get(limit.name),
    )
