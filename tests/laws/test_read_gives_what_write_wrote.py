"""Whatever `ls.write` wrote `ls.read` gives back, field by field, on random draws of every noun."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from bench_nouns import Free
from conversions import TWO_PI

import loopshape as ls

RATE = 1000.0
F = np.geomspace(0.5, 200.0, 60)
SEEDS = pytest.mark.parametrize("seed", range(6))


def same(one, other, where=""):
    """Equal, field by field, item by item and bit by bit; NaN is NaN."""
    assert type(one) is type(other) or not is_dataclass(one), where
    if isinstance(one, ls.Margins):  # a mapping of all limits; what was not read is nan
        same(dict(one), dict(other), where)
        same(replace(one, readings={}).__dict__, replace(other, readings={}).__dict__, where)
    elif is_dataclass(one):
        for field in fields(one):
            same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, Mapping):
        assert list(one) == list(other), where
        for key, value in one.items():
            same(value, other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for k, pair in enumerate(zip(one, other, strict=True)):
            same(*pair, f"{where}[{k}]")
    else:
        np.testing.assert_equal(other, one, where)


def pick(rng, *choices):
    return choices[int(rng.integers(len(choices)))]


def points(rng, count=3):
    hz = np.cumsum(rng.uniform(0.5, 20.0, count))
    return tuple((float(f), float(level)) for f, level in zip(hz, rng.normal(0.0, 20.0, count), strict=True))


def template(rng):
    low = float(rng.uniform(0.1, 5.0))
    free = Free(low, 3.0 * low, pick(rng, None, 2.0 * low))
    bounded = replace(ls.gain(), parameters={"gain": free})
    return pick(rng, ls.gain(low), bounded, ls.lead_lag((low, 9.0 * low), 40.0), ls.notch(), ls.low_pass(order=1))


def mask(rng):
    return pick(rng, ls.Mask(pick(rng, "S", "T", "CS", "PS", "L"), points(rng)), ls.Mask("L", points(rng), "at_least"))


def weight(rng):
    fixed = (ls.gain(2.0), ls.lead_lag(3.0, 30.0))
    return ls.Weight(pick(rng, "S", "T", "CS", "PS"), pick(rng, float(rng.uniform(0.1, 9.0)), points(rng), fixed))


def requirements(rng, loop="x"):
    """Requirements of which every field is there in some draw."""
    asked = {"phase_margin_deg": 60.0, "gain_margin_db": 6.0, "disk_margin": 0.7, "bandwidth_hz": 3.0, "error_rms": 0.1}
    asked = {name: float(rng.uniform(0.5, 1.0)) * x for name, x in asked.items() if rng.random() < 0.6}
    weights = tuple(weight(rng) for _ in range(int(rng.integers(0, 3))))
    masks = tuple(mask(rng) for _ in range(int(rng.integers(0, 3))))
    if weights and rng.random() < 0.7:
        asked["weighted_norm"] = 1.5
    if masks and rng.random() < 0.5:
        asked[masks[0].quantity] = 1.25
    if rng.random() < 0.5:
        asked |= {"control_high_frequency_db": 20.0, "control_high_frequency_from_hz": 100.0}
    heavy = ls.AtPoints({"load_kg": (2.0, 5.0)}, {"phase_margin_deg": 31.5}, pick(rng, (), (mask(rng),)))
    return ls.Requirements(
        loop, **asked, masks=masks, weights=weights, at=pick(rng, (), (heavy,)), integrators=pick(rng, None, -1, 2),
        unstable_poles=pick(rng, None, 0, 1), structure=tuple(template(rng) for _ in range(int(rng.integers(0, 4)))),
        band_hz=pick(rng, None, (0.7, 150.0)),
        objective=pick(rng, ls.Objective(), ls.Objective(0.0, 1.0, 2.0), ls.Objective(0.3, 0.7, 1.5)),
    )  # fmt: skip


def controller(rng, loop="x"):
    own = (ls.gain(float(rng.uniform(0.2, 1.2))), ls.lead_lag(5.0, 40.0))
    return ls.controller(*own, rate_hz=RATE, loop=loop)


def plant(rng, loop="x", recording="r1"):
    """A lag with delay and noise of 1 %."""
    s = 1j * TWO_PI * F
    G = float(rng.uniform(5.0, 20.0)) / (s + 3.0) * np.exp(-0.002 * s)
    noise = rng.standard_normal((2, F.size)) @ np.eye(F.size) / 2**0.5
    made = ls.FRF.from_arrays(F, G * (1.0 + 0.01 * (noise[0] + 1j * noise[1])), relative_std=0.01, rate_hz=RATE)
    return replace(made, loop=loop, recording=recording, operating_point={"load_kg": float(rng.uniform(1.0, 9.0))})


def matrix(rng):
    """Two loops with some coupling."""
    one, two = plant(rng), plant(rng)
    G = np.stack([np.stack([one.siso, 0.1 * two.siso]), np.stack([0.05 * one.siso, two.siso])]).transpose(2, 0, 1)
    covariance = np.repeat(np.eye(4)[None] * 1e-6, F.size, axis=0).astype(complex)
    valid = np.ones(F.size, dtype=bool)
    return ls.FRF(F, G, covariance, valid, ("u_v", "w_v"), ("x_m", "y_m"), "drawn", "r1", "x+y", RATE)


@SEEDS
def test_requirements(tmp_path, seed):
    rng = np.random.default_rng(seed)
    one = requirements(rng)
    (back,) = ls.read(ls.write(one, tmp_path / "r.toml"))
    same(one, back)
    together = ls.Requirements(disk_margin=0.4, input_output_disk_margin=0.3, integrators=1, band_hz=(1.0, 50.0))
    every = [requirements(rng, "x"), requirements(rng, "y"), together]
    same(every, list(ls.read(ls.write(every, tmp_path / "all.toml"))))
    same(tuple(every[:2]), ls.read_requirements(tmp_path / "all.toml"))


def test_a_weight_that_is_a_function_has_no_file(tmp_path):
    R = ls.Requirements("x", weights=(ls.Weight("S", lambda f_hz: f_hz),))
    with pytest.raises(ls.errors.WrongUseError, match="no form in a file"):
        ls.write(R, tmp_path / "r.toml")
    with pytest.raises(ls.errors.WrongUseError, match="names of their loops"):
        ls.write(ls.Requirements(phase_margin_deg=40.0), tmp_path / "r.toml")
    with pytest.raises(ls.errors.WrongUseError, match=r"written as \.toml"):
        ls.write(ls.Requirements("x", phase_margin_deg=40.0), tmp_path / "r.json")
    assert not list(tmp_path.iterdir())


@SEEDS
def test_verdicts_on_one_loop_and_on_several(tmp_path, seed):
    rng = np.random.default_rng(seed)
    R = ls.Requirements("x", phase_margin_deg=40.0, disk_margin=0.6, bandwidth_hz=2.0, unstable_poles=0)
    one = ls.check([plant(rng), plant(rng, recording="r2")], controller(rng), R)
    own, together = [controller(rng), controller(rng, "y")], ls.Requirements(disk_margin=0.3, unstable_poles=0)
    both = ls.check(matrix(rng), own, [R], together=together)
    assert [x.loop for x in both.each] == ["x", "y"]
    assert len(both.controllers) == 2
    for found in (one, both):
        (back,) = ls.read(ls.write(found, tmp_path / "v.json"))
        same(found, back)
        assert back.to_dict() == found.to_dict()


def test_a_verdict_on_a_schedule(tmp_path):
    pytest.importorskip("loopshape.toolbox.schedules", reason="schedules are a toolbox")
    rng = np.random.default_rng(3)
    nodes = [{"load_kg": 1.0}, {"load_kg": 9.0}]
    C = ls.schedules.gain_scheduled([controller(rng), controller(rng)], nodes, {"load_kg": "load_kg"})
    found = ls.check(plant(rng), C, ls.Requirements("x", phase_margin_deg=40.0, unstable_poles=0))
    (back,) = ls.read(ls.write(found, tmp_path / "v.json"))
    same(found, back)


def test_a_verdict_made_by_hand_is_not_kept(tmp_path):
    with pytest.raises(ls.errors.WrongUseError, match="made by check"):
        ls.write(ls.Verdict("x", (), {"r1": ls.Margins({}, "stable")}), tmp_path / "v.json")


@SEEDS
def test_fits(tmp_path, seed):
    rng = np.random.default_rng(seed)
    orders = {"numerator": 0, "denominator": 1, "delay": True}
    made = [ls.fit(plant(rng, recording=name), "rational", **orders) for name in ("r1", "r2")]
    same(made, list(ls.read(ls.write(made, tmp_path / "fits.json"))))
    same((made[0],), ls.read(ls.write(made[0], tmp_path / "one.json")))


@SEEDS
def test_controllers(tmp_path, seed):
    rng = np.random.default_rng(seed)
    own = [controller(rng), controller(rng, "y")]
    same(own, list(ls.read(ls.write(own, tmp_path / "c.toml"))))


def test_profiles(tmp_path):
    known = ls.profiles()
    same(known, ls.read(ls.write(list(known.values()), tmp_path / "p.toml")))
    same({"servo": known["servo"]}, ls.read(ls.write(known["servo"], tmp_path / "one.toml")))


def test_every_file_says_its_version(tmp_path):
    rng = np.random.default_rng(1)
    P, C, R = plant(rng), controller(rng), requirements(rng)
    ls.write(C, tmp_path / "c.toml")
    ls.write(R, tmp_path / "r.toml")
    ls.write(ls.profiles()["servo"], tmp_path / "p.toml")
    ls.write(ls.check(P, C), tmp_path / "v.json")
    ls.write(ls.fit(P, "rational", numerator=0, denominator=1), tmp_path / "f.json")
    for path in tmp_path.iterdir():
        (first,) = [line for line in path.read_text().splitlines() if '"loopshape-' in line][:1]
        assert first.strip(' ",')[-1].isdigit(), path
