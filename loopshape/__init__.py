"""loopshape: from closed-loop recordings of a motion system to a tuned, checked controller.

    import loopshape as ls

    P = ls.frf(ls.Run.from_arrays(u=u, y=y, excitation=n, rate_hz=1000.0))
    R = ls.Requirements(phase_margin_deg=45, sensitivity_peak_db=6, unstable_poles=0)
    C = ls.tune(P, R, [ls.gain(), ls.lead_lag(), ls.notch()])
    v = ls.check(P, C, R)

Names are loaded when they are first used; `dir(loopshape)` lists them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from loopshape.data.control_frd import from_control as from_control
    from loopshape.data.control_frd import to_control as to_control
    from loopshape.data.controller import Controller as Controller
    from loopshape.data.frf import FRF as FRF
    from loopshape.data.model import Fit as Fit
    from loopshape.data.recording import Recording as Recording
    from loopshape.data.requirements import Margins as Margins
    from loopshape.data.requirements import Outcome as Outcome
    from loopshape.data.requirements import Requirements as Requirements
    from loopshape.data.requirements import Verdict as Verdict
    from loopshape.data.run import Run as Run
    from loopshape.data.shorthand import controller as controller
    from loopshape.data.shorthand import gain as gain
    from loopshape.data.shorthand import lead_lag as lead_lag
    from loopshape.data.shorthand import low_pass as low_pass
    from loopshape.data.shorthand import notch as notch
    from loopshape.data.shorthand import pi as pi
    from loopshape.design.tune import Tuning as Tuning
    from loopshape.verbs.chain import bound as bound
    from loopshape.verbs.chain import check as check
    from loopshape.verbs.chain import fit as fit
    from loopshape.verbs.chain import frf as frf
    from loopshape.verbs.chain import frfs as frfs
    from loopshape.verbs.chain import gap as gap
    from loopshape.verbs.chain import predict as predict
    from loopshape.verbs.chain import read as read
    from loopshape.verbs.chain import tune as tune
    from loopshape.view import plot as plot

__version__ = "0.1.0"

#: public name -> the module that holds it
_HOME = {
    "Controller": "data.controller",
    "FRF": "data.frf",
    "Fit": "data.model",
    "Margins": "data.requirements",
    "Outcome": "data.requirements",
    "Recording": "data.recording",
    "Requirements": "data.requirements",
    "Run": "data.run",
    "Tuning": "design.tune",
    "Verdict": "data.requirements",
    "bound": "verbs.chain",
    "check": "verbs.chain",
    "controller": "data.shorthand",
    "fit": "verbs.chain",
    "frf": "verbs.chain",
    "frfs": "verbs.chain",
    "from_control": "data.control_frd",
    "gap": "verbs.chain",
    "gain": "data.shorthand",
    "lead_lag": "data.shorthand",
    "low_pass": "data.shorthand",
    "notch": "data.shorthand",
    "pi": "data.shorthand",
    "plot": "view",
    "predict": "verbs.chain",
    "read": "verbs.chain",
    "to_control": "data.control_frd",
    "tune": "verbs.chain",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'loopshape' has no attribute {name!r}")
    module = import_module(f"loopshape.{_HOME[name]}")
    return import_module("loopshape.view.plot") if name == "plot" else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
