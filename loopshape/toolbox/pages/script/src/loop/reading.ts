// The margins of open loops on the same lines: one pass over the lines for all of them (Python: core/kernels/margins.py).

import type { Complex, Real } from "../numbers/arrays";
import type { Draws } from "../numbers/dense";
import type { ReadLimit } from "../payload";
import { weights, type Reader } from "./limits";
import { chord } from "./turns";

/** What a column of a reading holds. */
export const GAIN_DB = 0;
export const REDUCTION_DB = 1;
export const PHASE_DEG = 2;
export const LN_DELAY_S = 3;
export const LN_MODULUS = 4;
export const COMPLEMENTARY_DB = 5;
export const CONTROL_DB = 6;
export const CONTROL_HIGH_DB = 7;
export const LN_BANDWIDTH_HZ = 8;
export const LN_DISK = 9;
export const PROCESS_DB = 10;
export const LN_SENSITIVITY_HZ = 11;
export const LN_COMPLEMENTARY_HZ = 12;
/** By how much |S|, |T|, |CS|, |PS| and |L| exceed their masks, and a floor exceeds |L|, in the order of the masks' rows. */
export const MASK_S = 13;
export const MASK_T = 14;
export const MASK_CS = 15;
export const MASK_PS = 16;
export const MASK_L = 17;
export const FLOOR_L = 18;
export const COLUMNS = 19;
const DB = 10 / Math.LN10;
const DEG = 180 / Math.PI;
const TINY = 1e-300;
const OVER_MASKS = [MASK_S, MASK_T, MASK_CS, MASK_PS, MASK_L, FLOOR_L];
const LARGEST = [COMPLEMENTARY_DB, CONTROL_DB, CONTROL_HIGH_DB, PROCESS_DB, ...OVER_MASKS];
const RISING = [LN_BANDWIDTH_HZ, LN_SENSITIVITY_HZ, LN_COMPLEMENTARY_HZ];

/** A first frequency below this share of the second stands for 0 Hz; |L| from which on nothing below it matters. */
const [AT_ZERO, LARGE] = [1e-4, 10];

/** Frequencies of the lines with |C|² on them, and the largest |C|² above the last: of all, and where it counts as high.
 * Masks weigh squared magnitudes on the lines; above the last one `over` has what the largest of them comes to; |L|
 * stays below its last value there, or `least`. */
export interface Grid {
  f: Real;
  c2: Real;
  fromHz: number;
  most: Peak;
  mostHigh: Peak;
  masks: Real[] | null;
  over: Peak[];
  least: number;
  /** Bits of the quantities that are asked about (`READ`), |S| among them. */
  asked: number;
  asksReduction: boolean;
}

interface Peak {
  size: number;
  hz: number;
}

/** A grid; `aboveF` and `aboveC2` go on above the last line. */
export function gridOf(f: Real, c2: Real, aboveF: Real, aboveC2: Real, { fromHz, masks, limits }: Reader, least: number): Grid {
  const most = { size: -1, hz: NaN };
  const mostHigh = { size: -1, hz: NaN };
  for (let i = 0; i < aboveF.length; i++) {
    for (const peak of aboveF[i] >= fromHz ? [most, mostHigh] : [most]) {
      if (aboveC2[i] > peak.size) Object.assign(peak, { size: aboveC2[i], hz: aboveF[i] });
    }
  }
  return { f, c2, fromHz, most, mostHigh, masks: weights(masks, f), over: largestOver(weights(masks, aboveF), aboveF, aboveC2), least, asked: askedOf(limits), asksReduction: limits.some(({ column }) => column === REDUCTION_DB) };
}

/** Above the last line, the largest weight of each quantity, with what |C|² adds to it. */
function largestOver(masks: Real[] | null, f: Real, c2: Real): Peak[] {
  return (masks ?? []).map((row, quantity) => {
    const peak = { size: 0, hz: NaN };
    row.forEach((weight, i) => {
      const size = weight * [1, 1, c2[i], 1 / Math.max(c2[i], TINY), 1, 1][quantity];
      if (size > peak.size) Object.assign(peak, { size, hz: f[i] });
    });
    return peak;
  });
}

