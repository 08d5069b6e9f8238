"""A plan from a short record, carried out with fresh noise: the scatter at the crossover is what was wished."""

from dataclasses import replace

import known_loops as known
import numpy as np
import pytest
from conversions import TWO_PI
from scipy.signal import lfilter
from study_signals import BandNoise, Multisine, Sweep

from loopshape.identify.frequency_response import estimate_frf, estimate_realisations
from loopshape.toolbox.planning.plan import plan
from loopshape.toolbox.planning.plan_nouns import Required
from loopshape.toolbox.planning.plan_record import first_record
from loopshape.toolbox.rig.files.excitation_sets import realised

AT_HZ, STD, REPEATS = 6.0, 0.01, 60
FIRSTS = {
    "noise": BandNoise(0.3, 40.0, 30.0, 1.0, 3, 0.5),
    "sweep": Sweep(0.3, 40.0, 60.0, 1.5, 0.5, "logarithmic"),
    "multisine": Multisine(0.5, 40.0, 10.0, 1.5, 6, ramp_s=1.0),
}


def sensor_noise(shape, seed):
    return lfilter([0.05], [1.0, -0.6], np.random.default_rng(seed).standard_normal(shape))


def noise_power(f_hz):
    """One-sided power per Hz of the sensor's noise."""
    return 2.0 * 0.05**2 / known.RATE / np.abs(1.0 - 0.6 * np.exp(-1j * TWO_PI * f_hz / known.RATE)) ** 2


def first(place, kind, seed=1):
    signal = FIRSTS[kind]
    n = signal.signal(known.RATE)
    z, y = known.run_loop(place, n, sensor_noise(n.size, seed))
    return first_record(known.record(place, kind, n, z, y, **period(signal)), known.LOOP)


def period(signal):
    return {} if signal.period_s is None else {"period_s": signal.period_s, "from_s": signal.ramp_s}


def crossover(plan):
    return int(np.argmin(np.abs(plan.lines_hz - plan.crossover_hz)))


def to_output(place, f_hz):
    """What the output answers to the instrument."""
    P, C = known.plant(f_hz), known.CONTROLLER.response(f_hz)
    return {"control": P, "plant_input": P / (1.0 + C * P)}.get(place, C * P / (1.0 + C * P))


def carried_out(place, found, repeats=REPEATS):
    """Response (repeats,) at the crossover's line, over the true one, and its own relative std (repeats,)."""
    n = found.excitation.signal(known.RATE)
    frfs = known.estimates(place, "multisine", n, sensor_noise((repeats, n.size), 7), **period(found.excitation))
    at = [int(np.argmin(np.abs(f.frequency_hz - found.lines_hz[crossover(found)]))) for f in frfs]
    G = np.array([f.siso[k] for f, k in zip(frfs, at, strict=True)])
    own = np.array([np.sqrt(f.variance[k, 0, 0] / 2.0) for f, k in zip(frfs, at, strict=True)]) / np.abs(G)
    return G / known.plant(found.lines_hz[crossover(found)]), own


@pytest.mark.long
@pytest.mark.parametrize(
    ("place", "kind"),
    [("control", "noise"), ("controller_input", "multisine"), ("plant_input", "sweep"), ("reference", "sweep")],
)
def test_the_scatter_at_the_crossover_is_the_wish(place, kind):
    found = plan(first(place, kind), Required(STD, at_hz=AT_HZ, max_amplitude=1.0))
    assert found.reached
    assert found.binds == "amplitude"
    x = crossover(found)
    f, amplitude = found.lines_hz[x], found.line_amplitude[x]
    line = 0.5 * amplitude**2 * np.abs(to_output(place, f)) ** 2
    exact = np.sqrt(noise_power(f) / (2.0 * found.measured_s * line))
    assert exact == pytest.approx(STD, rel=0.12)  # what the plan is, by the true plant and noise
    G, own = carried_out(place, found)
    scatter = np.sqrt(np.sum(np.abs(G - G.mean()) ** 2) / (REPEATS - 1) / 2.0)
    assert scatter == pytest.approx(STD, rel=0.15)  # what comes out, from 60 repeats (6 % sure)
    assert np.abs(G.mean() - 1.0) < 4.0 * STD * np.sqrt(2.0 / REPEATS)
    assert np.sqrt(np.mean(own**2)) == pytest.approx(STD, rel=0.15)  # what each record says of itself


def test_all_lines_are_as_sure_as_predicted_and_alike_where_the_ratio_allows():
    found = plan(first("plant_input", "multisine"), Required(STD, at_hz=AT_HZ, max_amplitude=1.0))
    n = found.excitation.signal(known.RATE)
    v = sensor_noise((REPEATS, n.size), 8)
    frfs = known.estimates("plant_input", "multisine", n, v, **period(found.excitation))
    f, G, _ = known.common_lines(frfs, 0.1, 45.0)
    np.testing.assert_allclose(f, found.lines_hz, rtol=1e-9)
    scatter = np.sqrt((np.abs(G - G.mean(axis=0)) ** 2).sum(axis=0) / (REPEATS - 1) / 2.0) / np.abs(known.plant(f))
    np.testing.assert_allclose(scatter, found.std, rtol=0.45)  # single lines: 6 % and the first record's own error
    assert np.median(scatter / found.std) == pytest.approx(1.0, abs=0.12)
    amplitude = found.line_amplitude
    assert amplitude.max() / amplitude.min() <= found.required.level_ratio * (1.0 + 1e-9)
    free = (amplitude > 1.001 * amplitude.min()) & (amplitude < 0.999 * amplitude.max())
    np.testing.assert_allclose(found.std[free], found.at_crossover, rtol=1e-6)


