"""A loop, or several of one plant at once: measured plant and controllers, and everything that follows from L = C P.

The picture that every docstring refers to, with its signs:

        n (controller_input)         n (plant_input)
              v                            v
 r --->(+)-->(+)--> C ----------> z ----->(+)--> [decoupling, PWM, plant] --+--> y
        ^ -                                                                 |
        +-------------------------------------------------------------------+

e = r - y (+ n) enters C; z is what C answers; P goes from what enters the plant to y. With L = C P:
S = 1/(1 + L), T = L/(1 + L), CS = C/(1 + L), PS = P/(1 + L).

Several loops wide, controller k goes from output k to input k: C is diagonal. Broken at the plant's inputs the open
loop is L_i = C P, at its outputs L = P C. With one controller a loop L = C^-1 L_i C: both have the same
eigenvalues, det(I + L), and structured singular values for one error a loop; only their plain singular values differ,
and those of S and T depend on the outputs' units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.algebra import ClosedLoop, controller_frf, product
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit, TransferFunction
from loopshape.data.response.smoothed import Scatter
from loopshape.loop.tolerances import TOL

if TYPE_CHECKING:
    from loopshape.data.result.margins import Margins
    from loopshape.data.result.step import Step

Values = TypeVar("Values", bound=np.ndarray)


def above_hz(last_hz: float, rate_hz: float, count: int = 80) -> Array:
    """Logarithmic grid above a last line, up to 0.45 times the rate; none where the line lies beyond."""
    return np.geomspace(last_hz, 0.45 * rate_hz, count)[1:] if last_hz < 0.45 * rate_hz else np.zeros(0)


def slope_at_end(f: Array, L: np.ndarray) -> float:
    """How steeply |L| falls over the highest lines, 1 for 20 dB a decade; taken as 1 where fewer than three tell."""
    tail = f >= 0.6 * f[-1]  # the highest lines
    if np.count_nonzero(tail) < 3:
        return 1.0
    return float(-np.polyfit(np.log(f[tail]), np.log(np.maximum(np.abs(L[tail]), 1e-300)), 1)[0])


def known_above(beyond: FRF) -> np.ndarray:
    """Which lines above those used (n,) are known well enough to tell what |L| is there.

    Not those of the valid band, which only requirements that narrow it leave out, and a note says so.
    """
    known = np.sqrt(beyond.variance[:, 0, 0]) < TOL.known_above_std * np.abs(beyond.siso)
    return np.asarray(known & ~beyond.valid)


def reach_above(beyond: FRF) -> Array:
    """Radius (n,) of the 95 % circles of lines above those used; their responses lie at the circles' far ends."""
    return np.asarray(np.sqrt(TOL.square_95 * beyond.variance[:, 0, 0]))


def _kept(values: Values) -> Values:
    values.setflags(write=False)
    return values


