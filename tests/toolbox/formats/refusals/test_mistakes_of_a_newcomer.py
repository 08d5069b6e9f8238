"""Mistakes of people who import their first recording: each ends in a sentence that names the cure."""

import re
import zipfile

import control
import numpy as np
import pytest
from run_files import write_frfs

import loopshape as ls
from loopshape.io.requirements import profile_of
from loopshape.io.write.check_files import check_all
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.gap.own.file import _function, _unpacked

MAP = """format = "loopshape-map/1"
rate_hz = 1000.0
time = { from = "t", unit = "s" }

[columns]
u_v = { from = "u", unit = "V" }
x_m = { from = "x", unit = "mm" }

[[loop]]
name = "axis"
control = "u_v"
output = "x_m"

[recording]
kind = "noise"
injection = "control"
excites = "axis"
closed_loop = false
"""
N = 400
T = np.arange(N) / 1000.0
U = np.random.default_rng(5).standard_normal(N)
X = np.convolve(U, [0.0, 0.5, 0.3])[:N]


def csv(separator=",", decimal=".", t=T, head="t,u,x\n"):
    rows = (separator.join(str(v).replace(".", decimal) for v in row) for row in zip(t, U, X, strict=True))
    return head.replace(",", separator) + "\n".join(rows) + "\n"


def changed(old, new):
    assert old in MAP
    return MAP.replace(old, new, 1)


CLOSED = MAP.replace('"control"\nexcites', '"controller_input"\nexcites').replace("closed_loop = false", "")
STAMPS = [f"2024-03-05T10:00:{t:09.6f}" for t in T]
LATE = np.where(T < 0.2, T, T + 0.3)

#: mistake -> what the map says, what the file holds, its name, and what the sentence must say
IMPORTS = {
    "a unit in full": (changed('"V"', '"volts"'), csv(), "r.csv", "'volts'", "'V' perhaps"),
    "Hz as the unit of a speed": (changed('"V"', '"Hz"'), csv(), "r.csv", "'Hz'", "a speed is rad/s or rpm"),
    "per cent as a unit": (changed('"V"', '"%"'), csv(), "r.csv", "'%'", "gain = 0.01"),
    "a name that ends in another unit": (changed("u_v =", "u_a ="), csv(), "r.csv", "_a", "end the name in _v"),
    "no unit": (changed(', unit = "mm"', ""), csv(), "r.csv", "no unit", "write it"),
    "a decimal comma in the map": (changed("1000.0", "1000,0"), csv(), "r.csv", "rate_hz = 1000,0", "decimal point"),
    "a text without quotes": (changed('"x"', "x"), csv(), "r.csv", "from = x", 'quotes: "x"'),
    "a colon for an equals sign": (changed("rate_hz =", "rate_hz:"), csv(), "r.csv", "rate_hz:", "key = value"),
    "kHz for Hz": (changed("1000.0", "1.0"), csv(), "r.csv", "keep 1000 Hz", "correct rate_hz"),
    "the period for the rate": (changed("1000.0", "0.001"), csv(), "r.csv", "keep 1000 Hz", "correct rate_hz"),
    "stamps in ms": (MAP, csv(t=1e3 * T), "r.csv", "keep 1 Hz", 'the unit of time ("ms")'),
    "stamps written as text": (MAP, csv(t=STAMPS), "r.csv", "2024-03-05T10", 'clock = "iso"'),
    "lost samples": (MAP, csv(t=LATE), "r.csv", "at row 200", "resample = true"),
    "a column misspelled": (changed('"x"', '"pos"'), csv(), "r.csv", "'pos'", "it holds t, u, x"),
    "control and output from one column": (changed('"x"', '"u"'), csv(), "r.csv", "one place", "a column of its own"),
    "another separator": (MAP, csv(";"), "r.csv", "it holds t;u;x", "say its separator in [csv]"),
    "a decimal comma in the file": (
        changed("[columns]", 'csv = { separator = ";" }\n[columns]'), csv(";", ","), "r.csv", "are not numbers",
        "decimal sign",
    ),
    "a row of units": (MAP, csv(head="t,u,x\ns,V,mm\n"), "r.csv", "row 0", "unit_rows = 1"),
    "a header and nothing else": (MAP, "t,u,x\n", "r.csv", "a header and no rows", "record again"),
    "an empty file": (MAP, "", "r.csv", "is empty", "record again"),
    "a spreadsheet": (MAP, csv(), "r.xlsx", "r.xlsx", "save the sheet as CSV"),
    "a pickle": (MAP, csv(), "r.pkl", "r.pkl", "numpy.savez"),
    "a loop misspelled": (changed('excites = "axis"', 'excites = "axes"'), csv(), "r.csv", "'axes'", "loops are axis"),
    "nothing moves": (MAP, re.sub(r",.*", ",0,0", csv()).replace("t,0,0", "t,u,x"), "r.csv", "not move", "check the"),
    "a closed loop without what was injected": (CLOSED, csv(), "r.csv", "no injected", "name the injected column"),
    "a draft taken for a map": (
        MAP + '\n[draft]\nguesses = ["u is the control"]\n', csv(), "r.csv", "has not been confirmed", "delete [draft]"
    ),
}  # fmt: skip


