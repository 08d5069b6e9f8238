// Loop -> margins, bias-corrected for noise, with 95 % intervals from draws (Python: loop/margins.py).

import { clip, db, deg, fromDb, geometric, magnitudes, placeIn, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import type { Detuning } from "./detuning";
import { disturbedUnder, rmsUnder, type Rms } from "./disturbed";
import type { ReadLimit } from "../payload";
import { DISTURBED, MASKED, weights, type Reader } from "./limits";
import type { Draws } from "../numbers/dense";
import { inSight, isLarge, largestAbove, readings, type Judged, type Loop } from "./loop";
import * as kernel from "./reading";
import { hiddenIn, type Stability } from "./stability";

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
  stability: Stability | null;
  /** What is known of the detuning margin, nothing while it is not. */
  detuning: Detuning | null;
  /** What the loop makes of what disturbed it, if it is stable; null where that is not known. */
  disturbed: Rms | null;
  settled: boolean;
}

/** Margins of a loop; with draws they are bias-corrected and have intervals. */
export function margins(loop: Loop, reader: Reader): Margins {
  const ways = readings(loop);
  const [first] = ways;
  const grid = gridOf(loop, first, reader);
  const scans = scansOf(loop, ways, grid);
  const read = readOf(grid, scans[0], true);
  const { at } = read.rows;
  const found = Float64Array.from(read.rows.found, (own, c) => kernel.inUnits(c, own[0]));
  const own = withIntervals(loop, first, read, reader);
  const ends = { value: own.value, low: own.low.slice(), high: own.high.slice() };
  const like = { ...read, ...own };
  for (let m = 1; m < ways.length; m++) {
    const { draws } = ways[m];
    if (sameScans(scans[m], scans[0], grid) && !(draws && drowned(ways[m], draws))) continue;
    const its = withIntervals(loop, ways[m], readOf(grid, scans[m], true), reader, like);
    its.low.forEach((value, c) => (ends.low[c] = Math.min(ends.low[c], value)));
    its.high.forEach((value, c) => (ends.high[c] = Math.max(ends.high[c], value)));
  }
  const [values, low, high] = [ends.value, ends.low, ends.high].map((columns) => fields(columns, reader));
  const intervals: Record<string, Interval> = {};
  if (first.draws) {
    for (const name of Object.keys(low).filter((one) => one in high)) {
      intervals[name] = [Math.min(low[name], high[name]), Math.max(low[name], high[name])];
    }
  }
  const best = bounds(loop, first, found, readOf(grid, scans[0], false), reader, like);
  const made = { values, intervals, bounds: best, at_hz: places(at, first.f[0], reader) };
  const continued = first.f.length > loop.dense.f.length;
  if (!continued && !isLarge(loop) && first.f.length > 1 && first.f[0] > loop.plant.source.constants.at_zero * first.f[1]) boundedBelow(loop, first, made, reader);
  boundedAbove(loop, first, made, reader);
  boundedBetween(loop, first, made, reader);
  values.controller_bandwidth_hz = control.bandwidthHz(loop.controller);
  values.detuning_percent = NaN;
  readDisturbed(loop, made, reader, first.draws !== null);
  return {
    ...made,
    missing_hz: loop.point.gaps.filter((gap) => gap.missing).map((gap) => gap.hz),
    stability: null,
    detuning: null,
    disturbed: loop.point.disturbed && rmsUnder(loop.point.disturbed, loop.controller),
    settled: first.draws !== null,
  };
}

type Measured = Pick<Margins, "values" | "intervals" | "bounds" | "at_hz">;

/** Rms, peak and rate where they are asked about; estimates leave out how a record differs from noise. */
function readDisturbed({ point, controller, plant }: Loop, { values, intervals }: Measured, { limits, ranged }: Reader, whole: boolean): void {
  const asked = limits.filter(({ name }) => DISTURBED.includes(name));
  if (!point.disturbed || !asked.length || ranged) return;
  const found = disturbedUnder(point.disturbed, controller, plant.source.constants.record, asked.map(({ name }) => name), whole);
  for (const { name } of asked.filter((limit) => limit.name in found)) {
    values[name] = found[name].value;
    if (whole) intervals[name] = found[name].interval;
  }
}

