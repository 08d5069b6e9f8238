"""Random loops whose data are spoiled: holes, poor bands, cut edges, hidden cancellations, fits of a wrong structure.

Loops are those of `run.harder` under a gain with a PI or a lead now and then; what is true of them comes from the
formula alone: the argument principle for closed-loop poles, and a dense grid for margins.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from loops import GAINS, LINEAR, LOGARITHMIC, RATE_HZ, between, limit, pair, product, real, unstable_poles

from loopshape.core.units import TWO_PI, Array
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.response.model import Fit, TransferFunction
from loopshape.identify.fit import fit
from loopshape.identify.structures import Rational
from loopshape.loop.verdict import check

KINDS = ("hole", "poor band", "low edge", "high edge", "cancellation", "fit", "sound")
STEPS = (0.3, 0.5, 0.7, 0.9, 1.1, 1.4, 2.0, 3.0)
#: limits lie this far from what is true: a factor of the modulus margin, dB, deg
FACTOR, APART_DB, APART_DEG = 1.12, 1.0, 5.0
#: nobody limits a margin that is larger than this; one of 170 dB at 1e-4 Hz was answered wrongly
MOST = {"phase_margin_deg": 170.0, "gain_margin_db": 60.0, "gain_reduction_margin_db": 60.0}


@dataclass(frozen=True, eq=False)
class Spoiled:
    """A loop with its data, what is asked of it and what is true: `stable`, and whether every limit `holds`."""

    kind: str
    frf: FRF
    controller: Controller
    asked: Requirements
    stable: bool
    holds: bool
    plant: TransferFunction
    band_hz: tuple[float, float]
    fits: tuple[Fit, ...] = ()

    def outcome(self) -> str:
        """What a check answers."""
        return check([self.frf], self.controller, self.asked, self.fits).outcome.value

    def wrong(self, outcome: str) -> str:
        """ "pass" or "fail" where the outcome is wrong, else nothing."""
        good = self.stable and self.holds
        return "pass" if outcome == "passed" and not good else "fail" if outcome == "failed" and good else ""


def plant_and_controller(rng: np.random.Generator, kind: str) -> tuple[TransferFunction, tuple[Block, ...], Array]:
    """A plant of `run.harder`'s kind, blocks besides the gain, and lines in Hz."""
    lines = (LINEAR, LOGARITHMIC)[int(rng.integers(2))]
    zero = kind == "cancellation"
    integrators, growing = (0 if zero else int(rng.integers(0, 4))), int(rng.integers(0, 3)) * (not zero)
    num = product(*(real(between(rng, 0.3, 3.0)) for _ in range(max(integrators - 1, 0) + growing)))
    den = product(*(real(between(rng, 8.0, 40.0)) for _ in range(3)))
    if growing == 1:
        den = product(den, real(between(rng, 0.5, 3.0), -1.0))
    if growing == 2:
        den = product(den, pair(between(rng, 0.5, 4.0), -between(rng, 0.05, 0.5)))
    for _ in range(int(rng.integers(0, 4))):
        f_hz = between(rng, 3.0, 40.0)
        den = product(den, pair(f_hz, between(rng, 0.003, 0.05)))
        num = product(num, pair(f_hz * between(rng, 0.8, 1.25), between(rng, 0.003, 0.05)))
    if zero:
        num, den = np.append(num, 0.0), product(den, real(between(rng, 0.05, 1.0)))
    den = np.concatenate([den, np.zeros(integrators)])
    scale = 1.0 / abs(TransferFunction(num, den).response([5.0])[0])
    plant = TransferFunction(scale * num, den, between(rng, 0.002, 0.02) if rng.random() < 1.0 / 3.0 else 0.0)
    if (
        kind in ("hole", "poor band", "low edge") and rng.random() < 0.6
    ):  # a mode beside the rest, seen by its peak alone
        f_hz, damping = between(rng, 3.0, 40.0), between(rng, 0.002, 0.03)
        mode, peak = pair(f_hz, damping), between(rng, 0.5, 12.0) * float(rng.choice([-1.0, 1.0]))
        peak *= abs(plant.response([f_hz])[0])
        num = np.polyadd(np.polymul(plant.num, mode), 2.0 * damping * peak * plant.den)
        plant = TransferFunction(num, np.polymul(plant.den, mode), plant.delay_s)
    blocks: tuple[Block, ...] = ()
    if zero or rng.random() < 0.3:
        blocks += (Block("pi", {"f_hz": between(rng, 0.01, 1.0)}),)
    if rng.random() < 0.3:
        f_hz = between(rng, 2.0, 20.0)
        blocks += (Block("lead_lag", {"f1_hz": f_hz / 3.0, "f2_hz": f_hz * 3.0}),)
    return plant, blocks, lines


