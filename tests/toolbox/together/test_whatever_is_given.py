# ruff: noqa: E501
"""Whatever is given to a public function or noun ends in an answer or in a sentence, never in another's exception."""

import warnings
from contextlib import contextmanager
from pathlib import Path

import control
import numpy as np
import pytest

import loopshape as ls

F = np.geomspace(1.0, 200.0, 24)
S = 2j * np.pi * F
N = 600
RATE = 1000.0
G = 50.0 / S * np.exp(-0.001 * S)
NOISE = np.random.default_rng(1).standard_normal((3, N))
U = NOISE[0]
Y = np.convolve(U, [0.0, 0.5, 0.3])[:N]

P = ls.FRF.from_arrays(F, G, relative_std=0.01, rate_hz=RATE)
P2 = ls.FRF.from_arrays(F, np.stack([[G, 0.1 * G], [0.1 * G, G]]).transpose(2, 0, 1), relative_std=0.01, rate_hz=RATE)
C = ls.controller(ls.gain(0.5), rate_hz=RATE)
R = ls.Requirements(sensitivity_peak_db=6.0, integrators=1, unstable_poles=0)
RUN = ls.Run.from_arrays(u=U, y=Y, rate_hz=RATE)
FIT = ls.fit(P, "integrator")
D = ls.diagrams.Diagram((ls.diagrams.Part("C", "e", "u"), ls.diagrams.Part("P", "u", "y", P)), {"e": "r - y"}, "C")
CONTROL = control.tf([50.0], [1.0, 0.0])
MASK = ls.Mask("S", ((0.1, -40.0), (10.0, 0.0)))

ODD = [
    None, True, False, "", "x", "plant-input", b"x", 0, -1, 3, 1.5, -2.5, float("nan"), float("inf"), 1e300, -1e300,
    1e-300, 10**400, 3 + 4j, [], [[]], (), {}, {"a": 1}, {"e": "r - y"}, {1, 2}, [1, [2, 3]], ["a", "b"], [None],
    [1.0, 2.0], (1.0, 2.0), (2.0, 1.0), (1.0, 2.0, 3.0), [(1.0, 2.0)], np.array([]), np.zeros(N), np.ones((2, 3)),
    np.array(5.0), np.full(24, np.nan), np.arange(24), np.arange(24.0)[::-1], np.ones(24, bool), np.ones(24, complex),
    np.zeros((24, 1, 1)), np.zeros((0, 2, 2)), np.array(["a", "b"]), np.array([object(), 1]), F, G, abs(G), 1e300 * F,
    1e200 * Y, 1e-200 * Y, U, Y[:-1], Y.astype(np.float16), (1e3 * Y).astype(np.int8), Y + 1j, np.where(U > 3, np.nan, U),
    np.ma.masked_greater(Y, 1.0), np.datetime64("2024-01-01"), np.arange(N).astype("datetime64[s]"),
    np.arange(N).astype("m8[s]"), np.zeros(3, dtype=[("a", float)]), object(), int, len, lambda f: f, ls, Path("none"),
    Path("/"), "\0", "x" * 5000, np.float32(1.0), np.int64(2), iter([1, 2]), range(24), slice(3),
    P, P2, [P], [P, P2], C, [C, C], R, [R], RUN, FIT, [FIT], D, MASK, [MASK], ls.gain(), ls.gain(1.0), [ls.gain()],
    ls.notch(5.0, 0.1, 0.5), ls.Outcome.PASSED, ls.LoopshapeError("x"),
]  # fmt: skip


def used_frf(P):
    return ls.check(P, C, R), ls.fit(P), repr(P), P.digest


def used_run(run):
    return ls.frf(run), repr(run)


def used_controller(C):
    return ls.check(P, C, R), repr(C), C.digest


def used_requirements(R):
    return ls.check(P, C, R), repr(R)


def used_diagram(D):
    return ls.check(D, C, R), repr(D)


