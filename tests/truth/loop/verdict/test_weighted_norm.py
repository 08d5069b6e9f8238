"""The norm of the weighted loop, max of sqrt(sum of |W|² |response|²): read, limited and made small.

Truths: an integrator under a gain, whose optimum is written out; python-control's own norm of the same closed loop.
"""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from bench_nouns import Block, TransferFunction
from commands import invoked
from conversions import TWO_PI
from run_files import requirements_of, write_frfs
from tune_plants import GAIN, LEAD, LOW_PASS, PI, RATE, frf, problem_of, required, servos

import loopshape as ls
from loopshape.design.problem.shifts import shifted_verdict
from loopshape.design.search import LARGEST, initial_point, search
from loopshape.design.tighten import tighten_limits
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import check

B, A, C3 = 20.0, 8.0, 0.05  # P = B/s, W1 = A/s, W3 = C3
INTEGRATOR = frf(TransferFunction([B], [1.0, 0.0]), 600, low_hz=0.01, high_hz=4600.0)
TWO = (ls.Weight("S", lambda f_hz: A / (TWO_PI * f_hz)), ls.Weight("CS", C3))
FOUR = (
    {"response": "S", "points": [[0.5, 30.0], [20.0, -6.0]]},
    {"response": "T", "points": [[10.0, -20.0], [200.0, 20.0]]},
    {"response": "CS", "points": [[1.0, -40.0], [1000.0, 0.0]]},
    {"response": "PS", "points": [[1.0, -30.0], [100.0, -40.0]]},
)


def norm_of(plant, C, weights):
    """The largest root of the sum of squared weighted responses, on the frequencies of an FRF."""
    f, c = plant.frequency_hz, C.response(plant.frequency_hz)
    S = 1.0 / (1.0 + c * plant.siso)
    sizes = {"S": S, "T": c * plant.siso * S, "CS": c * S, "PS": plant.siso * S}
    return np.sqrt(sum((w.at(f) * np.abs(sizes[w.response])) ** 2 for w in weights)).max()


def only_weights(structure, weights=TWO, **more):
    return ls.Requirements(
        "one", integrators=1, unstable_poles=0, structure=tuple(structure), weights=weights,
        objective=ls.Objective(0.0, weighted_norm=1.0), **more,
    )  # fmt: skip


def test_the_best_gain_of_an_integrator_is_where_calculus_puts_it():
    # S = s/(s + kB): |W1 S|² + |W3 CS|² = (A² + C3² k² w²)/(w² + k² B²) runs from A/(kB) to C3 k; least where equal
    best = np.sqrt(A / (B * C3))
    found = ls.tune(INTEGRATOR, only_weights([ls.gain((0.1, 100.0))]), starts=2)
    assert found.controller.blocks[0].parameters["gain"] == pytest.approx(best, rel=2e-3)
    assert found.weighted_norm == pytest.approx(C3 * best, rel=2e-3)
    assert found.objective == pytest.approx(-np.log(found.weighted_norm), rel=1e-3)


def test_the_norm_is_that_of_python_control():
    rate = 1000.0
    P = control.sample_system(control.tf([4000.0], [0.05, 1.0, 0.0]), 1.0 / rate)
    lead = control.sample_system(
        control.tf([1.0 / (TWO_PI * 20.0), 1.0], [1.0 / (TWO_PI * 200.0), 1.0]), 1e-3, "tustin"
    )
    W1, W2 = (
        control.sample_system(control.tf(*one), 1e-3, "tustin")
        for one in (([0.5, 60.0], [1.0, 0.5]), ([1.0, 60.0], [0.05, 200.0]))
    )
    L = control.ss(P) * control.ss(lead) * 0.4
    S = control.feedback(control.ss([], [], [], [[1.0]], 1e-3), L)
    T, CS = control.feedback(L, 1), 0.4 * control.ss(lead) * S
    stacked = control.append(control.ss(W1) * S, control.ss(W2) * T, 0.02 * CS)
    stacked = stacked * control.ss([], [], [], np.outer(np.ones(3), [1.0, 0.0, 0.0]), 1e-3)  # square, as scipy needs it
    truth = control.system_norm(stacked, "inf", tol=1e-9)
    plant = ls.FRF.from_control(P, np.geomspace(0.05, 499.0, 4000), rate_hz=rate)
    C = ls.controller(ls.gain(0.4), ls.lead_lag(20.0, 200.0), rate_hz=rate)
    weights = (ls.Weight("S", W1), ls.Weight("T", W2), ls.Weight("CS", 0.02))
    R = ls.Requirements(weights=weights, weighted_norm=truth * 1.01, unstable_poles=0, integrators=1)
    found = ls.check(plant, C, R)
    (line,) = found.lines
    assert line.value == pytest.approx(truth, rel=1e-4)
    assert (line.quantity, line.outcome) == ("weighted_norm", "passed")


