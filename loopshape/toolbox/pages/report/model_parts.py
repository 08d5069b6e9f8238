"""The report's controllers, block by block and as they run, and its fitted models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.core.outcomes import Outcome
from loopshape.data.control.controller import Controller
from loopshape.data.response.model import Estimate, Fit
from loopshape.toolbox.pages.markup import Content, Markup, joined, tag
from loopshape.toolbox.pages.report.run_report import FittedModel
from loopshape.toolbox.pages.report.words import DASH, Cell, badge, details, figure, named, number, point, table

#: formulas of the controller's blocks, as `loopshape.data.control.controller` defines them (w = 2 pi f)
FORMULAS = {
    "gain": "gain",
    "lead_lag": "(s/w1 + 1)/(s/w2 + 1)",
    "notch": "(s²/w1² + 2 damping1 s/w1 + 1)/(s²/w2² + 2 damping2 s/w2 + 1)",
    "low_pass_1": "1/(s/w + 1)",
    "low_pass_2": "1/(s²/w² + 2 damping s/w + 1)",
    "pi": "(s + w)/s",
    "pid": "gain (1 + wi/s + (s/wd)/(s/wf + 1))",
    "section": "(n0 + n1 s + n2 s²)/(d0 + d1 s + d2 s²)",
}


def controller(one: Controller) -> Markup:
    """Blocks with their numbers and formulas, and the biquads as they run."""
    rows: list[list[Cell | Content]] = [
        [
            f"{k + 1}. {block.kind.replace('_', ' ')}",
            ", ".join(f"{name} = {number(value, 6)}" for name, value in block.parameters.items()),
            FORMULAS.get(block.kind, DASH),
        ]
        for k, block in enumerate(one.blocks)
    ]
    caption = f"Controller of loop {one.loop}, digest {one.digest}: blocks in series, w = 2π f"
    coefficients: list[list[Cell | Content]] = [
        [str(k + 1), *(Cell(_exact(value), float(value)) for value in row)] for k, row in enumerate(one.biquads())
    ]
    names = ["section", "b0", "b1", "b2", "a1", "a2"]
    biquads = table(f"Biquads in {one.precision}, a0 = 1; every digit counts", names, coefficients)
    blocks = table(caption, ["block", "parameters", "transfer function"], rows, cards=True)
    return joined([blocks, tag("p", _as_it_runs(one)), biquads])


def _exact(value: float) -> str:
    """All digits that tell a coefficient from every other double."""
    return repr(float(value)).removesuffix(".0").replace("-", "\N{MINUS SIGN}")


def _as_it_runs(one: Controller) -> str:
    """Discretisation, delay and hold in words: what was checked is that one."""
    exact = "" if one.prewarp_hz is None else f", exact at {number(one.prewarp_hz)} Hz"
    delay = f"{number(1e3 * one.computation_delay_s)} ms" if one.computation_delay_s else "no"
    hold = "and a zero-order hold" if one.added_hold else "and no hold"
    return (
        f"Runs at {number(one.rate_hz, 9)} Hz after Tustin's rule{exact}, with {delay} delay of computation {hold}"
        " beside what the measured plant contains. Every check and plot above is of the controller as it runs."
    )


def fits(models: Sequence[FittedModel]) -> Markup:
    """Parameters of each structure with their 95 % intervals, and roots of rational fits."""
    parts = []
    for structure in dict.fromkeys((one.fit.loop, one.fit.structure) for one in models):
        mine = [one for one in models if (one.fit.loop, one.fit.structure) == structure]
        parts += _fits_of(mine)
    words = (
        '"enough: no" means that the model leaves more than the noise: its intervals are widened, and every check above'
        " uses the measured FRF and not the model."
    )
    return joined([*parts, tag("p", words, class_="quiet")])


def _fits_of(models: Sequence[FittedModel]) -> list[Markup]:
    """One structure's fits: what can be read (delays, eigenfrequencies, ...) first, bare coefficients folded away."""
    first = models[0].fit
    shown = {mode.name: _headed(mode) for one in models for mode in (*_readable(one.fit), *one.modes)}
    columns = ["recording", *shown.values(), "misfit [dB]", "chi²/dof", "enough", "outcome"]
    rows: list[list[Cell | Content]] = []
    for one in models:
        found = {mode.name: _estimate(mode) for mode in (*_readable(one.fit), *one.modes)}
        cells = [found.get(name, Cell(DASH, float("nan"))) for name in shown]
        enough = "yes" if one.fit.sufficient else "no"
        quality = (figure(one.fit.misfit_db), figure(one.fit.chi2_per_dof))
        rows.append([_head(one.fit), *cells, *quality, enough, _ended(one.fit)])
    caption = f"Fits of loop {first.loop}, structure {first.structure}: value, and below it the 95 % interval"
    made = [table(caption, columns, rows, sortable=len(rows) > 1)]
    bare = [p.name for p in first.parameters if p.unit == "SI"]
    if bare:
        rows = [[_head(one.fit), *(_estimate(one.fit[name]) for name in bare)] for one in models]
        inner = table(f"Coefficients of loop {first.loop} in SI, s in rad/s", ["recording", *bare], rows)
        made.append(details(f"Coefficients of the fits of loop {first.loop}", inner))
    return made


def _readable(fit: Fit) -> list[Estimate]:
    return [p for p in fit.parameters if p.unit != "SI"]


def _head(fit: Fit) -> Markup:
    return named(fit.recording, point(fit.operating_point, fit.rig_parameters))


def _headed(p: Estimate) -> str:
    """A parameter's name with its unit; `pole1_f_hz` is `pole1 f [Hz]`."""
    name = p.name
    for suffix in ("_hz", "_s", "_deg"):
        name = name.removesuffix(suffix)
    unit = "ms" if p.unit == "s" else p.unit
    return f"{name.replace('_', ' ')}{'' if unit in ('1', '', 'SI') else f' [{unit}]'}"


def _estimate(p: Estimate) -> Cell:
    factor = 1e3 if p.unit == "s" else 1.0
    low, high = p.interval
    ends = DASH if not np.isfinite([low, high]).all() else f"{number(factor * low)} … {number(factor * high)}"
    return figure(p.value, joined([number(factor * p.value, 5), tag("span", ends, class_="interval95")]))


def _ended(fit: Fit) -> Content:
    return fit.outcome if fit.converged else badge(Outcome.UNDECIDED, fit.outcome.replace("_", " "))
