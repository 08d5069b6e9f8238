"""A command and its verb over one run: `--json` is what the verb's answer has, warnings included."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import loopshape
from run_files import read_frfs
from scipy.signal import lfilter

import loopshape as ls
from loopshape.core.json_ready import json_ready
from loopshape.core.toolboxes import Installed, Toolbox
from loopshape.verbs import estimates

RATE_HZ = 500.0
REQUIREMENTS = """
format = "loopshape-requirements/1"
[[loop]]
name = "loop"
modulus_margin = 0.4
unstable_poles = 0
integrators = 0
structure = [
  { kind = "gain", gain = { min = 0.1, max = 20.0 } },
  { kind = "lead_lag", f1_hz = { min = 1.0, max = 50.0 }, f2_hz = { min = 5.0, max = 200.0 } },
]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of a loop y = P u with a tone that grows in its output, requirements and a controller."""
    folder = tmp_path_factory.mktemp("axis")
    n = np.random.default_rng(1).standard_normal(20_000)
    t = np.arange(n.size) / RATE_HZ
    y = lfilter([0.05], [1.0, -0.95], n) + 2e-3 * np.exp(0.15 * t) * np.sin(2.0 * np.pi * 61.3 * t)
    ls.write(ls.Run.from_arrays(u=n, y=y, rate_hz=RATE_HZ), folder / "run")
    (folder / "require.toml").write_text(REQUIREMENTS)
    ls.write(ls.controller(ls.gain(2.0), rate_hz=RATE_HZ, loop="loop"), folder / "controller.toml")
    return folder


def said(*words):
    done = loopshape(*words, "--json")
    assert done.returncode in (0, 1), done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def estimated(folder):
    """What `frf` says, and what `ls.estimate` gives with its warnings."""
    words = said("frf", folder / "run", "--no-figures")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = ls.estimate(folder / "run")
    return words, found, [str(one.message) for one in caught]


def same(one, other):
    """Whether two answers in JSON agree to what is written of numbers."""
    assert type(one) is type(other) or {type(one), type(other)} == {int, float}
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key, value in one.items():
            same(value, other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            same(a, b)
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-12)
    else:
        assert one == other


def plain(answer):
    return json.loads(json.dumps(json_ready({"it": answer}, unknown=None)))["it"]


def test_frf_warns_as_its_verbs_do(folder, estimated):
    pytest.importorskip("loopshape.toolbox.planning", reason="tones that grow are found by a toolbox")
    words, found, caught = estimated
    assert any("grow" in one for one in found.warnings)
    assert caught == list(found.warnings)
    assert words["warnings"] == [*found.warnings, *found.notes]
    assert [words["distortion"], words["levels"]] == [found.of("distortion"), found.of("levels")]
    with pytest.warns(UserWarning, match="grow"):
        P = ls.frf(folder / "run")
    assert P.digest == found.frfs[0].digest == read_frfs(folder / "run")[0].digest


@pytest.mark.long
def test_check_says_what_its_verb_gives(folder, estimated):
    words = said("check", folder / "run", folder / "controller.toml", "--require", folder / "require.toml")
    (R,), (C,) = ls.read_requirements(folder / "require.toml"), ls.read_controllers(folder / "controller.toml")
    same(words["loops"][0], plain(ls.check(estimated[1].frfs, C, R).to_dict()))


def test_fit_says_what_its_verb_gives(folder, estimated):
    words = said("fit", folder / "run", "--structure", "rational", "--require", folder / "require.toml")
    (R,) = ls.read_requirements(folder / "require.toml")
    found = ls.fit(estimated[1].frfs[0], "rational", R=R, numerator=0, denominator=1)
    same(words["fits"][0], plain(found))
    (folder / "run" / "fits.json").unlink()


def test_tune_gives_what_its_verb_gives(folder, estimated):
    out = folder / "tuned.toml"
    words = said("tune", folder / "run", "--require", folder / "require.toml", "--out", out, "--starts", 3)
    (R,) = ls.read_requirements(folder / "require.toml")
    tuned = ls.tune(estimated[1].frfs, R, starts=3)
    same(words["loops"][0], plain(tuned))
    assert ls.read_controllers(out)[0].digest == tuned.controller.digest


def clipped(name, role="estimation", excites="loop"):
    """Arrays of a loop whose output is cut off, as one recording."""
    u = np.random.default_rng(2).standard_normal(6000)
    y = np.clip(lfilter([0.05], [1.0, -0.95], u), -0.1, 0.1)
    (one,) = ls.Run.from_arrays(u=u, y=y, rate_hz=RATE_HZ).recordings
    return replace(one, info=replace(one.info, file=f"{name}.parquet", role=role, excites=excites))


def test_faults_of_recordings_that_give_no_frf_are_told():
    u = np.random.default_rng(1).standard_normal(6000)
    run = ls.Run.from_arrays(u=u, y=lfilter([0.05], [1.0, -0.95], u), rate_hz=RATE_HZ)
    both = replace(run, recordings=(*run.recordings, clipped("held-out", role="validation")))
    with pytest.warns(UserWarning, match="held-out.*saturated") as caught:
        found = ls.estimate(both)
    assert [one.recording for one in found.frfs] == ["recording"]
    assert {Path(one.filename).name for one in caught} == {Path(__file__).name}


def test_a_broken_look_harms_nothing(monkeypatch):
    box = Toolbox("mine", "looks", looks={"odd": "no_such_module:look"})
    monkeypatch.setattr(estimates, "found", lambda: Installed({"mine": box}, ()))
    u = np.random.default_rng(1).standard_normal(6000)
    with pytest.warns(UserWarning, match="the look odd of a toolbox failed: ModuleNotFoundError"):
        assert ls.frf(ls.Run.from_arrays(u=u, y=0.5 * u, rate_hz=RATE_HZ)).frequency_hz.size


def test_a_loop_that_nothing_excites_alone_is_refused():
    u = np.random.default_rng(1).standard_normal(6000)
    run = ls.Run.from_arrays(u=u, y=0.5 * u, rate_hz=RATE_HZ)
    (one,) = run.recordings
    two = replace(one, info=replace(one.info, excites="other"))
    other = replace(run, loops=(*run.loops, replace(run.loops[0], name="other")), recordings=(two,))
    with pytest.raises(ls.errors.WrongUseError, match="no recording excites this loop alone"):
        ls.estimate(other, "loop")