def sentence(action):
    with pytest.raises(ls.LoopshapeError) as caught:
        action()
    return str(caught.value)


@pytest.mark.parametrize("mistake", IMPORTS)
def test_a_mistake_of_an_import_ends_in_its_cure(mistake, tmp_path):
    map_text, text, name, *words = IMPORTS[mistake]
    (tmp_path / "map.toml").write_text(map_text)
    (tmp_path / name).write_text(text)
    said = sentence(lambda: ls.frf(import_file(tmp_path / name, tmp_path / "map.toml")))
    assert [word for word in words if word not in said] == [], said
    assert said.count("; ") >= 2  # three breaths


def test_the_map_of_these_mistakes_is_right_without_them(tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "r.csv").write_text(csv())
    assert ls.frf(import_file(tmp_path / "r.csv", tmp_path / "map.toml"), method="welch").frequency_hz.size > 10


def test_recording_and_map_given_the_wrong_way_round(tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "r.csv").write_text(csv())
    assert "the map behind --map" in sentence(lambda: import_file(tmp_path / "map.toml", tmp_path / "r.csv"))


P = ls.FRF.from_arrays([1.0, 2.0, 4.0], [1.0, 0.5j, 0.1], relative_std=0.01, rate_hz=1000.0, loop="axis")

C = ls.controller(ls.gain(0.5), rate_hz=1000.0, loop="axis")
TF = control.tf([1.0], [1.0, 1.0, 0.0])


def run_of(**words):
    return ls.Run.from_arrays(**{"u": U, "y": X, "excitation": U, "rate_hz": 1000.0, **words})


def frf_with(**words):
    return ls.FRF.from_arrays([1.0, 2.0], [1.0, 0.5j], relative_std=0.01, **words)