export function squares({ re, im }: Complex): Real {
  const out = new Float64Array(re.length);
  for (let k = 0; k < re.length; k++) out[k] = re[k] * re[k] + im[k] * im[k];
  return out;
}

/** Open loops on lines: L itself, and where there are draws its reference, to which `factor` times each is added. */
export interface Rows {
  L: Complex;
  reference?: Complex;
  factor?: Complex;
  draws?: Draws | null;
}

/** Margins by column of each row, and where those of the first row lie in Hz. */
export interface Readings {
  found: Float64Array[];
  at: Float64Array;
}

/** What lines tell by themselves, magnitudes squared; |L|² on the first and the last of them, |1 + L|² on the last. */
export interface Scan extends Readings {
  /** Whether |S| starts above -3 dB, or rose to it. */
  sensed: Uint8Array;
  first: Float64Array;
  last: Float64Array;
  lastAway: Float64Array;
  /** Frequencies of the first line, the second and the last. */
  ends: [number, number, number];
  /** What the largest of each quantity is at least, in every row. */
  floors: Float64Array;
}

const isRising = Array.from({ length: COLUMNS }, (_, c) => LARGEST.includes(c) || RISING.includes(c));

/** Equal parts of an array. */
const pieces = (whole: Float64Array, count: number): Float64Array[] =>
  Array.from({ length: count }, (_, k) => whole.subarray((k * whole.length) / count, ((k + 1) * whole.length) / count));

const copied = (columns: Float64Array[]): Float64Array[] => pieces(new Float64Array(columns[0].buffer.slice(0)), COLUMNS);

/** Open loops on one line: L, and the squares of |L|, |1 + L| and |1 - L|. */
class Place {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly size: Float64Array;
  readonly away: Float64Array;
  readonly mirrored: Float64Array;

  constructor(count: number) {
    [this.x, this.y, this.size, this.away, this.mirrored] = pieces(new Float64Array(5 * count), 5);
  }

  fill({ L, reference, factor, draws }: Rows, k: number): void {
    const { x, y, size, away, mirrored } = this;
    [x[0], y[0]] = [L.re[k], L.im[k]];
    if (reference && factor && draws) {
      const { re, im } = draws[k];
      const [cr, ci, rr, ri] = [factor.re[k], factor.im[k], reference.re[k], reference.im[k]];
      [x[1], y[1]] = [rr, ri];
      for (let d = 0; d < re.length; d++) {
        x[d + 2] = rr + (re[d] * cr - im[d] * ci);
        y[d + 2] = ri + (re[d] * ci + im[d] * cr);
      }
    }
    for (let r = 0; r < x.length; r++) {
      const y2 = y[r] * y[r];
      size[r] = x[r] * x[r] + y2;
      away[r] = (1 + x[r]) * (1 + x[r]) + y2;
      mirrored[r] = (1 - x[r]) * (1 - x[r]) + y2;
    }
  }
}

const numbered = new Map<number, Int32Array[]>();

/** All of so many lines, and the even and the odd ones, each with the first and the last. */
export function linesOf(count: number): Int32Array[] {
  const known = numbered.get(count);
  if (known) return known;
  const every = Int32Array.from({ length: count }, (_, k) => k);
  const made = [every, ...[0, 1].map((half) => every.filter((k) => k % 2 === half || k === 0 || k === count - 1))];
  numbered.set(count, made);
  return made;
}

const places = new Map<number, [Place, Place]>();

/** Two places to scan with, which the next scan overwrites. */
function placesOf(count: number): [Place, Place] {
  const made = places.get(count) ?? [new Place(count), new Place(count)];
  places.set(count, made);
  return made;
}

/** What some of the grid's lines tell, in their order; `begins` where none lies below them. Nothing is found of lines that
 * can tell no more than others of which `floors` are known. */
