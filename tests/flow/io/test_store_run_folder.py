"""Run folders survive the round trip, a kill between two writes, and a resume."""

import os
from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup, RecordingInfo

import loopshape as ls
from loopshape.io.run import run_folder
from loopshape.io.run.run_folder import (
    add_recording,
    check_recordings,
    finished,
    marks_as_read,
    read_run,
    start_run,
    write_run,
)
from loopshape.io.run.tables import TableColumns, check_rate, write_table

RATE_HZ = 100.0

EXAMPLE = """
format = "loopshape-run/1"
plant = "arm-1dof"             # the nominal model
rate_hz = 1000.0

[pwm]
frequency_hz = 50.0
dead_zone = 0.01

[[loop]]
name = "p_ab"
reference = "r_p_ab_bar"
injected = "n_p_ab_bar"
control = "z_p_v"
output = "p_a_bar + p_b_bar"
discretisation = "tustin"
controller = [
  { kind = "gain", gain = 55.0 },
  { kind = "lead_lag", f1_hz = 1.0, f2_hz = 15.0 },
  { kind = "notch", f1_hz = 6.1, f2_hz = 6.1, damping1 = 0.05, damping2 = 5.0 },
  { kind = "low_pass", order = 2, f_hz = 15.0, damping = 0.7 },
]

[[recording]]
file = "r03.csv"
role = "validation"
kind = "multisine"
excites = "p_ab"
injection = "controller_input"
closed_loop = true
operating_point = { theta2_deg = 0.0, p_ab_bar = 1.0 }
period_s = 20.0
periodic_from_s = 1.0
"""


def controller():
    blocks = (
        Block("gain", {"gain": 1 / 3}),
        Block("low_pass_1", {"f_hz": 15.0}),
        Block("low_pass_2", {"f_hz": 15.0, "damping": 0.7}),
        Block("pi", {"f_hz": 0.1}),
    )
    return ls.Controller("theta2", blocks, RATE_HZ)


def columns(n=400, seed=0):
    rng = np.random.default_rng(seed)
    names = ("r_theta2_rad", "n_theta2_rad", "z_theta2_v", "theta2_rad")
    return {name: rng.standard_normal(n) for name in names}


def recording(name="r01", **changes):
    info = RecordingInfo(
        f"{name}.parquet",
        "multisine",
        "controller_input",
        role="validation",
        excites="theta2",
        operating_point={"theta2_deg": 10.0, "p_ab_bar": 1.1},
        period_s=2.0,
        periodic_from_s=0.5,
        ended_early="the angle left its limits after 3 s",
    )
    return ls.Recording(replace(info, **changes), RATE_HZ, columns())


def run(*recordings):
    loops = (
        LoopSetup("theta2", "r_theta2_rad", "n_theta2_rad", "z_theta2_v", "theta2_rad", controller()),
        LoopSetup("open", None, None, "u_v", "p_a_bar + p_b_bar", None),
    )
    extra = {"parameters": {"mass_kg": 95.1}, "label": 'a "quoted" name\nof two lines', "list": [1, [2.5]], "no": False}
    return ls.Run(RATE_HZ, loops, recordings, "arm-1dof", {"frequency_hz": 50.0, "dead_zone": 0.01}, extra)


def assert_same_header(one, other):
    assert (one.rate_hz, one.plant, one.pwm, one.extra) == (other.rate_hz, other.plant, other.pwm, other.extra)
    for mine, theirs in zip(one.loops, other.loops, strict=True):
        for word in ("name", "reference", "injected", "control", "output"):
            assert getattr(mine, word) == getattr(theirs, word)
        assert (mine.controller is None) == (theirs.controller is None)
        if mine.controller and theirs.controller:
            assert mine.controller.blocks == theirs.controller.blocks
            assert mine.controller.rate_hz == theirs.controller.rate_hz


def test_everything_in_a_run_comes_back(tmp_path):
    made = run(recording("r01"), recording("r02", ended_early=None, kind="sweep", period_s=None, operating_point={}))
    write_run(tmp_path / "run", made)
    back = read_run(tmp_path / "run")
    assert_same_header(back, made)
    assert [r.info for r in back.recordings] == [r.info for r in made.recordings]
    for mine, theirs in zip(made.recordings, back.recordings, strict=True):
        for name, values in mine.columns.items():
            np.testing.assert_array_equal(theirs.column(name), values)
        np.testing.assert_array_equal(theirs.column("t_s"), np.arange(400) / RATE_HZ)


def two_loops(*recordings, outputs=()):
    """A run of two loops whose columns come out of `columns` and of `second`."""
    loops = (
        LoopSetup("theta2", "r_theta2_rad", "n_theta2_rad", "z_theta2_v", "theta2_rad", None),
        LoopSetup("theta1", "r_theta1_rad", "n_theta1_rad", "z_theta1_v", "theta1_rad", None),
    )
    return ls.Run(RATE_HZ, loops, recordings, outputs=outputs)


