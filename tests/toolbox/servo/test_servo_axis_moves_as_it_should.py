"""The axis' steps against closed forms: free run with viscous friction, spring, two masses, and sliding to rest."""

import numpy as np
import pytest
from bench_nouns import Experiment

import loopshape as ls
from loopshape.toolbox.servo import following
from loopshape.toolbox.servo.axis import ServoAxis

QUIET = {"position_noise_m": 0.0}


def open_loop(force_n, **changes):
    """Recording of an axis at rest at 0 under forces (n,) at 1 kHz."""
    axis = ServoAxis()
    loops = axis.loop_setups(axis.default_controllers(1000.0), "control")
    force = np.asarray(force_n, dtype=float)[:, None]
    e = Experiment(
        "one", "open_loop", loops, 1000.0, 0 * force, force, "control", {"position_m": 0.0}, closed_loop=False
    )
    return axis.simulate([e], changes=QUIET | changes, states=True)[0]


def test_constant_force_against_viscous_friction():
    r = open_loop(np.full(2000, 30.0), mass_kg=50.0, viscous_ns_m=200.0)
    t, tau = r.columns["t_s"], 50.0 / 200.0
    np.testing.assert_allclose(r.columns["position_m"], 30.0 / 200.0 * (t - tau * (1.0 - np.exp(-t / tau))), atol=1e-8)


def test_spring_swings_at_its_frequency():
    r = open_loop(np.full(2000, 10.0), mass_kg=10.0, viscous_ns_m=0.0, stiffness_n_m=4000.0)
    t = r.columns["t_s"]
    np.testing.assert_allclose(r.columns["position_m"], 10.0 / 4000.0 * (1.0 - np.cos(20.0 * t)), atol=5e-7)


def test_free_masses_swing_about_their_common_motion():
    r = open_loop(
        np.full(1000, 10.0), mass_kg=10.0, viscous_ns_m=0.0, flexible_share=0.4, flexible_hz=20.0, flexible_damping=0.0
    )
    t, w = r.columns["t_s"], 2 * np.pi * 20.0
    common = 0.5 * t**2
    np.testing.assert_allclose(r.columns["true_load_m"], common - (1.0 - np.cos(w * t)) / w**2, atol=2e-6)
    centre = 0.6 * r.columns["position_m"] + 0.4 * r.columns["true_load_m"]
    np.testing.assert_allclose(centre, common, atol=1e-12)


def test_friction_stops_the_axis_after_the_travel_that_its_energy_pays():
    force = np.zeros(3000)
    force[:100] = 120.0
    r = open_loop(force, mass_kg=100.0, viscous_ns_m=0.0, coulomb_n=20.0, coulomb_m_s=1e-5)
    paid = 120.0 * r.columns["position_m"][100]
    assert r.columns["position_m"][-1] == pytest.approx(paid / 20.0, rel=2e-3)
    assert abs(r.columns["true_velocity_m_s"][-1]) < 1e-6


def test_the_lacking_force_of_a_bare_model_is_the_force_that_is_not_modelled():
    t = np.arange(4000) / 1000.0
    r = open_loop(40.0 * np.sin(2 * np.pi * 1.5 * t), force_offset_n=3.0)
    axis = ServoAxis()
    run = ls.Run(1000.0, axis.loop_setups(axis.default_controllers(1000.0), "control"), (r,), axis.name)
    lacking = axis.residuals(axis.prepare(r, run, None), {})["force"]
    np.testing.assert_allclose(lacking, -3.0, atol=0.02)


def test_noise_floor_is_what_noise_leaves():
    axis = ServoAxis()
    r = open_loop(40.0 * np.sin(0.01 * np.arange(20000)), position_noise_m=1e-6)
    run = ls.Run(1000.0, axis.loop_setups(axis.default_controllers(1000.0), "control"), (r,), axis.name)
    f = axis.prepare(r, run, None)
    rms = np.sqrt(np.mean(axis.residuals(f, {})["force"] ** 2))
    assert rms == pytest.approx(following.noise_n(f, axis.parameters.vector()), rel=0.15)
