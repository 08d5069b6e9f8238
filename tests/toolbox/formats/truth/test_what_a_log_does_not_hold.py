"""A log of reference and error alone, with a known controller: output and control are made, the FRF is the plant's."""

import known_loops
import numpy as np
import pytest
from scipy.signal import chirp, lfilter, tf2zpk

import loopshape as ls
from loopshape.identify.signals import sum_was_logged
from loopshape.toolbox.formats.controllers.controller_words import step
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.made_columns import answered, read_terms

RATE_HZ, N = 100.0, 12_000
CONTROLLER = (
    '[{ kind = "gain", gain = 4.0 }, { kind = "lead_lag", f1_hz = 2.0, f2_hz = 20.0 }, { kind = "pi", f_hz = 0.2 }]'
)
C = ls.controller(ls.gain(4.0), ls.lead_lag(2.0, 20.0), ls.pi(0.2), rate_hz=RATE_HZ)
B, A = np.array([0.0, 0.02, 0.01]), np.array([1.0, -1.6, 0.64])  # the plant in z
MAP = f"""format = "loopshape-map/1"
rate_hz = 100.0
[columns]
r_rad = {{ from = "r", unit = "deg" }}
e_rad = {{ from = "e", unit = "deg" }}
z_v = {{ sum = "e_rad", controller = "axis" }}
[[loop]]
name = "axis"
reference = "r_rad"
control = "z_v"
output = "r_rad - e_rad"
controller = {CONTROLLER}
[recording]
kind = "noise"
injection = "reference"
excites = "axis"
"""


def closed(r):
    """Error of the loop around C and B/A (a sample late), by its transfer function: A_L/(A_L + B_L)."""
    b, a = B, A
    for b0, b1, b2, a1, a2 in C.biquads():
        b, a = np.convolve(b, [b0, b1, b2]), np.convolve(a, [1.0, a1, a2])
    assert np.abs(tf2zpk([1.0], a + b)[1]).max() < 1.0
    return lfilter(a, a + b, r)


@pytest.fixture
def logged(tmp_path):
    r = np.random.default_rng(4).standard_normal(N)
    np.savez(tmp_path / "log.npz", r=np.degrees(r), e=np.degrees(closed(r)))
    return tmp_path


def read(folder, text):
    (folder / "map.toml").write_text(text)
    return import_file(folder / "log.npz", folder / "map.toml")


def test_reference_and_error_with_the_controller_give_the_plant(logged):
    run = read(logged, MAP)
    assert run.loops[0].output == "axis_output_rad"
    assert any("z_v was not logged" in note and "e_rad from rest" in note for note in run.extra["notes"])
    P = ls.frf(run, loop="axis")
    z = np.exp(-2j * np.pi * P.frequency_hz / RATE_HZ)
    truth = np.polyval(B[::-1], z) / np.polyval(A[::-1], z)
    valid = P.valid & (P.frequency_hz > 0.3) & (P.frequency_hz < 30.0)
    assert valid.sum() > 20
    np.testing.assert_allclose(P.response[valid, 0, 0], truth[valid], rtol=0.02)


def test_a_control_is_what_the_exported_controller_answers():
    e = np.random.default_rng(1).standard_normal(300)
    np.testing.assert_allclose(answered(C, e), step(C, e), rtol=1e-9, atol=1e-12)


def test_sums_have_signs_and_factors():
    assert read_terms("r_rad - 2.5 e_rad + 1e-3*x_rad", "m") == ((1.0, "r_rad"), (-2.5, "e_rad"), (0.001, "x_rad"))


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('output = "r_rad - e_rad"', 'output = "r_rad - - e_rad"', "sum of columns is not understood"),
        ('output = "r_rad - e_rad"', 'output = "r_rad - f_rad"', "names columns that are not there"),
        ('output = "r_rad - e_rad"', 'output = "r_rad - 2 z_v"', "a sum has one unit"),
        ('controller = "axis" }', 'controller = "other" }', "needs the controller of a loop"),
        (f"controller = {CONTROLLER}\n", "", "needs the controller of a loop"),
        ('control = "z_v"\n', "", "let it be computed"),
    ],
)
def test_sums_that_cannot_be_made_are_refused_with_their_cure(logged, old, new, word):
    assert old in MAP
    with pytest.raises(ls.errors.WrongUseError, match=word):
        read(logged, MAP.replace(old, new))


def logged_loop(seed, summed):
    """u, n, y of a loop excited at the plant's input, u in front of the sum or behind it: noise, sweeps, multisines and
    PRBS, loop noise from 1e-4 to 3 of the excitation, noise of the log alone from none to 3 %."""
    rng, size = np.random.default_rng(seed), 3000
    lines = np.concatenate([[0.0], np.exp(2j * np.pi * rng.uniform(size=200)), np.zeros(300)])
    n = (
        rng.standard_normal(size),
        chirp(np.arange(size) / known_loops.RATE, 0.2, size / known_loops.RATE, rng.uniform(10.0, 45.0)),
        np.tile(40.0 * np.fft.irfft(lines, 1000), 3),
        np.repeat(rng.choice([-1.0, 1.0], size // 2), 2),
    )[seed % 4]
    level, log = 10.0 ** rng.uniform(-4.0, 0.5), 10.0 ** rng.uniform(-6.0, -1.5)
    u, y = known_loops.run_loop("plant_input", n, level * rng.standard_normal(size))
    u = u + n if summed else u
    u = u + log * u.std() * rng.standard_normal(size) * (seed % 3 > 0)
    return u, n, y + log * y.std() * rng.standard_normal(size) * (seed % 3 > 1)


def test_a_control_logged_behind_the_sum_is_told_and_a_right_one_never_taken_for_it():
    assert sum(sum_was_logged(*logged_loop(seed, summed=False)) for seed in range(200)) == 0
    assert sum(sum_was_logged(*logged_loop(seed, summed=True)) for seed in range(200)) >= 190


@pytest.mark.parametrize("estimator", ["reference", "direct"])
@pytest.mark.parametrize("stored", [False, True])
def test_a_control_that_holds_the_injection_is_refused_from_arrays_and_from_files(tmp_path, stored, estimator):
    for summed in (False, True):
        u, n, y = logged_loop(0, summed)
        run = ls.Run.from_arrays(u=u, y=y, excitation=n, injection="plant_input", rate_hz=known_loops.RATE)
        if stored:
            ls.write(run, tmp_path / f"run-{summed}")
            run = ls.read(tmp_path / f"run-{summed}")
        if not summed:
            assert ls.frf(run, estimator=estimator).valid.any()
            continue
        with pytest.raises(ls.errors.BadSignalError, match="holds the injected signal"):
            ls.frf(run, estimator=estimator)
