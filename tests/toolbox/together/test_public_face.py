"""`import loopshape as ls`: from arrays to a verdict in ten lines or a complex response in five; refusals."""

import copy
import doctest
import inspect
import json
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest
from commands import loopshape

import loopshape as ls
from loopshape.core.toolboxes import found

ROOT = Path(__file__).parents[3]
RATE_HZ = 1000.0
W = 2.0 * np.pi * 8.0
PLANT = control.c2d(control.tf([W**2], [1.0, 0.8 * W, W**2]), 1.0 / RATE_HZ)
F_HZ = np.geomspace(0.2, 400.0, 300)

STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
rate_hz = 1000.0
seed = 1
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }]
[[loop]]
name = "theta2"
controller = [{ kind = "gain", gain = 0.5 }]
[[experiment]]
name = "noise"
excites = "theta2"
[experiment.excitation]
kind = "multisine"
f_low_hz = 1.0
f_high_hz = 20.0
period_s = 2.0
periods = 5
amplitude_deg = 4.0
seed = 1
"""
TARGET_STUDY = STUDY.replace("simulated", "target").replace(
    "[[loop]]",
    """[target]
watchdog_ms = 250
soft_start_s = 0.5
settle_s = 0.5
[target.commands]
u_a_v = { theta2 = 1.0, p_ab = 1.0 }
u_b_v = { theta2 = -1.0, p_ab = 1.0 }
[limits]
theta2 = { low_deg = -40.0, high_deg = 40.0, rate_deg_s = 900.0 }
p_a = { low_bar = 0.15, high_bar = 1.15, rate_bar_s = 30.0 }
p_b = { low_bar = 0.15, high_bar = 1.15, rate_bar_s = 30.0 }
u_a = { low_v = -4.0, high_v = 4.0 }
u_b = { low_v = -4.0, high_v = 4.0 }
[[loop]]""",
)

CONTROLLER = """
format = "loopshape-controllers/1"
rate_hz = 2500.0
[[loop]]
name = "motor"
controller = [{ kind = "gain", gain = 40.0 }, { kind = "lead_lag", f1_hz = 1.6, f2_hz = 56.0 }]
"""


def exact(system: control.TransferFunction, f_hz: np.ndarray) -> np.ndarray:
    return np.asarray(system(np.exp(2j * np.pi * f_hz / RATE_HZ)))


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    """Two minutes of a loop closed by a gain of 0.5 under noise at the controller's input."""
    rng = np.random.default_rng(3)
    n = rng.standard_normal(120_000)
    t = np.arange(n.size) / RATE_HZ
    u = control.forced_response(control.feedback(control.tf([0.5], [1.0], 1.0 / RATE_HZ), PLANT), t, n).outputs
    y = control.forced_response(PLANT, t, u).outputs
    return {"u": u, "y": y + 1e-4 * rng.standard_normal(n.size), "excitation": n}


def test_import_loads_nothing_heavy() -> None:
    words = "import sys, loopshape; print([m for m in ('numpy', 'scipy', 'matplotlib', 'numba') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_help_loads_nothing_heavy() -> None:
    """`--help` is words of commands, those of toolboxes among them: numpy alone would be a third of its time."""
    words = """
import sys
from loopshape.cli import script
sys.argv = ["loopshape", "--help"]
try:
    script()
except SystemExit:
    print([m for m in ("numpy", "scipy", "matplotlib", "numba", "pandas") if m in sys.modules], file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True, timeout=60)
    assert "campaign" in done.stdout
    assert done.stderr.strip() == "[]"


def test_each_command_of_the_tour_loads_what_it_needs(tmp_path: Path) -> None:
    """Each of these packages takes a tenth of a second to load, or several."""
    bench = ROOT / "examples" / "motor_bench"
    controller, require = tmp_path / "controller.toml", str(bench / "requirements.toml")
    controller.write_text(CONTROLLER)
    never = ["scipy.stats", "scipy.signal", "scipy.interpolate", "pandas", "matplotlib", "control"]
    compiler = ["numba.np.arrayobj", "numba.np.arraymath"]
    for command, also in (
        (["import", str(bench / "multisine_type_a.parquet"), "--map", str(bench / "map.toml")], ["numba", "scipy"]),
        (["frf", "bench", "--no-figures"], [*compiler, "scipy.optimize"]),
        (["fit", "bench", "--structure", "rational", "--numerator", "2", "--denominator", "4"], ["numba"]),
        (["check", "bench", str(controller), "--require", require, "--no-figures"], [*compiler, "scipy.optimize"]),
    ):
        words = command + (["--out", "bench"] if command[0] == "import" else [])
        code = f"""
