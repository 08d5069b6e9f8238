"""Files of each kind, kept as a version wrote them, read as they did then (`tests/helpers/kept/NAME-VERSION`)."""

from pathlib import Path

from run_files import read_required
from simulated_machines import read_study

import loopshape as ls

KEPT = Path(__file__).parents[3] / "helpers/kept"


def test_requirements_1():
    (one,), together = read_required(KEPT / "requirements-1.toml")
    assert (one.loop, one.phase_margin_deg, one.band_hz, one.integrators) == ("axis", 40.0, (1.0, 200.0), 1)
    assert one.objective == ls.Objective(0.0, 1.0, 2.0)
    assert one.masks == (ls.Mask("S", ((0.1, -40.0), (10.0, 0.0))),)
    assert one.at[0] == ls.AtPoints({"load_kg": (2.0, 5.0), "x_m": (0.3, 0.3)}, {"phase_margin_deg": 30.0})
    assert one.weights[0].response == "T"
    assert [block.kind for block in one.structure] == ["gain", "notch"]
    assert (one.structure[0].parameters["gain"].start, dict(one.structure[1].tie)) == (1.0, {"f2_hz": "f1_hz"})
    assert (together.disk_margin, together.band_hz, together.integrators) == (0.5, (1.0, 100.0), 2)


def test_controllers_1():
    (axis,), (lift,) = (
        ls.read_controllers(KEPT / "controllers-1.toml"),
        ls.schedules.read_gain_scheduled(KEPT / "schedules-1.toml"),
    )
    assert (axis.loop, axis.rate_hz, axis.prewarp_hz, axis.precision) == ("axis", 1000.0, 20.0, "q5.27")
    assert [block.kind for block in axis.blocks] == ["gain", "low_pass_2"]
    assert [one.blocks[0].parameters["gain"] for one in lift.controllers] == [1.0, 2.0]
    assert (lift.loop, lift.lag_s, lift.variables[0].follows) == ("lift", 0.2, "output")


def test_profiles_1():
    (one,) = ls.profiles(KEPT / "profiles-1.toml").values()
    assert dict(one.limits) == {"sensitivity_peak_db": 9.5, "phase_margin_deg": 30.0}
    assert [(zone.name, zone.up_to_db) for zone in one.zones] == [("A", 9.5), ("B", float("inf"))]


def test_run_1():
    run = ls.read(KEPT / "run-1")
    (loop,), (recording,) = run.loops, run.recordings
    assert (run.plant, run.outputs, run.pwm["frequency_hz"], run.extra["notes"]) == (
        "servo-axis",
        ("x_m",),
        50.0,
        ["a note"],
    )
    assert (loop.reference, loop.controller.blocks[0].parameters["gain"], loop.decoupling["axis"]) == ("r_m", 0.5, 1.0)
    info = recording.info
    assert (info.role, info.excites, info.period_s, info.operating_point["x_m"]) == ("validation", "axis", 0.02, 0.0)
    assert (info.parameters["mass_kg"], info.ended_early) == (3.0, "stopped")
    assert list(recording.signal("x_m")) == [1.0, 2.0, 3.0, 4.0]


def test_study_1():
    study = read_study(KEPT / "study-1.toml")
    sweep, steps = study.experiments
    assert (study.rate_hz, study.seed, study.controllers["x"][0].parameters["gain"]) == (500.0, 3, 2.0)
    assert (sweep.excitation.amplitude, sweep.lead_s, sweep.parameters["mass_kg"]) == (0.005, 1.0, 2.0)
    assert (steps.role, steps.references["x"].values) == ("validation", (0.0, 0.005))
