"""Point-to-point trials of the arm under nine actions, and what a learner sees of them: no learning library here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from arm_stepper import SteppedArm

from loopshape.core.units import Array, deg
from loopshape.toolbox.arm.source import value

#: valves of A and B: -1 lets air out, 0 shuts both, +1 lets air in; what an arm with on/off valves can be told
ACTIONS = tuple((float(a), float(b)) for a in (-1, 0, 1) for b in (-1, 0, 1))
HOLD, UP, DOWN = (ACTIONS.index(u) for u in ((0.0, 0.0), (1.0, -1.0), (-1.0, 1.0)))
STATES = int(value("learning.states"))
LIMIT = int(value("learning.limit"))

#: setpoint in deg over time in s
Setpoint = Callable[[float], float]
#: what is seen (trials, `Rules.seen`) to places in `ACTIONS` (trials,)
Policy = Callable[[Array], Array]


@dataclass(frozen=True)
class Rules:
    """What a trial is (`[trial]`) and what it pays (`[reward]`)."""

    action_s: float
    p_ab_bar: float
    widest_deg: float
    least_move_deg: float
    tolerance_deg: float
    held_s: float
    stay_s: float
    look_s: float
    moves_deg: float
    per_deg: float
    inside: float
    left_range: float
    may_hold: bool = True  # without it eight actions: some valve is always open
    states: int = STATES

    @property
    def actions(self) -> tuple[int, ...]:
        """What may be done, as places in `ACTIONS`."""
        return tuple(k for k in range(len(ACTIONS)) if self.may_hold or k != HOLD)

    @property
    def seen(self) -> int:
        """Size of what is seen."""
        return 3 * self.states + 1

    @property
    def limit_s(self) -> float:
        """Time after which the source breaks a trial off."""
        return LIMIT * self.action_s


class Trial:
    """An arm on its way to a setpoint: what is seen, done and paid, action by action."""

    def __init__(self, rules: Rules, changes: Mapping[str, float] | None = None) -> None:
        self.rules = rules
        self.arm = SteppedArm(rules.action_s, changes)

    def start(self, start_deg: float, setpoint_deg: float, seed: int) -> Array:
        """At rest, seen as if it had always been."""
        row = self.arm.start(start_deg, self.rules.p_ab_bar, seed)
        self.history = np.tile(row, (self.rules.states, 1))
        self.setpoint_deg = setpoint_deg
        return self.seen()

    def seen(self) -> Array:
        """The setpoint's distance from the latest three angles, their pressures, and the setpoint; all of order 1."""
        away = (self.setpoint_deg - deg(self.history[:, 0])) / 10.0
        pressures = (1e-5 * self.history[:, 1:] - 0.5) / 0.3
        return np.concatenate([away, pressures.ravel(), [self.setpoint_deg / self.rules.widest_deg]])

    def act(self, action: int) -> tuple[bool, Array]:
        """One of the nine: whether the arm is still in range, and the rows measured meanwhile."""
        fine, rows = self.arm.act(*ACTIONS[action])
        self.history = np.concatenate([self.history[1:], self.arm.row[None]])
        return fine, rows

    def paid(self, fine: bool) -> float:
        """Reward of the latest action."""
        if not fine:
            return self.rules.left_range
        away = abs(self.setpoint_deg - float(deg(self.history[-1, 0])))
        return self.rules.per_deg * away + (self.rules.inside if away <= self.rules.tolerance_deg else 0.0)


@dataclass(frozen=True, eq=False)
class Trace:
    """One trial at 1 kHz: setpoint and measured angle in deg, pressures in bar, edges of the valves, range left."""

    setpoint_deg: Array
    theta2_deg: Array
    pressures_bar: Array
    edges: Array  # number of openings and closings at each tick
    left_range: bool


def start_for(setpoint_deg: float, rules: Rules, rng: np.random.Generator) -> float:
    """A starting angle in deg, even over those that are far enough from the setpoint."""
    while True:
        start = float(rng.uniform(-rules.widest_deg, rules.widest_deg))
        if abs(start - setpoint_deg) >= rules.least_move_deg:
            return start


def pairs(rules: Rules, count: int, seed: int) -> list[tuple[float, float]]:
    """Fixed trials (start, setpoint) in deg, the setpoints evenly over the range."""
    rng = np.random.default_rng(seed)
    setpoints = np.linspace(-rules.widest_deg, rules.widest_deg, count).tolist()
    return [(start_for(s, rules, rng), s) for s in setpoints]


def play(
    policy: Policy,
    rules: Rules,
    trials: list[tuple[float, float]],
    duration_s: float,
    seed: int,
    changes: Mapping[str, float] | None = None,
    moving: Setpoint | None = None,
) -> list[Trace]:
    """All trials in step, so that a network is asked once an action; each ends early where the arm leaves its range."""
    arms = [Trial(rules, changes) for _ in trials]
    seen = [t.start(a, b, seed + k) for k, (t, (a, b)) in enumerate(zip(arms, trials, strict=True))]
    parts: list[list[Array]] = [[t.history[-1:]] for t in arms]
    chosen: list[list[int]] = [[] for _ in arms]
    alive = list(range(len(arms)))
    for n in range(round(duration_s / rules.action_s)):
        for k in alive:
            arms[k].setpoint_deg = moving(n * rules.action_s) if moving else trials[k][1]
            seen[k] = arms[k].seen()
        if not alive:
            break
        actions = policy(np.array([seen[k] for k in alive]))
        still = []
        for k, action in zip(alive, actions.tolist(), strict=True):
            fine, rows = arms[k].act(action)
            parts[k].append(rows)
            chosen[k].append(action)
            if fine:
                still.append(k)
        alive = still
    return [
        trace(arms[k], np.concatenate(parts[k]), chosen[k], trials[k][1], k in alive, moving) for k in range(len(arms))
    ]


def trace(
    trial: Trial, rows: Array, chosen: list[int], setpoint_deg: float, fine: bool, moving: Setpoint | None
) -> Trace:
    """The log of one trial. A muscle's in and out valve each move when the action takes them up or leaves them."""
    t = np.arange(len(rows)) * 1e-3
    wanted = np.array([moving(s) for s in t]) if moving else np.full(len(rows), setpoint_deg)
    edges = np.zeros(len(rows))
    commands = np.array([(0.0, 0.0), *(ACTIONS[a] for a in chosen)])
    for n, moved in enumerate(np.abs(np.diff(commands, axis=0)).sum(axis=1)):
        edges[min(n * trial.arm.ticks, len(rows) - 1)] += moved
    return Trace(wanted, deg(rows[:, 0]), 1e-5 * rows[:, 1:], edges, not fine)


def relay(rules: Rules, band_deg: float, ahead_s: float) -> Policy:
    """A rule with three of the nine: towards the setpoint, hold inside the band, by the error `ahead_s` from now.

    The error is carried ahead along the straight line through the last two angles seen.
    """

    def rule(seen: Array) -> Array:
        away, before = 10.0 * seen[:, rules.states - 1], 10.0 * seen[:, rules.states - 2]
        away = away + (away - before) * (ahead_s / rules.action_s)
        return np.where(away > band_deg, UP, np.where(away < -band_deg, DOWN, HOLD))

    return rule


def at_random(rules: Rules, seed: int) -> Policy:
    """Actions drawn evenly: what nobody should be worse than."""
    rng = np.random.default_rng(seed)
    return lambda seen: rng.choice(rules.actions, size=len(seen))
