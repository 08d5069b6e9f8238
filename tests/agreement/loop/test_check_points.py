"""What is said of single operating points agrees with the verdict of all; the worst is found in the order it claims."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import LIMIT_OF, LIMITS, Block, Loop, RequirementResult
from conversions import TWO_PI

import loopshape as ls
from loopshape.loop.points import margins_of, point_outcome, worst_of

RATE = 1000.0
F = np.geomspace(0.1, 60.0, 200)


def frf(gain: float, recording: str, noise: float = 0.1, seed: int = 0) -> ls.FRF:
    s = 1j * TWO_PI * F
    response = gain * np.exp(-0.0027 * s) / (s * (s / (TWO_PI * 8.0) + 1.0))
    rng = np.random.default_rng(seed)
    error = np.sqrt(0.5) * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
    variance = (noise * np.abs(response)) ** 2
    return ls.FRF(
        F, (response * (1.0 + noise * error))[:, None, None], variance[:, None, None] + 0j, np.ones(F.size, dtype=bool),
        ("z_v",), ("y_rad",), "made up", recording=recording, loop="axis", rate_hz=RATE,
    )  # fmt: skip


def loops(*gains: float) -> list[Loop]:
    one = ls.Controller("axis", (Block("gain", {"gain": 1.0}),), RATE)
    return [Loop(frf(gain, f"r{k + 1}"), one, 1, unstable_poles=0) for k, gain in enumerate(gains)]


def margins(modulus: float, low: float | None = None, stable: str = "stable", at_hz: float = 5.0) -> ls.Margins:
    numbers = {limit.name: 1.0 for limit in LIMITS} | {"modulus_margin": modulus}
    intervals = {} if low is None else {"modulus_margin": (low, 2.0 * modulus - low)}
    return ls.Margins.of(numbers, stable, at_hz={"modulus_margin": at_hz}, intervals=intervals)


def verdict(*found: ls.Margins, lines: tuple[RequirementResult, ...] = ()) -> ls.Verdict:
    return ls.Verdict("axis", lines, {f"r{k + 1}": m for k, m in enumerate(found)})


def test_the_outcome_of_the_verdicts_point_is_the_lines_outcome() -> None:
    controller = ls.Controller("axis", (Block("gain", {"gain": 1.0}),), RATE)
    requirements = ls.Requirements(
        "axis", integrators=1, gain_margin_db=8.0, phase_margin_deg=33.0, modulus_margin=0.5, sensitivity_peak_db=6.3,
        complementary_peak_db=3.0, control_peak_db=2.0,
    )  # fmt: skip
    frfs = [frf(gain, f"r{k}", seed=k) for k, gain in enumerate((30.0, 36.0, 45.0))]
    on_the_limit = ls.check(frfs, controller, requirements).margins["r1"].bandwidth_hz
    found = ls.check(frfs, controller, replace(requirements, bandwidth_hz=on_the_limit))
    outcomes = set()
    for line in found.lines:
        assert point_outcome(found.margins[line.recording], line.quantity, line.required) == line.outcome
        each = [point_outcome(m, line.quantity, line.required) for m in found.margins.values()]
        outcomes |= set(each)
        expected = "failed" if "failed" in each else "undecided" if "undecided" in each else "passed"
        assert line.outcome == expected
    assert outcomes == {"passed", "undecided", "failed"}


@pytest.mark.parametrize(
    ("interval", "outcome"), [((0.5, 0.6), "passed"), ((0.49, 0.6), "undecided"), ((0.4, 0.49), "failed")]
)
def test_an_interval_must_lie_on_one_side(interval: tuple[float, float], outcome: str) -> None:
    names = ("modulus_margin", "sensitivity_peak_db")
    point = ls.Margins.of(dict.fromkeys(names, 0.5), "stable", intervals=dict.fromkeys(names, interval))
    assert point_outcome(point, "modulus_margin", 0.5) == outcome
    other = {"passed": "undecided", "undecided": "undecided", "failed": "passed"}[outcome]
    assert point_outcome(point, "sensitivity_peak_db", 0.5) == other


def test_without_a_verdict_the_worst_comes_nearest_to_minus_one() -> None:
    some = loops(20.0, 45.0, 30.0)
    worst = worst_of(some)
    assert worst.index == 1
    assert worst.at_hz == F[np.argmin(np.abs(1.0 + some[1].L))]
    assert worst.why == "nearest to -1"


def test_with_a_verdict_the_low_end_of_the_interval_counts() -> None:
    found = verdict(margins(0.5, 0.49), margins(0.55, 0.3, at_hz=7.0), margins(0.6, 0.5))
    assert worst_of(loops(20.0, 30.0, 45.0), found) == worst_of(loops(45.0, 30.0, 20.0), found)
    assert worst_of(loops(20.0, 30.0, 45.0), found).index == 1
    assert worst_of(loops(20.0, 30.0, 45.0), found).at_hz == 7.0


def test_what_is_missed_comes_before_what_is_near_and_what_is_unstable_before_both() -> None:
    some = loops(20.0, 30.0, 45.0)
    missed = RequirementResult("phase_margin_deg", "deg", 45.0, 40.0, -5.0, "failed", "r3", 4.0)
    doubted = RequirementResult("gain_margin_db", "dB", 6.0, 6.1, -0.1, "undecided", "r2", 9.0)
    far = RequirementResult("bandwidth_hz", "Hz", 9.0, 4.0, -5.0, "failed", "r2", 4.0)
    near = (margins(0.3), margins(0.5), margins(0.6))
    worst = worst_of(some, verdict(*near, lines=(doubted, missed, far)))
    assert (worst.index, worst.at_hz, worst.why) == (2, 4.0, "misses phase margin")
    worst = worst_of(some, verdict(*near, lines=(doubted, far)))
    assert (worst.index, worst.at_hz, worst.why) == (1, 9.0, "undecided: gain margin")
    assert worst_of(some, verdict(*near, lines=(far,))).index == 0  # a bandwidth says nothing of the room about -1
    shaky = verdict(margins(0.3), margins(0.5, stable="unstable"), margins(0.6), lines=(missed,))
    assert (worst_of(some, shaky).index, worst_of(some, shaky).why) == (1, "unstable")
    shaky = verdict(margins(0.3), margins(0.5, stable="undecided"), margins(0.6), lines=(missed,))
    assert (worst_of(some, shaky).index, worst_of(some, shaky).why) == (1, "stability undecided")


def test_margins_are_found_by_recording() -> None:
    some = loops(20.0, 30.0)
    found = verdict(margins(0.3), margins(0.5))
    assert margins_of(some[1], 0, found) is found.margins["r2"]
    assert margins_of(some[1], 0, None) is None
    assert LIMIT_OF["modulus_margin"].sense == "at_least"
