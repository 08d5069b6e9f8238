"""The dual-stage hard disk: score the reference, tune one set of controllers for nine plants, verify in simulation."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from hdd_benchmark import HALF, NAMES, Benchmark, System, read_controllers, write_controllers  # noqa: E402
from hdd_forecast import Forecast, nodes_hz, run_out_variance, tuning_nodes  # noqa: E402
from hdd_limit import closed, filters, least, lifted  # noqa: E402
from hdd_rows import Limits, margins  # noqa: E402
from hdd_tuning import Roots, Tuner, resonators, search  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from loopshape.core.units import TWO_PI, Array, db  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.view.style import new_figure, png, styled  # noqa: E402

#: limits are tuned to this much inside, for what lies between nodes
PEAK_DB, GAIN_DB, PHASE_DEG, LOW_DB = 0.03, 0.05, 0.2, 0.03
#: other seeds, the rotation's first
SEEDS = (101, 201)
#: damping of the resonators at the fan's modes at first
DAMPING = 0.03
#: searches one after the other: widest gap between nodes, most steps, first radius
WIDEST_HZ, STEPS, RADII = (70.0, 20.0), (150, 150), (0.05, 0.05)
#: a pole at 1 drifts (both actuators against each other, unseen) and counts as stable
DRIFT = 1e-6
#: dense nodes on which margins are read
DENSE = (8.0, 1.003)
COLUMNS = (
    "controllers", "case", "three_sigma", "forecast", "peak_S_db", "gain_margin_db", "phase_margin_deg",
    "low_S_over_reference_db", "largest_pole", "largest_stroke_nm",
)  # fmt: skip
LIMIT = ("case", "no_controller_below", "its_peak_S_db", "other_plants_stable", "reference", "tuned")


def main() -> None:
    """Tune one set for nine plants, verify it and the reference; two tables, the controllers and a figure."""
    benchmark = Benchmark()
    reference = benchmark.reference()
    dense = Forecast(benchmark, nodes_hz(*DENSE))
    low = tuned([Forecast(benchmark, tuning_nodes(benchmark, widest_hz)) for widest_hz in WIDEST_HZ], reference)
    found = {key: one.system() for key, one in zip(NAMES, low, strict=True)}
    write_controllers(HERE / "controllers_tuned.json", found, "tuned by loopshape")
    sets = {"reference": reference, "tuned": read_controllers(HERE / "controllers_tuned.json")}
    rows = [row for name, one in sets.items() for row in verified(benchmark, dense, name, one, reference)]
    _write("cases.csv", COLUMNS, rows)
    _write("seeds.csv", ("controllers", "first_seed", "worst_three_sigma"), seeds(benchmark, sets))
    _write("limit.csv", LIMIT, limit(benchmark, dense, sets))
    write_bytes_whole(HERE.parent.parent / "figures" / "hdd" / "sensitivity.png", png(sensitivities(dense, sets)))


def inside() -> Limits:
    """The limits and a little more, without one on |S| at low frequency."""
    asked = Limits()
    return Limits(asked.peak_db - PEAK_DB, asked.gain_db + GAIN_DB, asked.phase_deg + PHASE_DEG)


def low_limits(forecast: Forecast, reference: Mapping[str, System]) -> Array:
    """The reference's |S| (cases, n) in dB, a little lower."""
    L = forecast.loops(forecast.K(dict(reference)))
    return np.asarray(-db(np.abs(1.0 + L)) - LOW_DB)


def tuned(forecasts: Sequence[Forecast], reference: Mapping[str, System]) -> list[Roots]:
    """Controllers and filters with |S| up to 1 kHz below the reference's, on coarse nodes first and then on dense ones.

    From the reference's, with resonators at the fan's modes that do nothing yet.
    """
    roots = [Roots.of(reference[name]) for name in NAMES]
    roots[1] = roots[1].with_pairs(resonators(forecasts[0].benchmark.fan().w / TWO_PI, DAMPING))
    for forecast, most, radius in zip(forecasts, STEPS, RADII, strict=True):
        limits = replace(inside(), low_db=low_limits(forecast, reference))
        roots = search(Tuner(forecast, limits), roots, most, radius, say=print)
    return roots


def verified(
    benchmark: Benchmark,
    forecast: Forecast,
    name: str,
    controllers: Mapping[str, System],
    first: Mapping[str, System],
) -> Iterator[list[str]]:
    """A row a case: simulated score, forecast, margins on dense nodes, poles of the sampled loop, the PZT's stroke."""
    K = forecast.K(dict(controllers))
    L, given = forecast.loops(K), benchmark.disturbances()
    out = run_out_variance(benchmark, lambda other: other.K(dict(controllers)))
    sigma, read = forecast.three_sigma(K, L, out), list(margins(L))
    below = forecast.f <= 1000.0
    over = -db(np.abs(1.0 + L)) + db(np.abs(1.0 + forecast.loops(forecast.K(dict(first)))))
    for k, case in enumerate(benchmark.cases):
        y, stroke = benchmark.head(case, controllers, given)
        pole = np.abs(np.linalg.eigvals(sampled_loop(benchmark, k, controllers))).max()
        numbers = (benchmark.three_sigma(y), sigma[k], *astuple(read[k]), over[k, below].max())
        yield [name, str(k + 1), *(f"{x:.4g}" for x in numbers), f"{pole:.6f}", f"{1e9 * stroke:.4g}"]


