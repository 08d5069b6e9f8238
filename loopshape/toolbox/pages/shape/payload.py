"""Plants, controller and requirements -> the page on which a loop is shaped by hand: one text that loads nothing.

Its data are arrays as base64, constants by name, draws as a recipe. What depends on the controller is computed in the
page, by the formulas that `loopshape.loop` has; draws of the FRF's error are made there by the same generator from the
same seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from types import ModuleType
from typing import Any

import numpy as np

from loopshape.core.kernels.loops import margins as kernel
from loopshape.core.units import Array
from loopshape.data.control.block import BLOCK_KINDS, Block
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.limits_over import MASKED
from loopshape.data.requirement.requirements import LIMITS, Limit, Requirements
from loopshape.data.requirement.weight import Objective
from loopshape.data.response import smoothed as dense
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.detuning import SEARCHED_PERCENT, WARNED_PERCENT
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.identify.smooth import smoothing
from loopshape.identify.smooth.pole_terms import PLACES
from loopshape.identify.smooth.resonances import Phase, Resonance, resonances
from loopshape.identify.smooth.smoothing import Recipe, recipe_of
from loopshape.loop import detuning, shifted
from loopshape.loop.loop import Loop, known_above, reach_above
from loopshape.loop.loops import fit_of, loops_of
from loopshape.loop.margin import between, margins
from loopshape.loop.margin.disturbed import carried, lines_of, of_points
from loopshape.loop.predict import step_response
from loopshape.loop.stability import holes, low_end, obstacles, sampling, stability
from loopshape.loop.stability.continued import continued
from loopshape.loop.stability.low_end import LowModel, low_hz, low_models
from loopshape.loop.stability.mode_clusters import ClusterBand, Residual
from loopshape.loop.tolerances import TOL
from loopshape.loop.verdict import outside_warnings
from loopshape.toolbox.pages.markup import Markup, head, json_block, packed, tag

#: what pages know of a limit, to draw it and to read it
_LIMIT = ("name", "sense", "unit", "label", "plot", "scale", "asked", "crossing", "open")
#: limits that the page reads without a column; of the columns it knows those before this one
_WITHOUT_COLUMN, _COLUMNS = ("controller_bandwidth_hz", "detuning_percent"), kernel.LN_WEIGHTED
FORMAT = "loopshape-shape/1"
#: the script, built by esbuild: see `script`
SCRIPT, STYLE = "shape.js", "shape.css"
#: so many lines of a disturbance at most: a page stays below a megabyte for each operating point
MOST_LINES = 8192


@dataclass(frozen=True, eq=False)
class ClosedLoops:
    """Loops of the same plant that are closed while one is shaped, and the unstable poles that it meets then."""

    controllers: tuple[Controller, ...]
    unstable_poles: int | None

    def of_plant(self, required: Requirements) -> Requirements:
        """What is required, with the poles of the plant that is met: those of a file are of the whole plant."""
        return replace(required, integrators=None, unstable_poles=self.unstable_poles)


@dataclass(frozen=True, eq=False)
class ShapingSession:
    """One loop of the page: its FRFs, where shaping starts, what is required, and the verdict on that start.

    Where it is one of several, its FRFs are of the equivalent plant with the `others` closed.
    """

    frfs: tuple[FRF, ...]
    controller: Controller
    requirements: Requirements
    fits: tuple[Fit, ...]
    verdict: Verdict
    others: ClosedLoops | None = None
    disturbances: tuple[Disturbance, ...] = ()

    def of_plant(self, required: Requirements) -> Requirements:
        """The requirements of the equivalent plant."""
        return required if self.others is None else self.others.of_plant(required)


def shape_page(loops: Sequence[ShapingSession], title: str, version: str, *, saved: str | None = None) -> str:
    """The whole page as HTML; the same loops give the same text. Of a server, it may ask it and no other,
    and says which content of the server's file, `saved`, it may replace.
    """
    script = resource(SCRIPT)
    body = [
        tag("div", tag("p", "This page needs JavaScript."), id="page"),
        json_block("data", payload(loops, title, version) | {"served": saved is not None, "saved": saved or ""}),
        tag("script", Markup(script), id="script"),
    ]
    allowed = ("worker-src blob:", *["connect-src 'self'"] * (saved is not None))
    top = head(f"{title} · loopshape shape", resource(STYLE), script, *allowed)
    html = tag("html", top, tag("body", *body), lang="en")
    return f"<!DOCTYPE html>\n{html}\n"


def resource(name: str) -> str:
    """Style or script that is shipped with the package."""
    return files("loopshape.toolbox.pages.script").joinpath(name).read_text(encoding="utf-8")


def payload(loops: Sequence[ShapingSession], title: str, version: str) -> dict[str, Any]:
    """All that the page knows, for JSON."""
    made = [_loop(one) for one in loops]
    disturbed = all(point["disturbed"] for one in made for point in one["points"])
    return {
        "format": FORMAT,
        "version": version,
        "title": title,
        "limits": [limit_words(limit) for limit in LIMITS if _is_read(limit, disturbed=disturbed)],
        "unread": {limit.name: limit.label for limit in LIMITS if not _is_read(limit, disturbed=disturbed)},
        "blocks": {name: list(kind.parameters) for name, kind in BLOCK_KINDS.items()},
        "constants": _constants(),
        "random": {"smoothing": _state(smoothing.SEED), "between": _state(dense.SEED)},
        "loops": made,
    }


def _is_read(limit: Limit, *, disturbed: bool = False) -> bool:
    """Whether the page reads a limit: none of weights and of saturation, no column that came later."""
    if limit.disturbed:
        return disturbed and limit.name != "saturation_percent"
    return margins.COLUMN_OF.get(limit.name, _COLUMNS) < _COLUMNS or limit.name in _WITHOUT_COLUMN


def limit_words(limit: Limit) -> dict[str, Any]:
    """What pages know of a limit."""
    ends = {"ceiling": limit.ceiling, "distance": limit.distance, "column": margins.COLUMN_OF.get(limit.name)}
    return {key: getattr(limit, key) for key in _LIMIT} | {k: min(x, 1e300) if x else x for k, x in ends.items()}


def _constants() -> dict[str, Any]:
    """Numbers of the formulas, from the modules that hold them."""
    return {
        "half_width": TOL.half_width_std, "agree": TOL.integrators_agree, "wrong": TOL.wrong_count,
        "peak": TOL.unseen_peak, "scatter": TOL.scatter_std, "radius_95": TOL.radius_95,
        "uncertain_ratio": TOL.uncertain_ratio, "far_below": low_end.SMALL, "degree": smoothing.USED,
        "places": PLACES.tolist(), "draws": smoothing.DRAWS,
        **_numbers(low_end, "below_ratios extrapolated_below large"),
        **_numbers(kernel, "at_zero"),
        **_numbers(stability, "same fit_deg"),
        **_numbers(holes, "least_damping poor_damping"),
        **{f"hole_{name}": x for name, x in _numbers(holes, "fewest apart turn far").items()},
        **_numbers(obstacles, "on_it"),
        **_numbers(between, "step small most wide far rounds path_half_widths"),
        **_numbers(dense, "between fewest lowest steepest"),
        **_numbers(sampling, "sharpest"),
        "detuning": {
            "searched": SEARCHED_PERCENT, "warned": WARNED_PERCENT, "draws": TOL.shifted_draws,
            "half_width": TOL.half_width_shifted_std,
            **_numbers(detuning, "coarse fine finest steps finest_step rounding outer fewer"),
            **_numbers(shifted, "matters near"),
        },
        "step_response": _numbers(step_response, "small flat longest"),
        "record": {
            "parts": TOL.record_parts, "surrogates": TOL.record_surrogates, "bursts": TOL.bursts,
            "unlike": TOL.unlike_noise, "largest": TOL.largest_parts, "alone": TOL.event_alone,
            "normal_95": TOL.normal_95, "random": _state(0),
        },
    }  # fmt: skip


def _numbers(module: ModuleType, names: str) -> dict[str, Any]:
    return {name: np.asarray(getattr(module, name.upper())).tolist() for name in names.split()}


def _state(seed: int) -> dict[str, str]:
    """The state of numpy's generator with a seed, in hexadecimal digits."""
    state: Any = np.random.PCG64(seed).state["state"]
    return {name: f"{state[name]:x}" for name in ("state", "inc")}


