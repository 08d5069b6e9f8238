"""How honest: the share of errors that lie within the 95 % region that an estimate states, with the truth known."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from known import (
    LOOP,
    RATE_HZ,
    Plant,
    closed,
    matrix_response,
    matrix_run,
    matrix_signals,
    noise_records,
    one_resonance,
    recording,
    white,
)
from scipy.stats import f as f_distribution

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.signal.recording import Recording
from loopshape.identify.frequency_response import estimate_frf, estimate_realisations
from loopshape.identify.matrix.matrix import estimate_matrix
from loopshape.identify.settings import Settings
from loopshape.toolbox.rig.excitation.excitation import Sweep
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.files.excitation_sets import orthogonal

BAND_HZ = (1.0, 15.0)
PLACES = {"control": "open", "controller_input": "closed, n at the controller", "plant_input": "closed, n at the plant"}
#: signal to noise in the output's rms
LOW, HIGH = 60.0, 20.0
#: rank of the sensors' noise, and Monte Carlo draws behind the quantile of a matrix
SENSORS, DRAWS = 2, 100_000
COLUMNS = (
    "estimator", "loop", "plant", "snr_db", "test", "records", "coverage", "standard_error", "freedom",
    "error_over_stated", "verdict",
)  # fmt: skip


@dataclass(frozen=True)
class Found:
    """Errors of one record: whether each line's lies inside, its square over the stated one, and the freedom stated."""

    inside: np.ndarray
    over_stated: Array
    freedom: float


def element(frf: FRF, truth: ComplexArray) -> Found:
    """|d|² < variance x F(0.95; 2, freedom), for every line and element (nf, ny, nu) in the band."""
    variance = frf.variance
    share = np.abs(frf.response - truth) ** 2 / variance
    return Found(share < f_distribution.ppf(0.95, 2, frf.variance_freedom), share, frf.variance_freedom)


def joint(frf: FRF, truth: ComplexArray, kind: str) -> Found:
    """d^H C^-1 d of d = vec(P) against its 95 % quantile (`joint_quantile`)."""
    d = (frf.response - truth).transpose(0, 2, 1).reshape(len(truth), -1)
    distance = np.einsum("fi,fi->f", d.conj(), np.linalg.solve(frf.covariance, d[:, :, None])[:, :, 0]).real
    return Found(distance < joint_quantile(frf.variance_freedom, kind), distance / d.shape[1], frf.variance_freedom)


@cache
def joint_quantile(freedom: float, kind: str) -> float:
    """95 % quantile of d^H C^-1 d for the two columns of a matrix, each with the noise of two sensors.

    `shared`: one estimate S of the sensors' noise, a complex Wishart of half the freedom, serves both (the trace of
    Lawley and Hotelling). `each`: every column has its own (a sum of two of Hotelling's T²). `block`: recordings of a
    block have each its own, with a share of the freedom. `full`: all four elements scatter together between
    realisations, Hotelling's T² of four, p k/(k - p + 1) F(2 p, 2 (k - p + 1)). But for `full` by simulation.
    """
    k = 0.5 * freedom / (SENSORS if kind == "block" else 1)
    if kind == "full":
        p = SENSORS**2
        return float(p * k / (k - p + 1) * f_distribution.ppf(0.95, 2 * p, 2 * (k - p + 1)))
    rng, total = np.random.default_rng(1), np.zeros(DRAWS)
    for column in range(SENSORS):
        if column == 0 or kind != "shared":
            c11, c22 = np.sqrt(rng.gamma(k, size=DRAWS)), np.sqrt(rng.gamma(k - 1.0, size=DRAWS))
            c21 = _circular(rng)
        z1, z2 = _circular(rng), _circular(rng)
        w1 = z1 / c11  # by Bartlett's triangle
        total += np.abs(w1) ** 2 + np.abs((z2 - c21 * w1) / c22) ** 2
    return float(np.quantile(k * total, 0.95))


def _circular(rng: np.random.Generator) -> ComplexArray:
    return np.asarray((rng.standard_normal(DRAWS) + 1j * rng.standard_normal(DRAWS)) / np.sqrt(2.0))