@pytest.mark.parametrize("responses", [("S",), ("T",), ("CS",), ("PS",), ("S", "T", "CS", "PS")])
def test_each_weight_is_on_its_own_response(responses):
    # largest about the peak of |S|, where |S|, |T| and |L| differ
    weights = tuple(ls.Weight(name, lambda f_hz: np.exp(-3.0 * np.log(f_hz / 3.0) ** 2)) for name in responses)
    (plant,) = (one for one in servos(0.0, 1500) if one.recording == "load 1.5")
    C = ls.Controller("one", (Block("gain", {"gain": 0.2}),), RATE)
    asked = ls.Requirements("one", integrators=1, unstable_poles=0, weights=weights)
    (found,) = check([plant], C, asked).margins.values()
    assert found.weighted_norm == pytest.approx(norm_of(plant, C, weights), rel=1e-4)
    assert 2.0 < found.at_hz["weighted_norm"] < 4.5


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_interval_holds_the_norm_of_the_plants_without_noise(noise):
    weights = tuple(map(ls.Weight.from_table, FOUR))
    C = ls.Controller("one", (Block("gain", {"gain": 0.2}), Block("lead_lag", {"f1_hz": 12.0, "f2_hz": 200.0})), RATE)
    asked = required(weighted_norm=2.0, weights=FOUR)
    found = check(servos(noise), C, asked).margins
    for plant, margins in zip(servos(0.0, 4000), found.values(), strict=True):
        truth, (low, high) = norm_of(plant, C, weights), margins.intervals["weighted_norm"]
        assert 0.998 * low < truth < 1.002 * high
        assert (high - low < 0.002 * truth) == (noise == 0.0)


def test_tuned_to_the_norm_it_is_smaller_than_at_the_largest_bandwidth_and_within_the_margins():
    limits = {"phase_margin_deg": 45.0, "control_peak_db": 20.0}
    blocks = (GAIN, LEAD, PI, LOW_PASS)
    small = ls.tune(servos(0.01), required(*blocks, **limits, weights=FOUR, objective="weighted_norm"), starts=6)
    fast = ls.tune(servos(0.01), required(*blocks, **limits, weights=FOUR), starts=6)
    assert small.feasible
    assert fast.feasible
    assert small.weighted_norm < 0.98 * fast.weighted_norm
    assert small.bandwidth_hz < fast.bandwidth_hz
    low, high = small.weighted_norm_interval
    truth = max(norm_of(one, small.controller, map(ls.Weight.from_table, FOUR)) for one in servos(0.0, 3000))
    assert 0.998 * low <= truth <= 1.002 * high
    assert any(b.quantity == "weighted_norm" for b in small.binding)


def test_a_start_is_never_made_worse_and_no_larger_structure_beats_the_optimum():
    asked = only_weights([ls.gain((0.1, 100.0))])
    first = ls.tune(INTEGRATOR, asked, starts=2)
    again = ls.tune(INTEGRATOR, asked, start=first, starts=1)
    assert again.weighted_norm <= first.weighted_norm * (1.0 + 1e-9)
    # under the best gain the norm is the same at every frequency, as at the optimum over all controllers
    lag = ls.tune(INTEGRATOR, only_weights([ls.gain((0.1, 100.0)), ls.lead_lag((0.05, 50.0), (0.05, 50.0))]), starts=6)
    best = np.sqrt(A * C3 / B)
    assert best * 0.999 < lag.weighted_norm < 1.002 * best


def test_the_norm_as_a_limit_holds_while_the_bandwidth_grows():
    loose = required(GAIN, LEAD, LOW_PASS, phase_margin_deg=30.0)
    tight = required(GAIN, LEAD, LOW_PASS, phase_margin_deg=30.0, weights=FOUR, weighted_norm=1.6)
    free, held = (ls.tune(servos(), one, starts=4) for one in (loose, tight))
    assert held.verdict.passed
    assert held.weighted_norm == pytest.approx(1.6, rel=0.01)
    assert held.bandwidth_hz < free.bandwidth_hz


