"""What the files of an exported controller have in common: a safe name, safe comments, and what they say of it."""

from __future__ import annotations

import re
from hashlib import sha256

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Block, Controller

FORM = "direct form II transposed"
_LONGEST = 38  # with prefix and endings 63: so many letters of an identifier C99 tells apart, and MATLAB allows


def identifier(loop: str) -> str:
    """`controller_` and a loop's name in letters, digits and single underscores; other letters by their code point.

    Names of more than 38 characters are cut and end in a mark of the whole.
    """
    plain = "".join(c if c.isascii() else f"u{ord(c):04x}" for c in loop)
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")
    if not name:
        raise WrongUseError("a loop's name makes no identifier", repr(loop), "use letters and digits")
    if len(name) > _LONGEST:
        name = f"{name[: _LONGEST - 7].rstrip('_')}_{sha256(loop.encode()).hexdigest()[:6]}"
    return f"controller_{name}"


def comment(text: str) -> str:
    """A text in printable ASCII that ends no comment, begins none and continues no line, in C and in MATLAB."""
    return re.sub(r"[^ -~]|[*/\\?%{}]", lambda found: f"<{ord(found[0]):x}>", text)


def about(controller: Controller) -> list[str]:
    """What each file says of its controller, a line each."""
    c = controller
    lines = [f"Loop {comment(c.loop)} at {float(c.rate_hz)!r} Hz, digest {c.digest}; made by loopshape {__version__}."]
    lines.append(f"Coefficients in {c.precision}, {FORM}.")
    warped = f", exact at {c.prewarp_hz!r} Hz" if c.prewarp_hz is not None else ""
    lines.append(f"Discretised by Tustin's rule{warped}.")
    hold = "; a zero-order hold was added to the plant" if c.added_hold else ""
    lines.append(f"Checked with {c.computation_delay_s!r} s of computation delay beside the plant's own{hold}.")
    return lines


def block_words(block: Block) -> str:
    """A block in one line: kind and parameters, exactly."""
    return " ".join([block.kind, *(f"{name}={value!r}" for name, value in block.parameters.items())])
