// Margins at all operating points -> a row a requirement at its worst point (Python: loop/verdict.py, points.py).

import type { Controller } from "../numbers/controller";
import { Source } from "../numbers/dense";
import { withDetuning, withResonances, worstReach } from "./detuning";
import { readerOf, requirementsAt } from "./limits";
import { Loop, Plant } from "./loop";
import { margins, type Interval, type Margins } from "./margins";
import type { Limit, Payload, PlantLoop, Requirements } from "../payload";
import { closedLoopStability } from "./stability";

export type Outcome = "passed" | "failed" | "undecided";
const SEVERITY: Record<Outcome, number> = { failed: 0, undecided: 1, passed: 2 };

export interface Row {
  quantity: string;
  wished: number;
  found: number;
  interval: Interval | null;
  spare: number;
  outcome: Outcome;
  point: number;
  at_hz: number | null;
  bound: number | null;
  /** Whether `found` is as far as was looked. */
  beyond: boolean;
}

export interface Found {
  rows: Row[];
  margins: Margins[];
  outcome: Outcome;
  unstable: number[];
}

export function pointOutcome(m: Margins, limit: Limit, wished: number): Outcome {
  const value = m.values[limit.name];
  if (value === undefined || Number.isNaN(value)) return "undecided";
  let [low, high] = m.intervals[limit.name] ?? [value, value];
  const least = limit.sense === "at_least";
  const best = m.bounds[limit.name];
  if (best !== undefined) [low, high] = least ? [low, Math.max(high, best)] : [Math.min(low, best), high];
  if (least ? low >= wished : high <= wished) return "passed";
  const at = m.at_hz[limit.name] ?? 0;
  const perhaps = (least ? high >= wished : low <= wished) || m.missing_hz.some(([from, to]) => from < at && at < to);
  return perhaps ? "undecided" : "failed";
}

function rowAt(limit: Limit, wished: number, point: number, m: Margins): Row {
  const found = m.values[limit.name] ?? NaN;
  const interval = m.intervals[limit.name] ?? null;
  const [low, high] = interval ?? [found, found];
  const spare = limit.sense === "at_least" ? low - wished : wished - high;
  return {
    quantity: limit.name,
    wished,
    found,
    interval,
    spare,
    outcome: pointOutcome(m, limit, wished),
    point,
    at_hz: m.at_hz[limit.name] ?? null,
    bound: m.bounds[limit.name] ?? null,
    beyond: limit.name === "detuning_percent" && m.detuning !== null && worstReach(m.detuning).beyond,
  };
}

function worse(a: Row, b: Row): boolean {
  const [one, two] = [SEVERITY[a.outcome], SEVERITY[b.outcome]];
  return one < two || (one === two && a.spare < b.spare);
}

/** What a requirement asks for, null where it asks nothing. */
export function wishedOf(requirements: Requirements, limit: Limit): number | null {
  const value = requirements[limit.name];
  return typeof value === "number" ? value : null;
}

/** A row a limit, at the worst of the operating points that are limited so; `asked` is what is required at each. */
export function verdictOn(limits: Limit[], asked: Requirements[], found: Margins[]): Found {
  const rows: Row[] = [];
  for (const limit of limits) {
    const each = found.flatMap((m, point) => {
      const wished = wishedOf(asked[point], limit);
      return wished === null ? [] : [rowAt(limit, wished, point, m)];
    });
    if (each.length) rows.push(each.reduce((worst, row) => (worse(row, worst) ? row : worst)));
  }
  const stable = found.map((m) => m.stability?.outcome ?? "undecided");
  const outcomes: Outcome[] = rows.map((row) => row.outcome);
  if (stable.includes("unstable")) outcomes.push("failed");
  if (stable.includes("undecided")) outcomes.push("undecided");
  const outcome = outcomes.reduce((a, b) => (SEVERITY[b] < SEVERITY[a] ? b : a), "passed" as Outcome);
  return { rows, margins: found, outcome, unstable: stable.flatMap((word, k) => (word === "stable" ? [] : [k])) };
}

/** All operating points of one loop, ready to be asked about controllers. */
export class Engine {
  private readonly quick: Plant[];
  private readonly drawn: Plant[];
  readonly source: Source;

  constructor(
    readonly payload: Payload,
    readonly loop: PlantLoop,
    source?: Source,
  ) {
    const { constants, random } = payload;
    this.source = source ?? new Source(constants, random.smoothing, random.between);
    this.quick = loop.points.map((point) => new Plant(point, this.source, false));
    this.drawn = loop.points.map((point) => new Plant(point, this.source, true));
  }

  /** Estimates at every operating point, without bias, intervals and stability: what a drag shows at once. */
  estimates(controller: Controller, requirements: Requirements): Margins[] {
    const asked = this.asked(requirements);
    return this.quick.map((plant, k) => margins(new Loop(plant, controller), readerOf(asked[k])));
  }

  /** What is required at each operating point. */
  asked(requirements: Requirements): Requirements[] {
    return this.loop.points.map((point) => requirementsAt(requirements, point.operating_point));
  }

  /** The verdict on margins at all operating points. */
  verdict(requirements: Requirements, found: Margins[]): Found {
    return verdictOn(this.payload.limits, this.asked(requirements), found);
  }

  /** One operating point as Python's check reads it. */
  settled(index: number, controller: Controller, requirements: Requirements): Margins {
    const loop = new Loop(this.drawn[index], controller);
    return { ...margins(loop, readerOf(this.asked(requirements)[index])), stability: closedLoopStability(loop), settled: true };
  }

  /** The same with its detuning margin, which takes longest. */
  detuning(index: number, controller: Controller, requirements: Requirements, m: Margins): Margins {
    const loop = new Loop(this.quick[index], controller);
    return withDetuning(loop, this.drawn[index], m, this.asked(requirements)[index], this.payload.limits);
  }

  /** The same with what each resonance leaves that moves alone. */
  resonances(index: number, controller: Controller, requirements: Requirements, m: Margins): Margins {
    const loop = new Loop(this.quick[index], controller);
    return withResonances(loop, this.drawn[index], m, this.asked(requirements)[index], this.payload.limits);
  }

  get size(): number {
    return this.drawn.length;
  }
}