#: what is called -> (function, good arguments by name, what is done with its answer)
CALLS = {
    "Run.from_arrays": (ls.Run.from_arrays, dict(
        u=U, y=Y, rate_hz=RATE, excitation=None, reference=None, injection="controller_input", loop="loop",
        recording="recording", period_s=None, controller=None, operating_point=None), used_run),
    "Run.from_arrays, closed": (ls.Run.from_arrays, dict(
        u=U, y=Y, rate_hz=RATE, excitation=NOISE[1], injection="plant_input", period_s=0.1, controller=C), used_run),
    "FRF.from_arrays": (ls.FRF.from_arrays, dict(
        frequency_hz=F, response=G, relative_std=0.01, inputs=(), outputs=(), rate_hz=RATE, loop="", recording="",
        operating_point={}, open_loop=False, hold="unknown", method="m", notes=(), recorded_under=None), used_frf),
    "FRF.from_arrays, std": (ls.FRF.from_arrays, dict(frequency_hz=F, response=G, std=abs(G), rate_hz=RATE), used_frf),
    "FRF.from_arrays, covariance": (ls.FRF.from_arrays, dict(
        frequency_hz=F, response=G, covariance=abs(G[:, None, None]) ** 2 + 0j), used_frf),
    "FRF.from_arrays, polar": (ls.FRF.from_arrays, dict(
        omega_rad_s=F, magnitude_db=-20.0 + 0 * F, phase_deg=-90.0 + 0 * F, coherence=0.9 + 0 * F, averages=20.0), used_frf),
    "FRF": (ls.FRF, dict(
        frequency_hz=F, response=G[:, None, None], covariance=1e-4 * abs(G[:, None, None]) + 0j, valid=F > 0,
        inputs=("u_1",), outputs=("y_1",), method="m", coherence=None, input_power=None, power_per="Hz",
        line_overlap=1.0, variance_freedom=20.0, variance_pooled=1, parameters={}, averages=10.0, recordings=()), used_frf),
    "FRF.from_control": (ls.FRF.from_control, dict(system=CONTROL, frequency_hz=F), used_frf),
    "to_control": (ls.to_control, dict(frf=P), repr),
    "controller": (lambda a, b, **words: ls.controller(a, b, **words), dict(
        a=ls.gain(2.0), b=ls.pi(1.0), rate_hz=RATE, loop="", prewarp_hz=None, computation_delay_s=0.0,
        added_hold=False, precision="double"), used_controller),
    "Controller": (ls.Controller, dict(
        loop="", blocks=C.blocks, rate_hz=RATE, discretisation="tustin", prewarp_hz=10.0), used_controller),
    "gain": (ls.gain, dict(gain=1.0), repr),
    "lead_lag": (ls.lead_lag, dict(f1_hz=1.0, f2_hz=(1.0, 2.0)), repr),
    "notch": (ls.notch, dict(f_hz=1.0, damping1=0.1, damping2=0.5, f2_hz=None), repr),
    "resonator": (ls.resonator, dict(f_hz=1.0, damping1=0.1, damping2=0.5), repr),
    "low_pass": (ls.low_pass, dict(f_hz=1.0, damping=0.7, order=2), repr),
    "pid": (ls.pid, dict(gain=1.0, fi_hz=1.0, fd_hz=10.0, ff_hz=None), repr),
    "Requirements": (ls.Requirements, dict(
        loop="", gain_margin_db=6.0, phase_margin_deg=30.0, modulus_margin=0.5, sensitivity_peak_db=6.0,
        bandwidth_hz=1.0, control_high_frequency_db=6.0, control_high_frequency_from_hz=50.0, detuning_percent=None,
        masks=(MASK,), weights=(), at=(), band_hz=(1.0, 100.0), structure=(), integrators=1, unstable_poles=0,
        objective=ls.Objective()), used_requirements),
    "Mask": (ls.Mask, dict(response="S", points=((0.1, -40.0), (10.0, 0.0)), sense="at_most"), repr),
    "Weight": (ls.Weight, dict(response="S", size=((0.1, -40.0), (10.0, 0.0))), lambda one: one.at(F)),
    "AtPoints": (ls.AtPoints, dict(where={"p": (1.0, 2.0)}, limits={"gain_margin_db": 3.0}, masks=()),
                 lambda at: used_requirements(ls.Requirements(at=(at,), unstable_poles=0))),
    "Objective": (ls.Objective, dict(
        bandwidth=1.0, disturbance=0.5, disturbance_below_hz=2.0, weighted_norm=0.0), repr),
    "Part": (ls.diagrams.Part, dict(name="P", inputs="u", outputs="y", what=P, integrators=1, unstable_poles=0), lambda part:
             used_diagram(ls.diagrams.Diagram((ls.diagrams.Part("C", "e", "u"), part), {"e": "r - y"}, "C"))),
    "Diagram": (ls.diagrams.Diagram, dict(parts=D.parts, sums={"e": "r - y"}, tuned="C", name=""), used_diagram),
    "Disturbance.from_spectrum": (ls.Disturbance.from_spectrum, dict(
        frequency_hz=F, density=abs(G), recorded_under=None, loop=""), lambda one: ls.check(P, C, R, disturbance=one)),
    "gain_scheduled": (ls.schedules.gain_scheduled, dict(
        controllers=[C, C], at=[{"p": 1.0}, {"p": 2.0}], follows={"p": "loop"}, lag_s=0.1),
        lambda one: (repr(one), one.at({"p": 1.5}))),
    "fixed": (ls.fixed, dict(system=([1.0], [1.0, 2.0]), rate_hz=None, prewarp_hz=None), repr),
    "frf": (ls.frf, dict(run=RUN, loop=None, recording=None, estimator="reference", method="welch",
                         resolution_hz=20.0, overlap=0.5, window="hann", detrend="mean"), repr),
    "frfs": (ls.frfs, dict(run=RUN, loop=None, realisations=False, method="auto", segment_samples=None), repr),
    "frf_matrices": (ls.frf_matrices, dict(run=RUN, method="auto"), repr),
    "fit": (ls.fit, dict(P=P, structure="rational", weighting="variance", numerator=0, denominator=1, integrators=1,
                         delay=False), repr),
    "check": (ls.check, dict(P=P, C=C, R=R, fits=(), together=None, loops=None, recorded_under=(),
                             disturbance=None), repr),
    "check, several": (ls.check, dict(P=P2, C=[C, C], R=[R, R], fits=(), together=None, loops=None,
                                      recorded_under=[C, C]), repr),
    "check, schedule": (ls.check, dict(
        P=P, C=ls.schedules.gain_scheduled([C, C], [{"p": 1.0}, {"p": 2.0}], {"p": "l"}), R=R), repr),
    "check, diagram": (ls.check, dict(P=D, C=C, R=R), repr),
    "predict": (ls.predict, dict(P=P, C=C, fits=(FIT,), seed=0), repr),
    "compare": (ls.compare, dict(run=RUN, predictions=(), tolerance_db=0.0), repr),
    "interaction": (ls.interaction, dict(P=P2, loops=None), repr),
    "tones": (ls.planning.tones, dict(signals=Y, rate_hz=RATE, channels=(), chance=0.01), repr),
    "multirate": (ls.diagrams.multirate, dict(P=P, fast=ls.controller(ls.gain(1.0), rate_hz=4000.0), rate_hz=RATE), used_frf),
    "transfer": (ls.diagrams.transfer, dict(D=D, source="r", to="y", opened=("C",), point=0), used_frf),
    "equivalent": (ls.diagrams.equivalent, dict(D=D), repr),
    "cascade": (ls.diagrams.cascade, dict(G=P2, inner=C, requirements=None, loop="outer"), repr),
    "prefilter": (ls.diagrams.prefilter, dict(P=P, F=ls.controller(ls.low_pass(20.0, order=1), rate_hz=RATE), to="input"), repr),
    "dual_stage": (ls.diagrams.dual_stage, dict(P1=P, P2=P, C2=C, kind="parallel", estimate=None), repr),
    "two_sensors": (ls.diagrams.two_sensors, dict(G=P2, H1=C, H2=C), repr),
    "disturbance_observer": (ls.diagrams.disturbance_observer, dict(
        P=P, nominal=([50.0], [1.0, 0.0]), q_filter=ls.low_pass(20.0, 0.7)), repr),
    "decouple": (ls.diagrams.decouple, dict(P=P2, at_hz=10.0, order=0), repr),
    "feedforward": (ls.learning.feedforward, dict(P=P, band_hz=(1.0, 50.0), taps=8, preview=2, integrators=1), repr),
    "learning": (ls.learning, dict(P=P, C=C, band_hz=(1.0, 50.0), taps=8, preview=2, integrators=1), repr),
    "repetitive": (ls.learning.repetitive, dict(P=P, C=C, period_s=0.1, q_filter=0.9), repr),
    "tracking_error": (ls.learning.tracking_error, dict(P=P, C=C, setpoint=np.minimum(np.arange(N) / 50.0, 1.0), F=None,
                                               integrators=1), repr),
    "simulate": (ls.diagrams.simulate, dict(D=D.with_part("C", C), models={"P": CONTROL}, signals={"r": U}), repr),
    "plan": (ls.planning.plan, dict(run=RUN, recording=None, std=0.05, controllers=C, at_hz=10.0, max_amplitude=1.0,
                           longest_s=60.0, kind="odd"), repr),
    "export": (ls.formats.export, dict(controllers=C, folder=Path("export"), to="json"), repr),
    "write": (ls.write, dict(what=C, path=Path("c.toml")), repr),
    "read": (ls.read, dict(path=Path("none")), repr),
    "read_frf": (ls.formats.read_frf, dict(file=Path("none.csv"), relative_std=0.01, rate_hz=RATE), repr),
    "read_table": (ls.formats.read_table, dict(file=Path("none.csv"), map_file=Path("none.toml")), repr),
    "read_controllers": (ls.read_controllers, dict(file=Path("none.toml")), repr),
    "read_gain_scheduled": (ls.schedules.read_gain_scheduled, dict(file=Path("none.toml")), repr),
    "read_requirements": (ls.read_requirements, dict(file=Path("none.toml")), repr),
    "profiles": (ls.profiles, dict(file=None), repr),
    "report": (ls.report, dict(run_folder=Path("none"), out=None, controllers=None, figures_mb=0.7), repr),
    "gap": (ls.gap, dict(run=RUN, model=None, table=False, name=None), repr),
    "stop": (ls.rig.stop, dict(what="none", clear=False, baud=921600), repr),
    "measure": (ls.rig.measure, dict(study=Path("none.toml"), out=Path("o"), controllers=(), effects=()), repr),
    "campaign": (ls.campaign, dict(file=Path("none.toml"), out=Path("o"), workers=1, part=None), repr),
    "next_trial": (ls.learning.next_trial, dict(L=ls.learning(P, C, band_hz=(1.0, 50.0), taps=8, preview=2, integrators=1),
                                       run=RUN, loop=None, recordings=(), period_s=None), repr),
    "axis": (ls.gap.axis, dict(numbers={}, effort="u_v", position="y_rad", rotary=True, window_s=1.0), repr),
    "shape": (ls.shape, dict(P=P, C=C, R=R, out=Path("shape.html"), fits=()), repr),
    "tune": (ls.tune, dict(P=P, R=R, structure=[ls.gain()], fits=(), start=None, seed=0, starts=1, grow=0,
                           least_gain=0.01, disturbance=None), repr),
    "bound": (ls.limits.bound, dict(P=P, C=C, R=R, fits=()), repr),
    "schedule": (ls.schedules.schedule, dict(P=P, R=R, C=C, fits=(), seed=0, starts=1), repr),
    "max_order_design": (ls.limits.max_order_design, dict(P=P, C=C, R=R, order=1, fits=(), seed=0), repr),
}  # fmt: skip
#: calls whose right answer takes seconds: they are given fewer draws
SLOW = ("tune", "bound", "schedule", "max_order_design", "shape")


