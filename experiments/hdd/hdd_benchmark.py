"""The dual-stage hard disk's benchmark: nine plants, disturbances to the last random number, and the score.

Notation and order of computation: `README.md` of the data, after T. Atsumi's benchmark (MIT, PyHDDBenchmark).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import TWO_PI, Array

#: fine steps per sector and per step of the multirate filters
FINE, HALF = 20, 10
#: sectors of a revolution
SECTORS = 420


def data_folder() -> Path:
    """The folder of the benchmark's numbers, beside the repository or below $LOOPSHAPE_DATA."""
    shared = Path(__file__).parents[3] / "shared" / "data"
    return Path(os.environ.get("LOOPSHAPE_DATA", shared)) / "hdd"


@dataclass(frozen=True, eq=False)
class System:
    """A discrete state space of one input and one output: x+ = A x + B u, y = C x + D u."""

    A: Array
    B: Array
    C: Array
    D: float

    @classmethod
    def from_table(cls, table: Mapping[str, Sequence]) -> System:
        """As the benchmark's JSON writes it."""
        A, B, C, D = (np.array(table[name], dtype=float) for name in "ABCD")
        return cls(A, B.ravel(), C.ravel(), float(D.ravel()[0]))

    def to_table(self) -> dict[str, list]:
        """As the benchmark's JSON writes it."""
        return {"A": self.A.tolist(), "B": self.B[:, None].tolist(), "C": [self.C.tolist()], "D": [[self.D]]}


@dataclass(frozen=True)
class Modes:
    """A sum of modes kappa / (s² + 2 zeta w s + w²) of one plant: w (n,) in rad/s."""

    kappa: Array
    zeta: Array
    w: Array

    def held(self, step_s: float) -> tuple[Array, Array]:
        """Each mode held over a step, exactly: transition (n, 2, 2) and input (n, 2) of position and speed."""
        every = [
            cont2discrete(
                (np.array([[0.0, 1.0], [-w * w, -2.0 * z * w]]), np.array([[0.0], [k]]), np.eye(2), 0), step_s
            )
            for k, z, w in zip(self.kappa, self.zeta, self.w, strict=True)
        ]
        return np.array([one[0] for one in every]), np.array([one[1][:, 0] for one in every])

    def response(self, z: np.ndarray, step_s: float) -> np.ndarray:
        """Response at z = exp(j w step) of all modes held over a step, position out."""
        out = np.zeros(z.shape, dtype=complex)
        for F, G in zip(*self.held(step_s), strict=True):
            below = z * z - (F[0, 0] + F[1, 1]) * z + (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0])
            out += ((z - F[1, 1]) * G[0] + F[0, 1] * G[1]) / below
        return out


class Benchmark:
    """The benchmark's numbers; refuses a folder without them."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or data_folder()
        self.numbers = json.loads((self.folder / "benchmark.json").read_text())
        self.step_s = 1.0 / (50400.0 * FINE)
        self.steps = self.numbers["simulation"]["steps"]
        self.cases = self.numbers["plant"]["cases"]
        rro = self.numbers["disturbances"]["rro"]
        self.rro_m = rro["factor_m"] * np.array(rro["table"])

    def reference(self) -> dict[str, System]:
        """The reference's controllers and filters."""
        return read_controllers(self.folder / "reference_controllers.json")

    def plants(self, case: Mapping[str, float]) -> tuple[Modes, Modes]:
        """VCM and PZT of a case."""
        table = self.numbers["plant"]
        vcm, pzt = table["vcm"], table["pzt"]
        w = TWO_PI * np.array(vcm["frequency_Hz"]) * case["vcm_omega_factor"]
        first = Modes(vcm["Kp"] * np.array(vcm["kappa"]), np.array(vcm["zeta"]) * case["vcm_zeta_factor"], w)
        w = TWO_PI * np.array(pzt["frequency_Hz"]) * case["pzt_omega_factor"]
        kappa = np.array(pzt["kappa"])
        static = abs(float(np.sum(kappa / w**2)))
        second = Modes(case["pzt_gain_factor"] * kappa / static, np.array(pzt["zeta"]) * case["pzt_zeta_factor"], w)
        return first, second

    def fan(self) -> Modes:
        """The fan's modes, each with a random input of its own."""
        fan = self.numbers["disturbances"]["fan"]
        return Modes(np.array(fan["gain"]), np.array(fan["zeta"]), TWO_PI * np.array(fan["frequency_Hz"]))

    def rotation(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Numerators and denominators in z of the rotation's filter held at the fine step: its slow pole and its pair.

        In parts, for as one polynomial of third order it loses digits; its feedthrough is dropped.
        """
        rv = self.numbers["disturbances"]["rv"]
        za, pb, wn, wd = (TWO_PI * rv[name] for name in ("zero_Hz", "pole_Hz", "f_n_Hz", "f_d_Hz"))
        pair = np.array([1.0, 2.0 * rv["zeta_d"] * wd, wd**2])
        num = rv["gain"] * np.polymul([1.0, za], [1.0, 2.0 * rv["zeta_n"] * wn, wn**2])
        rest = np.polysub(num, rv["gain"] * np.polymul([1.0, pb], pair))
        slow = np.polyval(rest, -pb) / np.polyval(pair, -pb)
        other, _ = np.polydiv(np.polysub(rest, slow * pair), [1.0, pb])
        last = np.exp(-pb * self.step_s)
        one = np.array([0.0, slow * (1.0 - last) / pb]), np.array([1.0, -last])
        F, G = (x[0] for x in Modes(np.ones(1), np.array([rv["zeta_d"]]), np.array([wd])).held(self.step_s))
        position = np.array([0.0, G[0], F[0, 1] * G[1] - F[1, 1] * G[0]])
        speed = np.array([0.0, G[1], F[1, 0] * G[0] - F[0, 0] * G[1]])
        return one, (other[-2] * speed + other[-1] * position, np.array([1.0, -np.trace(F), np.linalg.det(F)]))

    def disturbances(self, seeds: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Fan (steps,) in m and rotation (steps,) at the VCM's input; `seeds` are 14, the rotation's first."""
        given = list(seeds or self.numbers["random_input"]["seeds"])
        drawn = [np.random.RandomState(seed).rand(self.steps) - 0.5 for seed in given]
        fan = np.zeros(self.steps)
        for (F, G), u in zip(zip(*self.fan().held(self.step_s), strict=True), drawn[1:], strict=True):
            num = [0.0, G[0], F[0, 1] * G[1] - F[1, 1] * G[0]]
            fan += lfilter(num, [1.0, -(F[0, 0] + F[1, 1]), F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]], u)
        return fan, np.sum([lfilter(num, den, drawn[0]) for num, den in self.rotation()], axis=0)

    def head(
        self, case: Mapping[str, float], controllers: Mapping[str, System], disturbances: tuple[Array, Array]
    ) -> tuple[Array, float]:
        """Head position y_c (steps,) in m at every fine step, and the PZT's largest stroke in m."""
        modes = [part for plant in self.plants(case) for part in plant.held(self.step_s)]
        parts = [x for name in NAMES for x in _arrays(controllers[name])]
        return _simulated(*modes, *parts, self.rro_m, *disturbances)

    def three_sigma(self, y: Array) -> float:
        """The score of a case, in % of the track pitch."""
        score = self.numbers["score"]
        window = y[score["first_index"] : score["first_index"] + score["samples"]]
        return float(300.0 * np.std(window) / self.numbers["track_pitch_m"])

    def scores(self, controllers: Mapping[str, System], seeds: Sequence[int] | None = None) -> list[float]:
        """3 sigma of each of the nine cases in % of the track pitch."""
        given = self.disturbances(seeds)
        return [self.three_sigma(self.head(case, controllers, given)[0]) for case in self.cases]


