"""Steps of a closed loop as it runs, from a model or from measured lines, by the inverse transform of T.

**Which discrete loop.** A plant measured from logged z to sampled y contains the hold, the sampler and the computation:
its FRF up to half the rate is the sampled plant's whole response, and a fit of it describes that response, not a
continuous plant behind a hold. A zero-order-hold equivalent of the fit would put a second hold into the loop, half a
sample more delay, and Tustin's rule would bend its frequencies. So the loop is closed at each frequency of the unit
circle with the controller as it runs, T = C P/(1 + C P), and the answer to a sampled step is the inverse transform.
That is exact for the fit taken as the sampled plant; what a fit says between its highest line and half the rate is
an extrapolation, which matters as little as |T| is there.

**How.** The setpoint is a square wave of long half periods. Its answer repeats; where it comes to rest within each half
period, half a period is the step. A square wave has no mean, so that no value at 0 Hz is needed, where integrators
make L infinite. An unstable loop has no causal answer: its inverse transform moves before the step, that is at the end
of the half period before, and so never comes to rest there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.algebra import feedback
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit, TransferFunction
from loopshape.data.result.step import Step
from loopshape.loop.predict.indicators import indicators, with_intervals

if TYPE_CHECKING:
    from loopshape.loop.loop import Loop

#: |T| above which a frequency takes part, and how close to its end a step must stay over its last quarter
SMALL, FLAT = 1e-4, 1e-3
#: most samples of half a period
LONGEST = 2**21
#: an FRF's last line must lie where |T| is below this, and its steps must come to rest to this within half a period
LAST_T, REST = 0.1, 0.02
#: and straight lines between its lines must miss T by less than this
BENT = 0.05
DRAWS = 400


@dataclass(frozen=True)
class _Grid:
    """Half a period of so many samples, seen every `stride` of them, from `lines` odd harmonics."""

    half: int
    stride: int
    rate_hz: float
    lines: int

    @property
    def frequency_hz(self) -> Array:
        """Odd harmonics of the square wave."""
        return np.asarray((2.0 * np.arange(self.lines) + 1.0) * (0.5 * self.rate_hz / self.half), dtype=float)

    @property
    def time_s(self) -> Array:
        """Times of half a period."""
        return np.asarray(np.arange(self.half // self.stride) * (self.stride / self.rate_hz), dtype=float)

    def swing(self, T: ComplexArray) -> Array:
        """Answer to a square wave that goes from -1/2 to 1/2 at time 0, over half a period."""
        k = 2 * np.arange(self.lines) + 1
        wave = 2.0 / (1.0 - np.exp(-1j * TWO_PI * k / (2 * self.half)))
        count = 2 * self.half // self.stride
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        spectrum[k] = wave * T * (count / (2.0 * self.half))
        return np.asarray(np.fft.irfft(spectrum, count)[: count // 2])


def predict_step(fit: Fit, controller: Controller, *, draws: int = DRAWS, seed: int = 0) -> Step | None:
    """Step of the loop of a fitted plant and a controller, with 95 % intervals; None where it does not come to rest.

    Intervals are quantiles over models drawn from the fit's covariance (normal in the fit's reported parameters); they
    say how well the numbers are pinned, and not how true the structure is: see `Fit.sufficient` and `misfit_db`. An
    integrator of the plant stays one in every draw.
    """
    closed = closed_loop(fit.model, controller)
    grid = _settling_grid(closed, controller.rate_hz)
    if grid is None:
        return None
    nominal = _step(closed, grid)
    loops = [closed_loop(model, controller) for model in models_within(fit, draws, seed)]
    every = [(y, _final(T, controller.rate_hz)) for T in loops if _rests(y := _step(T, grid))]
    at_rest = [y for y, _ in every]
    found = [indicators(grid.time_s, y, final=final) for y, final in every]
    unsettled = 1.0 - len(at_rest) / max(draws, 1)
    read = indicators(grid.time_s, nominal, final=_final(closed, controller.rate_hz))
    if unsettled < 0.025 and found:
        read = with_intervals(read, found)
    low, high = np.quantile(at_rest, [0.025, 0.975], axis=0) if at_rest else (nominal, nominal)
    last = float(np.abs(closed(np.array([0.4999 * controller.rate_hz])))[0])
    return Step(grid.time_s, nominal, low, high, read, "fit", unsettled, _doubts(fit, unsettled, last))


def _doubts(fit: Fit, unsettled: float, last: float) -> tuple[str, ...]:
    notes: tuple[str, ...] = ()
    if last > LAST_T:
        notes += (f"|T| of the fit's loop is still {last:.2g} at half the rate: its first samples are not valid",)
    if unsettled >= 0.025:
        notes += (f"{100.0 * unsettled:.0f} % of the models within the fit's covariance do not settle: no intervals",)
    if not fit.sufficient:
        notes += (
            f"the fit of {fit.recording} leaves more than noise (misfit {fit.misfit_db:.2g} dB rms): the step's band"
            " holds its parameters' spread and not what its structure misses",
        )
    return notes


def closed_loop(model: TransferFunction, controller: Controller) -> Callable[[Array], ComplexArray]:
    """T of a model taken as the sampled plant, and a controller, as a function of frequency in Hz."""

    def T(f: Array) -> ComplexArray:
        L = controller.response(f) * model.response(f)
        return np.asarray(L / (1.0 + L))

    return T


def models_within(fit: Fit, count: int, seed: int) -> list[TransferFunction]:
    """Models drawn from a fit's covariance, normal in its reported parameters."""
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    scale = np.where(std > 0.0, std, 1.0)
    values, vectors = np.linalg.eigh(fit.covariance / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    white = np.random.default_rng(seed).standard_normal((count, std.size))
    centre = np.array([p.value for p in fit.parameters])
    return [_model(fit, centre + scale * (root @ x)) for x in white]


def _model(fit: Fit, values: Array) -> TransferFunction:
    """A fit's structure at other values of its reported parameters."""
    given = dict(zip((p.name for p in fit.parameters), values.tolist(), strict=True))
    delay = max(given.pop("delay_s", fit.model.delay_s), 0.0)
    if "kappa" in given:
        den = np.array([1.0, 0.0])
        if "zeta" in given:
            w = TWO_PI * given["f_hz"]
            den = np.array([1.0, 2.0 * given["zeta"] * w, w * w, 0.0])
        return TransferFunction(np.array([given["kappa"]]), den, delay)
    num, den = np.array(fit.model.num), np.array(fit.model.den)
    for name, value in given.items():
        side = num if name[0] == "b" else den
        side[side.size - 1 - int(name[1:])] = value
    return TransferFunction(num, den, delay)


def _step(T: Callable[[Array], ComplexArray], grid: _Grid) -> Array:
    """Unit step from rest at 0; what the square wave leaves at the end of a half period is where it started."""
    swing = grid.swing(T(grid.frequency_hz))
    return np.asarray(swing + _end(swing))


def _end(y: Array) -> float:
    return float(np.mean(y[-8:]))


def _final(T: Callable[[Array], ComplexArray], rate_hz: float) -> float:
    """T at 0 Hz, from so close to it that integrators tell: where a step ends."""
    return float(T(np.array([1e-9 * rate_hz]))[0].real)


def _rests(y: Array) -> bool:
    """Whether a response stays where it ends over its last quarter.

    Looked at in means of neighbours, weighted 1, 2, 1: a |T| that is not quite gone at half the rate leaves a ripple
    there, since no sampled loop has a phase at that frequency.
    """
    smooth = np.convolve(y[-(y.size // 4) :], [0.25, 0.5, 0.25], mode="valid")
    return bool(np.all(np.abs(smooth - _end(y)) < FLAT * max(abs(_end(y)), 1e-9)))


def _settling_grid(T: Callable[[Array], ComplexArray], rate_hz: float) -> _Grid | None:
    """The shortest grid, by doubling, on which the loop comes to rest where T at 0 Hz puts it; None if none does."""
    f = np.geomspace(1e-6 * rate_hz, 0.4999 * rate_hz, 2000)
    size = np.abs(T(f))
    at_rest = _final(T, rate_hz)
    above = np.flatnonzero(size > SMALL)
    passed = np.flatnonzero(size > 0.5 * max(size[0], 1e-9))
    if not above.size:
        return None
    top = float(f[min(above[-1] + 1, f.size - 1)])
    stride = 2 ** max(0, int(np.floor(np.log2(rate_hz / (8.0 * top)))))
    samples = 4.0 * rate_hz / float(f[passed[-1]])
    half = stride * 2 ** max(4, int(np.ceil(np.log2(samples / stride))))
    while half <= max(LONGEST, 32 * stride):
        lines = min(int(np.ceil(top * half / rate_hz)), (half - 1) // 2 + 1)
        grid = _Grid(half, stride, rate_hz, max(lines, 1))
        y = _step(T, grid)
        if _rests(y) and abs(_end(y) - at_rest) < 2.0 * FLAT * max(abs(at_rest), 1e-9):
            return grid
        half *= 2
    return None


def step_from_lines(
    sensitivity: FRF, *, final: float | None = None, guessed: bool = False, draws: int = 200, seed: int = 0
) -> Step:
    """Step of a measured loop straight from its lines, S (1 x 1), without a model; the lines are all that is used.

    The square wave's fundamental is the first line, f1: nothing is assumed below it, and the step is seen for 1/(2 f1)
    s. What happens slower is missing: refused where the answer has not come to rest by then, or where lines lie too far
    apart to carry a period. `final` is where the step ends, if known (1 with an integrator in the loop): what is
    missing of it by then is what something slower still does, within which the band lies, and refused above `REST`; one
    that is `guessed` leaves open in the intervals whether it ends there or where the lines do.
    Nothing above the last line, fn: what is faster than about 1/(2 fn) s is missing, refused
    where |T| is still above -20 dB there. Between lines T is taken as linear. The band is of the lines' covariance,
    errors of neighbours as correlated as `line_overlap` says.
    """
    f, T = sensitivity.frequency_hz, 1.0 - sensitivity.siso
    rate = sensitivity.rate_hz or 64.0 * float(f[-1])
    if abs(T[-1]) > LAST_T:
        raise WrongUseError(
            "a step does not follow from frequencies that end before T dies out",
            f"|T| = {abs(T[-1]):.2g} at the highest frequency, {f[-1]:.3g} Hz",
            "measure higher, or take the step from a fit",
        )
    _check_spacing(sensitivity)
    half = max(2, int(np.floor(0.5 * rate / f[0])))
    stride = max(1, int(rate / (16.0 * f[-1])))
    half -= half % stride
    grid = _Grid(half, stride, rate, max(1, int((f[-1] * 2.0 * half / rate + 1.0) // 2)))
    at = np.clip(grid.frequency_hz, f[0], f[-1])
    nominal = _step(lambda _: np.interp(at, f, T), grid)
    moved = float(np.ptp(nominal[-max(2, nominal.size // 5) :]))
    if moved > REST * 2.0:
        raise WrongUseError(
            "a step does not come to rest within half a period of the lowest frequency",
            f"it still moves by {100.0 * moved:.2g} % of the step over the last fifth of {grid.time_s[-1]:.3g} s",
            "measure lower, or take the step from a fit",
        )
    slower = 0.0 if final is None else abs(final - _end(nominal))
    if slower > REST:
        raise WrongUseError(
            "a step does not come to rest within half a period of the lowest frequency",
            f"after {grid.time_s[-1]:.3g} s it is at {_end(nominal):.3g}, and ends at {final:.3g}",
            "measure lower, or take the step from a fit",
        )
    errors = _errors(sensitivity, draws, seed)
    every = [_step(lambda _, e=e: np.interp(at, f, T + e), grid) for e in errors]  # type: ignore[misc]
    low, high = np.quantile(every, [0.025, 0.975], axis=0)
    seen = (
        f"nothing slower than {0.5 / f[0]:.3g} s is seen (lowest frequency {f[0]:.3g} Hz), nothing above"
        f" {f[-1]:.3g} Hz, where |T| = {abs(T[-1]):.2g}"
    )
    read = indicators(grid.time_s, nominal, final=final)
    ends = (final, None) if guessed else (final,)
    read = with_intervals(read, [indicators(grid.time_s, y, final=end) for y in every for end in ends])
    return Step(grid.time_s, nominal, low - slower, high + slower, read, "FRF", 0.0, (seen,))


def measured_sensitivity(loop: Loop) -> FRF:
    """S of one loop on the lines as measured: smoothed ones share errors, which a comparison cannot know."""
    plant = loop.measured
    return replace(feedback(plant, loop.controller).S_o, recorded_under=loop.controller, loop=plant.loop)


def step_without_fit(
    loop: Loop, S: FRF, stability: str, *, guessed: bool = True, seed: int = 0
) -> tuple[Step | None, tuple[str, ...]]:
    """The step that the lines of a loop carry, or why they carry none; `guessed` are the plant's integrators."""
    if stability is not ClosedLoop.STABLE:  # lines show no end of it: an unstable loop has no step
        return None, ("no fit of this FRF, and a loop that is not known to be stable: no step",)
    own = loop.controller_integrators() > 0
    final = 1.0 if own or (loop.integrators or 0) > 0 else None
    try:
        return step_from_lines(S, final=final, guessed=guessed and not own, seed=seed), ()
    except WrongUseError as refused:
        return None, (f"no fit of this FRF, and {refused}",)


def _check_spacing(sensitivity: FRF) -> None:
    """Refuse lines too far apart: wider than the first line's own frequency, or than T is straight, beyond noise."""
    f, S = sensitivity.frequency_hz, sensitivity.siso
    noise = 3.0 * np.sqrt(0.1 * sensitivity.variance[1:-1, 0, 0])  # of a second difference over 8
    bend = float(np.max(np.abs(np.diff(S, 2)) / 8.0 - noise, initial=0.0))
    apart = float(np.diff(f)[: max(1, f.size // 4)].max(initial=0.0))
    if f.size < 3 or apart > 2.0 * f[0] or bend > BENT:
        raise WrongUseError(
            "a step does not follow from frequencies so far apart",
            f"up to {apart:.3g} Hz from {f[0]:.3g} Hz on, where straight lines deviate from T by {bend:.2g}",
            "measure with a finer resolution, or take the step from a fit",
        )


def _errors(frf: FRF, draws: int, seed: int) -> ComplexArray:
    """Errors (draws, nf) of a 1 x 1 FRF, circular, neighbours correlated by a moving mean of as many lines as overlap.

    A moving mean over m lines has sum of squared correlations (2 m² + 1)/(3 m), which is `line_overlap`.
    """
    overlap = frf.line_overlap
    width = max(1, round(0.75 * overlap + np.sqrt(max((0.75 * overlap) ** 2 - 0.5, 0.0))))
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((2, draws, frf.frequency_hz.size + width - 1))
    mean = np.lib.stride_tricks.sliding_window_view(white, width, axis=2).sum(-1) / np.sqrt(width)
    return np.asarray((mean[0] + 1j * mean[1]) * np.sqrt(0.5 * frf.variance[:, 0, 0]))