def _loop(one: ShapingSession) -> dict[str, Any]:
    required = one.of_plant(one.requirements)
    loops, notes = loops_of(one.frfs, one.controller, required, one.fits)
    disturbances = of_points(dict(zip(one.verdict.margins, loops, strict=True)), one.disturbances)
    return {
        "name": one.requirements.loop or one.controller.loop,
        "rate_hz": one.controller.rate_hz,
        "requirements": requirement_words(one.requirements),
        "controller": controller_words(one.controller),
        "points": [
            _point(name, loop)
            | {"fit": _fit(fit_of(frf, one.fits)), "disturbed": _disturbed(loop, disturbances.get(name))}
            for name, loop, frf in zip(one.verdict.margins, loops, one.frfs, strict=True)
        ],
        "closed": [controller_words(other) for other in one.others.controllers] if one.others else [],
        "certificate": {"outcome": one.verdict.outcome.value},
        "notes": [*notes, *outside_warnings(required, loops)],
        "weighted": required.weighted_norm is not None,
    }


def requirement_words(required: Requirements) -> dict[str, Any]:
    """What is required as its file has it, but for weights; what is not asked for is left out."""
    objective = Objective() if required.objective.weighted_norm else required.objective
    table = replace(required, weights=(), weighted_norm=None, objective=objective).to_table()
    return {"loop": table.pop("name")} | {k: v for k, v in table.items() if v or k not in MASKED}