def draw(rng, name):
    """A call's arguments with one or two of them replaced, and words that say which."""
    good = dict(CALLS[name][1])
    for key in rng.choice(list(good), min(len(good), int(rng.integers(1, 3))), replace=False):
        k = int(rng.integers(len(ODD)))
        good[str(key)] = ODD[k]
    return good


def foreign(name, arguments):
    """What came out that is neither an answer nor a sentence of ours, "" where nothing did."""
    call, good, use = CALLS[name]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            use(call(**arguments))
    except ls.LoopshapeError:
        return ""
    except Exception as error:
        changed = {k: repr(v)[:60] for k, v in arguments.items() if v is not good[k]}
        return f"{name}: {changed}: {type(error).__name__}: {error}"
    return ""


def failures(count, seed, among):
    rng = np.random.default_rng(seed)
    names = [among[k % len(among)] for k in range(count)]
    return [said for name in names if (said := foreign(name, draw(rng, name)))]


FAST = [name for name in CALLS if name not in SLOW]


def test_whatever_is_given_ends_in_an_answer_or_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert failures(3 * len(FAST), 1, FAST) == []


@pytest.mark.parametrize("band_hz", [[1.0, 50.0], np.array([1.0, 50.0])])
def test_a_list_stands_for_a_tuple(band_hz):
    assert np.array_equal(
        ls.learning.feedforward(P, band_hz=band_hz).taps, ls.learning.feedforward(P, band_hz=(1.0, 50.0)).taps
    )


