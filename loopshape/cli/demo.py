"""`loopshape demo`."""


def demo() -> None:
    """Demo."""
