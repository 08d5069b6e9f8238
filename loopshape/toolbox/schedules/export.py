"""A schedule out to the target: JSON (`loopshape-schedule/1`), or a C99 header that is C++ too.

Both hold six coefficients of each section at each node; what runs between is their linear interpolation over the
fourth, as `loopshape.toolbox.schedules.kernel` has it, operation for operation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.data.control.scheduled import Scheduled
from loopshape.toolbox.formats.controllers.controller_words import comment, identifier
from loopshape.toolbox.schedules.gain_scheduled import GainScheduled

FORMAT = "loopshape-schedule/1"
FORM = "direct form I, coefficients interpolated over a0"

_C = """
typedef struct {{
    double at[{v}];       /* where the coefficients stand, behind the lag */
    double c[{n}][5];     /* b0, b1, b2, a1, a2 of now */
    double past[{n1}][2]; /* the last two signals in front of and behind each section */
    int started;
}} {name}_state;

/* To rest. */
static inline void {name}_reset({name}_state *state)
{{
    int k;
    for (k = 0; k < {n1}; k++) {{
        state->past[k][0] = 0.0;
        state->past[k][1] = 0.0;
    }}
    state->started = 0;
}}

/* The coefficients at state->at. */
static inline void {name}_interpolate({name}_state *state)
{{
    int below[{v}], v, k, j, corner;
    double share[{v}], six[{n}][6];
    for (v = 0; v < {v}; v++) {{
        const double *knots = {name}_knots[v];
        const int last = {name}_counts[v] - 1;
        below[v] = 0;
        share[v] = 0.0;
        if (last > 0 && state->at[v] > knots[0]) {{
            while (below[v] < last - 1 && state->at[v] >= knots[below[v] + 1]) {{
                below[v]++;
            }}
            share[v] = (state->at[v] - knots[below[v]]) / (knots[below[v] + 1] - knots[below[v]]);
            share[v] = share[v] > 1.0 ? 1.0 : share[v];
        }}
    }}
    for (k = 0; k < {n}; k++) {{
        for (j = 0; j < 6; j++) {{
            six[k][j] = 0.0;
        }}
    }}
    for (corner = 0; corner < (1 << {v}); corner++) {{
        double weight = 1.0;
        int node = 0;
        for (v = 0; v < {v}; v++) {{
            const int up = (corner >> v) & 1, last = {name}_counts[v] - 1;
            const int knot = below[v] + up < last ? below[v] + up : last;
            weight *= up ? share[v] : 1.0 - share[v];
            node = node * {name}_counts[v] + knot;
        }}
        if (weight > 0.0) {{
            for (k = 0; k < {n}; k++) {{
                for (j = 0; j < 6; j++) {{
                    six[k][j] += weight * {name}_nodes[node][k][j];
                }}
            }}
        }}
    }}
    for (k = 0; k < {n}; k++) {{
        state->c[k][0] = six[k][0] / six[k][3];
        state->c[k][1] = six[k][1] / six[k][3];
        state->c[k][2] = six[k][2] / six[k][3];
        state->c[k][3] = six[k][4] / six[k][3];
        state->c[k][4] = six[k][5] / six[k][3];
    }}
}}