def requirements_from(words: Mapping[str, Any]) -> Requirements:
    """What the page requires."""
    table = dict(words)
    return Requirements.from_table({"name": table.pop("loop", ""), **table})


def controller_words(controller: Controller) -> dict[str, Any]:
    """A controller as the page knows it."""
    made = {f.name: getattr(controller, f.name) for f in fields(controller)}
    blocks = [{"kind": block.kind, "parameters": dict(block.parameters)} for block in controller.blocks]
    return made | {"blocks": blocks}


def controller_from(words: Mapping[str, Any]) -> Controller:
    """A controller of the page, which writes a whole number for a float."""
    known: dict[str, Any] = {name: float(x) if type(x) is int else x for name, x in words.items() if name != "blocks"}
    return Controller(**known, blocks=tuple(Block(x["kind"], x["parameters"]) for x in words["blocks"]))


def _point(name: str, loop: Loop) -> dict[str, Any]:
    raw = loop.measured
    recipe = recipe_of(raw)
    return {
        "name": name,
        "operating_point": dict(raw.operating_point),
        "f": packed(loop.frequency_hz),
        "P": packed(loop.plant.siso),
        "raw": packed(raw.siso),
        "variance": packed(recipe.variance),
        "halves": packed(recipe.halves.astype(np.uint8)),
        "taps": recipe.taps.tolist(),
        "terms": _terms(recipe),
        "integrators": loop.integrators,
        "unstable_poles": loop.unstable_poles,
        **_low_end(loop),
        "above_band": _above_band(loop.beyond),
        **_between_lines(loop),
        "resonances": [_resonance(x) for x in resonances(raw) if x.phase is not Phase.UNKNOWN],
        "hidden": [
            {"low_hz": one.low_hz, "high_hz": one.high_hz, "centre_hz": one.pole_hz.real, "peak": one.peak}
            for one in obstacles.hidden_in(loop)
        ],
    }


def _terms(recipe: Recipe) -> list[dict[str, Any]]:
    """Narrow resonances: residue and pole, and what errors of the lines from the first on do to both."""
    return [
        {
            "residue": _pair(term.resonance.residue),
            "pole": _pair(term.resonance.pole_hz),
            "first": term.resonance.first,
            "influence": packed(term.influence),
        }
        for term in recipe.terms
    ]


def _low_end(loop: Loop) -> dict[str, Any]:
    """The plant below its first line by fits or small models."""
    models, below_hz = low_models(loop), low_hz(loop)
    poles = np.zeros(0, dtype=complex) if loop.model is None else stability.unstable_or_undamped(loop.model)
    return {
        "fitted_f": packed(loop.below_hz),
        "fitted": packed(loop.P_below),
        "fitted_poles": [_pair(p) for p in poles],
        "below_f": packed(below_hz),
        "below": [packed(model.response(below_hz)) for model in models],
        "extrapolated": [_extrapolated(float(loop.frequency_hz[0]) * low_end.BELOW_RATIOS, model) for model in models],
        "simple": any(low_end.is_simple(model) for model in models),
        "sign": low_end.sign_at_0(loop),
        "knows_sign": any(model.knows_sign for model in models),
        "order": [*low_end.low_order(loop.measured), low_end.room_of(loop.measured)],
        "gaps": [_gap(gap) for gap in holes.gaps_of(loop)],
    }


def _gap(gap: holes.Gap) -> dict[str, Any]:
    return {
        "hz": [gap.low_hz, gap.high_hz],
        "P": [_pair(gap.at_low), _pair(gap.at_high)],
        "residue": gap.residue if np.isfinite(gap.residue) else 1e300,
        "missing": gap.missing,
    }