def row(estimator: str, loop: str, plant: str, snr_db: float, test: str, found: Sequence[Found]) -> list:
    """One line of the table; the standard error takes records as units, since neighbouring lines share their error."""
    shares = np.array([x.inside.mean() for x in found])
    coverage, error = float(shares.mean()), float(shares.std(ddof=1) / np.sqrt(len(shares)))
    rms = float(np.sqrt(np.mean([x.over_stated.mean() for x in found])))
    freedom = round(float(np.median([x.freedom for x in found])), 1)
    return [
        estimator,
        loop,
        plant,
        snr_db,
        test,
        len(found),
        round(coverage, 4),
        round(error, 4),
        freedom,
        round(rms, 3),
        verdict(coverage, error),
    ]


def verdict(coverage: float, error: float) -> str:
    """Inside 93-97 %, outside by less than two standard errors (undecided), or outside."""
    away = max(0.93 - coverage, coverage - 0.97)
    return "inside" if away <= 0.0 else ("undecided" if away < 2.0 * error else "outside")


def within(frf: FRF) -> FRF:
    """Lines in the band."""
    return frf.between(*BAND_HZ)


# --- one loop --------------------------------------------------------------------------------------------------------


def plant_at(damping: float, place: str) -> Plant:
    """The one resonance; with its controller where the loop is closed."""
    made = one_resonance(damping)
    return made if place == "control" else closed(made)


def noise_rows() -> Iterator[list]:
    """White noise of 30 s: Welch's default setting, local fits, and the automatic choice."""
    for damping in (0.02, 0.2):
        for place in PLACES:
            for snr_db in (LOW, HIGH):
                truth = plant_at(damping, place)
                records = noise_records(truth, place, 30.0, snr_db, 24, round(1000 * damping) + round(snr_db))
                many = noise_records(truth, place, 30.0, snr_db, 60, 7)
                found = [within(estimate_frf(r, LOOP, Settings(method="auto"))) for r in records]
                local = [x if ", local" in x.method else _local(r) for x, r in zip(found, records, strict=True)]
                welch = [within(estimate_frf(r, LOOP, Settings(method="welch"))) for r in many]
                for word, frfs in (("Welch", welch), ("local", local), ("auto", found)):
                    yield siso_row(f"{word}, noise", place, f"damping {damping}", snr_db, frfs, truth)


def _local(record: Recording) -> FRF:
    return within(estimate_frf(record, LOOP, Settings(method="local")))


def siso_row(word: str, place: str, plant: str, snr_db: float, frfs: Sequence[FRF], truth: Plant) -> list:
    """Coverage of one loop's FRFs."""
    found = [element(x, truth.response(x.frequency_hz)[:, None, None]) for x in frfs]
    return row(word, PLACES[place], plant, snr_db, "element", found)


def repeated_records(
    plant: Plant, place: str, kind: str, n: Array, snr_db: float, records: int, seed: int, **said: object
) -> list[Recording]:
    """Recordings of one excitation (n,) or one each (records, n), with white noise on the sensor; starts at rest."""
    n = np.broadcast_to(n, (records, n.shape[-1]))
    clean = plant.run(place, n[:1], np.zeros((1, n.shape[1])))[1]
    v = clean.std() * 10.0 ** (-snr_db / 20.0) * white(np.random.default_rng(seed), *n.shape)
    z, y = plant.run(place, n, v)
    return [recording(place, kind, *x, **said) for x in zip(n, z, y, strict=True)]


def periodic_rows() -> Iterator[list]:
    """Multisines of 4 s, one realisation, two and five periods after 8 s to settle."""
    for place in PLACES:
        for periods in (2, 5):
            for snr_db in (LOW, HIGH):
                plant = plant_at(0.05, place)
                n = Multisine(0.25, 40.0, 4.0, 1.0, periods=periods + 2, seed=1, ramp_s=0.0).signal(RATE_HZ)
                records = repeated_records(
                    plant, place, "multisine", n, snr_db, 100, 3, period_s=4.0, periodic_from_s=8.0
                )
                frfs = [within(estimate_frf(r, LOOP)) for r in records]
                yield siso_row(f"{periods} periods", place, "damping 0.05", snr_db, frfs, plant)


def sweep_rows() -> Iterator[list]:
    """A sweep up and down of 60 s."""
    n = Sweep(0.5, 25.0, 60.0, 1.0).signal(RATE_HZ)
    for damping in (0.05, 0.2):
        for place in PLACES:
            for snr_db in (LOW, HIGH):
                plant = plant_at(damping, place)
                records = repeated_records(plant, place, "sweep", n, snr_db, 60, 4)
                frfs = [within(estimate_frf(r, LOOP)) for r in records]
                yield siso_row("sweep", place, f"damping {damping}", snr_db, frfs, plant)


# --- realisations on a nonlinear plant -------------------------------------------------------------------------------