def both(**changes):
    """A recording that excites both loops, with two accelerations and the columns changed by name."""
    rng = np.random.default_rng(7)
    names = ("r_theta1_rad", "n_theta1_rad", "z_theta1_v", "theta1_rad", "a01_m_s2", "a02_m_s2")
    data = columns() | {name: rng.standard_normal(400) for name in names} | changes
    return replace(recording(excites_also=("theta1",)), columns=data)


OUTPUTS = ("a01_m_s2", "theta1_rad + theta2_rad")


def test_further_excited_loops_and_outputs_come_back(tmp_path):
    made = two_loops(both(), outputs=OUTPUTS)
    write_run(tmp_path / "run", made)
    back = read_run(tmp_path / "run")
    assert back.outputs == OUTPUTS
    assert back.extra == {}
    assert back.recordings[0].info == made.recordings[0].info
    assert back.recordings[0].info.excited == ("theta2", "theta1")
    text = (tmp_path / "run" / "run.toml").read_text()
    assert 'excites_also = ["theta1"]\n' in text
    assert 'outputs = ["a01_m_s2", "theta1_rad + theta2_rad"]\n' in text
    write_run(tmp_path / "plain", run(recording()))
    assert "excites_also" not in (tmp_path / "plain" / "run.toml").read_text()
    assert "outputs" not in (tmp_path / "plain" / "run.toml").read_text()
    assert read_run(tmp_path / "plain").outputs == ()


@pytest.mark.parametrize("outputs", [(), OUTPUTS[:1], OUTPUTS[::-1]])
def test_a_run_of_other_outputs_is_another_run(tmp_path, outputs):
    write_run(tmp_path / "run", two_loops(both(), outputs=OUTPUTS))
    start_run(tmp_path / "run", two_loops(outputs=OUTPUTS))
    with pytest.raises(ls.errors.WrongUseError, match="already holds another run; received different outputs"):
        start_run(tmp_path / "run", two_loops(outputs=outputs))


def test_outputs_belong_to_a_recording_s_mark(tmp_path):
    marks = []
    for k, outputs in enumerate([(), OUTPUTS, OUTPUTS[:1]]):
        write_run(tmp_path / str(k), two_loops(both(), outputs=outputs))
        marks.append(marks_as_read(read_run(tmp_path / str(k)), ["r01"])["r01"])
    assert len(set(marks)) == 3


@pytest.mark.parametrize("name", ["n_theta1_rad", "z_theta1_v", "theta1_rad", "n_theta2_rad", "a01_m_s2"])
def test_signals_of_every_excited_loop_and_every_output_must_move(name):
    assert check_recordings(two_loops(both(), outputs=OUTPUTS)) == []
    stuck = both(**{name: np.full(400, 2.5)})
    with pytest.raises(
        ls.errors.BadSignalError, match=rf"{name} of recording r01\.parquet does not move although loop .* is exc"
    ):
        check_recordings(two_loops(stuck, outputs=OUTPUTS))


def test_signals_that_nobody_asked_for_may_stand_still():
    still = np.zeros(400)
    assert check_recordings(two_loops(both(a01_m_s2=still, r_theta1_rad=still))) == []
    one = both(n_theta1_rad=still, z_theta1_v=still)
    alone = replace(one, info=replace(one.info, excites_also=()))
    assert check_recordings(two_loops(alone)) == []


@pytest.mark.parametrize("name", ["z_theta1_v", "theta1_rad", "a01_m_s2"])
def test_a_clipped_signal_of_a_further_loop_or_output_is_called_saturated(name):
    values = both().columns[name]
    clipped_one = both(**{name: np.minimum(values, np.quantile(values, 0.9))})
    (sentence,) = check_recordings(two_loops(clipped_one, outputs=OUTPUTS[:1]))
    assert sentence.startswith(f"{name} of recording r01.parquet sits at ")


def test_the_documented_example_is_read(tmp_path):
    (tmp_path / "run.toml").write_text(EXAMPLE)
    (tmp_path / "r03.csv").write_text("t_s, z_p_v, p_a_bar, p_b_bar\n0.000,1,0.5,0.25\n0.001,2,0.5,0.5\n")
    back = read_run(tmp_path)
    info = back.recordings[0].info
    assert (info.role, info.excites, info.period_s) == ("validation", "p_ab", 20.0)
    assert [b.kind for b in back.loop("p_ab").controller.blocks] == ["gain", "lead_lag", "notch", "low_pass_2"]
    np.testing.assert_array_equal(back.recordings[0].output(back.loop("p_ab").output), [0.75, 1.0])


def test_run_toml_reads_like_the_example(tmp_path):
    write_run(tmp_path / "run", run(recording()))
    text = (tmp_path / "run" / "run.toml").read_text()
    assert '  { kind = "low_pass", order = 2, f_hz = 15.0, damping = 0.7 },\n' in text
    assert "operating_point = { theta2_deg = 10.0, p_ab_bar = 1.1 }" in text
    assert text.index("[[loop]]") < text.index("[[recording]]")


