// Detuning margin: how far the plant's frequencies may move before something breaks (Python: loop/detuning.py and, for
// a loop whose whole frequency axis is stretched, loop/shifted.py). Single resonances are left to Python.

import { clip, concat, fromDb, placeIn, times, union, type Complex, type Real } from "./arrays";
import * as control from "./controller";
import type { Controller } from "./controller";
import { sumsOf, type Dense, type Draws } from "./dense";
import { followed, judgedLines, type Loop, type Plant } from "./loop";
import { aboveHz, LOGARITHMS, PLAIN, type Interval, type Margins } from "./margins";
import type { Constants, Limit, Requirements } from "./payload";
import { readerOf, type Reader } from "./limits";
import * as kernel from "./reading";
import { countUnstable } from "./stability";

/** The largest shift one way, in per cent, below which all holds; what breaks there, and its 95 % interval. */
export interface Reach {
  percent: number;
  beyond: boolean;
  breaks: string;
  interval: Interval;
}

export interface Detuning {
  up: Reach;
  down: Reach;
}

/** The lesser of up and down. */
export function worstReach({ up, down }: Detuning): Reach {
  const less = down.percent < up.percent || (down.percent === up.percent && down.interval[0] < up.interval[0]);
  return less ? down : up;
}

/** Margins with their detuning margin and its interval; as they are where stability is not decided. */
export function withDetuning(loop: Loop, drawn: Plant, m: Margins, requirements: Requirements, limits: Limit[]): Margins {
  const detuning = detuningOf(loop, drawn, m, requirements, limits);
  if (!detuning) return m;
  const { up, down } = detuning;
  const interval: Interval = [Math.min(up.interval[0], down.interval[0]), Math.min(up.interval[1], down.interval[1])];
  return {
    ...m,
    detuning,
    values: { ...m.values, detuning_percent: worstReach(detuning).percent },
    intervals: { ...m.intervals, detuning_percent: interval },
  };
}

function detuningOf(loop: Loop, drawn: Plant, m: Margins, requirements: Requirements, limits: Limit[]): Detuning | null {
  if (!m.stability || m.stability.outcome === "undecided" || loop.f.length < 2) return null;
  const moved = new Moved(loop, drawn, readerOf(requirements));
  if (moved.reading(0).poles === null) return null;
  const search = new Search(loop, m, requirements, limits, moved);
  if (m.stability.outcome === "unstable") {
    const none: Reach = { percent: 0, beyond: false, breaks: STABILITY, interval: [0, 0] };
    return { up: none, down: none };
  }
  return { up: search.oneWay(1), down: search.oneWay(-1) };
}

export const STABILITY = "stability";

interface Reading {
  values: Float64Array;
  poles: number | null;
  clear: number;
}

interface Lines {
  grid: kernel.Grid;
  C: Complex;
  poles: (L: Complex) => number | null;
}

/** A plant with its whole frequency axis stretched, read once at each shift. */
class Moved {
  private readonly f: Real;
  private readonly P: Complex;
  private readonly std: Real;
  private readonly draws: Draws;
  private readonly belowF: Real;
  private readonly belowP: Complex | null;
  private readonly aboveF: Real;
  readonly readings = new Map<number, Reading>();
  private readonly scatters = new Map<number, { bias: Float64Array; reach: Float64Array }>();

  constructor(
    private readonly loop: Loop,
    plant: Plant,
    private readonly reader: Reader,
  ) {
    const { point, controller } = loop;
    const dense = followed(fewerDraws(plant.dense, plant.source.constants.detuning.draws), controller, plant.source);
    const own = { f: dense.f, P: dense.P, std: deviations(plant, dense.f), draws: dense.draws as Draws };
    const { f, P, std, draws } = withLed(loop, own);
    [this.f, this.P, this.std, this.draws] = [f, P, std, draws];
    this.belowF = point.modelled ? point.below_f : new Float64Array(0);
    this.belowP = point.modelled ? point.below[0] : null;
    this.aboveF = aboveHz(point.f[point.f.length - 1], controller.rate_hz);
  }

