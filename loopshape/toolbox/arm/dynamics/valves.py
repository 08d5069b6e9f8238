"""When the valves are open in a PWM period, with delays of opening and closing and pulses that reach into the next."""

from __future__ import annotations

import math

from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.dynamics.model import Valves, called, in_line
from loopshape.toolbox.arm.effect import effect_parameters as e

MOST_EDGES = 24
#: a schedule (16,): sign, opening and closing times of the present pulse and of the one before, of A and then of B,
#: in s from the period's start; then how many edges follow
SIGN, OPEN, CLOSE, STOP, LAST_SIGN, LAST_OPEN, LAST_CLOSE, LAST_STOP, EACH = 0, 1, 2, 3, 4, 5, 6, 7, 8


@in_line
def next_pulse(c: Array, s: Array, first: int, u: float, period_s: float, dead_zone: float) -> None:
    """Move a muscle's schedule on by a period whose command is u."""
    s[first + LAST_SIGN] = s[first + SIGN]
    s[first + LAST_OPEN] = s[first + OPEN] - period_s
    s[first + LAST_CLOSE] = s[first + CLOSE] - period_s
    s[first + LAST_STOP] = s[first + STOP] - period_s
    length = pwm.pulse_s(u, period_s, dead_zone)
    lost, closing = length == 0.0 or length < c[e.SHORTEST], c[e.CLOSING]
    if c[e.CURRENT] > 0.0 and not lost and length < period_s:  # a short pulse builds up less current, and less to decay
        lost = length < c[e.ALONE]
        closing += c[e.CURRENT] * math.log(1.0 - math.exp(-length / c[e.CURRENT]))
        closing = max(closing, c[e.OPENING] - length)
    s[first + OPEN] = c[e.OPENING]
    s[first + CLOSE] = length + closing
    s[first + STOP] = length
    if c[e.TRAVEL] > 0.0:
        lost = length <= c[e.OPENING] - c[e.WHOLE_LATE]
        s[first + STOP] = length + c[e.WHOLE_LATE]
    s[first + SIGN] = 0.0 if lost else (1.0 if u > 0.0 else -1.0)
    whole = s[first + LAST_CLOSE] > c[e.CLOSING] - 1e-9 and s[first + LAST_SIGN] == s[first + SIGN]
    if whole:  # a valve that was open to the period's end and goes on does not move
        s[first + LAST_CLOSE] = s[first + OPEN] + c[e.TRAVEL]


@called
def plan_period(c: Array, s: Array, edges: Array, u_a: float, u_b: float, period_s: float, dead_zone: float) -> int:
    """Move the schedule on and list in order the times at which an area changes or bends; gives their number."""
    next_pulse(c, s, 0, u_a, period_s, dead_zone)
    next_pulse(c, s, EACH, u_b, period_s, dead_zone)
    half = 0.5 * c[e.RAMP]
    n = 0
    for first in (0, EACH):
        for at in (first, first + LAST_SIGN):
            if s[at] != 0.0:
                for k in (1, 2):
                    n = put(edges, n, s[at + k] - half, period_s)
                    if half > 0.0:
                        n = put(edges, n, s[at + k] + half, period_s)
                if c[e.TRAVEL] > 0.0:
                    up = min(c[e.TRAVEL], s[at + 3] - s[at + 1])
                    n = put(edges, n, s[at + 1] + up, period_s)
                    n = put(edges, n, s[at + 2] + up / c[e.TRAVEL] * c[e.TRAVEL_BACK], period_s)
    return n


@in_line
def put(edges: Array, n: int, time_s: float, period_s: float) -> int:
    """Insert a time in order, if it lies inside the period."""
    if not 0.0 < time_s < period_s:
        return n
    k = n
    while k > 0 and edges[k - 1] > time_s:
        edges[k] = edges[k - 1]
        k -= 1
    edges[k] = time_s
    return n + 1


@in_line
def pulse_area(c: Array, opens: float, closes: float, stops: float, now: float) -> float:
    """Open area of one pulse at `now`: sharp, ramps centred on its edges, or an armature's travel.

    An armature sets out at `opens`, gets no further once the command `stops`, and goes back from `closes` on.
    """
    if c[e.TRAVEL] > 0.0:
        way = min((min(now, stops) - opens) / c[e.TRAVEL], 1.0)
        return max(way - max(now - closes, 0.0) / c[e.TRAVEL_BACK], 0.0)
    if c[e.RAMP] == 0.0:
        return 1.0 if opens <= now < closes else 0.0
    up = min(max((now - opens) / c[e.RAMP] + 0.5, 0.0), 1.0)
    return max(up - min(max((now - closes) / c[e.RAMP] + 0.5, 0.0), 1.0), 0.0)


@in_line
def area(c: Array, s: Array, first: int, side: float, now: float) -> float:
    """Open area 0..1 of a muscle's in (side 1) or out (side -1) valve at `now` s of the period."""
    total = 0.0
    if s[first + SIGN] == side:
        total += pulse_area(c, s[first + OPEN], s[first + CLOSE], s[first + STOP], now)
    if s[first + LAST_SIGN] == side:
        total += pulse_area(c, s[first + LAST_OPEN], s[first + LAST_CLOSE], s[first + LAST_STOP], now)
    return min(total, 1.0)


@in_line
def areas(c: Array, s: Array, now: float) -> Valves:
    """Open areas of in A, in B, out A, out B at `now` s of the period."""
    if c[e.LATE] == 0.0:
        a, b = now < s[CLOSE], now < s[EACH + CLOSE]
        return (
            1.0 if a and s[SIGN] > 0.0 else 0.0,
            1.0 if b and s[EACH + SIGN] > 0.0 else 0.0,
            1.0 if a and s[SIGN] < 0.0 else 0.0,
            1.0 if b and s[EACH + SIGN] < 0.0 else 0.0,
        )
    return area(c, s, 0, 1.0, now), area(c, s, EACH, 1.0, now), area(c, s, 0, -1.0, now), area(c, s, EACH, -1.0, now)
