"""What one robust controller costs, and schedules made of controllers tuned at several operating points, or read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.control.shorthand import bounded
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.model import Fit
from loopshape.design.tune import Tuning
from loopshape.toolbox.schedules.gain_scheduled import LAG_S, Follows, GainScheduled, Variable
from loopshape.verbs.arguments import Plants, controller_of, equivalent_plants

if TYPE_CHECKING:
    from loopshape.toolbox.schedules.schedule import Schedule


def schedule(
    P: Plants, R: Requirements, C: Controller | Tuning, *, fits: Sequence[Fit] = (), seed: int = 0, starts: int = 16
) -> Schedule:
    """What one robust controller `C` costs in bandwidth, beside one tuned for each operating point alone under `R`.

    `points` of the answer hold own, robust and unreachable bandwidth in Hz of each. Same input and seed, same answer.
    Misleads: a controller switched between the points is no loop that was checked. Raises WrongUseError where `C` is
    not of the structure of `R`.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 40)
    >>> P = ls.FRF.from_arrays(f_hz, 50.0 / (2j * np.pi * f_hz), relative_std=0.01, rate_hz=5000.0)
    >>> R = ls.Requirements(sensitivity_peak_db=6.0, control_peak_db=6.0, unstable_poles=0, structure=(ls.gain(),))
    >>> found = ls.schedules.schedule(P, R, ls.controller(ls.gain(0.5), rate_hz=5000.0), starts=1)
    >>> bool(found.points[0].cost_hz > 0.0)
    True
    """
    from loopshape.toolbox.schedules.schedule import schedule as schedule_loop

    plants, R = equivalent_plants(P, R)
    asked = replace(R, structure=bounded(R.structure, plants))
    return schedule_loop(plants, asked, controller_of(C), tuple(fits), seed=seed, starts=starts)


def gain_scheduled(
    controllers: Sequence[Controller],
    at: Sequence[Mapping[str, float]],
    follows: Mapping[str, str | tuple[str, str]],
    *,
    lag_s: float = LAG_S,
) -> GainScheduled:
    """A controller interpolated over the operating point, from controllers of one structure tuned `at` several.

    `follows` names, for each scheduling variable, the loop whose reference it follows, or (loop, "output") where it
    follows what is measured. The operating points fill a grid; `lag_s` is the time constant of the lag behind which
    the variables act. The result's `at(point)` is the controller of a frozen operating point; `ls.check` looks at each.
    Raises WrongUseError for points that fill no grid, and for controllers that are not of one structure.

    Misleads: margins of frozen operating points hold where the point moves slowly beside the loop. That is not checked.

    >>> import loopshape as ls
    >>> soft, stiff = (ls.controller(ls.gain(k), ls.low_pass(20.0, 0.7), rate_hz=1000.0) for k in (10.0, 4.0))
    >>> C = ls.schedules.gain_scheduled([soft, stiff], [{"p_bar": 0.8}, {"p_bar": 1.4}], {"p_bar": "p"})
    >>> round(C.at({"p_bar": 1.1}).blocks[0].section()[0][0], 6)
    7.0
    """
    names = tuple(follows)
    if len(at) != len(controllers) or any(name not in point for name in names for point in at):
        raise WrongUseError(
            "a schedule has one operating point for each controller, with all that it follows",
            f"{len(controllers)} controllers at {[dict(point) for point in at]}, following {', '.join(names)}",
        )
    placed: dict[tuple[float, ...], Controller] = {}
    for point, controller in zip(at, controllers, strict=True):
        placed[tuple(float(point[name]) for name in names)] = controller
    axes = [sorted({place[k] for place in placed}) for k in range(len(names))]
    if missing := [place for place in product(*axes) if place not in placed]:
        raise WrongUseError(
            "the operating points of a schedule fill a grid",
            f"no controller at {', '.join(f'{n} {x:g}' for n, x in zip(names, missing[0], strict=True))}",
            "tune one there, or give the nearest one's",
        )
    variables = []
    for name, knots in zip(names, axes, strict=True):
        given = follows[name]
        loop, what = (given, Follows.REFERENCE) if isinstance(given, str) else given
        variables.append(Variable(name, tuple(knots), loop, what))  # type: ignore[arg-type]  # refuses other words
    first = next(iter(placed.values()))
    return GainScheduled(first.loop, tuple(variables), tuple(placed[x] for x in product(*axes)), lag_s)


def read_gain_scheduled(file: str | Path) -> tuple[GainScheduled, ...]:
    """The schedules in a controller file (TOML), one a loop. Raises UnreadableInputError for another file.

    Examples
    --------
    >>> import loopshape as ls, tempfile
    >>> soft, stiff = (ls.controller(ls.gain(k), rate_hz=1000.0, loop="theta") for k in (10.0, 4.0))
    >>> C = ls.schedules.gain_scheduled([soft, stiff], [{"p_bar": 0.8}, {"p_bar": 1.4}], {"p_bar": "p"})
    >>> ls.schedules.read_gain_scheduled(ls.write(C, f"{tempfile.mkdtemp()}/controller.toml"))[0].nodes[1]
    {'p_bar': 1.4}
    """
    from loopshape.io.write.controllers import read_loop_controllers

    path = Path(file)
    found = tuple(one for one in read_loop_controllers(path) if isinstance(one, GainScheduled))
    if not found:
        raise WrongUseError(f"{path.name} holds no schedule", "plain controllers", "read them as controllers")
    return found
