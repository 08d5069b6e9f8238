"""Names that leave their folder, files that are damaged, words that do not fit: the sentence a user gets."""

import json
import os

import numpy as np
import pytest
from bench_nouns import Block
from run_files import (
    read_fits,
    read_frfs,
    read_json,
    read_toml,
    write_controllers,
    write_fits,
    write_frfs,
    write_json,
    write_text_whole,
    write_toml,
)

import loopshape as ls
from loopshape.io.files import plain_name, write_whole
from loopshape.toolbox.rig.files.study import read_study


def refused(read, path, text, *words, error=ls.errors.WrongUseError):
    path.write_text(text)
    with pytest.raises(error) as caught:
        read(path)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../a", "/a", "a/b", "a\\b", "C:a", ".hidden", " a", "a\0b", "a\nb", "a" * 300, 3, None]
)
def test_a_plain_name(name):
    with pytest.raises(ls.errors.UnreadableInputError, match="the table must be a plain name inside its folder"):
        plain_name(name, "the table")
    assert plain_name("O-ring 257_7bar+x.csv", "the table") == "O-ring 257_7bar+x.csv"


def test_a_failed_write_keeps_the_old_file(tmp_path):
    write_text_whole(tmp_path / "a.txt", "old")

    def fails(part):
        part.write_text("half")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_whole(tmp_path / "a.txt", fails)
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_a_place_that_cannot_be_written(tmp_path):
    with pytest.raises(ls.errors.UnreadableInputError, match=r"none/a\.txt cannot be written; received No such file"):
        write_text_whole(tmp_path / "none" / "a.txt", "x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ls.errors.UnreadableInputError, match="folder cannot be written"):
        write_text_whole(tmp_path / "folder", "x")
    assert os.listdir(tmp_path) == ["folder"]


def test_toml_and_json_that_cannot_be_read(tmp_path):
    path = tmp_path / "x"
    for read, kind in ((read_toml, "TOML"), (read_json, "JSON")):
        refused(read, path, "{ a = ", "x cannot be read as", kind, error=ls.errors.UnreadableInputError)
        refused(read, path, "[" * 100_000, kind, error=ls.errors.UnreadableInputError)
        with pytest.raises(ls.errors.UnreadableInputError, match="does not exist"):
            read(tmp_path / "none")
        with pytest.raises(ls.errors.UnreadableInputError, match="a folder stands in the place of"):
            read(tmp_path)


def test_values_without_a_form():
    with pytest.raises(ls.errors.WrongUseError, match="no form in JSON; received 1j"):
        write_json("unused", {"a": 1j})
    with pytest.raises(ls.errors.WrongUseError, match="no form in TOML; received 1j"):
        write_toml("unused", {"a": 1j})


CONTROLLERS = """
format = "loopshape-controllers/1"
rate_hz = 100.0
[[loop]]
name = "x"
controller = [{ kind = "gain", gain = 1.0 }]
"""


def test_controllers(tmp_path):
    def no(text, *words, error=ls.errors.WrongUseError):
        refused(ls.read_controllers, tmp_path / "c.toml", text, *words, error=error)

    no(CONTROLLERS.replace("controllers/1", "run/1"), "loopshape-controllers/1", error=ls.errors.UnreadableInputError)
    no(CONTROLLERS.replace("rate_hz", "rate"), "unknown key", "'rate'")
    no(CONTROLLERS.split("[[loop]]", maxsplit=1)[0], "no loop")
    no(CONTROLLERS + 'output = "x_m"\n', "c.toml, loop 'x'", "unknown key", "'output'")
    no(CONTROLLERS + CONTROLLERS.split("100.0\n")[1], "two controllers have one name", "'x'")
    no(CONTROLLERS.replace("gain = 1.0", "gian = 1.0"), "parameters gain", "gian")
    one = ls.Controller("x", (Block("gain", {"gain": 1.0}),), 100.0)
    two = ls.Controller("y", (Block("gain", {"gain": 1.0}),), 200.0)
    with pytest.raises(ls.errors.WrongUseError, match="one rate; received 100 Hz, 200 Hz"):
        write_controllers(tmp_path / "c.toml", (one, two))
    with pytest.raises(ls.errors.WrongUseError, match="no controller"):
        write_controllers(tmp_path / "c.toml", ())
    with pytest.raises(ls.errors.WrongUseError, match="one name"):
        write_controllers(tmp_path / "c.toml", (one, one))


REQUIREMENTS = 'format = "loopshape-requirements/1"\n[[loop]]\nname = "x"\n'


def test_requirements(tmp_path):
    def no(text, *words, error=ls.errors.WrongUseError):
        refused(ls.read_requirements, tmp_path / "q.toml", text, *words, error=error)

    no(REQUIREMENTS.replace("/1", "/2"), "loopshape-requirements/1", error=ls.errors.UnreadableInputError)
    no(REQUIREMENTS + "phase_margin = 45\n", "q.toml, loop 'x'", "unknown key", "phase_margin_deg")
    no(REQUIREMENTS + 'phase_margin_deg = "45"\n', "must be a finite number", "'45'")
    no(REQUIREMENTS + "phase_margin_deg = inf\n", "finite number")
    no(REQUIREMENTS + "band_hz = 3\n", "band_hz", "pair of numbers")
    no(REQUIREMENTS + "band_hz = [3, 2]\n", "two rising frequencies")
    no(REQUIREMENTS.replace('name = "x"', "name = 3"), "name", "text")
    no(REQUIREMENTS + "structure = [3]\n", "list of tables")
    no(REQUIREMENTS + 'structure = [{ kind = ["gain"] }]\n', "kind", "text")
    no(
        REQUIREMENTS + 'structure = [{ kind = "gain", gain = [1] }]\n',
        "structure 1: gain of a gain block must be a finite number",
        "[1]",
    )
    no(REQUIREMENTS + 'structure = [{ kind = "gain", gain = { min = 1 } }]\n', "min, max")
    no(REQUIREMENTS + 'structure = [{ kind = "gain", gain = { min = "1", max = 2 } }]\n', "finite number")
    no(REQUIREMENTS + REQUIREMENTS.split("\n", 1)[1], "two loops have one name")
    no('format = "loopshape-requirements/1"\nloop = []\n', "requires nothing")


def frf(recording="r01", loop="x"):
    ones = np.ones((3, 1, 1), dtype=complex)
    return ls.FRF(np.arange(1.0, 4.0), ones, ones, np.ones(3, dtype=bool), ("u",), ("y",), "test", recording, loop)


def test_frfs(tmp_path):
    with pytest.raises(ls.errors.UnreadableInputError, match=r"no FRF yet.*loopshape frf"):
        read_frfs(tmp_path)
    with pytest.raises(ls.errors.UnreadableInputError, match="plain name"):
        write_frfs(tmp_path, (frf("../r01"),))
    with pytest.raises(ls.errors.WrongUseError, match=r"two FRFs have one name; received 'r01\.x\.npz'"):
        write_frfs(tmp_path, (frf(), frf()))
    (path,) = write_frfs(tmp_path, (frf(),))
    whole = path.read_bytes()
    for damaged in (b"", whole[:100], whole[:-40], b"PK" + b"x" * 50):
        path.write_bytes(damaged)
        with pytest.raises(ls.errors.UnreadableInputError, match=r"r01\.x\.npz cannot be read as FRF"):
            read_frfs(tmp_path)
    with np.load(write_frfs(tmp_path, (frf(),))[0]) as file:
        arrays = dict(file)
    np.savez(path, **(arrays | {"header": np.array(json.dumps({"format": "other/1"}))}))
    with pytest.raises(ls.errors.UnreadableInputError, match="not of the format loopshape-frf/2; received 'other/1'"):
        read_frfs(tmp_path)
    np.savez(path, **(arrays | {"response": np.ones((2, 1, 1), dtype=complex)}))
    with pytest.raises(ls.errors.UnreadableInputError, match="a response is"):
        read_frfs(tmp_path)
    np.savez(path, **(arrays | {"header": np.array([{"a": 1}], dtype=object)}))
    with pytest.raises(ls.errors.UnreadableInputError, match="allow_pickle"):
        read_frfs(tmp_path)


@pytest.mark.parametrize("text", ['{"fits": [', "[]", '{"format": "other/1"}'])
def test_fits(tmp_path, text):
    with pytest.raises(ls.errors.UnreadableInputError, match=r"no fits yet.*loopshape fit"):
        read_fits(tmp_path)
    (tmp_path / "fits.json").write_text(text)
    with pytest.raises(ls.errors.UnreadableInputError, match=r"fits\.json"):
        read_fits(tmp_path)
    write_fits(tmp_path, ())
    for fits in ([{}], [3], 3, [{"colour": 1}]):
        (tmp_path / "fits.json").write_text(json.dumps({"format": "loopshape-fits/1", "fits": fits}))
        with pytest.raises(ls.errors.UnreadableInputError, match="cannot be read as fits"):
            read_fits(tmp_path)


STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0 }]
[[experiment]]
name = "e1"
excites = "theta2"
excitation = { kind = "sweep", f_low_hz = 0.5, f_high_hz = 30.0, duration_s = 60.0, amplitude_deg = 5.0 }
"""
QUIET = STUDY.split("excites", maxsplit=1)[0] + "duration_s = 5.0\n"


def changed(old, new, text=STUDY):
    assert old in text
    return text.replace(old, new)


def test_studies(tmp_path):
    def no(text, *words, error=ls.errors.WrongUseError):
        refused(read_study, tmp_path / "s.toml", text, *words, error=error)

    no(changed("study/1", "study/2"), "loopshape-study/1", error=ls.errors.UnreadableInputError)
    no(changed('rig = "simulated"\nplant = "arm-1dof"', ""), "no rig, plant")
    no(changed('rig = "simulated"', 'rig = "simulated"\nsede = 3'), "unknown key", "'sede'", "seed")
    no(changed('rig = "simulated"', 'rig = "simulated"\nseed = -3'), "seed", "whole number")
    no(changed("[{ theta2_deg = 0.0 }]", "[]"), "no operating point")
    no(STUDY.split("[[experiment]]", maxsplit=1)[0] + "experiment = []\n", "no experiment")
    no(STUDY + "[pwm]\nrate = 3\n", "pwm: unknown key", "'rate'")
    no(STUDY + '[[loop]]\nname = "x"\n', "no controller")
    no(STUDY + STUDY.split("0.0 }]\n")[1], "two experiments have one name", "'e1'")


def test_experiments(tmp_path):
    def no(text, *words, error=ls.errors.WrongUseError):
        refused(read_study, tmp_path / "s.toml", text, *words, error=error)

    no(STUDY + "lag_s = 1.0\n", "s.toml, experiment 'e1'", "unknown key", "'lag_s'")
    no(STUDY + "lead_s = -1.0\n", "lead_s must not be negative")
    no(STUDY + "duration_s = 10.0\n", "duration_s is for experiments without an excitation", "both")
    no(changed("duration_s = 5.0", "", QUIET), "duration_s", "neither")
    no(changed('excites = "theta2"', ""), "excites and excitation go together")
    no(changed('"e1"', '"a/b"'), "plain name", error=ls.errors.UnreadableInputError)
    no(STUDY + 'kind = "wobble"\n', "wobble", "multisine")
    no(STUDY + 'injection = "valve"\n', "valve", "plant_input")
    no(STUDY + 'role = "both"\n', "both", "validation")
    step = 'x = { kind = "staircase", times_s = [0.0], values_v = [1.0] }'
    no(QUIET + f"references = {{ {step} }}\ncontrol = {{ {step} }}\n", "choose one")


def test_excitations(tmp_path):
    def no(old, new, *words):
        refused(read_study, tmp_path / "s.toml", changed(old, new), *words)

    no('"sweep"', '"chirp"', "chirp", "multisine")
    no("amplitude_deg = 5.0", "amplitude = 5.0", "amplitude is written once, with its unit", "deg")
    no("amplitude_deg = 5.0", "amplitude_degrees = 5.0", "amplitude_degrees", "deg")
    no("amplitude_deg = 5.0", "amplitude_deg = 5.0, amplitude_rad = 1.0", "written once")
    no("amplitude_deg = 5.0", "amplitude_deg = -5.0", "amplitude of a sweep must be positive")
    no("f_low_hz = 0.5, ", "", "no f_low_hz")
    no("f_low_hz = 0.5", "f_low_hz = 50.0", "excitation: a sweep's band must be positive and increasing")
    no("f_low_hz = 0.5", 'f_low_hz = "a"', "finite number")
    no("f_low_hz = 0.5", "f_low_hz = 0.5, period_s = 3.0", "unknown key", "'period_s'")
    no("f_low_hz = 0.5", 'f_low_hz = 0.5, spacing = "octaves"', "octaves", "logarithmic")


SINE = 'kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, amplitude_v = 0.1'
HISS = 'kind = "noise", f_low_hz = 1.0, f_high_hz = 9.0, duration_s = 20.0, amplitude_v = 0.1'


def several(first=SINE, second=SINE, text=""):
    """A study of one experiment that excites two loops at once."""
    both = f"excitations = {{ theta2 = {{ {first} }}, p_ab = {{ {second} }} }}\n"
    return STUDY.split("excites", maxsplit=1)[0] + text + both


def test_several_loops_at_once(tmp_path):
    def no(text, *words, error=ls.errors.WrongUseError):
        refused(read_study, tmp_path / "s.toml", text, *words, error=error)

    beside = "s.toml, experiment 'e1': excitations already say"
    no(several(text='excites = "theta2"\n'), beside, "excites beside it", "excites and excitation for one loop")
    no(several(text=f"excitation = {{ {SINE} }}\n"), beside, "excitation beside it")
    no(several(text="duration_s = 3.0\n"), "duration_s is for experiments without an excitation")
    no(several(SINE.replace("0.1", "-0.1")), "experiment 'e1', excitations, theta2: amplitude of a multisine")
    no(
        several(second=HISS),
        "experiment 'e1': loops are excited at once by",
        "theta2 multisine, p_ab noise",
        "of its own",
    )
    no(several(second=SINE.replace("2.0", "4.0")), "share their period", "theta2 2.0 s, p_ab 4.0 s")
    no(several(SINE + ", turn = 0.5"), "excitations, theta2: loops", "turned by their number", "turn", "leave it out")
    no(several(HISS + ", seed = 3", HISS + ", seed = 3"), "identical", "theta2 seed 3, p_ab seed 3")
    no(STUDY.split("excites", maxsplit=1)[0] + f"excitations = {{ p_ab = {{ {SINE} }} }}\n", "two or more", "p_ab")
    no(STUDY.split("excites", maxsplit=1)[0] + "excitations = {}\n", "two or more", "none")
    no(several(text='name2 = "x"\n'), "unknown key", "excitations, realisations")


def test_realisations(tmp_path):
    def no(text, *words, error=ls.errors.WrongUseError):
        refused(read_study, tmp_path / "s.toml", text, *words, error=error)

    no(several(text="realisations = 0\n"), "experiment 'e1': realisations of an experiment are 1 to 1000", "received 0")
    no(several(text="realisations = 1.5\n"), "realisations must be a whole number", "1.5")
    no(several(text="realisations = 5000\n"), "1 to 1000", "5000")
    no(several(HISS, HISS, "realisations = 2\n"), "experiment 'e1': realisations are of multisines", "theta2 noise")
    no(STUDY + "realisations = 1\n", "realisations are of multisines", "theta2 sweep", "leave realisations out")
    no(QUIET + "realisations = 2\n", "realisations are of multisines", "no excitation")
    again = "[[experiment]]" + several(text="").split("[[experiment]]")[1].replace('"e1"', '"e1-r1"')
    no(several(text="realisations = 1\n") + again, "two experiments have one name", "'e1-r1-s1'")


def test_setpoints(tmp_path):
    good = 'kind = "profile", times_s = [0.0], values_bar = [1.0]'
    good += ", velocity_bar_s = 1.0, acceleration_bar_s2 = 1.0, jerk_bar_s3 = 1.0"

    def no(old, new, *words):
        text = QUIET + f"references = {{ p_ab = {{ {changed(old, new, good)} }} }}\n"
        refused(read_study, tmp_path / "s.toml", text, "experiment 'e1', references, p_ab", *words)

    no('"profile"', '"ramp"', "ramp", "staircase")
    no("jerk_bar_s3", "jerk_mbar_s3", "unknown key", "'jerk_mbar_s3'", "jerk_bar_s3")
    no(", jerk_bar_s3 = 1.0", "", "no jerk_bar_s3")
    no("jerk_bar_s3 = 1.0", "jerk_bar_s3 = 0.0", "jerk", "positive")
    no("values_bar = [1.0]", "values_bar = [1.0, 2.0]", "a value for each time")
    no("values_bar = [1.0]", 'values_bar = ["a"]', "list of numbers")
    no("times_s = [0.0], values_bar = [1.0]", "times_s = [], values_bar = []", "goes somewhere")
    no("values_bar", "values", "values is written once")
