"""One norm of weighted S, T and CS made small: by hinfsyn of python-control on a fit, by `tune` on the FRF itself.

Both controllers are judged by `check` on the measured FRF: norm with interval, bandwidth, margins. Needs slycot.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import control
import numpy as np

import loopshape as ls
from loopshape.core.units import angular
from loopshape.data.controller import Controller
from loopshape.data.frf import FRF
from loopshape.data.model import Fit, TransferFunction
from loopshape.data.requirements import Requirements
from loopshape.design.tune import tune
from loopshape.io.requirements import read_requirements
from loopshape.loop.verdict import check

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "how_far"), str(HERE.parent / "detuning")]
from arm_frfs import EXAMPLES, measured, write  # noqa: E402
from bench_frf import motor_bench  # noqa: E402

COLUMNS = (
    "case", "how", "order", "norm_on_the_fit", "norm_on_the_frf", "from", "to", "stable", "bandwidth_hz",
    "phase_margin_deg", "gain_margin_db", "modulus_margin", "control_peak_db", "seconds",
)  # fmt: skip
#: an integrator of a fit is moved this far to the left, as a share of the frequency of the design: hinfsyn refuses it
LEFT = 1e-4
#: Padé's order for the delay
PADE = 2


@dataclass(frozen=True)
class Case:
    """What a comparison is made on, and its weights as continuous systems of python-control."""

    frf: FRF
    fit: Fit
    required: Requirements
    weights: dict[str, control.TransferFunction]
    design_hz: float

    @property
    def asked(self) -> Requirements:
        """The weights alone, for the structure of the shipped requirements."""
        return Requirements(
            self.required.loop,
            structure=self.required.structure,
            weights=tuple(ls.Weight(name, W) for name, W in self.weights.items()),
            objective=ls.Objective(0.0, weighted_norm=1.0),
            integrators=self.required.integrators,
            unstable_poles=self.required.unstable_poles,
        )


def main() -> None:
    """Each case by each way, and a table."""
    chosen = sys.argv[1:] or ["motor bench", "arm (0, 1.0)"]
    write(HERE / "norms.csv", COLUMNS, [row for name in chosen for row in rows(name)])


def rows(name: str) -> Iterator[list[object]]:
    """A case's controllers: of full order from the fit, of the shipped structure, and grown by one and two blocks."""
    case = cases(name)
    begun = time.process_time()
    system, norm = full_order(case)
    C = ls.controller(*ls.fixed(system), rate_hz=case.frf.rate_hz, loop=case.required.loop)
    seconds = time.process_time() - begun
    yield judged(name, "hinfsyn on the fit", case, C, norm, seconds)
    for how, grow, start in (("structure", 0, None), ("structure and two blocks", 2, None)):
        begun = time.process_time()
        found = tune([case.frf], case.asked, [case.fit], grow=grow, start=start, explain=False)
        seconds = time.process_time() - begun
        yield judged(name, how, case, found.controller, float("nan"), seconds)


def judged(name: str, how: str, case: Case, C: Controller, norm: float, seconds: float) -> list[object]:
    """What `check` reads of a controller on the FRF."""
    (m,) = check([case.frf], C, case.asked, [case.fit], detuned=False).margins.values()
    order = sum(block.order() for block in C.blocks)
    return [
        name, how, order, norm, m.weighted_norm, *m.intervals["weighted_norm"], m.stable, m.bandwidth_hz,
        m.phase_margin_deg, m.gain_margin_db, m.modulus_margin, m.control_peak_db, seconds,
    ]  # fmt: skip


def full_order(case: Case) -> tuple[control.StateSpace, float]:
    """hinfsyn's controller for the fit and the weights, with the norm that it promises; time runs in 1/(2 pi f)."""
    w = float(angular(case.design_hz))
    P = control.ss(slowed(rational(case.fit.model, w), w))
    W = {name: control.ss(slowed(one, w)) for name, one in case.weights.items()}
    K, _, norm, *_ = control.mixsyn(P, W["S"], W.get("CS"), W.get("T"))
    A, B, C, D = control.ssdata(K)
    return control.ss(w * A, w * B, C, D), float(norm[0] if isinstance(norm, Sequence) else norm)


def rational(model: TransferFunction, w: float) -> control.TransferFunction:
    """A fit with its delay after Padé and its integrators a little to the left."""
    integrators = model.integrators()
    den = np.polymul(model.den[: model.den.size - integrators], np.poly(np.full(integrators, -LEFT * w)))
    delay = control.tf(*control.pade(model.delay_s, PADE)) if model.delay_s > 0.0 else control.tf([1.0], [1.0])
    return control.tf(model.num, den) * delay


def slowed(system: control.TransferFunction, w: float) -> control.TransferFunction:
    """The same with w rad/s at 1 rad/s: coefficients of one size."""
    num, den = (np.asarray(x[0][0]) * w ** np.arange(len(x[0][0]) - 1.0, -1.0, -1.0) for x in (system.num, system.den))
    return control.tf(num / den[0], den / den[0])


def cases(name: str) -> Case:
    """A plant with its fit and weights."""
    if name == "motor bench":
        frfs, fits, asked = motor_bench()
        return Case(frfs[0], fits[0], asked, bench_weights(), 30.0)
    frfs, fits = measured()
    (k,) = (k for k, frf in enumerate(frfs) if frf.recording == "angle-08")
    return Case(frfs[k], fits[k], read_requirements(EXAMPLES / "requirements.toml")[0], arm_weights(), 2.0)


def bench_weights() -> dict[str, control.TransferFunction]:
    """|S| below 0.1 at low frequency and 1 at 25 Hz, |T| falling from 100 Hz, |CS| below 60 dB from there."""
    return {"S": rise(25.0, 0.1, 2.0), "T": fall(100.0), "CS": fall(200.0) * 1e-3}


def arm_weights() -> dict[str, control.TransferFunction]:
    """The same of the arm: 1 at 1.5 Hz, |T| from 10 Hz, |CS| below 26 dB."""
    return {"S": rise(1.5, 0.05, 2.0), "T": fall(10.0), "CS": fall(25.0) * 0.05}


def rise(f_hz: float, low: float, high: float) -> control.TransferFunction:
    """1/|W| is `low` at 0 Hz, 1 about f and `high` above."""
    w = float(angular(f_hz))
    return control.tf([1.0 / high, w], [1.0, w * low])


def fall(f_hz: float) -> control.TransferFunction:
    """|W| is 0.5 below f, 1 about it, and up to 50 above."""
    w = float(angular(f_hz))
    return control.tf([1.0 / w, 0.5], [0.01 / w, 1.0])


if __name__ == "__main__":
    main()
