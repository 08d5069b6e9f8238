"""Two recorded runs of the arm against each other: the table, its conclusion, its files."""

import json
from dataclasses import replace

import pytest
from simulated_machines import Arm1, ExperimentTemplate, header, measure
from study_signals import Multisine, Staircase, Sweep

import loopshape as ls
from loopshape.cli.output import Output
from loopshape.toolbox.gap.commands.gap_two_runs import two_runs
from loopshape.toolbox.gap.two_runs.table import compare

pytestmark = pytest.mark.long

POINTS = ({"theta2_deg": 0.0, "p_ab_bar": 1.0}, {"theta2_deg": 15.0, "p_ab_bar": 1.0})
ODD = tuple(0.1 * k for k in range(3, 141, 2) if k % 8 != 7)


def study(seed, changes=None, prefix=""):
    sweep = dict(spacing="logarithmic", ramp_s=1.0)
    templates = (
        ExperimentTemplate(
            f"{prefix}angle", "sweep", "controller_input", "theta2", Sweep(0.3, 15.0, 50.0, 0.05, **sweep), lead_s=2.0
        ),
        ExperimentTemplate(
            f"{prefix}pressure", "sweep", "controller_input", "p_ab", Sweep(0.3, 15.0, 40.0, 0.05, **sweep), lead_s=2.0
        ),
        ExperimentTemplate(
            f"{prefix}odd", "multisine", "controller_input", "theta2",
            Multisine(0.3, 14.0, 10.0, 0.1, 4, 7, ramp_s=2.0, lines_hz=ODD, crest_iterations=5), lead_s=2.0,
        ),
        ExperimentTemplate(
            f"{prefix}steps", "staircase", "reference", duration_s=9.0,
            references={"theta2": Staircase((1.0, 4.0), (0.15, 0.0)), "p_ab": Staircase((6.0,), (1.2,))},
        ),
    )  # fmt: skip
    return ls.rig.Study("simulated", "arm-1dof", templates, POINTS, seed=seed, changes=changes or {})


def arm_run(**words):
    made, plant = study(**words), Arm1()
    return replace(header(made, plant), recordings=tuple(measure(made, plant, threads=1)))


@pytest.fixture(scope="module")
def runs():
    stiff = {"stiffness_factor_a": 1.2, "stiffness_factor_b": 1.2}
    return {"real": arm_run(seed=1), "twin": arm_run(seed=2), "stiff": arm_run(seed=3, changes=stiff, prefix="other-")}


@pytest.fixture(scope="module")
def folders(runs, tmp_path_factory):
    place = tmp_path_factory.mktemp("two_runs")
    for name, run in runs.items():
        ls.write(run, place / name)
    return place


@pytest.fixture(scope="module")
def stiff(runs):
    return compare(runs["real"], runs["stiff"])


def test_a_twin_differs_nowhere(runs):
    table = compare(runs["real"], runs["twin"])
    assert len(table.rows) > 60
    assert (table.largest, table.unmatched, table.notes) == (None, (), ())
    assert not any(row.loud for row in table.times)
    assert table.conclusion.startswith("No difference beyond noise")
    assert all(row.interval[0] == 0.0 for row in table.nu_gaps)


def test_names_that_differ_are_matched_by_kind_loop_and_point(stiff):
    pairs = {(row.recording, row.simulated) for row in stiff.rows}
    assert ("angle-01", "other-angle-01") in pairs
    assert all(sim == f"other-{real}" for real, sim in pairs)
    assert stiff.unmatched == ()


def test_a_stiffer_arm_differs_in_the_joint_and_not_in_the_filling(stiff):
    significant = {row.path for row in stiff.rows if stiff.significant(row)}
    assert {"z_theta2 -> theta2", "p_a-p_b -> theta2"} <= significant
    assert "z_p -> p_a+p_b" not in {
        row.path for row in stiff.rows if stiff.significant(row) and row.operating_point["theta2_deg"] == 0.0
    }
    assert stiff.largest.path in ("z_theta2 -> theta2", "p_a-p_b -> theta2")
    assert stiff.largest.band_hz[0] < 6.0 < stiff.largest.band_hz[1]  # the resonance lies between 5 and 6 Hz
    assert "theta2 from 4.64 to 10 Hz" in stiff.conclusion


