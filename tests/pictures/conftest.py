"""Every figure that a test of pictures makes can be read: `text_layout` says what it looks for."""

import pytest


@pytest.fixture(autouse=True)
def each_is_looked_at(every_figure_is_readable):
    """For every test of this folder."""