def test_a_kill_between_table_and_run_toml_leaves_the_run_as_it_was(tmp_path, monkeypatch):
    folder = tmp_path / "run"
    start_run(folder, run())
    add_recording(folder, recording("r01"))

    def killed(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(run_folder, "write_toml", killed)
    with pytest.raises(KeyboardInterrupt):
        add_recording(folder, recording("r02"))
    monkeypatch.undo()
    assert (folder / "r02.parquet").exists()
    assert finished(folder) == {"r01"}
    start_run(folder, run())  # the same command again
    add_recording(folder, recording("r02"))
    assert finished(folder) == {"r01", "r02"}
    assert len(read_run(folder).recordings) == 2


def test_a_kill_while_a_table_is_written_leaves_no_half_table(tmp_path, monkeypatch):
    folder = tmp_path / "run"
    start_run(folder, run())

    def killed(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        add_recording(folder, recording("r01"))
    assert [p.name for p in folder.iterdir()] == ["run.toml"]


def test_a_resume_removes_what_a_kill_left(tmp_path):
    folder = tmp_path / "run"
    start_run(folder, run())
    (folder / ".r01.parquet.77-abc.part").write_bytes(b"half")
    start_run(folder, run())
    assert [p.name for p in folder.iterdir()] == ["run.toml"]


def test_a_run_without_a_folder_has_nothing_finished(tmp_path):
    assert finished(tmp_path / "run") == set()


def test_new_notes_are_kept_with_the_old_ones(tmp_path):
    made = run()
    write_run(tmp_path / "run", replace(made, extra={"notes": ["one"]}, recordings=(recording("r01"),)))
    write_run(tmp_path / "run", replace(made, extra={"notes": ["two"]}, recordings=(recording("r02"),)))
    back = read_run(tmp_path / "run")
    assert back.extra["notes"] == ["one", "two"]
    assert len(back.recordings) == 2


@pytest.mark.parametrize("ending", [".parquet", ".csv", ".csv.gz"])
def test_columns_load_when_asked_for(tmp_path, ending):
    import pandas as pd

    path = tmp_path / f"r{ending}"
    data = columns(50)
    if ending == ".parquet":
        write_table(path, data)
    else:
        pd.DataFrame(data).to_csv(path, index=False)
    table = TableColumns(path)
    assert tuple(table) == tuple(data)
    assert table.rows == 50
    assert "t_s" not in table
    for name, values in data.items():
        np.testing.assert_allclose(table[name], values, rtol=4e-16)  # pandas before 3 may miss a CSV's last bit
        assert not table[name].flags.writeable


def test_a_table_keeps_nan_and_the_last_bit(tmp_path):
    values = np.array([0.1 + 0.2, np.nan, -0.0, 1e-310])
    write_table(tmp_path / "r.parquet", {"u_v": values})
    assert TableColumns(tmp_path / "r.parquet")["u_v"].tobytes() == values.tobytes()


def test_missing_parquet_values_become_nan(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"u_v": [1, None, 3], "flag_1": [True, False, True]}), tmp_path / "r.parquet")
    table = TableColumns(tmp_path / "r.parquet")
    np.testing.assert_array_equal(table["u_v"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(table["flag_1"], [1.0, 0.0, 1.0])


def test_stamps_within_a_hundredth_of_a_sample_keep_the_rate():
    t = 5.0 + np.arange(10_000) / 1000.0
    check_rate(t, 1000.0)
    check_rate(np.round(t, 6), 1000.0)
    check_rate(t + 0.9e-5 * (-1.0) ** np.arange(10_000) * (np.arange(10_000) > 0), 1000.0)
    assert "scatter" in check_rate(t + 2.1e-5 * (np.arange(10_000) == 500), 1000.0)
    with pytest.raises(ls.errors.BadSignalError, match="now and then"):
        check_rate(t + 2.1e-3 * (np.arange(10_000) == 500), 1000.0)


def clipped(share):
    data = columns(1000)
    z = data["z_theta2_v"]
    data["z_theta2_v"] = np.minimum(z, np.quantile(z, 1.0 - share))
    return replace(recording(), columns=data)


def test_only_a_clipped_signal_is_called_saturated():
    assert check_recordings(run(clipped(0.01))) == []
    (sentence,) = check_recordings(run(clipped(0.05)))
    assert "z_theta2_v" in sentence
    assert "5.1 %" in sentence or "5.0 %" in sentence


def test_coarse_converters_and_staircases_are_not_called_saturated():
    data = columns(1000)
    data["theta2_rad"] = np.clip(np.round(data["theta2_rad"] * 40) / 40, -1, 1)
    data["z_theta2_v"] = np.repeat(np.arange(10.0), 100)
    assert check_recordings(run(replace(recording(), columns=data))) == []
