"""The peer: plain least squares, all numbers free, and the name is the number that changed most, in tolerances."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.own.plant import OwnMachine

SHARE, LATE_MS = 0.05, 1.0  # tolerance of what has none: a share of its scale, a delay
LIGHT = 1.0  # floors for one tolerance: holds what the recordings do not tell
MOST = 1e4  # floors: a simulation that is further off has run away
ROUNDS = 15
STEP = 0.05  # tolerances


def least_squares_name(plant: OwnMachine, run: Run) -> dict:
    """An answer in the form of a gap report's: names by their change in tolerances, with sizes and intervals."""
    by_role = {role: [r for r in run.recordings if r.info.role == role] for role in ("estimation", "validation")}
    ready_plant, cut, _ = plant.readied(run, [r.info.name for r in by_role["estimation"]])
    assert isinstance(ready_plant, OwnMachine)
    prepared = {role: [ready_plant.prepare(r, cut, None) for r in rows] for role, rows in by_role.items()}
    table = numbers(ready_plant)
    unit = np.array([t for _, _, t, _ in table])

    def moves(x: np.ndarray) -> dict[str, float]:
        own = {key: float(v) for (_, key, _, _), v in zip(table, x * unit, strict=True) if v != 0.0}
        return own | slides

    slides = {
        n.parameter: n.starts[0] for f in ready_plant.effects for n in f.free if n.parameter.endswith("coulomb_speed")
    }

    def misfit(x: np.ndarray, role: str = "estimation") -> np.ndarray:
        rows = []
        for f in prepared[role]:
            floors = ready_plant.floors(f)
            rows += [values / floors[k] for k, values in ready_plant.residuals(f, moves(x)).items()]
        return np.clip(np.concatenate(rows), -MOST, MOST)

    def held(x: np.ndarray) -> np.ndarray:
        return np.concatenate([misfit(x), LIGHT * x])

    def slopes(x: np.ndarray) -> np.ndarray:  # a step of scipy's at 0 is lost in rounding
        base = held(x)
        return np.stack([(held(x + STEP * row) - base) / STEP for row in np.eye(x.size)], axis=1)

    low = np.array([low for *_, low in table])
    start = np.where(low == 0.0, 0.1, 0.0)
    size = float(np.median(np.abs(misfit(start)))) + 1.0
    found = least_squares(
        held, start, bounds=(low, np.full(low.size, np.inf)), loss="soft_l1", f_scale=size, jac=slopes,
        x_scale=1.0, max_nfev=ROUNDS,
    )  # fmt: skip
    before, after = (float(np.sqrt(np.mean(misfit(x, "validation") ** 2))) for x in (0.0 * start, found.x))
    noise = np.sqrt(np.mean(found.fun**2))
    spread = noise * np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)))
    best: dict[str, dict] = {}
    for (name, _, tolerance, _), x, s in zip(table, found.x, spread, strict=True):
        row = {"effect": name, "magnitude": float(x * tolerance), "unit": "", "moved": abs(float(x)),
               "interval": (float((x - 2 * s) * tolerance), float((x + 2 * s) * tolerance))}  # fmt: skip
        if name not in best or best[name]["moved"] < row["moved"]:
            best[name] = row
    ranking = sorted(best.values(), key=lambda r: -r["moved"])
    total = sum(r["moved"] for r in ranking) or 1.0
    for r in ranking:
        r["probability"] = r["moved"] / total
    verdict = ranking[0]["effect"] if ranking[0]["moved"] > 1.0 else "none"
    return {"verdict": verdict, "ranking": ranking, "where": {}, "gap": {"before": before, "after": after}}


def numbers(plant: OwnMachine) -> list[tuple[str, str, float, float]]:
    """All numbers that may move: name, move, tolerance, and the lowest value in tolerances."""
    model, scales = plant.model, {f.free[0].parameter: f.free[0] for f in plant.effects}
    names = {p.effect for p in model.parameters if p.value}
    out = []
    for p in model.parameters:
        if p.value or p.range:
            tolerance = p.tolerance * abs(p.value) or SHARE * (
                abs(p.value) or abs(p.range[1]) if p.range else abs(p.value)
            )
            name = f"parameter_error@{p.name}" if p.effect == "none" else p.effect
            out.append((name, f"change.{p.name}", tolerance, -np.inf))
    for i in (i for i in model.inputs if i.column):
        out.append((f"actuator_gain_error@{i.name}", f"input.{i.name}.gain", SHARE, -np.inf))
        out.append((f"actuator_delay@{i.name}", f"input.{i.name}.delay_ms", LATE_MS, 0.0))
    for o in model.outputs:
        out.append((f"sensor_gain@{o.name}", f"output.{o.name}.gain", SHARE, -np.inf))
        out.append((f"sensor_delay@{o.name}", f"output.{o.name}.delay_ms", LATE_MS, 0.0))
        largest = scales[f"output.{o.name}.offset"].high
        out.append((f"sensor_offset@{o.name}", f"output.{o.name}.offset", SHARE * largest, -np.inf))
    for q in model.ports:
        for kind, key in (("coulomb_friction", "coulomb"), ("viscous_error", "viscous"), ("force_offset", "offset")):
            if f"{kind}@{q.name}" not in names:
                start = max(abs(v) for v in scales[f"port.{q.name}.{key}"].starts)
                out.append(
                    (f"{kind}@{q.name}", f"port.{q.name}.{key}", 0.5 * start, -np.inf if key != "coulomb" else 0.0)
                )
    return out