def sampled_loop(benchmark: Benchmark, case: int, controllers: Mapping[str, System]) -> Array:
    """State matrix of the closed loop from sector to sector, all states at once."""
    parts = []
    for actuator, plant in enumerate(benchmark.plants(benchmark.cases[case])):
        F, G = plant.held(HALF * benchmark.step_s)
        n = 2 * len(F)
        A, B, C = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        for i in range(len(F)):
            A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], B[2 * i : 2 * i + 2], C[2 * i] = F[i], G[i], 1.0
        parts.append((A, B, C, controllers[NAMES[actuator + 2]], controllers[NAMES[actuator]]))
    sizes = [(len(A), len(f.A), len(c.A)) for A, _, _, f, c in parts]
    total = sum(map(sum, sizes))
    out = np.zeros((total, total))
    for column in range(total):
        x = np.eye(total)[column]
        out[:, column] = _one_sector(parts, sizes, x)
    return out


def _one_sector(parts: list, sizes: list, x: Array) -> Array:
    """States (n,) a sector later, without disturbances."""
    cut = np.split(x, np.cumsum([size for one in sizes for size in one])[:-1])
    e, after = -sum(C @ cut[3 * k] for k, (_, _, C, _, _) in enumerate(parts)), []
    for k, (A, B, _, F, Cd) in enumerate(parts):
        plant, filt, own = cut[3 * k : 3 * k + 3]
        u = Cd.C @ own + Cd.D * e
        for _ in range(2):
            v = F.C @ filt + F.D * u
            plant, filt = A @ plant + B * v, F.A @ filt + F.B * u
        after += [plant, filt, Cd.A @ own + Cd.B * e]
    return np.concatenate(after)


def seeds(benchmark: Benchmark, sets: Mapping[str, Mapping[str, System]]) -> Iterator[list[str]]:
    """Worst scores with the benchmark's and with other seeds."""
    for first in (1, *SEEDS):
        given = benchmark.disturbances(range(first, first + 14))
        for name, one in sets.items():
            worst = max(benchmark.three_sigma(benchmark.head(case, one, given)[0]) for case in benchmark.cases)
            yield [name, str(first), f"{worst:.4g}"]


def limit(benchmark: Benchmark, forecast: Forecast, sets: Mapping[str, Mapping[str, System]]) -> Iterator[list[str]]:
    """The least 3 sigma of each plant alone without the run-out, what reaches it, and the sets' own without it."""
    kept = {name: forecast.K(dict(one)) for name, one in sets.items()}
    sigma = {name: forecast.three_sigma(K, forecast.loops(K)) for name, K in kept.items()}
    plants = [lifted(benchmark, case) for case in benchmark.cases]
    for k, plant in enumerate(plants):
        found = least(plant)
        own = forecast.loops(filters(benchmark, plant, found, forecast))[k]
        held = sum(
            np.abs(np.linalg.eigvals(closed(other, plant, found))).max() < 1.0 + DRIFT
            for other in plants
            if other is not plant
        )
        numbers = (found.three_sigma, np.max(-db(np.abs(1.0 + own))), held, sigma["reference"][k], sigma["tuned"][k])
        yield [str(k + 1), *(f"{x:.4g}" for x in numbers)]


@styled()
def sensitivities(forecast: Forecast, sets: Mapping[str, Mapping[str, System]]) -> Figure:
    """|S| at all nine plants under each set."""
    figure = new_figure(1, 1, (7.0, 4.0))
    (axes,) = figure.axes
    for (name, one), colour in zip(sets.items(), ("0.6", "C0"), strict=True):
        S = -db(np.abs(1.0 + forecast.loops(forecast.K(dict(one)))))
        axes.semilogx(forecast.f, S.T, color=colour, lw=0.6, label=[name, *[None] * 8])
    axes.set(xlim=(100.0, 25200.0), ylim=(-60.0, 10.0), xlabel="frequency [Hz]", ylabel="|S| at the sectors [dB]")
    axes.axhline(Limits().peak_db, color="k", lw=0.5, label=f"limit {Limits().peak_db:g} dB")
    axes.set_title("Nine plants under one set of controllers")
    axes.legend()
    return figure


def _write(name: str, columns: tuple[str, ...], rows: Iterator[list[str]] | list[list[str]]) -> None:
    rows = list(rows)
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    for row in rows:
        print("  ".join(row))


if __name__ == "__main__":
    main()
