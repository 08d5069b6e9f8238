"""The page of `shape` in a cell of a notebook: the same script as an anywidget, its design as traits.

`controller` and `requirements` are the page's and Python's at once: what is moved in one is moved in the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import anywidget
import traitlets

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.verdict import Verdict
from loopshape.toolbox.pages.shape.payload import (
    SCRIPT,
    STYLE,
    ShapingSession,
    controller_from,
    controller_words,
    payload,
    requirement_words,
    requirements_from,
    resource,
)

Check = Callable[[Sequence[Controller], Sequence[Requirements]], Verdict]


def _synced(to_words: Any, from_words: Any) -> Any:
    """A trait of a noun, of several loops of a tuple, that travels to the page and back as words."""

    def sent(value: Any, _: Any) -> Any:
        return list(map(to_words, value)) if isinstance(value, tuple) else to_words(value)

    def heard(words: Any, _: Any) -> Any:
        return tuple(map(from_words, words)) if isinstance(words, list) else from_words(words)

    return traitlets.Any().tag(sync=True, to_json=sent, from_json=heard)


def _listed(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


class ShapeWidget(anywidget.AnyWidget):  # type: ignore[misc,unused-ignore]
    """Loops that are shaped by hand in a notebook's cell.

    `controller` and `requirements` follow the page, and the page follows them; `observe` tells of each change. Of
    several loops they are tuples, in the order of the loops. A controller of another loop or rate is refused: the lines
    of the page are of these.
    """

    _esm = f"{resource(SCRIPT)}\nexport default shapePage.default;\n"
    script = traitlets.Unicode().tag(sync=True)
    style = traitlets.Unicode().tag(sync=True)
    payload = traitlets.Dict().tag(sync=True)
    controller = _synced(controller_words, controller_from)
    requirements = _synced(requirement_words, requirements_from)

    def __init__(self, loops: Sequence[ShapingSession], title: str, version: str, check: Check) -> None:
        self._loops, self._check = tuple(loops), check
        controllers, required = (tuple(getattr(x, name) for x in loops) for name in ("controller", "requirements"))
        super().__init__(
            script=resource(SCRIPT), style=resource(STYLE),
            payload=payload(loops, title, version) | {"served": False, "saved": ""},
            controller=controllers if len(loops) > 1 else controllers[0],
            requirements=required if len(loops) > 1 else required[0],
        )  # fmt: skip

    @traitlets.validate("controller")
    def _of_these_loops(self, proposal: Mapping[str, Any]) -> Any:
        starts = [one.controller for one in self._loops]
        made = _listed(proposal["value"])
        if [(x.loop, x.rate_hz) for x in made] != [(x.loop, x.rate_hz) for x in starts]:
            own, other = (" and ".join(f"{x.loop!r} at {x.rate_hz:g} Hz" for x in each) for each in (starts, made))
            raise WrongUseError(
                f"this widget shapes loop {own}", f"a controller of {other}", "make a widget of its own by shape"
            )
        return proposal["value"]

    def check(self) -> Verdict:
        """What `check` says of the design as it is now."""
        return self._check(_listed(self.controller), _listed(self.requirements))