#: mistake -> what is done, and what the sentence must say
IN_PYTHON = {
    "per cent for a share": (lambda: ls.FRF.from_arrays([1.0], [1.0 + 0j], relative_std=5.0), "500 %", "write 0.05"),
    "a coherence without averages": (
        lambda: ls.FRF.from_arrays([1.0], [1.0 + 0j], coherence=[0.9]), "averages", "give coherence and averages"
    ),
    "no error": (lambda: ls.FRF.from_arrays([1.0], [1.0 + 0j]), "the error of this FRF", "give std, relative_std"),
    "magnitude without phase": (
        lambda: ls.FRF.from_arrays([1.0], magnitude_db=[0.0], relative_std=0.1), "1 of", "magnitude_db and phase_deg"
    ),
    "a modulus margin in dB": (lambda: ls.Requirements(modulus_margin=6.0), "6", "must not exceed 1"),
    "a controller at another rate": (
        lambda: ls.check(P, ls.controller(ls.gain(1.0), rate_hz=500.0)), "500 and 1000 Hz", "the recording's rate_hz"
    ),
    "a profile misspelled": (lambda: profile_of("iso"), "'iso'", "servo"),
    "an injection misspelled": (lambda: run_of(injection="plant-input"), "'plant-input'", "did you mean 'plant_input'"),
    "an injection in capitals": (lambda: run_of(injection="Plant_Input"), "'Plant_Input'", "did you mean 'plant_in"),
    "an injection with a space": (lambda: run_of(injection="plant input"), "did you mean 'plant_input'?"),
    "a method misspelled": (lambda: ls.frf(run_of(), method="welsh"), "'welsh'", "did you mean 'welch'?"),
    "a setting misspelled": (lambda: ls.frf(run_of(), resolution=1.0), "'resolution'", "did you mean 'resolution_hz'?"),
    "a structure misspelled": (lambda: ls.fit(P, "thirdorder"), "did you mean 'third_order'?"),
    "an order misspelled": (lambda: ls.fit(P, "rational", poles=2), "'poles'", "known are numerator"),
    "a sense misspelled": (lambda: ls.Mask("S", ((1.0, 0.0), (2.0, 0.0)), "at-most"), "did you mean 'at_most'?"),
    "a hold misspelled": (lambda: frf_with(hold="includes"), "'includes'", "did you mean 'included'?"),
    "a field misspelled": (lambda: frf_with(ratehz=1.0), "'ratehz'", "did you mean 'rate_hz'?"),
    "a real response": (lambda: ls.FRF.from_arrays([1.0], [1.0], relative_std=0.1), "must be complex", "H + 0j"),
    "truth values for a response": (
        lambda: ls.FRF.from_arrays([1.0], [True], relative_std=0.1), "must hold numbers", "truth values"
    ),
    "a masked response": (
        lambda: ls.FRF.from_arrays([1.0, 2.0], np.ma.array([1j, 1j], mask=[0, 1]), relative_std=0.1), "masked", "1 of 2"
    ),
    "masked samples": (lambda: run_of(u=np.ma.masked_greater(U, 1.0)), "masked values", "cut them out"),
    "complex samples": (lambda: run_of(y=X + 1j), "y of a run must be real", ".real"),
    "dates for samples": (lambda: run_of(u=np.arange(N).astype("datetime64[s]")), "dates", "seconds"),
    "texts for samples": (lambda: run_of(u=["a"] * N), "u of a run must hold numbers", "texts"),
    "objects for samples": (lambda: run_of(u=np.array([None] * N)), "u of a run", "objects"),
    "a sample that is no number": (lambda: run_of(u=np.where(U > 1, np.nan, U)), "are not numbers", "at index"),
    "samples of 1e300": (lambda: run_of(y=1e300 * X), "above 1e+50", "check its unit"),
    "no samples": (lambda: run_of(u=[], y=[]), "of one length", "u (0,)"),
    "a rate of zero": (lambda: run_of(rate_hz=0), "rate_hz of a run must be a positive", "0"),
    "a rate below zero": (lambda: run_of(rate_hz=-1.0), "rate_hz of a run must be a positive", "-1"),
    "a rate that is no number": (lambda: run_of(rate_hz=float("nan")), "rate_hz of", "nan"),
    "a rate of 1e300": (lambda: run_of(rate_hz=9e299), "between 1e-06 and 1e+12 Hz"),
    "a rate of 1e-300": (lambda: run_of(rate_hz=1e-300), "between 1e-06 and 1e+12 Hz", "1e-300"),
    "a rate in quotes": (lambda: run_of(rate_hz="500"), "rate_hz of", "a number", "'500'"),
    "a period that is no number": (lambda: run_of(period_s=float("nan")), "period_s of", "nan"),
    "no frequencies": (lambda: ls.FRF.from_arrays([], np.zeros(0, complex), relative_std=0.1), "(0,) frequencies"),
    "errors for a share": (
        lambda: ls.FRF.from_arrays([1.0, 2.0], [1j, 1j], relative_std=np.array([0.1, 0.1])), "relative_std", "a number"
    ),
    "check with its arguments swapped": (lambda: ls.check(C, P), "the wrong way round", "ls.check(P, C, R)"),
    "check with all of them moved": (lambda: ls.check(ls.Requirements(), P, C), "ls.check(P, C, R)"),
    "a model for a plant": (lambda: ls.check(TF, C), "P of ls.check", "ls.FRF.from_control(system, frequency_hz)"),
    "a transfer function as controller": (lambda: ls.check(P, TF), "C of", "ls.controller(*ls.fixed(system"),
    "poles that nothing declares": (
        lambda: ls.tune(P, ls.Requirements(sensitivity_peak_db=6.0, integrators=0), [ls.gain()]),
        "at frf 1; declare unstable_poles",
    ),
    "no structure": (lambda: ls.tune(P, ls.Requirements(sensitivity_peak_db=6.0)), "ls.tune(P, R, [ls.gain(), ...])"),
    "a run that is not there": (lambda: ls.read("nowhere"), "nowhere, which does not exist", "run.toml"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", IN_PYTHON)
def test_a_mistake_in_python_ends_in_its_cure(mistake):
    action, *words = IN_PYTHON[mistake]
    said = sentence(action)
    assert [word for word in words if word not in said] == [], said


CONTROLLER = """format = "loopshape-controllers/1"
rate_hz = 1000.0
[[loop]]
name = "axis"
controller = [{ kind = "gain", gain = 0.5 }]
"""
REQUIRED = """format = "loopshape-requirements/1"
[[loop]]
name = "axis"
phase_margin_deg = 45.0
"""
OF_FILES = {
    "a loop misspelled": (REQUIRED.replace('"axis"', '"axes"'), "'axes'", "axis"),
    "the requirements of another loop": (REQUIRED.replace('"axis"', '"position"'), "'position'", "axis"),
    "a key misspelled": (REQUIRED.replace("phase_margin_deg", "phase_margin"), "phase_margin", "phase_margin_deg"),
    "a decimal comma": (REQUIRED.replace("45.0", "45,0"), "45,0", "decimal point"),
    "a block without its parameters": (
        REQUIRED + 'structure = [{ kind = "gain" }]',
        "received none",
        "gain = 1.0",
        "{}",
    ),
}


@pytest.mark.parametrize("mistake", OF_FILES)
def test_a_mistake_of_requirements_ends_in_its_cure(mistake, tmp_path):
    text, *words = OF_FILES[mistake]
    write_frfs(tmp_path / "run", [P])
    (tmp_path / "c.toml").write_text(CONTROLLER)
    (tmp_path / "r.toml").write_text(text)
    said = sentence(lambda: check_all(tmp_path / "run", tmp_path / "c.toml", tmp_path / "r.toml"))
    assert [word for word in words if word not in said] == [], said


def test_slips_of_a_requirements_file_name_the_users_own_value(tmp_path):
    path = tmp_path / "r.toml"
    for line, words in (
        ("gain_margin_db = 6,25", "write a decimal point: 6.25"),
        ("phase_margin = 30.0", "did you mean 'phase_margin_deg'"),
        ('phase_margin_deg = "30 deg"', "leave the unit out: phase_margin_deg = 30"),
    ):
        path.write_text(f'format = "loopshape-requirements/1"\n[[loop]]\nname = "axis"\n{line}\n')
        assert words in sentence(lambda: ls.read_requirements(path))


def test_a_models_file_does_not_end_the_command(tmp_path):
    (tmp_path / "m.py").write_text("import sys\nsys.exit(0)\n")
    assert "m.py does not run" in sentence(lambda: _function(tmp_path, "m.py", "motion"))


def test_an_fmu_that_would_fill_the_disk_is_refused_before_it_is_unpacked(tmp_path):
    pytest.importorskip("fmpy")
    with zipfile.ZipFile(tmp_path / "m.fmu", "w", zipfile.ZIP_DEFLATED) as made, made.open("big", "w") as big:
        for _ in range(257):
            big.write(bytes(1 << 20))
    said = sentence(lambda: _unpacked(tmp_path, "m.fmu"))
    assert "m.fmu is no FMU" in said
    assert str(257 << 20) in said
