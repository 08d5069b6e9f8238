"""A controller as a C99 header that is C++ too: coefficients, a state, a reset and a step function.

The step function does what `step` of `controller_words` does, operation for operation, where the compiler
evaluates in the type of the operands (FLT_EVAL_METHOD 0) and does not contract a product and a sum (-ffp-contract=off).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from loopshape.data.control.controller import Controller
from loopshape.toolbox.formats.controllers.controller_words import about, block_words, error_feedback, identifier
from loopshape.toolbox.formats.controllers.limited import AntiWindup, LimitedLaw

_RESET = """/* To rest: the state of all sections becomes zero{also}. */
static inline void {name}_reset({name}_state *state)
{{
    int k;
    for (k = 0; k < {n}; k++) {{
        state->s[k][0] = {zero};
        state->s[k][1] = {zero};
    }}
{last}}}
"""
_FLOATING = """
typedef struct {{
    {kind} s[{n}][2];
}} {name}_state;

{reset}
/* One sample: the error in, the control out. */
static inline {kind} {name}_step({name}_state *state, {kind} value)
{{
    int k;
    for (k = 0; k < {n}; k++) {{
        const {kind} *c = {name}_coefficients[k];
        {kind} *s = state->s[k];
        const {kind} out = c[0] * value + s[0];
        s[0] = (c[1] * value - c[3] * out) + s[1];
        s[1] = c[2] * value - c[4] * out;
        value = out;
    }}
    return value;
}}
"""

_LIMITED = """
typedef struct {{
    {kind} s[{n}][2];
    {kind} last;
}} {name}_state;

{reset}
/* Takes over at an output within the limits without a bump: filters at rest at this error, the integrator there. */
static inline void {name}_start({name}_state *state, {kind} value, {kind} output)
{{
    int k;
    output = output > {high} ? {high} : output < {low} ? {low} : output;
    for (k = 0; k < {n}; k++) {{
        const {kind} *c = {name}_coefficients[k];
        {kind} *s = state->s[k];
        {kind} out = output;
        if (k < {first}) {{
            out = ((c[0] + c[1]) + c[2]) / (({one} + c[3]) + c[4]) * value;
        }} else if (k < {n} - 1) {{
            out = {zero};
        }}
        s[1] = c[2] * value - c[4] * out;
        s[0] = out - c[0] * value;
        value = out;
    }}
    state->last = output;
}}

/* One sample: the error in, the limited control out. */
static inline {kind} {name}_step({name}_state *state, {kind} value)
{{
    {kind} low = {low}, high = {high};
    {kind} driven, given, in[{n} + 1];
    int k;
{rate}    for (k = 0; k < {first}; k++) {{
        const {kind} *c = {name}_coefficients[k];
        {kind} *s = state->s[k];
        const {kind} out = c[0] * value + s[0];
        s[0] = (c[1] * value - c[3] * out) + s[1];
        s[1] = c[2] * value - c[4] * out;
        value = out;
    }}
    driven = {sign}value;
    in[{first}] = value;
    for (k = {first}; k < {n}; k++) {{
        value = {name}_coefficients[k][0] * value + state->s[k][0];
        in[k + 1] = value;
    }}
    given = value > high ? high : value < low ? low : value;
{anti_windup}    state->last = given;
    return given;
}}
"""
_RATE = """    if (state->last - {step} > low) {{
        low = state->last - {step};
    }}
    if (state->last + {step} < high) {{
        high = state->last + {step};
    }}
"""
_INTEGRATE = """{indent}for (k = {first}; k < {n}; k++) {{
{indent}    const {kind} *c = {name}_coefficients[k];
{indent}    {kind} *s = state->s[k];
{indent}    s[0] = (c[1] * in[k] - c[3] * in[k + 1]) + s[1];
{indent}    s[1] = c[2] * in[k] - c[4] * in[k + 1];
{indent}}}
"""
_BACK = """    (void)driven;
    in[{n}] = value + {share} * (given - value);
