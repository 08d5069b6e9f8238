"""A learner with nine actions against the feedback controller, on the same simulated arm and the same trials."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own files, however it is started

from learning_pictures import draw_all  # noqa: E402
from learning_scores import scored  # noqa: E402
from learning_tables import Results, write_rows, write_tables  # noqa: E402
from nine_actions import Policy, Rules, at_random, pairs, play, relay  # noqa: E402
from rivals import Rival, designed, driven, steered, track, try_on  # noqa: E402
from trial_outcomes import summary  # noqa: E402

MISSING = (
    "this study trains a learner and found no stable-baselines3: install the extra with "
    "pip install 'loopshape[learning]' (`make studies` does) and run it again"
)
Learners = dict[int, Any]  # `dqn_learner.Learned` by seed; that file needs the extra


def main() -> None:
    """Train, try all on the same trials, write tables and figures."""
    if find_spec("stable_baselines3") is None:
        print(MISSING, file=sys.stderr)
        sys.exit(2)
    settings = tomllib.loads((HERE / "study.toml").read_text(encoding="utf-8"))
    rules = Rules(**settings["trial"], **settings["reward"])
    learners = train(rules, settings, settings["learner"], "learner")
    under = {name: replace(rules, **change) for name, change in settings["variants"]["of"].items()}
    others = {name: train(changed, settings, settings["variants"], name) for name, changed in under.items()}
    rivals, tracked = everyone(rules, settings, learners), settings["track"]
    results = Results(
        settings,
        rules,
        {seed: one.curve for seed, one in learners.items()},
        {name: {seed: one.curve for seed, one in made.items()} for name, made in others.items()},
        tried(rivals, rules, settings),
        tried_variants(others, under, settings),
        {(n, f): track(r, tracked, f) for n, r in rivals.items() for f in tracked["frequencies_hz"]},
    )
    write_tables(HERE, results)
    write_rows(HERE / "scores.csv", scored(results))
    seed = settings["final"]["seed"]
    early = {"early": driven(rules, first(learners).early, seed)}
    shown = {n: driven(under[n], others[n][results.restless(n)].policy, seed) for n in others}
    draw_all(results, rivals | early, shown)


def train(rules: Rules, settings: Mapping[str, Any], plan: Mapping[str, Any], name: str) -> Learners:
    """One learner a seed, each watched on the same fixed trials."""
    from dqn_learner import learn

    learner = settings["learner"]
    trials = pairs(rules, learner["curve_trials"], learner["curve_seed"])

    def judge(policy: Policy) -> tuple[int, int, float]:
        played = play(policy, rules, trials, rules.limit_s + rules.stay_s, learner["curve_seed"])
        found = summary(played, rules)
        return found.reached, found.moving, found.frequency_hz

    learned = {}
    for seed in plan["seeds"]:
        learned[seed] = learn(rules, learner["network"], plan["actions"], seed, plan["every_trials"], judge)
        print(f"{name}, seed {seed}: {learned[seed].trials} trials", flush=True)
    return learned


def first(made: Learners) -> Any:
    """The first seed's, for the figures."""
    return next(iter(made.values()))


def everyone(rules: Rules, settings: Mapping[str, Any], learners: Learners) -> dict[str, Rival]:
    """All who drive the nominal arm, by name."""
    final, seed = settings["final"], settings["final"]["seed"]
    rules_of_thumb = {
        "relay": relay(rules, final["relay_band_deg"], 0.0),
        "relay, ahead": relay(rules, final["relay_band_deg"], final["relay_ahead_s"]),
        "random": at_random(rules, seed),
    }
    policies = {f"learner {k}": one.policy for k, one in learners.items()} | rules_of_thumb
    found = {name: driven(rules, policy, seed) for name, policy in policies.items()}
    return found | {name: steered(rules, controllers, seed) for name, controllers in designed().items()}


def tried(rivals: Mapping[str, Rival], rules: Rules, settings: Mapping[str, Any]) -> dict[tuple[str, str], Any]:
    """Summary and counts by (who, arm); the feedback controller also without the dead zone."""
    arms = [(name, change, moves) for name in rivals for change, moves in settings["changes"].items()]
    arms += [("feedback", change, moves) for change, moves in settings["feedback_only"].items()]
    return {(n, change): try_on(rivals[n], rules, settings["final"], moves) for n, change, moves in arms}


def tried_variants(
    others: Mapping[str, Learners], under: Mapping[str, Rules], settings: Mapping[str, Any]
) -> dict[tuple[str, int], Any]:
    """Summary and counts by (variant, seed), on the nominal arm."""
    final = settings["final"]
    return {
        (name, seed): try_on(driven(under[name], one.policy, final["seed"]), under[name], final, {})
        for name, made in others.items()
        for seed, one in made.items()
    }


if __name__ == "__main__":
    main()
