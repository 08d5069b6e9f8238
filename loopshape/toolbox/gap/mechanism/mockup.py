"""An FMU for model exchange (FMI 2 or 3) as a user's machine: its derivatives are called from compiled code.

The standard's functions are reached through their addresses, so that a step costs a call and no Python. An instance
belongs to one thread: each has its own, set up anew (reset, parameters, initialisation) for every set of parameters.
Modelica Association, Functional Mock-up Interface 2.0 (2014) and 3.0 (2022).
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.toolbox.gap.nouns.machine import Model, Unit

_OK = 1  # highest status that is no failure: a warning
_lock = threading.Lock()  # FMPy changes the working directory while it loads a library


def machine_of(unit: Unit) -> Model:
    """The FMU as a model; refuses one without model exchange, with events, or without the variables that are named."""
    d = unit.description
    _suitable(unit)
    states = tuple(u.variable.derivative.name for u in d.derivatives)
    own = [p.name for p in unit.parameters], [i.name for i in unit.inputs]
    references = [_references(unit, what, names) for what, names in zip(("parameter", "input"), own, strict=True)]
    instances = Instances(unit, *references)
    return Model(
        name=unit.name, motion=instances.motion(len(states)), states=states, parameters=unit.parameters,
        inputs=unit.inputs, outputs=unit.outputs, ports=unit.ports, window_s=unit.window_s, without=unit.without,
        derived=instances.at, matters=unit.matters,
    )  # fmt: skip


def _references(unit: Unit, what: str, names: list[str]) -> list[int]:
    """Value references of variables; refuses names that the FMU does not have."""
    known = {v.name: v for v in unit.description.modelVariables}
    for name in names:
        if name not in known:
            own = ", ".join(n for n, v in known.items() if v.causality == what)
            raise WrongUseError(f"{what}s of {unit.name} are the FMU's", f"{name!r}", f"it has {own}")
    return [known[name].valueReference for name in names]


def _suitable(unit: Unit) -> None:
    """Refuse what cannot be followed in short windows."""
    d, way = unit.description, "export it for model exchange, with continuous states alone"
    if d.modelExchange is None:
        raise WrongUseError(f"the FMU of {unit.name} gives derivatives (model exchange)", "co-simulation alone", way)
    if d.modelExchange.canBeInstantiatedOnlyOncePerProcess:
        raise WrongUseError(f"the FMU of {unit.name} runs several times at once", "once per process", way)
    if d.numberOfEventIndicators:
        raise WrongUseError(
            f"the FMU of {unit.name} has no events: effects that switch are added around it",
            f"{d.numberOfEventIndicators} event indicators", way,
        )  # fmt: skip
    if not d.derivatives:
        raise WrongUseError(f"the FMU of {unit.name} has continuous states", "none", way)


class Instances:
    """One instance a thread, and the addresses of the functions that a step needs."""

    def __init__(self, unit: Unit, parameters: list[int], inputs: list[int]) -> None:
        self.unit, self.parameters, self.inputs = unit, parameters, np.array(inputs, dtype=np.uint32)
        self.version = 3 if unit.description.fmiVersion.startswith("3") else 2
        self.own: dict[int, Any] = {}

    def at(self, values: tuple[float, ...]) -> tuple[int, np.ndarray]:
        """This thread's instance with these parameters, initialised: its address, and references of the inputs."""
        fmu = self._mine()
        fmu.reset()
        if self.version == 3:
            fmu.setFloat64(self.parameters, list(values))
            fmu.enterInitializationMode(startTime=0.0)
        else:
            fmu.setupExperiment(startTime=0.0)
            fmu.setReal(self.parameters, list(values))
            fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        self._settled(fmu)
        fmu.enterContinuousTimeMode()
        return _address(fmu.component), self.inputs

    def _settled(self, fmu: Any) -> None:
        """Discrete states updated until nothing changes."""
        for _ in range(100):
            again = fmu.updateDiscreteStates()[0] if self.version == 3 else fmu.newDiscreteStates()[0]
            if not again:
                return
        raise BadSignalError(
            f"the FMU of {self.unit.name} does not settle at the start", "100 updates", "export it anew"
        )

    def _mine(self) -> Any:
        """This thread's instance; idents of threads that ended are given anew, and so are their instances."""
        key = threading.get_ident()
        with _lock:
            if key not in self.own:
                self.own[key] = self._instantiated()
        return self.own[key]

    def _instantiated(self) -> Any:
        from fmpy.fmi2 import FMU2Model
        from fmpy.fmi3 import FMU3Model

        d = self.unit.description
        try:
            fmu = (FMU3Model if self.version == 3 else FMU2Model)(
                guid=d.guid, modelIdentifier=d.modelExchange.modelIdentifier, unzipDirectory=self.unit.folder,
                instanceName=self.unit.name,
            )  # fmt: skip
            fmu.instantiate()
        except Exception as error:  # FMPy raises plain exceptions
            raise WrongUseError(
                f"the FMU of {self.unit.name} runs on this system", str(error), "export it for this platform"
            ) from error
        return fmu

    def motion(self, nx: int) -> Callable[..., Any]:
        """The right-hand side: t, states, inputs and what `at` gave, to the derivatives (nx,); nan on failure."""
        library = self._mine().dll
        own: Mapping[str, tuple[type, ...]] = _FMI3 if self.version == 3 else _FMI2
        set_time, set_states, set_inputs, derivatives = (_function(library, n, kinds) for n, kinds in own.items())
        if self.version == 3:

            def motion3(t, x, u, p):  # type: ignore[no-untyped-def]
                out = np.full(nx, np.nan)
                bad = set_time(p[0], t) > _OK or set_states(p[0], x.ctypes, nx) > _OK
                if not bad and set_inputs(p[0], p[1].ctypes, u.size, u.ctypes, u.size) <= _OK:
                    derivatives(p[0], out.ctypes, nx)
                return out

            return motion3

        def motion2(t, x, u, p):  # type: ignore[no-untyped-def]
            out = np.full(nx, np.nan)
            bad = set_time(p[0], t) > _OK or set_states(p[0], x.ctypes, nx) > _OK
            if not bad and set_inputs(p[0], p[1].ctypes, u.size, u.ctypes) <= _OK:
                derivatives(p[0], out.ctypes, nx)
            return out

        return motion2


