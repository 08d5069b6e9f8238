"""Several loops of one plant at once: its matrix, a controller for each loop, and all that follows from L = C P.

The picture is that of `data.control.loop`, several loops wide: y = P z; controller k goes from output k to input k:
C is diagonal. Broken at the plant's inputs the open loop is L_i = C P, at its outputs L_o = P C. With one controller a
loop L_o = C^-1 L_i C: both have the same eigenvalues, the same det(I + L), and the same structured singular values for
one error a loop; only their plain singular values differ, and those of S_o and T_o depend on the outputs' units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF


@dataclass(frozen=True, eq=False)
class LoopMatrix:
    """A square plant FRF under one controller a loop, the k-th from output k to input k; responses (nf, n, n).

    `names` are the loops in that order. `integrators` is the number of poles of the whole plant at s = 0, as a minimal
    realisation has them (two axes that integrate have two), `unstable_poles` in the right half plane, counted alike
    (None: not known). `beyond` holds lines above those that are used, less sure: they may still show that L comes up
    again. `held` are the controllers, in the same order, under which all loops were closed and stood when the plant was
    recorded; empty where that is not known.
    Refuses another number of controllers than loops, several rates, and lines at or above half the rate.
    """

    plant: FRF
    controllers: tuple[Controller, ...]
    names: tuple[str, ...]
    integrators: int | None = None
    unstable_poles: int | None = None
    beyond: FRF | None = None
    held: tuple[Controller, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "controllers", tuple(self.controllers))
        object.__setattr__(self, "names", tuple(self.names))
        ny, nu = self.plant.response.shape[1:]
        if not ny == nu == len(self.controllers) == len(self.names):
            raise WrongUseError(
                "several loops need a square plant, and a controller and a name for each of them",
                f"{ny} x {nu}, {len(self.controllers)} controllers, {len(self.names)} names",
                "pick the loops' channels",
            )
        rates = sorted({c.rate_hz for c in self.controllers} | ({self.plant.rate_hz} - {0.0}))
        if len(rates) > 1:
            raise WrongUseError(
                f"the controllers of {', '.join(self.names)} and the recording {self.plant.recording} have one rate",
                ", ".join(f"{rate:g} Hz" for rate in rates),
            )

    @property
    def frequency_hz(self) -> Array:
        """The FRF's lines in Hz."""
        return self.plant.frequency_hz

    @property
    def P(self) -> ComplexArray:
        """The plant's response."""
        return self.plant.response

    @property
    def c(self) -> ComplexArray:
        """Controllers as they run, (nf, n)."""
        return responses(self.controllers, self.frequency_hz)

    @property
    def C(self) -> ComplexArray:
        """Controllers as they run, diagonal (nf, n, n)."""
        return np.asarray(self.c[:, :, None] * np.eye(len(self.names)))

    @property
    def L_i(self) -> ComplexArray:
        """Open loop at the plant's inputs, C P."""
        return np.asarray(self.c[:, :, None] * self.P)

    @property
    def L_o(self) -> ComplexArray:
        """Open loop at the plant's outputs, P C."""
        return np.asarray(self.P * self.c[:, None, :])

    @property
    def determinant(self) -> ComplexArray:
        """det(I + L) (nf,), the same at both places."""
        return np.asarray(np.linalg.det(np.eye(len(self.names)) + self.L_i))

    @property
    def S_i(self) -> ComplexArray:
        """Sensitivity at the plant's inputs, (I + C P)^-1."""
        return sensitivity(self.L_i)

    @property
    def S_o(self) -> ComplexArray:
        """Sensitivity at the plant's outputs, (I + P C)^-1."""
        return sensitivity(self.L_o)

    @property
    def T_i(self) -> ComplexArray:
        """Complementary sensitivity at the plant's inputs, C P (I + C P)^-1."""
        return self.L_i @ self.S_i

    @property
    def T_o(self) -> ComplexArray:
        """Complementary sensitivity at the plant's outputs, P C (I + P C)^-1."""
        return self.L_o @ self.S_o

    @property
    def CS(self) -> ComplexArray:
        """Control sensitivity, C (I + P C)^-1 = (I + C P)^-1 C."""
        return np.asarray(self.c[:, :, None] * self.S_o)

    @property
    def PS(self) -> ComplexArray:
        """Process sensitivity, P (I + C P)^-1 = (I + P C)^-1 P."""
        return self.P @ self.S_i

    def controller_integrators(self) -> int:
        """Poles at s = 0 of all controllers together."""
        return sum(c.integrators() for c in self.controllers)


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
