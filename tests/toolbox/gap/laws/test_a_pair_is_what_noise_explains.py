"""What recordings that no fit saw leave decides between one effect, two, and none of the list."""

from types import SimpleNamespace

import pytest

from loopshape.toolbox.gap.diagnose.decide import decided, healthy_prior, probabilities
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.gap.tolerances import TOL

PAIRS = {"play@rail+friction@rail", "friction@rail+lag@belt"}
SEEN = {  # a cart with an effect that is in no list, as it was answered: a pair, though 37 of 397 floors are left
    "play@rail+friction@rail": 1.0 - 6e-11, "unknown": 5e-11, "friction@rail": 2e-13, "friction@rail+lag@belt": 1e-13,
    "none": 0.0,
}  # fmt: skip


def test_a_pair_that_leaves_more_than_noise_is_refuted_and_what_is_unlisted_stays_unknown():
    out = decided(SEEN, PAIRS, 397.0, {"play@rail+friction@rail": 37.0, "friction@rail": 178.0})
    assert next(iter(out)) == "unknown"
    leaves = TOL.wrong_form_leaves  # its other forms leave as much
    assert out["friction@rail"] / out["unknown"] == pytest.approx(leaves)
    assert sum(out.values()) == pytest.approx(1.0)


def test_a_second_effect_that_takes_up_what_a_form_leaves_gives_way_to_the_first():
    seen = SEEN | {"friction@rail": 4e-11, "unknown": 2e-11}
    out = decided(seen, PAIRS, 467.0, {"play@rail+friction@rail": 41.0, "friction@rail": 80.0})
    assert next(iter(out)) == "friction@rail"
    assert out["unknown"] > 0.2  # what is left is not hidden
    assert sum(out.values()) == pytest.approx(1.0)


def test_a_pair_that_leaves_only_noise_stays_and_is_no_surer_than_a_wrong_form_allows():
    out = decided(SEEN, PAIRS, 397.0, {"play@rail+friction@rail": 0.6, "friction@rail": 178.0})
    assert list(out)[:2] == ["play@rail+friction@rail", "friction@rail"]
    assert out["play@rail+friction@rail"] == pytest.approx(1.0 / (1.0 + TOL.wrong_form_pairs))
    assert sum(out.values()) == pytest.approx(1.0)


def test_a_single_form_may_leave_a_little_and_no_more():
    seen = {"friction@rail": 0.9, "unknown": 0.1, "none": 0.0}
    assert decided(seen, PAIRS, 100.0, {"friction@rail": 15.0}) == seen
    assert next(iter(decided(seen, PAIRS, 100.0, {"friction@rail": 30.0}))) == "unknown"


def test_what_names_no_effect_is_left_as_it_is():
    for seen in ({"none": 0.9, "friction@rail": 0.1}, {"unknown": 0.6, "friction@rail": 0.4}):
        assert decided(seen, PAIRS, 2.0, {"friction@rail": 2.0}) == seen


def test_unknown_by_many_recordings_is_no_surer_than_a_wrong_form_allows():
    out = decided({"unknown": 1.0 - 1e-12, "friction@rail": 1e-12, "none": 0.0}, PAIRS, 90.0, {"friction@rail": 60.0})
    assert out["friction@rail"] / out["unknown"] == pytest.approx(TOL.wrong_form_leaves)
    assert out["none"] == 0.0


@pytest.mark.parametrize("count", [2, 20, 200])
def test_a_machine_where_no_effect_explains_anything_is_healthy_however_many_effects_there_are(count):
    effects = tuple(
        EffectForm(f"kind{k}@rail", "form", "rail", "N", (), {}, {}, 1.0, (0.0, 1.0), "") for k in range(count)
    )
    plant = SimpleNamespace(effects=effects, calibrated=False)
    prices = {"none": -healthy_prior(plant)} | dict.fromkeys([f.effect for f in effects], TOL.one_effect)
    assert probabilities(prices)["none"] >= 0.5 - 1e-9
