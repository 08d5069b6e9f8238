"""What all tests need: the folder of shared data, and an eye on their pictures.

Every PNG that a test writes must be readable: `text_layout` says what it looks for.
"""

import os
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir
from matplotlib.figure import Figure
from text_layout import look_at_each_png, unreadable

# the same examples in every run, and no folder .hypothesis at the root, which pytest would look into
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")
set_hypothesis_home_dir(Path(__file__).resolve().parents[1] / ".pytest_cache" / "hypothesis")

UNREADABLE: list[str] = []
look_at_each_png(UNREADABLE.extend)


@pytest.fixture(autouse=True)
def every_png_is_readable():
    yield
    found = list(dict.fromkeys(UNREADABLE))
    UNREADABLE.clear()
    assert not found, "\n".join(found)


@pytest.fixture
def every_figure_is_readable(monkeypatch):
    """Keeps the figures that a test makes, written or not, and looks at each when the test is over."""
    made, original = [], Figure.__init__

    def init(self, *args, **words):
        original(self, *args, **words)
        made.append(self)

    monkeypatch.setattr(Figure, "__init__", init)
    yield
    monkeypatch.undo()
    found = [line for figure in made for line in unreadable(figure)]
    assert not found, "\n".join(dict.fromkeys(found))


@pytest.fixture(autouse=True)
def every_figure_of_a_test_of_pictures_is_readable(request):
    """For every test in a folder `pictures`."""
    if request.path.parent.name == "pictures":
        request.getfixturevalue("every_figure_is_readable")


@pytest.fixture(scope="session")
def shared():
    """Folder of the shared data: LOOPSHAPE_SHARED, else ../shared beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("LOOPSHAPE_SHARED", beside))
    if not folder.is_dir():
        pytest.skip("the shared data are not here: set LOOPSHAPE_SHARED to their folder")
    return folder
