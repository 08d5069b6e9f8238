"""Every noun that is written comes back the same, and studies arrive in stored units."""

import csv
import json
from dataclasses import fields, replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from bench_nouns import Block, Estimate, Free, RequirementResult, TransferFunction
from conversions import rad
from run_files import (
    read_fits,
    read_frfs,
    read_json,
    read_toml,
    write_controllers,
    write_fits,
    write_frfs,
    write_json,
    write_toml,
)
from study_signals import BandNoise, Multisine, Prbs, Profile, Staircase, Sweep
from verdict_cases import write_junit

import loopshape as ls
from loopshape import __version__
from loopshape.io.write.frfs import frf_csv
from loopshape.toolbox.rig.files.study import read_study


def assert_same(one, other):
    """Equal field by field, arrays value by value with NaN equal to NaN."""
    assert type(one) is type(other)
    for field in fields(one):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, theirs)
        elif isinstance(mine, TransferFunction):
            assert_same(mine, theirs)
        else:
            np.testing.assert_equal(theirs, mine)


def test_controllers(tmp_path):
    one = ls.Controller("theta2", (Block("gain", {"gain": -0.1}), Block("low_pass_1", {"f_hz": 1 / 3})), 1000.0)
    two = ls.Controller("p_ab", (Block("pi", {"f_hz": 0.2}),), 1000.0)
    write_controllers(tmp_path / "c.toml", (one, two), {"tuned on": "r01", "margins": {"theta2": 6.0}})
    back = ls.read_controllers(tmp_path / "c.toml")
    for mine, theirs in zip((one, two), back, strict=True):
        assert_same(mine, theirs)
    assert read_toml(tmp_path / "c.toml")["notes"] == {
        "loopshape": __version__,
        "tuned on": "r01",
        "margins": {"theta2": 6.0},
    }


def test_requirements(tmp_path):
    (tmp_path / "q.toml").write_text("""
format = "loopshape-requirements/1"
[[loop]]
name = "theta2"
phase_margin_deg = 45
band_hz = [0.5, 30.0]
integrators = 1
structure = [
  { kind = "gain", gain = { min = 1.0, max = 100.0, start = 10.0 } },
  { kind = "notch", f1_hz = 6.0, f2_hz = "f1_hz", damping1 = 0.05, damping2 = { min = 1, max = 5 } },
]
[[loop]]
name = "p_ab"
gain_margin_db = 6.0
""")
    first, second = ls.read_requirements(tmp_path / "q.toml")
    assert (first.loop, first.phase_margin_deg, first.band_hz) == ("theta2", 45, (0.5, 30.0))
    assert first.structure[0].parameters["gain"] == Free(1.0, 100.0, 10.0)
    assert first.structure[1].tie == {"f2_hz": "f1_hz"}
    assert (second.loop, second.gain_margin_db) == ("p_ab", 6.0)


def frf(recording="r01", loop="theta2", ny=1, nu=1, nf=5):
    rng = np.random.default_rng(3)
    root = rng.standard_normal((nf, ny * nu, ny * nu))
    response = rng.standard_normal((nf, ny, nu)) + 1j * rng.standard_normal((nf, ny, nu))
    return ls.FRF(
        np.arange(1.0, nf + 1.0),
        response,
        (root @ root.transpose(0, 2, 1)).astype(complex),
        np.arange(nf) % 2 == 0,
        tuple(f"u{k}" for k in range(nu)),
        tuple(f"y{k}" for k in range(ny)),
        "local polynomial, °C",
        recording,
        loop,
        1000.0,
        {"theta2_deg": 10.0},
        coherence=np.linspace(0.5, 1.0, nf),
        notes=("first", "second"),
    )


def test_frfs(tmp_path):
    made = (frf(), replace(frf("r02"), coherence=None, cross_power=np.full(5, 1j)), frf("r03", "", ny=2, nu=3))
    paths = write_frfs(tmp_path, made)
    assert [p.name for p in paths] == ["r01.theta2.npz", "r02.theta2.npz", "r03.all.npz"]
    for mine, theirs in zip(made, read_frfs(tmp_path), strict=True):
        assert_same(mine, theirs)
    write_frfs(tmp_path, (replace(frf(), method="again"),))
    assert [x.method for x in read_frfs(tmp_path)] == ["again", made[1].method, made[2].method]


