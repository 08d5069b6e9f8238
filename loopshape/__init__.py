"""loopshape: from closed-loop recordings of a motion system to a tuned, checked controller.

    import loopshape as ls

    P = ls.frf(ls.Run.from_arrays(u=u, y=y, excitation=n, rate_hz=1000.0))
    R = ls.Requirements(phase_margin_deg=45, sensitivity_peak_db=6, unstable_poles=0)
    C = ls.tune(P, R, [ls.gain(), ls.lead_lag(), ls.notch()])
    v = ls.check(P, C, R)

Names are loaded when they are first used; `dir(loopshape)` lists them. What stands beside this bench is found by its
toolbox: `ls.rig.measure`, `ls.diagrams.cascade`, `ls.gap(run)`, which is `ls.gap.gap`, and `ls.report` of the pages.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from loopshape.core import errors as errors
    from loopshape.core.errors import LoopshapeError as LoopshapeError
    from loopshape.core.outcomes import Outcome as Outcome
    from loopshape.data.control.controller import Controller as Controller
    from loopshape.data.control.fixed import fixed as fixed
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
    from loopshape.data.requirement.requirements import Requirements as Requirements
    from loopshape.data.requirement.weight import Objective as Objective
    from loopshape.data.requirement.weight import Weight as Weight
    from loopshape.data.response.control_frd import from_control as from_control
    from loopshape.data.response.control_frd import to_control as to_control
    from loopshape.data.response.frf import FRF as FRF
    from loopshape.data.response.model import Fit as Fit
    from loopshape.data.result.margins import Margins as Margins
    from loopshape.data.result.verdict import Verdict as Verdict
    from loopshape.data.signal.disturbance import Disturbance as Disturbance
    from loopshape.data.signal.recording import Recording as Recording
    from loopshape.data.signal.run import Run as Run
    from loopshape.design.tune import Tuning as Tuning
    from loopshape.loop.loop import Loop as Loop
    from loopshape.toolbox import diagrams as diagrams
    from loopshape.toolbox import formats as formats
    from loopshape.toolbox import limits as limits
    from loopshape.toolbox import planning as planning
    from loopshape.toolbox import rig as rig
    from loopshape.toolbox import schedules as schedules
    from loopshape.toolbox.diagrams.coupling.interaction import interaction as interaction
    from loopshape.toolbox.pages.verbs import report as report
    from loopshape.toolbox.pages.verbs import shape as shape
    from loopshape.toolbox.validation.predicted.nouns import Prediction as Prediction
    from loopshape.toolbox.validation.predicted.verbs import predict as predict
    from loopshape.toolbox.validation.verbs import compare as compare
    from loopshape.verbs.chain import check as check
    from loopshape.verbs.chain import fit as fit
    from loopshape.verbs.chain import frf as frf
    from loopshape.verbs.chain import frfs as frfs
    from loopshape.verbs.chain import tune as tune
    from loopshape.verbs.estimates import estimate as estimate
    from loopshape.verbs.estimates import frf_matrices as frf_matrices
    from loopshape.verbs.files import profiles as profiles
    from loopshape.verbs.files import read as read
    from loopshape.verbs.files import read_controllers as read_controllers
    from loopshape.verbs.files import read_requirements as read_requirements
    from loopshape.verbs.files import write as write
    from loopshape.view.plot import plot as plot

    gap: Any  # these three are called, too
    campaign: Any
    learning: Any

__version__ = "0.1.0"

#: public name -> the module that holds it
_HOME = {
    "AtPoints": "data.requirement.limits_over",
    "Controller": "data.control.controller",
    "Disturbance": "data.signal.disturbance",
    "FRF": "data.response.frf",
    "Fit": "data.response.model",
    "Loop": "loop.loop",
    "LoopshapeError": "core.errors",
    "Margins": "data.result.margins",
    "Mask": "data.requirement.limits_over",
    "Objective": "data.requirement.weight",
    "Outcome": "core.outcomes",
    "Recording": "data.signal.recording",
    "Requirements": "data.requirement.requirements",
    "Run": "data.signal.run",
    "Tuning": "design.tune",
    "Verdict": "data.result.verdict",
    "Weight": "data.requirement.weight",
    "biquad": "data.control.shorthand",
    "check": "verbs.chain",
    "complex_lead": "data.control.shorthand",
    "controller": "data.control.shorthand",
    "estimate": "verbs.estimates",
    "fit": "verbs.chain",
    "fixed": "data.control.fixed",
    "frf": "verbs.chain",
    "frf_matrices": "verbs.estimates",
    "frfs": "verbs.chain",
    "from_control": "data.response.control_frd",
    "gain": "data.control.shorthand",
    "lead_lag": "data.control.shorthand",
    "low_pass": "data.control.shorthand",
    "notch": "data.control.shorthand",
    "pi": "data.control.shorthand",
    "pid": "data.control.shorthand",
    "plot": "view.plot",
    "profiles": "verbs.files",
    "read": "verbs.files",
    "read_controllers": "verbs.files",
    "read_requirements": "verbs.files",
    "resonator": "data.control.shorthand",
    "to_control": "data.response.control_frd",
    "tune": "verbs.chain",
    "write": "verbs.files",
}
#: the kinds of LoopshapeError, `ls.errors.<name>`
_KINDS = ("BadSignalError", "RigError", "UnreadableInputError", "WrongUseError")
_ERRORS = dict.fromkeys(_KINDS, "loopshape.core.errors")


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return __dir__()
    if name.startswith("_"):
        raise AttributeError(f"module 'loopshape' has no attribute {name!r}")
    if name in _HOME:
        return _public(f"loopshape.{_HOME[name]}", name, f"ls.{name}")
    boxes = _toolboxes()
    if name in boxes:
        return boxes[name]
    if name in (verbs := _verbs()):
        return _public(verbs[name], name, f"ls.{name}")
    there = [f"loopshape.{box}.{name}" for box, names in boxes.items() if name in dir(names)]
    from loopshape.core.errors import meant

    hint = f"there is {', '.join(there)}" if there else meant(name, __dir__()).strip()
    raise AttributeError(f"module 'loopshape' has no attribute {name!r}{'; ' * bool(hint)}{hint}")


def _verbs() -> dict[str, str]:
    """Public names that toolboxes add to the bench's own, and their modules."""
    from loopshape.core.toolboxes import found

    return found().all("verbs")