export function scan(grid: Grid, rows: Rows, lines: ArrayLike<number>, begins = true, floors: Float64Array = new Float64Array(QUANTITIES)): Scan {
  const count = rows.draws ? rows.draws[0].count + 2 : 1;
  const ones = new Float64Array(count).fill(1);
  let [before, now] = placesOf(count);
  const hz = (i: number): number => grid.f[lines[i]];
  const out: Scan = {
    found: [], at: new Float64Array(COLUMNS).fill(NaN), sensed: new Uint8Array(count), first: ones, last: ones, lastAway: ones,
    ends: [hz(0), hz(1), hz(lines.length - 1)], floors: floors.slice(),
  };
  const needed = neededOf(grid, rows, lines, out.floors);
  const all = grid.asked | CHORD;
  const isBare = needed?.every((bits) => !bits) ?? false;
  if (!isBare) {
    out.found = pieces(new Float64Array(COLUMNS * count), COLUMNS);
    out.found.forEach((column, c) => column.fill(isRising[c] ? -Infinity : Infinity));
  }
  for (let i = 0; i < (isBare ? 1 : lines.length); i++) {
    const bits = needed ? needed[i] : all;
    if (!bits && i && i < lines.length - 1) continue;
    now.fill(rows, lines[i]);
    if (bits) alone(grid, lines[i], now, ones, bits, out);
    if (i && bits & CHORD) chords(hz(i - 1), hz(i), before, now, out);
    if (!i) {
      out.first = now.size.slice();
      if (begins || isBare) now.away.forEach((away, r) => (out.sensed[r] = away <= 2 ? 1 : 0));
    }
    [before, now] = [now, before];
  }
  [out.last, out.lastAway] = [before.size.slice(), before.away.slice()];
  if (!needed) floorsOf(out);
  return out;
}

/** |CS| where it counts as high, |S|, |T|, |CS|, |PS|, |1 - L|/|1 + L|, those over their masks, and a floor over |L|: where
 * each is read, bit by bit of what a line may tell; and that its chord from the line before may. */
const READ = [CONTROL_HIGH_DB, LN_MODULUS, COMPLEMENTARY_DB, CONTROL_DB, PROCESS_DB, LN_DISK, ...OVER_MASKS];
const QUANTITIES = READ.length;
const [CHORD, USED] = [1 << QUANTITIES, 2 << QUANTITIES];

/** Bits of what some limits are read from: |S| always, for what comes nearest to -1 is drawn in front. */
const askedOf = (limits: ReadLimit[]): number => READ.reduce((bits, column, q) => (q === 1 || limits.some((limit) => limit.column === column) ? bits | (1 << q) : bits), 0);

function quantities({ f, c2, fromHz, masks }: Grid, k: number, L: number, far: number, T: number, mirrored: number, out: Float64Array): void {
  const c = Math.sqrt(c2[k]);
  [out[1], out[2], out[3], out[4], out[5]] = [1 / far, T, c / far, T / c, mirrored / far];
  out[0] = f[k] >= fromHz ? out[3] : 0;
  if (!masks) return;
  for (let q = 0; q < 4; q++) out[6 + q] = Math.sqrt(masks[q][k]) * out[1 + q];
  out[10] = Math.sqrt(masks[4][k]) * L;
}

const ROUNDING = 1e-12;

/** What the largest of each quantity is, where one row was read from all lines. */
function floorsOf({ found, floors }: Scan): void {
  if (found[0].length > 1) return;
  READ.forEach((column, q) => {
    const square = isRising[column] ? found[column][0] : 1 / found[column][0];
    if (square > 0 && square < Infinity) floors[q] = Math.max(floors[q], Math.sqrt(square) * (1 - ROUNDING));
  });
}

