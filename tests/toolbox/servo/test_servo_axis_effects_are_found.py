"""A servo axis with one known effect: the attribution ranks it first and gives its magnitude."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Experiment
from study_signals import Multisine

import loopshape as ls
from loopshape.toolbox.gap.diagnose import attribute
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import candidates
from loopshape.toolbox.servo.axis import ServoAxis
from loopshape.toolbox.servo.effects import USUAL, forms

RATE_HZ, SECONDS = 1000.0, 7
GIVEN = {"mass_kg": 100.0, "viscous_ns_m": 200.0}
PER_NUMBER = 0.1  # of cost: of two equal explanations the one with fewer numbers


def strokes(seed):
    """Smooth strokes of random length and speed, with rests, (n,) in m."""
    rng, parts, at = np.random.default_rng(seed), [], 0.0
    while sum(p.size for p in parts) < SECONDS * RATE_HZ:
        to = rng.uniform(-0.12, 0.12)
        n = max(200, int(1500 * abs(to - at) / rng.uniform(0.05, 0.15)))
        s = np.linspace(0.0, 1.0, n)
        parts += [at + (to - at) * (10 * s**3 - 15 * s**4 + 6 * s**5), np.full(200, to)]
        at = to
    return np.concatenate(parts)[: int(SECONDS * RATE_HZ)]


def slower(run, rate_hz):
    """The run as a slower logger keeps it: the force's mean over each sample, the position at its start."""
    n = round(run.rate_hz / rate_hz)

    def thinned(r):
        rows = r.columns["position_m"].size // n * n
        force = r.columns["force_n"][:rows].reshape(-1, n).mean(axis=1)
        return replace(r, rate_hz=rate_hz, columns={"force_n": force, "position_m": r.columns["position_m"][:rows:n]})

    return replace(run, rate_hz=rate_hz, recordings=tuple(thinned(r) for r in run.recordings))


def recorded(changes, given, count=3):
    """A run of a simulated axis: strokes with a multisine of 40 um in front of the controller."""
    axis = ServoAxis()
    loops = axis.loop_setups(axis.default_controllers(RATE_HZ), "controller_input")
    experiments = []
    for k in range(count):
        sine = Multisine(1.0, 60.0, period_s=5.0, amplitude=4e-5, periods=1, seed=k, crest_iterations=5)
        signals = (strokes(k)[:, None], sine.signal(RATE_HZ)[:, None])
        words = {"excites": "position", "seed": k}
        experiments.append(
            Experiment(f"r{k}", "multisine", loops, RATE_HZ, *signals, "controller_input", {"position_m": 0.0}, **words)
        )
    recordings = axis.simulate(experiments, changes=changes)
    assert all(r.info.ended_early is None for r in recordings)
    return ls.Run(RATE_HZ, loops, tuple(recordings), axis.name, extra={"parameters": given})


def ranking(run):
    axis = ServoAxis().of_run(run)
    evidence = Evidence.of(axis, run, [r.info.name for r in run.recordings], periodic_s=np.inf, threads=1)
    base = attribute.healthy(evidence)
    coarse = attribute.screened(evidence, candidates(axis), base)
    fitted = [attribute.again(evidence, f, rounds=3) for f in coarse]
    order = sorted(attribute.best_forms(fitted), key=lambda f: f.cost + PER_NUMBER * f.hypothesis.n_free)
    return evidence, base, order


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "changes", "magnitude"),
    [
        ("coulomb_friction", {"coulomb_n": 12.0}, 12.0),
        ("coulomb_friction", {"presliding_n": 12.0, "presliding_m": 2e-5}, 12.0),
        ("asymmetric_friction", {"coulomb_n": 15.0, "coulomb_asymmetry": 0.25}, 15.0),
        ("stribeck_friction", {"coulomb_n": 12.0, "stribeck_share": 0.8, "stribeck_m_s": 0.01}, 12.0),
        ("force_offset", {"force_offset_n": -5.0}, -5.0),
        ("hardening_stiffness", {"cubic_n_m3": 2e4}, 2e4),
        ("backlash", {"sensor_play_m": 1e-4}, 0.1),
        ("force_saturation", {"force_limit_n": 100.0}, 100.0),
        ("loop_delay", {"loop_delay_ms": 3.0}, 3.0),
        ("loop_delay", {"force_lag_ms": 2.0}, 2.0),
    ],
)
def test_a_known_effect_is_ranked_first_with_its_magnitude(effect, changes, magnitude):
    evidence, base, order = ranking(recorded(changes, GIVEN))
    assert order[0].hypothesis.name == effect
    assert order[0].magnitudes[0] == pytest.approx(magnitude, rel=0.05)
    assert order[0].cost < 0.5 * base.cost
    assert order[0].cost < 3.0 * evidence.quiet


@pytest.mark.long
@pytest.mark.parametrize("rate_hz", [200.0, 100.0])
def test_friction_is_found_at_slow_rates(rate_hz):
    _, _, order = ranking(slower(recorded({"coulomb_n": 15.0}, GIVEN), rate_hz))
    assert order[0].hypothesis.name == "coulomb_friction"
    assert order[0].magnitudes[0] == pytest.approx(15.0, rel=0.2)


@pytest.mark.parametrize("rate_hz", [1.0, 30.0, 250.0, 1e4, 1e6])
def test_every_start_of_every_form_is_a_parameter_of_the_axis_at_any_rate(rate_hz):
    axis = ServoAxis()
    for form in forms(replace(USUAL, rate_hz=rate_hz)):
        assert np.isfinite(axis.parameters.vector(form.moves([f.starts[0] for f in form.free]))).all()


@pytest.mark.long
@pytest.mark.parametrize("given", [GIVEN, {}, {"mass_kg": 97.0, "viscous_ns_m": 230.0}])
def test_an_ordinary_axis_has_no_gap(given):
    evidence, base, order = ranking(recorded({}, given, count=2))
    assert base.cost < 1.1 * evidence.quiet
    assert order[0].cost > base.cost - 0.2


def test_a_flexibility_is_fitted_best_at_its_own_frequency():
    run = recorded({"flexible_share": 0.25, "flexible_hz": 25.0}, GIVEN, count=1)
    axis = ServoAxis().of_run(run)
    prepared = axis.prepare(run.recordings[0], run, None)

    def error(hz):
        return axis.relative_error(prepared, {"flexible_share": 0.25, "flexible_hz": hz})

    assert error(25.0) < 0.04
    assert min(error(23.0), error(27.0)) > 3.0 * error(25.0)


def test_of_a_missing_mass_and_viscous_friction_the_estimate_is_right_within_two_percent():
    axis = ServoAxis().of_run(recorded({"mass_kg": 40.0, "viscous_ns_m": 300.0}, {}, count=1))
    found = axis.parameters.vector()[[axis.parameters.index(n) for n in ("mass_kg", "viscous_ns_m")]]
    np.testing.assert_allclose(found, [40.0, 300.0], rtol=0.02)  # central differences up to 40 Hz


def test_one_recording_is_cut_into_pieces_that_can_be_left_out():
    run = recorded({"coulomb_n": 12.0}, GIVEN, count=1)
    axis, cut, names = ServoAxis().readied(run, ["r0"])
    assert names == ["r0-01", "r0-02"]
    assert Evidence.of(axis, cut, names, periodic_s=np.inf, threads=1).recordings == names
    many = replace(
        run,
        recordings=tuple(
            replace(r, info=replace(r.info, file=f"{k}.parquet")) for k in range(4) for r in run.recordings
        ),
    )
    assert ServoAxis().readied(many, ["0", "1", "2", "3"])[1] is many
