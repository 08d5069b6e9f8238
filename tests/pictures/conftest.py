"""Every figure that a test of pictures makes can be read: `text_layout` says what it looks for."""

from collections.abc import Iterator

import pytest
from matplotlib.figure import Figure
from text_layout import unreadable


@pytest.fixture(autouse=True)
def every_figure_is_readable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Keeps the figures that a test makes and looks at each when the test is over."""
    made: list[Figure] = []
    original = Figure.__init__

    def init(self: Figure, *args: object, **words: object) -> None:
        original(self, *args, **words)
        made.append(self)

    monkeypatch.setattr(Figure, "__init__", init)
    yield
    monkeypatch.undo()
    found = [line for figure in made for line in unreadable(figure)]
    assert not found, "\n".join(dict.fromkeys(found))
