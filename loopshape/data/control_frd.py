"""FRFs to and from python-control's `FrequencyResponseData`, which knows no error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import ComplexArray, angular, hz
from loopshape.data.frf import FRF
from loopshape.io.frf_foreign import ForeignFRF, Stated, frf_of

if TYPE_CHECKING:
    import control


def to_control(frf: FRF) -> control.FrequencyResponseData:
    """The response as an FRD: (outputs, inputs, lines), rad/s, named channels; covariance and coherence stay behind.

    Its timebase is 1/rate_hz, as hold and sampling are in a FRF that was recorded at a rate; unspecified without one.
    """
    import control

    dt = 1.0 / frf.rate_hz if frf.rate_hz > 0.0 else None
    return control.FrequencyResponseData(
        np.moveaxis(frf.response, 0, -1), angular(frf.frequency_hz), dt,
        inputs=list(frf.inputs), outputs=list(frf.outputs),
    )  # fmt: skip


def from_control(
    frd: Any, *, covariance: ComplexArray | None = None, relative_std: float | None = None, **words: Any
) -> FRF:
    """The FRF of an FRD, whose error is stated: a covariance (nf, n, n), or `relative_std` (0 for a model's response).

    `words` are those of `Stated`: inputs, outputs (default: the FRD's labels), recording, loop, rate_hz (default 1/dt).
    """
    if not all(hasattr(frd, name) for name in ("frdata", "omega", "input_labels", "output_labels", "dt")):
        raise WrongUseError("only frequency response data become a FRF", type(frd).__name__, "use control.frd first")
    rate_hz = 1.0 / frd.dt if isinstance(frd.dt, float) and frd.dt > 0.0 else 0.0
    own = {"inputs": list(frd.input_labels), "outputs": list(frd.output_labels), "rate_hz": rate_hz}
    arrays = {} if covariance is None else {"covariance": np.asarray(covariance)}
    found = ForeignFRF(
        "an FRD", hz(1.0) * np.asarray(frd.omega, dtype=float),
        np.array(np.moveaxis(frd.frdata, -1, 0), dtype=complex), arrays, own | {"method": "from python-control"},
    )  # fmt: skip
    return frf_of(found, Stated(relative_std=relative_std, **words))