def test_twice_as_strict_takes_four_times_as_long_or_twice_the_amplitude():
    record = first("controller_input", "multisine")
    one, strict = (plan(record, Required(s, at_hz=AT_HZ, max_amplitude=1.0, longest_s=5e3)) for s in (STD, STD / 2.0))
    assert strict.measured_s == pytest.approx(4.0 * one.measured_s, abs=4.0 * one.excitation.period_s)
    larger = plan(record, Required(STD / 2.0, at_hz=AT_HZ, max_amplitude=2.0))
    assert larger.measured_s == pytest.approx(one.measured_s, abs=one.excitation.period_s)
    near, far = (plan(record, Required(s, at_hz=AT_HZ, max_amplitude=50.0)) for s in (0.02, 0.01))
    assert near.binds == far.binds == "shortest"
    assert near.excitation.periods == far.excitation.periods == 4
    assert far.excitation.amplitude == pytest.approx(2.0 * near.excitation.amplitude)


@pytest.mark.parametrize("place", ["controller_input", "plant_input", "control"])
def test_limits_hold_in_what_is_carried_out(place):
    record = first(place, "multisine")
    loose = plan(record, Required(STD, at_hz=AT_HZ, max_amplitude=50.0, longest_s=2e3))
    u_most, y_most = 0.8 * loose.peak_input, 0.8 * loose.peak_output
    for limit in ({"max_input": u_most}, {"max_output": y_most}):
        found = plan(record, Required(STD, at_hz=AT_HZ, max_amplitude=50.0, longest_s=2e3, **limit))
        n = found.excitation.signal(known.RATE)
        z, y = known.run_loop(place, n, sensor_noise(n.size, 11))
        u = z + n if place == "plant_input" else z
        peak, allowed = (np.abs(u).max(), u_most) if "max_input" in limit else (np.abs(y).max(), y_most)
        assert 0.6 * allowed < peak <= 1.02 * allowed
        assert np.abs(n).max() <= found.excitation.amplitude * (1.0 + 1e-9)
        assert found.binds in ("input", "output", "shortest")


def test_out_of_reach_says_by_how_much_and_what_would_do():
    record = first("controller_input", "multisine")
    found = plan(record, Required(0.002, at_hz=AT_HZ, max_amplitude=1.0, longest_s=120.0))
    assert not found.reached
    assert found.duration_s <= 120.0
    assert found.short_by == pytest.approx(found.at_crossover / 0.002)
    assert "out of reach" in found.sentence
    assert "times the required one" in found.sentence
    more = plan(record, replace(found.required, longest_s=found.needed_s + found.excitation.period_s))
    assert more.at_crossover == pytest.approx(0.002, rel=0.1)
    louder = plan(record, replace(found.required, max_amplitude=1.001 * found.needed_amplitude))
    assert louder.reached


def bent(signal, seed, cubic=0.12):
    """An open-loop record of the plant behind a cubic, with a little noise."""
    n = signal.signal(known.RATE)
    y = lfilter(known.B, known.A, n + cubic * n**3) + 0.01 * sensor_noise(n.size, seed)
    return known.record("control", "multisine", n, n, y, **period(signal))


def test_distortion_of_the_first_record_is_a_floor_that_realisations_average():
    lines = tuple(0.2 * k for k in range(3, 150, 2) if k % 8 != 7)
    signal = Multisine(0.5, 31.0, 5.0, 1.5, 5, 2, ramp_s=1.0, lines_hz=lines)
    record = first_record(bent(signal, 1), known.LOOP)
    single = plan(record, Required(0.3, at_hz=AT_HZ))
    x = crossover(single)
    assert single.floor[x] > 0.003
    assert single.realisations == 1

    def scatter(found, draws):
        out = []
        for k in range(draws):
            seeds = replace(found.excitation, seed=found.excitation.seed + 12345 * (k + 1))
            sets = [realised({"axis": seeds}, r)["axis"] for r in range(found.realisations)]
            records = [bent(one, 100 * k + r) for r, one in enumerate(sets)]
            frf = estimate_frf(records[0], known.LOOP) if len(sets) == 1 else estimate_realisations(records, known.LOOP)
            out.append(frf.siso[int(np.argmin(np.abs(frf.frequency_hz - found.lines_hz[crossover(found)])))])
        G = np.array(out)
        return float(np.sqrt(np.sum(np.abs(G / G.mean() - 1.0) ** 2) / (draws - 1) / 2.0))

    assert scatter(single, 40) == pytest.approx(single.at_crossover, rel=0.4)  # a few silent lines tell it roughly
    required = 0.8 * float(single.floor[x])
    averaged = plan(record, Required(required, at_hz=AT_HZ))
    assert averaged.realisations > 1
    assert averaged.binds == "distortion"
    assert scatter(averaged, 30) < 1.15 * required
    tight = plan(record, Required(0.05 * float(single.floor[x]), at_hz=AT_HZ, longest_s=60.0))
    assert not tight.reached
    assert "realisations only" in tight.sentence


def test_without_distortion_there_is_no_floor_however_little_noise():
    lines = tuple(0.2 * k for k in range(3, 150, 2) if k % 8 != 7)
    for seed in range(5):
        signal = Multisine(0.5, 31.0, 5.0, 1.5, 5, seed, ramp_s=1.0, lines_hz=lines)
        found = plan(first_record(bent(signal, seed, cubic=0.0), known.LOOP), Required(0.001, at_hz=AT_HZ))
        assert not found.floor.any()
