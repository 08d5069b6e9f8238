"""A controller as a filter file of the LIGO control system (foton): one module, its first filter.

    MODULE 0 21 SECTIONS 0 0 NAME GAIN a1 a2 b1 b2
                                       a1 a2 b1 b2        one line a further section

H = GAIN prod (1 + b1/z + b2/z²)/(1 + a1/z + a2/z²); a filter holds at most ten sections.
"""

from __future__ import annotations

from math import prod

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.toolbox.formats.controllers.controller_words import about, identifier

_MOST_SECTIONS = 10
_RULE = "#" * 80
_TEXT = """# FILTERS FOR ONLINE SYSTEM
#
{about}
#
# MODULES {module}
#
{rule}
### {module:<72} ###
{rule}
# SAMPLING {module} {rate}
###                                                                          ###
{rows}
"""


def foton_text(controller: Controller) -> str:
    """The filter file of a controller. Refuses a rate that is no whole number, more sections than a filter holds, and
    one that begins with a pure delay.
    """
    module = identifier(controller.loop).removeprefix("controller_").upper()
    sections = [row for row in controller.biquads().tolist()]
    gains = [row[0] for row in sections]
    moving = [row for row in sections if any(row[1:])] or [[1.0, 0.0, 0.0, 0.0, 0.0]]
    if not float(controller.rate_hz).is_integer() or len(moving) > _MOST_SECTIONS or not all(gains):
        raise WrongUseError(
            f"the controller of loop {controller.loop!r} does not fit into a filter of foton",
            f"{controller.rate_hz:g} Hz, {len(moving)} sections",
            f"use a whole rate, at most {_MOST_SECTIONS} blocks besides gains, and none whose first coefficient is 0",
        )  # fmt: skip
    tails = [f"{a1!r} {a2!r} {b1 / b0!r} {b2 / b0!r}" for b0, b1, b2, a1, a2 in moving]
    first = f"{module} 0 21 {len(moving)} 0 0 {controller.digest} {prod(gains)!r} {tails[0]}"
    return _TEXT.format(
        about="\n".join(f"# {line}" for line in about(controller)), module=module, rule=_RULE,
        rate=int(controller.rate_hz), rows="\n".join([first, *tails[1:]]),
    )  # fmt: skip
