// Loop -> margins, bias-corrected for noise, with 95 % intervals from draws (Python: loop/margins.py).

import { clip, db, fromDb, geometric, magnitudes, placeIn, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import { sumsOf, type Draws } from "../numbers/dense";
import type { Detuning } from "./detuning";
import type { ReadLimit } from "../payload";
import type { Reader } from "./limits";
import { inSight, isLarge, largestAbove, readings, type Judged, type Loop } from "./loop";
import * as kernel from "./reading";
import type { Stability } from "./stability";

const readLimits = new WeakMap<ReadLimit[], [ReadLimit, number][]>();

/** Limits that the kernel reads, each with its column. */
export function columnsOf(limits: ReadLimit[]): [ReadLimit, number][] {
  const made = readLimits.get(limits) ?? limits.flatMap((limit): [ReadLimit, number][] => (limit.column === null ? [] : [[limit, limit.column]]));
  readLimits.set(limits, made);
  return made;
}

/** A quantity from the kernel's column, and back. */
export const valueOf = ({ scale }: ReadLimit, column: number): number =>
  scale === "inverse" ? -db(Math.exp(column)) : scale === "ln" ? Math.exp(column) : column;
export const onColumn = ({ scale }: ReadLimit, value: number): number =>
  scale === "inverse" ? -Math.log(fromDb(value)) : scale === "ln" ? Math.log(value) : value;

export type Interval = [number, number];

/** Margins at one operating point; `settled` tells that bias and intervals are in them. */
export interface Margins {
  values: Record<string, number>;
  intervals: Record<string, Interval>;
  bounds: Record<string, number>;
  at_hz: Record<string, number>;
  /** Holes between the frequencies, in which a reading is a guess. */
  missing_hz: Interval[];
  crossings_hz: number[];
  phase_crossings_hz: number[];
  stability: Stability | null;
  /** What is known of the detuning margin, nothing while it is not. */
  detuning: Detuning | null;
  settled: boolean;
}

/** Margins of a loop; with draws they are bias-corrected and have intervals. */
export function margins(loop: Loop, reader: Reader): Margins {
  const [first, ...others] = readings(loop);
  const { found, at } = nominal(loop, first, reader);
  const own = withIntervals(loop, first, found, reader, true);
  for (const other of others) {
    const its = withIntervals(loop, other, nominal(loop, other, reader).found, reader, true);
    own.low = own.low.map((value, k) => Math.min(value, its.low[k]));
    own.high = own.high.map((value, k) => Math.max(value, its.high[k]));
  }
  const [low, high] = [fields(own.low, reader), fields(own.high, reader)];
  const values = fields(own.value, reader);
  const intervals: Record<string, Interval> = {};
  if (first.draws) {
    for (const name of Object.keys(low).filter((one) => one in high)) {
      intervals[name] = [Math.min(low[name], high[name]), Math.max(low[name], high[name])];
    }
  }
  const ends = bounds(loop, first, found, reader);
  const made = { values, intervals, bounds: ends, at_hz: places(at, first.f[0], reader) };
  const continued = first.f.length > loop.dense.f.length;
  if (!continued && !isLarge(loop) && first.f.length > 1 && first.f[0] > loop.plant.source.constants.at_zero * first.f[1]) boundedBelow(loop, first, made, reader);
  boundedAbove(loop, first, made);
  values.controller_bandwidth_hz = control.bandwidthHz(loop.controller);
  values.detuning_percent = NaN;
  return {
    ...made,
    missing_hz: loop.point.gaps.filter((gap) => gap.missing).map((gap) => gap.hz),
    crossings_hz: unitCrossings(first.f, first.L),
    phase_crossings_hz: axisCrossings(first.f, first.L),
    stability: null,
    detuning: null,
    settled: first.draws !== null,
  };
}

type Measured = Pick<Margins, "values" | "intervals" | "bounds" | "at_hz">;

/** Make a reading a bound: no worse than `value`, at best as it was read, or as `best`. */
function worst(found: Measured, name: string, value: number, at_hz: number, best = found.bounds[name] ?? found.values[name]): void {
  found.bounds[name] = best;
  if (found.intervals[name] && value !== found.values[name]) found.intervals[name] = [value, value];
  [found.values[name], found.at_hz[name]] = [value, at_hz];
}

const size = ({ re, im }: Complex, k: number): number => Math.hypot(re[k], im[k]);

/** What may lie below the first line, where no model tells it and |L| is not large there (`_bounded_below`). */
function boundedBelow(loop: Loop, j: Judged, found: Measured, { limits }: Reader): void {
  const [first_hz, first, hidden] = [j.f[0], size(j.L, 0), !inSight(loop)];
  for (const name of ["bandwidth_hz", "sensitivity_bandwidth_hz"]) {
    if (found.values[name] === 0 || hidden) worst(found, name, 0, first_hz, Math.max(found.values[name], first_hz));
  }
  if (found.values.complementary_bandwidth_hz === 0) worst(found, "complementary_bandwidth_hz", 0, first_hz, first_hz);
  if (!hidden) {
    const below = Float64Array.from(loop.plant.source.constants.below_ratios, (share) => first_hz * share);
    const least = Math.min(...magnitudes(control.response(loop.controller, below)));
    const peak = db(first / Math.max(first - 1, 1e-9) / least);
    if (peak > found.values.process_peak_db) worst(found, "process_peak_db", peak, first_hz);
    return;
  }
  for (const name of ["gain_margin_db", "modulus_margin", "disk_margin"]) worst(found, name, 0, first_hz);
  for (const name of ["sensitivity", "complementary", "control", "process"]) worst(found, `${name}_peak_db`, Infinity, first_hz);
  for (const { name } of limits.filter(({ crossing }) => crossing)) {
    found.values[name] = NaN;
    delete found.bounds[name];
    delete found.intervals[name];
  }
}

/** How far |T| may still rise above the last line, and |PS| (`_bounded_above`). */
function boundedAbove(loop: Loop, j: Judged, found: Measured): void {
  const end = j.f.length - 1;
  const last = Math.max(size(j.L, end), largestAbove(loop));
  if (!aboveHz(loop.f[loop.f.length - 1], loop.controller.rate_hz).length) return;
  const room = Math.max(1 - last, 1e-9);
  if (last / room >= Math.SQRT1_2) worst(found, "complementary_bandwidth_hz", found.values.complementary_bandwidth_hz, j.f[end], Infinity);
  const peak = db(size(j.L, end) / size(j.C, end) / room);
  if (peak > found.values.process_peak_db) worst(found, "process_peak_db", peak, j.f[end]);
}

const grids = new WeakMap<Judged, kernel.Grid>();

function gridOf(loop: Loop, j: Judged, reader: Reader): kernel.Grid {
  const made = grids.get(j) ?? madeGrid(loop, j.f, j.C, reader);
  grids.set(j, made);
  return made;
}

function madeGrid(loop: Loop, f: Real, C: Complex, reader: Reader): kernel.Grid {
  const aboveF = aboveHz(loop.f[loop.f.length - 1], loop.controller.rate_hz);
  const aboveC2 = kernel.squares(control.responseOn(loop.controller, aboveF));
  return kernel.gridOf(f, kernel.squares(C), aboveF, aboveC2, reader, largestAbove(loop));
}

const drawnReadings = new WeakMap<Judged, kernel.Readings>();

/** What every draw reads, once for both ways to end above the last line. */
function readingsOf(grid: kernel.Grid, j: Judged, draws: Draws): kernel.Readings {
  const found = drawnReadings.get(j) ?? kernel.readDraws(grid, j.reference, draws);
  drawnReadings.set(j, found);
  return found;
}

const above = new Map<string, Real>();

export function aboveHz(last: number, rate_hz: number): Real {
  const key = `${last} ${rate_hz}`;
  const made = above.get(key) ?? (last < 0.45 * rate_hz ? geometric(last, 0.45 * rate_hz, 80).subarray(1) : new Float64Array(0));
  above.set(key, made);
  return made;
}

function nominal(loop: Loop, j: Judged, reader: Reader, bounded = true): kernel.Reading {
  const out = kernel.freshReading();
  kernel.read(gridOf(loop, j, reader), j.L.re, j.L.im, bounded, out);
  return out;
}

interface Ends {
  value: Float64Array;
  low: Float64Array;
  high: Float64Array;
}

function withIntervals(loop: Loop, j: Judged, found: Float64Array, reader: Reader, bounded: boolean): Ends {
  if (!j.draws) return { value: found, low: found, high: found };
  if (drowned(j, j.draws)) return { value: found, low: found.map(() => -Infinity), high: found.map(() => Infinity) };
  const grid = gridOf(loop, j, reader);
  const drawn = readingsOf(grid, j, j.draws)[bounded ? "bounded" : "open"];
  const reference = kernel.freshReading();
  kernel.read(grid, j.reference.re, j.reference.im, bounded, reference);
  const out = { value: found.slice(), low: found.slice(), high: found.slice() };
  const { half_width } = loop.plant.source.constants;
  const scatters = scattersOf(reader);
  const chords = betweenLines(loop, j, reference.found, reader, bounded);
  for (let c = 0; c < kernel.COLUMNS; c++) {
    const ordered = Float64Array.from({ length: j.draws.count }, (_, d) => drawn[d * kernel.COLUMNS + c]).sort();
    const usual = ordered.every(Number.isFinite) && Number.isFinite(reference.found[c]) && Number.isFinite(found[c]);
    if (usual && ofOnePiece(ordered) && deviation(ordered) <= (scatters.get(c) ?? Infinity)) {
      out.value[c] = found[c] - (mean(ordered) - reference.found[c]);
      const half = Math.hypot(half_width * deviation(ordered), chords[c]);
      [out.low[c], out.high[c]] = [out.value[c] - half, out.value[c] + half];
    } else {
      const last = ordered.length - 1;
      const k = Math.round(0.025 * last);
      [out.low[c], out.high[c]] = [Math.min(ordered[k], found[c]), Math.max(ordered[last - k], found[c])];
    }
  }
  return out;
}

/** How far columns may be off because lines are joined by chords: half of what changes with every other line. */
function betweenLines(loop: Loop, j: Judged, found: Float64Array, reader: Reader, bounded: boolean): Float64Array {
  const coarse = halvesOf(loop, j, reader).map(({ grid, k }) => {
    const out = kernel.freshReading();
    kernel.read(grid, taken(j.reference.re, k), taken(j.reference.im, k), bounded, out);
    return out.found;
  });
  return found.map((value, c) => {
    const changes = coarse.map((one) => Math.abs(one[c] - value)).filter(Number.isFinite);
    return (0.5 * changes.reduce((a, b) => a + b, 0)) / coarse.length;
  });
}

interface Half {
  grid: kernel.Grid;
  k: number[];
}

const halves = new WeakMap<Judged, Half[]>();

/** Grids of the even and of the odd lines, each with the first and the last. */
function halvesOf(loop: Loop, j: Judged, reader: Reader): Half[] {
  const made = halves.get(j) ?? [0, 1].map((first) => {
    const k = Array.from(j.f.keys()).filter((at) => at % 2 === first || at === 0 || at === j.f.length - 1);
    return { k, grid: madeGrid(loop, taken(j.f, k), { re: taken(j.C.re, k), im: taken(j.C.im, k) }, reader) };
  });
  halves.set(j, made);
  return made;
}

const taken = (values: Real, k: number[]): Real => Float64Array.from(k, (at) => values[at]);

/** Up to which deviation a column scatters as a logarithm, of distances to -1 and of peaks over them. */
const scattersOf = ({ limits }: Reader): Map<number, number> => new Map(columnsOf(limits).map(([{ distance }, k]) => [k, distance]));

const mean = (values: Float64Array): number => values.reduce((a, b) => a + b, 0) / values.length;

function deviation(values: Float64Array): number {
  const middle = mean(values);
  return Math.sqrt(values.reduce((a, b) => a + (b - middle) ** 2, 0) / values.length);
}

/** Whether ordered draws scatter as about one value, and do not jump from one crossing to another. */
function ofOnePiece(ordered: Float64Array): boolean {
  const last = ordered.length - 1;
  const spread = deviation(ordered);
  const core = (ordered[Math.round(0.84 * last)] - ordered[Math.round(0.16 * last)]) / 1.989;
  return spread <= 2 * core + 1e-12 && ordered[last] - ordered[0] >= 4 * spread - 1e-12;
}

/** Whether errors as large as L itself, where L is not small, leave nothing that draws could tell. */
function drowned(j: Judged, draws: Draws): boolean {
  const { power, re, im } = sumsOf(draws, j.f.length);
  let large = 0;
  let lost = 0;
  for (let k = 0; k < j.f.length; k++) {
    const size = Math.hypot(j.L.re[k], j.L.im[k]);
    if (size <= 0.1) continue;
    large += 1;
    const variance = power[k] / draws.count - (re[k] / draws.count) ** 2 - (im[k] / draws.count) ** 2;
    if (Math.sqrt(Math.max(variance, 0)) > 0.7 * size) lost += 1;
  }
  return large > 0 && lost > 0.1 * large;
}

/** How good the quantities may be that what lies above the last line bounds (`_bounds`). */
function bounds(loop: Loop, j: Judged, found: Float64Array, reader: Reader): Record<string, number> {
  const best = nominal(loop, j, reader, false).found;
  const out: Record<string, number> = {};
  for (const [{ name }, k] of columnsOf(reader.limits).filter(([{ open }]) => open)) {
    if (found[k] === Math.log(j.f[j.f.length - 1])) out[name] = Infinity;
  }
  const bounded = found.map((value, k) => (value === best[k] ? 0 : 1));
  if (!bounded.some(Boolean)) return out;
  const { low, high } = withIntervals(loop, j, best, reader, false);
  const better = best.map((value, k) =>
    bounded[k] ? (value > found[k] ? Math.max(low[k], high[k]) : Math.min(low[k], high[k])) : NaN,
  );
  for (const [name, value] of Object.entries(fields(better, reader))) if (!Number.isNaN(value)) out[name] = value;
  return out;
}

/** Quantities by name from the kernel's columns; a bias taken off may lead out of what can be. */
function fields(columns: Float64Array, { limits }: Reader): Record<string, number> {
  const out: Record<string, number> = {};
  for (const [limit, k] of columnsOf(limits)) {
    if (limit.asked && !(columns[k] > -Infinity)) continue;
    const value = valueOf(limit, columns[k]);
    out[limit.name] = limit.ceiling !== null && Number.isFinite(value) ? clip(value, 0, limit.ceiling) : value;
  }
  return out;
}

function places(at: Float64Array, first_hz: number, { limits }: Reader): Record<string, number> {
  const known = columnsOf(limits).filter(([, k]) => Number.isFinite(at[k]));
  return Object.fromEntries(known.map(([{ name }, k]) => [name, at[k] > 1e-3 * first_hz ? at[k] : 0]));
}

/** Frequencies in Hz where |L| = 1; between lines ln L is linear in ln f. */
export function unitCrossings(f: Real, L: Complex): number[] {
  const size = L.re.map((re, k) => 0.5 * Math.log(re * re + L.im[k] * L.im[k]));
  const out: number[] = [];
  for (let k = 0; k < f.length; k++) {
    if (size[k] === 0) out.push(f[k]);
    if (k + 1 < f.length && size[k] * size[k + 1] < 0) {
      out.push(f[k] * (f[k + 1] / f[k]) ** (size[k] / (size[k] - size[k + 1])));
    }
  }
  return out;
}

/** Frequencies in Hz where L crosses the negative real axis, along chords. */
export function axisCrossings(f: Real, L: Complex): number[] {
  const out: number[] = [];
  for (let k = 0; k < f.length; k++) {
    if (L.im[k] === 0 && L.re[k] < 0) out.push(f[k]);
    if (k + 1 >= f.length || L.im[k] * L.im[k + 1] >= 0) continue;
    const share = L.im[k] / (L.im[k] - L.im[k + 1]);
    if (L.re[k] + share * (L.re[k + 1] - L.re[k]) < 0) out.push(f[k] + share * (f[k + 1] - f[k]));
  }
  return out;
}

/** Where in a gap of rising frequencies one lies: the line before it. */
export function gapOf(f: Real, at: number): number {
  return clip(placeIn(f, at, true) - 1, 0, f.length - 2);
}
