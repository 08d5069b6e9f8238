"""A bad line and a target that fails: a recording is exactly right or not kept, in one sentence; nothing hangs."""

import time
from collections import Counter

import numpy as np
import pytest
from axis_study import experiment, measured, simulated, study_text, table, target, write_study
from python_target_line import Faults, Pty, Running
from run_files import finished, verify

import loopshape as ls
from loopshape.toolbox.rig.target import acquisition, session

pytestmark = pytest.mark.timeout(60)  # a hang is a failure
NAMES = ("one", "two")
TEXT = study_text(
    experiment("one", period_s=0.25), experiment("two", period_s=0.25, amplitude=0.03), target=["watchdog_ms = 500"]
)
KINDS = ("drop", "corrupt", "duplicate", "delay", "cut", "garbage", "oversize", "lie", "foreign", "late")


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """A request is sent again sooner than by default, and given up after the same time: the tests wait less."""
    monkeypatch.setattr(session, "ANSWER_S", 0.03)
    monkeypatch.setattr(session, "TRIES", 20)
    monkeypatch.setattr(acquisition, "PATIENCE_S", 0.02)


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    study = write_study(tmp_path_factory.mktemp("expected"), TEXT)
    return {name: simulated(study, name) for name in NAMES}


def right(run, expected):
    """What is kept is what was done, number by number, and every file is sound."""
    kept = finished(run) if run.exists() else set()
    for name in kept:
        found = table(run, name)
        for key, values in expected[name].items():
            np.testing.assert_array_equal(found[key], values, err_msg=f"{name} {key}")
    if run.exists():
        assert not [one for one in verify(run) if one.sound is False]
    return kept


def tried(study, run, running):
    """The sentence that measuring ended in, or None."""
    try:
        assert measured(study, run, running.port) == []
    except ls.LoopshapeError as error:
        said = str(error)
    else:
        return None
    assert "\n" not in said
    return said


def one_case(folder, expected, faults, line=None):
    """Measure over a bad line, then once more over a good one: `right`, `refused` or `half` (one recording kept)."""
    folder.mkdir()
    study, run = write_study(folder, TEXT), folder / "run"
    with Running(target, faults, *([line] if line else [])) as running:
        said = tried(study, run, running)
    kept = right(run, expected)
    assert (said is None) == (kept == set(NAMES)), said
    if said is not None:
        with Running(target) as running:
            assert tried(study, run, running) is None
        assert right(run, expected) == set(NAMES)
    return "right" if said is None else "half" if kept else "refused"


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_bad_line_gives_the_truth_or_nothing(tmp_path, expected, kind):
    """Each of ten faults in 14 cases: 1, 5 and 20 % of frames, up to three seeds, to the host and both ways."""
    found = Counter()
    cases = [(s, n, b) for s, seeds in ((0.01, 3), (0.05, 3), (0.2, 1)) for n in range(1, seeds + 1) for b in (0, 1)]
    for k, (share, seed, both) in enumerate(cases):
        faults = Faults(**{kind: share}, late_s=0.1, seed=seed, to_target=bool(both) and kind != "foreign")
        found[share, one_case(tmp_path / str(k), expected, faults)] += 1
    assert found[0.01, "right"] >= (6 if kind != "lie" else 3), found  # one frame in a hundred is mended
    print(kind, dict(found))


@pytest.mark.long
def test_all_at_once(tmp_path, expected):
    shares = dict.fromkeys(KINDS, 0.01) | {"lie": 0.0}
    found = Counter()
    for seed in range(20):
        line = Pty() if seed % 2 else None
        found[
            one_case(
                tmp_path / str(seed), expected, Faults(**shares, late_s=0.1, seed=seed, to_target=seed % 4 > 1), line
            )
        ] += 1
    assert found["right"] >= 15, found
    print(dict(found))


EVENTS = [("upload", 100), ("run", 1), ("run", 300), ("ended", 0), ("begun", 0)]