  /** What margins and count are at a shift in per cent. */
  reading(percent: number): Reading {
    const known = this.readings.get(percent);
    if (known) return known;
    const { grid, C, poles } = this.linesAt(percent);
    const n = grid.f.length;
    const L = times(C, { re: this.P.re.subarray(0, n), im: this.P.im.subarray(0, n) });
    const out = kernel.freshReading();
    kernel.read(grid, L.re, L.im, true, out);
    let clear = Infinity;
    for (let k = 0; k < n; k++) {
      const share = Math.hypot(1 + L.re[k], L.im[k]) / (Math.hypot(C.re[k], C.im[k]) * this.std[k]);
      if (!(share >= clear)) clear = share;
    }
    const made = { values: out.found, poles: poles(L), clear };
    this.readings.set(percent, made);
    return made;
  }

  /** Bias and half interval of a reading's columns, by draws of the plant's error; infinite where one jumps. */
  scatter(percent: number): { bias: Float64Array; reach: Float64Array } {
    const known = this.scatters.get(percent);
    if (known) return known;
    const made = this.scattered(percent);
    this.scatters.set(percent, made);
    return made;
  }

  private scattered(percent: number): { bias: Float64Array; reach: Float64Array } {
    const { grid, C } = this.linesAt(percent);
    const { values } = this.reading(percent);
    const { count } = this.draws;
    const [n, wide] = [grid.f.length, this.f.length];
    const [re, im] = [new Float64Array(n), new Float64Array(n)];
    const out = kernel.freshReading();
    const found = new Float64Array(count * kernel.COLUMNS);
    for (let d = 0; d < count; d++) {
      for (let k = 0; k < n; k++) {
        const x = this.P.re[k] + this.draws.re[d * wide + k];
        const y = this.P.im[k] + this.draws.im[d * wide + k];
        re[k] = C.re[k] * x - C.im[k] * y;
        im[k] = C.re[k] * y + C.im[k] * x;
      }
      kernel.read(grid, re, im, true, out);
      found.set(out.found, d * kernel.COLUMNS);
    }
    const made = { bias: new Float64Array(kernel.COLUMNS), reach: new Float64Array(kernel.COLUMNS) };
    for (let c = 0; c < kernel.COLUMNS; c++) {
      const off = Float64Array.from({ length: count }, (_, d) => found[d * kernel.COLUMNS + c] - values[c]);
      const known = Number.isFinite(values[c]) && off.every(Number.isFinite);
      const mean = known ? off.reduce((a, b) => a + b, 0) / count : 0;
      const squares = known ? off.reduce((a, b) => a + (b - mean) ** 2, 0) / count : 0;
      made.bias[c] = mean;
      made.reach[c] = known ? this.loop.plant.source.constants.detuning.reach * Math.sqrt(squares) : Infinity;
    }
    return made;
  }

  private last: { percent: number; lines: Lines } | null = null;

  /** Lines below half the rate with the controller there, once for a reading and its scatter. */
  private linesAt(percent: number): Lines {
    if (this.last?.percent === percent) return this.last.lines;
    const { controller, integrators, point, plant } = this.loop;
    const { rate_hz } = controller;
    const by = 1 + 0.01 * percent;
    const stretched = this.f.map((x) => x * by);
    const f = stretched.subarray(0, placeIn(stretched, 0.499 * rate_hz));
    const above = this.aboveF.map((x) => x * by);
    const more = this.aboveF.filter((x) => above.length > 0 && x > above[above.length - 1]);
    const aboveF = concat(above, more).filter((x) => x > f[f.length - 1] && x <= 0.45 * rate_hz);
    const C = control.response(controller, f);
    const belowC = this.belowP && control.response(controller, this.belowF.map((x) => x * by));
    const led = belowC && this.belowP ? times(belowC, this.belowP) : null;
    const aboveC2 = kernel.squares(control.response(controller, aboveF));
    const grid = kernel.gridOf(f, kernel.squares(C), aboveF, aboveC2, this.reader);
    const poles = (L: Complex): number | null =>
      countUnstable(L, integrators, point.unstable_poles ?? 0, led, plant.source.constants.fit_deg);
    this.last = { percent, lines: { grid, C, poles } };
    return this.last.lines;
  }
}

function fewerDraws(dense: Dense, count: number): Dense {
  const draws = dense.draws as Draws;
  const few = Math.min(count, draws.count);
  const n = dense.f.length;
  return { ...dense, draws: { count: few, of: draws.count, re: draws.re.subarray(0, few * n), im: draws.im.subarray(0, few * n) } };
}

