// Real and complex arrays, and the few functions of numpy that the formulas are written with.

export type Real = Float64Array;

/** A complex array: real and imaginary parts of one length. */
export interface Complex {
  re: Real;
  im: Real;
}

export const TWO_PI = 2 * Math.PI;

export function zeros(n: number): Complex {
  return { re: new Float64Array(n), im: new Float64Array(n) };
}

export function times(a: Complex, b: Complex): Complex {
  const n = a.re.length;
  const out = zeros(n);
  for (let k = 0; k < n; k++) {
    out.re[k] = a.re[k] * b.re[k] - a.im[k] * b.im[k];
    out.im[k] = a.re[k] * b.im[k] + a.im[k] * b.re[k];
  }
  return out;
}

export const plus = (a: Complex, b: Complex): Complex => ({ re: a.re.map((x, k) => x + b.re[k]), im: a.im.map((x, k) => x + b.im[k]) });

export function joined(...parts: Complex[]): Complex {
  return { re: concat(...parts.map((p) => p.re)), im: concat(...parts.map((p) => p.im)) };
}

export function concat(...parts: Real[]): Real {
  const out = new Float64Array(parts.reduce((n, p) => n + p.length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

/** First place at which a value may be put into rising numbers; behind equal ones where `right`. */
export function placeIn(rising: Real, value: number, right = false): number {
  let low = 0;
  let high = rising.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rising[middle] < value || (right && rising[middle] === value)) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Rising numbers with some more among them, each once. */
export function union(rising: Real, more: Real): Real {
  const others = Float64Array.from(more).sort();
  const out = new Float64Array(rising.length + others.length);
  let n = 0;
  for (let i = 0, j = 0; i < rising.length || j < others.length; ) {
    const value = j >= others.length || rising[i] <= others[j] ? rising[i++] : others[j++];
    if (n === 0 || out[n - 1] !== value) out[n++] = value;
  }
  return out.slice(0, n);
}

export function geometric(start: number, stop: number, count: number, endpoint = true): Real {
  const step = Math.log(stop / start) / (endpoint ? count - 1 : count);
  const out = Float64Array.from({ length: count }, (_, k) => start * Math.exp(step * k));
  if (endpoint) out[count - 1] = stop;
  return out;
}

export function clip(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high);
}

export const db = (ratio: number): number => 20 * Math.log10(ratio);
export const fromDb = (decibel: number): number => 10 ** (decibel / 20);
export const deg = (rad: number): number => (rad * 180) / Math.PI;

/** The nearest whole number, halves to the even one. */
export function rint(value: number): number {
  const rounded = Math.round(value);
  return Math.abs(value % 1) === 0.5 && rounded % 2 !== 0 ? rounded - 1 : rounded;
}

export function magnitudes({ re, im }: Complex): Real {
  const out = new Float64Array(re.length);
  for (let k = 0; k < re.length; k++) out[k] = Math.sqrt(re[k] * re[k] + im[k] * im[k]);
  return out;
}

/** d ln size/d ln f by least squares. */
export function steepness(f: Real, size: Real): number {
  const x = f.map(Math.log);
  const y = size.map((value) => Math.log(Math.max(value, 1e-300)));
  const [mx, my] = [x, y].map((values) => values.reduce((sum, value) => sum + value, 0) / f.length);
  let [up, down] = [0, 0];
  for (let k = 0; k < f.length; k++) [up, down] = [up + (x[k] - mx) * (y[k] - my), down + (x[k] - mx) ** 2];
  return up / down;
}

function bytes(text: string): ArrayBuffer {
  const binary = atob(text);
  const out = new Uint8Array(binary.length);
  for (let k = 0; k < binary.length; k++) out[k] = binary.charCodeAt(k);
  return out.buffer;
}

/** What Python wrote, with its arrays: each is an object with its kind and base64, equal real ones are one. */
export function unpacked(given: unknown, known = new Map<string, Real>()): unknown {
  if (typeof given !== "object" || given === null) return given;
  if (Array.isArray(given)) return given.map((one) => unpacked(one, known));
  const { f8, c16, c8, u1 } = given as Record<string, string | undefined>;
  if (f8 !== undefined) {
    const made = known.get(f8) ?? new Float64Array(bytes(f8));
    known.set(f8, made);
    return made;
  }
  if (c16 !== undefined) return parted(new Float64Array(bytes(c16)));
  if (c8 !== undefined) return parted(new Float32Array(bytes(c8)));
  if (u1 !== undefined) return new Uint8Array(bytes(u1));
  return Object.fromEntries(Object.entries(given).map(([name, value]) => [name, unpacked(value, known)]));
}

function parted(both: ArrayLike<number>): Complex {
  const out = zeros(both.length / 2);
  for (let k = 0; k < out.re.length; k++) {
    out.re[k] = both[2 * k];
    out.im[k] = both[2 * k + 1];
  }
  return out;
}
