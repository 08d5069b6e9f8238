"""One norm of weighted S, T and CS made small: by hinfsyn of python-control on a fit, by `tune` on the FRF itself.

Both controllers are judged by `check` on the measured FRF: norm with interval, bandwidth, margins. Needs slycot.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import control
import numpy as np

import loopshape as ls
from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import angular
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit, TransferFunction
from loopshape.design.tune import Search, tune
from loopshape.io.requirements import read_requirements
from loopshape.loop.verdict import check

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "how_far"), str(HERE.parent / "detuning")]
from arm_frfs import EXAMPLES, measured, write  # noqa: E402
from bench_frf import motor_bench  # noqa: E402

COLUMNS = (
    "case", "how", "order", "promised", "norm_on_the_fit", "norm_on_the_frf", "from", "to", "at_hz", "stable",
    "bandwidth_hz", "phase_margin_deg", "gain_margin_db", "modulus_margin", "control_peak_db", "seconds",
)  # fmt: skip
CASES = ("motor bench", "arm (0, 1.0)")
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
    """Each case by each way (or those that are named), and a table."""
    if not control.exception.slycot_check():
        raise UnreadableInputError("the study needs slycot", "it is not installed", "pip install 'loopshape[peers]'")
    table = HERE / "norms.csv"
    with table.open() as file:
        known = [row for row in list(csv.reader(file))[1:] if row[0] in CASES]
    for name in sys.argv[1:] or CASES:
        known = [row for row in known if row[0] != name] + list(rows(name))
    write(table, COLUMNS, known)


def rows(name: str) -> Iterator[list[object]]:
    """A case's controllers: of full order from the fit, of the shipped structure, and grown by one and two blocks."""
    case = cases(name)
    begun = time.process_time()
    system, promised = full_order(case)
    C = ls.controller(*ls.fixed(system), rate_hz=case.frf.rate_hz, loop=case.required.loop)
    seconds = time.process_time() - begun
    yield judged(name, "hinfsyn on the fit", case, C, promised, seconds)
    for how, grow in (("structure", 0), ("structure and two blocks", 2)):
        begun = time.process_time()
        found = tune([case.frf], case.asked, explain=False, search=Search(grow=grow))
        seconds = time.process_time() - begun
        yield judged(name, how, case, found.controller, float("nan"), seconds)


def judged(name: str, how: str, case: Case, C: Controller, promised: float, seconds: float) -> list[object]:
    """What `check` reads of a controller on the FRF."""
    print(f"{how}: {seconds:.1f} s", flush=True)
    (m,) = check([case.frf], C, case.asked).margins.values()
    order = sum(block.order() for block in C.blocks)
    return [
        name, how, order, promised, norm_on_fit(case, C), m.weighted_norm, *m.intervals["weighted_norm"],
        m.at_hz["weighted_norm"], m.stable, m.bandwidth_hz, m.phase_margin_deg, m.gain_margin_db, m.modulus_margin,
        m.control_peak_db, seconds,
    ]  # fmt: skip


def norm_on_fit(case: Case, C: Controller) -> float:
    """The norm of C's loop with the fit as the plant, on a fine grid from far below the first line to half the rate."""
    f = np.geomspace(1e-4 * case.frf.frequency_hz[0], 0.499 * C.rate_hz, 40_000)
    P, c = case.fit.model.response(f), C.response(f)
    S = 1.0 / (1.0 + c * P)
    sizes = {"S": S, "T": c * P * S, "CS": c * S, "PS": P * S}
    return float(np.sqrt(sum((w.at(f) * np.abs(sizes[w.response])) ** 2 for w in case.asked.weights)).max())


def full_order(case: Case) -> tuple[control.StateSpace, float]:
    """hinfsyn's controller for the fit and the weights, with the norm that it promises; time runs in 1/(2 pi f)."""
    w = float(angular(case.design_hz))
    P = control.ss(slowed(rational(case.fit.model, w), w))
    W = {name: control.ss(slowed(one, w)) for name, one in case.weights.items()}
    K, _, promised, *_ = control.mixsyn(P, W["S"], W.get("CS"), W.get("T"))
    A, B, C, D = control.ssdata(K)
    return control.ss(w * A, w * B, C, D), float(promised[0])


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


def down(frf: FRF, fit: Fit) -> FRF:
    """The measured lines, and below them those of the fit, 2 % stated: a design on a model counts |S| from 0 Hz on.

    Without it a controller on measured lines alone gives |S| up where nothing is read.
    """
    mine = frf.select(frf.valid)
    low = mine.frequency_hz[0] * np.geomspace(1e-3, 1.0, 60, endpoint=False)
    P = np.concatenate([fit.model.response(low), mine.siso])
    std = np.concatenate([0.02 * np.abs(P[: low.size]), np.sqrt(mine.variance[:, 0, 0])])
    return ls.FRF.from_arrays(
        np.append(low, mine.frequency_hz), P, std=std, rate_hz=frf.rate_hz, loop=frf.loop, recording=frf.recording
    )


def cases(name: str) -> Case:
    """A plant with its fit and weights."""
    if name == "motor bench":
        frfs, fits, asked = motor_bench()
        return Case(down(frfs[0], fits[0]), fits[0], replace(asked, unstable_poles=0), bench_weights(), 30.0)
    frfs, fits = measured()
    (k,) = (k for k, frf in enumerate(frfs) if frf.recording == "angle-08")
    asked = read_requirements(EXAMPLES / "requirements.toml")[0]
    return Case(down(frfs[k], fits[k]), fits[k], replace(asked, unstable_poles=0), arm_weights(), 2.0)


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
