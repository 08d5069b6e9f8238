"""loopshape: from closed-loop recordings of a motion system to a tuned, checked controller."""

__version__ = "0.1.0"