/** Make a reading a bound: no worse than `value`, at best as it was read, or as `best`. */
function worst(found: Measured, { limits }: Reader, name: string, value: number, at_hz: number, best?: number): void {
  const good = limits.find((limit) => limit.name === name)?.sense === "at_least" ? Math.max : Math.min;
  found.bounds[name] = best ?? found.bounds[name] ?? good(...(found.intervals[name] ?? [found.values[name]]));
  if (found.intervals[name] && value !== found.values[name]) found.intervals[name] = [value, value];
  [found.values[name], found.at_hz[name]] = [value, at_hz];
}

const size = ({ re, im }: Complex, k: number): number => Math.sqrt(re[k] * re[k] + im[k] * im[k]);

/** What may lie below the first line, where no model tells it and |L| is not large there (`_bounded_below`). */
function boundedBelow(loop: Loop, j: Judged, found: Measured, reader: Reader): void {
  const [first_hz, first, hidden] = [j.f[0], size(j.L, 0), !inSight(loop)];
  for (const name of ["bandwidth_hz", "sensitivity_bandwidth_hz"]) {
    if (found.values[name] === 0 || hidden) worst(found, reader, name, 0, first_hz, Math.max(found.values[name], first_hz));
  }
  if (found.values.complementary_bandwidth_hz === 0) worst(found, reader, "complementary_bandwidth_hz", 0, first_hz, first_hz);
  if (!hidden) {
    const below = Float64Array.from(loop.plant.source.constants.below_ratios, (share) => first_hz * share);
    const least = Math.min(...magnitudes(control.response(loop.controller, below)));
    const peak = db(first / Math.max(first - 1, 1e-9) / least);
    if (peak > found.values.process_peak_db) worst(found, reader, "process_peak_db", peak, first_hz);
    return;
  }
  for (const name of ["gain_margin_db", "modulus_margin", "disk_margin"]) worst(found, reader, name, 0, first_hz);
  for (const name of ["sensitivity", "complementary", "control", "process"]) worst(found, reader, `${name}_peak_db`, Infinity, first_hz);
  for (const { name } of reader.limits.filter(({ crossing }) => crossing)) {
    found.values[name] = NaN;
    delete found.bounds[name];
    delete found.intervals[name];
  }
}

/** How far |T| may still rise above the last line, and |PS| (`_bounded_above`). */
function boundedAbove(loop: Loop, j: Judged, found: Measured, reader: Reader): void {
  const end = j.f.length - 1;
  const last = Math.max(size(j.L, end), largestAbove(loop));
  if (!aboveHz(loop.f[loop.f.length - 1], loop.controller.rate_hz).length) return;
  const room = Math.max(1 - last, 1e-9);
  if (last / room >= Math.SQRT1_2) worst(found, reader, "complementary_bandwidth_hz", found.values.complementary_bandwidth_hz, j.f[end], Infinity);
  const peak = db(size(j.L, end) / size(j.C, end) / room);
  if (peak > found.values.process_peak_db) worst(found, reader, "process_peak_db", peak, j.f[end]);
}

/** What a resonance that lines which are missing do not show makes of each limit at worst (`_bounded_between`). */
function boundedBetween(loop: Loop, { f, L, C }: Judged, found: Measured, reader: Reader): void {
  const gaps = hiddenIn(loop).filter(({ missing, hz }) => missing && hz[1] <= f[f.length - 1]);
  if (!gaps.length) return;
  const weighed = weights(reader.masks, Float64Array.from(gaps.flatMap(({ hz }) => hz)));
  const each = gaps.map(({ hz, moved }, k) => {
    let [near, least, most, leastC, mostC] = [Infinity, Infinity, 0, Infinity, 0];
    for (let i = placeIn(f, hz[0]); i < placeIn(f, hz[1], true); i++) {
      const [own, c] = [size(L, i), size(C, i)];
      near = Math.min(near, Math.hypot(1 + L.re[i], L.im[i]));
      [least, most, leastC, mostC] = [Math.min(least, own), Math.max(most, own), Math.min(leastC, c), Math.max(mostC, c)];
    }
    const [room, low, high] = [Math.max(near - moved, 0), Math.max(least - moved, 0), most + moved];
    const responses = [1 / room, high / room, mostC / room, high / room / leastC, high, 1 / low];
    const phase = low < 1 && high > 1 ? 2 * deg(Math.asin(Math.min(0.5 * room, 1))) : Infinity;
    const made: Record<string, number> = {
      modulus_margin: room,
      disk_margin: (2 * room) / (1 + high),
      sensitivity_peak_db: db(responses[0]),
      complementary_peak_db: db(responses[1]),
      control_peak_db: db(responses[2]),
      process_peak_db: db(responses[3]),
      control_high_frequency_db: hz[1] >= reader.fromHz ? db(responses[2]) : -Infinity,
      gain_margin_db: -db(Math.min(Math.max(1 - room, 0), high)),
      gain_reduction_margin_db: high > 1 ? db(Math.max(1 + room, low)) : Infinity,
      phase_margin_deg: phase,
      delay_margin_s: phase / 360 / hz[1],
      bandwidth_hz: least > 1 && low < 1 ? hz[0] : Infinity,
      sensitivity_bandwidth_hz: 2 * room ** 2 < 1 ? hz[0] : Infinity,
    };
    weighed?.forEach((row, m) => {
      const weight = Math.max(row[2 * k], row[2 * k + 1]);
      made[MASKED[m]] = weight > 0 ? 0.5 * db(weight * responses[m] ** 2) : -Infinity;
    });
    return made;
  });
  for (const { name, sense } of reader.limits.filter(({ name }) => name in each[0] && name in found.values)) {
    const falls = sense === "at_least";
    const k = each.reduce((best, made, i) => ((falls ? made[name] < each[best][name] : made[name] > each[best][name]) ? i : best), 0);
    const [value, at, { hz }] = [each[k][name], found.at_hz[name] ?? 0, gaps[k]];
    if (!(falls ? value < found.values[name] : value > found.values[name])) continue;
    const guessed = gaps.some((gap) => gap.hz[0] < at && at < gap.hz[1]); // read off the lines on both sides
    worst(found, reader, name, value, Math.sqrt(hz[0] * hz[1]), guessed ? (falls ? Infinity : -Infinity) : undefined);
  }
}

