"""Curves of the page of `shape` that differ in colour alone are told apart by everybody, in light and dark."""

import re
from itertools import combinations

import numpy as np
import pytest
from colour_vision import VISION, apart, lab_of

from loopshape.toolbox.pages.shape.payload import STYLE, resource

#: drawn in unbroken lines. What else has a colour has a second mark: B and 0 dB are dashed, a handle is a circle with
#: a letter, a verdict has a sign and a word
UNBROKEN = ("point", "worst", "chosen", "limit")
#: of CIEDE2000: neighbours in a map's key are told apart at sight from about 10 on
TOLD = 14.0


def palettes() -> dict[str, dict[str, str]]:
    light, dark = resource(STYLE).split("@media (prefers-color-scheme: dark)")[:2]
    words = {"light": light, "dark": dark.split("* { box-sizing")[0]}
    return {name: dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", text)) for name, text in words.items()}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("vision", VISION)
def test_unbroken_lines_of_two_colours_are_told_apart(scheme: str, vision: str) -> None:
    colours = palettes()[scheme]
    near = {
        (one, other): round(apart(lab_of(colours[one], vision), lab_of(colours[other], vision)), 1)
        for one, other in combinations(UNBROKEN, 2)
    }
    assert {pair: far for pair, far in near.items() if far < TOLD} == {}


@pytest.mark.parametrize(
    ("one", "other", "far"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.694), (23.0331, 14.973, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_measure_is_that_of_its_published_pairs(
    one: tuple[float, ...], other: tuple[float, ...], far: float
) -> None:
    """Table 1 of Sharma, Wu and Dalal 2005."""
    assert apart(np.array(one), np.array(other)) == pytest.approx(far, abs=5e-5)


def test_grey_stays_grey_to_everybody() -> None:
    for vision in VISION:
        assert np.abs(lab_of("#777777", vision)[1:]).max() < 0.5
