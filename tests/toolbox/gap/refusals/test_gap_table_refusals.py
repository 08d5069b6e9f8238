"""What a comparison of two runs refuses, and what it says instead of refusing."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup, RecordingInfo

import loopshape as ls
from loopshape.toolbox.gap.two_runs.nu_gap import nu_gap
from loopshape.toolbox.gap.two_runs.table import compare
from loopshape.toolbox.gap.two_runs.table_pairs import pair_recordings

LOOP = LoopSetup("axis", "r_rad", "n_rad", "z_v", "y_rad", None)
INFO = RecordingInfo("one.parquet", "noise", "controller_input", excites="axis", operating_point={"y_rad": 0.0})


def recording(name="one", seed=0, rate_hz=100.0, samples=4000, drop=(), **info):
    rng = np.random.default_rng(seed)
    n = np.random.default_rng(9).standard_normal(samples)
    y = np.convolve(n, 0.5 ** np.arange(10))[:samples] + 0.01 * rng.standard_normal(samples)
    columns = {"r_rad": np.zeros(samples), "n_rad": n, "z_v": n - 0.1 * y, "y_rad": y}
    kept = {k: v for k, v in columns.items() if k not in drop}
    return ls.Recording(replace(INFO, file=f"{name}.parquet", **info), rate_hz, kept)


def run(*recordings, rate_hz=100.0, loop=LOOP):
    return ls.Run(rate_hz, (loop,), recordings or (recording(),))


def test_two_rates() -> None:
    with pytest.raises(
        ls.errors.WrongUseError, match=r"compared at one rate; received 100 and 200 Hz; import one with resample"
    ):
        compare(run(), run(rate_hz=200.0))


def test_no_common_loop() -> None:
    with pytest.raises(
        ls.errors.WrongUseError, match=r"share no loop.*loops axis and other; name the loops of both alike"
    ):
        compare(run(), run(loop=replace(LOOP, name="other")))


def test_an_unknown_kind_of_band() -> None:
    with pytest.raises(
        ls.errors.WrongUseError,
        match=r"kind of band is not known; received 'decade'; did you mean 'third_decade'. use octave or third_decade",
    ):
        compare(run(), run(), bands="decade")


def test_a_nu_gap_on_other_lines() -> None:
    def plant(f):
        response, covariance = np.ones((f.size, 1, 1), dtype=complex), np.zeros((f.size, 1, 1), dtype=complex)
        return ls.FRF(f, response, covariance, np.ones(f.size, dtype=bool), ("z_v",), ("y_rad",), "")

    with pytest.raises(ls.errors.WrongUseError, match="frequencies that both plants share"):
        nu_gap(plant(np.arange(1.0, 9.0)), plant(np.arange(1.0, 10.0)))


def test_what_does_not_match_is_said_and_not_refused() -> None:
    real = run(recording(), recording("two", operating_point={"y_rad": 1.0}))
    table = compare(real, run(recording(seed=1), recording("three", kind="sweep")))
    assert table.unmatched == (
        "recording two (noise of axis at y_rad 1) of the real run has no counterpart",
        "recording three (sweep of axis at y_rad 0) of the simulated run has no counterpart",
    )
    assert table.rows


def test_the_same_name_for_something_else_is_said() -> None:
    pairs, said = pair_recordings([recording()], [recording(operating_point={"y_rad": 1.0}), recording("late")])
    assert [(p.real.info.name, p.sim.info.name) for p in pairs] == [("one", "late")]
    assert said[0] == "both runs have a recording one, but they differ in operating point"


def test_order_pairs_what_words_do_not_part() -> None:
    real = [recording("a"), recording("b")]
    pairs, said = pair_recordings(real, [recording("x"), recording("y"), recording("z")])
    assert [p.sim.info.name for p in pairs] == ["x", "y"]
    assert len(said) == 1


def test_settings_of_the_rig_part_recordings() -> None:
    pairs, said = pair_recordings([recording()], [recording(parameters={"supply_bar": 1.25})])
    assert pairs == []
    assert "settings of the rig" in said[0]


def test_nothing_in_common_is_a_conclusion() -> None:
    table = compare(run(), run(recording(kind="sweep")))
    assert table.conclusion == "The two runs share no recording that can be compared."
    assert len(table.unmatched) == 3


def test_a_path_that_cannot_be_estimated_is_a_note() -> None:
    table = compare(run(), run(recording(drop=("n_rad",))))
    assert table.rows == ()
    assert len(table.notes) == 1
    assert "one, z -> y: recording one.parquet was made in closed loop and has no injected signal" in table.notes[0]


def test_controllers_that_differ_are_a_note() -> None:
    loops = [replace(LOOP, controller=ls.Controller("axis", (Block("gain", {"gain": g}),), 100.0)) for g in (0.1, 0.2)]
    table = compare(run(loop=loops[0]), run(recording(seed=1), loop=loops[1]))
    assert any("the controllers of loop axis differ" in note for note in table.notes)


def test_other_inputs_are_not_compared_in_time() -> None:
    still = dict(excites=None, kind="profile", injection="reference")
    one, two = recording(**still), recording(seed=1, **still)
    moved = dict(two.columns) | {"n_rad": 1.5 * two.column("n_rad")}
    table = compare(run(one), run(replace(two, columns=moved)))
    assert table.times == ()
    assert "n_rad differs between the runs by up to" in table.notes[0]
