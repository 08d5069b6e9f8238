"""Sweeps on the 1-DoF arm as it is printed and otherwise: recordings, FRFs, fits, and the linearisation beside them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import csd

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.fit import fit, structure_by_name
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.linear import Linearisation, linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.rig.effects import moves
from loopshape.toolbox.rig.simulated import header, measure, plan
from loopshape.toolbox.rig.study import Study

Point = tuple[float, float]


@dataclass(frozen=True)
class Arm:
    """One arm: a name, words for a legend, effects and changed parameters; `only` some recordings, or all."""

    name: str
    label: str
    effects: Mapping[str, float] = field(default_factory=dict)
    changes: Mapping[str, float] = field(default_factory=dict)
    only: tuple[str, ...] = ()

    @classmethod
    def from_table(cls, name: str, table: Mapping[str, Any]) -> Arm:
        """An arm of the settings."""
        return cls(name, **{key: tuple(v) if key == "only" else v for key, v in table.items()})

    def of(self, study: Study) -> Study:
        """The study on this arm."""
        return replace(study, effects=dict(self.effects), changes={**study.changes, **self.changes})

    def linearised(self, point: Point, parameters: Mapping[str, float]) -> Linearisation:
        """The linearisation with averaged valves, under the rig's settings of a recording."""
        changed = {**moves(Arm1(), self.effects), **self.changes, **parameters}
        return linearise(constants(ARM1_PARAMETERS.vector(changed)), *point)


@dataclass(frozen=True, eq=False)
class Found:
    """One recording's FRF and its third-order fit, with the linearised arm at the same point."""

    arm: Arm
    name: str
    frf: FRF
    fit: Fit
    linear: Linearisation

    @property
    def point(self) -> Point:
        """theta2 in deg and p_AB in bar."""
        return self.frf.operating_point["theta2_deg"], self.frf.operating_point["p_ab_bar"]

    def value(self, name: str) -> float:
        """Fitted kappa, f_hz or zeta."""
        return self.fit[name].value

    def interval(self, name: str) -> tuple[float, float]:
        """Its 95 % interval."""
        return self.fit[name].interval

    @property
    def stiffness_gain(self) -> float:
        """kappa/w^2 in rad/(V s): level of the line of slope -1."""
        return self.value("kappa") / (2.0 * np.pi * self.value("f_hz")) ** 2

    def coherent_band_hz(self, least: float) -> tuple[float, float]:
        """The longest unbroken band whose coherence is at least so much."""
        assert self.frf.coherence is not None
        good = np.concatenate([[False], self.frf.coherence >= least, [False]])
        edges = np.flatnonzero(np.diff(good.astype(int)))
        f = self.frf.frequency_hz
        spans = [(f[a], f[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        low, high = max(spans, key=lambda span: np.log(span[1] / span[0]))
        return float(low), float(high)


def recorded(study: Study, arm: Arm, names: Iterable[str] = ()) -> tuple[Run, list[Recording]]:
    """The run and its recordings, those named or all; refuses one that ended early."""
    own, plant, required = arm.of(study), Arm1(), frozenset(names or arm.only)
    every = {planned.name for planned in plan(own, plant)}
    done = every - required if required else set()
    recordings = list(measure(own, plant, done=frozenset(done), threads=1))
    if early := [r.info.name for r in recordings if r.info.ended_early]:
        raise SystemExit(f"{arm.label}: {', '.join(early)} ended early")
    return header(own, plant), recordings


def found(run: Run, recordings: Sequence[Recording], arm: Arm) -> list[Found]:
    """FRF and fit of each recording of the angle loop."""
    out = []
    for recording in recordings:
        frf = estimate_frf(recording, run.loop("theta2"))
        point = frf.operating_point["theta2_deg"], frf.operating_point["p_ab_bar"]
        linear = arm.linearised(point, recording.info.parameters)
        out.append(Found(arm, recording.info.name, frf, fit(frf, structure_by_name("third_order")), linear))
    return out


def by_formula_4_9(recording: Recording, gain: float, segment_s: float) -> tuple[Array, ComplexArray]:
    """The source's own estimate, written out: H = -Phi_e1n/(C Phi_e2n), of Welch's spectra, (nf,)."""
    n, e1 = recording.column("n_theta2_rad"), recording.column("r_theta2_rad") - recording.column("theta2_rad")
    length = round(segment_s * recording.rate_hz)
    given: dict[str, Any] = {"fs": recording.rate_hz, "nperseg": length, "noverlap": 3 * length // 4}
    f, first = csd(n, e1, **given)
    _, second = csd(n, e1 + n, **given)
    return f[1:], -first[1:] / (gain * second[1:])