CUBE = 0.3


def bent(place: str, n: Array, v: Array) -> tuple[Array, Array]:
    """z and y (records, samples) of a plant whose input bends, u + 0.3 u³, before a resonance; 0.5 closes its loop."""
    plant = one_resonance(0.1)
    if place == "control":
        return n, plant.run("control", n + CUBE * n**3, v)[1]
    z, y, (b, a) = np.empty_like(n), np.empty_like(n), (plant.B, plant.A)
    old_w, old_x = np.zeros((2, len(n))), np.zeros((2, len(n)))
    for k in range(n.shape[1]):
        x = b[1] * old_w[0] + b[2] * old_w[1] - a[1] * old_x[0] - a[2] * old_x[1]
        y[:, k] = x + v[:, k]
        z[:, k] = 0.1 * ((n[:, k] if place == "controller_input" else 0.0) - y[:, k])
        u = z[:, k] + (n[:, k] if place == "plant_input" else 0.0)
        old_w, old_x = np.stack([u + CUBE * u**3, old_w[0]]), np.stack([x, old_x[0]])
    return z, y


def draws(count: int, seed: int) -> Array:
    """Random-phase multisines (count, samples), two periods to settle and two to use, rms 0.7 throughout."""
    made = [
        Multisine(0.25, 20.0, 4.0, 1.0, periods=4, seed=seed + k, ramp_s=0.0, crest_iterations=0).signal(RATE_HZ)
        for k in range(count)
    ]
    return np.array([0.7 * x / x.std() for x in made])


def bent_level(place: str, snr_db: float) -> float:
    """Noise's standard deviation for a ratio to the output's rms."""
    n = gain_at(place) * draws(1, 1)
    return float(bent(place, n, np.zeros_like(n))[1].std() * 10.0 ** (-snr_db / 20.0))


def gain_at(place: str) -> float:
    """What is injected in front of a controller of gain 0.1 is as strong there as needed."""
    return 5.0 if place == "controller_input" else 1.0


def bent_records(place: str, n: Array, snr_db: float, seed: int) -> list[Recording]:
    """Recordings of the bent plant with noise on its sensor."""
    gain = gain_at(place)
    v = bent_level(place, snr_db) * white(np.random.default_rng(seed), *n.shape)
    z, y = bent(place, gain * n, v)
    return [
        recording(place, "multisine", *x, period_s=4.0, periodic_from_s=8.0) for x in zip(gain * n, z, y, strict=True)
    ]


def realisation_rows() -> Iterator[list]:
    """Realisations on the bent plant: the best linear approximation is that of 2000 draws without noise."""
    for place in PLACES:
        truth = estimate_realisations(bent_records(place, draws(2000, 100_000), np.inf, 0), LOOP)
        truth = within(truth).siso[:, None, None]
        for snr_db in (LOW, HIGH):
            for count in (2, 4, 10):
                records = bent_records(place, draws(40 * count, 1), snr_db, 5)
                groups = [records[k : k + count] for k in range(0, len(records), count)]
                frfs = [within(estimate_realisations(g, LOOP)) for g in groups]
                found = [element(x, truth) for x in frfs]
                yield row(f"{count} realisations", PLACES[place], "cubic", snr_db, "element", found)


def noise_part_rows() -> Iterator[list]:
    """The noise part of realisations' covariance over the noise that was put in, in open loop."""
    for snr_db in (LOW, HIGH):
        level = bent_level("control", snr_db)
        records = bent_records("control", draws(160, 1), snr_db, 5)
        frfs = [within(estimate_realisations(records[k : k + 4], LOOP)) for k in range(0, 160, 4)]
        ratios = []
        for k, frf in enumerate(frfs):
            lines = np.round(frf.frequency_hz * 4.0).astype(int)
            power = [np.abs(np.fft.rfft(r.column("z_v")[-400:])[lines] / 400) ** 2 for r in records[4 * k : 4 * k + 4]]
            known = level**2 / 400 / 2 * np.mean(1.0 / np.array(power), axis=0) / 4
            ratios.append(float(np.mean(frf.noise_covariance[:, 0, 0].real / known)))
        error = float(np.std(ratios, ddof=1) / np.sqrt(len(ratios)))
        ratio = float(np.mean(ratios))
        yield ["4 realisations", "open", "cubic", snr_db, "noise part over known", len(frfs), round(ratio, 4),
               round(error, 4), "", "", "inside" if abs(ratio - 1.0) < 0.05 else "outside"]  # fmt: skip


