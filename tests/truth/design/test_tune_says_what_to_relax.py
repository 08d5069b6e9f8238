"""Requirements that exclude each other: what holds them apart, what each would have to give, and a proof nearby."""

from dataclasses import replace

import numpy as np
import pytest
from tune_plants import DELAY_S, DELAYED, GAIN, LEAD, LOW_PASS, NOTCH, frf, problem_of, required, servos

from loopshape.design import relax
from loopshape.design.problem.measures import measure
from loopshape.design.tune import tune

PLANT = frf(DELAYED, 3000)
# k exp(-0.02 s)/s with 45 deg: crossover at most 45/360/0.02 = 6.25 Hz; with 8 Hz 90 - 8 0.02 360 = 32.4 deg are left
APART = required(GAIN, phase_margin_deg=45.0, bandwidth_hz=8.0)


@pytest.fixture(scope="module")
def known():
    return tune([PLANT], APART)


def test_each_requirement_gives_what_the_textbook_says(known):
    assert not known.feasible
    relaxed = {one.quantity: one for one in known.shortfall.relaxations}
    assert relaxed["bandwidth_hz"].reachable == pytest.approx(0.125 / DELAY_S, rel=2e-3)
    assert relaxed["phase_margin_deg"].reachable == pytest.approx(90.0 - 360.0 * 8.0 * DELAY_S, rel=2e-3)
    assert all(one.verified for one in relaxed.values())
    assert relaxed["phase_margin_deg"].by == pytest.approx(12.6, rel=1e-2)


def test_a_tuning_with_what_it_says_is_feasible_and_with_less_it_is_not(known):
    for one in known.shortfall.relaxations:
        give = one.reachable - one.required
        assert tune([PLANT], replace(APART, **{one.quantity: one.required + 1.001 * give}), explain=False).feasible
        assert not tune([PLANT], replace(APART, **{one.quantity: one.required + 0.98 * give}), explain=False).feasible


def test_what_holds_them_apart_is_named_with_shares_that_sum_to_one(known):
    why = known.shortfall
    assert {pull.quantity for pull in why.pulls} == {"bandwidth_hz", "phase_margin_deg"}
    assert sum(pull.share for pull in why.pulls) == pytest.approx(1.0)
    assert all(pull.slack < 0.0 for pull in why.pulls)
    # one gain: the two slopes by ln k, 1 and -w d, cancel
    shares = {pull.quantity: pull.share for pull in why.pulls}
    crossover = 2.0 * np.pi * known.bandwidth_hz
    assert shares["bandwidth_hz"] == pytest.approx(crossover * DELAY_S * shares["phase_margin_deg"], rel=1e-2)
    assert why.certified


def test_a_dip_that_binds_is_no_requirement_that_could_give(monkeypatch):
    certificate = relax._certificate

    def with_a_dip(*given):
        pulls, helps = certificate(*given)
        return (*pulls, replace(pulls[0], quantity="dip")), helps

    monkeypatch.setattr(relax, "_certificate", with_a_dip)
    why = tune([PLANT], APART).shortfall
    assert "dip" in {pull.quantity for pull in why.pulls}
    assert {one.quantity for one in why.relaxations} == {"bandwidth_hz", "phase_margin_deg"}


def test_the_certificate_holds_no_small_change_makes_the_worst_miss_smaller():
    asked = required(
        GAIN, LEAD, NOTCH, LOW_PASS,
        sensitivity_peak_db=5.0, phase_margin_deg=40.0, control_peak_db=5.0, bandwidth_hz=14.0,
    )  # fmt: skip
    found = tune(servos(), asked)
    why = found.shortfall
    assert why.certified
    p = problem_of(servos(), asked)
    x = np.log([found.controller.blocks[v.block].parameters[v.name] for v in p.variables])
    assert -measure(p, x, {}).worst == pytest.approx(why.miss, rel=0.02)
    rng = np.random.default_rng(0)
    for _ in range(300):
        m = measure(p, np.clip(x + 0.01 * rng.uniform(-1.0, 1.0, x.size), p.low, p.high), {})
        assert -m.worst > why.miss - 2e-3


def test_a_point_that_is_not_the_best_gets_no_certificate():
    from loopshape.design.relax import _certificate
    from loopshape.design.search import Goal, initial_point

    p = problem_of([PLANT], APART)
    away = initial_point(p, np.log([10.0]), Goal(objective=False, soft=None))
    pulls, helps = _certificate(p, away, {})
    assert {pull.quantity for pull in pulls} == {"bandwidth_hz"}
    assert helps == pytest.approx(0.01, rel=1e-3)  # 1 % more gain is 1 % more bandwidth


def test_one_that_does_not_do_alone_is_not_offered():
    # 20 Hz leave 90 - 144 deg: no phase margin, however small, makes that stable
    why = tune([PLANT], replace(APART, bandwidth_hz=20.0)).shortfall
    relaxed = {one.quantity: one for one in why.relaxations}
    assert np.isnan(relaxed["phase_margin_deg"].reachable)
    assert not relaxed["phase_margin_deg"].verified
    assert relaxed["bandwidth_hz"].reachable == pytest.approx(6.25, rel=2e-3)
    assert why.least.quantity == "bandwidth_hz"


def test_requirements_that_are_met_have_no_shortfall():
    assert tune([PLANT], required(GAIN, phase_margin_deg=45.0)).shortfall is None


def test_without_a_stable_start_it_says_so():
    unstable = frf(DELAYED, 400)
    stuck = {"kind": "gain", "gain": {"min": 500.0, "max": 1000.0}}  # crossover far beyond the delay's limit
    why = tune([unstable], required(stuck, phase_margin_deg=10.0)).shortfall
    assert not why.stable
    assert not why.certified
    assert why.relaxations == ()


def test_noise_counts_in_what_is_to_be_relaxed():
    clean, noisy = (tune([frf(DELAYED, 1000, std=std)], APART).shortfall for std in (0.0, 0.05))
    reach = [next(one.reachable for one in s.relaxations if one.quantity == "bandwidth_hz") for s in (clean, noisy)]
    assert reach[1] < 0.999 * reach[0]


def test_what_to_relax_is_printed_with_numbers_alone(capsys):
    from loopshape.cli.design.tune import _report_shortfall
    from loopshape.cli.output import Output
    from loopshape.design.relax import Relaxation, Shortfall

    relaxed = Relaxation("phase_margin_deg", "deg", 45.0, 32.4, True, 8.0)
    never = Relaxation("gain_margin_db", "dB", 5.0, np.nan, False, np.nan)
    _report_shortfall(Shortfall(True, 0.1, 0.0, (), (), (relaxed, never)), Output(as_json=False, quiet=False))
    shown = capsys.readouterr().out
    assert "32.4" in shown
    assert "gain_margin_db: no value of it alone was found" in shown
    assert "nan" not in shown.lower()
