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
    from loopshape.data.algebra.sampling import multirate as multirate
    from loopshape.data.control.controller import Controller as Controller
    from loopshape.data.control.fixed import fixed as fixed
    from loopshape.data.control.gain_scheduled import GainScheduled as GainScheduled
    from loopshape.data.control.gain_scheduled import gain_scheduled as gain_scheduled
    from loopshape.data.control.shorthand import biquad as biquad
    from loopshape.data.control.shorthand import complex_lead as complex_lead
    from loopshape.data.control.shorthand import controller as controller
    from loopshape.data.control.shorthand import gain as gain
    from loopshape.data.control.shorthand import lead_lag as lead_lag
    from loopshape.data.control.shorthand import low_pass as low_pass
    from loopshape.data.control.shorthand import notch as notch
    from loopshape.data.control.shorthand import pi as pi
    from loopshape.data.control.shorthand import pid as pid
    from loopshape.data.control.shorthand import resonator as resonator
    from loopshape.data.requirement.limits_over import AtPoints as AtPoints
    from loopshape.data.requirement.limits_over import Mask as Mask
    from loopshape.data.requirement.objective import Objective as Objective
    from loopshape.data.requirement.requirements import Margins as Margins
    from loopshape.data.requirement.requirements import Requirements as Requirements
    from loopshape.data.requirement.requirements import SeveralRequirements as SeveralRequirements
    from loopshape.data.requirement.weight import Weight as Weight
    from loopshape.data.response.control_frd import from_control as from_control
    from loopshape.data.response.control_frd import to_control as to_control
    from loopshape.data.response.frf import FRF as FRF
    from loopshape.data.response.interaction import Interaction as Interaction
    from loopshape.data.response.model import Fit as Fit
    from loopshape.data.result.prediction import Comparison as Comparison
    from loopshape.data.result.prediction import Prediction as Prediction
    from loopshape.data.result.verdict import Outcome as Outcome
    from loopshape.data.result.verdict import Verdict as Verdict
    from loopshape.data.signal.disturbance import Disturbance as Disturbance
    from loopshape.data.signal.recording import Recording as Recording
    from loopshape.data.signal.run import Run as Run
    from loopshape.design.decoupling.decouple import decouple as decouple
    from loopshape.design.decoupling.decoupled import decoupled as decoupled
    from loopshape.design.tune import Tuning as Tuning
    from loopshape.toolbox.campaign.verbs import campaign as campaign
    from loopshape.toolbox.diagrams.common_diagrams import cascade as cascade
    from loopshape.toolbox.diagrams.common_diagrams import disturbance_observer as disturbance_observer
    from loopshape.toolbox.diagrams.common_diagrams import dual_stage as dual_stage
    from loopshape.toolbox.diagrams.common_diagrams import prefilter as prefilter
    from loopshape.toolbox.diagrams.common_diagrams import two_sensors as two_sensors
    from loopshape.toolbox.diagrams.diagram import Diagram as Diagram
    from loopshape.toolbox.diagrams.diagram import Part as Part
    from loopshape.toolbox.diagrams.diagram_run import simulate as simulate
    from loopshape.toolbox.diagrams.equivalent import Equivalent as Equivalent
    from loopshape.toolbox.diagrams.equivalent import equivalent as equivalent
    from loopshape.toolbox.diagrams.transfer import transfer as transfer
    from loopshape.toolbox.diagrams.wired import Wired as Wired
    from loopshape.toolbox.formats.verbs import export as export
    from loopshape.toolbox.formats.verbs import read_frf as read_frf
    from loopshape.toolbox.formats.verbs import read_table as read_table
    from loopshape.toolbox.gap.nouns.axis import axis as axis
    from loopshape.toolbox.gap.nouns.gap_report import GapReport as GapReport
    from loopshape.toolbox.gap.nouns.machine import Input as Input
    from loopshape.toolbox.gap.nouns.machine import Model as Model
    from loopshape.toolbox.gap.nouns.machine import ModelParameter as ModelParameter
    from loopshape.toolbox.gap.nouns.machine import Output as Output
    from loopshape.toolbox.gap.nouns.machine import Port as Port
    from loopshape.toolbox.gap.verbs import gap as gap
    from loopshape.toolbox.gap.verbs import identifiability as identifiability
    from loopshape.toolbox.learning.feedforward import feedforward as feedforward
    from loopshape.toolbox.learning.learning import learning as learning
    from loopshape.toolbox.learning.next_trial import next_trial as next_trial
    from loopshape.toolbox.learning.repetitive import repetitive as repetitive
    from loopshape.toolbox.learning.verbs import tracking_error as tracking_error
    from loopshape.toolbox.limits.bound import Bound as Bound
    from loopshape.toolbox.limits.verbs import bound as bound
    from loopshape.toolbox.limits.verbs import reach as reach
    from loopshape.toolbox.limits.verbs import schedule as schedule
    from loopshape.toolbox.planning.tone.verbs import tones as tones
    from loopshape.toolbox.planning.verbs import plan as plan
    from loopshape.toolbox.planning.verbs import write_plan as write_plan
    from loopshape.toolbox.rig.study import Study as Study
    from loopshape.toolbox.rig.verbs.machine import connect as connect
    from loopshape.toolbox.rig.verbs.machine import emulator as emulator
    from loopshape.toolbox.rig.verbs.machine import measure as measure
    from loopshape.toolbox.rig.verbs.stop import stop as stop
    from loopshape.verbs.chain import check as check
    from loopshape.verbs.chain import compare as compare
    from loopshape.verbs.chain import fit as fit
    from loopshape.verbs.chain import frf as frf
    from loopshape.verbs.chain import frfs as frfs
    from loopshape.verbs.chain import predict as predict
    from loopshape.verbs.chain import shape as shape
    from loopshape.verbs.chain import tune as tune
    from loopshape.verbs.files import profiles as profiles
    from loopshape.verbs.files import read as read
    from loopshape.verbs.files import read_controllers as read_controllers
    from loopshape.verbs.files import read_gain_scheduled as read_gain_scheduled
    from loopshape.verbs.files import read_requirements as read_requirements
    from loopshape.verbs.files import report as report
    from loopshape.verbs.files import write as write
    from loopshape.verbs.several import frf_matrices as frf_matrices
    from loopshape.verbs.several import interaction as interaction
    from loopshape.view import plot as plot