@pytest.mark.long
@pytest.mark.parametrize("event", ["pull", "restart", "silent"])
@pytest.mark.parametrize("recording", [1, 2])
@pytest.mark.parametrize(("when", "at"), EVENTS)
def test_what_was_finished_stays_and_the_same_command_goes_on(tmp_path, expected, event, when, at, recording):
    """A cable pulled, a target restarted or silent, at any place: 30 cases."""
    study, run = write_study(tmp_path, TEXT), tmp_path / "run"
    faults = Faults(event=event, when=when, at=at, recording=recording)
    with Running(target, faults) as running:
        said = tried(study, run, running)
        assert running.happened
        kept = right(run, expected)
        assert kept >= set(NAMES[: recording - 1])
        assert said is not None or kept == set(NAMES)
        running.silent = False
        assert tried(study, run, running) is None
    assert right(run, expected) == set(NAMES)


def test_answers_of_another_host_are_no_answers(tmp_path, expected):
    assert one_case(tmp_path / "a", expected, Faults(foreign=1.0, to_target=False)) == "right"


def test_answers_that_always_come_late_are_answers(tmp_path, expected):
    assert one_case(tmp_path / "a", expected, Faults(late=1.0, late_s=0.02, to_target=False)) == "right"


def test_samples_that_are_gone_are_no_recording(tmp_path):
    """A real machine does not wait: what is lost beyond its memory is lost, and said."""
    study = write_study(tmp_path, study_text(target=["place = false"]))
    make = lambda: target(fast=False, memory=40)  # noqa: E731
    with Running(make, Faults(drop=0.4, seed=1, to_target=False)) as running:
        said = tried(study, tmp_path / "run", running)
    assert "samples of 'one' are lost: the target no longer has them" in said
    assert finished(tmp_path / "run") == set()


@pytest.mark.long
def test_in_real_time_a_bad_line_gives_what_the_machine_did_or_nothing(tmp_path):
    """9 cases against the samples that the target itself made."""
    found = Counter()
    text = study_text(experiment(period_s=0.25), target=["place = false", "watchdog_ms = 200"])
    for seed, share in enumerate([0.02] * 3 + [0.1] * 3 + [0.3] * 3):
        run = tmp_path / str(seed)
        with Running(lambda: target(fast=False), Faults(drop=share / 2, corrupt=share / 2, seed=seed)) as running:
            said = tried(write_study(tmp_path, text), run, running)
            made = np.array([np.frombuffer(one) for one in running.target.made])
        found[share, said is None] += 1
        if said is None:
            names = ("r", "n", "z", "s", "u")
            np.testing.assert_array_equal(np.column_stack([table(run, "one")[f"{k}1"] for k in names]), made)
        else:
            assert not run.exists() or finished(run) == set(), said
    assert found[0.02, True] >= 2, found
    print(dict(found))


@pytest.mark.parametrize("words", [{"buffer": 0}, {"buffer": 20}, {"memory": 20}, {"memory": 30, "buffer": 50}])
def test_a_target_with_little_memory_is_slow_or_refused(tmp_path, expected, words, monkeypatch):
    monkeypatch.setattr(acquisition, "STILL_S", 0.5)
    run = tmp_path / "run"
    with Running(lambda: target(**words)) as running:
        said = tried(write_study(tmp_path, TEXT), run, running)
    assert right(run, expected) == (set(NAMES) if said is None else set())


def test_a_target_that_stands_still_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(acquisition, "STILL_S", 0.5)
    stuck = target()
    stuck.step = lambda now, ticks: (setattr(stuck, "now", now), 0)[1]
    begun = time.monotonic()
    with Running(lambda: stuck) as running:
        said = tried(write_study(tmp_path, TEXT), tmp_path / "run", running)
    assert "gets no further with 'one'" in said
    assert time.monotonic() - begun < 5.0


@pytest.mark.parametrize("ticks", [599, 601, 0, 2**32 - 1])
def test_an_end_that_the_recording_contradicts_is_refused(tmp_path, ticks):
    lying = target()
    honest = lying._ended
    lying._ended = lambda run, found, *more: honest(run, ticks, *more)
    with Running(lambda: lying) as running:
        said = tried(write_study(tmp_path, TEXT), tmp_path / "run", running)
    assert "ended with another length than it has" in said
    assert finished(tmp_path / "run") == set()
