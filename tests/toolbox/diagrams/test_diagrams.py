"""Structures: the plant that a tuned block meets, whole diagrams and their intervals, against python-control."""

import control
import numpy as np
import pytest
from conversions import angular

import loopshape as ls
from loopshape.toolbox.diagrams.diagram_run import states

RATE = 2000.0
F = np.geomspace(0.05, 800.0, 120)
Z = np.exp(1j * angular(F) / RATE)
COARSE = control.c2d(control.ss(control.tf([4000.0], [1.0, 20.0, 100.0])), 1.0 / RATE)
FINE = control.c2d(control.ss(control.tf([1.0e6], [1.0, 400.0, 1.0e6])), 1.0 / RATE)
C1 = ls.controller(ls.gain(0.8), ls.lead_lag(20.0, 200.0), rate_hz=RATE, loop="C1")
C2 = ls.controller(ls.gain(0.3), ls.low_pass(30.0, order=1), rate_hz=RATE, loop="C2")
LOW, HIGH = (ls.controller(*ls.fixed(one), rate_hz=RATE) for one in (([], [-60.0], 60.0), ([0.0], [-60.0], 1.0)))


def frf(system, recording="", std=0.0, seed=0, **words):
    """The FRF of a discrete system, with independent relative noise of each element."""
    H = np.moveaxis(np.asarray(system.frequency_response(angular(F), squeeze=False).frdata), -1, 0)
    rng = np.random.default_rng(seed)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2.0)
    return ls.FRF.from_arrays(
        F, H * (1.0 + std * noise), relative_std=std, rate_hz=RATE, recording=recording, **({"open_loop": True} | words)
    )


def system(controller, name, into, out):
    """A controller as python-control's system with named signals."""
    made = control.tf([1.0], [1.0], 1.0 / RATE)
    for b0, b1, b2, a1, a2 in controller.biquads():
        made = made * control.tf([b0, b1, b2], [1.0, a1, a2], 1.0 / RATE)
    return control.ss(made, inputs=[into], outputs=[out], name=name)


def named(plant, name, into, out):
    return control.ss(plant.A, plant.B, plant.C, plant.D, plant.dt, inputs=into, outputs=out, name=name)


def summed(name, text):
    return control.summing_junction(inputs=text.replace("+ ", "").replace("- ", "-").split(), output=name)


def whole(structure, models):
    """The whole diagram by python-control, from the setpoint to y."""
    parts = []
    for one in structure.parts:
        if one.plants:
            parts.append(named(models[one.name], one.name, list(one.inputs), list(one.outputs)))
        else:
            parts.append(system(one.what, one.name, one.inputs[0], one.outputs[0]))
    parts += [summed(name, text) for name, text in structure.sums.items()]
    out = "y" if "y" in structure.signals else structure.part("G").outputs[1]
    return control.interconnect(parts, inputs=["r"], outputs=[out], check_unused=False), out


MOTOR = control.c2d(
    control.ss([[-12.0, 0.0], [1.0, 0.0]], [[60.0], [0.0]], np.eye(2), np.zeros((2, 1))), 1.0 / RATE
)  # drive to speed and angle
SPEED = ls.controller(ls.gain(1.5), ls.pi(3.0), rate_hz=RATE, loop="speed")
NOMINAL = control.tf([20.0], [1.0, 4.0, 0.0])
REAL = control.c2d(control.ss(control.tf([24.0], [1.0, 5.0, 0.0])), 1.0 / RATE)
LEAD = ls.controller(ls.gain(8.0), ls.lead_lag(1.0, 20.0), rate_hz=RATE)
PRE = ls.controller(ls.low_pass(15.0, order=1), rate_hz=RATE)


def every():
    """Structures with their tuned controller in, and the models of their plants."""
    stages = {"P1": COARSE, "P2": FINE}
    both = (frf(COARSE, "a"), frf(FINE, "b"))
    sensors = control.ss(REAL.A, REAL.B, np.vstack([REAL.C, REAL.C]), np.zeros((2, 1)), 1.0 / RATE)
    return {
        "parallel": (ls.diagrams.dual_stage(*both, C2).with_part("C1", C1), stages),
        "master-slave": (
            ls.diagrams.dual_stage(*both, C2, kind="master-slave", estimate=PRE).with_part("C1", C1),
            stages,
        ),
        "displacement": (ls.diagrams.dual_stage(*both, C2, kind="master-slave").with_part("C1", C1), stages),
        "cascade": (
            ls.diagrams.cascade(frf(MOTOR, "m", outputs=("speed", "angle")), SPEED).with_part(
                "outer", ls.controller(ls.gain(6.0), rate_hz=RATE)
            ),
            {"G": MOTOR},
        ),
        "two sensors": (ls.diagrams.two_sensors(frf(sensors, "s"), LOW, HIGH).with_part("C", LEAD), {"G": sensors}),
        "setpoint": (ls.diagrams.prefilter(frf(REAL, "p"), PRE).with_part("C", LEAD), {"P": REAL}),
        "input": (ls.diagrams.prefilter(frf(REAL, "p"), PRE, to="input").with_part("C", LEAD), {"P": REAL}),
        "observer": (
            ls.diagrams.disturbance_observer(frf(REAL, "p"), NOMINAL, ls.low_pass(20.0, 0.7)).with_part("C", LEAD),
            {"P": REAL},
        ),
    }


