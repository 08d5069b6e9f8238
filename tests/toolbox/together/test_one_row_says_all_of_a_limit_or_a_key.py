"""A quantity of LIMITS and a key of `[[recording]]` are written once: each place that needs them is shown to have them.

What a newcomer forgets fails here, by its name.
"""

from dataclasses import MISSING, fields, replace
from types import SimpleNamespace

import pytest
from bench_nouns import LIMITS, RecordingInfo, RequirementResult
from verdict_cases import CONTROLLER, margins

import loopshape as ls
from loopshape.data.signal.experiment import ExperimentSettings
from loopshape.design.structure import NEAR
from loopshape.io.config_table import ConfigTable
from loopshape.io.run.run_tables import read_recording, recording_table
from loopshape.loop.points import CLOSENESS
from loopshape.toolbox.limits.bound_nodes import COUNTED, counted
from loopshape.toolbox.pages.report.verdict_parts import _column
from loopshape.toolbox.pages.report.verdict_parts import margins as margin_tables
from loopshape.toolbox.rig.files.study import _EXPERIMENT_KEYS

NAMES = [limit.name for limit in LIMITS]
MASKED = [name for name in NAMES if name.endswith(("_mask_db", "_floor_db"))]
LOOPS = (SimpleNamespace(name="a"), SimpleNamespace(name="b"))


def asked(name, value=0.9):
    """Requirements of one limit alone."""
    also = {"control_high_frequency_from_hz": 50.0} if name == "control_high_frequency_db" else {}
    if name in MASKED:
        response = ("S", "T", "CS", "PS", "L", "L")[MASKED.index(name)]
        sense = "at_least" if name == "loop_floor_db" else "at_most"
        also = {"masks": (ls.Mask(response, ((1.0, 0.0), (2.0, 0.0)), sense),)}
    if name == "saturation_percent":
        also = {"control_range": (-1.0, 1.0)}
    if name == "weighted_norm":
        also = {"weights": (ls.Weight("S", ((1.0, 0.0), (2.0, 0.0))),)}
    return {name: value} | also


@pytest.mark.parametrize("name", NAMES)
def test_a_limit_is_asked_for_and_found_under_one_name(name):
    assert name in {f.name for f in fields(ls.Requirements)} & set(margins())
    words = {
        "masks": lambda mask: vars(mask),
        "weights": lambda weight: {"response": weight.response, "points": weight.size},
    }
    table = {k: [words[k](one) for one in value] if k in words else value for k, value in asked(name).items()}
    assert ls.Requirements.from_table({"name": "axis", **table}) is not None
    assert name in margins().to_dict()
    assert f"{name} at" in repr(ls.Requirements("axis", **asked(name)))


@pytest.mark.parametrize("limit", LIMITS, ids=NAMES)
def test_the_report_shows_each_quantity_in_one_of_its_two_tables(limit):
    found = ls.Verdict(
        "axis", (RequirementResult(limit.name, limit.unit, 1.0, 10.0, 1.0, "passed", "r1", 3.0),), {"r1": margins()}
    )
    one = SimpleNamespace(verdict=found, frfs=(), loops=(), controller=CONTROLLER)
    tables = str(margin_tables(one)).split("<table")[1:]
    assert [str(_column(limit)) in table for table in tables] == [limit.margin, not limit.margin]


@pytest.mark.parametrize("name", [name for name in NAMES if name != "bandwidth_hz"])
def test_a_bound_counts_each_limit_or_says_that_it_leaves_it_out(name):
    used, left = counted(ls.Requirements("axis", **asked(name)))
    assert (used, left) == (((name,), ()) if name in COUNTED else ((), (name,)))


def test_ranks_of_closeness_are_one_after_another_and_what_keeps_off_is_close():
    ranks = sorted(limit.closeness for limit in LIMITS if limit.closeness)
    assert ranks == list(range(1, len(ranks) + 1))
    assert CLOSENESS[0] == "modulus_margin"
    assert set(NEAR) <= set(CLOSENESS)


def test_what_an_experiment_tells_is_said_in_the_same_words_by_study_and_run():
    told = {f.name for f in fields(ExperimentSettings)}
    assert told <= set(_EXPERIMENT_KEYS)


def test_every_key_of_a_recording_comes_back_as_it_was():
    filled = RecordingInfo(
        "r1.parquet", "noise", "plant_input", role="validation", excites="a", excites_also=("b",), closed_loop=True,
        operating_point={"x_m": 0.1}, period_s=2.0, periodic_from_s=0.5, parameters={"mass_kg": 3.0}, ended_early="why",
    )  # fmt: skip
    plain = [f.name for f in fields(RecordingInfo) if f.default is not MISSING and getattr(filled, f.name) == f.default]
    assert plain == ["closed_loop"]  # the rest is not at its default, so a key that is not written shows
    for info in (filled, replace(filled, injection="control", closed_loop=False)):
        written = {key: value for key, value in recording_table(info).items() if value is not None}
        assert read_recording(ConfigTable(written, "r1"), LOOPS) == info
