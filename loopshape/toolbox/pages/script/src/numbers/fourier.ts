// Transforms of signals of any length.

import type { Complex, Real } from "./arrays";

const roots = new Map<number, Real>();

/** Cosines of half a turn in n/2 steps, with what sines need beyond. */
function rootsOf(n: number): Real {
  const made = roots.get(n) ?? Float64Array.from({ length: (3 * n) / 4 + 1 }, (_, k) => Math.cos((2 * Math.PI * k) / n));
  roots.set(n, made);
  return made;
}

/** In place, of a length that is a power of two (Cooley and Tukey 1965). */
function powerOfTwo(re: Real, im: Real): void {
  const n = re.length;
  const cosines = rootsOf(n);
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) [re[i], re[j], im[i], im[j]] = [re[j], re[i], im[j], im[i]];
  }
  for (let size = 2; size <= n; size <<= 1) {
    const half = size >> 1;
    for (let start = 0; start < n; start += size) {
      for (let k = 0, at = 0, i = start; k < half; k++, i++, at += n / size) {
        const c = cosines[at];
        const s = cosines[at + n / 4];
        const x = re[i + half] * c - im[i + half] * s;
        const y = re[i + half] * s + im[i + half] * c;
        re[i + half] = re[i] - x;
        im[i + half] = im[i] - y;
        re[i] += x;
        im[i] += y;
      }
    }
  }
}

interface Chirp {
  re: Real;
  im: Real;
  ofRe: Real;
  ofIm: Real;
}

const chirps = new Map<number, Chirp>();

/** exp(-j pi k²/n), and the transform of its conjugate, by which any length is one of a power of two (Bluestein 1970). */
function chirpOf(n: number): Chirp {
  const known = chirps.get(n);
  if (known) return known;
  const size = 2 ** Math.ceil(Math.log2(2 * n - 1));
  const [re, im, ofRe, ofIm] = [new Float64Array(n), new Float64Array(n), new Float64Array(size), new Float64Array(size)];
  for (let k = 0; k < n; k++) {
    const turn = (Math.PI * ((k * k) % (2 * n))) / n;
    [re[k], im[k]] = [Math.cos(turn), -Math.sin(turn)];
    for (const place of k ? [k, size - k] : [0]) [ofRe[place], ofIm[place]] = [re[k], -im[k]];
  }
  powerOfTwo(ofRe, ofIm);
  const made = { re, im, ofRe, ofIm };
  chirps.set(n, made);
  return made;
}

/** The discrete Fourier transform of a complex signal of any length. */
export function transform(x: Real, y: Real): Complex {
  const n = x.length;
  const { re, im, ofRe, ofIm } = chirpOf(n);
  const size = ofRe.length;
  const [a, b] = [new Float64Array(size), new Float64Array(size)];
  for (let k = 0; k < n; k++) [a[k], b[k]] = [x[k] * re[k] - y[k] * im[k], x[k] * im[k] + y[k] * re[k]];
  powerOfTwo(a, b);
  for (let k = 0; k < size; k++) [a[k], b[k]] = [a[k] * ofRe[k] - b[k] * ofIm[k], -(a[k] * ofIm[k] + b[k] * ofRe[k])];
  powerOfTwo(a, b); // of the conjugate: the way back
  const out = { re: new Float64Array(n), im: new Float64Array(n) };
  for (let k = 0; k < n; k++) [out.re[k], out.im[k]] = [(a[k] * re[k] + b[k] * im[k]) / size, (a[k] * im[k] - b[k] * re[k]) / size];
  return out;
}

/** Two real signals (n,) of even length from their lines 0 .. n/2, the imaginary parts of both ends left out. */
export function fromLines(one: Complex, other: Complex): [Real, Real] {
  const last = one.re.length - 1;
  const n = 2 * last;
  const [x, y] = [new Float64Array(n), new Float64Array(n)];
  for (let k = 0; k <= last; k++) {
    const [a, b, c, d] = k && k < last ? [one.re[k], one.im[k], other.re[k], other.im[k]] : [one.re[k], 0, other.re[k], 0];
    [x[k], y[k]] = [a - d, -b - c]; // of the conjugate: the way back
    if (k) [x[n - k], y[n - k]] = [a + d, b - c];
  }
  const { re, im } = transform(x, y);
  return [re.map((value) => value / n), im.map((value) => -value / n)];
}