@pytest.mark.parametrize("name", every())
def test_a_whole_diagram_is_that_of_python_control(name):
    """Poles and the closed loop's response by `control.interconnect`; the count of `check` agrees with the poles."""
    structure, models = every()[name]
    truth, out = whole(structure, models)
    H = np.asarray(truth.frequency_response(angular(F), squeeze=True).frdata).ravel()
    np.testing.assert_allclose(ls.diagrams.transfer(structure, "r", out).siso, H, rtol=1e-9, atol=1e-12)
    mine = np.linalg.eigvals(states(structure, models).A)
    for pole in control.poles(truth):
        assert np.abs(mine - pole).min() < 1e-5
    assert np.abs(mine).max() < 1.0 - 1e-6
    verdict = ls.check(structure, structure.part(structure.tuned).what)
    assert [m.stable for m in verdict.margins.values()] == ["stable"]


@pytest.mark.parametrize("name", every())
def test_a_diagram_runs_as_python_control_runs_it(name):
    structure, models = every()[name]
    truth, out = whole(structure, models)
    r = np.sin(0.01 * np.arange(400)) + 0.2
    found = ls.diagrams.simulate(structure, models, {"r": r})[out]
    there = control.forced_response(truth, np.arange(400) / RATE, r, squeeze=True).outputs
    np.testing.assert_allclose(found, np.ravel(there), atol=1e-9 * np.abs(there).max())


@pytest.mark.parametrize("name", every())
def test_margins_are_those_of_the_loop_broken_at_the_tuned_block(name):
    """|S| of `check` at its peak is that of the diagram's own response at the tuned block's output."""
    structure, _ = every()[name]
    tuned = structure.part(structure.tuned)
    (plant,) = ls.diagrams.equivalent(structure).plants
    S = ls.diagrams.transfer(structure, tuned.outputs[0], tuned.outputs[0]).siso
    np.testing.assert_allclose(S, 1.0 / (1.0 + tuned.what.response(F) * plant.siso), rtol=1e-9)
    (m,) = ls.check(structure, tuned.what).margins.values()
    assert m.sensitivity_peak_db == pytest.approx(20.0 * np.log10(np.abs(S).max()), abs=0.1)


@pytest.mark.parametrize("kind", ["parallel", "observer"])
def test_the_error_of_what_the_tuned_block_meets_is_that_of_draws(kind):
    """The variance told, over that of 80 draws of all measurements."""

    def made(seed):
        if kind == "parallel":
            return ls.diagrams.dual_stage(frf(COARSE, "a", 0.01, seed), frf(FINE, "b", 0.01, 1000 + seed), C2)
        return ls.diagrams.disturbance_observer(frf(REAL, "p", 0.01, seed), NOMINAL, ls.low_pass(20.0, 0.7))

    one = made(0)
    signal = one.part(one.tuned)
    path = {"opened": (one.tuned,), "source": signal.outputs[0], "to": signal.inputs[0]}
    drawn = np.array([ls.diagrams.transfer(made(k), **path).siso for k in range(80)])
    ratio = np.var(drawn, axis=0) / ls.diagrams.transfer(one, **path).variance[:, 0, 0]
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.04)


def test_what_was_measured_together_is_counted_once():
    """Two sensors with one noise, added with opposite signs: nothing is left of it."""
    H = np.stack([REAL(Z), REAL(Z)], axis=1)[:, :, None]
    shared = 1e-4 * np.abs(H[:, :1]) ** 2 * np.ones((2, 2))
    G = ls.FRF.from_arrays(F, H, covariance=shared + 0j, rate_hz=RATE, open_loop=True)
    half, minus = (ls.controller(ls.gain(g), rate_hz=RATE) for g in (1.0, -1.0))
    D = ls.diagrams.two_sensors(G, half, minus)
    assert np.all(ls.diagrams.transfer(D, "u", "y", opened=("C",)).variance < 1e-12 * shared[:, :1, :1])