/** What each line can tell of a row, in bits: errors move L by a radius at most. Null where all can tell all. */
function neededOf(grid: Grid, { L, reference = L, factor, draws }: Rows, lines: ArrayLike<number>, floors: Float64Array): Uint16Array | null {
  if ((!draws && !floors.some(Boolean)) || grid.masks?.[5].some(Boolean)) return null;
  const n = lines.length;
  const most = new Float64Array(n * QUANTITIES);
  const mostHere = new Float64Array(QUANTITIES);
  const nearest = new Float64Array(n).fill(Infinity);
  const out = new Uint16Array(n);
  const least = new Float64Array(QUANTITIES);
  const nothing: Disk = { x: 0, y: 0, moved: 0, size: 0, far: 0, leastT: 0, mostT: 0 };
  let [before, now] = [{ ...nothing }, { ...nothing }];
  for (let i = 0; i < n; i++) {
    const k = lines[i];
    const [x, y] = [reference.re[k], reference.im[k]];
    const [l, far, mirrored] = [size(x, y), size(1 + x, y), size(1 - x, y)];
    const drawn = draws && factor ? size(factor.re[k], factor.im[k]) * draws[k].most : 0;
    const moved = Math.max(drawn, size(L.re[k] - x, L.im[k] - y)) + ROUNDING * (1 + l);
    const inverse = l > moved ? moved / (l * (l - moved)) : Infinity; // how far 1/L moves, by which a large |T| does
    const [leastT, mostT] = [1 / (far / l + inverse), far / l > inverse ? 1 / (far / l - inverse) : Infinity];
    const [lower, upper] = [Math.max(l - moved, 0), Math.max(far - moved, 1e-150)];
    quantities(grid, k, lower, far + moved, Math.max(lower / (far + moved), leastT), Math.max(mirrored - moved, 0), least);
    quantities(grid, k, l + moved, upper, Math.min((l + moved) / upper, mostT), mirrored + moved, mostHere);
    most.set(mostHere, i * QUANTITIES);
    for (let q = 0; q < QUANTITIES; q++) if (least[q] > floors[q]) floors[q] = least[q];
    [now.x, now.y, now.moved, now.size, now.far, now.leastT, now.mostT] = [x, y, moved, l, far, least[2], mostHere[2]];
    if (i) {
      nearest[i] = chord(reference, lines[i - 1], k) - Math.max(moved, before.moved);
      if (mayCross(before, now)) out[i] = CHORD;
    }
    [before, now] = [now, before];
  }
  for (let i = 0; i < n; i++) {
    for (let q = 0; q < QUANTITIES; q++) if (most[i * QUANTITIES + q] >= floors[q] && most[i * QUANTITIES + q] > 0) out[i] |= grid.asked & (1 << q);
    if (nearest[i] * floors[1] <= 1) out[i] |= CHORD;
    if (i && out[i] & CHORD) out[i - 1] |= USED;
  }
  return out;
}

/** Whether errors allow |L|, its phase, |S| or |T| to pass a level between two lines. */
function mayCross(a: Disk, b: Disk): boolean {
  const clear = (one: number, other: number, level: number): boolean =>
    (one - a.moved > level && other - b.moved > level) || (one + a.moved < level && other + b.moved < level);
  const ofT = Math.min(a.leastT, b.leastT) > Math.SQRT1_2 || Math.max(a.mostT, b.mostT) < Math.SQRT1_2;
  return !(ofT && clear(a.size, b.size, 1) && clear(a.far, b.far, Math.SQRT2) && (clear(a.y, b.y, 0) || (a.x > a.moved && b.x > b.moved)));
}

/** Where errors may move L on a line: a disk about x, y, and what |L|, |1 + L| and |T| are there. */
interface Disk {
  x: number;
  y: number;
  moved: number;
  size: number;
  far: number;
  leastT: number;
  mostT: number;
}

const size = (x: number, y: number): number => Math.sqrt(x * x + y * y);