def in_series(plant: TransferFunction, blocks: tuple[Block, ...]) -> TransferFunction:
    """The plant behind continuous blocks: PI 1 + w/s, lead (s/w1 + 1)/(s/w2 + 1)."""
    num, den = plant.num, plant.den
    for block in blocks:
        v = block.parameters
        if block.kind == "pi":
            num, den = np.polymul(num, [1.0, TWO_PI * v["f_hz"]]), np.append(den, 0.0)
        else:
            num, den = np.polymul(num, real(v["f1_hz"])), np.polymul(den, real(v["f2_hz"]))
    if num[-1] == 0.0 and den[-1] == 0.0:  # the zero at s = 0 hides the integrator: what is left is the loop
        num, den = num[:-1], den[:-1]
    return TransferFunction(num, den, plant.delay_s)


def dense_hz(loop: TransferFunction) -> Array:
    """A grid on which no resonance of the loop is stepped over, from 1e-4 Hz to 1 kHz."""
    parts = [np.geomspace(1e-4, 1e3, 12_000)]
    for root in np.concatenate([np.roots(loop.num), np.roots(loop.den)]):
        centre, width = abs(root.imag) / TWO_PI, abs(root.real) / TWO_PI
        if centre > 0.0:
            parts.append(centre + width * np.sinh(np.linspace(-8.0, 8.0, 400)))
    every = np.unique(np.concatenate(parts))
    return every[every >= 1e-4]