function gridOf(loop: Loop, { f, C }: Judged, reader: Reader): kernel.Grid {
  const aboveF = aboveHz(loop.f[loop.f.length - 1], loop.controller.rate_hz);
  const aboveC2 = kernel.squares(control.responseOn(loop.controller, aboveF));
  return kernel.gridOf(f, kernel.squares(C), aboveF, aboveC2, reader, largestAbove(loop));
}

/** Scans of all lines, and of the reference on the even and on the odd ones, each with the first and the last. */
interface Scans {
  own: kernel.Scan;
  halves: kernel.Scan[];
}

/** What the lines tell with each model of those below them: from the first line on they are scanned once. */
function scansOf(loop: Loop, ways: Judged[], grid: kernel.Grid): Scans[] {
  const [first] = ways;
  const [every, ...halves] = kernel.linesOf(grid.f.length);
  const below = every.length - loop.dense.f.length;
  const each = (lines: Int32Array, rows: (j: Judged) => kernel.Rows): kernel.Scan[] => {
    const from = lines.findIndex((k) => k >= below);
    const upper = kernel.scan(grid, rows(first), lines.subarray(from), !below);
    const lower = lines.subarray(0, from + 1);
    return ways.map((j) => (below ? kernel.joined(kernel.scan(grid, rows(j), lower, true, upper.floors), upper) : upper));
  };
  const own = each(every, (j) => j);
  const coarse = first.draws ? halves.map((lines) => each(lines, (j) => ({ L: j.reference }))) : [];
  return own.map((one, m) => ({ own: one, halves: coarse.map((half) => half[m]) }));
}

const sameScans = (one: Scans, other: Scans, grid: kernel.Grid): boolean =>
  kernel.endsAlike(one.own, other.own, grid) && one.halves.every((half, k) => kernel.endsAlike(half, other.halves[k], grid));

/** Columns of L, its reference and its draws, and of the reference on every other line. */
interface Read {
  rows: kernel.Readings;
  halves: kernel.Readings[];
}

const readOf = (grid: kernel.Grid, { own, halves }: Scans, bounded: boolean): Read => ({
  rows: kernel.ended(grid, own, bounded),
  halves: halves.map((half) => kernel.ended(grid, half, bounded)),
});

const above = new Map<string, Real>();

export function aboveHz(last: number, rate_hz: number): Real {
  const key = `${last} ${rate_hz}`;
  const made = above.get(key) ?? (last < 0.45 * rate_hz ? geometric(last, 0.45 * rate_hz, 80).subarray(1) : new Float64Array(0));
  above.set(key, made);
  return made;
}

interface Ends {
  value: Float64Array;
  low: Float64Array;
  high: Float64Array;
}

