"""Same experiments and seeds, same recordings bit for bit, however many threads run them."""

import numpy as np
import pytest

from loopshape.toolbox.arm.source import EQUILIBRIA


@pytest.fixture(scope="module")
def campaign(arm_experiment):
    near = [(0.9 * theta, p) for theta, p in EQUILIBRIA[:8]]
    return [arm_experiment(a, 1500, setpoint=b, seed=k) for k, (a, b) in enumerate(zip(near, EQUILIBRIA, strict=False))]


def same(ours, theirs):
    return [np.array_equal(ours.columns[name], theirs.columns[name]) for name in ours.columns]


def test_one_and_two_threads_record_the_same_bits(arm, campaign):
    one, two = (arm.simulate(campaign, threads=n, states=True) for n in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert a.info == b.info
        assert set(a.columns) == set(b.columns)
        assert all(same(a, b))


def test_an_experiment_does_not_depend_on_its_neighbours(arm, campaign):
    together = arm.simulate(campaign)
    for k in (0, 3, 7):
        assert all(same(arm.simulate([campaign[k]])[0], together[k]))


def test_asking_for_states_changes_no_measured_bit(arm, campaign):
    (plain,), (more,) = (arm.simulate(campaign[:1], states=s) for s in (False, True))
    assert all(same(plain, more))
    assert len(more.columns) == len(plain.columns) + 5


def test_another_seed_gives_other_noise_and_the_same_kind_of_motion(arm, arm_experiment):
    one, other = arm.simulate([arm_experiment((9.0, 1.0), 1500, setpoint=(10.0, 1.0), seed=s) for s in (1, 2)])
    different = one.column("p_a_bar") != other.column("p_a_bar")
    assert np.mean(different) > 0.5  # noise of 2 converter steps
    assert np.abs(one.column("theta2_rad") - other.column("theta2_rad")).max() < np.radians(1.0)
