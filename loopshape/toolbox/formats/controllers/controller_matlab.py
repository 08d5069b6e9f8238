"""A controller as a MATLAB function that gives second-order sections, a gain, and a tf; and as a Simulink subsystem."""

from __future__ import annotations

from itertools import pairwise
from math import prod

from loopshape.data.control.controller import Controller
from loopshape.toolbox.formats.controllers.controller_words import about, block_words, identifier

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


_SIMULINK = """%{name} Builds a model with the controller as a subsystem of discrete blocks.
% Run it in MATLAB with Simulink, then copy the subsystem into your model. Sample time {period} s, from rest.
%
{about}
model = '{name}_model';
new_system(model); open_system(model);
path = [model '/{name}'];
add_block('simulink/Ports & Subsystems/Subsystem', path);
delete_line(path, 'In1/1', 'Out1/1');
add_block('simulink/Math Operations/Gain', [path '/gain'], 'Gain', '{gain}');
{blocks}
{lines}
"""


def simulink_text(controller: Controller) -> str:
    """A script that builds the sections as blocks `Discrete Transfer Fcn` in series; a delay is one block more."""
    name, sections = identifier(controller.loop), controller.biquads().tolist()
    pairs = list(zip(controller.blocks, sections, strict=True))
    period = f"1/{float(controller.rate_hz)!r}"
    made = [
        f"add_block('simulink/Discrete/Discrete Transfer Fcn', [path '/s{k}'], 'Numerator', '[{b0!r} {b1!r} {b2!r}]', "
        f"'Denominator', '[1 {a1!r} {a2!r}]', 'SampleTime', '{period}');  % {block_words(block)}"
        for k, (block, (b0, b1, b2, a1, a2)) in enumerate(((b, s) for b, s in pairs if b.kind != "gain"), start=1)
    ]
    names = ["In1", "gain", *(f"s{k}" for k in range(1, len(made) + 1)), "Out1"]
    if controller.computation_delay_s:
        made.append(
            "add_block('simulink/Continuous/Transport Delay', [path '/delay'], 'DelayTime', "
            f"'{float(controller.computation_delay_s)!r}');"
        )
        names.insert(-1, "delay")
    return _SIMULINK.format(
        name=name, period=period, about="\n".join(f"% {line}" for line in about(controller)),
        gain=repr(prod(row[0] for block, row in pairs if block.kind == "gain")), blocks="\n".join(made),
        lines="\n".join(f"add_line(path, '{a}/1', '{b}/1');" for a, b in pairwise(names)),
    )  # fmt: skip