"""
_CONDITIONAL = """    if (!((value - given) * driven > {zero})) {{
{integrate}    }}
"""

_FIXED = """
/* What rounding leaves of a section's output, times these, goes into its two states: minus a1 and a2, rounded. */
static const int {name}_feedback[{n}][2] = {{
{feedback}
}};

typedef struct {{
    int64_t s[{n}][2];
}} {name}_state;

{reset}
/* One sample: the error in, the control out, both whole numbers in a unit of your choice. */
static inline int32_t {name}_step({name}_state *state, int32_t input)
{{
    const int64_t one = (int64_t)1 << {UPPER}_FRACTION_BITS;
    const int64_t limit = {UPPER}_SIGNAL_LIMIT;
    int64_t value = input;
    int k;
    if (value > limit) {{
        value = limit;
    }} else if (value < -limit) {{
        value = -limit;
    }}
    for (k = 0; k < {n}; k++) {{
        const {kind} *c = {name}_coefficients[k];
        const int *e = {name}_feedback[k];
        int64_t *s = state->s[k];
        const int64_t exact = c[0] * value + s[0];
        const int64_t up = exact + one / 2;
        int64_t out = up < 0 ? ~(~up >> {UPPER}_FRACTION_BITS) : up >> {UPPER}_FRACTION_BITS;
        int64_t rest = exact - out * one;
        if (out > limit) {{
            out = limit;
            rest = 0;
        }} else if (out < -limit) {{
            out = -limit;
            rest = 0;
        }}
        s[0] = c[1] * value - c[3] * out + e[0] * rest + s[1];
        s[1] = c[2] * value - c[4] * out + e[1] * rest;
        value = out;
    }}
    return (int32_t)value;
}}
"""

_SAID_FLOATING = (
    "No allocation, no library. Bit for bit as checked where products and sums are not contracted",
    "(-ffp-contract=off) and not evaluated in a wider type (FLT_EVAL_METHOD 0).",
    "The output has no limit and there is no anti-windup: both belong to the caller.",
)
_SAID_LIMITED = (
    *_SAID_FLOATING[:2],
    "The output stays from {low} to {high}, and changes by {rate} a second at most; anti-windup: {anti_windup}.",
    "The margins that were checked are those of the loop whose output is not limited.",
)
_SAID_FIXED = (
    "A coefficient is an integer times 2^-{N}. Signals are whole numbers in a unit of your choice, the same for input",
    "and output; states have that unit times 2^-{N}. Input and section outputs are clipped to +-{limit}, so that",
    "no sum leaves int64_t; a clipped signal is no longer what was checked. A section's output is rounded to the",
    "nearest unit, halves upwards: choose a unit so small that errors of a few of them do not matter.",
    "The output has no other limit and there is no anti-windup: both belong to the caller.",
)


def c_text(controller: Controller, law: LimitedLaw | None = None) -> str:
    """The header of a controller, with its limits."""
    form, name = controller.number_format, identifier(controller.loop)
    fixed = {"N": form.fraction_bits, "limit": form.signal_limit}
    notes = [line.format(**fixed) for line in _SAID_FIXED] if form.fixed else [*_SAID_FLOATING]
    if law is not None:
        stated = {field: getattr(law.limits, field) for field in ("low", "high", "rate", "anti_windup")}
        notes = [line.format(**stated) for line in _SAID_LIMITED]
    head = "\n".join(f" * {line}".rstrip() for line in [*about(controller), "", *notes])
    words = {"name": name, "UPPER": name.upper(), "n": len(controller.blocks), "kind": _kind(controller)}
    zero = "0" if form.fixed else "0.0f" if form.name == "single" else "0.0"
    words |= {"zero": zero, "feedback": _feedback(controller)}
    last = ("", "") if law is None else (", and the last output", f"    state->last = {zero};\n")
    words["reset"] = _RESET.format(also=last[0], last=last[1], **words)
    body = (_FIXED if form.fixed else _FLOATING).format(**words) if law is None else _limited(law, words)
    return (
        f"/*\n{head}\n */\n#ifndef {name.upper()}_H\n#define {name.upper()}_H\n\n"
        f"{_macros(controller)}\n{_coefficients(controller, law)}{body}\n#endif\n"
    )


def _kind(controller: Controller) -> str:
    form = controller.number_format
    if form.fixed:
        return "int32_t" if form.bits <= 32 else "int64_t"
    return "float" if form.name == "single" else "double"


def _macros(controller: Controller) -> str:
    form, upper = controller.number_format, identifier(controller.loop).upper()
    lines = ["#include <stdint.h>", ""] if form.fixed else []
    lines += [
        f"#define {upper}_RATE_HZ {float(controller.rate_hz)!r}",
        f"#define {upper}_SECTIONS {len(controller.blocks)}",
    ]
    if form.fixed:
        lines += [
            f"#define {upper}_FRACTION_BITS {form.fraction_bits}",
            f"#define {upper}_SIGNAL_LIMIT {form.signal_limit}",
        ]
    return "\n".join(lines) + "\n"


def _limited(law: LimitedLaw, words: dict[str, Any]) -> str:
    """State, reset, start and step of a controller whose output is limited."""
    single = law.controller.number_format.name == "single"
    limits = law.limits
    words |= {
        "first": len(law.order) - law.integrating,
        "one": "1.0f" if single else "1.0",
        "sign": "-" if law.turned else "",
    }
    words |= {name: _floating(getattr(limits, name), single) for name in ("low", "high")}
    words |= {"share": _floating(law.share, single), "step": _floating(law.step, single)}
    words["rate"] = _RATE.format(**words) if np.isfinite(limits.rate) else ""
    back = limits.anti_windup is AntiWindup.BACK_CALCULATION
    integrate = _INTEGRATE.format(indent=" " * (4 if back else 8), **words)
    words["anti_windup"] = (
        _BACK.format(**words) + integrate if back else _CONDITIONAL.format(integrate=integrate, **words)
    )
    return _LIMITED.format(**words)


def _coefficients(controller: Controller, law: LimitedLaw | None) -> str:
    """The table of coefficients, each row followed by the block that it comes from."""
    order = range(len(controller.blocks)) if law is None else law.order
    form, sections = controller.number_format, controller.biquads()[list(order)]
    if form.fixed:
        rows = [[_integer(v) for v in row] for row in form.integers(sections)]
    else:
        rows = [[_floating(v, form.name == "single") for v in row] for row in sections.tolist()]
    lines = [
        f"    /* {block_words(b)} */\n    {{ {', '.join(r)} }}"
        for b, r in zip((controller.blocks[k] for k in order), rows, strict=True)
    ]
    name = identifier(controller.loop)
    return (
        "/* b0, b1, b2, a1, a2 of (b0 + b1/z + b2/z^2)/(1 + a1/z + a2/z^2) */\n"
        f"static const {_kind(controller)} {name}_coefficients[{len(rows)}][5] = {{\n" + ",\n".join(lines) + "\n};\n"
    )


def _floating(value: float, single: bool) -> str:
    """The shortest decimal that reads back as the value itself."""
    return f"{np.float32(value)!s}f" if single else repr(value)


def _integer(value: int) -> str:
    """A literal; the least int32 has none of its own type."""
    return "-2147483647 - 1" if value == -(2**31) else f"INT64_C({value})" if abs(value) >= 2**31 else str(value)


def _feedback(controller: Controller) -> str:
    pairs = [error_feedback(row[3], row[4]) for row in controller.biquads().tolist()]
    return ",\n".join(f"    {{ {e1}, {e2} }}" for e1, e2 in pairs)