/** Each column freed of its bias, with the ends of its interval; one that was read so before has its ends of then. */
function withIntervals(loop: Loop, j: Judged, read: Read, reader: Reader, like?: Read & Ends): Ends {
  const value = Float64Array.from(read.rows.found, (own, c) => kernel.inUnits(c, own[0]));
  if (!j.draws) return { value, low: value, high: value };
  if (drowned(j, j.draws)) return { value, low: value.map(() => -Infinity), high: value.map(() => Infinity) };
  const out = { value: value.slice(), low: value.slice(), high: value.slice() };
  for (const [{ distance }, c] of columnsOf(reader.limits)) {
    const same = like && sameIn(like.rows, read.rows, c) && like.halves.every((half, k) => sameIn(half, read.halves[k], c));
    const ends = same ? [like.value[c], like.low[c], like.high[c]] : endsOf(c, read, loop.plant.source.constants.half_width, distance);
    [out.value[c], out.low[c], out.high[c]] = ends;
  }
  return out;
}

function sameIn(one: kernel.Readings, other: kernel.Readings, c: number): boolean {
  const [mine, its] = [one.found[c], other.found[c]];
  for (let r = 0; r < mine.length; r++) if (mine[r] !== its[r]) return false;
  return true;
}

/** One column without its bias, and the ends of its interval. */
function endsOf(c: number, { rows, halves }: Read, half_width: number, scatters: number): [number, number, number] {
  const values = rows.found[c].map((value) => kernel.inUnits(c, value));
  const [found, reference] = values;
  const ordered = values.subarray(2).sort();
  const last = ordered.length - 1;
  if ([ordered[0], ordered[last], reference, found].every(Number.isFinite) && ofOnePiece(ordered) && deviation(ordered) <= scatters) {
    const value = found - (mean(ordered) - reference);
    const half = Math.hypot(half_width * deviation(ordered), betweenLines(c, halves, reference));
    return [value, value - half, value + half];
  }
  const k = Math.round(0.025 * last);
  return [found, Math.min(ordered[k], found), Math.max(ordered[last - k], found)];
}

/** How far a column may be off because lines are joined by chords: half of what changes with every other line. */
function betweenLines(c: number, halves: kernel.Readings[], value: number): number {
  const changes = halves.map(({ found }) => Math.abs(kernel.inUnits(c, found[c][0]) - value)).filter(Number.isFinite);
  return (0.5 * changes.reduce((a, b) => a + b, 0)) / halves.length;
}

function mean(values: Float64Array): number {
  let total = 0;
  for (let d = 0; d < values.length; d++) total += values[d];
  return total / values.length;
}

function deviation(values: Float64Array): number {
  const middle = mean(values);
  let total = 0;
  for (let d = 0; d < values.length; d++) total += (values[d] - middle) ** 2;
  return Math.sqrt(total / values.length);
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
  const own = lostLines(j, draws, j.f.length - (j.measured?.f.length ?? 0));
  const [large, lost] = j.measured?.draws ? lostOf(j.measured, j.measured.draws).map((count, k) => count + own[k]) : own;
  return large > 0 && lost > 0.1 * large;
}

const known = new WeakMap<Judged, [number, number]>();

function lostOf(j: Judged, draws: Draws): [number, number] {
  const made = known.get(j) ?? lostLines(j, draws, j.f.length);
  known.set(j, made);
  return made;
}

/** Of the first lines, how many are not small, and in how many of these errors are as large as L. */
function lostLines({ L, factor }: Judged, draws: Draws, count: number): [number, number] {
  const out: [number, number] = [0, 0];
  for (let k = 0; k < count; k++) {
    const large = size(L, k);
    if (large <= 0.1) continue;
    out[0] += 1;
    if (size(factor, k) * draws[k].std > 0.7 * large) out[1] += 1;
  }
  return out;
}

/** How good the quantities may be that what lies above the last line bounds (`_bounds`). */
function bounds(loop: Loop, j: Judged, found: Float64Array, open: Read, reader: Reader, like: Read & Ends): Record<string, number> {
  const best = open.rows.found.map((own, c) => kernel.inUnits(c, own[0]));
  const out: Record<string, number> = {};
  for (const [{ name }, k] of columnsOf(reader.limits).filter(([{ open }]) => open)) {
    if (found[k] === Math.log(j.f[j.f.length - 1])) out[name] = Infinity;
  }
  if (best.every((value, k) => value === found[k])) return out;
  const { low, high } = withIntervals(loop, j, open, reader, like);
  const better = found.map((value, k) =>
    value === best[k] ? NaN : best[k] > value ? Math.max(low[k], high[k]) : Math.min(low[k], high[k]),
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
