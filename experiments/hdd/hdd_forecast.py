"""3 sigma of the benchmark in the frequency domain, exactly, with what the filters' staircase does between samples.

The disturbances run at the fine step, the error is sampled at the sectors. A disturbance D at the fine frequency w_k
reaches the sampled error through its aliases, and the head by y_k = D_k - G_k S D_s, D_s the mean of the aliases of D,
G_k = P_vcm H F_vcm C_vcm + P_pzt H F_pzt C_pzt with the holds in H, and S = 1/(1 + sum G_k / 20). For stationary
disturbances of density Phi the head's is |1 - G_k S/20|² Phi_k + sum over j != k of |G_k S/20|² Phi_j.
The filters see two frequencies a node, half the sectors' rate apart, so the twenty aliases are summed once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from hdd_benchmark import FINE, HALF, NAMES, SECTORS, Benchmark, System

from loopshape.core.units import TWO_PI, Array, ComplexArray

SECTOR_HZ = 50400.0


def nodes_hz(widest_hz: float = 60.0, ratio: float = 1.015) -> Array:
    """Nodes (n,) from 1 Hz to just below half the sectors' rate."""
    low = [1.0]
    while low[-1] * (ratio - 1.0) < widest_hz:
        low.append(low[-1] * ratio)
    return np.concatenate([low, np.arange(low[-1] + widest_hz, 0.4999 * SECTOR_HZ, widest_hz)])


def tuning_nodes(benchmark: Benchmark, widest_hz: float) -> Array:
    """Nodes in Hz, denser about the fan's modes and up to 1 kHz."""
    fan, widths = benchmark.fan(), np.array([1.0, 2.0, 4.0, 8.0, 15.0, 30.0])
    beside = np.concatenate([-widths, [0.0], widths])
    f = np.union1d(
        nodes_hz(widest_hz, 1.0 + 0.0004 * widest_hz),
        np.ravel(fan.w[:, None] / TWO_PI * (1.0 + fan.zeta[:, None] * beside)),
    )
    f = f[(f >= 1.0) & (f < 25199.0)]
    return f[np.append(True, np.diff(f) > 2.0) | (f < 200.0)]