def _extrapolated(f: Array, model: LowModel) -> dict[str, Any]:
    words = {"P": packed(model.response(f)), "slopes": packed(model.slopes(f))}
    return words | {"influence": packed(model.influence), "lines": model.lines}


def _above_band(frf: FRF | None) -> dict[str, Any] | None:
    if frf is None:
        return None
    radius = reach_above(frf)
    known = (known_above(frf) & (radius < np.abs(frf.siso))).tolist()
    return {"f": packed(frf.frequency_hz), "P": packed(frf.siso), "half_width": packed(radius), "known": known}


def _resonance(one: Resonance) -> dict[str, Any]:
    return {
        "hz": one.frequency_hz,
        "damping": one.damping,
        "peak": one.peak,
        "pole": _pair(one.pole_hz),
        "residue": _pair(one.residue),
    }


def _between_lines(loop: Loop) -> dict[str, Any]:
    """Resonances close together, fitted, and where lines scatter: of the plant alone."""
    clusters = [_cluster(loop, band) for band in obstacles.cluster_bands_in(loop)]
    residual, scatter = obstacles.interpolation_residuals(loop)
    tells = scatter.any() or any(one["left"] == Residual.SCATTER.value for one in clusters)
    return {
        "clusters": clusters,
        "scattered": np.flatnonzero(scatter).tolist(),
        "interpolation_residual": packed(residual) if tells else None,
    }


def _cluster(loop: Loop, band: ClusterBand) -> dict[str, Any]:
    """A stretch of lines and the ways in which poles explain it: those as complex64, as they are kept."""
    cluster = obstacles.cluster_in(loop, band)
    return {
        "low": band.low,
        "high": band.high,
        "polynomial_residual": obstacles.polynomial_residual(loop, band),
        "left": cluster.left.value,
        "delay_s": cluster.delay_s,
        "power": _pair(cluster.window.power[0]),
        "middle_hz": float(cluster.window.middle[0]),
        "poles": packed(cluster.pole_hz.astype(np.complex64)),
        "residues": packed(cluster.residue.astype(np.complex64)),
        "polynomials": packed(cluster.polynomial.astype(np.complex64)),
        "ways": len(cluster.pole_hz),
        "hidden": packed(cluster.hidden),
    }


def _fit(fit: Fit | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    named = {"structure": fit.structure, "misfit_db": fit.misfit_db, "sufficient": fit.sufficient}
    model = fit.model
    return named | {"num": model.num.tolist(), "den": model.den.tolist(), "delay_s": model.delay_s}


def _disturbed(loop: Loop, disturbance: Disturbance | None) -> dict[str, Any] | None:
    """What disturbed a loop, with plant and old controller on its lines; None of what the page does not judge."""
    if disturbance is None or disturbance.repeats or disturbance.coarse or disturbance.power.size > MOST_LINES:
        return None
    known, rate_hz, old = carried(loop, disturbance), loop.controller.rate_hz, disturbance.recorded_under
    values = {
        "f": known.f, "power": np.abs(known.before) ** 2, "scatter": lines_of(disturbance, rate_hz)[2],
        "P": known.there.response, "own_hz": loop.measured.frequency_hz, "variance": known.covariance[:, 0, 0].real,
    }  # fmt: skip
    samples = disturbance.duration_s * rate_hz
    return {k: packed(x) for k, x in values.items()} | {
        "recorded_under": None if old is None else controller_words(old), "last": _pair(loop.measured.siso[-1]),
        "overlap": known.overlap, "rms": disturbance.rms, "samples": samples if samples > 0.0 else None,
        "record": _record(loop, disturbance),
    }  # fmt: skip


def _record(loop: Loop, disturbance: Disturbance) -> dict[str, Any] | None:
    """The recorded error freed of the old controller, and the plant, on the lines of the record."""
    n = disturbance.samples.size // 2 * 2
    if not n:
        return None
    f = np.arange(1, n // 2) * loop.controller.rate_hz / n
    P = continued(loop.measured, f, loop.integrators or 0).response
    error, old = np.fft.rfft(disturbance.samples[:n])[1 : f.size + 1], disturbance.recorded_under
    made = error if old is None else error * (1.0 + old.response(f) * P)
    return {"count": n, "error": packed(made), "P": packed(P) if n < disturbance.samples.size else None}


def _pair(value: complex) -> list[float]:
    return [float(complex(value).real), float(complex(value).imag)]
