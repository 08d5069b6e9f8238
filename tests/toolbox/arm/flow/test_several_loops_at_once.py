"""Two loops of the 2-DoF arm excited at once: from a study's words over the simulated rig into a run folder."""

from dataclasses import replace

import numpy as np
import pytest
from arm2_cases import QUIET
from run_files import check_recordings, start_run
from simulated_machines import header, measure, plan, read_study

import loopshape as ls
from loopshape.toolbox.rig import registry

RATE_HZ = 1000.0
LEAD, RAMP, PERIOD, PERIODS = 1000, 1000, 4000, 4  # samples
HEAD = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-2dof"
seed = 1
operating_points = [{ theta1_deg = 0.0, theta2_deg = 0.0, p_a_bar = 0.4, p_c_bar = 0.4 }]
"""
SINE = 'kind = "multisine", f_low_hz = 0.5, f_high_hz = 8.0, period_s = 4.0, periods = 4, odd = true'
BOTH = f"""
[[experiment]]
name = "both"
injection = "plant_input"
lead_s = 1.0
[experiment.excitations]
theta1 = {{ {SINE}, amplitude_v = 0.1 }}
theta2 = {{ {SINE}, amplitude_v = 0.2 }}
"""
HISS = """
[[experiment]]
name = "hiss"
injection = "plant_input"
[experiment.excitations]
theta2 = { kind = "noise", f_low_hz = 0.5, f_high_hz = 8.0, duration_s = 6.0, amplitude_v = 0.05 }
p_a = { kind = "noise", f_low_hz = 0.5, f_high_hz = 8.0, duration_s = 6.0, amplitude_v = 0.05 }
"""
NOISELESS = "[parameters]\n" + "".join(f"{name} = {value}\n" for name, value in QUIET.items())
LOOPS = ("theta1", "theta2", "p_a", "p_c")
ANGLES = ("theta1_rad", "theta2_rad")


def study(tmp_path, text):
    (tmp_path / "study.toml").write_text(HEAD + text)
    return read_study(tmp_path / "study.toml"), registry.plant("arm-2dof")


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The study of two loops at once without sensor noise, its plant, and its recordings."""
    made, plant = study(tmp_path_factory.mktemp("both"), NOISELESS + BOTH)
    return made, plant, list(measure(made, plant, threads=1))


def test_each_recording_excites_both_loops_with_what_the_study_asks(both):
    made, _, recordings = both
    assert [r.info.file for r in recordings] == ["both-s1.parquet", "both-s2.parquet"]
    for template, recording in zip(made.experiments, recordings, strict=True):
        info = recording.info
        assert info.excited == ("theta1", "theta2")
        assert (info.kind, info.injection, info.ended_early) == ("multisine", "plant_input", None)
        assert (info.period_s, info.periodic_from_s) == (4.0, 2.0)
        for loop, excitation in template.excited.items():
            n = recording.column(f"n_{loop}_v")
            np.testing.assert_array_equal(n[:LEAD], 0.0)
            np.testing.assert_array_equal(n[LEAD:], excitation.signal(RATE_HZ))
            assert np.abs(n).max() == pytest.approx({"theta1": 0.1, "theta2": 0.2}[loop], rel=1e-12)
        np.testing.assert_array_equal(recording.column("n_p_a_v"), 0.0)
    one, two = recordings
    np.testing.assert_array_equal(one.column("n_theta1_v"), two.column("n_theta1_v"))
    np.testing.assert_array_equal(one.column("n_theta2_v"), -two.column("n_theta2_v"))


def test_the_run_folder_keeps_them(both, tmp_path):
    made, plant, recordings = both
    folder = tmp_path / "run"
    start_run(folder, header(made, plant))
    ls.write(replace(header(made, plant), recordings=recordings), folder)
    back = ls.read(folder)
    assert [r.info for r in back.recordings] == [r.info for r in recordings]
    for mine, theirs in zip(recordings, back.recordings, strict=True):
        for name in mine.columns:
            np.testing.assert_array_equal(theirs.column(name), mine.column(name))
    assert check_recordings(back) == []


