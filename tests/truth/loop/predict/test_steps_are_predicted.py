"""Steps of known loops: by formula, by simulating the sampled loop sample by sample, and with intervals that cover."""

import numpy as np
import pytest
from bench_nouns import Block, Estimate, Integrator, ThirdOrder, TransferFunction
from conversions import TWO_PI, Array, ComplexArray
from predicted_loops import NEW, RATE_HZ, arm, measured
from scipy.signal import cont2discrete, lfilter, sosfilt

import loopshape as ls
from loopshape.identify.fit import fit
from loopshape.loop.predict.indicators import indicators
from loopshape.loop.predict.step_response import closed_loop, predict_step, step_from_lines

GAIN = ls.Controller("a", (Block("gain", {"gain": 2.0}),), RATE_HZ)


def exact_fit(model: object) -> ls.Fit:
    """A fit without spread of whatever answers at a frequency."""
    none = tuple(Estimate(name, 1.0, "1", 0.0) for name in ("kappa",))
    return ls.Fit("integrator", model, none, np.zeros((1, 1)), "converged", 1.0, 0.5, 0.5, 0.0, (0.1, 20.0), 100)  # type: ignore[arg-type]


class Sampled:
    """A plant's response as its sampled recordings have it, hold and a computation delay included."""

    def __init__(self, model: TransferFunction, delay: int) -> None:
        num, den, _ = cont2discrete((model.num, model.den), 1.0 / RATE_HZ, "zoh")
        self.num, self.den, self.delay = np.atleast_2d(num)[0], den, delay
        self.delay_s = 0.0

    def response(self, f: Array) -> ComplexArray:
        q = np.exp(-1j * TWO_PI * np.asarray(f) / RATE_HZ)
        powers = q[:, None] ** np.arange(self.den.size)
        return np.asarray((powers @ self.num) / (powers @ self.den) * q**self.delay)


def simulated(plant: Sampled, controller: ls.Controller, n: int) -> Array:
    """Unit step of the loop, sample by sample."""
    sos = np.array([[b0, b1, b2, 1.0, a1, a2] for b0, b1, b2, a1, a2 in controller.biquads()])
    zc, zp = np.zeros((len(sos), 2)), np.zeros(plant.den.size - 1)
    y, z = np.zeros(n), np.zeros(n + plant.delay)
    for k in range(n):
        if k:
            out, zp = lfilter(
                plant.num, plant.den, z[k - 1 : k], zi=zp
            )  # z arrives a sample late at least: num[0] is 0
            y[k] = 0.0
        y[k] = _now(plant, zp)
        out, zc = sosfilt(sos, [1.0 - y[k]], zi=zc)
        z[k + plant.delay] = out[0]
    return y


def _now(plant: Sampled, state: Array) -> float:
    """What a strictly proper filter in transposed form answers before its next input."""
    return float(state[0] / plant.den[0])


def test_a_predicted_step_is_the_sampled_loop_sample_by_sample() -> None:
    plant = Sampled(arm(), 0)
    step = predict_step(exact_fit(plant), NEW, draws=0)
    assert step is not None
    y = simulated(plant, NEW, 3000)
    shown = step.time_s < 3.0
    at = np.round(step.time_s[shown] * RATE_HZ).astype(int)
    assert np.max(np.abs(step.response[shown] - y[at])) < 2e-4


def test_a_first_order_loop_has_the_indicators_of_the_formula() -> None:
    step = predict_step(exact_fit(TransferFunction(np.array([3.0]), np.array([1.0, 0.0]))), GAIN, draws=0)
    assert step is not None
    read, a = step.indicators, 6.0  # T = a/(s + a), sampled so fast that z is hardly seen
    assert read.rise_time_s == pytest.approx(np.log(9.0) / a, rel=0.01)
    assert read.settling_time_s == pytest.approx(np.log(50.0) / a, rel=0.01)
    assert read.settling_time_5_s == pytest.approx(np.log(20.0) / a, rel=0.01)
    assert read.overshoot == pytest.approx(0.0, abs=1e-3)
    assert read.steady_state_error == pytest.approx(0.0, abs=1e-6)


def test_overshoot_and_error_of_a_second_order_loop_are_those_of_the_formula() -> None:
    w, zeta, loss = TWO_PI * 2.0, 0.3, 0.05
    # L = k/(s² + 2 zeta w s + w² - k): T = k/(s² + 2 zeta w s + w²), T(0) = 1 - loss
    k = (1.0 - loss) * w * w
    plant = TransferFunction(np.array([0.5 * k]), np.array([1.0, 2.0 * zeta * w, w * w - k]))
    step = predict_step(exact_fit(plant), GAIN, draws=0)
    assert step is not None
    assert step.indicators.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2)), rel=0.01)
    assert step.indicators.steady_state_error == pytest.approx(loss, abs=1e-6)