def test_a_weight_is_the_same_in_every_form():
    f = np.geomspace(0.1, 1000.0, 30)
    corner, gain = 30.0, 4.0
    truth = gain * np.abs(1.0 + 1j * f / corner) / np.abs(1.0 + 1j * f / 300.0)
    system = control.tf([gain / (TWO_PI * corner), gain], [1.0 / (TWO_PI * 300.0), 1.0])
    forms = [
        system, control.ss(system), (ls.gain(gain), ls.lead_lag(corner, 300.0)),
        lambda f_hz: gain * (1.0 + 1j * f_hz / corner) / (1.0 + 1j * f_hz / 300.0),
        tuple((x, y) for x, y in zip(f, 20.0 * np.log10(truth), strict=True)),
    ]  # fmt: skip
    for form in forms:
        np.testing.assert_allclose(ls.Weight("T", form).at(f), truth, rtol=1e-9)
    blocks = [{"kind": "gain", "gain": gain}, {"kind": "lead_lag", "f1_hz": corner, "f2_hz": 300.0}]
    np.testing.assert_allclose(ls.Weight.from_table({"response": "T", "blocks": blocks}).at(f), truth, rtol=1e-9)
    np.testing.assert_allclose(ls.Weight("T", 3).at(f), 3.0)


def test_what_is_no_weight_is_refused():
    for response, size, word in (
        ("L", 1.0, "S, T, CS or PS"), ("S", "30", "a number, points"), ("S", ((1.0, 2.0),), "two pairs"),
        ("S", ls.gain((1.0, 2.0)), "free parameters"), ("S", None, "a number, points"),
    ):  # fmt: skip
        with pytest.raises(ls.errors.WrongUseError, match=word):
            ls.Weight(response, size)
    with pytest.raises(ls.errors.WrongUseError, match="one finite number at each frequency"):
        ls.Weight("S", lambda f_hz: 1.0 / (f_hz - 1.0)).at([0.5, 1.0])
    with pytest.raises(ls.errors.WrongUseError, match="one finite number"):
        ls.Weight("S", lambda f_hz: 1.0).at([0.5, 1.0])
    with pytest.raises(ls.errors.WrongUseError, match="needs weights"):
        ls.Requirements(weighted_norm=1.0)
    with pytest.raises(ls.errors.WrongUseError, match="points or blocks"):
        requirements_of({"name": "a", "weights": [{"response": "S"}]})
    with pytest.raises(ls.errors.WrongUseError, match="needs weights"):
        requirements_of({"name": "a", "objective": "weighted_norm"})


def test_the_page_of_weights_runs(capsys):
    page = (Path(__file__).parents[4] / "docs" / "weights.md").read_text()
    left = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", page, flags=re.S)), left)
    assert left["C"].feasible
    assert "weighted_norm" in capsys.readouterr().out
    (table,) = re.findall(r"```toml\n(.*?)```", page, flags=re.S)
    assert requirements_of(tomllib.loads(table)["loop"][0]).objective == ls.Objective(0.0, weighted_norm=1.0)


def test_the_command_tunes_to_the_norm_of_a_file(tmp_path):
    words = """format = "loopshape-requirements/1"
[[loop]]
name = "one"
integrators = 1
unstable_poles = 0
phase_margin_deg = 40.0
objective = "weighted_norm"
weights = [
  { response = "S", points = [[0.5, 30.0], [20.0, -6.0]] },
  { response = "CS", blocks = [{ kind = "gain", gain = 0.05 }] },
]
structure = [{ kind = "gain", gain = { min = 0.01, max = 100.0 } }, { kind = "lead_lag", f1_hz = 10.0, f2_hz = 300.0 }]
"""
    (tmp_path / "r.toml").write_text(words)
    run = tmp_path / "run"
    write_frfs(run, servos(0.01))
    asked = [
        "tune",
        str(run),
        "--require",
        str(tmp_path / "r.toml"),
        "--out",
        str(tmp_path / "c.toml"),
        "--starts",
        "2",
    ]
    done = invoked([*asked, "--json"])
    (loop,) = json.loads(done.stdout)["loops"]
    weights = (ls.Weight("S", ((0.5, 30.0), (20.0, -6.0))), ls.Weight("CS", 0.05))
    (C,) = ls.read_controllers(tmp_path / "c.toml")
    truth = max(norm_of(one, C, weights) for one in servos(0.0, 3000))
    low, high = loop["weighted_norm_interval"]
    assert 0.998 * low <= truth <= 1.002 * high
    assert "weighted norm" in invoked(asked).stdout


def test_where_no_limit_binds_and_stability_is_undecided_the_search_goes_on_at_all_points():
    asked = required(GAIN, LEAD, weights=FOUR, objective="weighted_norm")
    p, asks = problem_of(servos(), asked), []
    loops = dict(zip("abc", loops_of(servos(), p.unit, asked)[0], strict=True))

    def judge(controller, points=None):
        asks.append(points)
        found = shifted_verdict(loops, controller, asked, points)
        unsure = {name: replace(one, stable="undecided") for name, one in found.margins.items()}
        return replace(found, margins=unsure)

    tighten_limits(p, search(p, initial_point(p, np.log([0.2, 10.0, 200.0])), LARGEST, 50), judge)
    assert len(asks) > 1
    assert all(points is None or len(points) > 0 for points in asks)
