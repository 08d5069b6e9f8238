"""The page of `shape` in a cell of a notebook: the same script as an anywidget, its design as traits.

`controller` and `requirements` are the page's and Python's at once: what is moved in one is moved in the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import anywidget
import traitlets

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.verdict import Verdict
from loopshape.loop.verdict import check
from loopshape.view.page.page import SCRIPT, STYLE, resource
from loopshape.view.page.payload import (
    ShapingSession,
    controller_from,
    controller_words,
    payload,
    requirement_words,
    requirements_from,
)


def _synced(kind: type, to_words: Any, from_words: Any) -> Any:
    """A trait of a noun that travels to the page and back as words."""
    return traitlets.Instance(kind).tag(
        sync=True,
        to_json=lambda value, widget: to_words(value),
        from_json=lambda words, widget: from_words(words) if isinstance(words, Mapping) else words,
    )


class ShapeWidget(anywidget.AnyWidget):  # type: ignore[misc,unused-ignore]
    """A loop that is shaped by hand in a notebook's cell.

    `controller` and `requirements` follow the page, and the page follows them; `observe` tells of each change. A
    controller of another loop or rate is refused: the lines of the page are of this one.
    """

    _esm = f"{resource(SCRIPT)}\nexport default shapePage.default;\n"
    script = traitlets.Unicode().tag(sync=True)
    style = traitlets.Unicode().tag(sync=True)
    payload = traitlets.Dict().tag(sync=True)
    controller = _synced(Controller, controller_words, controller_from)
    requirements = _synced(Requirements, requirement_words, requirements_from)

    def __init__(self, one: ShapingSession, title: str, version: str) -> None:
        self._one = one
        super().__init__(
            script=resource(SCRIPT), style=resource(STYLE),
            payload=payload([one], title, version) | {"served": False, "saved": ""},
            controller=one.controller, requirements=one.requirements,
        )  # fmt: skip

    @traitlets.validate("controller")
    def _of_this_loop(self, proposal: Mapping[str, Any]) -> Controller:
        made: Controller = proposal["value"]
        start = self._one.controller
        if (made.loop, made.rate_hz) != (start.loop, start.rate_hz):
            raise WrongUseError(
                f"this widget shapes loop {start.loop!r} at {start.rate_hz:g} Hz",
                f"a controller of {made.loop!r} at {made.rate_hz:g} Hz", "make a widget of its own by shape",
            )  # fmt: skip
        return made

    def check(self) -> Verdict:
        """What `check` says of the design as it is now."""
        one = self._one
        return check(one.frfs, self.controller, one.of_plant(self.requirements), one.fits)
