"""Benchmarks against peers, printed as ratios measured in this run; `make speed`. No gate: a loaded machine lies.

The workload of the arm is stated because it matters: tracking steps of +-20 deg with noise and converters on.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from arm_workload import SECONDS, all_effects, biquads, experiments, references, start
from scipy.integrate import solve_ivp

HERE = Path(__file__).parent


def best(run: Callable[[], object], repeats: int = 5) -> float:
    """Least wall time of a few runs, in s, after one that warms caches and memory."""
    run()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        run()
        times.append(time.perf_counter() - begun)
    return min(times)


def interleaved(
    first: Callable[[], object],
    second: Callable[[], object],
    rounds: int = 9,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, float]:
    """Least times of two runs that take turns, so that both see the same machine; the wall's unless told."""
    first(), second()
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for k, run in enumerate((first, second)):
            begun = clock()
            run()
            times[k].append(clock() - begun)
    return min(times[0]), min(times[1])


def c_arm(folder: Path) -> Callable[[], object]:
    """The plain C arm, compiled here with cc -O3, on the workload."""
    library = folder / "arm1.so"
    compiler = os.environ.get("CC", "cc")
    command = [compiler, "-O3", "-std=c99", "-shared", "-fPIC", "-o", str(library), str(HERE / "arm1.c"), "-lm"]
    subprocess.run(command, check=True)
    run = ctypes.CDLL(str(library)).arm1_run
    run.restype = ctypes.c_int
    r, n = references(), references().shape[0]
    injected, out = np.zeros((n, 2)), np.zeros((n, 7))
    sections = biquads()

    def pointer(a: np.ndarray) -> ctypes.c_void_p:
        return a.ctypes.data_as(ctypes.c_void_p)

    def go() -> None:
        x = start()
        ended = run(
            n, pointer(r), pointer(injected), pointer(sections), sections.shape[1], pointer(x),
            ctypes.c_longlong(12345678901), 1, pointer(out),
        )  # fmt: skip
        assert ended == 0, "the C arm left its range"

    return go


def our_arm(moves: dict[str, float] | None = None) -> Callable[[], object]:
    """Our kernel on the same workload, one call, no Python inside; with parameters moved."""
    from loopshape.toolbox.arm.dynamics import closed_loop as kernel
    from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants, sensor_constants
    from loopshape.toolbox.gap.noise import start_state

    vector = ARM1_PARAMETERS.vector({"range_low_bar": 0.0, "range_high_bar": 10.0} | (moves or {}))
    c, sensors = constants(vector), sensor_constants(vector)
    x, r, n = start(), references(), references().shape[0]
    injected, out = np.zeros((n, 2)), np.zeros((n, kernel.MEASURED))
    sections = biquads()
    inputs = kernel.Inputs(r, injected, kernel.CONTROLLER_INPUT, True, start_state(1))

    def go() -> None:
        arm, loops = kernel.at_rest(c, x.copy()), kernel.plain_controllers(sections[0], sections[1][:2])
        ended, _ = kernel.run(arm, sensors, loops, inputs, kernel.Pwm(1e-3, 20, 0.01), kernel.EDGES, 1, out)
        assert ended == kernel.COMPLETE, "the arm left its range"

    return go


def c_arm2(folder: Path) -> Callable[[], object]:
    """The plain C arm of two joints, compiled here with cc -O3, on its workload."""
    import arm2_workload as work

    library = folder / "arm2.so"
    compiler = os.environ.get("CC", "cc")
    command = [compiler, "-O3", "-std=c99", "-shared", "-fPIC", "-o", str(library), str(HERE / "arm2.c"), "-lm"]
    subprocess.run(command, check=True)
    run = ctypes.CDLL(str(library)).arm2_run
    run.restype = ctypes.c_int
    r, sections, rested = work.references(), work.biquads(), work.start()
    injected, out = np.zeros_like(r), np.zeros((len(r), 14))

    def pointer(a: np.ndarray) -> ctypes.c_void_p:
        return a.ctypes.data_as(ctypes.c_void_p)

    def go() -> None:
        x = rested.copy()
        ended = run(
            len(r), pointer(r), pointer(injected), pointer(sections), sections.shape[1], pointer(x),
            ctypes.c_longlong(12345678901), 1, pointer(out),
        )  # fmt: skip
        assert ended == 0, "the C arm left its range"

    return go