# --- a matrix --------------------------------------------------------------------------------------------------------


def matrix_rows() -> Iterator[list]:
    """2 x 2 in open and closed loop: noise one loop at a time, noise in both at once, orthogonal multisines."""
    for place in PLACES:
        for snr_db in (LOW, HIGH):
            yield from matrix_noise(place, snr_db, at_once=False)
            yield from matrix_noise(place, snr_db, at_once=True)
            yield from matrix_multisines(place, snr_db)


def matrix_level(place: str, n: Array, snr_db: float) -> float:
    """Standard deviation of the sensors' noise."""
    return float(matrix_signals(place, n, np.zeros_like(n))[1].std() * 10.0 ** (-snr_db / 20.0))


def matrix_noise(place: str, snr_db: float, at_once: bool) -> Iterator[list]:
    """30 s of white noise: local fits on few records, Welch's segments on more."""
    rng, records, size = np.random.default_rng(11), 24, 1000 + 3000
    sets = [(0, 1)] if at_once else [(0,), (1,)]
    n = [white(rng, records, size, 2) * np.isin([0, 1], excited) for excited in sets]
    level = matrix_level(place, n[0][:1], snr_db)
    signals = [matrix_signals(place, x, level * white(rng, *x.shape)) for x in n]
    runs = [
        matrix_run(
            place,
            "noise",
            [(e, x[k, 1000:], z[k, 1000:], y[k, 1000:]) for e, x, (z, y) in zip(sets, n, signals, strict=True)],
        )
        for k in range(records)
    ]
    word = "both at once" if at_once else "one at a time"
    for method, some in (("welch", runs), ("local", runs[:10])):
        frfs = [within(estimate_matrix(r, r.recordings, Settings(method=method))) for r in some]
        yield from matrix_pair(
            f"{'Welch' if method == 'welch' else method}, noise {word}",
            place,
            snr_db,
            frfs,
            "shared" if at_once else "each",
        )


def matrix_pair(word: str, place: str, snr_db: float, frfs: Sequence[FRF], kind: str) -> Iterator[list]:
    """Coverage of the elements, and of all together."""
    truth = [matrix_response(x.frequency_hz) for x in frfs]
    found = [element(x, t) for x, t in zip(frfs, truth, strict=True)]
    yield row(word, PLACES[place], "2 x 2", snr_db, "element", found)
    found = [joint(x, t, kind) for x, t in zip(frfs, truth, strict=True)]
    yield row(word, PLACES[place], "2 x 2", snr_db, "joint", found)


def matrix_multisines(place: str, snr_db: float) -> Iterator[list]:
    """Orthogonal multisines, four periods used: one block, and three realisations of it."""
    for blocks in (1, 3):
        frfs = matrix_blocks(place, snr_db, blocks, seed=17)
        yield from matrix_pair(
            f"orthogonal multisines, {blocks} block{'s' * (blocks > 1)}",
            place,
            snr_db,
            frfs,
            "block" if blocks == 1 else "full",
        )


def matrix_blocks(place: str, snr_db: float, blocks: int, seed: int, records: int = 60) -> list[FRF]:
    """Estimates of many runs of the same blocks, each with its own noise."""
    rng, parts = np.random.default_rng(seed), []
    for block in range(blocks):
        one = {f"l{k}": Multisine(0.25, 30.0, 4.0, 1.0, periods=6, seed=50 * block + k, ramp_s=0.0) for k in (0, 1)}
        parts += [np.stack([s[f"l{k}"].signal(RATE_HZ) for k in (0, 1)], axis=1) for s in orthogonal(one)]
    level = matrix_level(place, parts[0][None], snr_db)
    all_signals = []
    for n in parts:
        n = np.broadcast_to(n, (records, *n.shape))
        all_signals.append((n, *matrix_signals(place, n, level * white(rng, *n.shape))))
    said = {"period_s": 4.0, "periodic_from_s": 8.0}
    runs = [
        matrix_run(place, "multisine", [((0, 1), *(x[k] for x in s)) for s in all_signals], **said)
        for k in range(records)
    ]
    return [within(estimate_matrix(r, r.recordings)) for r in runs]


def all_rows() -> Iterator[list]:
    """The whole table."""
    parts: Iterable[Callable[[], Iterator[list]]] = (
        noise_rows, periodic_rows, sweep_rows, realisation_rows, noise_part_rows, matrix_rows,
    )  # fmt: skip
    for part in parts:
        yield from part()
