"""A frequency response that says how sure it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from hashlib import sha256
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError, refuse_unknown, refuse_unknown_keys
from loopshape.core.gate import gated, pass_fields
from loopshape.core.units import Array, ComplexArray
from loopshape.data.arrays import number, rate
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf_arrays import NEEDED, lines_of, passed, stated_arrays

if TYPE_CHECKING:
    from loopshape.data.algebra import ClosedLoop

_ARRAYS = (
    "frequency_hz",
    "response",
    "covariance",
    "coherence",
    "input_power",
    "output_power",
    "cross_power",
    "noise_covariance",
    "multiple_coherence",
    "partial_coherence",
)


def joined(names: Sequence[str]) -> str:
    """Several recordings in short: both of two, else the first and how many more."""
    return "+".join(names) if len(names) <= 2 else f"{names[0]}+{len(names) - 1}more"


class Hold(StrEnum):
    """Whether a response is known to contain the zero-order hold of its rate: then it is multiplied in nowhere else."""

    UNKNOWN = "unknown"
    INCLUDED = "included"


@dataclass(frozen=True, eq=False)
class FRF:
    """Response (nf, ny, nu) on `frequency_hz` (nf,), frequency first; SISO is 1 x 1, never squeezed.

    `covariance` (nf, ny nu, ny nu) is E[d d^H] of d = vec(response) with columns stacked, for a circular
    error: the standard deviation of the real part alone is sqrt(diag/2). `coherence` (nf,), `input_power`,
    `output_power` and `cross_power` (nf,) are those of the loop's own input and output, per Hz or per line
    of a periodic record as `power_per` says; None where there is none. `valid` (nf,) marks lines fit for
    use. `line_overlap` is the number of lines that carry one line's worth of independent error (1 for
    periods, 1.94 for Hann segments), `variance_freedom` the degrees of freedom of each line's variance, which
    `variance_pooled` neighbouring lines share.
    `noise_covariance`, shaped as `covariance`, is the part that noise leaves; the rest is what a nonlinear plant
    answers differently to each draw of the excitation. None where one cannot be told from the other.
    `multiple_coherence` (nf, ny) and `partial_coherence` (nf, ny, nu) are those of several inputs; `averages` is the
    effective number of averages behind them, without which a coherence says nothing (it is biased by inputs/averages).
    `recording` names what it was measured from, in short; where that was several, `recordings` names all.
    `parameters` are settings of the rig that held for this recording alone; `recorded_under` is the controller under
    which the loop stood, where it is known; `open_loop` says that the recordings were made without feedback, so that
    a plant whose output stayed bounded has no unstable pole; `hold` says whether it is known to contain the zero-order
    hold. `method` says in one line how it was measured, `method_numbers` are the numbers in it by name, from which
    `view.labels.method_in_short` puts many methods into one line; `notes` are warnings.
    """

    frequency_hz: Array
    response: ComplexArray
    covariance: ComplexArray
    valid: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    method: str
    recording: str = ""
    loop: str = ""
    rate_hz: float = 0.0
    operating_point: Mapping[str, float] = field(default_factory=dict)
    coherence: Array | None = None
    input_power: Array | None = None
    output_power: Array | None = None
    cross_power: ComplexArray | None = None
    power_per: str = "Hz"
    line_overlap: float = 1.0
    variance_freedom: float = float("inf")
    variance_pooled: int = 1
    parameters: Mapping[str, float] = field(default_factory=dict)
    recorded_under: Controller | None = None
    notes: tuple[str, ...] = ()
    noise_covariance: ComplexArray | None = None
    multiple_coherence: Array | None = None
    partial_coherence: Array | None = None
    averages: float = float("nan")
    recordings: tuple[str, ...] = ()
    open_loop: bool = False
    hold: Hold = Hold.UNKNOWN
    method_numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._pass_arrays()
        nf, ny, nu = self.frequency_hz.size, len(self.outputs), len(self.inputs)
        if np.shape(self.response) != (nf, ny, nu):
            raise WrongUseError("a response is (frequencies, outputs, inputs)", f"{np.shape(self.response)}")
        if np.shape(self.covariance) != (nf, ny * nu, ny * nu):
            raise WrongUseError("a covariance is (frequencies, outputs inputs, outputs inputs)")
        self._check_numbers()
        self._check_words()

    def _pass_arrays(self) -> None:
        """Copy the arrays, read-only; refuses what is no number and a response that is real."""
        for name in (*_ARRAYS, "valid"):
            value = getattr(self, name)
            if value is not None or name in NEEDED:
                copy = passed(name, value)
                copy.setflags(write=False)
                object.__setattr__(self, name, copy)
        pass_fields(self)
        for name in ("inputs", "outputs", "notes", "recordings"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    def _check_numbers(self) -> None:
        f, nf = self.frequency_hz, self.frequency_hz.size
        if f.ndim != 1 or not (nf > 0 and f[0] > 0.0 and np.all(np.diff(f) > 0.0)):
            raise WrongUseError("frequency_hz must be finite, positive and strictly increasing", f"{nf} lines")
        if np.any(np.real(np.einsum("fii->fi", self.covariance)) < 0.0):
            raise WrongUseError("the variances of an FRF are not negative")
        ny, nu = len(self.outputs), len(self.inputs)
        shapes: dict[str, tuple[int, ...]] = {name: (nf,) for name in ("valid", *_ARRAYS[3:7])}
        shapes |= {"noise_covariance": (nf, ny * nu, ny * nu)}
        shapes |= {"multiple_coherence": (nf, ny), "partial_coherence": (nf, ny, nu)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != shape:
                raise WrongUseError(f"{name} of an FRF has the shape {shape}", f"{np.shape(value)} for {nf} lines")

    def _check_words(self) -> None:
        if not number(self.line_overlap, "the line overlap of an FRF") >= 1.0:
            raise WrongUseError("the line overlap of an FRF is finite and 1 at least", f"{self.line_overlap!r}")
        if not self.variance_freedom > 0.0:
            raise WrongUseError(
                "the degrees of freedom of an FRF's variance must be positive", f"{self.variance_freedom!r}"
            )
        if not self.variance_pooled >= 1:
            raise WrongUseError("an FRF's variance is pooled over at least 1 frequency", f"{self.variance_pooled!r}")
        object.__setattr__(self, "rate_hz", rate(self.rate_hz, "the rate of an FRF", unknown=True))
        for name, value in self.operating_point.items():
            number(value, f"{name} of an FRF's operating point")
        refuse_unknown("what the powers of an FRF are per is not known", self.power_per, ("Hz", "line"))
        refuse_unknown("the hold of an FRF is not known", self.hold, Hold)
        object.__setattr__(self, "hold", Hold(self.hold))

    @classmethod
    @gated
    def from_arrays(
        cls,
        frequency_hz: ArrayLike | None = None,
        response: ArrayLike | None = None,
        *,
        omega_rad_s: ArrayLike | None = None,
        magnitude_db: ArrayLike | None = None,
        phase_deg: ArrayLike | None = None,
        std: ArrayLike | None = None,
        relative_std: float | None = None,
        covariance: ArrayLike | None = None,
        coherence: ArrayLike | None = None,
        averages: float | None = None,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        method: str = "from arrays",
        **words: Any,
    ) -> FRF:
        """An FRF from frequencies (nf,) in Hz and a response (nf,) or (nf, ny, nu), whose error is stated once.

        Frequencies may be `omega_rad_s` instead, and a response `magnitude_db` and `phase_deg`, wrapped or not.

        `std` is sqrt(E|d|²) of each value, `relative_std` the same share of |response| everywhere (0: exact, as a
        model's), `covariance` (nf, ny nu, ny nu) as in `FRF`; `coherence` (nf,) needs `averages`. The valid band
        follows from it. `words` are other fields of `FRF`: rate_hz (a controller is tuned at it), loop, recording,
        operating_point, open_loop, hold. A first frequency of 0 Hz is left out.

        Raises WrongUseError for shapes that do not fit, a real response (a magnitude is none: write H + 0j where it is
        one) and an error stated twice or not at all, BadSignalError for NaN and masked values.
        Misleads where the error that is stated is not that of the data: intervals and verdicts are as good as it.

        Examples
        --------
        >>> import numpy as np, loopshape as ls
        >>> f_hz = np.geomspace(0.5, 200.0, 100)
        >>> ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01, rate_hz=1000.0)
        FRF: 100 frequencies, 0.5 to 200 Hz, 1 output x 1 input, rate 1000 Hz
        """
        known = dict.fromkeys([*signature(cls.from_arrays).parameters][:-1] + [f.name for f in fields(cls)])
        refuse_unknown_keys("an FRF has no such field", words, known)
        arrays = stated_arrays(
            *lines_of(frequency_hz, omega_rad_s, response, magnitude_db, phase_deg),
            std=std, relative_std=relative_std, covariance=covariance, coherence=coherence, averages=averages,
        )  # fmt: skip
        ny, nu = arrays["response"].shape[1:]
        names: dict[str, Any] = {
            "inputs": inputs or tuple(f"u{k + 1}_1" for k in range(nu)),
            "outputs": outputs or tuple(f"y{k + 1}_1" for k in range(ny)),
        }
        return cls(**arrays, **names, method=method, **words)

    @classmethod
    @gated
    def from_control(cls, system: Any, frequency_hz: ArrayLike | None = None, **stated: Any) -> FRF:
        """The FRF of a python-control system: see `loopshape.from_control`, which this is."""
        from loopshape.data.response.control_frd import from_control

        return from_control(system, frequency_hz, **stated)

    def __repr__(self) -> str:
        """One line: what it is of, its frequencies, its valid band and its size."""
        of = " ".join(word for word in (self.loop, self.recording) if word)
        f, (low, high) = self.frequency_hz, self.valid_band_hz
        valid = "" if self.valid.all() else f" (valid band {low:.4g} to {high:.4g} Hz)"
        ny, nu = self.response.shape[1:]
        size = f"{ny} output{'s' * (ny > 1)} x {nu} input{'s' * (nu > 1)}"
        rate = f", rate {self.rate_hz:g} Hz" if self.rate_hz else ""
        return f"FRF{f' {of}' if of else ''}: {f.size} frequencies, {f[0]:.4g} to {f[-1]:.4g} Hz{valid}, {size}{rate}"

    __array_ufunc__ = None  # an array times an FRF is no array of FRFs

    def __mul__(self, other: FRF | Controller | complex) -> FRF:
        """P Q or P C, what stands on the right comes first (a controller as it runs), or P times a number."""
        return _series(self, other)

    def __rmul__(self, other: Controller | complex) -> FRF:
        return _series(other, self)

    def __add__(self, other: FRF) -> FRF:
        """P + Q, side by side."""
        from loopshape.data.algebra import add

        return add(self, other) if isinstance(other, FRF) else NotImplemented

    def __sub__(self, other: FRF) -> FRF:
        from loopshape.data.algebra import subtract

        return subtract(self, other) if isinstance(other, FRF) else NotImplemented

    def __neg__(self) -> FRF:
        return _series(-1.0, self)

    def feedback(self, K: FRF | Controller | Sequence[Controller]) -> ClosedLoop:
        """The closed loop of this plant and K with negative feedback: S, T, PS and KS, each with its covariance.

        Whether it is stable is for `ls.check` to say.

        >>> import loopshape as ls
        >>> P = ls.FRF.from_arrays([1.0, 2.0], [1.0 + 0j, 0.5], std=0.01)
        >>> P.feedback(ls.controller(ls.gain(1.0), rate_hz=100.0)).S_o.siso.round(3).tolist()
        [(0.5+0j), (0.667+0j)]
        """
        from loopshape.data.algebra import feedback

        return feedback(self, K)

    @property
    def digest(self) -> str:
        """A short mark of lines and response, by which a fit knows the FRF that it was made for."""
        data = np.ascontiguousarray(self.frequency_hz).tobytes() + np.ascontiguousarray(self.response).tobytes()
        return sha256(data).hexdigest()[:16]

    @property
    def siso(self) -> ComplexArray:
        """Response (nf,) of a 1 x 1 FRF; refuses a larger one."""
        if self.response.shape[1:] != (1, 1):
            raise WrongUseError(
                "one loop's response was requested from an FRF with several",
                f"{self.response.shape[1:]}",
                "pick an element",
            )
        return np.asarray(self.response[:, 0, 0])

    @property
    def variance(self) -> Array:
        """Variance E|d|² of each element, (nf, ny, nu)."""
        diagonal = np.real(np.einsum("fii->fi", self.covariance))
        return diagonal.reshape(len(diagonal), len(self.inputs), len(self.outputs)).transpose(0, 2, 1)

    @property
    def relative_std(self) -> Array:
        """sqrt(E|d|²)/|G| of each element, (nf, ny, nu)."""
        return np.asarray(np.sqrt(self.variance) / np.maximum(np.abs(self.response), 1e-300))

    @property
    def modulus_std(self) -> Array:
        """Relative std of |G|, which is that of its phase in rad, for a circular error: sqrt(E|d|²/2)/|G|, as above."""
        return np.asarray(np.sqrt(0.5 * self.variance) / np.maximum(np.abs(self.response), 1e-300))

    def select(self, lines: np.ndarray) -> FRF:
        """The same FRF on a mask or index of lines."""
        changes = {n: getattr(self, n)[lines] for n in (*_ARRAYS, "valid") if getattr(self, n) is not None}
        return replace(self, **changes)

    def between(self, f_low_hz: float, f_high_hz: float) -> FRF:
        """The lines in a closed band; refuses a band without lines."""
        mask = (self.frequency_hz >= f_low_hz) & (self.frequency_hz <= f_high_hz)
        if not mask.any():
            raise WrongUseError(
                "no frequency of the FRF lies in the band",
                f"{f_low_hz:g} to {f_high_hz:g} Hz",
                f"the frequencies go from {self.frequency_hz[0]:g} to {self.frequency_hz[-1]:g} Hz",
            )
        return self.select(mask)

    def valid_lines(self) -> FRF:
        """The valid lines; refuses an FRF without any."""
        if not self.valid.any():
            raise WrongUseError(
                f"no frequency of the FRF {self.loop} {self.recording} is valid".replace("  ", " "),
                self.method,
                "excite more, or measure longer",
            )
        return self.select(self.valid)

    @property
    def valid_band_hz(self) -> tuple[float, float]:
        """Lowest and highest valid line, (nan, nan) without any."""
        f = self.frequency_hz[self.valid]
        return (float(f[0]), float(f[-1])) if f.size else (float("nan"), float("nan"))

    def renewed(self, newer: FRF) -> FRF:
        """This FRF with the valid lines of a newer measurement of the same plant in place of its own in their band.

        For a band that is measured once more, finer or longer, as an undecided verdict orders it. The less certain of
        the two tells the degrees of freedom and how far lines depend on one another. Misleads where the plant changed
        between the two: compare them first (`loopshape compare`). Refuses other channels, rates and operating points.

        >>> import loopshape as ls
        >>> old = ls.FRF.from_arrays([1.0, 2.0, 3.0, 4.0], [1.0 + 0j, 0.5, 0.3, 0.2], std=0.1)
        >>> new = ls.FRF.from_arrays([2.0, 2.5, 3.0], [0.5 + 0j, 0.4, 0.3], std=0.01)
        >>> old.renewed(new).frequency_hz.tolist()
        [1.0, 2.0, 2.5, 3.0, 4.0]
        """
        for name in ("inputs", "outputs", "rate_hz", "operating_point", "parameters", "hold", "recorded_under"):
            if getattr(self, name) != getattr(newer, name):
                raise WrongUseError(
                    f"the two FRFs of loop {self.loop} differ in {name}: one does not renew the other",
                    f"{getattr(self, name)!s:.80} and {getattr(newer, name)!s:.80}",
                    "take FRFs of one plant at one operating point",
                )
        new = newer.valid_lines()
        f, (low, high) = self.frequency_hz, new.frequency_hz[[0, -1]]
        outside = (f < low * (1.0 - 1e-6)) | (f > high * (1.0 + 1e-6))  # the ends are lines of both
        if not outside.any():
            return new
        old = self.select(outside)
        order = np.argsort(np.concatenate([old.frequency_hz, new.frequency_hz]))
        alike = self.power_per == newer.power_per  # else powers of two kinds would stand in one array
        kept = [name for name in (*_ARRAYS, "valid") if alike or not name.endswith("_power")]
        pairs = {name: (getattr(old, name), getattr(new, name)) for name in kept}
        arrays: dict[str, Any] = {
            n: None if a is None or b is None else np.concatenate([a, b])[order] for n, (a, b) in pairs.items()
        }
        arrays |= {name: None for name in _ARRAYS if name not in kept}
        return replace(
            self,
            **arrays,
            method=f"{self.method}; renewed from {low:g} to {high:g} Hz: {newer.method}",
            line_overlap=max(self.line_overlap, newer.line_overlap),
            variance_freedom=min(self.variance_freedom, newer.variance_freedom),
            variance_pooled=max(self.variance_pooled, newer.variance_pooled),
            open_loop=self.open_loop and newer.open_loop,
            notes=tuple(dict.fromkeys([*self.notes, *newer.notes])),
        )


def _series(A: Any, B: Any) -> FRF:
    from loopshape.data.algebra.operations import series

    return series(A, B)