def _public(home: str, name: str, public: str) -> Any:
    """What stands in a module under a name; a function behind the gate of its arguments."""
    found = getattr(import_module(home), name)
    if isinstance(found, FunctionType):
        return _behind_gate(found, public)
    from loopshape.core.gate import with_sentences

    kind = found if isinstance(found, type) else type(found)
    if kind.__module__.startswith("loopshape."):
        with_sentences(kind, public)
    return found


@cache
def _behind_gate(function: Any, public: str) -> Any:
    from loopshape.core.gate import gated

    return gated(function, public)


class _Names:
    """The names of a toolbox, loaded when they are used."""

    def __init__(self, name: str, purpose: str, homes: Mapping[str, str]) -> None:
        self.__name__, self.__doc__, self._key, self.__homes = f"loopshape.{name}", purpose, name, homes

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # before its fields are there, too: copies and pickles ask
            raise AttributeError(name)
        if name not in self.__homes:
            raise AttributeError(f"{self.__name__} has no {name!r}: it has {', '.join(dir(self))}")
        return _public(self.__homes[name], name, f"ls.{self._key}.{name}")

    def __dir__(self) -> list[str]:
        return sorted(self.__homes)

    def __repr__(self) -> str:
        return f"{self.__name__}: {', '.join(dir(self))}"

    def __reduce__(self) -> tuple[Any, ...]:
        return _toolbox, (self._key,)


class _Verb(_Names):
    """A toolbox with a verb of its own name: called, it does what that does."""

    def __init__(self, name: str, purpose: str, homes: Mapping[str, str]) -> None:
        super().__init__(name, f"{purpose}.\n\nCalled, it is `{name}.{name}`.", homes)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return getattr(self, self._key)(*arguments, **named)

    @property
    def __signature__(self) -> Any:
        from inspect import signature

        return signature(getattr(self, self._key))


def _toolbox(name: str) -> _Names:
    return _toolboxes()[name]


@cache
def _toolboxes() -> dict[str, _Names]:
    from loopshape.core.toolboxes import found

    boxes = {key: one for key, one in found().toolboxes.items() if one.names}
    made = {key: (_Verb if key in one.names else _Names)(key, one.purpose, one.names) for key, one in boxes.items()}
    return made | {"errors": _Names("errors", "Kinds of LoopshapeError", _ERRORS)}


def __dir__() -> list[str]:
    return sorted({"__version__", *_HOME, *_verbs(), *_toolboxes()})