def test_a_tuned_dual_stage_is_stable_and_faster_than_the_coarse_actuator_alone():
    D = ls.diagrams.dual_stage(frf(COARSE, "a", 0.003), frf(FINE, "b", 0.003, 1), C2)
    R = ls.Requirements("C1", sensitivity_peak_db=6.0, integrators=0)
    made = ls.tune(D, R, [ls.gain(), ls.lead_lag((5.0, 60.0), (60.0, 600.0))], starts=1)
    assert made.verdict.passed
    closed = D.with_part("C1", made.controller)
    assert np.abs(np.linalg.eigvals(states(closed, {"P1": COARSE, "P2": FINE}).A)).max() < 1.0
    assert ls.check(D, made, R).outcome is ls.Outcome.PASSED


def test_inner_loops_that_are_not_certified_are_refused():
    fine = frf(FINE, "b")
    with pytest.raises(ls.errors.WrongUseError, match="inner loop C2 is unstable"):
        ls.diagrams.equivalent(
            ls.diagrams.dual_stage(frf(COARSE, "a"), fine, ls.controller(ls.gain(30.0), rate_hz=RATE))
        )
    unknown = frf(FINE, "b", open_loop=False)
    with pytest.raises(ls.errors.WrongUseError, match="inner loop C2 is undecided"):
        ls.diagrams.equivalent(ls.diagrams.dual_stage(frf(COARSE, "a"), unknown, C2))


def test_integrators_that_drift_against_each_other_are_refused():
    """A double integrator beside a fine actuator whose controller integrates: the state matrix has a pole at 1."""
    free = control.c2d(control.ss(control.tf([400.0], [1.0, 0.0, 0.0])), 1.0 / RATE)
    D = ls.diagrams.dual_stage(frf(free, "a"), frf(FINE, "b"), ls.controller(ls.gain(0.1), ls.pi(2.0), rate_hz=RATE))
    with pytest.raises(ls.errors.WrongUseError, match="does not see"):
        ls.diagrams.equivalent(D)
    poles = np.linalg.eigvals(states(D.with_part("C1", C1), {"P1": free, "P2": FINE}).A)
    assert np.abs(poles - 1.0).min() < 1e-4


def test_unstable_poles_go_to_the_loop_that_holds_them():
    """An unstable coarse actuator: the tuned block meets one unstable pole, and another number is refused."""
    falling = control.c2d(control.ss(control.tf([900.0], [1.0, 2.0, -100.0])), 1.0 / RATE)
    plain = ls.diagrams.dual_stage(frf(falling, "a", open_loop=False), frf(FINE, "b"), C2)
    parts = tuple(
        ls.diagrams.Part("P1", "u1", "y1", p.what, unstable_poles=1) if p.name == "P1" else p for p in plain.parts
    )
    D = ls.diagrams.Diagram(parts, plain.sums, "C1")
    assert ls.diagrams.equivalent(D).unstable_poles == 1
    lead = ls.controller(ls.gain(1.5), ls.lead_lag(3.0, 60.0), rate_hz=RATE)
    (m,) = ls.check(D, lead, ls.Requirements("C1", integrators=0)).margins.values()
    stable = np.abs(np.linalg.eigvals(states(D.with_part("C1", lead), {"P1": falling, "P2": FINE}).A)).max() < 1.0
    assert (m.stable == "stable") == stable
    with pytest.raises(ls.errors.WrongUseError, match="declare other unstable poles"):
        ls.check(D, lead, ls.Requirements("C1", unstable_poles=0))


def test_diagrams_that_make_no_sense_are_refused():
    P = ls.diagrams.Part("P", "u", "y", frf(REAL))
    C = ls.diagrams.Part("C", "e", "u")
    with pytest.raises(ls.errors.WrongUseError, match="one block or sum"):
        ls.diagrams.Diagram((C, P), {"y": "r - u"}, "C")
    with pytest.raises(ls.errors.WrongUseError, match="circle"):
        ls.diagrams.Diagram((C, P), {"e": "r - a", "a": "e + y"}, "C")
    with pytest.raises(ls.errors.WrongUseError, match="no such block"):
        ls.diagrams.Diagram((C, P), {"e": "r - y"}, "D")
    with pytest.raises(ls.errors.WrongUseError, match="signals with signs"):
        ls.diagrams.Diagram((C, P), {"e": "r * y"}, "C")
    with pytest.raises(ls.errors.WrongUseError, match="no controller yet"):
        ls.diagrams.transfer(ls.diagrams.Diagram((C, P), {"e": "r - y"}, "C"), "r", "y")
    F2 = ls.controller(ls.gain(1.0), rate_hz=2.0 * RATE)
    with pytest.raises(ls.errors.WrongUseError, match="one rate"):
        ls.diagrams.Diagram(
            (C, P, ls.diagrams.Part("F", "r", "rf", F2), ls.diagrams.Part("H", "y", "h", C1)), {"e": "rf - h"}, "C"
        )