_HANDLE, _ARRAY, _SIZE = ctypes.c_int64, ctypes.c_void_p, ctypes.c_size_t
_FMI2 = {
    "fmi2SetTime": (_HANDLE, ctypes.c_double), "fmi2SetContinuousStates": (_HANDLE, _ARRAY, _SIZE),
    "fmi2SetReal": (_HANDLE, _ARRAY, _SIZE, _ARRAY), "fmi2GetDerivatives": (_HANDLE, _ARRAY, _SIZE),
}  # fmt: skip
_FMI3 = {
    "fmi3SetTime": (_HANDLE, ctypes.c_double), "fmi3SetContinuousStates": (_HANDLE, _ARRAY, _SIZE),
    "fmi3SetFloat64": (_HANDLE, _ARRAY, _SIZE, _ARRAY, _SIZE),
    "fmi3GetContinuousStateDerivatives": (_HANDLE, _ARRAY, _SIZE),
}  # fmt: skip


def _function(library: Any, name: str, kinds: tuple[type, ...]) -> Any:
    """A C function of a library that gives a status, with handles as integers and arrays as bare addresses."""
    return ctypes.CFUNCTYPE(ctypes.c_int, *kinds)(_address(ctypes.cast(getattr(library, name), ctypes.c_void_p)))


def _address(pointer: Any) -> int:
    """A C pointer as an integer."""
    return int(getattr(pointer, "value", pointer))