/** What one line tells by itself, of the quantities whose bits are set. */
function alone({ f, c2, fromHz, masks }: Grid, k: number, { size, away, mirrored }: Place, ones: Float64Array, bits: number, { found, at }: Scan): void {
  const c = c2[k];
  for (let q = 0; q < (masks ? QUANTITIES : 6); q++) {
    if (!(bits & (1 << q))) continue;
    const own = found[READ[q]];
    const known = own[0];
    if (q === 1) least(own, away, ones);
    else if (q === 5) least(own, away, mirrored);
    else {
      // |S|, |T|, |CS| and |PS| are 1, |L|, |C| and |L/C| over |1 + L|
      const of = q < 6 ? q : q - 5;
      const mask = q < 6 ? 1 : (masks as Real[])[q - 6][k];
      const weight = of === 3 || !q ? c * mask : of === 4 ? mask / c : mask;
      if (q ? weight > 0 || q < 6 : f[k] >= fromHz) largest(own, of === 2 || of === 4 || of === 5 ? size : ones, of < 5 ? away : of === 5 ? ones : size, weight);
    }
    if (own[0] !== known) at[READ[q]] = f[k];
  }
}

/** Quotients are compared as products. */
function largest(own: Float64Array, top: Float64Array, bottom: Float64Array, weight: number): void {
  for (let r = 0; r < own.length; r++) {
    const below = bottom[r] > TINY ? bottom[r] : TINY;
    if (weight * top[r] > own[r] * below) own[r] = (weight * top[r]) / below;
  }
}

function least(own: Float64Array, top: Float64Array, bottom: Float64Array): void {
  for (let r = 0; r < own.length; r++) {
    const below = bottom[r] > TINY ? bottom[r] : TINY;
    if (top[r] < own[r] * below) own[r] = top[r] / below;
  }
}

/** What the chords from the line before tell, with crossings on them. */
function chords(f0: number, f1: number, before: Place, now: Place, out: Scan): void {
  const { found, at, sensed } = out;
  const [{ x: x0, y: y0, size: last, away: lastAway }, { x: x1, y: y1, size, away }] = [before, now];
  const [modulus, bandwidth, ofS, ofT] = [found[LN_MODULUS], found[LN_BANDWIDTH_HZ], found[LN_SENSITIVITY_HZ], found[LN_COMPLEMENTARY_HZ]];
  const count = x1.length;
  for (let r = 0; r < count; r++) {
    const x = 1 + x0[r];
    const y = y0[r];
    const stepX = x1[r] - x0[r];
    const stepY = y1[r] - y;
    const along = -(x * stepX + y * stepY);
    const length = stepX * stepX + stepY * stepY;
    if (along > 0 && along < length) {
      const across = x * stepY - y * stepX;
      if (across * across < modulus[r] * length) {
        const share = along / length;
        const nearX = x + share * stepX;
        const nearY = y + share * stepY;
        note(out, r, LN_MODULUS, nearX * nearX + nearY * nearY, f0 + share * (f1 - f0), false);
      }
    }
    const s0 = last[r];
    const s1 = size[r];
    const d0 = lastAway[r];
    const d1 = away[r];
    if (s0 >= 1 !== s1 >= 1) {
      unitCrossing(f0, f1, x0[r], y, x1[r], y1[r], r, out);
      if (s0 >= 1 && bandwidth[r] === -Infinity) {
        bandwidth[r] = between(f0, f1, s0, s1, 1);
        if (!r) at[LN_BANDWIDTH_HZ] = Math.exp(bandwidth[r]);
      }
    }
    if (y >= 0 !== y1[r] >= 0) axisCrossing(f0, f1, x0[r], y, x1[r], y1[r], r, out);
    if (d1 <= 2 && d0 > 2 && !sensed[r]) {
      ofS[r] = between(f0, f1, 1 / d0, 1 / d1, 0.5);
      sensed[r] = 1;
    }
    if (2 * s0 >= d0 && 2 * s1 < d1) ofT[r] = between(f0, f1, s0 / d0, s1 / d1, 0.5);
  }
}

function between(f0: number, f1: number, size0: number, size1: number, level: number): number {
  const a = Math.log(Math.max(size0, TINY) / level);
  const b = Math.log(Math.max(size1, TINY) / level);
  return Math.log(f0) + (Math.log(f1 / f0) * a) / (a - b);
}