/** Deviation of the plant at frequencies among its lines, straight between them. */
function deviations({ point, dense }: Plant, at: Real): Real {
  const draws = dense.draws as Draws;
  const { power } = sumsOf(draws, dense.f.length);
  const std = point.f.map((x) => Math.sqrt(power[placeIn(dense.f, x)] / draws.count));
  return at.map((x) => {
    const k = clip(placeIn(point.f, x, true) - 1, 0, point.f.length - 2);
    return std[k] + ((std[k + 1] - std[k]) / (point.f[k + 1] - point.f[k])) * (x - point.f[k]);
  });
}

interface Known {
  f: Real;
  P: Complex;
  std: Real;
  draws: Draws;
}

/** The lines with those before them where a model leads to the first one: as unsure as that. */
function withLed(loop: Loop, own: Known): Known {
  const led = judgedLines(loop)?.led ?? 0;
  if (!led) return own;
  const { led_f, led: ahead } = loop.point;
  const n = own.f.length;
  const { count } = own.draws;
  const [pr, pi] = [own.P.re[0], own.P.im[0]];
  const size = pr * pr + pi * pi;
  const share: Complex = {
    re: ahead.re.map((x, k) => (x * pr + ahead.im[k] * pi) / size),
    im: ahead.re.map((x, k) => (ahead.im[k] * pr - x * pi) / size),
  };
  const draws: Draws = { count, re: new Float64Array(count * (n + led)), im: new Float64Array(count * (n + led)) };
  for (let d = 0; d < count; d++) {
    const [x, y, start] = [own.draws.re[d * n], own.draws.im[d * n], d * (n + led)];
    for (let k = 0; k < led; k++) {
      draws.re[start + k] = share.re[k] * x - share.im[k] * y;
      draws.im[start + k] = share.re[k] * y + share.im[k] * x;
    }
    draws.re.set(own.draws.re.subarray(d * n, (d + 1) * n), start + led);
    draws.im.set(own.draws.im.subarray(d * n, (d + 1) * n), start + led);
  }
  return {
    f: concat(led_f, own.f),
    P: { re: concat(ahead.re, own.P.re), im: concat(ahead.im, own.P.im) },
    std: concat(share.re.map((x, k) => own.std[0] * Math.hypot(x, share.im[k])), own.std),
    draws,
  };
}

const columnOf = (name: string): number | undefined =>
  name === "sensitivity_peak_db" ? kernel.LN_MODULUS : (PLAIN[name] ?? LOGARITHMS[name]);

/** A limit on the scale of the kernel's column. */
function scaled(name: string, value: number): number {
  if (name === "sensitivity_peak_db") return -Math.log(fromDb(value));
  return name in LOGARITHMS ? Math.log(value) : value;
}

type End = -1 | 0 | 1;

/** Slacks of one loop over shifts of its plant. */
class Search {
  private readonly c: Constants["detuning"];
  private readonly closely: boolean;
  private readonly limits: Limit[];
  private readonly columns: number[];
  private readonly signs: number[];
  private readonly wished: number[];
  private readonly bias: number[];
  private readonly known: Record<string, number[]>;
  private readonly shifts: number[];

  constructor(
    private readonly loop: Loop,
    m: Margins,
    requirements: Requirements,
    limits: Limit[],
    private readonly moved: Moved,
  ) {
    const required = requirements.detuning_percent;
    this.c = loop.plant.source.constants.detuning;
    this.closely = typeof required === "number";
    this.limits = limits.filter(({ name }) => columnOf(name) !== undefined && typeof requirements[name] === "number");
    this.columns = this.limits.map(({ name }) => columnOf(name) as number);
    this.signs = this.limits.map(({ name, sense }) => (sense === "at_least" || name === "sensitivity_peak_db" ? 1 : -1));
    this.wished = this.limits.map(({ name }) => scaled(name, requirements[name] as number));
    const now = this.limits.map(({ name }) => scaled(name, m.values[name]));
    this.bias = this.columns.map((c, k) => finite(moved.reading(0).values[c] - now[k]));
    this.known = { "-1": this.knownReach(m, now, -1), "1": this.knownReach(m, now, 1) };
    this.shifts = shiftsOf(loop, this.closely ? (required as number) : null);
  }

