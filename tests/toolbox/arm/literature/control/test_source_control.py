"""Section 5.2, tables 5.1 to 5.3 of DCT 2007.002: the source's controllers on its printed plants and on the model."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from source_controllers import (
    TABLES,
    angle_controller,
    controller,
    pressure_controller,
    third_order_plant,
)

import loopshape as ls
from loopshape.toolbox.arm.source import numbers, value

STUDIES = Path(__file__).parents[5] / "experiments"
GRID = {"low_hz": 0.05, "high_hz": 100.0, "count": 2000}


@pytest.fixture(scope="module")
def study():
    """The study's modules: loops and motion."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("arm1_identification", "arm1_control"):
            patch.syspath_prepend(str(STUDIES / name))
        yield importlib.import_module("arm1_loops"), importlib.import_module("arm1_motion")


@pytest.fixture(scope="module")
def printed(study):
    """Margins on the four printed plants, by plant, notch and delay."""
    return {row[:3]: row[4] for row in study[0].on_printed_plants(GRID, 0.0055)}


@pytest.mark.parametrize("table", TABLES)
def test_every_number_of_a_controller_s_table_stands_in_its_blocks(table):
    found = [v for block in controller(table).blocks for v in block.parameters.values()]
    names = ("gain", "lead1", "lead2", "notch", "b1", "b2", "lowpass", "zeta")
    given = {n: value(f"{table}.{n}") for n in names if f"{table}.{n}" in numbers()}
    assert sorted(found) == sorted([*given.values(), *([given["notch"]] if "notch" in given else [])])
    assert controller(table).loop == TABLES[table]


def test_variants_of_the_angle_controller_change_one_number_only():
    lower = angle_controller(20.0, notch_hz=value("figure_5_7.notch"))
    assert lower.blocks[0].parameters["gain"] == 20.0
    assert lower.blocks[2].parameters["f1_hz"] == lower.blocks[2].parameters["f2_hz"] == value("figure_5_7.notch")
    assert lower.blocks[1] == angle_controller().blocks[1]
    assert pressure_controller().loop == "p_ab"


def test_places_without_a_controller_or_a_fit_are_refused():
    with pytest.raises(ls.errors.WrongUseError, match="prints no controller"):
        controller("table_5_3")
    with pytest.raises(ls.errors.WrongUseError, match="no third-order fit"):
        third_order_plant("figure_4_13")


@pytest.mark.parametrize("place", ["figure_4_12", "figure_4_15.measured"])
@pytest.mark.parametrize("delay_s", [0.0, 0.0055])
def test_table_5_1_meets_all_requirements_on_both_plants_that_were_measured(study, printed, place, delay_s):
    m = printed[place, "notch as printed", delay_s]
    assert study[0].meets(m)
    low, high = value("table_5_1.bandwidth_low"), value("table_5_1.bandwidth_high")
    assert low <= m.bandwidth_hz <= high


def test_the_lowered_notch_hardly_holds_the_plants_that_were_simulated(study, printed):
    """Figure 5.7's controller on the source's own simulated fits: stable without delay, far from what it requires."""
    for place in ("figure_4_14", "figure_4_15.simulated"):
        m = printed[place, "notch of figure 5.7", 0.0]
        assert m.stable == "stable"
        assert m.phase_margin_deg < 20.0
    assert printed["figure_4_15.simulated", "notch of figure 5.7", 0.0055].stable == "unstable"


def test_the_printed_rise_time_is_faster_than_the_printed_plant_with_open_valves(study):
    """|z| = 1 V opens a valve for the whole period; the printed plant then moves at 29 deg/s."""
    motion, size = study[1], value("step_5_3.theta2")
    least = motion.fastest_rise_s(motion.stiffness_line_deg_s("figure_4_12"), size)
    assert least > 3.0 * value("table_5_3.theta2.tr")
    plant = third_order_plant("figure_4_12")
    free, limited = (motion.read_off(*motion.printed_step(plant, v, size, 3.0), size) for v in (None, 1.0))
    assert free.rise_time_s < value("table_5_3.theta2.tr") < limited.rise_time_s
    assert limited.rise_time_s == pytest.approx(least, rel=0.1)


def test_the_printed_pressure_rise_is_faster_than_its_printed_bandwidth_allows(study):
    loops, motion = study
    least = motion.fastest_rise_s(loops.implied_pressure_gain(), value("step_5_3.p_ab"))
    assert least > 1.8 * value("table_5_3.p_ab.tr")


def test_filling_both_muscles_is_no_faster_than_filling_one(study, arm_constants):
    """One throttle feeds the splitter: p_AB rises at 0.92 bar/s with both in-valves open, and falls at 2.98."""
    loops, motion = study
    up, down = motion.pressure_rates(loops.Arm("nominal", "nominal"))
    assert up == pytest.approx(0.92, abs=0.005)
    assert down == pytest.approx(2.98, abs=0.005)
    assert loops.implied_pressure_gain() > 0.5 * (up + down)


def test_throttles_scaled_by_the_study_give_the_printed_kappa(study):
    loops = study[0]
    arm = loops.matched({"label": "x", "effects": {"gas_law": 1.0}, "match": "figure_4_12.kappa"}, "x")
    assert arm.linearised((0.0, 1.0), {}).third_order()[0] == pytest.approx(value("figure_4_12.kappa"), rel=1e-9)
    assert arm.changes["throttle_factor"] < 0.59


def test_overshoot_and_delay_are_read_as_defined(study):
    t = np.arange(4000) / 1000.0
    r = np.interp(t, [0.5, 1.0, 2.5, 3.0], [0.0, 30.0, 30.0, 0.0])
    y = np.interp(t - 0.08, [0.5, 1.0, 1.1, 1.3, 2.5, 3.0], [0.0, 30.0, 34.0, 30.0, 30.0, 0.0])
    over = study[1].overshoots(r, y)
    assert over == pytest.approx((4.0, 0.0), abs=0.05)
    assert study[1].best_delay_s(r, np.roll(r, 80), 1000.0, 0.3) == pytest.approx(0.08)
