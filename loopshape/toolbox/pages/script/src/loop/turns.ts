// How 1 + L turns along L, and how near its chords come to -1 (Python: core/kernels/encirclements.py, loop/between.py).

import { clip, type Complex, type Real } from "../numbers/arrays";

/** Angle of a quotient. */
export function angleOf(ar: number, ai: number, br: number, bi: number): number {
  return Math.atan2(ai * br - ar * bi, ar * br + ai * bi);
}

/** How far 1 + L turns from one place to another. */
export function turnAlong(L: Complex, from: number, to: number): number {
  let turn = 0;
  for (let k = from + 1; k <= to; k++) turn += angleOf(1 + L.re[k], L.im[k], 1 + L.re[k - 1], L.im[k - 1]) || 0;
  return turn;
}

/** Distance of each chord of L from -1. */
export function chords(L: Complex): Real {
  const out = new Float64Array(Math.max(L.re.length - 1, 0));
  for (let k = 0; k < out.length; k++) out[k] = chord(L, k, k + 1);
  return out;
}

export function chord(L: Complex, k: number, next: number): number {
  const [x, y] = [1 + L.re[k], L.im[k]];
  const [dx, dy] = [L.re[next] - L.re[k], L.im[next] - L.im[k]];
  const length = dx * dx + dy * dy;
  const share = length > 0 ? clip(-(x * dx + y * dy) / length, 0, 1) : 0;
  return Math.sqrt((x + share * dx) ** 2 + (y + share * dy) ** 2);
}