  /** How far the bad or good end of the unmoved loop's intervals lies from the estimate. */
  private knownReach(m: Margins, now: number[], end: End): number[] {
    return this.limits.map(({ name }, k) => {
      const interval = m.intervals[name];
      if (!interval) return 0;
      const ends = interval.map((value) => this.signs[k] * (scaled(name, value) - now[k]));
      return finite(end < 0 ? Math.min(...ends) : Math.max(...ends));
    });
  }

  /** What each limit leaves at a shift: of the estimate, or of its interval's bad (-1) or good (1) end. */
  private slacks(percent: number, end: End): number[] {
    const { values } = this.moved.reading(percent);
    return this.columns.map((c, k) => {
      const left = this.signs[k] * (values[c] - this.biasAt(percent, k) - this.wished[k]);
      return end === 0 || !Number.isFinite(left) ? left : left + this.reachAt(percent, end, k);
    });
  }

  private reachAt(percent: number, end: End, k: number): number {
    const own = this.known[String(end)][k];
    if (!this.closely || percent === 0) return own;
    const here = this.moved.scatter(percent).reach[this.columns[k]];
    const before = this.moved.scatter(0).reach[this.columns[k]];
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
    const sure = clear > this.loop.plant.source.constants.reach_95;
    return end < 0 ? balanced && sure : end > 0 ? balanced || !sure : balanced;
  }

  private holds(percent: number, end: End): boolean {
    return this.stable(percent, end) && this.slacks(percent, end).every((slack) => slack >= -this.c.rounding);
  }

  /** The largest shift one way, with its interval. */
  oneWay(way: 1 | -1): Reach {
    const { percent, beyond } = this.firstBreak(way, 0, this.c.searched);
    const low = this.firstBreak(way, -1, percent).percent;
    const high = this.firstBreak(way, 1, this.c.searched).percent;
    const breaks = beyond ? "" : this.what(way, percent);
    return { percent, beyond, breaks, interval: [Math.min(low, percent), Math.max(high, percent)] };
  }

  private firstBreak(way: 1 | -1, end: End, most: number): { percent: number; beyond: boolean } {
    if (!this.holds(0, end)) return { percent: 0, beyond: false };
    let before = 0;
    for (const shift of [...this.shifts.filter((x) => x < most), most]) {
      if (!this.holds(way * shift, end)) return { percent: this.between(way, end, before, shift), beyond: false };
      before = shift;
    }
    return { percent: before, beyond: true };
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

  /** What breaks first beyond a shift, at the nearest one that was looked at. */
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

/** Shifts in per cent that are looked at, all positive. */
function shiftsOf(loop: Loop, required: number | null): number[] {
  const c = loop.plant.source.constants.detuning;
  const farther = (near: Real, more: number[]): number[] => [...near, ...more.filter((x) => x > near[near.length - 1] + 1e-9)];
  if (required === null) return farther(even(c.warned, Math.round(c.warned / c.coarse)), c.fewer);
  const sharpest = Math.min(...seenDampings(loop), sharpestOf(loop.controller));
  const last = Math.max(required, c.warned);
  const near = even(last, Math.ceil(last / clip(50 * sharpest, c.finest, c.fine)));
  return farther(union(near, Float64Array.of(required)), c.outer);
}

const even = (last: number, count: number): Real => Float64Array.from({ length: count }, (_, k) => (k === count - 1 ? last : ((k + 1) * last) / count));

/** Damping of the plant's resonances whose peak matters to L. */
function seenDampings({ point, controller, plant }: Loop): number[] {
  const { matters, near } = plant.source.constants.detuning;
  return point.resonances.filter(({ hz, peak }) => {
    if (hz >= (0.5 * controller.rate_hz) / (1 + near[near.length - 1])) return false;
    const C = control.response(controller, Float64Array.from(near, (x) => hz * (1 + x)));
    return Math.max(...kernel.squares(C)) ** 0.5 * peak > matters;
  }).map(({ damping }) => damping);
}

/** Least damping of the controller's sections, of numerators and denominators; 1 without. */
function sharpestOf({ blocks }: Controller): number {
  const parts = blocks.flatMap((block) => control.section(block)).filter((p) => p[0] * p[2] > 0);
  return Math.min(1, ...parts.map((p) => Math.abs(p[1]) / (2 * Math.sqrt(p[0] * p[2]))).filter((x) => x > 0));
}