def test_a_frf_as_a_table(tmp_path):
    made = frf()
    frf_csv(tmp_path / "frf.csv", made)
    with (tmp_path / "frf.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["frequency_hz", "re", "im", "std", "coherence", "valid"]
    assert [float(row["re"]) for row in rows] == made.siso.real.tolist()
    assert [float(row["std"]) ** 2 for row in rows] == pytest.approx(made.covariance[:, 0, 0].real.tolist())
    assert [row["valid"] for row in rows] == ["1", "0", "1", "0", "1"]
    frf_csv(tmp_path / "mimo.csv", replace(frf(ny=2, nu=2), coherence=None))
    head, first = (tmp_path / "mimo.csv").read_text().splitlines()[:2]
    assert head.startswith("frequency_hz,re_y0_u0,im_y0_u0,std_y0_u0,re_y0_u1")
    assert first.endswith(",,1")


def test_fits(tmp_path):
    model = TransferFunction(np.array([1.0 / 3.0]), np.array([1.0, 2.0, 0.0]), 0.003)
    made = ls.Fit(
        "third_order",
        model,
        (Estimate("gain", 0.1, "rad/V", 0.01), Estimate("f_hz", 6.0, "Hz", float("inf"))),
        np.array([[1e-4, np.nan], [np.nan, np.inf]]),
        "at_bound",
        float("nan"),
        0.3,
        0.02,
        1.5,
        (0.5, 30.0),
        12,
        "r01",
        "theta2",
        {"theta2_deg": 0.0},
        True,
    )
    bare = replace(made, parameters=(), covariance=np.empty((0, 0)), recording="r02")
    write_fits(tmp_path, (made, bare))
    for mine, theirs in zip((made, bare), read_fits(tmp_path), strict=True):
        assert_same(mine, theirs)
    json.loads((tmp_path / "fits.json").read_text(), parse_constant=pytest.fail)


def margins(stable):
    return ls.Margins.of({"gain_margin_db": 1.0}, stable, stability_reason="one encirclement < & \x07")


def test_junit(tmp_path):
    lines = (
        RequirementResult("phase_margin_deg", "deg", 45.0, 50.0, 5.0, "passed", "r01", 3.0),
        RequirementResult("sensitivity_peak_db", "dB", 6.0, 8.4, -2.4, "failed", "r02", None),
    )
    made = ls.Verdict("theta2", lines, {"r01": margins("stable"), "r02": margins("undecided")}, ("be careful",))
    write_junit(tmp_path / "j.xml", (made, replace(made, loop="p_ab")))
    root = ET.parse(tmp_path / "j.xml").getroot()
    suite = root[0]
    assert suite.attrib == {"name": "theta2", "tests": "4", "failures": "2", "errors": "0"}
    failed = {
        case.get("name"): case.find("failure").get("message")
        for case in suite.iter("testcase")
        if case.find("failure") is not None
    }
    assert set(failed) == {"sensitivity_peak_db", "stability in r02"}
    assert failed["sensitivity_peak_db"] == "required at most 6 dB, found 8.4 dB in r02 (slack -2.4 dB)"
    assert failed["stability in r02"].startswith("undecided: one encirclement < &")


def test_toml_and_json_keep_what_they_are_given(tmp_path):
    data = {"a b": {"x": [1.5, 2], "y": {"z": 'q"\n\x7f'}}, "list": [{"k": 1}, {"k": [{"m": True}]}], "n": 1e300}
    write_toml(tmp_path / "x.toml", data | {"none": None, "array": np.arange(3), "number": np.float64(0.1)})
    assert read_toml(tmp_path / "x.toml") == data | {"array": [0, 1, 2], "number": 0.1}
    write_json(tmp_path / "x.json", {"a": np.array([1.0, np.inf]), "b": (None, float("nan")), "c": Free(1.0, 2.0)})
    assert read_json(tmp_path / "x.json") == {
        "a": [1.0, "inf"],
        "b": [None, "nan"],
        "c": {"low": 1.0, "high": 2.0, "start": None},
    }


STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
rate_hz = 500.0
seed = 7
solver = "smooth"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }, { theta2_deg = 20.0, p_ab_bar = 1.2 }]

[parameters]
payload_kg = 0.5

[pwm]
frequency_hz = 50.0
dead_zone = 0.01

[[loop]]
name = "theta2"
controller = [{ kind = "gain", gain = 2.0 }]

[[experiment]]
name = "sweep"
excites = "theta2"
lead_s = 1.0
[experiment.excitation]
kind = "sweep"
f_low_hz = 0.5
f_high_hz = 30
duration_s = 60
amplitude_deg = 5.0
spacing = "logarithmic"