import sys
from loopshape.cli import script
sys.argv = ["loopshape", *{words!r}]
try:
    script()
except SystemExit:
    print([m for m in {[*never, *also]!r} if m in sys.modules])
"""
        run = [sys.executable, "-c", code]
        if command[0] in ("frf", "check"):  # what compiles its kernels loads the compiler
            subprocess.run(run, capture_output=True, timeout=240, cwd=tmp_path)
        done = subprocess.run(run, capture_output=True, text=True, check=True, timeout=120, cwd=tmp_path)
        assert done.stdout.splitlines()[-1] == "[]", (command[0], done.stdout, done.stderr)


BOXES = [name for name in found().toolboxes if hasattr(ls, name)]
EVERY = [name for name in dir(ls) if name != "__version__"]
EVERY += [f"{box}.{name}" for box in ("errors", *BOXES) for name in dir(getattr(ls, box))]


@pytest.mark.parametrize("name", EVERY)
def test_every_public_name_loads_and_says_what_it_is(name: str) -> None:
    assert (attrgetter(name)(ls).__doc__ or "").strip()


def test_the_bench_has_at_most_sixty_names() -> None:
    assert len(dir(ls)) - 1 <= 60


def test_a_name_of_a_toolbox_says_where_it_is() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'measure'; there is loopshape\.rig\.measure"):
        _ = ls.measure
    with pytest.raises(AttributeError, match=r"loopshape\.rig has no 'mesure': it has Study, adopt, advise, connect"):
        _ = ls.rig.mesure


def test_a_toolbox_s_names_are_copied_pickled_and_called_as_they_should() -> None:
    assert copy.copy(ls.gap) is ls.gap
    assert pickle.loads(pickle.dumps(ls.rig)) is ls.rig
    assert [name for name in BOXES if callable(getattr(ls, name))] == ["campaign", "gap", "learning"]
    assert list(inspect.signature(ls.gap).parameters)[:2] == ["run", "model"]


@pytest.mark.long
@pytest.mark.timeout(900)  # s; compiles what no other test has before
def test_examples_of_the_public_names_run() -> None:
    every = [attrgetter(name)(ls) for name in EVERY]
    modules = sorted({one.__module__ for one in every if getattr(one, "__module__", "loopshape") != "loopshape"})
    results = [doctest.testmod(sys.modules[name], raise_on_error=False) for name in modules]
    assert sum(r.attempted for r in results) >= 20
    assert sum(r.failed for r in results) == 0


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="no attribute 'tuen'"):
        _ = ls.tuen


@pytest.mark.long
def test_from_arrays_to_a_verdict(arrays: dict[str, np.ndarray]) -> None:
    """The FRF is the plant's within its own error, and the tuned loop's margins are those of the known plant."""
    P = ls.frf(ls.Run.from_arrays(**arrays, rate_hz=RATE_HZ))
    R = ls.Requirements(phase_margin_deg=45.0, sensitivity_peak_db=6.0, unstable_poles=0, integrators=0)
    C = ls.tune(P, R, [ls.gain(), ls.lead_lag(), ls.pi()], starts=4)
    v = ls.check(P, C, R)
    assert v.outcome is ls.Outcome.PASSED
    valid = P.between(1.0, 100.0)
    error = np.abs(valid.siso - exact(PLANT, valid.frequency_hz)) / np.sqrt(valid.variance[:, 0, 0])
    assert 0.6 < np.sqrt(np.mean(error**2)) < 1.4
    f = np.geomspace(0.05, 0.49 * RATE_HZ, 40_000)
    L = C.controller.response(f) * exact(PLANT, f)
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
    true_deg = np.abs(np.rad2deg(np.angle(-L[crossings]))).min()
    low, high = v.margins["recording"].intervals["phase_margin_deg"]
    assert low - 0.2 < true_deg < high + 0.2
    assert v.table()["outcome"].tolist() == ["passed", "passed"]
    assert json.loads(json.dumps(v.to_dict()))["outcome"] == "passed"


def test_from_a_complex_response_in_five_lines() -> None:
    P = ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), relative_std=0.01, rate_hz=RATE_HZ)
    R = ls.Requirements(phase_margin_deg=45.0, unstable_poles=0, integrators=0)
    C = ls.controller(ls.gain(0.5), ls.pi(1.0), rate_hz=RATE_HZ)
    v = ls.check(P, C, R)
    assert v.outcome is ls.Outcome.PASSED
    assert repr(v) == "Verdict: passed"
    rows = [line.split() for line in str(v).splitlines()]
    assert rows[0][:2] == ["verdict:", "pass:"]
    (margin,) = [row for row in rows if row[:1] == ["phase_margin_deg"]]
    (found,) = v.margins.values()
    low, high = found.intervals["phase_margin_deg"]
    assert [float(margin[k]) for k in (1, 3, 5)] == pytest.approx([45.0, low, high], rel=1e-3)
    assert max(map(len, str(v).splitlines())) <= 80
    assert "<table" in v._repr_html_()


def test_nothing_told_of_unstable_poles_is_undecided() -> None:
    P = ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), relative_std=0.01, rate_hz=RATE_HZ)
    v = ls.check(P, ls.controller(ls.gain(0.5), rate_hz=RATE_HZ))
    assert v.outcome is ls.Outcome.UNDECIDED


def test_python_control_goes_in_and_comes_out() -> None:
    model = control.ss(control.tf([1.0, 3.0], [1.0, 0.4, 9.0]))
    P = ls.FRF.from_control(model, F_HZ)
    assert np.allclose(P.siso, model(2j * np.pi * F_HZ), rtol=1e-12)
    assert not P.covariance.any()
    back = ls.to_control(P)
    assert np.allclose(back(2j * np.pi * F_HZ[3:9]), P.siso[3:9], rtol=1e-9)
    again = ls.from_control(back, std=0.1 * np.abs(P.siso))
    assert np.allclose(np.sqrt(again.variance[:, 0, 0]), 0.1 * np.abs(P.siso))


def test_a_coherence_tells_the_error() -> None:
    """E|d|² = |H|² (1 - g2)/(g2 (K - 1)), Bendat and Piersol, table 9.6 with one degree of freedom taken."""
    H, g2 = exact(PLANT, F_HZ), np.full(F_HZ.size, 0.9)
    P = ls.FRF.from_arrays(F_HZ, H, coherence=g2, averages=26)
    assert np.allclose(P.variance[:, 0, 0], np.abs(H) ** 2 * 0.1 / (0.9 * 25.0))


def test_the_verb_and_the_command_say_the_same(tmp_path: Path) -> None:
    """`ls.check` on the arm's exact response, and `loopshape check` on the same FRF in a run folder."""
    from run_files import write_frfs

    P = ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), relative_std=0.02, rate_hz=RATE_HZ, loop="x", recording="r1")
    C = ls.controller(ls.gain(0.5), ls.pi(1.0), rate_hz=RATE_HZ, loop="x")
    run = tmp_path / "run"
    run.mkdir()
    write_frfs(run, [P])
    ls.write(C, tmp_path / "controller.toml")
    (tmp_path / "requirements.toml").write_text(
        'format = "loopshape-requirements/1"\n[[loop]]\nname = "x"\nphase_margin_deg = 45.0\nunstable_poles = 0\n'
    )
    words = ["check", run, tmp_path / "controller.toml", "--require", tmp_path / "requirements.toml"]
    done = loopshape(*words, "--json", "--no-figures")
    assert done.returncode == 0, done.stderr
    R = ls.Requirements("x", phase_margin_deg=45.0, unstable_poles=0)
    assert json.loads(done.stdout)["loops"][0] == json.loads(json.dumps(ls.check(P, C, R).to_dict()))


