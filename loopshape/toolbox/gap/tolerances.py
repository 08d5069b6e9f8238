"""What decides a diagnosis: temperature, costs and shares, each with the study that gave the number."""

from __future__ import annotations

from typing import NamedTuple


class Tolerances(NamedTuple):
    """Numbers of the diagnosis; those without a study were chosen by hand on development arms (experiments/exam)."""

    #: gap in noise floors below which there is none to explain
    smallest_gap: float = 1.5
    #: one over the temperature, and what is added where the best explains all but noise
    sharpness: float = 0.4
    sharper: float = 0.8
    #: cost of one effect, and of two: what a second cost development arms of eight recordings
    one_effect: float = 1.0
    two_effects: float = 3.975
    #: cost of the unknown, which leaves this share of the healthy model's gap
    unknown: float = 3.2
    unknown_leaves: float = 0.2
    #: an unusual magnitude costs this in squared distance, beyond the slack
    unusual: float = 6.0
    unusual_slack: float = 0.15
    #: excess up to which all but noise is explained, and cost of what was not fitted
    explained: float = 3.0
    not_fitted: float = 5.0
    #: a name has to take away this share of the held-out gap to be an answer; refuted ones keep a share of theirs
    least_share: float = 0.1
    refuted_keeps: float = 0.1
    #: how often the right kind in a wrong form leaves more than `unknown_leaves` of a plain gap, and how often a second
    #: effect beside it leaves noise alone: 19 of 32 and 1 of 8 (experiments/machines_exam/forms.csv), by Laplace's rule
    wrong_form_leaves: float = 20.0 / 34.0
    wrong_form_pairs: float = 2.0 / 10.0
    #: relative errors of a magnitude: of its form, of what it leaves, and of what is not modelled (24 falsified models
    #: of EMPS and QUBE: the likelihood is largest at 0 to 0.19, all terms in it)
    form_error: float = 0.04
    of_what_is_left: float = 1.6
    of_the_unmodelled: float = 0.2
    #: chance of calling a quantity of a linear machine dependent on the level
    level_by_chance: float = 0.005


TOL = Tolerances()