NAMES = ("Cd_vcm", "Cd_pzt", "Fm_vcm", "Fm_pzt")


def read_controllers(path: Path) -> dict[str, System]:
    """Controllers at Ts and filters at Ts/2 of a JSON file."""
    table = json.loads(path.read_text())
    return {name: System.from_table(table[name]) for name in NAMES}


def write_controllers(path: Path, controllers: Mapping[str, System], name: str) -> None:
    """Write controllers as the benchmark's JSON does, so that anyone can score them."""
    convention = "x+ = A x + B u, y = C x + D u; Cd at Ts with input e, Fm at Ts/2 with the held controller output"
    table = {"name": name, "convention": convention, **{key: controllers[key].to_table() for key in NAMES}}
    path.write_text(json.dumps(table, indent=1) + "\n")


def _arrays(system: System) -> tuple[Array, Array, Array, float]:
    return np.ascontiguousarray(system.A), system.B, system.C, system.D


@compiled
def _step(A, B, C, D, x, u):  # type: ignore[no-untyped-def]
    """Output C x + D u first, then the state, in place."""
    out = D * u
    for i in range(x.size):
        out += C[i] * x[i]
    new = B * u
    for i in range(x.size):
        for j in range(x.size):
            new[i] += A[i, j] * x[j]
    x[:] = new
    return out


@compiled
def _simulated(Fv, Gv, Fp, Gp, A1, B1, C1, D1, A2, B2, C2, D2, A3, B3, C3, D3, A4, B4, C4, D4, rro, fan, rotation):  # type: ignore[no-untyped-def]
    """y_c at every fine step, in the order that the benchmark gives, and the largest |y_cp|."""
    xv, xp = np.zeros((len(Fv), 2)), np.zeros((len(Fp), 2))
    x1, x2, x3, x4 = np.zeros(B1.size), np.zeros(B2.size), np.zeros(B3.size), np.zeros(B4.size)
    y = np.zeros(fan.size)
    v1 = v2 = v3 = v4 = most = 0.0
    sector = 0
    for k in range(fan.size):
        total = fan[k]
        for i in range(len(Fv)):
            total += xv[i, 0]
        stroke = 0.0
        for i in range(len(Fp)):
            stroke += xp[i, 0]
        total += stroke
        most = max(most, abs(stroke))
        y[k] = total
        if k % 20 == 0:
            e = rro[sector] - total
            sector = (sector + 1) % rro.size
            v1, v2 = _step(A1, B1, C1, D1, x1, e), _step(A2, B2, C2, D2, x2, e)
        if k % 10 == 0:
            v3, v4 = _step(A3, B3, C3, D3, x3, v1), _step(A4, B4, C4, D4, x4, v2)
        u = v3 + rotation[k]
        for i in range(len(Fv)):
            a, b = xv[i, 0], xv[i, 1]
            xv[i, 0] = Fv[i, 0, 0] * a + Fv[i, 0, 1] * b + Gv[i, 0] * u
            xv[i, 1] = Fv[i, 1, 0] * a + Fv[i, 1, 1] * b + Gv[i, 1] * u
        for i in range(len(Fp)):
            a, b = xp[i, 0], xp[i, 1]
            xp[i, 0] = Fp[i, 0, 0] * a + Fp[i, 0, 1] * b + Gp[i, 0] * v4
            xp[i, 1] = Fp[i, 1, 0] * a + Fp[i, 1, 1] * b + Gp[i, 1] * v4
    return y, most
