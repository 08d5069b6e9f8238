// The margins of open loops on the same lines: one pass over the lines for each (Python: core/kernels/margins.py).

import type { Complex, Real } from "./arrays";
import type { Draws } from "./dense";

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
export const COLUMNS = 13;
const DB = 10 / Math.LN10;
const DEG = 180 / Math.PI;
const TINY = 1e-300;
const LARGEST = [COMPLEMENTARY_DB, CONTROL_DB, CONTROL_HIGH_DB, PROCESS_DB];
const RISING = [LN_BANDWIDTH_HZ, LN_SENSITIVITY_HZ, LN_COMPLEMENTARY_HZ];

/** Frequencies of the lines and of those above the last, with |C|² on both; |CS| counts as high from a frequency on. */
export interface Grid {
  f: Real;
  c2: Real;
  aboveF: Real;
  aboveC2: Real;
  fromHz: number;
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

/** Margins of L, given by its parts from `start` on, into `out`; `bounded` counts what |L| may do above the last line. */
export function read(grid: Grid, re: Real, im: Real, start: number, bounded: boolean, out: Reading): void {
  const { f, c2, fromHz } = grid;
  const { found, at } = out;
  const n = f.length;
  found.fill(Infinity);
  at.fill(NaN);
  for (const column of LARGEST) found[column] = -Infinity;
  for (const column of RISING) found[column] = -Infinity;
  let [complementary, control, high, process, disk, modulus] = [-Infinity, -Infinity, -Infinity, -Infinity, Infinity, Infinity];
  let [atT, atC, atH, atP, atD, atM] = [NaN, NaN, NaN, NaN, NaN, NaN];
  let [beforeS, beforeT, beforeSize] = [0, 0, 0];
  let [crossed, sensed] = [false, false];
  let [lastX, lastY] = [0, 0];
  const begins = n > 0 && Math.hypot(re[start], im[start]) >= 1;
  for (let k = 0; k < n; k++) {
    const x = re[start + k];
    const y = im[start + k];
    const size = x * x + y * y;
    const d2 = Math.max((1 + x) * (1 + x) + y * y, TINY);
    const t2 = size / d2;
    const s2 = 1 / d2;
    if (t2 > complementary) [complementary, atT] = [t2, f[k]];
    const cs2 = c2[k] / d2;
    if (cs2 > control) [control, atC] = [cs2, f[k]];
    if (f[k] >= fromHz && cs2 > high) [high, atH] = [cs2, f[k]];
    const ps2 = size / c2[k] / d2;
    if (ps2 > process) [process, atP] = [ps2, f[k]];
    const disk2 = d2 / Math.max((1 - x) * (1 - x) + y * y, TINY);
    if (disk2 < disk) [disk, atD] = [disk2, f[k]];
    if (k > 0) {
      // squared distance of the chord from -1
      const [stepX, stepY] = [x - lastX, y - lastY];
      const length = stepX * stepX + stepY * stepY;
      const startX = 1 + lastX;
      let share = 0;
      if (length > 0) share = Math.min(Math.max(-(startX * stepX + lastY * stepY) / length, 0), 1);
      const [nearX, nearY] = [startX + share * stepX, lastY + share * stepY];
      const near = nearX * nearX + nearY * nearY;
      if (near < modulus) [modulus, atM] = [near, f[k - 1] + share * (f[k] - f[k - 1])];
      if (beforeSize >= 1 !== size >= 1) {
        unitCrossing(f[k - 1], f[k], lastX, lastY, x, y, out);
        if (!crossed && begins) {
          found[LN_BANDWIDTH_HZ] = between(f[k - 1], f[k], beforeSize, size, 1);
          at[LN_BANDWIDTH_HZ] = Math.exp(found[LN_BANDWIDTH_HZ]);
        }
        crossed = true;
      }
      if (lastY >= 0 !== y >= 0) axisCrossing(f[k - 1], f[k], lastX, lastY, x, y, out);
      if (!sensed && beforeS < 0.5 && 0.5 <= s2) {
        found[LN_SENSITIVITY_HZ] = between(f[k - 1], f[k], beforeS, s2, 0.5);
        sensed = true;
      }
      if (beforeT >= 0.5 && 0.5 > t2) found[LN_COMPLEMENTARY_HZ] = between(f[k - 1], f[k], beforeT, t2, 0.5);
    } else if (s2 >= 0.5) sensed = true;
    [beforeS, beforeT, beforeSize, lastX, lastY] = [s2, t2, size, x, y];
  }
  if (n === 1) [modulus, atM] = [(1 + lastX) ** 2 + lastY ** 2, f[0]];
  [found[COMPLEMENTARY_DB], found[CONTROL_DB], found[CONTROL_HIGH_DB]] = [complementary, control, high];
  [found[PROCESS_DB], found[LN_DISK], found[LN_MODULUS]] = [process, disk, modulus];
  [at[COMPLEMENTARY_DB], at[CONTROL_DB], at[CONTROL_HIGH_DB]] = [atT, atC, atH];
  [at[PROCESS_DB], at[LN_DISK], at[LN_MODULUS]] = [atP, atD, atM];
  if (!sensed) found[LN_SENSITIVITY_HZ] = Math.log(f[n - 1]);
  if (beforeT >= 0.5) found[LN_COMPLEMENTARY_HZ] = Math.log(f[n - 1]);
  const last = Math.sqrt(beforeSize);
  if (bounded && last >= 1) [found[PHASE_DEG], found[LN_DELAY_S]] = [0, -Infinity];
  if (bounded) above(grid, last, out);
  else aboveAtBest(grid, Math.min(last, 1), out);
  finish(found);
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

/** Above the last line |L| stays below `last`: how near -1 it may come there, and how large all may be. */
function above({ f, aboveF, aboveC2, fromHz }: Grid, last: number, out: Reading): void {
  const end = f[f.length - 1];
  const room = Math.max(1 - last, 1e-9);
  note(out, GAIN_DB, Math.max(-2 * DB * Math.log(Math.max(last, TINY)), 0), end, false);
  note(out, LN_MODULUS, Math.max(1 - last, 0) ** 2, end, false);
  note(out, LN_DISK, (Math.max(1 - last, 0) / (1 + last)) ** 2, end, false);
  note(out, COMPLEMENTARY_DB, (last / room) ** 2, end, true);
  for (let i = 0; i < aboveF.length; i++) {
    const size = aboveC2[i] / room ** 2;
    note(out, CONTROL_DB, size, aboveF[i], true);
    if (aboveF[i] >= fromHz) note(out, CONTROL_HIGH_DB, size, aboveF[i], true);
  }
}

/** |CS| above the last line where |L| stays below `last`: no less than |C|/(1 + last). */
function aboveAtBest({ aboveF, aboveC2, fromHz }: Grid, last: number, out: Reading): void {
  for (let i = 0; i < aboveF.length; i++) {
    const size = aboveC2[i] / (1 + last) ** 2;
    note(out, CONTROL_DB, size, aboveF[i], true);
    if (aboveF[i] >= fromHz) note(out, CONTROL_HIGH_DB, size, aboveF[i], true);
  }
}

function finish(found: Float64Array): void {
  for (const column of LARGEST) found[column] = found[column] > 0 ? DB * Math.log(found[column]) : -Infinity;
  found[LN_MODULUS] = found[LN_MODULUS] > 0 ? 0.5 * Math.log(found[LN_MODULUS]) : -Infinity;
  found[LN_DISK] = found[LN_DISK] > 0 ? Math.LN2 + 0.5 * Math.log(found[LN_DISK]) : -Infinity;
}

/** Readings of a reference with each of the draws added: (draws, columns). */
export function readDraws(grid: Grid, reference: Complex, draws: Draws, bounded: boolean): Float64Array {
  const n = grid.f.length;
  const [re, im] = [new Float64Array(n), new Float64Array(n)];
  const out = new Float64Array(draws.count * COLUMNS);
  const one = freshReading();
  for (let d = 0; d < draws.count; d++) {
    const start = d * n;
    for (let k = 0; k < n; k++) {
      re[k] = reference.re[k] + draws.re[start + k];
      im[k] = reference.im[k] + draws.im[start + k];
    }
    read(grid, re, im, 0, bounded, one);
    out.set(one.found, d * COLUMNS);
  }
  return out;
}
