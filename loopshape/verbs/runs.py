"""Verbs on a run's folder: each reads the files that it needs, and gives a noun; what a command does, a script can."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.profile import Profile, zone_shares
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict_words import page_text
from loopshape.io.files import make_folder, write_text_whole
from loopshape.io.folder_lock import locked
from loopshape.io.requirements import joined, profile_of, read_required, read_requirements
from loopshape.io.write.controllers import read_controllers
from loopshape.io.write.fits import fits_of, write_fits
from loopshape.io.write.frfs import read_all_loops, read_frfs
from loopshape.io.write.verdicts import write_verdicts
from loopshape.verbs import chain
from loopshape.verbs.watch import Unwatched, Watch

if TYPE_CHECKING:
    from loopshape.data.result.baseline import Baseline
    from loopshape.design.tune import Tuning
    from loopshape.design.turns import TunedLoops
    from loopshape.io.write.check_files import Checks


def fit(
    run: Path,
    structure: str = "auto",
    *,
    loop: str | None = None,
    require: Path | None = None,
    watch: Watch | None = None,
    **options: Any,
) -> list[Fit]:
    """Fit the FRFs of a run, of one loop if named; `options` as in `ls.fit`. Refuses a run without such an FRF."""
    required = {} if require is None else {one.loop: one for one in read_requirements(require)}
    frfs = [one for one in read_frfs(run) if loop in (None, one.loop)]
    if not frfs:
        raise WrongUseError("the run has no FRF of such a loop", repr(loop))
    made = []
    with (watch or Unwatched()).progress("fit", len(frfs)) as step:
        for one in frfs:
            made.append(chain.fit(one, structure, R=required.get(one.loop), **options))
            step(one.recording)
    return made


def store_fits(run: Path, made: Sequence[Fit]) -> None:
    """Write fits into the run's folder, beside those of other FRFs."""
    known = {(f.recording, f.loop) for f in made}
    with locked(run):
        write_fits(run, [*(f for f in fits_of(run) if (f.recording, f.loop) not in known), *made])


@dataclass(frozen=True, eq=False)
class TunedRun:
    """Tunings by loop, and why they are not enough, "" where they are.

    `turns` is what several loops gave that were tuned in turn, `profile` the one whose limits were kept too.
    """

    tunings: tuple[Tuning, ...]
    missed: str
    profile: Profile | None = None
    turns: TunedLoops | None = None


def tune(
    run: Path,
    require: Path,
    *,
    start: Path | None = None,
    profile: str | None = None,
    matrix: bool = False,
    diagram: Path | None = None,
    each: Callable[[Tuning], None] = lambda tuning: None,
    **search: Any,
) -> TunedRun:
    """Tune the loops of a requirements file; `search`, with `disturbance` and `watch`, as in `ls.tune`.

    Each by itself, `each` called with it as soon as it is tuned, or with `matrix` in turn with the others closed; a
    profile then limits each with the others closed. Refuses a file to `start` from without any of these loops, and with
    `matrix` a diagram.
    """
    from loopshape.design.turns import TunedLoops
    from loopshape.io.run.run_folder import recorded_under

    given, together = read_required(require) if matrix else (read_requirements(require), None)
    requirements, chosen = joined(profile, given)
    initial = _to_start(start, [one.loop for one in requirements])
    if not matrix:
        tunings = []
        for tuning in _alone(run, requirements, initial, diagram, **search):
            tunings.append(tuning)
            each(tuning)
        return TunedRun(tuple(tunings), _missed(tunings), chosen)
    if diagram is not None:
        raise WrongUseError(
            "a diagram closes its other loops itself, and is tuned at its one open block", "--matrix and a diagram",
            "leave --matrix out",
        )  # fmt: skip
    found = chain.tune(
        read_all_loops(run), requirements, start=[*initial.values()], together=together,
        recorded_under=recorded_under(run), **search,
    )  # fmt: skip
    if not isinstance(found, TunedLoops):
        return TunedRun((found,), _missed([found]), chosen)
    missed = "" if found.feasible else "the loops do not meet all requirements together"
    return TunedRun(tuple(found.tunings.values()), missed, chosen, found)


def _alone(
    run: Path, requirements: Sequence[Requirements], initial: Mapping[str, Controller], diagram: Path | None,
    *, disturbance: Path | None = None, watch: Watch | None = None, **search: Any,
) -> Iterator[Tuning]:  # fmt: skip
    """Each loop by itself, or the tuned block of a diagram."""
    frfs, fits = read_frfs(run), fits_of(run)
    if diagram is not None:
        from loopshape.io.write.check_files import read_diagram

        equivalent = read_diagram(diagram, run).equivalent()
        frfs, fits, requirements = equivalent.plants, (), tuple(map(equivalent.asked, requirements))
    for required in requirements:
        mine = [one for one in frfs if one.loop == required.loop]
        known = chain.point_disturbances(disturbance, required.loop) or None
        start = initial.get(required.loop)
        with (watch or Unwatched()).progress(f"tune {required.loop}", 1):
            tuned = chain.tune(mine, required, fits=fits, start=start, disturbance=known, **search)
        yield tuned


