"""The learner: DQN of stable-baselines3 on the arm's trials. The one file that needs the extra `learning`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from nine_actions import LIMIT, Policy, Rules, Trial, start_for
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy

from loopshape.core.units import Array

warnings.filterwarnings("ignore", module="stable_baselines3")


class ArmTrials(gymnasium.Env[Array, int]):
    """Trials from a random angle to a random setpoint: nine actions, the latest three states, at most 100 actions."""

    def __init__(self, rules: Rules) -> None:
        self.trial, self.rules = Trial(rules), rules
        self.action_space = spaces.Discrete(len(rules.actions))
        self.observation_space = spaces.Box(-10.0, 10.0, (rules.seen,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """A new trial; its sensors' noise has a seed of its own."""
        super().reset(seed=seed)
        wide = self.rules.widest_deg
        setpoint = float(self.np_random.uniform(-wide, wide))
        start, self.done = start_for(setpoint, self.rules, self.np_random), 0
        seen = self.trial.start(start, setpoint, int(self.np_random.integers(2**31)))
        return seen.astype(np.float32), {}

    def step(self, action: int) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One action; leaving the range ends the trial, the limit of actions breaks it off."""
        fine, _ = self.trial.act(self.rules.actions[int(action)])
        self.done += 1
        seen = np.clip(self.trial.seen(), -10.0, 10.0).astype(np.float32)
        return seen, self.trial.paid(fine), not fine, self.done >= LIMIT, {}


#: of a policy on the watched trials: setpoints reached, trials that still move at the end, and at how many Hz
Verifier = Callable[[Policy], tuple[int, int, float]]


@dataclass(frozen=True, eq=False)
class Learned:
    """The last policy; trials and actions before each evaluation with what it gave; trials in all."""

    policy: Policy
    curve: list[tuple[int, int, int, int, float]]
    trials: int
    early: Policy  # as it was after `kept_trials`


class Watch(BaseCallback):
    """Counts trials, and asks after every so many how good the greedy policy is."""

    def __init__(self, rules: Rules, every: int, kept: int, judge: Verifier) -> None:
        super().__init__()
        self.rules, self.every, self.kept, self.judge = rules, every, kept, judge
        self.trials, self.curve = 0, list[tuple[int, int, int, int, float]]()

    def _on_training_start(self) -> None:
        self.look()

    def _on_step(self) -> bool:
        if self.locals["dones"][0]:
            self.trials += 1
            if self.trials % self.every == 0:
                self.look()
        return True

    def look(self) -> None:
        """Evaluate what is learned so far, without exploration."""
        self.curve.append((self.trials, self.num_timesteps, *self.judge(greedy(self.model.policy, self.rules))))
        if self.trials <= self.kept:
            self.early = greedy(deepcopy(self.model.policy), self.rules)


def greedy(network: BasePolicy, rules: Rules) -> Policy:
    """The action of the largest value, for many trials at once."""
    places = np.array(rules.actions)

    def best(seen: Array) -> Array:
        return places[network.predict(np.clip(seen, -10.0, 10.0).astype(np.float32), deterministic=True)[0]]

    return best


def learn(rules: Rules, settings: Mapping[str, Any], actions: int, seed: int, every: int, judge: Verifier) -> Learned:
    """Train one learner; same seed and machine, same learner."""
    torch.set_num_threads(1)
    first = float(settings["learning_rate"])
    model = DQN(
        "MlpPolicy", ArmTrials(rules), learning_rate=lambda left: first * left, seed=seed, device="cpu",
        policy_kwargs={"net_arch": list(settings["layers"])}, **settings["dqn"],
    )  # fmt: skip
    watch = Watch(rules, every, settings["kept_trials"], judge)
    model.learn(actions, callback=watch)
    watch.look()
    return Learned(greedy(model.policy, rules), watch.curve, watch.trials, watch.early)
