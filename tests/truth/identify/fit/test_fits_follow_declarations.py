"""A fit asks for a stable model where the recordings or the requirements declare one, and only there.

The machines are difference equations of their own: a crane's swing in open loop, an inverted pendulum held upright.
"""

import json

import numpy as np
import pytest
from commands import loopshape as command
from scipy.signal import cont2discrete, lfilter

import loopshape as ls

RATE, N = 50.0, 12_000
W = np.sqrt(9.81 / 0.45 * (1.0 + 0.63 / 1.7))  # load of 0.63 kg on 0.45 m of rope under a trolley of 1.7 kg, in rad/s


def crane(rng, rests_s):
    """Force and swing of a crane that nothing moves for the first `rests_s`; damping ratio 0.003."""
    B, A, _ = cont2discrete(([-1.0 / (1.7 * 0.45)], [1.0, 0.006 * W, W * W]), 1.0 / RATE)
    u = lfilter([0.2], [1.0, -0.8], rng.standard_normal(N))
    u[: round(rests_s * RATE)] = 0.0
    return u, lfilter(np.ravel(B), A, u) + 0.0003 * rng.standard_normal(N)


def pendulum(rng):
    """Reference, torque and angle of an inverted pendulum with poles at +-4 rad/s, under gain and lead."""
    B, A, _ = cont2discrete(([16.0], [1.0, 0.0, -16.0]), 1.0 / RATE)
    D, F, _ = cont2discrete(([4.0, 16.0], [1.0 / 60.0, 1.0]), 1.0 / RATE, "bilinear")
    opened, forward, beside = (np.convolve(p, q) for p, q in ((A, F), (np.ravel(B), np.ravel(D)), (A, np.ravel(D))))
    closed = opened + forward
    assert np.abs(np.roots(closed)).max() < 1.0 < np.abs(np.roots(opened)).max()
    r, v = rng.standard_normal(N), 0.001 * rng.standard_normal(N)
    return r, lfilter(beside, closed, r - v), lfilter(forward, closed, r) + lfilter(opened, closed, v)


@pytest.mark.parametrize("rests_s", [0.0, 100.0])
def test_a_crane_in_open_loop_gets_a_stable_model_though_it_rested_at_first(rests_s):
    u, y = crane(np.random.default_rng(1), rests_s)
    P = ls.frf(ls.Run.from_arrays(u=u, y=y, rate_hz=RATE))
    assert P.open_loop
    found = ls.fit(P, "rational", numerator=0, denominator=2)
    assert found.model.unstable_poles() == 0
    assert found.structure.endswith("stable")


def test_an_output_that_grows_while_its_input_does_not_is_not_taken_for_stable():
    rng = np.random.default_rng(2)
    u = rng.standard_normal(2000)
    y = lfilter([0.01], np.poly([1.002, 0.9]), u) + 0.01 * rng.standard_normal(2000)
    assert not ls.frf(ls.Run.from_arrays(u=u, y=y, rate_hz=RATE)).open_loop


def fitted(folder, *words):
    """Whether the command asked for a stable model."""
    done = command("fit", folder, "--structure", "rational", "--denominator", "2", *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["fits"][0]["structure"].endswith("stable")


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pendulum") / "run"
    r, u, y = pendulum(np.random.default_rng(3))
    ls.write(ls.Run.from_arrays(u=u, y=y, excitation=r, rate_hz=RATE, loop="angle"), folder)
    assert command("frf", folder).returncode == 0
    return folder


def declared(folder, poles):
    file = folder.parent / f"requirements-{poles}.toml"
    file.write_text(f'format = "loopshape-requirements/1"\n[[loop]]\nname = "angle"\nunstable_poles = {poles}\n')
    return file


def test_an_inverted_pendulum_in_closed_loop_keeps_its_unstable_pole(held):
    assert not fitted(held)
    P = ls.frf(ls.read(held))
    assert not P.open_loop
    assert ls.fit(P, "rational", denominator=2).model.unstable_poles() == 1


def test_declared_unstable_poles_decide_where_no_option_does(held):
    assert not fitted(held, "--require", declared(held, 1))
    assert fitted(held, "--require", declared(held, 0))
    assert not fitted(held, "--require", declared(held, 0), "--any-poles")
