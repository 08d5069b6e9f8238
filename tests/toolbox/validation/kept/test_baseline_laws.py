"""Laws of a comparison: with itself nothing changed; backwards, better is worse; its two parts add up."""

from bench_nouns import LIMITS
from hypothesis import given
from hypothesis import strategies as st
from verdict_cases import VALUES, checked, margins

from loopshape.toolbox.validation.kept.baseline import compare

OPPOSITE = {"better": "worse", "worse": "better", "unchanged": "unchanged"}
numbers = st.floats(-60.0, 60.0)
reaches = st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 20.0)) | st.none()


@st.composite
def points(draw):
    values = {limit.name: draw(numbers) for limit in LIMITS[:4]}
    spread = {name: draw(reaches) for name in values}
    intervals = {
        n: (values[n] - low, values[n] + high) for n, r in spread.items() if r is not None for low, high in [r]
    }
    return {"r1": margins(VALUES | values, intervals)}


@given(points(), st.sampled_from(["a", "b"]))
def test_with_itself_nothing_changed(point, data):
    found = compare([checked(point)], [checked(point, data=data)])
    assert found.outcome == "unchanged"
    assert all(change.change == 0.0 for change in found.margins)


@given(points(), points(), st.sampled_from(["a", "b"]))
def test_backwards_better_is_worse(one, other, data):
    there = compare([checked(one)], [checked(other, data=data)]).margins
    back = compare([checked(other, data=data)], [checked(one)]).margins
    for mine, theirs in zip(there, back, strict=True):
        assert mine.change == -theirs.change
        assert mine.outcome == OPPOSITE[theirs.outcome]
        if mine.interval is not None:
            low, high = theirs.interval
            assert abs(mine.interval[0] + high) < 1e-9
            assert abs(mine.interval[1] + low) < 1e-9


@given(points(), points())
def test_other_data_never_show_more_than_the_same(one, other):
    same = compare([checked(one)], [checked(other)])
    data = compare([checked(one)], [checked(other, data="b")])
    changed = {c.quantity for c in same.margins if c.outcome != "unchanged"}
    assert {c.quantity for c in data.margins if c.outcome != "unchanged"} <= changed


@given(points(), points(), points())
def test_the_parts_add_up_to_the_whole(before, across, now):
    """Before (data a, old controller) to across (data b, old controller) to now (data b, new controller)."""
    plant = compare([checked(before)], [checked(across, data="b")]).margins
    controller = compare([checked(across, data="b")], [checked(now, data="b")]).margins
    whole = compare([checked(before)], [checked(now, data="b")]).margins
    for first, second, both in zip(plant, controller, whole, strict=True):
        assert abs(first.change + second.change - both.change) < 1e-9
        assert second.common
        assert not first.common
