"""A controller as a MATLAB function that gives second-order sections, a gain, and a tf on request."""

from __future__ import annotations

from math import prod

from loopshape.data.controller import Controller
from loopshape.io.controller_words import about, block_words, identifier

_TEXT = """function [sos, g, Ts, C, delay_s] = {name}()
%{upper} Second-order sections and gain of a controller.
%   [sos, g] = {name}() has a row [b0 b1 b2 1 a1 a2] for each block but the gains, whose product is g:
%   z = g*sosfilt(sos, e), from rest.
%   [sos, g, Ts, C] = {name}() gives the sample time in s and the tf object too (Control System Toolbox).
%   [sos, g, Ts, C, delay_s] = {name}() gives the computation's delay, which neither sos nor C contains.
%
{about}
%   Numbers here are doubles that hold the coefficients exactly; what runs in another precision also rounds signals.
sos = [
{rows}
];
g = {gain};
Ts = 1/{rate};
delay_s = {delay};
if nargout > 3
    C = tf(g, 1, Ts);
    for k = 1:size(sos, 1)
        C = C*tf(sos(k, 1:3), sos(k, 4:6), Ts);
    end
end
end
"""


def matlab_text(controller: Controller) -> str:
    """The function file of a controller, in ASCII; numbers read back exactly."""
    name, sections = identifier(controller.loop), controller.biquads().tolist()
    pairs = list(zip(controller.blocks, sections, strict=True))
    rows = [
        f"    {b0!r} {b1!r} {b2!r} 1 {a1!r} {a2!r}  % {block_words(block)}"
        for block, (b0, b1, b2, a1, a2) in pairs
        if block.kind != "gain"
    ]
    return _TEXT.format(
        name=name,
        upper=name.upper(),
        about="\n".join(f"%   {line}" for line in about(controller)),
        rows="\n".join(rows or ["    1 0 0 1 0 0"]),
        gain=repr(prod(row[0] for block, row in pairs if block.kind == "gain")),
        rate=repr(float(controller.rate_hz)),
        delay=repr(float(controller.computation_delay_s)),
    )
