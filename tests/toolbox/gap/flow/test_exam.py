"""`make exam` with a quick diagnosis in its place: seals first, one answer each, resumed, not tampered."""

import csv
import hashlib
import inspect
import json
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import exam as command
import exam_cases
import examiner
import numpy as np
import pytest
import typer
from exam import exam
from exam_cases import Case, case_list, catalogue, library_run
from examiner import EFFECTS, OUTSIDE

import loopshape as ls
from loopshape.toolbox.gap.nouns.gap_report import Ranked, Shrink, Where

PLAN = {"single": 4, "healthy": 2, "unknown": 1, "pairs": 2}


def report(name):
    where = Where("body", {"body": 1.0}, "theta2", (0.1, 1.0), [])
    ranking = [
        Ranked("payload", 0.8, 50.0, (40.0, 60.0), "g", "one"),
        Ranked("leak", 0.2, 0.2, (0.1, 0.3), "mm", "one"),
    ]
    gap = Shrink("rms", 9.0, 2.0, 0.875, (0.8, 0.9), ["rec09"])
    return ls.gap.GapReport(
        name, "arm-1dof", "payload", ranking, ["payload", "leak"], where, gap, [], [], None, None, [], ""
    )


@pytest.fixture
def sat(monkeypatch):
    """Names in the order in which they were diagnosed; at the n-th, `stop_at`, somebody interrupts."""
    found = SimpleNamespace(names=[], stop_at=None, folder=None, sealed_before=[])

    def diagnose(plant, run, name, *, threads, table):
        if found.stop_at == len(found.names):
            raise KeyboardInterrupt
        assert (threads, table) == (1, False)
        if found.folder is not None:
            found.sealed_before.append((found.folder / "sealed.json").exists())
            assert not (found.folder / "labels.json").exists()
        found.names.append(name)
        return report(name)

    run = SimpleNamespace(plant="arm-1dof")
    monkeypatch.setattr("loopshape.toolbox.gap.diagnose.diagnose.diagnose", diagnose)
    monkeypatch.setattr(examiner, "make_run", lambda labels, seed, variant: run)
    monkeypatch.setattr("loopshape.view.style.png", lambda figure: b"")  # test_draw_exam.py looks at pictures
    return found


def sit(out, seed=1, **plan):
    exam(out, **(PLAN | plan), seed=seed, jobs=1, keep_runs=False, library_forms=False)


def test_seals_stand_and_are_printed_before_any_diagnosis_and_fit_the_labels(sat, tmp_path, capsys):
    sat.folder = tmp_path
    sit(tmp_path)
    printed = capsys.readouterr().out
    assert sat.sealed_before == [True] * 9
    seals = {row["case"]: row["seal"] for row in json.loads((tmp_path / "sealed.json").read_text())["cases"]}
    for row in json.loads((tmp_path / "labels.json").read_text())["cases"]:
        labels = json.dumps(row["labels"], sort_keys=True, separators=(",", ":"))
        text = f"{row['kind']}/{row['variant']}/{row['run_seed']}/{row['nonce']}:{labels}"
        assert seals[row["name"]] == hashlib.sha256(text.encode()).hexdigest()
        assert f"{row['name']}  {seals[row['name']]}" in printed
    assert printed.index(seals["case-009"]) < printed.index("Against the bars")