def test_both_excitations_enter_at_the_plant_s_inputs(both):
    """The flow commands are the decoupling of z + n of every loop at once (`closed_loop2`)."""
    for recording in both[2]:
        u = {m: recording.column(f"u_{m}_v") for m in "abcd"}
        asked = {loop: recording.column(f"z_{loop}_v") + recording.column(f"n_{loop}_v") for loop in LOOPS}
        np.testing.assert_allclose(u["d"], asked["theta1"], atol=1e-12)
        np.testing.assert_allclose(u["c"], asked["p_c"] - asked["theta1"], atol=1e-12)
        np.testing.assert_allclose(u["b"], -asked["theta2"], atol=1e-12)
        np.testing.assert_allclose(u["a"], asked["p_a"] + asked["theta2"], atol=1e-12)
        assert min(np.ptp(recording.column(angle)) for angle in ANGLES) > 1e-3


def test_what_is_done_is_left_out(both):
    made, plant, recordings = both
    (second,) = measure(made, plant, done=frozenset({"both-s1"}), threads=1)
    np.testing.assert_array_equal(second.column("theta1_rad"), recordings[1].column("theta1_rad"))


def test_noise_in_two_loops_is_one_recording_without_a_period(tmp_path):
    (recording,) = measure(*study(tmp_path, HISS), threads=1)
    info = recording.info
    assert (info.file, info.kind, info.excited) == ("hiss.parquet", "noise", ("theta2", "p_a"))
    assert (info.period_s, info.periodic_from_s) == (None, None)
    a, b = recording.column("n_theta2_v"), recording.column("n_p_a_v")
    assert min(a.std(), b.std()) > 0.03
    assert abs(np.corrcoef(a, b)[0, 1]) < 4.0 / np.sqrt(2 * 7.5 * 6.0)


def test_names_of_realisations_at_several_points(tmp_path):
    points = "{ theta1_deg = 0.0, theta2_deg = 0.0, p_a_bar = 0.4, p_c_bar = 0.4 }"
    other = points.replace("theta2_deg = 0.0", "theta2_deg = 5.0")
    text = BOTH.replace("lead_s", f"realisations = 2\noperating_points = [{points}, {other}]\nlead_s")
    names = [planned.name for planned in plan(*study(tmp_path, text))]
    assert names == [f"both-r{r}-s{s}-0{k}" for r in (1, 2) for s in (1, 2) for k in (1, 2)]


def test_references_of_two_loops_move_at_once(tmp_path):
    text = BOTH.replace("plant_input", "reference").replace("amplitude_v", "amplitude_deg")
    first, second = measure(*study(tmp_path, text), threads=1)
    for loop in ("theta1", "theta2"):
        assert np.ptp(first.column(f"r_{loop}_rad")) > 1e-3
    np.testing.assert_allclose(first.column("r_theta2_rad"), -second.column("r_theta2_rad"), atol=1e-15)
    assert np.ptp(first.column("r_p_a_bar")) == 0.0


@pytest.mark.parametrize(("loop", "column"), [("theta1", "n_theta1_v"), ("theta2", "n_theta2_v")])
def test_every_loop_s_unit_is_held_against_its_place(tmp_path, loop, column):
    line = next(row for row in BOTH.splitlines() if row.startswith(loop))
    text = BOTH.replace(line, line.replace("amplitude_v", "amplitude_deg"))
    with pytest.raises(
        ls.errors.WrongUseError, match=f"'both-s1' moves {column} in another unit; received rad; give it in V"
    ):
        plan(*study(tmp_path, text))


def test_every_loop_must_be_the_plant_s(tmp_path):
    with pytest.raises(
        ls.errors.WrongUseError, match="'both-s1' names a loop that arm-2dof does not have; received 'theta3'"
    ):
        plan(*study(tmp_path, BOTH.replace("theta2 =", "theta3 =")))


def test_multisines_of_two_lengths_are_not_called_periodic(tmp_path):
    """A template made in Python may hold them; the recording is as long as the longer one."""
    made, plant = study(tmp_path, BOTH)
    template = made.experiments[0]
    longer = replace(template.excites_also["theta2"], periods=PERIODS + 1)
    template = replace(template, excites_also={"theta2": longer})
    (recording,) = measure(replace(made, experiments=(template,)), plant, threads=1)
    assert (recording.info.period_s, recording.info.periodic_from_s) == (None, None)
    assert recording.column("n_theta1_v").size == LEAD + 2 * RAMP + (PERIODS + 1) * PERIOD