def our_arm2() -> Callable[[], object]:
    """Our kernel of two joints on the same workload, one call, no Python inside."""
    import arm2_workload as work

    from loopshape.toolbox.arm.dynamics import closed_loop2 as kernel
    from loopshape.toolbox.arm.dynamics.closed_loop import COMPLETE, CONTROLLER_INPUT, Inputs, Pwm, plain_controllers
    from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2, sensor_constants2
    from loopshape.toolbox.gap.noise import start_state

    vector = ARM2_PARAMETERS.vector()
    c, sensors = constants2(vector), sensor_constants2(vector)
    r, sections, rested = work.references(), work.biquads(), work.start()
    injected, out = np.zeros_like(r), np.zeros((len(r), kernel.MEASURED))
    injected.setflags(write=False)  # as an experiment's, so that one compiled kernel serves both
    inputs = Inputs(r, injected, CONTROLLER_INPUT, True, start_state(1))

    def go() -> None:
        loops = plain_controllers(sections[0], sections[1], sections[2][:1], sections[3][:1])
        ended, _ = kernel.run2(c, sensors, rested.copy(), loops, inputs, Pwm(1e-3, 20, 0.01), 1, out)
        assert ended == COMPLETE, "the arm left its range"

    return go


def lanes() -> None:
    """Print what several arms in the lanes of one vector loop in C gain over the plain C arm."""
    from lanes_workload import table

    with tempfile.TemporaryDirectory() as folder:
        for one in table(Path(folder)):
            line(*one)


def batch(threads: int) -> Callable[[], object]:
    """Eight arms through the plant, recordings and all."""
    from loopshape.toolbox.arm.arm1 import Arm1

    plant, todo = Arm1(), experiments(8)
    return lambda: plant.simulate(todo, threads=threads)


def solve_ivp_arm(seconds: float) -> Callable[[], object]:
    """scipy's solve_ivp (RK45, rtol 1e-6) on the same closed loop, noise off, restarted at each tick and edge."""
    from loopshape.core.kernels import biquads as cascade
    from loopshape.toolbox.arm.dynamics.model import derivatives
    from loopshape.toolbox.arm.dynamics.pwm import pulse_s
    from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants

    c, r, sections = constants(ARM1_PARAMETERS.vector()), references(seconds), biquads()

    def rates(_t: float, x: np.ndarray, in_a: bool, in_b: bool, out_a: bool, out_b: bool) -> np.ndarray:
        d = derivatives(c, tuple(x[:5]), (in_a, in_b, out_a, out_b))
        return np.array([d[0], d[1], d[2], x[4], d[3]])

    def go() -> float:
        x, state, u, close = start()[:5], np.zeros((2, 4, 2)), (0.0, 0.0), (0.0, 0.0)
        for tick in range(r.shape[0]):
            z_theta = cascade.step(sections[0], state[0], r[tick, 0] - x[3])
            z_p = cascade.step(sections[1], state[1], 1e-5 * (r[tick, 1] - x[1] - x[2]))
            begin = (tick % 20) * 1e-3
            if begin == 0.0:
                u = (z_theta + z_p, z_p - z_theta)
                close = (pulse_s(u[0], 0.02, 0.01), pulse_s(u[1], 0.02, 0.01))
            stops = sorted({t for t in close if begin < t < begin + 1e-3} | {begin, begin + 1e-3})
            for now, then in pairwise(stops):
                on = [now < t for t in close]
                valves = (on[0] and u[0] > 0, on[1] and u[1] > 0, on[0] and u[0] < 0, on[1] and u[1] < 0)
                x = solve_ivp(rates, (now, then), x, args=valves, rtol=1e-6, atol=1e-9).y[:, -1]
        return float(x[3])

    return go