__version__ = "0.1.0"

#: public name -> the module that holds it
_HOME = {
    "AtPoints": "data.requirement.limits_over",
    "Comparison": "data.result.prediction",
    "Controller": "data.control.controller",
    "Disturbance": "data.signal.disturbance",
    "FRF": "data.response.frf",
    "Fit": "data.response.model",
    "GainScheduled": "data.control.gain_scheduled",
    "Interaction": "data.response.interaction",
    "LoopshapeError": "core.errors",
    "Margins": "data.requirement.requirements",
    "Mask": "data.requirement.limits_over",
    "Objective": "data.requirement.objective",
    "Outcome": "data.result.verdict",
    "Prediction": "data.result.prediction",
    "Recording": "data.signal.recording",
    "Requirements": "data.requirement.requirements",
    "Run": "data.signal.run",
    "SeveralRequirements": "data.requirement.requirements",
    "Tuning": "design.tune",
    "Verdict": "data.result.verdict",
    "Weight": "data.requirement.weight",
    "biquad": "data.control.shorthand",
    "check": "verbs.chain",
    "compare": "verbs.chain",
    "complex_lead": "data.control.shorthand",
    "controller": "data.control.shorthand",
    "decouple": "design.decoupling.decouple",
    "decoupled": "design.decoupling.decoupled",
    "fit": "verbs.chain",
    "fixed": "data.control.fixed",
    "frf": "verbs.chain",
    "frf_matrices": "verbs.several",
    "frfs": "verbs.chain",
    "from_control": "data.response.control_frd",
    "gain": "data.control.shorthand",
    "gain_scheduled": "data.control.gain_scheduled",
    "interaction": "verbs.several",
    "lead_lag": "data.control.shorthand",
    "low_pass": "data.control.shorthand",
    "multirate": "data.algebra.sampling",
    "notch": "data.control.shorthand",
    "pi": "data.control.shorthand",
    "pid": "data.control.shorthand",
    "plot": "view",
    "predict": "verbs.chain",
    "profiles": "verbs.files",
    "read": "verbs.files",
    "read_controllers": "verbs.files",
    "read_gain_scheduled": "verbs.files",
    "read_requirements": "verbs.files",
    "report": "verbs.files",
    "resonator": "data.control.shorthand",
    "shape": "verbs.chain",
    "to_control": "data.response.control_frd",
    "tune": "verbs.chain",
    "write": "verbs.files",
}


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return __dir__()
    if name.startswith("_"):
        raise AttributeError(f"module 'loopshape' has no attribute {name!r}")
    if name == "plot":
        return import_module("loopshape.view.plot")
    home = f"loopshape.{_HOME[name]}" if name in _HOME else _of_toolboxes().get(name)
    if home is None:
        raise AttributeError(f"module 'loopshape' has no attribute {name!r}")
    found = getattr(import_module(home), name)
    return _behind_gate(found) if isinstance(found, FunctionType) else found


@cache
def _behind_gate(function: Any) -> Any:
    from loopshape.core.gate import gated

    return gated(function)


def _of_toolboxes() -> dict[str, str]:
    from loopshape.core.toolboxes import found

    return found().names


def __dir__() -> list[str]:
    return sorted(["__version__", *_HOME, *_of_toolboxes()])
