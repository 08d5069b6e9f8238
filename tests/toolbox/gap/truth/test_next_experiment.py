"""The proposed experiment: hypotheses that agree are not parted, limits hold, and what is proposed really parts."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from simulated_machines import Arm1, ExperimentTemplate, header, measure, plan
from simulated_machines import experiment as rig_experiment
from study_signals import Multisine, Staircase

import loopshape as ls
from loopshape.toolbox.gap.recordings import next_experiment as nxt
from loopshape.toolbox.gap.recordings.probing import habits

POINTS = ({"theta2_deg": 0.0, "p_ab_bar": 1.0}, {"theta2_deg": 20.0, "p_ab_bar": 1.4})
FRICTION = {"coulomb_nm": 0.1, "coulomb_rad_s": 0.03}
PAYLOAD = {"payload_kg": 0.06}


@pytest.fixture(scope="module")
def run():
    study = ls.rig.Study(
        "simulated",
        "arm-1dof",
        (
            ExperimentTemplate(
                "angle", "multisine", "controller_input", "theta2",
                Multisine(0.5, 6.0, 4.0, 0.3, 1, crest_iterations=5), lead_s=1.0,
            ),
            ExperimentTemplate(
                "steps", "staircase", "reference", references={"theta2": Staircase((1.0,), (0.2,))}, duration_s=3.0,
                operating_points=POINTS[:1],
            ),
            ExperimentTemplate(
                "pulse", "open_loop", "control", control={"theta2": Staircase((0.5, 0.7), (0.3, 0.0))}, duration_s=2.0,
                operating_points=POINTS[:1],
            ),
        ),
        POINTS,
    )  # fmt: skip
    return replace(header(study, Arm1()), recordings=tuple(measure(study, Arm1(), threads=1)))


def test_habits_are_those_of_the_study(run) -> None:
    usual = habits(run)
    amplitude, injection, (low, high) = usual.injected["theta2"]
    assert (amplitude, injection) == (pytest.approx(0.3), "controller_input")
    assert low == pytest.approx(0.5, abs=0.2)
    assert high == pytest.approx(6.0, abs=0.3)
    assert usual.moved == {"theta2": pytest.approx(0.1, abs=1e-3)}  # half of 0.2 rad, from the point
    assert usual.driven == {"theta2": (pytest.approx(0.3, abs=1e-3), pytest.approx(0.2, abs=2e-3))}
    assert "p_ab" not in usual.injected


def test_points_are_the_runs_own_and_corners_inside_the_range(run) -> None:
    found = nxt.points(Arm1(), run, (PAYLOAD, FRICTION))
    assert found[:2] == list(POINTS)
    assert {tuple(p.values()) for p in found[2:]} == {(0.0, 1.4), (20.0, 1.0)}
    far = [
        replace(r, info=replace(r.info, operating_point={"theta2_deg": 90.0, "p_ab_bar": 1.0})) for r in run.recordings
    ]
    assert nxt.points(Arm1(), replace(run, recordings=tuple(far)), (PAYLOAD, FRICTION)) == []


def test_candidates_are_signals_of_every_kind_the_run_has(run) -> None:
    kinds = {c.template.kind for c in nxt.candidates(Arm1(), run, (PAYLOAD, FRICTION))}
    assert kinds == {"multisine", "staircase", "open_loop"}
    closed = replace(run, recordings=tuple(r for r in run.recordings if r.info.closed_loop))
    assert "open_loop" not in {c.template.kind for c in nxt.candidates(Arm1(), closed, (PAYLOAD, FRICTION))}


def test_models_that_agree_are_not_parted_and_models_that_differ_are(run) -> None:
    same = nxt.propose(Arm1(), run, ("one", PAYLOAD), ("two", PAYLOAD), threads=1)
    assert same.separation == pytest.approx(1.0)
    assert "by 1 noise floors only" in same.sentence
    small, large = (
        nxt.propose(Arm1(), run, ("payload", {"payload_kg": kg}), ("none", {}), threads=1) for kg in (0.01, 0.06)
    )
    assert 2.0 < small.separation < large.separation
    assert large.sentence.endswith(f"parts payload from none by {large.separation:.2g} noise floors")


def test_a_study_always_gives_a_frf_to_estimate(run, monkeypatch) -> None:
    def pulses_win(plant, experiments, *_):
        return [9.0 if e.kind == "open_loop" else 3.0 if e.kind == "multisine" else 1.0 for e in experiments]

    monkeypatch.setattr(nxt, "separations", pulses_win)
    found = nxt.propose(Arm1(), run, ("payload", PAYLOAD), ("none", {}))
    assert (found.name, found.separation) == ("next-pulses-theta2", 9.0)
    assert [t.kind for t in found.study.experiments] == ["open_loop", "multisine"]
    assert "the study also holds a multisine of theta2" in found.sentence
    assert [p.name for p in plan(found.study, Arm1())] == ["next-pulses-theta2", "next-multisine-theta2"]


def test_the_study_holds_the_signals_that_were_simulated(run) -> None:
    plant = Arm1()
    for candidate in nxt.candidates(plant, run, (PAYLOAD, FRICTION))[:12]:
        mine = nxt.experiment(run, candidate)
        controllers = {loop.name: loop.controller.blocks for loop in run.loops}
        study = ls.rig.Study(
            "simulated", plant.name, (candidate.template,), (candidate.point,), controllers=controllers
        )
        theirs = rig_experiment(study, plant, plan(study, plant)[0])
        assert theirs.injection == mine.injection
        n = mine.samples - round(nxt.RAMP_S * run.rate_hz)  # then one period ramps out where the study goes on
        assert np.allclose(theirs.references[:n], mine.references[:n])
        assert np.allclose(theirs.injected[:n], mine.injected[:n])


def test_what_leaves_the_range_or_saturates_is_dropped(run) -> None:
    wild = replace(run, recordings=tuple(_louder(r, 12.0) for r in run.recordings if r.info.excites == "theta2"))
    tried = nxt.candidates(Arm1(), wild, ({}, PAYLOAD))
    experiments = [nxt.experiment(wild, c) for c in tried if c.template.kind == "multisine"]
    assert set(nxt.separations(Arm1(), experiments, ({}, PAYLOAD), nxt.MOST_CLIPPED, 1)) == {0.0}


def _louder(recording, factor):
    columns = dict(recording.columns)
    columns["n_theta2_rad"] = factor * columns["n_theta2_rad"]
    return replace(recording, columns=columns)


def test_a_rig_that_cannot_be_driven_on_the_model_gets_no_proposal(run) -> None:
    loose = replace(run, loops=tuple(replace(loop, controller=None) for loop in run.loops))
    assert nxt.propose(Arm1(), loose, ("payload", PAYLOAD), ("none", {})) is None
    assert nxt.propose(Arm1(), run, ("none", {}), ("none", {})) is None
    hole = np.array(run.recordings[0].column("n_theta2_rad"))
    hole[3] = np.nan
    torn = replace(run.recordings[0], columns=dict(run.recordings[0].columns) | {"n_theta2_rad": hole})
    assert nxt.propose(Arm1(), replace(run, recordings=(torn,)), ("payload", PAYLOAD), ("none", {})) is None


def test_a_loop_that_is_excited_at_once_with_another_has_habits_too():
    rng = np.random.default_rng(0)
    loops = tuple(LoopSetup(x, None, f"n_{x}_v", f"z_{x}_v", f"{x}_rad", None) for x in ("a", "b"))
    columns = {f"{signal}_{x}_v": rng.standard_normal(2000) for signal in ("n", "z") for x in ("a", "b")}
    info = RecordingInfo("r01.parquet", "noise", "plant_input", excites="a", excites_also=("b",))
    found = habits(ls.Run(100.0, loops, (ls.Recording(info, 100.0, columns),))).injected
    assert {loop: (size, place) for loop, (size, place, _) in found.items()} == {
        x: (np.abs(columns[f"n_{x}_v"]).max(), "plant_input") for x in ("a", "b")
    }