@dataclass(frozen=True, eq=False, init=False)
class Loop:
    """A square plant FRF under one controller a loop, the k-th from output k to input k.

    >>> import loopshape as ls
    >>> P = ls.FRF.from_arrays([1.0, 2.0], [1.0 + 0j, 0.5], std=0.01)
    >>> ls.Loop(P, ls.controller(ls.gain(1.0), rate_hz=100.0)).complementary.siso.real.round(3).tolist()
    [0.5, 0.333]

    `controllers` is one controller, or a sequence of them in the order of the channels. Responses C, L, S, T, CS and PS
    are (nf,) of one loop and (nf, n, n) of n, broken at the plant's outputs; L_i is always (nf, n, n), broken at its
    inputs. `open_loop`, `sensitivity`, `complementary`, `process` and `control` are FRFs with their covariance.

    `integrators` is the number of poles of the plant at s = 0 (of several loops as a minimal realisation has them: two
    axes that integrate have two), `unstable_poles` in the right half plane (None: not known); the data alone do not
    show them, they come from the recorded loop, a fit or the user. `beyond` holds lines above those that are used, less
    sure: they may still show that |L| comes up again. `recorded_under` are the controllers, in the same order, under
    which all loops were closed and stood when the plant was recorded; empty where that is not known.

    Of one loop `model`, where there is a fit, says how the plant goes on below the lowest line; only the count of
    encirclements uses it. Where `plant` was smoothed over its lines, `raw` are these as they were measured, and
    `scatter` draws what noise does to `plant`.
    Refuses another number of controllers than loops, several rates, and lines at or above half the rate.
    """

    plant: FRF
    controllers: tuple[Controller, ...]
    integrators: int | None
    unstable_poles: int | None
    model: TransferFunction | None
    beyond: FRF | None
    raw: FRF | None
    scatter: Scatter | None
    recorded_under: tuple[Controller, ...]

    def __init__(
        self,
        plant: FRF,
        controllers: Controller | Sequence[Controller],
        integrators: int | None = 0,
        unstable_poles: int | None = None,
        model: TransferFunction | None = None,
        beyond: FRF | None = None,
        raw: FRF | None = None,
        scatter: Scatter | None = None,
        recorded_under: Sequence[Controller] = (),
    ) -> None:
        every = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
        _refuse_unlike(plant, every)
        vars(self).update(
            plant=plant, controllers=every, integrators=integrators, unstable_poles=unstable_poles, model=model,
            beyond=beyond, raw=raw, scatter=scatter, recorded_under=tuple(recorded_under),
        )  # fmt: skip

    def __repr__(self) -> str:
        """One line: the controllers and their plant."""
        return f"Loop: {', '.join(map(repr, self.controllers))}; {self.plant!r}"

    @property
    def is_one(self) -> bool:
        """Whether this is one loop, whose responses are (nf,)."""
        return len(self.controllers) == 1

    @property
    def controller(self) -> Controller:
        """The controller of one loop; refuses several."""
        if not self.is_one:
            raise WrongUseError("one loop's controller was requested of several loops", ", ".join(self.names))
        return self.controllers[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The loops by their controllers, in the order of the channels."""
        return tuple(one.loop for one in self.controllers)

    @property
    def frequency_hz(self) -> Array:
        """The FRF's lines in Hz."""
        return self.plant.frequency_hz

    @property
    def P(self) -> ComplexArray:
        """The plant's response (nf, n, n)."""
        return self.plant.response

    @property
    def measured(self) -> FRF:
        """The plant's lines as they were measured: what is smoothed over frequency does not show what lies between."""
        return self.plant if self.raw is None else self.raw

    @cached_property
    def c(self) -> ComplexArray:
        """Controllers as they run, discretised, (nf, n)."""
        return _kept(responses(self.controllers, self.frequency_hz))

    @cached_property
    def C(self) -> ComplexArray:
        """Controller as it runs, of several loops diagonal."""
        one = self.controllers[0].response(self.frequency_hz) if self.is_one else None
        return _kept(self.c[:, :, None] * np.eye(len(self.controllers)) if one is None else one)

    @cached_property
    def L(self) -> ComplexArray:
        """Open loop P C."""
        return _kept(self.C * self.plant.siso if self.is_one else self.P * self.c[:, None, :])

    @property
    def S(self) -> ComplexArray:
        """Sensitivity (I + P C)^-1."""
        return np.asarray(1.0 / (1.0 + self.L)) if self.is_one else sensitivity(self.L)

    @property
    def T(self) -> ComplexArray:
        """Complementary sensitivity P C (I + P C)^-1."""
        return self.L * self.S if self.is_one else self.L @ self.S

    @property
    def CS(self) -> ComplexArray:
        """Control sensitivity C (I + P C)^-1 = (I + C P)^-1 C."""
        return self.C * self.S if self.is_one else np.asarray(self.c[:, :, None] * self.S)

    @property
    def PS(self) -> ComplexArray:
        """Process sensitivity (I + P C)^-1 P = P (I + C P)^-1."""
        return self.plant.siso * self.S if self.is_one else self.S @ self.P

    @property
    def L_i(self) -> ComplexArray:
        """Open loop at the plant's inputs, C P."""
        return np.asarray(self.c[:, :, None] * self.P)

    @property
    def determinant(self) -> ComplexArray:
        """det(I + L) (nf,), the same at the plant's inputs and outputs."""
        return np.asarray(np.linalg.det(np.eye(len(self.controllers)) + self.L_i))

    def controller_integrators(self) -> int:
        """Poles at s = 0 of all controllers together."""
        return sum(one.integrators() for one in self.controllers)

    @property
    def open_loop(self) -> FRF:
        """L = P C as an FRF with its covariance."""
        C = controller_frf(self.controllers, self.frequency_hz, self.plant.outputs, self.plant.inputs)
        return product(self.plant, C, connect="order")

    @property
    def sensitivity(self) -> FRF:
        """S = (I + P C)^-1 as an FRF with its covariance."""
        return self._closed.S_o

    @property
    def complementary(self) -> FRF:
        """T = P C S as an FRF with its covariance."""
        return self._closed.T_o

    @property
    def process(self) -> FRF:
        """P S as an FRF with its covariance."""
        return self._closed.PS

    @property
    def control(self) -> FRF:
        """C S as an FRF with its covariance."""
        return self._closed.KS

    def margins(self) -> Margins:
        """Margins with 95 % intervals and stability, as `ls.check` reads them; 0 integrators are taken as not known."""
        from loopshape.loop.verdict import check

        declared = Requirements(integrators=self.integrators or None, unstable_poles=self.unstable_poles)
        verdict = check([self.plant], self.controllers, together=declared, recorded_under=self.recorded_under)
        return next(iter(verdict.margins.values()))

    def step(self, fit: Fit | None = None) -> Step | None:
        """Setpoint step of one loop, from a fit of the plant or from its lines alone; None where neither tells it."""
        from loopshape.loop.loops import loops_of
        from loopshape.loop.predict.step_response import measured_sensitivity, predict_step, step_without_fit
        from loopshape.loop.stability.stability import closed_loop_stability

        if fit is not None:
            return predict_step(fit, self.controller)
        ((loop,), _) = loops_of([self.plant], self.controller, Requirements(self.controller.loop))
        return step_without_fit(loop, measured_sensitivity(loop), closed_loop_stability(loop).outcome)[0]

    def poles(self, fit: Fit) -> ComplexArray:
        """Closed-loop poles in rad/s of a fit, taken as the sampled plant, and the controller as it runs.

        Zeros of 1 + C(exp(s/rate)) P(s) slower than pi rate, and than 40/delay, by Newton's method; their number is
        that of the argument principle. Raises WrongUseError where some are not found.
        """
        from loopshape.loop.predict.poles import closed_loop_poles

        return closed_loop_poles(fit.model, self.controller)

    @cached_property
    def _closed(self) -> ClosedLoop:
        return self.plant.feedback(self.controllers)

    @cached_property
    def above_hz(self) -> Array:
        """Frequencies from the last line to nine tenths of half the rate, where no line was measured."""
        return _kept(above_hz(float(self.frequency_hz[-1]), self.controllers[0].rate_hz))

    @cached_property
    def C_above(self) -> ComplexArray:
        """Controller on `above_hz`."""
        return _kept(self.controller.response(self.above_hz))

    @cached_property
    def largest_above(self) -> float:
        """How far towards -1 lines above those used may reach that are known well enough; 0 where none does.

        1 less the smallest distance of their 95 % circles to -1: where L passes the negative real axis there, its size.
        """
        if self.beyond is None:
            return 0.0
        f, P, reach = self.beyond.frequency_hz, self.beyond.siso, reach_above(self.beyond)
        rows = (reach < np.abs(P)) & known_above(self.beyond) & (f < 0.5 * self.controller.rate_hz)
        C = self.controller.response(f[rows])
        middle = C * P[rows] * (1.0 - reach[rows] / np.abs(P[rows]))
        return float(np.max(1.0 - np.abs(1.0 + middle) + np.abs(C) * reach[rows], initial=0.0))

    @cached_property
    def rise_above(self) -> float:
        """|L| of one loop where it is largest above all lines, 0 where it does not rise there.

        The controller is known there, as behind a notch at the band's end; |P| falls on as over the highest lines,
        `beyond` among them.
        """
        f, P = self.frequency_hz, np.abs(self.plant.siso)
        if self.beyond is not None:
            f, P = np.append(f, self.beyond.frequency_hz), np.append(P, np.abs(self.beyond.siso))
        above = self.above_hz > f[-1]
        if not above.any():
            return 0.0
        size = P[-1] * (self.above_hz[above] / f[-1]) ** min(-slope_at_end(f, P), 0.0) * np.abs(self.C_above[above])
        largest = float(size.max())
        return largest if largest > P[-1] * abs(self.controller.response(f[-1:])[0]) else 0.0

    @property
    def below_hz(self) -> Array:
        """Three decades of frequencies below the lowest line, where only a model tells; none without one.

        Dense about each of the model's poles and zeros there: a sharp resonance must not be stepped over.
        """
        if self.model is None:
            return np.zeros(0)
        lowest = float(self.frequency_hz[0])
        grid = [np.geomspace(1e-3 * lowest, lowest, 60, endpoint=False)]
        for root in np.concatenate([self.model.poles(), np.roots(self.model.num)]):
            centre, width = abs(root.imag) / TWO_PI, max(abs(root.real) / TWO_PI, 1e-9)
            if centre > 0.0:
                grid.append(centre + width * np.sinh(np.linspace(-6.0, 6.0, 61)) / 20.0)
        every = np.unique(np.concatenate(grid))
        return every[(every >= 1e-3 * lowest) & (every < lowest)]

    @property
    def P_below(self) -> ComplexArray:
        """The model's response on `below_hz`."""
        return np.zeros(0, dtype=complex) if self.model is None else self.model.response(self.below_hz)


def _refuse_unlike(plant: FRF, controllers: tuple[Controller, ...]) -> None:
    """Refuse a plant that is not as wide and as high as there are controllers, and several rates."""
    ny, nu = plant.response.shape[1:]
    if not ny == nu == len(controllers):
        raise WrongUseError(
            "a loop needs a square plant, and a controller for each channel", f"{ny} x {nu}, {len(controllers)}"
            f" controller{'s' * (len(controllers) != 1)}", "pick the loops' channels",
        )  # fmt: skip
    rates = {one.rate_hz for one in controllers} | ({plant.rate_hz} - {0.0})
    if len(rates) > 1:
        names = ", ".join(one.loop for one in controllers)
        raise WrongUseError(
            f"the controllers of {names} and the recording {plant.recording} have one rate",
            ", ".join(f"{rate:g} Hz" for rate in sorted(rates)),
        )


def responses(controllers: Sequence[Controller], frequency_hz: Array) -> ComplexArray:
    """Responses (nf, n) of controllers as they run."""
    return np.stack([c.response(frequency_hz) for c in controllers], axis=1)


def sensitivity(L: ComplexArray) -> ComplexArray:
    """(I + L)^-1 at each line; infinite entries where I + L has no inverse."""
    M = np.eye(L.shape[-1]) + L
    try:
        return np.asarray(np.linalg.inv(M))
    except np.linalg.LinAlgError:
        singular = np.abs(np.linalg.det(M)) == 0.0
        out = np.full(L.shape, np.inf, dtype=complex)
        out[~singular] = np.linalg.inv(M[~singular])
        return out


def characteristic_loci(L: ComplexArray) -> ComplexArray:
    """Eigenvalues (nf, n) of L (nf, n, n), joined to smooth curves as well as lines allow.

    Each line's eigenvalues go to where the two lines before lead, all at once at the least squared distance, relative
    to their size. Where two loci meet the names behind the meeting are arbitrary; their set is not.
    """
    loci = np.linalg.eigvals(L).astype(complex)
    n = loci.shape[1]
    if n == 1:
        return loci
    from scipy.optimize import linear_sum_assignment

    order = np.argsort(-np.abs(loci[0]))
    loci[0] = loci[0][order]
    for k in range(1, len(loci)):
        ahead = loci[k - 1] if k == 1 else 2.0 * loci[k - 1] - loci[k - 2]
        apart = np.minimum(_distance(ahead, loci[k]), _distance(loci[k - 1], loci[k]))
        _, columns = linear_sum_assignment(apart)
        loci[k] = loci[k][columns]
    return loci


def _distance(one: ComplexArray, two: ComplexArray) -> np.ndarray:
    size = np.maximum(np.abs(one)[:, None] + np.abs(two)[None, :], 1e-300)
    return np.asarray(np.abs(one[:, None] - two[None, :]) ** 2 / size**2)
