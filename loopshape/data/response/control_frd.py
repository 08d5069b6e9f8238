"""FRFs to and from python-control: models are exact, its `FrequencyResponseData` knows no error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, angular, hz
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF, Hold

if TYPE_CHECKING:
    import control


def to_control(frf: FRF | Controller) -> control.FrequencyResponseData | control.StateSpace:
    """An FRF as an FRD: (outputs, inputs, frequencies), rad/s, named channels; a controller as a discrete system.

    The timebase is 1/rate_hz, as hold and sampling are in an FRF that was recorded at a rate; unspecified without one.
    Covariance and coherence stay here. A controller becomes its sections as they run, behind whole samples of delay;
    raises WrongUseError for a delay of parts of a sample and for an added hold, which are no discrete system.

    >>> import loopshape as ls
    >>> ls.to_control(ls.controller(ls.gain(2.0), ls.pi(1.0), rate_hz=1000.0)).dt
    0.001
    """
    import control

    if isinstance(frf, Controller):
        return control.StateSpace(*_state_space(frf), 1.0 / frf.rate_hz)
    dt = 1.0 / frf.rate_hz if frf.rate_hz > 0.0 else None
    return control.FrequencyResponseData(
        np.moveaxis(frf.response, 0, -1), angular(frf.frequency_hz), dt,
        inputs=list(frf.inputs), outputs=list(frf.outputs),
    )  # fmt: skip


def _state_space(C: Controller) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D of a controller's sections in series, each in direct form II transposed, and of its delay."""
    samples = C.computation_delay_s * C.rate_hz
    if C.added_hold or abs(samples - round(samples)) > 1e-6:
        raise WrongUseError(
            "a discrete system holds whole samples of delay and no hold",
            f"added_hold {C.added_hold}, {samples:g} samples",
            "leave added_hold out, and round computation_delay_s to the rate",
        )  # fmt: skip
    A, B, row, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    for b0, b1, b2, a1, a2 in [*C.biquads().tolist(), *[(0.0, 1.0, 0.0, 0.0, 0.0)] * round(samples)]:
        order = 2 if a2 or b2 else 1 if a1 or b1 else 0
        own = np.array([[-a1, 1.0], [-a2, 0.0]])[:order, :order]
        entry, out = np.array([[b1 - a1 * b0], [b2 - a2 * b0]])[:order], np.eye(1, order)
        A = np.block([[A, np.zeros((len(A), order))], [entry @ row, own]])
        B, row, D = np.vstack([B, entry @ D]), np.hstack([b0 * row, out]), b0 * D
    return A, B, row, D


def from_control(system: Any, frequency_hz: ArrayLike | None = None, **stated: Any) -> FRF:
    """The FRF of a python-control system.

    An FRD keeps its frequencies, and its error is stated: `covariance`, `std` or `relative_std` (0: exact). A
    `TransferFunction` or `StateSpace` is evaluated at `frequency_hz` (nf,) and is exact unless an error is stated; with
    a timebase its FRF has that rate, and contains the hold. `stated` are keywords of `FRF.from_arrays`.

    Raises WrongUseError for anything else, an FRD without an error, and a model without frequencies.

    Examples
    --------
    >>> import control, numpy as np, loopshape as ls
    >>> P = ls.FRF.from_control(control.tf([1.0], [1.0, 1.0]), np.geomspace(0.01, 10.0, 50), rate_hz=1000.0)
    >>> print(abs(P.siso[0]).round(3))
    0.998
    """
    names = ("frdata", "omega", "input_labels", "output_labels", "dt")
    if all(hasattr(system, name) for name in names):
        f, H = hz(1.0) * np.asarray(system.omega, dtype=float), np.moveaxis(system.frdata, -1, 0)
    elif hasattr(system, "frequency_response"):
        if frequency_hz is None:
            raise WrongUseError("a model has a response at any frequency", "none was asked", "give frequency_hz")
        f = real_array(frequency_hz, "frequency_hz of a model's response", ndim=1)
        H = np.moveaxis(np.asarray(system.frequency_response(angular(f), squeeze=False).frdata), -1, 0)
        if not {"std", "relative_std", "covariance"} & set(stated):
            stated["relative_std"] = 0.0
    else:
        raise WrongUseError(
            "only frequency response data and systems of python-control become an FRF",
            type(system).__name__,
            "use control.frd, control.tf or control.ss first",
        )
    rate_hz = 1.0 / system.dt if isinstance(system.dt, float) and system.dt > 0.0 else 0.0
    own: dict[str, Any] = {
        "inputs": tuple(system.input_labels),
        "outputs": tuple(system.output_labels),
        "rate_hz": rate_hz,
        "hold": Hold.INCLUDED if rate_hz else Hold.UNKNOWN,
    }
    words: dict[str, Any] = {"method": "from python-control"} | own | stated
    return FRF.from_arrays(f, H, **words)