def test_what_comes_out(sat, tmp_path):
    sit(tmp_path)
    given = json.loads((tmp_path / "answers" / "case-001.json").read_text())
    assert given["verdict"] == "payload"
    assert given["time_s"] >= 0.0
    assert not {"labels", "kind", "variant"} & set(given)
    with (tmp_path / "cases.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["case"] for row in rows] == sat.names
    assert Counter(row["kind"] for row in rows) == {"single": 4, "healthy": 2, "unknown": 1, "pair": 2}
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["false_alarms"]["right"] == 2
    assert {p.name for p in tmp_path.glob("*.png")} == {"confusion.png", "reliability.png", "shrink.png"}


def test_what_diagnoses_gets_the_run_and_a_number_only():
    assert list(inspect.signature(command.diagnosed).parameters) == ["run", "name"]
    names = [c.name for c in case_list({"single": 2, "healthy": 1}, 1, False)]
    assert names == ["case-001", "case-002", "case-003"]


def test_a_diagnosis_that_breaks_off_is_a_wrong_answer(sat, tmp_path, monkeypatch):
    def broken(*words, **more):
        raise FloatingPointError("no")

    monkeypatch.setattr("loopshape.toolbox.gap.diagnose.diagnose.diagnose", broken)
    sit(tmp_path)
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert (scores["failed"], scores["single"]["right"], scores["false_alarms"]["right"]) == (9, 0, 2)
    assert "FloatingPointError" in json.loads((tmp_path / "answers" / "case-001.json").read_text())["error"]


def test_the_same_seed_gives_the_same_cases_and_another_seed_others():
    plan = {"single": 60, "healthy": 20, "unknown": 12, "pair": 12}
    assert case_list(plan, 1, False) == case_list(plan, 1, False)
    assert {c.seal for c in case_list(plan, 1, False)}.isdisjoint(c.seal for c in case_list(plan, 2, False))


def test_singles_go_round_the_effects_and_their_forms():
    cases = case_list({"single": 60, "healthy": 20, "unknown": 12, "pair": 12}, 5, False)
    singles = [c for c in cases if c.kind == "single"]
    effects = Counter(next(iter(c.labels)) for c in singles)
    assert set(effects) == set(EFFECTS)
    assert set(effects.values()) == {2, 3}
    assert {(next(iter(c.labels)), c.variant) for c in singles} == {(e, v) for e in EFFECTS for v in (0, 1)}
    assert abs(Counter(c.variant for c in singles)[0] - 30) <= 3
    outside = Counter(next(iter(c.labels)) for c in cases if c.kind == "unknown")
    assert set(outside) == set(OUTSIDE)
    assert all(len(c.labels) == 2 for c in cases if c.kind == "pair")
    assert len({c.run_seed for c in cases}) == len(cases)
    assert "".join(c.kind[0] for c in cases) != "".join(sorted(c.kind[0] for c in cases))  # the order tells nothing


def test_an_interrupted_exam_goes_on_without_repeating(sat, tmp_path):
    sat.stop_at = 4
    with pytest.raises(typer.Exit):
        sit(tmp_path)
    assert not (tmp_path / "labels.json").exists()
    first = (tmp_path / "answers" / f"{sat.names[0]}.json").read_bytes()
    sat.stop_at = None
    sit(tmp_path)
    assert sorted(sat.names) == [f"case-{k:03d}" for k in range(1, 10)]  # each once
    assert (tmp_path / "answers" / f"{sat.names[0]}.json").read_bytes() == first
    sit(tmp_path)
    assert len(sat.names) == 9


@pytest.mark.parametrize(
    ("words", "what"), [({"seed": 2}, "seed 1, now 2"), ({"single": 5}, "plan"), ({"healthy": 3}, "plan")]
)
def test_another_exam_in_the_same_folder_is_refused(sat, tmp_path, words, what):
    sit(tmp_path)
    with pytest.raises(ls.errors.WrongUseError, match=what):
        sit(tmp_path, **words)


def test_a_folder_with_other_things_is_refused(sat, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ls.errors.WrongUseError, match=r"thesis\.txt"):
        sit(tmp_path)
    assert sat.names == []


@pytest.mark.parametrize("key", ["labels", "variant", "kind", "nonce"])
def test_changed_labels_are_refused(sat, tmp_path, key):
    sit(tmp_path)
    path = tmp_path / "labels.json"
    words = json.loads(path.read_text())
    old = words["cases"][3][key]
    words["cases"][3][key] = {"labels": {"payload": 50.0}, "variant": 7, "kind": "healthy!", "nonce": "0"}[key]
    assert old != words["cases"][3][key]
    path.write_text(json.dumps(words))
    with pytest.raises(ls.errors.WrongUseError, match=r"not those that were sealed.*case-004"):
        sit(tmp_path)


def test_changed_seals_and_missing_labels_are_refused(sat, tmp_path):
    sit(tmp_path)
    labels, sealed = tmp_path / "labels.json", tmp_path / "sealed.json"
    words = json.loads(labels.read_text())
    labels.write_text(json.dumps(words | {"cases": words["cases"][1:]}))
    with pytest.raises(ls.errors.WrongUseError, match="8 of 9 cases"):
        sit(tmp_path)
    labels.write_text('{"cases": [{"name": "case-001"}]}')
    with pytest.raises(ls.LoopshapeError, match="labels of an exam"):
        sit(tmp_path)
    sealed.write_text(sealed.read_text().replace('"seal": "', '"seal": "0', 1))
    with pytest.raises(ls.errors.WrongUseError, match="another cases"):
        sit(tmp_path)


def test_an_arm_that_leaves_its_range_is_drawn_again(monkeypatch):
    def make_run(labels, seed, variant):
        if seed < 12:
            raise ls.errors.WrongUseError("the arm left its range", "", "")
        return seed

    monkeypatch.setattr(examiner, "make_run", make_run)
    assert exam_cases.made(Case("case-001", "single", {"leak": 0.2}, 0, 10, "")) == 12
    with pytest.raises(ls.errors.WrongUseError):
        exam_cases.made(Case("case-001", "single", {"leak": 0.2}, 0, -100, ""))


def test_library_forms_come_from_the_catalogue():
    forms = catalogue()
    assert set(forms) == set(EFFECTS)
    cases = case_list({"single": 63, "healthy": 2}, 3, True)
    for case in cases:
        for name, magnitude in case.labels.items():
            low, high = forms[name][case.variant].usual
            assert 0.999 * low <= abs(magnitude) <= 1.001 * high
    assert len({(next(iter(c.labels)), c.variant) for c in cases if c.labels}) > 42


def test_the_hash_of_the_code_changes_with_what_diagnoses_and_with_nothing_else(monkeypatch, tmp_path):
    package = tmp_path / "loopshape"
    for folder in ("toolbox/gap", "view"):
        (package / folder).mkdir(parents=True)
        (package / folder / "one.py").write_text("x = 1")
    monkeypatch.setattr(command.loopshape, "__file__", str(package / "__init__.py"))
    first = command.code_sha256()
    (package / "view" / "one.py").write_text("x = 2")
    assert command.code_sha256() == first
    (package / "toolbox/gap" / "one.py").write_text("x = 2")
    assert command.code_sha256() != first


@pytest.mark.long
def test_an_arm_with_library_forms_has_a_session_s_recordings(monkeypatch):
    session = examiner.make_run({}, 4)
    session = replace(session, recordings=session.recordings[7:])  # loops open, sweep, staircase, profile
    monkeypatch.setattr(examiner, "make_run", lambda labels, seed: session)
    run = library_run({"payload": 60.0}, 0, 4)
    assert [r.info for r in run.recordings] == [r.info for r in session.recordings]
    for mine, theirs in zip(run.recordings, session.recordings, strict=True):
        assert set(mine.columns) == set(theirs.columns)
        for column in ("t_s", "r_theta2_rad", "n_theta2_rad", "r_p_ab_bar", "n_p_ab_bar"):
            assert np.array_equal(mine.column(column), theirs.column(column))
        angle, other = mine.column("theta2_rad"), theirs.column("theta2_rad")
        assert angle.size == other.size
        assert 0.0 < np.sqrt(np.mean((angle - other) ** 2)) < 0.1
