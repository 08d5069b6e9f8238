"""For a project's own tests: a controller that no longer holds is a failed test, with the verdict as its message.

    from loopshape.testing import ControllerTest, assert_controller

    def test_axis():
        assert_controller("runs/axis", "controller.toml", "requirements.toml", baseline="verdict.json")

    AXIS = ControllerTest("runs/axis", "controller.toml", "requirements.toml")

    @pytest.mark.parametrize("case", AXIS.cases)
    def test_each_requirement(case):
        AXIS.assert_case(case)

Needs no pytest: any runner that takes an `AssertionError` will do.
"""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.data.requirement.requirements import TOGETHER
from loopshape.data.result.baseline import Baseline
from loopshape.data.result.verdict import Verdict
from loopshape.data.result.verdict_words import line_text, stability_text
from loopshape.io.requirements import read_required
from loopshape.io.write.check_files import Checks, against, check_all

AnyPath = str | PathLike[str]
STABILITY, ALL = "stability", "all loops"


def assert_controller(
    run: AnyPath,
    controller: AnyPath,
    require: AnyPath,
    *,
    baseline: AnyPath | None = None,
    allow_worse: bool = False,
) -> None:
    """Check a controller on a run's FRFs as `loopshape check` does.

    Raises AssertionError with the verdict where a requirement is missed or not decided by these data, where a loop is
    not known to be stable, or where something is worse than the `baseline` (a verdict that `loopshape check
    --save-verdict` kept; with `allow_worse` it is only part of the message). Files that cannot be read raise
    `loopshape.core.errors.LoopshapeError`: the test has an error, it does not fail.
    """
    __tracebackhide__ = True
    test = ControllerTest(run, controller, require)
    compared = None if baseline is None else against(Path(baseline), test.checks.loops)
    worse = compared is not None and compared.worse and not allow_worse
    if not all(one.passed for one in test.verdicts) or worse:
        raise AssertionError(test.message(compared))


class ControllerTest:
    """One controller on one run, for a test of each requirement; it is checked once, when the first test asks.

    `cases` come from the requirements' file alone, so that collecting tests is quick and needs no run.
    """

    def __init__(self, run: AnyPath, controller: AnyPath, require: AnyPath) -> None:
        self.run, self.controller, self.require = Path(run), Path(controller), Path(require)

    @cached_property
    def cases(self) -> tuple[str, ...]:
        """Each requirement as "loop: quantity", and the stability of each loop as "loop: stability".

        What [several] asks of all loops at once is "all loops: quantity".
        """
        loops, together = read_required(self.require)
        asked = [(one.loop, one.limited()) for one in loops]
        asked += [] if together is None else [(ALL, tuple(x.name for x in TOGETHER if getattr(together, x.name)))]
        return tuple(f"{loop}: {name}" for loop, limits in asked for name in (*limits, STABILITY))

    @cached_property
    def checks(self) -> Checks:
        """What was checked, loop by loop or all at once."""
        return check_all(self.run, self.controller, self.require)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Each loop's verdict, and then that on all together."""
        return self.checks.verdicts

    def assert_case(self, case: str) -> None:
        """Assert one of `cases`; refuses one that is not among them."""
        __tracebackhide__ = True
        if case not in self.cases:
            raise WrongUseError("a case is not one of the requirements", repr(case), f"use {', '.join(self.cases)}")
        loop, _, quantity = case.rpartition(": ")
        verdict = next(v for v in self.verdicts if v.loop == loop or (loop == ALL and v.together))
        text = _stability(verdict) if quantity == STABILITY else _line(verdict, quantity)
        if text:
            raise AssertionError(text)

    def message(self, compared: Baseline | None = None) -> str:
        """All verdicts, and the comparison with a baseline, as a failed test shows them."""
        parts = {} if compared is None else compared.parts
        texts = [one.text(title) for title, one in parts.items()]
        return "\n".join([f"{self.controller} on {self.run}", *map(str, self.verdicts), *texts])


def _line(verdict: Verdict, quantity: str) -> str:
    """The line's sentence where it does not pass, else nothing."""
    line = next(line for line in verdict.lines if line.quantity == quantity)
    return "" if line.passed else f"{line.outcome.word}: {quantity} of loop {verdict.loop}: {line_text(line)}"


def _stability(verdict: Verdict) -> str:
    named = [f"{name}: {stability_text(verdict.margins[name])}" for name in verdict.unstable]
    return "" if not named else "\n".join([f"loop {verdict.loop} is not known to be stable", *named])
