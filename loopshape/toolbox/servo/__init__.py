"""The servo axis by its numbers: one mass under a position controller: friction, perhaps a spring.

An experiment comes in, a recording goes out; what such an axis may hide is its catalogue of effects.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Toolbox

TOOLBOX = Toolbox(
    "servo",
    "The servo axis by its numbers: one mass under a position controller: friction, perhaps a spring",
    plants={"servo-axis": "loopshape.toolbox.servo.axis:ordinary_axis"},
)