def test_pictures_take_nouns_and_an_axes() -> None:
    P = ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), relative_std=0.01, rate_hz=RATE_HZ)
    C = ls.controller(ls.gain(0.5), ls.pi(1.0), rate_hz=RATE_HZ)
    _, ax = plt.subplots()
    assert ls.plot.nichols(P, C, ls.Requirements(sensitivity_peak_db=6.0, unstable_poles=0), ax=ax) is ax
    assert len(ls.plot.bode(P, C).axes) >= 4
    assert len(ls.plot.sensitivities(P, C).axes) == 4
    assert len(ls.plot.frf(P).axes) >= 2
    loop = ls.Loop(P, C)
    assert len(ls.plot(loop).axes) == len(ls.plot.bode(P, C).axes)
    left, _ = ls.plot.bode(loop.sensitivity).axes  # neither spectra nor coherence: no empty panel
    np.testing.assert_allclose(left.lines[0].get_ydata(), 20.0 * np.log10(np.abs(1.0 / (1.0 + loop.L))), atol=1e-9)
    left, _ = ls.plot(C).axes
    f = left.lines[0].get_xdata()
    np.testing.assert_allclose(left.lines[0].get_ydata(), 20.0 * np.log10(np.abs(C.response(f))), atol=1e-9)
    plt.close("all")