[[experiment]]
name = "multi"
excites = "p_ab"
injection = "plant_input"
role = "validation"
operating_points = [{ theta2_deg = 5.0 }]
[experiment.excitation]
kind = "multisine"
f_low_hz = 0.5
f_high_hz = 30.0
period_s = 10.0
amplitude_mv = 200.0
periods = 3
odd = true
seed = 11

[[experiment]]
name = "lines"
excites = "p_ab"
[experiment.excitation]
kind = "multisine"
f_low_hz = 1
f_high_hz = 9
period_s = 1.0
amplitude_mbar = 50
lines_hz = [1, 3, 7]

[[experiment]]
name = "bits"
excites = "p_ab"
excitation = { kind = "prbs", order = 9, clock_s = 0.01, amplitude_bar = 0.1 }

[[experiment]]
name = "hiss"
excites = "p_ab"
excitation = { kind = "noise", f_low_hz = 0.5, f_high_hz = 30.0, duration_s = 20.0, amplitude_bar = 0.1 }

[[experiment]]
name = "track"
duration_s = 20.0
[experiment.references.theta2]
kind = "profile"
times_s = [1.0, 9.0]
values_deg = [90, 0]
velocity_deg_s = 180
acceleration_deg_s2 = 360
jerk_deg_s3 = 720
[experiment.references.p_ab]
kind = "staircase"
times_s = [0.0]
values_mbar = [1200.0]

[[experiment]]
name = "steps"
duration_s = 10.0
control = { theta2 = { kind = "staircase", times_s = [0.0, 5.0], values_v = [0.1, -0.1] } }

[[experiment]]
name = "quiet"
duration_s = 5.0
"""


def test_study(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study = read_study(tmp_path / "study.toml")
    assert (study.rig, study.plant, study.rate_hz, study.seed, study.solver) == (
        "simulated",
        "arm-1dof",
        500.0,
        7,
        "smooth",
    )
    assert study.operating_points == ({"theta2_deg": 0.0, "p_ab_bar": 1.0}, {"theta2_deg": 20.0, "p_ab_bar": 1.2})
    assert (study.changes, study.pwm) == ({"payload_kg": 0.5}, {"frequency_hz": 50.0, "dead_zone": 0.01})
    assert study.controllers == {"theta2": (Block("gain", {"gain": 2.0}),)}
    by_name = {e.name: e for e in study.experiments}
    found = {name: (e.kind, e.injection, e.role) for name, e in by_name.items()}
    assert found == {
        "sweep": ("sweep", "controller_input", "estimation"),
        "multi": ("multisine", "plant_input", "validation"),
        "lines": ("multisine", "controller_input", "estimation"),
        "bits": ("prbs", "controller_input", "estimation"),
        "hiss": ("noise", "controller_input", "estimation"),
        "track": ("profile", "reference", "estimation"),
        "steps": ("open_loop", "control", "estimation"),
        "quiet": ("none", "reference", "estimation"),
    }
    assert by_name["sweep"].lead_s == 1.0
    assert by_name["multi"].operating_points == ({"theta2_deg": 5.0},)
    assert by_name["sweep"].operating_points is None


SEVERAL = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-2dof"
seed = 7
operating_points = [{ theta1_deg = 0.0 }]

[[experiment]]
name = "both"
injection = "plant_input"
role = "validation"
realisations = 2
lead_s = 1.0
[experiment.excitations]
theta1 = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, amplitude_mv = 100.0 }
theta2 = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, amplitude_v = 0.2, seed = 11 }

[[experiment]]
name = "three"
[experiment.excitations]
theta1 = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, amplitude_deg = 1.0 }
theta2 = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, amplitude_deg = 1.0 }
p_a = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, amplitude_mbar = 10.0 }

[[experiment]]
name = "hiss"
[experiment.excitations]
theta1 = { kind = "noise", f_low_hz = 1.0, f_high_hz = 9.0, duration_s = 20.0, amplitude_v = 0.1 }
p_a = { kind = "noise", f_low_hz = 2.0, f_high_hz = 9.0, duration_s = 20.0, amplitude_v = 0.1 }

[[experiment]]
name = "again"
realisations = 3
excites = "theta1"
[experiment.excitation]
kind = "multisine"
f_low_hz = 1.0
f_high_hz = 9.0
period_s = 2.0
amplitude_v = 0.1
turn = 0.25
turns = 4
"""