def test_a_weight_too_large_for_a_number_is_refused_in_a_sentence():
    with pytest.raises(ls.LoopshapeError, match="must be finite"):
        ls.Weight("S", 10**400)


class Told:
    """A watch of one's own, as `ls.estimate` and others take it."""

    def __init__(self):
        self.lines, self.steps = [], []

    def say(self, line):
        self.lines.append(line)

    def warn(self, lines):
        self.lines.extend(lines)

    @contextmanager
    def progress(self, label, total):
        yield self.steps.append


def test_a_watch_is_told_and_what_is_none_is_refused():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(4000)
    y = np.convolve(u, 0.5 ** np.arange(20))[:4000]
    run, watch = ls.Run.from_arrays(u=u, y=y, rate_hz=100.0), Told()
    assert ls.estimate(run, watch=watch).frfs
    assert watch.steps
    with pytest.raises(ls.LoopshapeError, match="watch"):
        ls.estimate(run, watch="loudly")


def test_a_plant_without_poles_is_checked():
    """1 at every frequency under a gain of 0.5: 1 + L is 1.5, nothing fails."""
    flat = ls.FRF.from_arrays(F, np.ones(F.size, complex), relative_std=0.01, rate_hz=RATE)
    found = ls.check(flat, C, ls.Requirements(modulus_margin=0.5, integrators=0, unstable_poles=0))
    assert found.outcome is not ls.Outcome.FAILED


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", range(8))
def test_two_thousand_times_whatever_is_given(seed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert failures(240, 100 + seed, FAST) == []
    assert failures(10, 200 + seed, list(SLOW)) == []