def test_a_slow_tail_is_waited_for() -> None:
    """A slow integral action: after a second the output stands at 2/3, and it takes minutes to reach 1."""
    slow = ls.Controller("a", (Block("gain", {"gain": 2.0}), Block("pi", {"f_hz": 0.001})), RATE_HZ)
    lag = TransferFunction(np.array([5.0]), np.array([1.0, 5.0]))
    step = predict_step(exact_fit(lag), slow, draws=0)
    assert step is not None
    assert abs(step.indicators.steady_state_error) < 1e-3
    assert step.indicators.settling_time_s > 60.0


@pytest.mark.parametrize("gain", [30.0, 100.0])
def test_an_unstable_loop_has_no_step(gain: float) -> None:
    hot = ls.Controller("a", (Block("gain", {"gain": gain}),), RATE_HZ)
    assert predict_step(exact_fit(arm()), hot, draws=0) is None


@pytest.mark.long
def test_intervals_of_predicted_steps_cover_the_truth() -> None:
    rng, f = np.random.default_rng(5), 0.1 * np.arange(1, 151)
    truth = predict_step(exact_fit(arm()), NEW, draws=0)
    assert truth is not None
    names, runs = ("rise_time_s", "overshoot", "settling_time_5_s"), 60
    inside = dict.fromkeys(names, 0)
    for k in range(runs):
        found = predict_step(fit(measured(rng, f, arm().response(f), 0.05, NEW), ThirdOrder()), NEW, draws=160, seed=k)
        assert found is not None
        for name in names:
            low, high = found.indicators.intervals[name]
            inside[name] += low <= getattr(truth.indicators, name) <= high
    assert all(52 <= count <= runs for count in inside.values()), inside  # 57 expected, 3 sigma of a binomial


def test_a_step_of_the_lines_is_that_of_the_model_and_its_band_covers_it() -> None:
    rng, f = np.random.default_rng(1), 0.05 * np.arange(2, 601)
    T = closed_loop(arm(), NEW)(f)
    frf = measured(rng, f, 1.0 - T, 1e-4, NEW)
    step, truth = step_from_lines(frf), predict_step(exact_fit(arm()), NEW, draws=0)
    assert truth is not None
    at = np.interp(step.time_s, truth.time_s, truth.response)
    assert np.max(np.abs(step.response - at)) < 0.02  # |T| is 0.01 at the last line
    noisy = step_from_lines(measured(rng, f, 1.0 - T, 0.05, NEW))
    covered = np.mean((noisy.low - 0.01 <= at[: noisy.low.size]) & (at[: noisy.low.size] <= noisy.high + 0.01))
    assert covered > 0.9


@pytest.mark.parametrize(("low", "high", "word"), [(20, 600, "lowest frequency"), (2, 100, "dies out")])
def test_lines_that_cannot_carry_a_step_are_refused(low: int, high: int, word: str) -> None:
    f = 0.05 * np.arange(low, high)
    frf = measured(np.random.default_rng(0), f, 1.0 - closed_loop(arm(), NEW)(f), 1e-4, NEW)
    with pytest.raises(ls.errors.WrongUseError, match=word):
        step_from_lines(frf)


def test_a_response_that_does_not_stay_is_not_settled() -> None:
    t = np.arange(4000) / RATE_HZ
    ringing = indicators(t, 1.0 + 0.1 * np.cos(20.0 * t) * (t > 0))
    assert ringing.outcome == "not settled"
    assert np.isnan(ringing.settling_time_s)


def test_an_integrator_stays_one_in_every_draw() -> None:
    f = 0.1 * np.arange(1, 60)
    made = TransferFunction(np.array([1.5]), np.array([1.0, 0.0]))
    found = fit(measured(np.random.default_rng(3), f, made.response(f), 0.1, GAIN), Integrator())
    step = predict_step(found, GAIN, draws=100)
    assert step is not None
    assert step.unsettled == 0.0
    assert np.allclose(step.indicators.intervals["steady_state_error"], 0.0, atol=1e-6)
    low, high = step.indicators.intervals["rise_time_s"]
    assert low < np.log(9.0) / 3.0 < high


def test_models_that_do_not_settle_are_counted_and_take_the_intervals_away() -> None:
    """kappa/s³-like with a gain just inside the limit, known to 20 %: nearly half of the draws are unstable."""
    gain = ls.Controller("a", (Block("gain", {"gain": 1.0}),), RATE_HZ)
    w, zeta = TWO_PI * 5.0, 0.1
    limit = 2.0 * zeta * w**3  # of kappa, by Routh
    values = (("kappa", 0.95 * limit), ("f_hz", 5.0), ("zeta", zeta))
    std = np.array([0.2 * limit, 1e-6, 1e-6])
    estimates = tuple(Estimate(name, value, "1", s) for (name, value), s in zip(values, std, strict=True))
    model = arm(kappa=0.95 * limit, zeta=zeta)
    made = ls.Fit("third_order", model, estimates, np.diag(std**2), "converged", 1.0, 0.5, 0.5, 0.0, (0.1, 20.0), 100)
    step = predict_step(made, gain, draws=200)
    assert step is not None
    assert 0.3 < step.unsettled < 0.6
    assert not step.indicators.intervals
    assert any("do not settle" in note for note in step.notes)