/** What lines tell together with those above them; the last of the lower ones is the first of the upper ones. */
export function joined(lower: Scan, upper: Scan): Scan {
  const { last, lastAway, floors, at: upperAt } = upper;
  const [f0, f1] = lower.ends;
  const whole = { sensed: lower.sensed.map((one, r) => one | upper.sensed[r]), first: lower.first, last, lastAway, floors, ends: [f0, f1, upper.ends[2]] as Scan["ends"] };
  if (!lower.found.length) return { ...upper, ...whole };
  const at = lower.at.slice();
  const found = copied(lower.found);
  found.forEach((out, c) => {
    const other = upper.found[c];
    for (let r = 0; r < out.length; r++) {
      let takes = isRising[c] ? other[r] > out[r] : other[r] < out[r];
      if (c === LN_BANDWIDTH_HZ) takes = out[r] === -Infinity;
      else if (c === LN_SENSITIVITY_HZ) takes = !lower.sensed[r];
      else if (c === LN_COMPLEMENTARY_HZ) takes = other[r] > -Infinity;
      if (!takes) continue;
      out[r] = other[r];
      if (!r) at[c] = upperAt[c];
    }
  });
  return { found, at, ...whole };
}

/** Whether two ways that one scan goes on from end alike: what lies below the lines is large in every row of both. */
export function endsAlike(one: Scan, other: Scan, grid: Grid): boolean {
  if (one.found !== other.found || grid.asksReduction) return false;
  const large = ({ first }: Scan): boolean => first.every((size) => size >= LARGE ** 2);
  return large(one) && large(other) && one.sensed.every((value, r) => value === other.sensed[r]);
}

/** Margins of one loop by column, and where they lie in Hz. */
export interface Reading {
  found: Float64Array;
  at: Float64Array;
}

/** Margins of L on all lines of the grid. */
export function read(grid: Grid, L: Complex): Reading {
  const { found, at } = ended(grid, scan(grid, { L }, linesOf(grid.f.length)[0]), true);
  return { found: Float64Array.from(found, (own, c) => inUnits(c, own[0])), at };
}

function over(out: Readings, r: number, column: number, size2: number, weight: number, hz: number): void {
  if (weight > 0) note(out, r, column, size2 * weight, hz, true);
}

function note({ found, at }: Readings, r: number, column: number, value: number, where: number, largest: boolean): void {
  const own = found[column];
  if (largest ? value > own[r] : value < own[r]) {
    own[r] = value;
    if (!r) at[column] = where;
  }
}

function unitCrossing(f0: number, f1: number, x0: number, y0: number, x1: number, y1: number, r: number, out: Readings): void {
  const a = Math.log(Math.hypot(x0, y0));
  const b = Math.log(Math.hypot(x1, y1));
  const share = a / (a - b);
  const turn = Math.atan2(y1 * x0 - x1 * y0, x1 * x0 + y1 * y0);
  const phase = Math.atan2(y0, x0) + share * turn;
  let ahead = (phase * DEG + 180) % 360;
  if (ahead < 0) ahead += 360;
  const where = f0 * (f1 / f0) ** share;
  note(out, r, PHASE_DEG, Math.min(ahead, 360 - ahead), where, false);
  note(out, r, LN_DELAY_S, Math.log(Math.max(ahead, TINY) / 360 / where), where, false);
}

function axisCrossing(f0: number, f1: number, x0: number, y0: number, x1: number, y1: number, r: number, out: Readings): void {
  const share = y0 / (y0 - y1);
  const value = x0 + share * (x1 - x0);
  if (value >= 0) return;
  const size = 2 * DB * Math.log(Math.max(-value, TINY));
  const where = f0 + share * (f1 - f0);
  if (size <= 0) note(out, r, GAIN_DB, -size, where, false);
  else note(out, r, REDUCTION_DB, size, where, false);
}