def test_an_experiment_of_several_loops_comes_as_the_recordings_it_stands_for(tmp_path):
    (tmp_path / "study.toml").write_text(SEVERAL)
    study = read_study(tmp_path / "study.toml")
    assert [e.name for e in study.experiments] == [
        *("both-r1-s1", "both-r1-s2", "both-r2-s1", "both-r2-s2"),
        *("three-s1", "three-s2", "three-s3"),
        "hiss",
        *("again-r1", "again-r2", "again-r3"),
    ]
    by_name = {e.name: e for e in study.experiments}
    both = by_name["both-r1-s2"]
    assert (both.kind, both.injection, both.role, both.lead_s) == ("multisine", "plant_input", "validation", 1.0)
    assert (both.excites, list(both.excites_also)) == ("theta1", ["theta2"])
    assert both.excitation.amplitude == pytest.approx(0.1)
    assert both.excites_also["theta2"] == Multisine(1.0, 9.0, 2.0, 0.2, seed=11, turn=0.5)
    assert by_name["both-r1-s1"].excites_also["theta2"] == Multisine(1.0, 9.0, 2.0, 0.2, seed=11)
    assert [m.turn for m in by_name["three-s2"].excited.values()] == [0.0, 1 / 3, 2 / 3]
    hiss = by_name["hiss"]
    assert (hiss.kind, hiss.excites, list(hiss.excites_also)) == ("noise", "theta1", ["p_a"])
    assert by_name["again-r2"].excitation.turn == 0.25
    units = study.extra["units"]
    assert units["both-r2-s1"]["excitation"] == "v"
    assert (units["three-s3"]["excitation"], units["three-s3"]["excites_also"]) == (
        "rad",
        {"theta2": "rad", "p_a": "bar"},
    )
    assert (units["again-r1"]["excitation"], units["again-r1"]["excites_also"]) == ("v", {})


def test_seeds_of_several_loops_are_their_own_and_the_same_when_read_again(tmp_path):
    (tmp_path / "study.toml").write_text(SEVERAL)
    first, again = (read_study(tmp_path / "study.toml").experiments for _ in range(2))
    assert [e.excited for e in first] == [e.excited for e in again]
    by_name = {e.name: {loop: s.seed for loop, s in e.excited.items()} for e in first}
    assert len({*by_name["both-r1-s1"].values(), *by_name["both-r2-s1"].values()}) == 4
    assert by_name["both-r1-s1"] == by_name["both-r1-s2"]
    assert len(set(by_name["three-s1"].values())) == 3
    assert len(set(by_name["hiss"].values())) == 2
    assert 7 in by_name["again-r1"].values()  # the study's
    (tmp_path / "study.toml").write_text(SEVERAL.replace("seed = 7", "seed = 8"))
    other = {e.name: e.excited["theta1"].seed for e in read_study(tmp_path / "study.toml").experiments}
    assert all(other[name] != seeds["theta1"] for name, seeds in by_name.items())


def test_signals_of_a_study_come_in_stored_units(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study = read_study(tmp_path / "study.toml")
    by_name = {e.name: e for e in study.experiments}
    assert by_name["sweep"].excitation == Sweep(0.5, 30.0, 60.0, float(rad(5.0)), spacing="logarithmic")
    assert by_name["multi"].excitation == Multisine(0.5, 30.0, 10.0, 0.2, 3, 11, True)
    assert by_name["lines"].excitation == Multisine(1.0, 9.0, 1.0, 0.05, seed=7, lines_hz=(1.0, 3.0, 7.0))
    assert by_name["bits"].excitation == Prbs(9, 0.01, 0.1, seed=7)
    assert by_name["hiss"].excitation == BandNoise(0.5, 30.0, 20.0, 0.1, seed=7)
    profile = by_name["track"].references["theta2"]
    assert isinstance(profile, Profile)
    assert profile.values == pytest.approx((rad(90.0), 0.0))
    assert (profile.velocity, profile.acceleration, profile.jerk) == pytest.approx(tuple(rad([180.0, 360.0, 720.0])))
    assert by_name["track"].references["p_ab"] == Staircase((0.0,), (1.2,))
    assert by_name["steps"].control["theta2"] == Staircase((0.0, 5.0), (0.1, -0.1))
    units = study.extra["units"]
    assert units["sweep"]["excitation"] == "rad"
    assert units["multi"]["excitation"] == "v"
    assert units["track"]["references"] == {"theta2": "rad", "p_ab": "bar"}