def truth(loop: TransferFunction, gain: float) -> dict[str, float]:
    """Margins by their definitions, from the formula."""
    f = dense_hz(loop)
    L = gain * loop.response(f)
    a, b = L[:-1], L[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = np.flatnonzero((a.imag >= 0.0) != (b.imag >= 0.0))
        share = a.imag[cross] / (a.imag[cross] - b.imag[cross])
        axis = a.real[cross] + share * (b.real[cross] - a.real[cross])
        unit = np.flatnonzero((np.abs(a) >= 1.0) != (np.abs(b) >= 1.0))
    sizes = -axis[axis < 0.0]
    if abs(L[0].imag) < 1e-3 * abs(L[0].real) and L[0].real < 0.0:  # without integrators: the axis is met at 0 Hz
        sizes = np.append(sizes, -L[0].real)
    inner, outer = sizes[sizes < 1.0], sizes[sizes >= 1.0]
    angles = np.abs(180.0 - np.abs(np.degrees(np.angle(L[unit]))))
    return {
        "modulus_margin": float(np.abs(1.0 + L).min()),
        "complementary_peak_db": float(20.0 * np.log10(np.abs(L / (1.0 + L)).max())),
        "gain_margin_db": float(-20.0 * np.log10(inner.max())) if inner.size else np.inf,
        "gain_reduction_margin_db": float(20.0 * np.log10(outer.min())) if outer.size else np.inf,
        "phase_margin_deg": float(angles.min()) if angles.size else np.inf,
    }


def requirements(
    rng: np.random.Generator, exact: dict[str, float], plant: TransferFunction, zero: bool
) -> tuple[Requirements, bool]:
    """One to three limits that lie clear of what is true, all kept or one missed; and whether all are kept."""
    names = [x for x in exact if np.isfinite(exact[x]) and exact[x] < MOST.get(x, np.inf)]
    chosen = [str(x) for x in rng.permutation(names)[: int(rng.integers(1, 4))]]
    missed = chosen[0] if rng.random() < 0.5 else None
    limits = {}
    for name in chosen:
        sign = -1.0 if name == missed else 1.0
        if name == "modulus_margin":
            limits[name] = min(exact[name] / FACTOR**sign, 0.999)
            if name == missed and limits[name] <= exact[name]:
                missed = None
        elif name == "complementary_peak_db":
            limits[name] = exact[name] + sign * APART_DB
        elif name == "phase_margin_deg":
            limits[name] = exact[name] - sign * APART_DEG
        else:
            limits[name] = exact[name] - sign * APART_DB
    kept = missed is None
    limits = {n: v for n, v in limits.items() if v > 0.0 or n == "complementary_peak_db"}
    kept = kept or missed not in limits
    poles = plant.unstable_poles()
    return Requirements("axis", integrators=-1 if zero else plant.integrators(), unstable_poles=poles, **limits), kept


def _gain(rng: np.random.Generator, loop: TransferFunction) -> float:
    """A gain some way from one of the limits of stability, where there is one."""
    counts = np.array([unstable_poles(loop, g) for g in GAINS])
    changes = np.flatnonzero(np.diff(counts))
    if not changes.size:
        return float(rng.choice(GAINS))
    return limit(loop, counts, int(rng.choice(changes))) * float(rng.choice(STEPS))


def _wrong_fit(rng: np.random.Generator, frf: FRF) -> Fit:
    """A fit of a structure that is drawn without looking at the plant."""
    den = int(rng.integers(2, 6))
    integrators = int(rng.integers(0, min(den, 3)))
    structure = Rational(int(rng.integers(0, den)), den, integrators, bool(rng.integers(2)))
    return fit(frf.valid_lines(), structure, weighting=str(rng.choice(["variance", "relative"])))


def draw(rng: np.random.Generator, kind: str) -> Spoiled:
    """One loop with spoiled data."""
    wanted = bool(rng.integers(2))  # half of the loops are stable
    for _ in range(40):
        plant, blocks, lines = plant_and_controller(rng, kind)
        loop = in_series(plant, blocks)
        gain = _gain(rng, loop)
        balanced = unstable_poles(loop, gain) == 0
        if balanced == wanted:
            break
    stable = balanced and kind != "cancellation"
    exact = truth(loop, gain)
    asked, holds = requirements(rng, exact, plant, kind == "cancellation")
    controller = Controller("axis", (Block("gain", {"gain": gain}), *blocks), RATE_HZ)
    noise = float(rng.choice([1e-6, 1e-3, 3e-3, 0.01]))
    relative = np.full(lines.size, noise)
    keep = np.ones(lines.size, dtype=bool)
    width = between(rng, 0.1, 1.5)  # octaves
    L = np.abs(gain * loop.response(lines))
    near = lines[(L > 0.03) & (L < 30.0)]
    modes = np.abs(np.roots(plant.den).imag) / TWO_PI
    about = [*modes[(modes > lines[0]) & (modes < lines[-1])], *([float(rng.choice(near))] if near.size else [])]
    centre = (
        float(rng.choice(about)) * 2.0 ** rng.uniform(-0.4 * width, 0.4 * width) if about else between(rng, 0.5, 30.0)
    )
    band = centre * 2.0 ** (-0.5 * width), centre * 2.0 ** (0.5 * width)
    inside = (lines > band[0]) & (lines < band[1])
    if kind == "hole":
        keep = ~inside
    if kind == "poor band":
        relative = np.where(inside, float(rng.uniform(0.2, 0.8)), noise)
    if kind in ("low edge", "fit"):
        keep = lines > between(rng, 0.1, 6.0)
    if kind == "high edge":
        top = between(rng, 10.0, 60.0)
        above = np.geomspace(top, 1e3, 4000)
        size = np.abs(gain * loop.response(np.unique(np.concatenate([above, dense_hz(loop)[dense_hz(loop) > top]]))))
        if size.max() <= size[0] * 1.001 and size[0] < 1.0:  # what the check assumes above its last line
            keep = lines <= top
    f = lines[keep]
    P, std = plant.response(f), relative[keep] * np.abs(plant.response(f))
    error = std * np.sqrt(0.5) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    known = valid_lines(f, relative[keep], np.ones(f.size, dtype=bool))
    frf = FRF(
        f,
        (P + error)[:, None, None],
        (std**2)[:, None, None] + 0j,
        known,
        ("u",),
        ("y",),
        "drawn",
        "one",
        "axis",
        RATE_HZ,
    )
    fits = (_wrong_fit(rng, frf),) if kind == "fit" else ()
    if kind == "fit":  # what the fit says of it counts
        told = ("integrators", "unstable_poles")
        asked = replace(asked, **{name: None for name in told if rng.random() < 0.5})
    return Spoiled(kind, frf, controller, asked, stable, holds, plant, band, fits)


def worse(rng: np.random.Generator, one: Spoiled) -> Spoiled:
    """The same loop on worse data: thinned, a band with more noise, or an edge cut."""
    frf, how = one.frf, int(rng.integers(3))
    f = frf.frequency_hz
    if how == 0:
        return replace(one, kind="thinned", frf=frf.select(np.arange(f.size) % int(rng.integers(2, 5)) == 0))
    if how == 1:
        std = np.sqrt(frf.variance[:, 0, 0])
        low = float(rng.choice(f))
        inside = (f >= low) & (f <= low * 2.0 ** rng.uniform(0.1, 1.5))
        more = np.where(inside, rng.uniform(0.05, 0.8) * np.abs(frf.siso), 0.0)
        error = more * np.sqrt(0.5) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
        std = np.hypot(std, more)
        known = valid_lines(f, std / np.abs(frf.siso), np.ones(f.size, dtype=bool))
        made = replace(
            frf, response=frf.response + error[:, None, None], covariance=(std**2)[:, None, None] + 0j, valid=known
        )
        return replace(one, kind="noisier", frf=made)
    return replace(one, kind="cut", frf=frf.select(f > float(rng.choice(f[: f.size // 2]))))


COLUMNS = ("kind", "loops", "stable and kept", "passed", "failed", "undecided", "wrong passes", "wrong fails")
HERE = Path(__file__).parent


def rows(count: int, seed: int) -> Iterator[list]:
    """Of each kind: how many there are, what is answered, what is wrong; what is wrong is printed."""
    for kind in KINDS:
        found: Counter[str] = Counter()
        for k in range(count if kind != "fit" else count // 4):
            one = draw(np.random.default_rng([seed, KINDS.index(kind), k]), kind)
            outcome = one.outcome()
            found.update([outcome, *(["good"] if one.stable and one.holds else [])])
            if one.wrong(outcome):
                found.update([f"wrong {one.wrong(outcome)}"])
                print(f"wrong {one.wrong(outcome)}: {kind} {k}", flush=True)
        names = ("good", "passed", "failed", "undecided", "wrong pass", "wrong fail")
        yield [kind, found["passed"] + found["failed"] + found["undecided"], *(found[name] for name in names)]


def law(count: int, seed: int) -> Iterator[list]:
    """Worse data of the same loop: how outcomes change, and how many of those that come to pass are wrong."""
    found: Counter[tuple[str, str, str]] = Counter()
    wrong: Counter[tuple[str, str, str]] = Counter()
    for k in range(count):
        rng = np.random.default_rng([seed, len(KINDS), k])
        one = draw(rng, "sound")
        other = worse(rng, one)
        if not other.frf.valid.any():
            continue
        change = other.kind, one.outcome(), other.outcome()
        found[change] += 1
        wrong[change] += bool(other.wrong(change[2]))
        if change[2] == "passed" != change[1]:
            print(f"{change}: {k}, {'wrong' if other.wrong('passed') else 'right'}", flush=True)
    for change, n in sorted(found.items()):
        yield [*change, n, wrong[change]]


def _write(name: str, columns: tuple[str, ...], table: Iterator[list]) -> int:
    made = list(table)
    with (HERE / name).open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(columns)
        out.writerows(made)
    for row in made:
        print(", ".join(map(str, row)))
    return sum(sum(row[6:8]) if len(row) > 5 else row[4] for row in made)


def main(count: int = 800, seed: int = 28) -> int:
    """Write spoiled.csv and law.csv; 1 where an answer is wrong."""
    wrong = _write("spoiled.csv", COLUMNS, rows(count, seed))
    wrong += _write("law.csv", ("made worse", "before", "after", "loops", "wrong"), law(2000 * count // 800, seed))
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
