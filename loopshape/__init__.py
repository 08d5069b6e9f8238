"""loopshape: from closed-loop recordings of a motion system to a tuned, checked controller.

    import loopshape as ls

    P = ls.frf(ls.Run.from_arrays(u=u, y=y, excitation=n, rate_hz=1000.0))
    R = ls.Requirements(phase_margin_deg=45, sensitivity_peak_db=6, unstable_poles=0)
    C = ls.tune(P, R, [ls.gain(), ls.lead_lag(), ls.notch()])
    v = ls.check(P, C, R)

Names are loaded when they are first used; `dir(loopshape)` lists them.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from loopshape.core.errors import LoopshapeError as LoopshapeError
    from loopshape.data.algebra.diagram import transfer as transfer
    from loopshape.data.algebra.multirate import multirate as multirate
    from loopshape.data.axis import axis as axis
    from loopshape.data.common_diagrams import cascade as cascade
    from loopshape.data.common_diagrams import disturbance_observer as disturbance_observer
    from loopshape.data.common_diagrams import dual_stage as dual_stage
    from loopshape.data.common_diagrams import prefilter as prefilter
    from loopshape.data.common_diagrams import two_sensors as two_sensors
    from loopshape.data.control_frd import from_control as from_control
    from loopshape.data.control_frd import to_control as to_control
    from loopshape.data.controller import Controller as Controller
    from loopshape.data.diagram import Diagram as Diagram
    from loopshape.data.diagram import Part as Part
    from loopshape.data.disturbance import Disturbance as Disturbance
    from loopshape.data.fixed import fixed as fixed
    from loopshape.data.frf import FRF as FRF
    from loopshape.data.gain_scheduled import GainScheduled as GainScheduled
    from loopshape.data.gain_scheduled import gain_scheduled as gain_scheduled
    from loopshape.data.gap_report import GapReport as GapReport
    from loopshape.data.interaction import Interaction as Interaction
    from loopshape.data.limits_over import AtPoints as AtPoints
    from loopshape.data.limits_over import Mask as Mask
    from loopshape.data.machine import Input as Input
    from loopshape.data.machine import Model as Model
    from loopshape.data.machine import ModelParameter as ModelParameter
    from loopshape.data.machine import Output as Output
    from loopshape.data.machine import Port as Port
    from loopshape.data.model import Fit as Fit
    from loopshape.data.objective import Objective as Objective
    from loopshape.data.prediction import Comparison as Comparison
    from loopshape.data.prediction import Prediction as Prediction
    from loopshape.data.recording import Recording as Recording
    from loopshape.data.requirements import Margins as Margins
    from loopshape.data.requirements import Requirements as Requirements
    from loopshape.data.requirements import SeveralRequirements as SeveralRequirements
    from loopshape.data.run import Run as Run
    from loopshape.data.shorthand import biquad as biquad
    from loopshape.data.shorthand import complex_lead as complex_lead
    from loopshape.data.shorthand import controller as controller
    from loopshape.data.shorthand import gain as gain
    from loopshape.data.shorthand import lead_lag as lead_lag
    from loopshape.data.shorthand import low_pass as low_pass
    from loopshape.data.shorthand import notch as notch
    from loopshape.data.shorthand import pi as pi
    from loopshape.data.shorthand import pid as pid
    from loopshape.data.shorthand import resonator as resonator
    from loopshape.data.study import Study as Study
    from loopshape.data.verdict import Outcome as Outcome
    from loopshape.data.verdict import Verdict as Verdict
    from loopshape.data.weight import Weight as Weight
    from loopshape.data.wired import Wired as Wired
    from loopshape.design.bound import Bound as Bound
    from loopshape.design.decouple import decouple as decouple
    from loopshape.design.decoupled import decoupled as decoupled
    from loopshape.design.feedforward import feedforward as feedforward
    from loopshape.design.learning import learning as learning
    from loopshape.design.next_trial import next_trial as next_trial
    from loopshape.design.repetitive import repetitive as repetitive
    from loopshape.design.tune import Tuning as Tuning
    from loopshape.loop.diagram_run import simulate as simulate
    from loopshape.loop.equivalent import Equivalent as Equivalent
    from loopshape.loop.equivalent import equivalent as equivalent
    from loopshape.verbs.campaign import campaign as campaign
    from loopshape.verbs.chain import check as check
    from loopshape.verbs.chain import compare as compare
    from loopshape.verbs.chain import fit as fit
    from loopshape.verbs.chain import frf as frf
    from loopshape.verbs.chain import frfs as frfs
    from loopshape.verbs.chain import predict as predict
    from loopshape.verbs.chain import shape as shape
    from loopshape.verbs.chain import tune as tune
    from loopshape.verbs.diagnosis import gap as gap
    from loopshape.verbs.diagnosis import identifiability as identifiability
    from loopshape.verbs.files import export as export
    from loopshape.verbs.files import profiles as profiles
    from loopshape.verbs.files import read as read
    from loopshape.verbs.files import read_controllers as read_controllers
    from loopshape.verbs.files import read_frf as read_frf
    from loopshape.verbs.files import read_gain_scheduled as read_gain_scheduled
    from loopshape.verbs.files import read_requirements as read_requirements
    from loopshape.verbs.files import read_table as read_table
    from loopshape.verbs.files import report as report
    from loopshape.verbs.files import write as write
    from loopshape.verbs.machine import connect as connect
    from loopshape.verbs.machine import emulator as emulator
    from loopshape.verbs.machine import measure as measure
    from loopshape.verbs.plan import plan as plan
    from loopshape.verbs.plan import write_plan as write_plan
    from loopshape.verbs.possible import bound as bound
    from loopshape.verbs.possible import reach as reach
    from loopshape.verbs.possible import schedule as schedule
    from loopshape.verbs.several import frf_matrices as frf_matrices
    from loopshape.verbs.several import interaction as interaction
    from loopshape.verbs.stop import stop as stop
    from loopshape.verbs.tones import tones as tones
    from loopshape.verbs.tracking import tracking_error as tracking_error
    from loopshape.view import plot as plot

__version__ = "0.1.0"

#: public name -> the module that holds it
_HOME = {
    "AtPoints": "data.limits_over",
    "Bound": "design.bound",
    "Comparison": "data.prediction",
    "Controller": "data.controller",
    "Diagram": "data.diagram",
    "Disturbance": "data.disturbance",
    "Equivalent": "loop.equivalent",
    "FRF": "data.frf",
    "Fit": "data.model",
    "GainScheduled": "data.gain_scheduled",
    "Wired": "data.wired",
    "GapReport": "data.gap_report",
    "Input": "data.machine",
    "Interaction": "data.interaction",
    "LoopshapeError": "core.errors",
    "Margins": "data.requirements",
    "Mask": "data.limits_over",
    "Model": "data.machine",
    "ModelParameter": "data.machine",
    "Objective": "data.objective",
    "Outcome": "data.verdict",
    "Output": "data.machine",
    "Part": "data.diagram",
    "Port": "data.machine",
    "Prediction": "data.prediction",
    "Recording": "data.recording",
    "Requirements": "data.requirements",
    "Run": "data.run",
    "SeveralRequirements": "data.requirements",
    "Study": "data.study",
    "Tuning": "design.tune",
    "Verdict": "data.verdict",
    "Weight": "data.weight",
    "axis": "data.axis",
    "biquad": "data.shorthand",
    "bound": "verbs.possible",
    "campaign": "verbs.campaign",
    "cascade": "data.common_diagrams",
    "check": "verbs.chain",
    "compare": "verbs.chain",
    "complex_lead": "data.shorthand",
    "connect": "verbs.machine",
    "controller": "data.shorthand",
    "decouple": "design.decouple",
    "decoupled": "design.decoupled",
    "disturbance_observer": "data.common_diagrams",
    "dual_stage": "data.common_diagrams",
    "emulator": "verbs.machine",
    "equivalent": "loop.equivalent",
    "export": "verbs.files",
    "feedforward": "design.feedforward",
    "fit": "verbs.chain",
    "fixed": "data.fixed",
    "frf": "verbs.chain",
    "frf_matrices": "verbs.several",
    "frfs": "verbs.chain",
    "from_control": "data.control_frd",
    "gain": "data.shorthand",
    "gain_scheduled": "data.gain_scheduled",
    "gap": "verbs.diagnosis",
    "identifiability": "verbs.diagnosis",
    "interaction": "verbs.several",
    "lead_lag": "data.shorthand",
    "learning": "design.learning",
    "low_pass": "data.shorthand",
    "measure": "verbs.machine",
    "multirate": "data.algebra.multirate",
    "next_trial": "design.next_trial",
    "notch": "data.shorthand",
    "pi": "data.shorthand",
    "pid": "data.shorthand",
    "plan": "verbs.plan",
    "plot": "view",
    "predict": "verbs.chain",
    "prefilter": "data.common_diagrams",
    "profiles": "verbs.files",
    "reach": "verbs.possible",
    "read": "verbs.files",
    "read_controllers": "verbs.files",
    "read_frf": "verbs.files",
    "read_gain_scheduled": "verbs.files",
    "read_requirements": "verbs.files",
    "read_table": "verbs.files",
    "report": "verbs.files",
    "repetitive": "design.repetitive",
    "resonator": "data.shorthand",
    "schedule": "verbs.possible",
    "shape": "verbs.chain",
    "simulate": "loop.diagram_run",
    "stop": "verbs.stop",
    "to_control": "data.control_frd",
    "tones": "verbs.tones",
    "tracking_error": "verbs.tracking",
    "transfer": "data.algebra.diagram",
    "tune": "verbs.chain",
    "two_sensors": "data.common_diagrams",
    "write": "verbs.files",
    "write_plan": "verbs.plan",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'loopshape' has no attribute {name!r}")
    if name == "plot":
        return import_module("loopshape.view.plot")
    found = getattr(import_module(f"loopshape.{_HOME[name]}"), name)
    return _behind_gate(found) if isinstance(found, FunctionType) else found


@cache
def _behind_gate(function: Any) -> Any:
    from loopshape.core.gate import gated

    return gated(function)


def __dir__() -> list[str]:
    return sorted(__all__)