/** Margins of scanned lines, by column as they come (`inUnits`); `bounded` counts what |L| may do beyond them. */
export function ended(grid: Grid, { found, at, sensed, first, last, lastAway, ends }: Scan, bounded: boolean): Readings {
  const out = { found: copied(found), at: at.slice() };
  for (let r = 0; r < first.length; r++) {
    if (!sensed[r]) out.found[LN_SENSITIVITY_HZ][r] = Math.log(ends[2]);
    if (2 * last[r] >= lastAway[r]) out.found[LN_COMPLEMENTARY_HZ][r] = Math.log(ends[2]);
    const end = Math.max(Math.sqrt(last[r]), grid.least);
    if (bounded) {
      below(ends, Math.sqrt(first[r]), r, out);
      above(grid, ends[2], end, r, out);
    } else controlAbove(grid, 1 + Math.min(end, 1), r, out);
    overMasksAbove(grid, bounded ? end : Math.min(end, 1), bounded, r, out);
  }
  return out;
}

/** Below the first line |L| stays above `first`; where that is no more than 1 nothing is known. */
function below([f0, f1]: number[], first: number, r: number, out: Readings): void {
  if (!(f0 > AT_ZERO * f1)) return;
  note(out, r, REDUCTION_DB, 2 * DB * Math.log(Math.max(first, 1)), f0, false);
  if (first >= LARGE) return;
  const room = Math.max(first - 1, 0);
  note(out, r, LN_MODULUS, room ** 2, f0, false);
  note(out, r, LN_DISK, (room / (1 + first)) ** 2, f0, false);
  note(out, r, COMPLEMENTARY_DB, first ** 2 / Math.max(room, 1e-9) ** 2, f0, true);
  if (room > 0) return;
  note(out, r, PHASE_DEG, 0, f0, false);
  note(out, r, LN_DELAY_S, -Infinity, f0, false);
}

/** Above the last line |L| stays below `last`: how near -1 it may come there, and how large all may be. */
function above(grid: Grid, end: number, last: number, r: number, out: Readings): void {
  if (last >= 1) {
    out.found[PHASE_DEG][r] = 0;
    out.found[LN_DELAY_S][r] = -Infinity;
  }
  const room = Math.max(1 - last, 1e-9);
  note(out, r, GAIN_DB, Math.max(-2 * DB * Math.log(Math.max(last, TINY)), 0), end, false);
  note(out, r, LN_MODULUS, Math.max(1 - last, 0) ** 2, end, false);
  note(out, r, LN_DISK, (Math.max(1 - last, 0) / (1 + last)) ** 2, end, false);
  note(out, r, COMPLEMENTARY_DB, (last / room) ** 2, end, true);
  controlAbove(grid, room, r, out);
}

/** |CS| above the last line, where it is |C| over no less than `room`; at best |L| is its last value there. */
function controlAbove({ most, mostHigh }: Grid, room: number, r: number, out: Readings): void {
  if (most.size >= 0) note(out, r, CONTROL_DB, most.size / room ** 2, most.hz, true);
  if (mostHigh.size >= 0) note(out, r, CONTROL_HIGH_DB, mostHigh.size / room ** 2, mostHigh.hz, true);
}

/** Above the last line, where |L| stays below `last`: the worst that may be, or the best where not `bounded`. */
function overMasksAbove({ over: most }: Grid, last: number, bounded: boolean, r: number, out: Readings): void {
  if (!most.length) return;
  const room = Math.max(1 - last, 1e-9);
  const s2 = 1 / (bounded ? room : 1 + last) ** 2;
  const [t2, l2, least2] = bounded ? [(last / room) ** 2, last ** 2, 0] : [0, 0, last ** 2];
  const sizes = [s2, t2, s2, t2, l2, 1 / Math.max(least2, TINY)];
  most.forEach(({ size, hz }, quantity) => over(out, r, OVER_MASKS[quantity], sizes[quantity], size, hz));
}

/** A number of a column from a squared magnitude, in the unit in which its error is nearest to normal. */
export function inUnits(column: number, value: number): number {
  if (LARGEST.includes(column)) return value > 0 ? DB * Math.log(value) : -Infinity;
  if (column !== LN_MODULUS && column !== LN_DISK) return value;
  return value > 0 ? (column === LN_DISK ? Math.LN2 : 0) + 0.5 * Math.log(value) : -Infinity;
}
