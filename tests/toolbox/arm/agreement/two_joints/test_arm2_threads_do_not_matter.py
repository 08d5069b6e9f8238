"""Two joints: same experiments and seeds, same recordings bit for bit, however many threads run them."""

import numpy as np
import pytest
from arm2_cases import ARM, MIDDLE, experiment

POINTS = [MIDDLE, (0.0, 10.0, 0.4, 0.4), (3.0, 0.0, 0.4, 0.4), (-3.0, -5.0, 0.45, 0.5)]


@pytest.fixture(scope="module")
def campaign():
    return [experiment((0.9 * p[0], *p[1:]), 1500, setpoint=p, seed=k) for k, p in enumerate(POINTS)]


def same(ours, theirs):
    return [np.array_equal(ours.columns[name], theirs.columns[name]) for name in ours.columns]


def test_one_and_two_threads_record_the_same_bits(campaign):
    one, two = (ARM.simulate(campaign, threads=n, states=True) for n in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert a.info == b.info
        assert set(a.columns) == set(b.columns)
        assert all(same(a, b))


def test_an_experiment_does_not_depend_on_its_neighbours(campaign):
    assert all(same(ARM.simulate([campaign[2]])[0], ARM.simulate(campaign)[2]))


def test_asking_for_states_changes_no_measured_bit(campaign):
    (plain,), (more,) = (ARM.simulate(campaign[:1], states=s) for s in (False, True))
    assert all(same(plain, more))
    assert len(more.columns) == len(plain.columns) + 9


def test_another_seed_gives_other_noise_and_the_same_kind_of_motion():
    one, other = ARM.simulate([experiment((2.0, 9.0, 0.4, 0.4), 1500, setpoint=POINTS[1], seed=s) for s in (1, 2)])
    for name in ("theta1_rad", "theta2_rad", "p_a_bar", "p_b_bar", "p_c_bar", "p_d_bar"):
        assert np.mean(one.column(name) != other.column(name)) > 0.1, name
    assert np.abs(one.column("theta2_rad") - other.column("theta2_rad")).max() < np.radians(1.0)