@pytest.mark.long
def test_predicted_and_bounded_from_the_same_nouns() -> None:
    """The prediction's |S| is that of the known loop; the controller does not exceed the bound."""
    P = ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), relative_std=0.01, rate_hz=RATE_HZ)
    C = ls.controller(ls.gain(0.5), ls.pi(1.0), rate_hz=RATE_HZ)
    R = ls.Requirements(phase_margin_deg=45.0, sensitivity_peak_db=6.0, unstable_poles=0, integrators=0)
    S = ls.predict(P, C)[0].sensitivity
    truth = 1.0 / (1.0 + C.response(S.frequency_hz) * exact(PLANT, S.frequency_hz))
    assert np.allclose(S.siso, truth, rtol=0.05)
    found = ls.limits.bound(P, C, R)
    assert found.bandwidths_hz[P.recording or "frf 1"] < found.together.bound_hz


def test_the_gap_needs_a_run_that_names_its_plant() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="names no plant"):
        ls.gap(ls.Run.from_arrays(u=np.arange(9.0), y=np.arange(9.0), rate_hz=1.0))


def test_arrays_may_be_held_out_and_take_columns_of_a_machine() -> None:
    (recording,) = ls.Run.from_arrays(u=np.arange(9.0), y=np.ones(9), rate_hz=1.0, role="validation").recordings
    assert recording.info.role == "validation"
    own = replace(recording, columns={"torque_nm": np.arange(9.0), "lever_rad": np.ones(9)})
    assert ls.Run(1.0, (), [own]).recordings[0].column("lever_rad").size == 9
    with pytest.raises(ls.errors.WrongUseError, match="estimation"):
        ls.Run.from_arrays(u=np.arange(9.0), y=np.ones(9), rate_hz=1.0, role="held out")


def test_reprs_are_one_line(arrays: dict[str, np.ndarray]) -> None:
    P = ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), relative_std=0.01, rate_hz=RATE_HZ)
    run = ls.Run.from_arrays(**arrays, rate_hz=RATE_HZ)
    things = [P, run, ls.controller(ls.gain(2.0), rate_hz=10.0), ls.Requirements(phase_margin_deg=45.0)]
    things.append(ls.fit(P, "rational", numerator=1, denominator=2))
    assert all("\n" not in repr(x) and len(repr(x)) < 200 for x in things)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "the error of this FRF"),
        ({"std": 0.1, "relative_std": 0.1}, "stated once"),
        ({"coherence": np.full(F_HZ.size, 0.9)}, "give coherence and averages"),
        ({"coherence": np.full(F_HZ.size, 1.9), "averages": 10}, "between 0 and 1"),
        ({"std": np.ones(3)}, "std is the standard deviation"),
    ],
)
def test_an_error_that_is_not_stated_is_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(ls.errors.WrongUseError, match=words):
        ls.FRF.from_arrays(F_HZ, exact(PLANT, F_HZ), **given)


def test_arrays_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="for each frequency"):
        ls.FRF.from_arrays(F_HZ, np.ones(3) + 0j, relative_std=0.1)
    with pytest.raises(ls.errors.BadSignalError, match="not numbers"):
        ls.FRF.from_arrays(F_HZ, np.full(F_HZ.size, np.nan + 0j), relative_std=0.1)
    with pytest.raises(ls.errors.WrongUseError, match="of one length"):
        ls.Run.from_arrays(u=np.ones(3), y=np.ones(4), rate_hz=1.0)
    with pytest.raises(ls.errors.WrongUseError, match="needs numbers"):
        ls.controller(ls.gain(), rate_hz=1000.0)
    with pytest.raises(ls.errors.WrongUseError, match="0 < low < high"):
        ls.notch((5.0, 2.0))
    with pytest.raises(ls.errors.WrongUseError, match=r"P of ls\.check must be an FRF, a sequence of FRF or a Diagram"):
        ls.check([3.0], ls.controller(ls.gain(1.0), rate_hz=1000.0))
    with pytest.raises(ls.errors.WrongUseError, match="only frequency response data and systems"):
        ls.from_control(3.0)
    with pytest.raises(ls.errors.WrongUseError, match="give frequency_hz"):
        ls.from_control(control.tf([1.0], [1.0, 1.0]))


