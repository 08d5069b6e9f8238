"""The rms of an error under a new controller, predicted from the FRF and what disturbed the loop under the old one."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from commands import invoked
from run_files import write_frfs
from scipy.signal import lfilter
from scipy.stats import binom

import loopshape as ls
from loopshape.data.result.verdict_words import row_of
from loopshape.data.signal.disturbance import powers

RATE, N = 200.0, 8192
NUM, DEN = np.array([0.0, 0.02]), np.poly([0.98, 0.93 * np.exp(0.5j), 0.93 * np.exp(-0.5j)]).real  # resonance, 16 Hz
NUM = NUM * 0.05
OLD, NEW = 0.5, 2.5  # gains
F_HZ = np.geomspace(0.1, 95.0, 150)
COLOUR = [1.0, -0.9]  # of the disturbance at the output


def z(f_hz):
    return np.exp(2j * np.pi * np.asarray(f_hz) / RATE)


def rational(f_hz, num, den):
    return np.polyval(np.pad(num, (0, len(den) - len(num))), z(f_hz)) / np.polyval(den, z(f_hz))


def gain(value):
    return ls.controller(ls.gain(value), rate_hz=RATE, loop="axis")


def error(rng, value, samples=N):
    """What is left of an AR(1) disturbance of the output under a gain."""
    d = lfilter([1.0], COLOUR, rng.standard_normal(samples + 2000))
    padded = np.pad(value * NUM, (0, DEN.size - NUM.size))
    return -lfilter(DEN, DEN + padded, d)[2000:]


def true_rms(value):
    f = np.linspace(0.0, 0.5 * RATE, 200_001)[1:]
    S = 1.0 / (1.0 + value * rational(f, NUM, DEN))
    return float(np.sqrt(np.mean(np.abs(S * rational(f, [1.0], COLOUR)) ** 2)))


def measured(rng=None, relative=0.03):
    P, std = rational(F_HZ, NUM, DEN), relative
    if rng is not None:
        P = P * (1.0 + std * (rng.standard_normal(F_HZ.size) + 1j * rng.standard_normal(F_HZ.size)) / np.sqrt(2.0))
    return ls.FRF.from_arrays(F_HZ, P, relative_std=std, rate_hz=RATE, loop="axis")


def recorded(rng, value=OLD, name="still"):
    info = RecordingInfo(f"{name}.parquet", "none", "controller_input")
    loop = LoopSetup("axis", None, None, "z_v", "y_m", gain(value))
    y = -error(rng, value)
    return ls.Run(RATE, (loop,), (ls.Recording(info, RATE, {"z_v": -value * y, "y_m": y}),))


R = ls.Requirements("axis", error_rms=3.0, unstable_poles=0, integrators=0)


def found(verdict):
    (margins,) = verdict.margins.values()
    return margins.error_rms, margins.intervals["error_rms"]


@pytest.mark.long
def test_intervals_cover_the_true_rms():
    """100 draws of FRF and recording: 95 % intervals cover as often as binomial chance of 1e-4 allows."""
    rng, truth, covered = np.random.default_rng(1), true_rms(NEW), 0
    for _ in range(100):
        _, (low, high) = found(ls.check(measured(rng, 0.1), gain(NEW), R, disturbance=recorded(rng)))
        covered += low <= truth <= high
    assert binom.ppf(1e-4, 100, 0.95) <= covered <= binom.ppf(1.0 - 1e-4, 100, 0.95)


def test_a_given_spectrum_without_noise_gives_the_integral():
    f = np.linspace(0.0, 100.0, 4001)
    density = np.abs(rational(f, [1.0], COLOUR)) ** 2 * 2.0 / RATE
    spectrum = ls.Disturbance.from_spectrum(f, density)
    assert spectrum.rms == pytest.approx(true_rms(0.0), rel=1e-3)
    rms, (low, high) = found(ls.check(measured(relative=1e-6), gain(NEW), R, disturbance=spectrum))
    assert rms == pytest.approx(true_rms(NEW), rel=0.005)
    assert low <= rms <= high


def test_the_recorded_controller_gives_back_the_recorded_rms():
    run = recorded(np.random.default_rng(2))
    rms, _ = found(ls.check(measured(), gain(OLD), R, disturbance=run))
    y = run.recordings[0].column("y_m")
    assert rms == pytest.approx(np.sqrt(powers(y, RATE)[1][:-1].sum()), rel=1e-9)  # below half the rate
    assert rms == pytest.approx(np.std(y), rel=0.05)


def test_a_recording_under_the_new_controller_shows_what_was_predicted():
    rng = np.random.default_rng(3)
    rms, (low, high) = found(ls.check(measured(rng), gain(NEW), R, disturbance=recorded(rng)))
    (after,) = ls.planning.tones(recorded(rng, NEW), channels=["y_m"])
    assert low < after.rms_interval[1]
    assert after.rms_interval[0] < high
    assert rms == pytest.approx(after.rms, rel=0.1)


def test_the_verdict_has_a_row_and_is_passed_failed_or_undecided():
    rng, truth = np.random.default_rng(4), true_rms(NEW)
    run, P = recorded(rng), measured(rng)
    for limit, outcome in ((2.0 * truth, "passed"), (0.5 * truth, "failed")):
        required = ls.Requirements("axis", error_rms=limit, unstable_poles=0, integrators=0)
        verdict = ls.check(P, gain(NEW), required, disturbance=run)
        (line,) = verdict.lines
        assert (line.quantity, line.outcome, verdict.outcome) == ("error_rms", outcome, outcome)
    verdict = ls.check(P, gain(NEW), R)
    assert verdict.outcome == "undecided"
    assert "--disturbance" in " ".join(verdict.warnings)


def test_the_command_predicts_from_another_run(tmp_path):
    rng = np.random.default_rng(5)
    for name in ("plant", "still"):
        ls.write(recorded(rng), tmp_path / name)
    write_frfs(tmp_path / "plant", [replace(measured(rng), recording="still")])
    ls.write(gain(NEW), tmp_path / "c.toml")
    (tmp_path / "r.toml").write_text(
        'format = "loopshape-requirements/1"\n[[loop]]\nname = "axis"\nerror_rms = 3.5\nunstable_poles = 0\n'
        "integrators = 0\n"
    )
    words = ["check", "plant", "c.toml", "--require", "r.toml", "--disturbance", "still", "--no-figures"]
    words = [str(tmp_path / w) if w in ("plant", "still", "c.toml", "r.toml") else w for w in words]
    done = invoked([*words, "--json"])
    (line,) = json.loads(done.stdout)["loops"][0]["lines"]
    assert line["value"] == pytest.approx(true_rms(NEW), rel=0.1)
    assert line["interval"][0] < line["value"] < line["interval"][1]
    assert "error_rms" in invoked(words).stdout
    plant, page, still = (str(tmp_path / name) for name in ("plant", "shape.html", "still"))
    asked = ["shape", plant, "--controller", str(tmp_path / "c.toml"), "--out", page]
    for words, known in ((asked, False), ([*asked, "--disturbance", still], True)):
        invoked(words)
        assert ('"disturbed":{' in Path(page).read_text("utf-8").replace(" ", "")) is known
    assert "take one loop alone" in str(invoked([*asked, "--matrix", "--disturbance", still]).exception)


def test_the_command_tunes_to_it_from_another_run(tmp_path):
    rng = np.random.default_rng(5)
    ls.write(recorded(rng), tmp_path / "still")
    (tmp_path / "plant").mkdir()
    write_frfs(tmp_path / "plant", [replace(measured(rng), recording="still")])
    (tmp_path / "r.toml").write_text(
        'format = "loopshape-requirements/1"\n[[loop]]\nname = "axis"\nerror_rms = 3.0\nunstable_poles = 0\n'
        'integrators = 0\nmodulus_margin = 0.4\nstructure = [{ kind = "gain", gain = { min = 0.1, max = 30.0 } }]\n'
    )
    words = ["tune", "plant", "--require", "r.toml", "--out", "c.toml", "--starts", "2"]
    words = [str(tmp_path / w) if w in ("plant", "c.toml", "r.toml") else w for w in words]
    refused = invoked(words)
    assert "--disturbance" in str(refused.exception)
    done = invoked([*words, "--json", "--disturbance", str(tmp_path / "still")])
    (line,) = (x for x in json.loads(done.stdout)["loops"][0]["verdict"]["lines"] if x["quantity"] == "error_rms")
    (C,) = ls.read_controllers(tmp_path / "c.toml")
    found = C.blocks[0].parameters["gain"]
    assert line["interval"][0] <= true_rms(found) <= line["interval"][1] <= 3.0


def test_small_units_are_shown_as_they_are():
    f = np.linspace(0.0, 100.0, 4001)
    verdict = ls.check(
        measured(), gain(NEW), ls.Requirements("axis", error_rms=1e-7, unstable_poles=0, integrators=0),
        disturbance=ls.Disturbance.from_spectrum(f, np.full(f.size, 1e-18)),
    )  # fmt: skip
    (line,) = verdict.lines
    assert 1e-9 < float(row_of(line).worst) < 1e-7
    assert row_of(line).asked == "at most 1e-07"


#: a disturbance about the peak of |S|, which a larger gain raises
PEAKED = ls.Disturbance.from_spectrum(np.linspace(10.0, 25.0, 301), np.full(301, 0.1))


def rms_under(value):
    f = np.linspace(10.0, 25.0, 6001)
    S = 1.0 / (1.0 + value * rational(f, NUM, DEN))
    return float(np.sqrt(np.trapezoid(0.1 * np.abs(S) ** 2, f)))


def test_a_tuning_comes_up_to_the_limit_of_the_error_and_keeps_it():
    P = measured(relative=1e-4)
    wide = ls.Requirements("axis", modulus_margin=0.3, unstable_poles=0, integrators=0)
    free = ls.tune(P, wide, [ls.gain((0.1, 30.0))], starts=2)
    best = free.controller.blocks[0].parameters["gain"]
    limit = 0.5 * (rms_under(0.6 * best) + rms_under(0.7 * best))
    assert rms_under(0.6 * best) < limit < rms_under(0.7 * best)
    asked = replace(wide, error_rms=limit)
    made = ls.tune(P, asked, [ls.gain((0.1, 30.0))], starts=2, disturbance=PEAKED)
    gain_found = made.controller.blocks[0].parameters["gain"]
    assert made.verdict.passed
    assert rms_under(gain_found) == pytest.approx(limit, rel=5e-3)
    assert any(b.quantity == "error_rms" for b in made.binding)
    (line,) = (x for x in made.verdict.lines if x.quantity == "error_rms")
    assert line.value <= limit


def test_the_examples_of_the_page_run():
    page = (Path(__file__).parents[3] / "docs" / "disturbances.md").read_text()
    left = {"np": np, "ls": ls}
    exec("\n".join(re.findall(r"```python\n(.*?)```", page, flags=re.S)[-3:]), left)
    assert left["C"].feasible


def test_what_does_not_show_a_disturbance_is_refused():
    rng = np.random.default_rng(6)
    run = recorded(rng)
    one = run.recordings[0]
    excited = RecordingInfo("a.parquet", "noise", "controller_input", excites="axis")
    with pytest.raises(ls.errors.BadSignalError, match="excites loop axis"):
        ls.check(
            measured(), gain(NEW), R, disturbance=ls.Run(RATE, run.loops, (ls.Recording(excited, RATE, one.columns),))
        )
    with pytest.raises(ls.errors.WrongUseError, match="needs what disturbs the loop"):
        ls.tune(measured(), ls.Requirements("axis", error_rms=1.0, phase_margin_deg=40.0, unstable_poles=0),
                [ls.gain()])  # fmt: skip
    with pytest.raises(ls.errors.WrongUseError, match="two rising frequencies"):
        ls.Disturbance.from_spectrum([2.0, 1.0], [1.0, 1.0])
