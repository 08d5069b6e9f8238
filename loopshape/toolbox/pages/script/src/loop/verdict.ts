// Margins at all operating points -> a row a requirement at its worst point, and which point to look at first (Python:
// loop/verdict.py, points.py).

import type { Controller } from "../numbers/controller";
import { Source } from "../numbers/dense";
import { withDetuning, withResonances, worstReading } from "./detuning";
import { askedOf, DISTURBED, readerOf, requirementsAt, type Reader } from "./limits";
import { Loop, Plant } from "./loop";
import { margins, type Interval, type Margins } from "./margins";
import type { Limit, Payload, PlantLoop, Requirements } from "../payload";
import { closedLoopStability } from "./stability";

export type Outcome = "passed" | "failed" | "undecided";
export const SEVERITY: Record<Outcome, number> = { failed: 0, undecided: 1, passed: 2 };

export interface Row {
  quantity: string;
  required: number;
  value: number;
  interval: Interval | null;
  slack: number;
  outcome: Outcome;
  point: number;
  at_hz: number | null;
  bound: number | null;
  /** Whether `value` is as far as was looked. */
  is_bound: boolean;
}

export interface Verdict {
  rows: Row[];
  margins: Margins[];
  outcome: Outcome;
  unstable: number[];
}

export function pointOutcome(m: Margins, limit: Limit, required: number): Outcome {
  const value = m.values[limit.name];
  if (value === undefined || Number.isNaN(value)) return "undecided";
  let [low, high] = m.intervals[limit.name] ?? [value, value];
  const least = limit.sense === "at_least";
  const best = m.bounds[limit.name];
  if (best !== undefined) [low, high] = least ? [low, Math.max(high, best)] : [Math.min(low, best), high];
  if (least ? low >= required : high <= required) return "passed";
  const at = m.at_hz[limit.name] ?? 0;
  const later = limit.name === "complementary_bandwidth_hz"; // |T| may fall for the last time in a hole further up
  const within = m.missing_hz.some(([from, to]) => (later ? required < to : best === undefined && from < at && at < to));
  const perhaps = (least ? high >= required : low <= required) || within;
  return perhaps ? "undecided" : "failed";
}

function rowAt(limit: Limit, required: number, point: number, m: Margins): Row {
  const value = m.values[limit.name] ?? NaN;
  const interval = m.intervals[limit.name] ?? null;
  const [low, high] = interval ?? [value, value];
  const slack = limit.sense === "at_least" ? low - required : required - high;
  return {
    quantity: limit.name,
    required,
    value,
    interval,
    slack,
    outcome: pointOutcome(m, limit, required),
    point,
    at_hz: m.at_hz[limit.name] ?? null,
    bound: m.bounds[limit.name] ?? null,
    is_bound: limit.name === "detuning_percent" && m.detuning !== null && worstReading(m.detuning).is_bound,
  };
}

function worse(a: Row, b: Row): boolean {
  const [one, two] = [SEVERITY[a.outcome], SEVERITY[b.outcome]];
  return one < two || (one === two && a.slack < b.slack);
}

/** What a requirement asks for, null where it asks nothing. */
export function requiredOf(requirements: Requirements, limit: Limit): number | null {
  const value = requirements[limit.name];
  return typeof value === "number" ? value : null;
}

/** A row a limit, at the worst of the operating points that are limited so; `asked` is what is required at each. */
export function verdictOn(limits: Limit[], asked: Requirements[], found: Margins[]): Verdict {
  const rows: Row[] = [];
  for (const limit of limits) {
    const each = found.flatMap((m, point) => {
      const required = requiredOf(asked[point], limit);
      return required === null ? [] : [rowAt(limit, required, point, m)];
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

const CLOSENESS = [
  "modulus_margin", "sensitivity_peak_db", "disk_margin", "phase_margin_deg", "gain_margin_db",
  "gain_reduction_margin_db", "delay_margin_s", "complementary_peak_db",
];
const RANK = { unstable: 0, undecided: 1, stable: 2 };

/** First what is unstable or undecided, then where the worst row about -1 is missed, else what comes nearest to -1. */
export function worstOf(found: Verdict): number {
  const ranks = found.margins.map((m) => (m.stability ? RANK[m.stability.outcome] : 2));
  const least = Math.min(...ranks);
  const missed = found.rows.filter((row) => CLOSENESS.includes(row.quantity) && row.outcome !== "passed");
  if (least === 2 && missed.length) return missed.reduce((a, b) => (orderOf(b) < orderOf(a) ? b : a)).point;
  const near = found.margins.map((m) => m.intervals.modulus_margin?.[0] ?? m.values.modulus_margin);
  return near.reduce((best, value, k) => {
    if (ranks[k] !== least) return best;
    return best < 0 || value < near[best] ? k : best;
  }, -1);
}

const orderOf = (row: Row): number => SEVERITY[row.outcome] * 100 + CLOSENESS.indexOf(row.quantity);

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
    return this.quick.map((_, k) => this.estimate(k, controller, requirements));
  }

  estimate(index: number, controller: Controller, requirements: Requirements): Margins {
    return margins(this.quickLoop(index, controller), this.readerAt(index, requirements, false));
  }

  /** One operating point under a controller, without draws. */
  quickLoop(index: number, controller: Controller): Loop {
    return new Loop(this.quick[index], controller);
  }

  /** What is required at each operating point. */
  asked(requirements: Requirements): Requirements[] {
    return this.loop.points.map((_, k) => this.askedAt(k, requirements));
  }

  private askedAt(index: number, requirements: Requirements): Requirements {
    return requirementsAt(requirements, this.loop.points[index].operating_point);
  }

  private readerAt(index: number, requirements: Requirements, all: boolean): Reader {
    const { limits } = this.payload;
    const asked = this.askedAt(index, requirements);
    return readerOf(asked, all ? limits : askedOf(asked, limits));
  }

  /** The verdict on margins at all operating points. */
  verdict(requirements: Requirements, found: Margins[]): Verdict {
    return this.verdictOf(this.asked(requirements), found);
  }

  verdictOf(asked: Requirements[], found: Margins[]): Verdict {
    return verdictOn(this.payload.limits, asked, found);
  }

  /** One operating point as Python's check reads it: of what is required, or of all quantities. */
  settled(index: number, controller: Controller, requirements: Requirements, all = false): Margins {
    const loop = new Loop(this.drawn[index], controller);
    const reader = this.readerAt(index, requirements, all);
    const made = { ...margins(loop, reader), stability: closedLoopStability(loop), settled: true };
    if (made.stability.outcome !== "unstable" || !loop.point.disturbed) return made;
    for (const { name } of reader.limits.filter((limit) => DISTURBED.includes(limit.name))) {
      made.values[name] = Infinity;
      delete made.intervals[name];
    }
    return made;
  }

  /** The same with its detuning margin, which takes longest. */
  detuning(index: number, controller: Controller, requirements: Requirements, m: Margins): Margins {
    const loop = this.quickLoop(index, controller);
    return withDetuning(loop, this.drawn[index], m, this.askedAt(index, requirements), this.payload.limits);
  }

  /** The same with what each resonance leaves that moves alone. */
  resonances(index: number, controller: Controller, requirements: Requirements, m: Margins): Margins {
    const loop = this.quickLoop(index, controller);
    return withResonances(loop, this.drawn[index], m, this.askedAt(index, requirements), this.payload.limits);
  }

  get size(): number {
    return this.drawn.length;
  }
}