def first_call(cached: bool) -> float:
    """Seconds from starting Python to the end of a first short simulation, with a filled or an empty cache."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from arm_workload import experiments;"
        "from loopshape.toolbox.arm.arm1 import Arm1; Arm1().simulate(experiments(1, 1.0))"
    )
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | ({} if cached else {"NUMBA_CACHE_DIR": folder})
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", code, str(HERE)], check=True, env=environment)
        return time.perf_counter() - begun


#: what the global optimisers are given, in times of what the tuner takes
TIMES = 100.0


def tuning() -> None:
    """Print how long 24 FRFs of 500 lines take to tune, and what peers reach within the same limits."""
    from tune_peers import annealing, bare, evolution, lqg, rule_of_thumb
    from tune_workload import frfs, requirements

    from loopshape.design.tune import Search, tune

    plants, required = frfs(500), requirements()
    tune(plants[:2], required, search=Search(starts=2, draws=4))  # compiles
    begun = time.process_time()
    found = tune(plants, required)
    taken, ours = time.process_time() - begun, found.bandwidth_hz
    line("tune, 24 FRFs of 500 lines, one core", taken, f"s; lowest bandwidth {ours:.4g} Hz")
    least = bare(found.controller, plants, required)
    line("  bare: L and margins on all lines, 200 times", least, f"s, ours {taken / least:.1f} times")
    for name, peer in (
        (f"scipy's differential evolution, {TIMES:g} times as long", lambda: evolution(TIMES * taken)),
        (f"scipy's dual annealing, {TIMES:g} times as long", lambda: annealing(TIMES * taken)),
        ("LQG of python-control, best of 144", lqg),
        ("rule: notch, lead at crossover, best gain", rule_of_thumb),
    ):
        begun = time.process_time()
        reached = peer()
        spent = time.process_time() - begun
        line(
            f"  {name}",
            reached,
            f"Hz, ours {ours / max(reached, 1e-9):.3f} of it, in {spent / taken:.2g} times our time",
        )


def two_joints() -> None:
    """Print how fast the 2-DoF arm runs, and how that compares with plain C."""
    with tempfile.TemporaryDirectory() as folder:
        ours, peer = interleaved(our_arm2(), c_arm2(Path(folder)), clock=time.process_time)
    line("2-DoF arm, closed loop, exact edges, one core", SECONDS / ours, "simulated s/s")
    line("  plain C (-O3), same workload", SECONDS / peer, f"simulated s/s, ours {peer / ours:.2f} of it")


def main() -> None:
    """Run all and print a table."""
    print(f"{os.cpu_count()} cores; arm workload: {SECONDS:.0f} s of tracking steps, noise and converters on")
    with tempfile.TemporaryDirectory() as folder:
        ours, peer = interleaved(our_arm(), c_arm(Path(folder)), clock=time.process_time)
    effects, nominal = interleaved(our_arm(all_effects()), our_arm(), clock=time.process_time)
    speed = SECONDS / ours
    line("arm, closed loop, exact edges, one core", speed, "simulated s/s")
    line("  plain C (-O3), same workload", SECONDS / peer, f"simulated s/s, ours {peer / ours:.2f} of it")
    line("  all 21 effects on", SECONDS / effects, f"simulated s/s, {nominal / effects:.2f} of the nominal arm's")
    two_joints()
    lanes()
    one, two = interleaved(batch(1), batch(2), 3)
    line("8 recordings through the plant, 1 thread", 8 * SECONDS / one, "simulated s/s")
    line("  2 threads", 8 * SECONDS / two, f"simulated s/s, {one / two:.2f} times as fast")
    ivp = 3.0 / best(solve_ivp_arm(3.0), 2)
    line("scipy's solve_ivp, same arm, noise off, 3 s", ivp, f"simulated s/s, {ivp / speed:.5f} of ours")
    line("first call, empty cache, Python's start included", first_call(False), "s")
    line("  filled cache", first_call(True), "s")
    start_up()
    tour()
    frf()
    long_recording()
    million()
    runs()
    tuning()
    campaign()
    gap()


def start_up() -> None:
    """`loopshape --help` and `import loopshape` as processes, against an interpreter with typer and rich."""

    def process(code: str) -> Callable[[], object]:
        return lambda: subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)

    asked = "import sys; sys.argv = ['loopshape', '--help']; from loopshape.cli import script; script()"
    parts = "import typer, rich.console, rich.table, rich.panel, importlib.metadata"
    help_s, bare = interleaved(process(asked), process(parts))
    line("loopshape --help", help_s, f"s, {help_s / bare:.2f} of an interpreter with typer and rich")
    import_s, empty = interleaved(process("import loopshape"), process("pass"))
    line("import loopshape", import_s - empty, f"s beside an empty interpreter's {empty:.3f}")


def tour() -> None:
    """Each command of the tour on the motor bench against loading what it stands on."""
    from tour_workload import table

    for name, taken, bare in table():
        line(f"tour, {name}, warm", taken, f"s of CPU, {taken / bare:.2f} times loading what it stands on")


def frf() -> None:
    """A 2 x 2 FRF of 20 minutes at 1 kHz against pairwise csd and the bare transforms, and its memory."""
    from frf_workload import bare_transforms, local, ours, pairwise, peak_megabytes, signals

    six = signals()
    taken, bare = interleaved(ours(six), bare_transforms(six), 5)
    _, pairs = interleaved(lambda: None, pairwise(six), 2)
    line("2 x 2 FRF of 20 minutes at 1 kHz, covariance too", taken, "s")
    line("  the bare transforms", bare, f"s, ours takes {taken / bare:.2f} times that")
    line("  pairwise scipy.signal.csd", pairs, f"s, ours is {pairs / taken:.1f} times as fast")
    few, many = peak_megabytes(10), peak_megabytes(40)
    line("  memory beside the record, 10 minutes", few, f"MB; 40 minutes {many:.3g} MB")
    fits, bare = interleaved(*local(), 3, clock=time.process_time)
    line(
        "local fits of 60 s at 1 kHz, covariance too", fits, f"s of one core, {fits / bare:.2f} of 100 bare transforms"
    )


def long_recording() -> None:
    """A quarter of an hour at 10 kHz from the disk to its FRF, against reading it and the bare transforms."""
    from long_workload import ours, reading_and_transforms, written

    with tempfile.TemporaryDirectory() as folder:
        run = written(Path(folder) / "run")
        taken, bare = interleaved(ours(run), reading_and_transforms(run), 3, clock=time.process_time)
    line(
        "9 million rows from the disk to an FRF", taken, f"s of one core, {taken / bare:.2f} of reading and transforms"
    )


def million() -> None:
    """An FRF of a million frequencies, checked, drawn and reported."""
    from million_workload import table

    for one in table():
        line(*one)


def runs() -> None:
    """Import beside reading the file, and memory against the number of recordings."""
    from runs_workload import importing, megabytes

    taken, most, reading, least = importing()
    line("import of a CSV file of 3 million rows", taken, f"s of one core, {taken / reading:.1f} times reading it")
    line("  its memory", most, f"MB; reading it {least:.0f} MB")
    for rows in (160_000, 320_000):
        some, twice = megabytes(60, rows), megabytes(120, rows)
        for what, few, many in zip(("verify", "frf"), some, twice, strict=True):
            text = f"{what} of 60 recordings of {24e-6 * rows:.1f} MB, memory"
            line(text, few, f"MB; of 120 {many:.0f} MB, {many / few:.3f} times")


def campaign() -> None:
    """A campaign's recording of 100 s, written, against its simulation alone, on one worker and on two."""
    from toolbox.campaign_workload import table

    bare, two_bare, one, two = table()
    line("a recording of 100 s simulated in memory", bare, "s")
    line("  two such at once, a recording", two_bare, f"s, {bare / two_bare:.2f} times as fast")
    line("campaign, a recording of 100 s, one worker", one, f"s, {one / bare:.2f} times its simulation in memory")
    line("  two workers", two, f"s, {one / two:.2f} times as fast, {two / two_bare:.2f} times two simulations at once")


def gap() -> None:
    """The diagnosis of a user's own machine against its simulations, as many ticks of the equations alone."""
    from toolbox.gap_workload import seconds

    whole, simulations = seconds()
    line("gap of a user's own axis, 60 s at 500 Hz", whole, f"s of one core, {whole / simulations:.2f} of simulations")


def line(what: str, value: float, unit: str) -> None:
    """One line of the table."""
    print(f"{what:50s} {value:8.4g} {unit}")


if __name__ == "__main__":
    main()
