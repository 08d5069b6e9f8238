// The margins of open loops on the same lines: one pass over the lines for each (Python: core/kernels/margins.py).

import type { Complex, Real } from "../numbers/arrays";
import type { Draws } from "../numbers/dense";
import { weights, type Reader } from "./limits";

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
}

interface Peak {
  size: number;
  hz: number;
}

/** A grid; `aboveF` and `aboveC2` go on above the last line. */
export function gridOf(f: Real, c2: Real, aboveF: Real, aboveC2: Real, { fromHz, masks }: Reader, least: number): Grid {
  const most = { size: -1, hz: NaN };
  const mostHigh = { size: -1, hz: NaN };
  for (let i = 0; i < aboveF.length; i++) {
    for (const peak of aboveF[i] >= fromHz ? [most, mostHigh] : [most]) {
      if (aboveC2[i] > peak.size) Object.assign(peak, { size: aboveC2[i], hz: aboveF[i] });
    }
  }
  return { f, c2, fromHz, most, mostHigh, masks: weights(masks, f), over: largestOver(weights(masks, aboveF), aboveF, aboveC2), least };
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

export function squares(C: Complex): Real {
  return C.re.map((re, k) => re * re + C.im[k] * C.im[k]);
}

/** One reading: margins by column, and where they lie in Hz. */
export interface Reading {
  found: Float64Array;
  at: Float64Array;
}

export function freshReading(): Reading {
  return { found: new Float64Array(COLUMNS), at: new Float64Array(COLUMNS) };
}

function between(f0: number, f1: number, size0: number, size1: number, level: number): number {
  const a = Math.log(Math.max(size0, TINY) / level);
  const b = Math.log(Math.max(size1, TINY) / level);
  return Math.log(f0) + (Math.log(f1 / f0) * a) / (a - b);
}

/** Margins of L, given by its parts; `bounded` counts what |L| may do above the last line. */
export function read(grid: Grid, re: Real, im: Real, bounded: boolean, out: Reading): void {
  const last = scan(grid, re, im, out);
  ended(grid, Math.hypot(re[0], im[0]), last, bounded, out);
}

/** What the lines alone tell, magnitudes squared; gives |L| on the last one. */
function scan(grid: Grid, re: Real, im: Real, out: Reading): number {
  const { f, c2, fromHz, masks } = grid;
  const { found, at } = out;
  const n = f.length;
  found.fill(Infinity);
  at.fill(NaN);
  for (const column of RISING) found[column] = -Infinity;
  for (const column of OVER_MASKS) found[column] = -Infinity;
  let complementary = -Infinity, control = -Infinity, high = -Infinity, process = -Infinity;
  let disk = Infinity, modulus = Infinity;
  let atT = 0, atC = 0, atH = 0, atP = 0, atD = 0, chord = 0, chordShare = 0;
  let beforeS = 0, beforeT = 0, beforeSize = 0, lastX = 0, lastY = 0;
  let crossed = false, sensed = false;
  for (let k = 0; k < n; k++) {
    const x = re[k];
    const y = im[k];
    const size = x * x + y * y;
    const d2 = Math.max((1 + x) * (1 + x) + y * y, TINY);
    const s2 = 1 / d2;
    const t2 = size / d2;
    if (t2 > complementary) {
      complementary = t2;
      atT = k;
    }
    const cs2 = c2[k] / d2;
    if (cs2 > control) {
      control = cs2;
      atC = k;
    }
    if (f[k] >= fromHz && cs2 > high) {
      high = cs2;
      atH = k;
    }
    const ps2 = size / c2[k] / d2;
    if (ps2 > process) {
      process = ps2;
      atP = k;
    }
    const disk2 = d2 / Math.max((1 - x) * (1 - x) + y * y, TINY);
    if (disk2 < disk) {
      disk = disk2;
      atD = k;
    }
    if (masks) overMasks(masks, k, f[k], s2, t2, c2[k], size, out);
    if (k > 0) {
      // squared distance of the chord from -1
      const stepX = x - lastX;
      const stepY = y - lastY;
      const length = stepX * stepX + stepY * stepY;
      const share = length > 0 ? Math.min(Math.max(-((1 + lastX) * stepX + lastY * stepY) / length, 0), 1) : 0;
      const nearX = 1 + lastX + share * stepX;
      const nearY = lastY + share * stepY;
      const near = nearX * nearX + nearY * nearY;
      if (near < modulus) {
        modulus = near;
        chord = k;
        chordShare = share;
      }
      if (beforeSize >= 1 !== size >= 1) {
        unitCrossing(f[k - 1], f[k], lastX, lastY, x, y, out);
        if (!crossed && beforeSize >= 1) {
          found[LN_BANDWIDTH_HZ] = between(f[k - 1], f[k], beforeSize, size, 1);
          at[LN_BANDWIDTH_HZ] = Math.exp(found[LN_BANDWIDTH_HZ]);
          crossed = true;
        }
      }
      if (lastY >= 0 !== y >= 0) axisCrossing(f[k - 1], f[k], lastX, lastY, x, y, out);
      if (!sensed && beforeS < 0.5 && 0.5 <= s2) {
        found[LN_SENSITIVITY_HZ] = between(f[k - 1], f[k], beforeS, s2, 0.5);
        sensed = true;
      }
      if (beforeT >= 0.5 && 0.5 > t2) found[LN_COMPLEMENTARY_HZ] = between(f[k - 1], f[k], beforeT, t2, 0.5);
    } else if (s2 >= 0.5) sensed = true;
    beforeS = s2;
    beforeT = t2;
    beforeSize = size;
    lastX = x;
    lastY = y;
  }
  place(out, COMPLEMENTARY_DB, complementary, f[atT]);
  place(out, CONTROL_DB, control, f[atC]);
  place(out, CONTROL_HIGH_DB, high, high > -Infinity ? f[atH] : NaN);
  place(out, PROCESS_DB, process, f[atP]);
  place(out, LN_DISK, disk, f[atD]);
  if (n === 1) place(out, LN_MODULUS, (1 + lastX) ** 2 + lastY ** 2, f[0]);
  else place(out, LN_MODULUS, modulus, f[chord - 1] + chordShare * (f[chord] - f[chord - 1]));
  if (!sensed) found[LN_SENSITIVITY_HZ] = Math.log(f[n - 1]);
  if (beforeT >= 0.5) found[LN_COMPLEMENTARY_HZ] = Math.log(f[n - 1]);
  return Math.sqrt(beforeSize);
}

/** Squared excess of each response over its masks at the k-th frequency, and of the floor over |L|. */
function overMasks(masks: Real[], k: number, hz: number, s2: number, t2: number, c2: number, l2: number, out: Reading): void {
  over(out, MASK_S, s2, masks[0][k], hz);
  over(out, MASK_T, t2, masks[1][k], hz);
  over(out, MASK_CS, c2 * s2, masks[2][k], hz);
  over(out, MASK_PS, t2 / Math.max(c2, TINY), masks[3][k], hz);
  over(out, MASK_L, l2, masks[4][k], hz);
  over(out, FLOOR_L, 1 / Math.max(l2, TINY), masks[5][k], hz);
}

function over(out: Reading, column: number, size2: number, weight: number, hz: number): void {
  if (weight > 0) note(out, column, size2 * weight, hz, true);
}

/** Above the last line, where |L| stays below `last`: the worst that may be, or the best where not `bounded`. */
function overMasksAbove({ over: most }: Grid, last: number, bounded: boolean, out: Reading): void {
  const room = Math.max(1 - last, 1e-9);
  const s2 = 1 / (bounded ? room : 1 + last) ** 2;
  const [t2, l2, least2] = bounded ? [(last / room) ** 2, last ** 2, 0] : [0, 0, last ** 2];
  const sizes = [s2, t2, s2, t2, l2, 1 / Math.max(least2, TINY)];
  most.forEach(({ size, hz }, quantity) => over(out, OVER_MASKS[quantity], sizes[quantity], size, hz));
}

function place(out: Reading, column: number, value: number, where: number): void {
  out.found[column] = value;
  out.at[column] = where;
}

function ended(grid: Grid, first: number, lastLine: number, bounded: boolean, out: Reading): void {
  const last = Math.max(lastLine, grid.least);
  if (bounded) {
    below(grid, first, out);
    if (last >= 1) {
      out.found[PHASE_DEG] = 0;
      out.found[LN_DELAY_S] = -Infinity;
    }
    above(grid, last, out);
  } else aboveAtBest(grid, Math.min(last, 1), out);
  overMasksAbove(grid, bounded ? last : Math.min(last, 1), bounded, out);
  finish(out.found);
}

function note(out: Reading, column: number, value: number, where: number, largest: boolean): void {
  if (largest ? value > out.found[column] : value < out.found[column]) {
    out.found[column] = value;
    out.at[column] = where;
  }
}

function unitCrossing(f0: number, f1: number, x0: number, y0: number, x1: number, y1: number, out: Reading): void {
  const a = Math.log(Math.hypot(x0, y0));
  const b = Math.log(Math.hypot(x1, y1));
  const share = a / (a - b);
  const turn = Math.atan2(y1 * x0 - x1 * y0, x1 * x0 + y1 * y0);
  const phase = Math.atan2(y0, x0) + share * turn;
  let ahead = (phase * DEG + 180) % 360;
  if (ahead < 0) ahead += 360;
  const where = f0 * (f1 / f0) ** share;
  note(out, PHASE_DEG, Math.min(ahead, 360 - ahead), where, false);
  note(out, LN_DELAY_S, Math.log(Math.max(ahead, TINY) / 360 / where), where, false);
}

function axisCrossing(f0: number, f1: number, x0: number, y0: number, x1: number, y1: number, out: Reading): void {
  const share = y0 / (y0 - y1);
  const value = x0 + share * (x1 - x0);
  if (value >= 0) return;
  const size = 2 * DB * Math.log(Math.max(-value, TINY));
  const where = f0 + share * (f1 - f0);
  if (size <= 0) note(out, GAIN_DB, -size, where, false);
  else note(out, REDUCTION_DB, size, where, false);
}

/** Below the first line |L| stays above `first`; where that is no more than 1 nothing is known. */
function below({ f }: Grid, first: number, out: Reading): void {
  if (f.length < 2 || f[0] <= AT_ZERO * f[1]) return;
  note(out, REDUCTION_DB, 2 * DB * Math.log(Math.max(first, 1)), f[0], false);
  if (first >= LARGE) return;
  const room = Math.max(first - 1, 0);
  note(out, LN_MODULUS, room ** 2, f[0], false);
  note(out, LN_DISK, (room / (1 + first)) ** 2, f[0], false);
  note(out, COMPLEMENTARY_DB, first ** 2 / Math.max(room, 1e-9) ** 2, f[0], true);
  if (room > 0) return;
  note(out, PHASE_DEG, 0, f[0], false);
  note(out, LN_DELAY_S, -Infinity, f[0], false);
}

/** Above the last line |L| stays below `last`: how near -1 it may come there, and how large all may be. */
function above(grid: Grid, last: number, out: Reading): void {
  const end = grid.f[grid.f.length - 1];
  const room = Math.max(1 - last, 1e-9);
  note(out, GAIN_DB, Math.max(-2 * DB * Math.log(Math.max(last, TINY)), 0), end, false);
  note(out, LN_MODULUS, Math.max(1 - last, 0) ** 2, end, false);
  note(out, LN_DISK, (Math.max(1 - last, 0) / (1 + last)) ** 2, end, false);
  note(out, COMPLEMENTARY_DB, (last / room) ** 2, end, true);
  controlAbove(grid, room, out);
}

/** |CS| above the last line where |L| stays below `last`: no less than |C|/(1 + last). */
function aboveAtBest(grid: Grid, last: number, out: Reading): void {
  controlAbove(grid, 1 + last, out);
}

function controlAbove({ most, mostHigh }: Grid, over: number, out: Reading): void {
  if (most.size >= 0) note(out, CONTROL_DB, most.size / over ** 2, most.hz, true);
  if (mostHigh.size >= 0) note(out, CONTROL_HIGH_DB, mostHigh.size / over ** 2, mostHigh.hz, true);
}

function finish(found: Float64Array): void {
  for (const column of LARGEST) found[column] = found[column] > 0 ? DB * Math.log(found[column]) : -Infinity;
  found[LN_MODULUS] = found[LN_MODULUS] > 0 ? 0.5 * Math.log(found[LN_MODULUS]) : -Infinity;
  found[LN_DISK] = found[LN_DISK] > 0 ? Math.LN2 + 0.5 * Math.log(found[LN_DISK]) : -Infinity;
}

/** Readings (draws, columns), with what |L| may do above the last line and without. */
export interface Readings {
  bounded: Float64Array;
  open: Float64Array;
}

/** Readings of a reference with each of the draws added. */
export function readDraws(grid: Grid, reference: Complex, draws: Draws): Readings {
  const n = grid.f.length;
  const re = new Float64Array(n);
  const im = new Float64Array(n);
  const out = { bounded: new Float64Array(draws.count * COLUMNS), open: new Float64Array(draws.count * COLUMNS) };
  const one = freshReading();
  const other = freshReading();
  for (let d = 0; d < draws.count; d++) {
    const start = d * n;
    for (let k = 0; k < n; k++) {
      re[k] = reference.re[k] + draws.re[start + k];
      im[k] = reference.im[k] + draws.im[start + k];
    }
    const last = scan(grid, re, im, one);
    other.found.set(one.found);
    const first = Math.hypot(re[0], im[0]);
    ended(grid, first, last, true, one);
    ended(grid, first, last, false, other);
    out.bounded.set(one.found, d * COLUMNS);
    out.open.set(other.found, d * COLUMNS);
  }
  return out;
}
