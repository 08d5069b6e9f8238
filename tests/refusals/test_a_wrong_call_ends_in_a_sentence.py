"""A wrong call of a public name ends in a sentence that names the right one, and stays a TypeError."""

import inspect

import numpy as np
import pytest

import loopshape as ls

F_HZ = np.geomspace(1.0, 300.0, 50)
P = ls.FRF.from_arrays(F_HZ, 1.0 / (1.0 + 1j * F_HZ / 10.0), relative_std=0.01, rate_hz=2000.0)
C = ls.controller(ls.gain(1.0), rate_hz=2000.0)
R = ls.Requirements(phase_margin_deg=45.0)

#: call -> what its sentence must say
CALLS = {
    lambda: ls.check(P, C, margin=45.0): ("ls.check", "'margin'", "ls.check(P, C, R=None, *"),
    lambda: ls.check(P, C, distrubance=None): ("'distrubance'", "did you mean 'disturbance'?"),
    lambda: ls.check(P): ("ls.check: missing a required argument: 'C'", "ls.check(P, C, R=None, *"),
    lambda: ls.check(P, C, R, 4, 5): ("ls.check: too many positional arguments", "call ls.check("),
    lambda: ls.tune(P, R, max_s=3.0): ("ls.tune", "'max_s'"),
    lambda: ls.tune(P, R, seeds=3): ("did you mean 'seed'?",),
    lambda: ls.check(P, C, phase_margin_deg=45.0): ("limits go into R=ls.Requirements(...)",),
    lambda: ls.notch(f=30.0): ("ls.notch", "'f'", "ls.notch(f_hz=None"),
    lambda: ls.pid(kp=3.0, kk=3.0): ("kk",),
    lambda: ls.Requirements(phase_margin=45.0): ("ls.Requirements", "did you mean 'phase_margin_deg'?"),
    lambda: ls.Loop(P, D=C): ("ls.Loop", "'D'", "ls.Loop(plant, controllers"),
    lambda: ls.Controller(x=3): ("ls.Controller", "'x'"),
    lambda: P.between(low_hz=3.0): ("ls.FRF.between", "did you mean 'f_low_hz'?"),
    lambda: P.between(1.0, 2.0, 3.0): ("ls.FRF.between: too many", "call ls.FRF.between(f_low_hz, f_high_hz)"),
    lambda: ls.FRF.from_arrays(F_HZ, P.siso, coherance=0.5): ("did you mean 'coherence'?",),
    lambda: ls.FRF.from_arrays(frequency=F_HZ): ("did you mean 'frequency_hz'?",),
    lambda: ls.Run.from_arrays(u=F_HZ, y=F_HZ, fs=3.0): ("'fs'", "rate_hz"),
    lambda: ls.plot.bode(P, titel=""): ("ls.plot.bode", "'titel'"),
    lambda: ls.plot(P, titel=""): ("ls.plot", "'titel'"),
    lambda: ls.chek: ("did you mean 'check'?",),
    lambda: ls.Weihgt: ("did you mean 'Weight'?",),
}  # fmt: skip


@pytest.mark.parametrize("call", CALLS, ids=[" ".join(words) for words in CALLS.values()])
def test_a_wrong_call_ends_in_a_sentence(call):
    with pytest.raises((ls.LoopshapeError, AttributeError)) as wrong:
        call()
    for words in CALLS[call]:
        assert words in str(wrong.value), str(wrong.value)


@pytest.mark.parametrize("call", list(CALLS)[:3])
def test_a_wrong_call_is_a_type_error_as_python_has_it(call):
    with pytest.raises(TypeError):
        call()


def test_what_goes_wrong_inside_stays_what_it_is():
    with pytest.raises(TypeError, match="<=") as wrong:
        P.between(1.0, object())
    assert not isinstance(wrong.value, ls.LoopshapeError)


def test_signatures_of_public_nouns_are_still_theirs():
    assert list(inspect.signature(ls.Loop).parameters)[:2] == ["plant", "controllers"]
    assert list(inspect.signature(ls.FRF.between).parameters) == ["self", "f_low_hz", "f_high_hz"]
    assert "phase_margin_deg" in inspect.signature(ls.Requirements).parameters


def test_what_a_notebook_shows_of_a_noun_is_one_short_line():
    loop, disturbance = ls.Loop(P, C), ls.Disturbance.from_arrays(np.sin(np.arange(2000.0)), 2000.0, recorded_under=C)
    P2 = ls.FRF.from_arrays(F_HZ, P.siso[:, None, None] * np.eye(2), relative_std=0.01, rate_hz=2000.0)
    run = ls.Run.from_arrays(u=np.sin(F_HZ), y=np.cos(F_HZ), rate_hz=2000.0)
    shown = [loop, loop.margins(), disturbance, P2, run.recordings[0], run, ls.check(P, C, R)]
    for line in map(repr, shown):
        assert len(line) < 200
        assert "\n" not in line
        assert "array" not in line


def test_a_worst_case_that_nothing_bounds_is_a_word():
    low = P.between(1.0, 3.0)
    asked = ls.Requirements(phase_margin_deg=45.0, sensitivity_peak_db=6.0, integrators=0, unstable_poles=0)
    shown = str(ls.check(low, ls.controller(ls.gain(30.0), rate_hz=2000.0), asked))
    assert "undecided" in shown
    assert "nan" not in shown
    assert "<= inf" not in shown


def test_a_rate_that_is_not_known_is_named():
    with pytest.raises(ls.LoopshapeError, match=r"rate of the FRFs to tune for is not known.*give them rate_hz"):
        ls.tune(ls.FRF.from_arrays(F_HZ, P.siso, relative_std=0.01), R, [ls.gain()])
