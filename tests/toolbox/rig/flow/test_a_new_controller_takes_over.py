"""A new controller takes over on a target share by share, or the target goes back; what it does is journaled."""

import json

import numpy as np
import pytest
from axis_study import experiment, study_text, target, write_study
from commands import invoked
from python_target_line import Running
from python_target_trial import KEPT, WENT_BACK

import loopshape as ls
from loopshape.toolbox.rig.target.trial import Why

pytestmark = pytest.mark.long
REQUIRED = ls.Requirements("axis1", sensitivity_peak_db=6.0, unstable_poles=0, integrators=1)
MOTOR = ["watchdog_ms = 5000"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = study_text(experiment(period_s=1.0, periods=6), target=MOTOR).replace(
        "f_high_hz = 60.0", "f_high_hz = 300.0"
    )
    return write_study(tmp_path_factory.mktemp("study"), text)


@pytest.fixture(scope="module")
def run(study, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "old"
    with Running(lambda: target(1)) as line:
        ls.rig.measure(study, out, port=line.port, arm=True)
    return out


def new(gain, corner_hz=5.0):
    blocks = (ls.gain(gain), ls.lead_lag(corner_hz, 61.0), ls.low_pass(200.0, order=1))
    return ls.controller(*blocks, rate_hz=1000.0, loop="axis1")


def journal(out):
    return [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]


def test_one_that_does_what_was_predicted_is_adopted(study, run, tmp_path):
    with Running(lambda: target(1)) as line:
        found = ls.rig.adopt(run, new(11.0), study, tmp_path / "out", port=line.port, requirements=[REQUIRED], arm=True)
        assert found.outcome == "adopted", found.reason
        assert [one.share for one in found.steps] == [0.0, 0.25, 0.5, 1.0, 1.0]
        assert line.target.settings.trial.phase == KEPT
    for one in found.steps[1:]:
        low, high = one.expected.error_rms
        assert 0.8 * low < one.error_rms < 1.2 * high
    assert [line["event"] for line in journal(tmp_path / "out")] == ["armed", *["share"] * 5, "adopted"]
    half = ls.read(tmp_path / "out" / "a050")
    np.testing.assert_allclose(
        half.loop("axis1").controller.response([3.0, 30.0]),
        0.5 * (new(9.0).response([3.0, 30.0]) + new(11.0).response([3.0, 30.0])), rtol=1e-9,
    )  # fmt: skip


def tried(study, run, out, controller, machine=lambda target: None):
    """A trial on an axis of which `machine` makes another one, and the target after it."""
    with Running(lambda: target(1)) as line:
        machine(line.target)
        found = ls.rig.adopt(run, controller, study, out, port=line.port, requirements=[REQUIRED], arm=True)
        return found, line.target


def test_one_that_the_run_rules_out_moves_nothing(study, run, tmp_path):
    with pytest.warns(UserWarning, match="refused: on the plant of one"):
        found, machine = tried(study, run, tmp_path / "out", new(36.0))
    assert (found.outcome, found.steps) == ("refused", ())
    assert "sensitivity_peak_db" in found.reason
    assert machine.log == []
    assert not (tmp_path / "out").exists()


def test_a_machine_that_changed_since_the_run_is_seen_under_the_old_controller(study, run, tmp_path):
    with pytest.warns(UserWarning, match="refused: on the plant as it is now"):
        found, machine = tried(study, run, tmp_path / "out", new(11.0), lambda t: setattr(t.machine, "gain", 1.4))
    assert (found.outcome, [one.share for one in found.steps]) == ("refused", [0.0])
    assert machine.settings.trial.share == 0.0
    assert found.controller.response([5.0]) == pytest.approx(new(9.0).response([5.0]))


def changes_at(share, gain):
    """A machine whose gain is another from a share on."""

    def change(target):
        move = target.machine.move

        def moved(u):
            trial = target.settings and target.settings.trial
            if trial and trial.share >= share:
                target.machine.gain = gain
            move(u)

        target.machine.move = moved

    return change


def test_a_machine_that_changes_under_way_is_taken_back_by_the_target(study, run, tmp_path):
    with pytest.warns(UserWarning, match="went back by itself"):
        found, machine = tried(study, run, tmp_path / "out", new(11.0), changes_at(0.4, 1.1))
    assert (found.outcome, found.steps[-1].share, found.went_back_by_itself) == ("went back", 0.5, True)
    assert machine.settings.trial.phase == WENT_BACK
    last = found.steps[-1]
    assert last.progress.why in (Why.ERROR_RMS, Why.ERROR_PEAK, Why.CONTROL_RANGE)
    assert last.progress.ticks <= last.watch.ramp + 9000  # the recording, a second of it at rest
    events = journal(tmp_path / "out")
    assert [one["event"] for one in events] == ["armed", "share", "share", "share", "went back"]
    assert "watched for" in events[-1]["reason"]


def test_a_change_too_small_for_the_target_is_seen_in_s(study, run, tmp_path):
    with pytest.warns(UserWarning, match="share 1"):
        found, _ = tried(study, run, tmp_path / "out", new(11.0), changes_at(0.9, 0.5))
    assert found.outcome == "went back"
    assert found.steps[-1].share == 1.0
    assert found.steps[-1].comparison.outcome == "refuted"


def test_without_a_word_to_arm_nothing_moves(study, run, tmp_path):
    with Running(lambda: target(1)) as line:
        with pytest.raises(ls.errors.WrongUseError, match="no motion"):
            ls.rig.adopt(run, new(11.0), study, tmp_path / "out", port=line.port, requirements=[REQUIRED])
        assert line.target.state == 0


def test_a_target_that_takes_no_trial_is_named(study, run, tmp_path):
    with Running(lambda: target(1, trials=False)) as line, pytest.raises(ls.errors.WrongUseError, match="no second"):
        ls.rig.adopt(run, new(11.0), study, tmp_path / "out", port=line.port, requirements=[REQUIRED], arm=True)


@pytest.fixture(scope="module")
def after(study, tmp_path_factory):
    """Runs under a gain of 11: of an axis as it was, and of one that has another gain."""
    out = tmp_path_factory.mktemp("after")
    for name, gain in (("same", 0.4), ("other", 0.6)):
        with Running(lambda: target(1)) as line:
            line.target.machine.gain = gain
            ls.rig.measure(study, out / name, port=line.port, arm=True, controllers=[new(11.0)])
    return out


def test_logs_alone_say_go_or_no_go(run, after):
    advise = ls.rig.advise
    before = advise(run, new(11.0), requirements=[REQUIRED])
    assert (before.advice, before.recipe, before.comparisons) == ("go", (), ())
    assert advise(run, new(36.0), requirements=[REQUIRED]).advice == "no go"
    same = advise(run, new(11.0), after=after / "same", requirements=[REQUIRED])
    assert (same.advice, same.comparisons[0].outcome) == ("go", "confirmed")
    other = advise(run, new(11.0), after=after / "other", requirements=[REQUIRED])
    assert (other.advice, other.comparisons[0].outcome) == ("no go", "refuted")


def test_logs_that_decide_nothing_say_what_to_record(run, study, tmp_path):
    """Nothing excites the loop in one; in the other noise leaves the peak open."""
    quiet = study_text("""
[[experiment]]
name = "rest"
duration_s = 4.0
""", target=MOTOR)  # fmt: skip
    with Running(lambda: target(1)) as line:
        ls.rig.measure(write_study(tmp_path, quiet), tmp_path / "rest", port=line.port, arm=True)
    found = ls.rig.advise(tmp_path / "rest", new(11.0), requirements=[REQUIRED])
    assert found.advice == "not decidable"
    assert found.recipe[0].startswith("record 60 s with a multisine at the controller's input, 0.5 to 200 Hz")
    strict = ls.Requirements("axis1", sensitivity_peak_db=3.99, unstable_poles=0, integrators=1)
    peak = ls.check(ls.frf(run), new(11.0), strict).lines[0]
    strict = ls.Requirements("axis1", sensitivity_peak_db=peak.value, unstable_poles=0, integrators=1)
    found = ls.rig.advise(run, new(11.0), requirements=[strict])
    assert found.advice == "not decidable"
    assert found.recipe
    after = ls.rig.advise(run, new(11.0), after=tmp_path / "rest", requirements=[REQUIRED])
    assert (after.advice, "multisine" in after.recipe[0]) == ("not decidable", True)


def test_the_command_says_it_and_its_exit_code(run, study, tmp_path):
    for name, gain in (("good", 11.0), ("bad", 36.0)):
        ls.write(new(gain), tmp_path / f"{name}.toml")
    (tmp_path / "required.toml").write_text(
        'format = "loopshape-requirements/1"\n[[loop]]\nname = "axis1"\nsensitivity_peak_db = 6.0\n'
        "unstable_poles = 0\nintegrators = 1\n"
    )
    required = ["--require", str(tmp_path / "required.toml")]
    said = invoked(["adopt", str(run), str(tmp_path / "good.toml"), *required])
    assert (said.exit_code, said.output.partition(":")[0]) == (0, "go")
    said = invoked(["adopt", str(run), str(tmp_path / "bad.toml"), "--json", *required])
    assert (said.exit_code, json.loads(said.output)["advice"]) == (1, "no go")
    said = invoked(["adopt", str(run), str(tmp_path / "good.toml"), "--study", str(study)])
    assert isinstance(said.exception, ls.errors.WrongUseError)
    with Running(lambda: target(1)) as line:
        words = ["--study", str(study), "--port", line.port, "--out", str(tmp_path / "out"), "--arm", *required]
        said = invoked(["adopt", str(run), str(tmp_path / "good.toml"), *words])
    assert said.exit_code == 0, said.output
    assert "adopted: S is as predicted" in said.output
