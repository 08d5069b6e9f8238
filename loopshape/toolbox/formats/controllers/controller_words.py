"""What exported controllers have in common: a safe name, safe comments, what files say of them, and how they run."""

from __future__ import annotations

import re
from collections.abc import Sequence
from hashlib import sha256

import numpy as np
from numpy.typing import ArrayLike

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
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


def step(controller: Controller, inputs: ArrayLike) -> np.ndarray:
    """Outputs (n,) of inputs (n,) from rest, bit for bit those of the exported step function in C.

    Floating point: float64, or float32 with every operation rounded. Fixed point: inputs and outputs are whole numbers
    (int64), in the target's own unit, clipped to `signal_limit`. Plain Python, for comparison alone:
    a compiler that contracts a product and a sum rounds once less.
    """
    form, given = controller.number_format, np.asarray(inputs)
    if given.ndim != 1:
        raise WrongUseError("a controller steps through one signal (n,)", f"an array {given.shape}")
    if not form.fixed:
        dtype = np.float32 if form.name == "single" else np.float64
        return run_floating(controller.biquads(), np.asarray(given, dtype=dtype), dtype)
    if given.dtype.kind not in "iu":
        raise WrongUseError(
            f"a controller in {form.name} answers to whole numbers", str(given.dtype), "scale and round the signal"
        )
    sections = controller.biquads()
    feedback = [error_feedback(a1, a2) for *_, a1, a2 in sections.tolist()]
    out = _run_fixed(
        form.integers(sections), feedback, given.tolist(), form.fraction_bits, form.signal_limit
    )  # fmt: skip
    return np.array(out, dtype=np.int64)


def run_floating(sections: Array, inputs: Array, dtype: type[np.floating]) -> np.ndarray:
    """Outputs (n,) of direct form II transposed from rest; every operation rounds to `dtype`."""
    rows = [list(row) for row in sections.astype(dtype)]
    zero = dtype(0.0)
    states = [[zero, zero] for _ in rows]
    out = np.empty(inputs.size, dtype=dtype)
    with np.errstate(all="ignore"):  # as in C, what is too large is infinite
        for k, value in enumerate(inputs.astype(dtype)):
            for (b0, b1, b2, a1, a2), s in zip(rows, states, strict=True):
                answer = b0 * value + s[0]
                s[0] = (b1 * value - a1 * answer) + s[1]
                s[1] = b2 * value - a2 * answer
                value = answer
            out[k] = value
    return out


def error_feedback(a1: float, a2: float) -> tuple[int, int]:
    """How a section's rounding error goes back into its two states: the whole numbers nearest to -a1 and -a2.

    The error then reaches the output through (1 - e1/z - e2/z²)/(1 + a1/z + a2/z²), about 1 at low frequencies, and
    an integrator loses nothing (Thong and Liu, IEEE Trans. ASSP 25, 1977). Without it the error of a slow section is
    multiplied by 1/(1 + a1 + a2), and an integrator stands still at small inputs.
    """
    return round(-a1), round(-a2)


def _run_fixed(
    sections: Sequence[Sequence[int]],
    feedback: Sequence[tuple[int, int]],
    inputs: Sequence[int],
    fraction_bits: int,
    limit: int,
) -> list[int]:
    """Integer outputs of integer inputs, from rest: direct form II transposed with error feedback.

    Coefficients are integers times 2^-fraction_bits, states have the unit of a signal times that. A section's output
    is rounded to the nearest integer (halves upwards) and, as the input, clipped to `limit`.
    """
    states = [[0, 0] for _ in sections]
    half, out = 1 << (fraction_bits - 1), []
    for sample in inputs:
        value = min(max(int(sample), -limit), limit)
        for (b0, b1, b2, a1, a2), (e1, e2), s in zip(sections, feedback, states, strict=True):
            exact = b0 * value + s[0]
            answer = (exact + half) >> fraction_bits
            rest = exact - (answer << fraction_bits)
            if abs(answer) > limit:
                answer, rest = (limit if answer > 0 else -limit), 0
            s[0] = b1 * value - a1 * answer + e1 * rest + s[1]
            s[1] = b2 * value - a2 * answer + e2 * rest
            value = answer
        out.append(value)
    return out
