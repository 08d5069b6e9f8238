"""FRFs to and from python-control: models are exact, its `FrequencyResponseData` knows no error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import angular, hz
from loopshape.data.frf import FRF, Hold

if TYPE_CHECKING:
    import control


def to_control(frf: FRF) -> control.FrequencyResponseData:
    """The response as an FRD: (outputs, inputs, frequencies), rad/s, named channels; covariance and coherence stay.

    Its timebase is 1/rate_hz, as hold and sampling are in a FRF that was recorded at a rate; unspecified without one.
    """
    import control

    dt = 1.0 / frf.rate_hz if frf.rate_hz > 0.0 else None
    return control.FrequencyResponseData(
        np.moveaxis(frf.response, 0, -1), angular(frf.frequency_hz), dt,
        inputs=list(frf.inputs), outputs=list(frf.outputs),
    )  # fmt: skip


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
        f = np.asarray(frequency_hz, dtype=float)
        H = np.moveaxis(np.asarray(system.frequency_response(angular(f), squeeze=False).frdata), -1, 0)
        if not {"std", "relative_std", "covariance"} & set(stated):
            stated["relative_std"] = 0.0
    else:
        raise WrongUseError(
            "only frequency response data and systems of python-control become a FRF",
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