def test_the_pressures_to_the_angle_is_softer_by_stiffness_below_the_resonance(stiff):
    low = [r for r in stiff.rows if r.path == "p_a-p_b -> theta2" and r.band_hz[1] < 2.3 and r.recording == "odd-01"]
    assert low
    assert all(-0.6 < row.gain_db < 0.0 for row in low)


def test_the_multisine_tells_distortion_of_both_and_the_sweep_none(stiff):
    own = [row for row in stiff.rows if row.path == "z_theta2 -> theta2"]
    odd = [row for row in own if row.recording.startswith("odd")]
    assert odd
    assert all(row.distortion_real.odd_db < 0.0 for row in odd if row.distortion_real)
    assert any(row.distortion_real and row.distortion_sim for row in odd)
    assert all(row.distortion_real is None for row in own if row.recording.startswith("angle"))


def test_nu_gaps_stand_beside_those_between_neighbouring_points(stiff):
    rows = {row.recording: row for row in stiff.nu_gaps}
    angle = rows["odd-01"]
    assert angle.winding == "holds"
    assert angle.interval[0] < angle.value < angle.interval[1]
    assert angle.value > 1.2 * angle.scale
    assert angle.scale_to == POINTS[1]
    assert rows["pressure-01"].interval[0] == 0.0


def test_equal_inputs_are_compared_in_time(stiff):
    steps = [row for row in stiff.times if row.recording == "steps-01"]
    assert {"theta2_rad", "z_theta2_v", "p_a_bar", "p_a_bar + p_b_bar"} <= {row.signal for row in steps}
    assert {round(row.from_s) for row in steps if row.kind == "window"} == {0, 1, 4, 6}


def test_the_command_prints_writes_and_concludes(folders, capsys, tmp_path):
    table = two_runs(folders / "real", folders / "stiff", tmp_path / "gap.json", tmp_path / "report.png", Output())
    printed = capsys.readouterr().out
    assert "z_theta2 -> theta2" in printed
    assert " ".join(printed.split("\n\n")[0].split()) == table.conclusion
    assert max(map(len, printed.splitlines())) <= 80
    found = json.loads((tmp_path / "gap.json").read_text())
    assert found["format"] == "loopshape-gap-table/1"
    assert len(found["rows"]) == len(table.rows)
    assert sum(row["significant"] for row in found["rows"]) == sum(table.significant(row) for row in table.rows)
    assert found["conclusion"] == table.conclusion
    assert (tmp_path / "report.png").read_bytes().startswith(b"\x89PNG")


def test_it_is_quiet_when_asked_and_one_object_when_asked(folders, capsys):
    two_runs(folders / "real", folders / "twin", output=Output(quiet=True))
    assert capsys.readouterr().out == ""
    two_runs(folders / "real", folders / "twin", output=Output(as_json=True))
    assert json.loads(capsys.readouterr().out)["real"] == "real"


def test_what_only_one_run_holds_is_said(folders, runs, capsys):
    part = replace(runs["twin"], recordings=tuple(r for r in runs["twin"].recordings if "pressure" not in r.info.name))
    table = compare(ls.read(folders / "real"), part)
    assert [line for line in table.unmatched if "pressure-01" in line and "no counterpart" in line]
    assert not any(row.loop == "p_ab" for row in table.rows)


def test_nothing_is_written_where_a_run_is_refused(folders, tmp_path):
    with pytest.raises(ls.LoopshapeError):
        two_runs(folders / "real", tmp_path / "nowhere", tmp_path / "gap.json", tmp_path / "report.png", Output())
    with pytest.raises(ls.LoopshapeError, match=r"a report is a picture as PNG; received .*report.pdf"):
        two_runs(folders / "real", folders / "twin", tmp_path / "gap.json", tmp_path / "report.pdf", Output())
    with pytest.raises(ls.LoopshapeError):
        two_runs(folders / "real", folders / "twin", tmp_path / "gap.json", None, Output(), bands="thirds")
    assert list(tmp_path.iterdir()) == []
