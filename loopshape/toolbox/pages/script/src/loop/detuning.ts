// Detuning margin: how far the plant's frequencies, or one resonance alone, may move before something breaks (Python:
// loop/detuning.py).

import { clip, union, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import type { Controller } from "../numbers/controller";
import type { Loop, Plant } from "./loop";
import { columnsOf, onColumn, type Interval, type Margins } from "./margins";
import type { Constants, ReadLimit, Requirements, Seen } from "../payload";
import { readerOf } from "./limits";
import { seenResonances, Shiftable, type Moved, type Reading } from "./shifted";

/** The largest shift one way, in per cent, below which all holds; what breaks there, and its 95 % interval. */
export interface DetuningReading {
  percent: number;
  is_bound: boolean;
  breaks: string;
  interval: Interval;
}

/** What one resonance of the plant, moved alone, leaves. */
export interface MovedResonance {
  hz: number;
  damping: number;
  up: DetuningReading;
  down: DetuningReading;
}

export interface Detuning {
  up: DetuningReading;
  down: DetuningReading;
  /** Of single resonances; null while, or where, they are not asked about. */
  resonances: MovedResonance[] | null;
}

/** The lesser of up and down. */
export function worstReading({ up, down }: Pick<Detuning, "up" | "down">): DetuningReading {
  const less = down.percent < up.percent || (down.percent === up.percent && down.interval[0] < up.interval[0]);
  return less ? down : up;
}

/** Margins with their detuning margin and its interval; as they are where stability is not decided. */
export function withDetuning(loop: Loop, drawn: Plant, m: Margins, requirements: Requirements, limits: ReadLimit[]): Margins {
  const detuning = detuningOf(loop, drawn, m, requirements, limits);
  if (!detuning) return m;
  const { up, down } = detuning;
  const interval: Interval = [Math.min(up.interval[0], down.interval[0]), Math.min(up.interval[1], down.interval[1])];
  return {
    ...m,
    detuning,
    values: { ...m.values, detuning_percent: worstReading(detuning).percent },
    intervals: { ...m.intervals, detuning_percent: interval },
  };
}

/** Searches over shifts of one loop's plant, whole or a resonance at a time; null where its poles cannot be counted. */
function searches(loop: Loop, drawn: Plant, m: Margins, requirements: Requirements, limits: ReadLimit[]): { whole: Search; alone: (one: Seen) => Search; seen: Seen[] } | null {
  if (!m.stability || m.stability.outcome === "undecided" || loop.f.length < 2) return null;
  const plant = new Shiftable(loop, drawn, readerOf(requirements, limits));
  const stretched = plant.stretched();
  const unmoved = stretched.reading(0);
  if (unmoved.poles === null) return null;
  const seen = seenResonances(loop);
  const search = (moved: Moved): Search => new Search(loop, m, requirements, limits, moved, unmoved, seen);
  return { whole: search(stretched), alone: (one) => search(plant.withMoved(one)), seen };
}

function detuningOf(loop: Loop, drawn: Plant, m: Margins, requirements: Requirements, limits: ReadLimit[]): Detuning | null {
  const found = searches(loop, drawn, m, requirements, limits);
  return found && { ...found.whole.both(), resonances: null };
}

/** Margins with what each of the plant's resonances, moved alone, leaves, where a detuning margin is required. */
export function withResonances(loop: Loop, drawn: Plant, m: Margins, requirements: Requirements, limits: ReadLimit[]): Margins {
  if (!m.detuning || typeof requirements.detuning_percent !== "number") return m;
  const found = searches(loop, drawn, m, requirements, limits);
  const resonances = found && found.seen.map((one) => ({ hz: one.hz, damping: one.damping, ...found.alone(one).both() }));
  return { ...m, detuning: { ...m.detuning, resonances } };
}

export const STABILITY = "stability";

type End = -1 | 0 | 1;

/** Slacks of one loop over shifts of its plant. */
class Search {
  private readonly c: Constants["detuning"];
  private readonly closely: boolean;
  private readonly limits: ReadLimit[];
  private readonly columns: number[];
  private readonly signs: number[];
  private readonly required: number[];
  private readonly bias: number[];
  private readonly known: Record<string, number[]>;
  private readonly shifts: number[];

  constructor(
    private readonly loop: Loop,
    private readonly m: Margins,
    requirements: Requirements,
    limits: ReadLimit[],
    private readonly moved: Moved,
    unmoved: Reading,
    seen: Seen[],
  ) {
    const required = requirements.detuning_percent;
    this.c = loop.plant.source.constants.detuning;
    this.closely = typeof required === "number";
    const asked = columnsOf(limits).filter(([{ name }]) => typeof requirements[name] === "number");
    this.limits = asked.map(([limit]) => limit);
    this.columns = asked.map(([, column]) => column);
    this.signs = this.limits.map(({ scale, sense }) => ((sense === "at_least") !== (scale === "inverse") ? 1 : -1));
    this.required = this.limits.map((limit) => onColumn(limit, requirements[limit.name] as number));
    const now = this.limits.map((limit) => onColumn(limit, m.values[limit.name]));
    this.bias = this.columns.map((c, k) => finite(unmoved.values[c] - now[k]));
    this.known = { "-1": this.knownReach(m, now, -1), "1": this.knownReach(m, now, 1) };
    this.shifts = shiftsOf(loop, seen, this.closely ? (required as number) : null);
  }

  /** How far the bad or good end of the unmoved loop's intervals lies from the estimate. */
  private knownReach(m: Margins, now: number[], end: End): number[] {
    return this.limits.map((limit, k) => {
      const interval = m.intervals[limit.name];
      if (!interval) return 0;
      const ends = interval.map((value) => this.signs[k] * (onColumn(limit, value) - now[k]));
      return finite(end < 0 ? Math.min(...ends) : Math.max(...ends));
    });
  }

  /** What each limit leaves at a shift: of the estimate, or of its interval's bad (-1) or good (1) end. */
  private slacks(percent: number, end: End): number[] {
    const { values } = this.moved.reading(percent);
    return this.columns.map((c, k) => {
      const left = this.signs[k] * (values[c] - this.biasAt(percent, k) - this.required[k]);
      return end === 0 || !Number.isFinite(left) ? left : left + this.reachAt(percent, end, k);
    });
  }

  private reachAt(percent: number, end: End, k: number): number {
    const own = this.known[String(end)][k];
    if (!this.closely || percent === 0) return own;
    const here = this.moved.scatter(percent).half_width[this.columns[k]];
    const before = this.moved.scatter(0).half_width[this.columns[k]];
    const grown = here / before;
    return Number.isFinite(grown) && before > 0 ? own * grown : own + end * here;
  }

  private biasAt(percent: number, k: number): number {
    if (!this.closely || percent === 0) return this.bias[k];
    const c = this.columns[k];
    return this.bias[k] + this.moved.scatter(percent).bias[c] - this.moved.scatter(0).bias[c];
  }

  private stable(percent: number, end: End): boolean {
    const { poles, clear } = this.moved.reading(percent);
    const balanced = poles !== null && poles === this.moved.reading(0).poles;
    const sure = clear > this.loop.plant.source.constants.radius_95;
    return end < 0 ? balanced && sure : end > 0 ? balanced || !sure : balanced;
  }

  private holds(percent: number, end: End): boolean {
    return this.stable(percent, end) && this.slacks(percent, end).every((slack) => slack >= -this.c.rounding);
  }

  /** Up and down. */
  both(): { up: DetuningReading; down: DetuningReading } {
    const none: DetuningReading = { percent: 0, is_bound: false, breaks: STABILITY, interval: [0, 0] };
    return this.m.stability?.outcome === "unstable" ? { up: none, down: none } : { up: this.oneWay(1), down: this.oneWay(-1) };
  }

  /** The largest shift one way, with its interval. */
  private oneWay(way: 1 | -1): DetuningReading {
    const { percent, is_bound } = this.firstBreak(way, 0, this.c.searched);
    const low = this.firstBreak(way, -1, percent).percent;
    const high = this.firstBreak(way, 1, this.c.searched).percent;
    const breaks = is_bound ? "" : this.what(way, percent);
    return { percent, is_bound, breaks, interval: [Math.min(low, percent), Math.max(high, percent)] };
  }

  private firstBreak(way: 1 | -1, end: End, most: number): { percent: number; is_bound: boolean } {
    if (!this.holds(0, end)) return { percent: 0, is_bound: false };
    let before = 0;
    for (const shift of [...this.shifts.filter((x) => x < most), most]) {
      if (!this.holds(way * shift, end)) return { percent: this.between(way, end, before, shift), is_bound: false };
      before = shift;
    }
    return { percent: before, is_bound: true };
  }

  /** The shift at which something breaks, between one that holds and one that does not, by secants and halves. */
  private between(way: number, end: End, good: number, bad: number): number {
    if (!this.closely && end !== 0) return good + this.share(way, end, good, bad) * (bad - good);
    const steps = this.closely ? this.c.steps : Math.floor(this.c.steps / 2);
    for (let k = 0; k < steps; k++) {
      const share = k % 2 === 0 ? clip(this.share(way, end, good, bad), 0.05, 0.95) : 0.5;
      const middle = good + share * (bad - good);
      if (this.holds(way * middle, end)) good = middle;
      else bad = middle;
      if (bad - good < this.c.finest_step) break;
    }
    return this.closely ? good : good + this.share(way, end, good, bad) * (bad - good);
  }

  /** Where between two shifts the first slack passes zero, if each runs straight; else halfway. */
  private share(way: number, end: End, good: number, bad: number): number {
    if (!this.stable(way * bad, end)) return 0.5;
    const [before, after] = [this.slacks(way * good, end), this.slacks(way * bad, end)];
    let least = Infinity;
    for (let k = 0; k < before.length; k++) {
      if (!Number.isFinite(before[k]) || !Number.isFinite(after[k]) || after[k] >= 0) continue;
      const room = Math.max(before[k], 0);
      least = Math.min(least, room / (room - after[k]));
    }
    return least === Infinity ? 0.5 : least;
  }

  /** What breaks first beyond a shift, at the nearest searched one. */
  private what(way: number, percent: number): string {
    let after = Infinity;
    for (const x of this.moved.readings.keys()) {
      if (way * x >= percent && Math.abs(x) < Math.abs(after) && !this.holds(x, 0)) after = x;
    }
    if (!this.stable(after, 0)) return STABILITY;
    const slacks = this.slacks(after, 0);
    return this.limits[slacks.reduce((least, slack, k) => (slack >= slacks[least] ? least : k), 0)].name;
  }
}

const finite = (value: number): number => (Number.isFinite(value) ? value : 0);

/** Shifts in per cent that are searched, all positive. */
function shiftsOf(loop: Loop, seen: Seen[], required: number | null): number[] {
  const c = loop.plant.source.constants.detuning;
  const farther = (near: Real, more: number[]): number[] => [...near, ...more.filter((x) => x > near[near.length - 1] + 1e-9)];
  if (required === null) return farther(even(c.warned, Math.round(c.warned / c.coarse)), c.fewer);
  const sharpest = Math.min(...seen.map(({ damping }) => damping), sharpestOf(loop.controller));
  const last = Math.max(required, c.warned);
  const near = even(last, Math.ceil(last / clip(50 * sharpest, c.finest, c.fine)));
  return farther(union(near, Float64Array.of(required)), c.outer);
}

const even = (last: number, count: number): Real => Float64Array.from({ length: count }, (_, k) => (k === count - 1 ? last : ((k + 1) * last) / count));

/** Least damping of the controller's sections, of numerators and denominators; 1 without. */
function sharpestOf({ blocks }: Controller): number {
  const parts = blocks.flatMap((block) => control.section(block)).filter((p) => p[0] * p[2] > 0);
  return Math.min(1, ...parts.map((p) => Math.abs(p[1]) / (2 * Math.sqrt(p[0] * p[2]))).filter((x) => x > 0));
}