@dataclass(frozen=True, eq=False)
class Forecast:
    """The benchmark on nodes f (n,): aliases are summed over (cases, n, 2 parities, 2 actuators)."""

    benchmark: Benchmark
    f: Array

    @cached_property
    def at(self) -> tuple[ComplexArray, ComplexArray]:
        """z at Ts (n,) and at Ts/2 (n, 2): the aliases of even and of odd number."""
        angle = TWO_PI * self.f / SECTOR_HZ
        return np.exp(1j * angle), np.exp(0.5j * angle)[:, None] * np.array([1.0, -1.0])

    @cached_property
    def aliases_hz(self) -> Array:
        """Frequencies (n, 20) of a node's aliases, its own first."""
        k = np.concatenate([np.arange(FINE // 2), np.arange(-FINE // 2, 0)])
        return self.f[:, None] + SECTOR_HZ * k

    @cached_property
    def parity(self) -> np.ndarray:
        """Whether an alias (20,) is of even (0) or odd (1) number."""
        return np.arange(FINE) % 2

    @cached_property
    def plants(self) -> ComplexArray:
        """P with both holds over 20 (cases, n, 20, 2), from the filters' output at Ts/2 to the head."""
        w = TWO_PI * self.aliases_hz * self.benchmark.step_s
        hold = np.exp(-1j * w[..., None] * np.arange(HALF)).sum(axis=-1) * (1.0 + np.exp(-1j * HALF * w)) / FINE
        pairs = [self.benchmark.plants(case) for case in self.benchmark.cases]
        z, step = np.exp(1j * w), self.benchmark.step_s
        return np.array([np.stack([hold * P.response(z, step) for P in pair], axis=-1) for pair in pairs])

    @cached_property
    def density(self) -> Array:
        """Phi of fan and rotation at the head (cases, n, 20) times the node's weight: their sum is the variance."""
        f, pieces = self.f, 64
        edges = np.concatenate([f[:1], 0.5 * (f[1:] + f[:-1]), [0.5 * SECTOR_HZ]])
        fine = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(pieces) + 0.5) / pieces
        shift = self.aliases_hz[0] - f[0]
        z = np.exp(1j * TWO_PI * self.benchmark.step_s * (fine[:, :, None] + shift))
        fan, step = self.benchmark.fan(), self.benchmark.step_s
        every = np.zeros(z.shape)
        for k in range(fan.w.size):
            one = type(fan)(fan.kappa[k : k + 1], fan.zeta[k : k + 1], fan.w[k : k + 1])
            every += np.abs(one.response(z, step)) ** 2
        share = 2.0 * np.diff(edges)[:, None] * step / 12.0  # both signs of f
        Phi = np.broadcast_to(every.mean(axis=1) * share, (9, f.size, FINE)).copy()
        turned = sum(np.polyval(num, z) / np.polyval(den, z) for num, den in self.benchmark.rotation())
        for temperature in range(3):  # the VCM does not know the PZT's gain
            P = self.benchmark.plants(self.benchmark.cases[temperature])[0].response(z, step)
            Phi[temperature::3] += np.mean(np.abs(P * turned) ** 2, axis=1) * share
        return Phi

    @cached_property
    def sampled(self) -> ComplexArray:
        """P at the sectors (cases, n, 2 parities, 2 actuators): L's factors."""
        return np.stack([self.plants[:, :, self.parity == k].sum(axis=2) for k in (0, 1)], axis=2)

    @cached_property
    def sums(self) -> dict[str, Array]:
        """What the aliases leave: factors of the node's own, and those of the quadratic form, by parity."""
        P, Phi = self.plants, self.density
        total = Phi.sum(axis=-1)
        other, odd = ((self.parity == k) for k in (0, 1))
        other[0] = False
        split = [other, odd]
        return {
            "own": P[:, :, 0],
            "Phi_own": Phi[:, :, 0],
            "Phi_rest": total - Phi[:, :, 0],
            "total": total,
            "cross": np.stack([(P * Phi[..., None])[:, :, own].sum(axis=2) for own in split], axis=2),
            "square": np.stack(
                [np.einsum("cnka,cnkb->cnab", P[:, :, own].conj(), P[:, :, own]) for own in split], axis=2
            ),
        }

    def loops(self, K: ComplexArray) -> ComplexArray:
        """L (cases, n) of controllers with filters K (n, 2 parities, 2 actuators)."""
        return np.einsum("cnpa,npa->cn", self.sampled, K)

    def variance(self, K: ComplexArray, L: ComplexArray) -> Array:
        """Variance (cases,) of the head by fan and rotation in m²."""
        s, S = self.sums, 1.0 / (1.0 + L)
        g = np.einsum("cna,na->cn", s["own"], K[:, 0])
        own = np.abs(1.0 - g * S) ** 2 * s["Phi_own"] + np.abs(g * S) ** 2 * s["Phi_rest"]
        cross = np.real(S * np.einsum("cnpa,npa->cn", s["cross"], K))
        square = np.real(np.einsum("cnpab,npa,npb->cn", s["square"], K.conj(), K, optimize=True)) * np.abs(S) ** 2
        return np.asarray((own + s["Phi_rest"] - 2.0 * cross + square * s["total"]).sum(axis=1))

    def variance_slopes(self, K: ComplexArray, L: ComplexArray) -> ComplexArray:
        """G (cases, n, 2, 2) with d variance = Re sum G dK."""
        s, S = self.sums, 1.0 / (1.0 + L)
        g = S * np.einsum("cna,na->cn", s["own"], K[:, 0])
        by_own = s["Phi_rest"] * g.conj() - s["Phi_own"] * (1.0 - g).conj()
        cross = S * np.einsum("cnpa,npa->cn", s["cross"], K)
        power = s["total"] * np.abs(S) ** 2
        pulled = np.einsum("cnpba,npb->cnpa", s["square"], K.conj())
        square = np.real(np.einsum("cnpa,npa->cn", pulled, K))
        by_L = -by_own * g * S + S * cross - power * square * S
        G = by_L[..., None, None] * self.sampled - S[..., None, None] * s["cross"] + power[..., None, None] * pulled
        G[:, :, 0] += (by_own * S)[..., None] * s["own"]
        return np.asarray(2.0 * G)

    def three_sigma(self, K: ComplexArray, L: ComplexArray, run_out: Array | float = 0.0) -> Array:
        """3 sigma (cases,) in % of the track."""
        return 300.0 * np.sqrt(self.variance(K, L) + run_out) / self.benchmark.numbers["track_pitch_m"]

    def K(self, controllers: dict[str, System]) -> ComplexArray:
        """Controllers with filters (n, 2, 2) at the nodes."""
        z, half = self.at
        Cd = np.stack([response(controllers[name], z) for name in NAMES[:2]], axis=-1)
        F = np.stack([response(controllers[name], half) for name in NAMES[2:]], axis=-1)
        return Cd[:, None, :] * F


def run_out_variance(benchmark: Benchmark, K_at: Callable[[Forecast], ComplexArray]) -> Array:
    """Variance (cases,) of the head by the run-out in m²; `K_at` gives K of a forecast at the run-out's harmonics."""
    harmonics = Forecast(benchmark, SECTOR_HZ / SECTORS * np.arange(1, SECTORS // 2))
    K = K_at(harmonics)
    L, amplitude = harmonics.loops(K), np.abs(np.fft.rfft(benchmark.rro_m)[1 : SECTORS // 2]) / SECTORS
    G = np.einsum("cnka,nka->cnk", harmonics.plants, K[:, harmonics.parity])
    return 2.0 * np.sum(np.abs(G / (1.0 + L)[..., None] * amplitude[:, None]) ** 2, axis=(1, 2))


def response(system: System, z: ComplexArray) -> ComplexArray:
    """C (z - A)^-1 B + D at z of any shape."""
    flat = z.ravel()
    x = np.linalg.solve(flat[:, None, None] * np.eye(len(system.A)) - system.A, system.B[:, None])[..., 0]
    return (x @ system.C + system.D).reshape(z.shape)