def test_files_go_out_and_come_back(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    """A run, an FRF and a controller, written and read: the same numbers; other things are refused."""
    run = ls.Run.from_arrays(**{name: x[:20_000] for name, x in arrays.items()}, rate_hz=RATE_HZ)
    back = ls.read(ls.write(run, tmp_path / "run")).recordings[0].column("y_1")
    np.testing.assert_array_equal(back, arrays["y"][:20_000])
    P = ls.FRF.from_control(PLANT, F_HZ, rate_hz=RATE_HZ, relative_std=0.01)
    for ending in ("csv", "mat", "uff"):
        stated = {"relative_std": 0.01, "rate_hz": RATE_HZ} if ending == "uff" else {}
        found = ls.formats.read_frf(ls.write(P, tmp_path / f"P.{ending}"), **stated)
        np.testing.assert_allclose(found.siso, P.siso, rtol=1e-6)
    C = ls.controller(ls.gain(0.5), ls.pi(1.0), rate_hz=RATE_HZ, loop="x")
    with pytest.raises(ls.LoopshapeError, match="the name of its loop"):
        ls.write(replace(C, loop=""), tmp_path / "c.toml")
    (read,) = ls.read_controllers(ls.write(C, tmp_path / "c.toml"))
    np.testing.assert_array_equal(read.response(F_HZ), C.response(F_HZ))
    (header,) = ls.formats.export(C, tmp_path / "c", "c")
    assert header.suffix == ".h"
    with pytest.raises(ls.LoopshapeError, match=r"what of ls\.write must be a Run, a Controller"):
        ls.write(3, tmp_path / "x")  # type: ignore[arg-type]
    assert ls.report(tmp_path / "run", date="today").stat().st_size > 10_000


def test_a_study_is_measured_and_told_from_python(tmp_path: Path) -> None:
    """A simulated arm, a few periods; that its FRF is its linearisation is tested elsewhere."""
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    run = ls.rig.measure(study, tmp_path / "run")
    again = ls.rig.measure(study, tmp_path / "run")
    assert [r.info.name for r in again.recordings] == [r.info.name for r in run.recordings] == ["noise"]
    assert np.isfinite(ls.frf(run).siso).all()


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_a_target_moves_only_when_armed(tmp_path: Path) -> None:
    """The emulated arm: refused without arm, shown what is about to happen, recorded with it, stopped."""
    study, seen = tmp_path / "study.toml", []
    study.write_text(TARGET_STUDY)
    with ls.rig.emulator() as port:
        with pytest.raises(ls.LoopshapeError, match="no motion"):
            ls.rig.measure(study, tmp_path / "run", port=port, confirm=lambda motion: bool(seen.append(motion)))
        assert seen[0].identity.emulated
        assert not (tmp_path / "run").exists()
        with ls.rig.connect(port) as rig:
            assert (rig.identity.board, rig.state()) == (seen[0].identity.board, "idle")
            (shown,) = rig.show(study).experiments()
            assert shown.name == "noise"
            assert not (tmp_path / "run").exists()
            run = rig.measure(study, tmp_path / "run", arm=True)
            assert len(run.recordings) == 1
            assert rig.stop(clear=True).startswith("vented")
            assert rig.state() == "idle"
        assert ls.rig.stop(port).startswith("vented")


def test_an_error_that_is_stated_is_the_error_that_the_frf_has():
    f_hz = np.geomspace(1.0, 100.0, 20)
    P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.02)
    np.testing.assert_allclose(P.relative_std, 0.02, rtol=1e-12)
    np.testing.assert_allclose(P.modulus_std, 0.02 / np.sqrt(2.0), rtol=1e-12)  # half the power lies along |P|