/* One sample: the error and the scheduling variables in, the control out. */
static inline double {name}_step({name}_state *state, double value, const double *variables)
{{
    int v, k, moved = !state->started;
    for (v = 0; v < {v}; v++) {{
        const double step = state->started ? variables[v] - state->at[v] : 0.0;
        state->at[v] = state->started ? state->at[v] + {UPPER}_SHARE * step : variables[v];
        moved = moved || step != 0.0;
    }}
    state->started = 1;
    if (moved) {{
        {name}_interpolate(state);
    }}
    for (k = 0; k < {n}; k++) {{
        const double *c = state->c[k];
        double out = c[0] * value + c[1] * state->past[k][0] + c[2] * state->past[k][1];
        out -= c[3] * state->past[k + 1][0] + c[4] * state->past[k + 1][1];
        state->past[k][1] = state->past[k][0];
        state->past[k][0] = value;
        value = out;
    }}
    state->past[{n}][1] = state->past[{n}][0];
    state->past[{n}][0] = value;
    return value;
}}
"""


def schedule_json(one: GainScheduled) -> dict[str, Any]:
    """The JSON object of a schedule; numbers read back exactly."""
    return {
        "format": FORMAT,
        "made_by": f"loopshape {__version__}",
        "loop": one.loop,
        "rate_hz": float(one.rate_hz),
        "form": FORM,
        "lag_s": one.lag_s,
        "share": one.share,
        "variables": [
            {"name": v.name, "loop": v.loop, "follows": v.follows.value, "knots": list(v.knots)} for v in one.variables
        ],
        "nodes": [{"at": at, "sections": rows} for at, rows in zip(one.nodes, one.coefficients.tolist(), strict=True)],
    }


def schedule_c(one: GainScheduled) -> str:
    """The header of a schedule: tables, a state, a reset and a step function."""
    name, n = identifier(one.loop), one.coefficients.shape[1]
    names = ", ".join(comment(v.name) for v in one.variables)
    notes = [
        f"Loop {comment(one.loop)} at {float(one.rate_hz)!r} Hz, a schedule; made by loopshape {__version__}.",
        f"{FORM}; the variables act behind a lag of {one.lag_s!r} s.",
        f"Variables, in this order: {names}; outside the knots the edge holds.",
        "No allocation, no library. The output has no limit and there is no anti-windup: both belong to the caller.",
    ]
    head = "\n".join(f" * {line}" for line in notes)
    words = {"name": name, "UPPER": name.upper(), "n": n, "n1": n + 1, "v": len(one.variables)}
    return (
        f"/*\n{head}\n */\n#ifndef {name.upper()}_H\n#define {name.upper()}_H\n\n"
        f"{_tables(one, name)}{_C.format(**words)}\n#endif\n"
    )


def _tables(one: GainScheduled, name: str) -> str:
    most, nodes = max(one.shape), len(one.controllers)
    knots = ",\n".join(f"    {{ {', '.join(map(repr, v.knots))} }}" for v in one.variables)
    rows = []
    for at, sections in zip(one.nodes, one.coefficients.tolist(), strict=True):
        inner = ",\n".join(f"        {{ {', '.join(map(repr, row))} }}" for row in sections)
        rows.append(f"    /* {comment(', '.join(f'{k} {v:g}' for k, v in at.items()))} */\n    {{\n{inner}\n    }}")
    listed = ",\n".join(rows)
    return (
        f"#define {name.upper()}_RATE_HZ {float(one.rate_hz)!r}\n#define {name.upper()}_SHARE {one.share!r}\n\n"
        f"static const int {name}_counts[{len(one.variables)}] = {{ {', '.join(map(str, one.shape))} }};\n"
        f"static const double {name}_knots[{len(one.variables)}][{most}] = {{\n{knots}\n}};\n\n"
        "/* b0, b1, b2, a0, a1, a2 of each section at each node, the last variable fastest */\n"
        f"static const double {name}_nodes[{nodes}][{one.coefficients.shape[1]}][6] = {{\n{listed}\n}};\n"
    )


#: format -> ending of the file, and its content
WRITERS: dict[str, tuple[str, Callable[[GainScheduled], str | dict[str, Any]]]] = {
    "json": (".json", schedule_json),
    "c": (".h", schedule_c),
}


def schedule_file(one: Scheduled, to: str) -> tuple[str, str | dict[str, Any]]:
    """Name and content of a schedule's file; refuses a format that has no schedules."""
    if to not in WRITERS:
        raise WrongUseError("a schedule is not written in every format", repr(to), f"use {' or '.join(WRITERS)}")
    ending, write = WRITERS[to]
    assert isinstance(one, GainScheduled)
    return f"{identifier(one.loop)}{ending}", write(one)
