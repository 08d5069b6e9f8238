"""Schedules made of controllers that were tuned at several operating points, and read from controller files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.control.gain_scheduled import LAG_S, Follows, GainScheduled, Variable


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
    from loopshape.io.write.controllers import read_gain_scheduled as read_file

    return read_file(Path(file))