def _to_start(file: Path | None, loops: list[str]) -> dict[str, Controller]:
    """Controllers of a file by loop; refuses a file that has none of the loops to be tuned."""
    if file is None:
        return {}
    found = {one.loop: one for one in read_controllers(file)}
    if not set(found) & set(loops):
        what = f"{file.name} has no controller to start from"
        raise WrongUseError(what, f"loops {', '.join(found)}", f"give one of {', '.join(loops)}")
    return found


def _missed(found: Sequence[Tuning]) -> str:
    """Why tunings are not enough; "" where all meet their requirements."""
    if all(t.feasible for t in found):
        return ""
    unstable = [t.controller.loop for t in found if ClosedLoop.UNSTABLE in t.verdict.stabilities]
    reason = "the nearest is shown above"
    if unstable:
        reason = f"no start was found stable in loop {', '.join(unstable)}"
    elif all(t.outcome is not Outcome.FAILED for t in found):
        reason = "the nearest, shown above, holds by the estimates and not by their 95 % intervals"
    return f"no controller was found that meets all requirements: {reason}"


@dataclass(frozen=True)
class Reports:
    """Files that a check writes or is compared with; None where they are not wanted."""

    junit: Path | None = None
    markdown: Path | None = None
    save_verdict: Path | None = None
    baseline: Path | None = None
    allow_worse: bool = False


@dataclass(frozen=True, eq=False)
class CheckedRun:
    """What a check found, under which profile, and against a baseline; without requirements `passed` is None."""

    checks: Checks
    profile: Profile | None = None
    compared: Baseline | None = None
    required: bool = True
    allow_worse: bool = False

    @property
    def outcome(self) -> Outcome | None:
        """The outcome of all loops, None where nothing was required."""
        return Outcome.worst(one.outcome for one in self.checks.verdicts) if self.required else None

    def text(self, run: str = "RUN") -> str:
        """The verdict in one sentence, and of each loop its requirements in 80 columns."""
        return page_text(self.checks.verdicts, ", and worse than the baseline" if self.worse else "", run)

    @property
    def worse(self) -> bool:
        """Whether something is worse than the baseline, and may not be."""
        return self.compared is not None and self.compared.worse and not self.allow_worse

    @property
    def profile_words(self) -> dict[str, Any] | None:
        """The profile and the probability of each zone by loop, for JSON."""
        if self.profile is None:
            return None
        names = ("name", "standard", "edition", "clause", "source", "confirm", "unread", "remarks", "limits")
        zones = {one.loop: zone_shares(one, self.profile) for one in self.checks.verdicts if not one.together}
        return {name: getattr(self.profile, name) for name in names} | {"zones": zones}

    @property
    def passed(self) -> bool | None:
        """Whether all requirements hold and nothing is worse than the baseline."""
        return self.outcome is Outcome.PASSED and not self.worse if self.required else None


def check(
    run: Path,
    controller: Path,
    require: Path | None,
    *,
    profile: str | None = None,
    reports: Reports | None = None,
    **options: Any,
) -> CheckedRun:
    """Check each loop of a requirements file, and compare it with the baseline of the `reports`.

    `options` as in `check_all`. Refuses reports on nothing required.
    """
    from loopshape.io.write.check_files import against, check_all

    reports = reports or Reports()
    chosen = None if profile is None else profile_of(profile)
    required = require is not None or chosen is not None
    if not required and reports != Reports():
        raise WrongUseError("a verdict needs requirements", "a file for it, and no requirements", "add --require FILE")
    if reports.allow_worse and reports.baseline is None:
        raise WrongUseError("--allow-worse needs a baseline", "none", "name it: --baseline FILE")
    found = check_all(run, controller, require, chosen, **options)
    compared = None if reports.baseline is None else against(reports.baseline, found.loops)
    return CheckedRun(found, chosen, compared, required, reports.allow_worse)


def write_reports(found: CheckedRun, reports: Reports) -> None:
    """Write the files that report on a check."""
    from loopshape.view.verdict.junit import junit
    from loopshape.view.verdict.markdown import markdown

    checks, compared = found.checks, found.compared
    for path in (one for one in (reports.junit, reports.markdown) if one is not None):
        make_folder(path.parent)
    if reports.save_verdict is not None:
        write_verdicts(reports.save_verdict, checks.kept)
    if reports.junit is not None:
        whole = None if compared is None else compared.whole
        write_text_whole(reports.junit, junit(checks.verdicts, whole, allow_worse=reports.allow_worse))
    if reports.markdown is not None:
        write_text_whole(reports.markdown, markdown(checks.verdicts, None if compared is None else compared.parts))
