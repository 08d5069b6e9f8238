// A controller as it runs: blocks in series after Tustin's rule, in the target's numbers, with delay and hold.

import { clip, geometric, rint, TWO_PI, zeros, type Complex, type Real } from "./arrays";

export type Kind = "gain" | "lead_lag" | "notch" | "low_pass_1" | "low_pass_2" | "pi" | "pid" | "section";

export interface Block {
  kind: Kind;
  parameters: Record<string, number>;
}

export interface Controller {
  loop: string;
  blocks: Block[];
  rate_hz: number;
  discretisation: string;
  prewarp_hz: number | null;
  computation_delay_s: number;
  added_hold: boolean;
  precision: string;
}

type Polynomial = [number, number, number];
type Section = [Polynomial, Polynomial];

function quadratic(f_hz: number, damping: number): Polynomial {
  const w = TWO_PI * f_hz;
  return [1, (2 * damping) / w, 1 / (w * w)];
}

/** Numerator and denominator of a block, coefficients of s^0, s^1, s^2. */
export function section({ kind, parameters: p }: Block): Section {
  switch (kind) {
    case "gain":
      return [[p.gain, 0, 0], [1, 0, 0]];
    case "lead_lag":
      return [[1, 1 / (TWO_PI * p.f1_hz), 0], [1, 1 / (TWO_PI * p.f2_hz), 0]];
    case "notch":
      return [quadratic(p.f1_hz, p.damping1), quadratic(p.f2_hz, p.damping2)];
    case "low_pass_1":
      return [[1, 0, 0], [1, 1 / (TWO_PI * p.f_hz), 0]];
    case "low_pass_2":
      return [[1, 0, 0], quadratic(p.f_hz, p.damping)];
    case "pi":
      return [[TWO_PI * p.f_hz, 1, 0], [0, 1, 0]];
    case "pid":
      return pid(p);
    case "section":
      return [[p.n0, p.n1, p.n2], [p.d0, p.d1, p.d2]];
  }
}

function pid(p: Record<string, number>): Section {
  const [integral, tame, derivative] = [TWO_PI * p.fi_hz, 1 / (TWO_PI * p.ff_hz), 1 / (TWO_PI * p.fd_hz)];
  return [[p.gain * integral, p.gain * (1 + integral * tame), p.gain * (tame + derivative)], [0, 1, tame]];
}

/** Poles of a block at s = 0, below zero of zeros there. */
export function integratorsOf(block: Block): number {
  const [num, den] = section(block).map((p) => Math.max(p.findIndex((c) => c !== 0), 0));
  return den - num;
}

/** A section without the integral term of its partial fractions; 1 where it is nothing else. */
function bounded([num, den]: Section): Section {
  if (den[0] !== 0) return [num, den];
  const rest: Polynomial = [0, den[1] !== 0 ? num[1] - (num[0] * den[2]) / den[1] : 0, num[2]];
  const one: Polynomial = [1, 0, 0];
  const lowered = (p: Polynomial): Polynomial => (den[1] !== 0 ? [p[1], p[2], 0] : [p[2], 0, 0]);
  return rest.some((c) => c !== 0) ? [lowered(rest), lowered(den)] : [one, one];
}

/** Why a section cannot run, in words; null where it can. */
export function sectionRefusal([num, den]: Section): string | null {
  const degree = (p: Polynomial): number => p.reduce((top, c, k) => (c !== 0 ? k : top), 0);
  if (!num.some(Boolean) || !den.some(Boolean)) return "a section needs a numerator and a denominator";
  if (degree(num) > degree(den)) return "a section with more zeros than poles cannot run (it is improper)";
  if (num[0] === 0 && den[0] === 0) return "a section has a zero and a pole at s = 0";
  const rest = den.slice(den.findIndex((c) => c !== 0), degree(den) + 1);
  return rest.every((c) => c * rest[0] > 0) ? null : "a section of a controller must be stable";
}

function tustinConstant(c: Controller): number {
  if (c.prewarp_hz === null) return 2 * c.rate_hz;
  const w = TWO_PI * c.prewarp_hz;
  return w / Math.tan((0.5 * w) / c.rate_hz);
}

/** Imaginary part of s (n,) at frequencies in Hz, with Tustin's warped axis. */
function warped(c: Controller, f: Real): Real {
  const k = tustinConstant(c);
  return f.map((x) => k * Math.tan((0.5 * TWO_PI * x) / c.rate_hz));
}

/** Response of sections in series at s = j w. */
function series(sections: readonly Section[], w: Real): Complex {
  const out = zeros(w.length);
  out.re.fill(1);
  for (const [num, den] of sections) {
    for (let k = 0; k < w.length; k++) {
      const square = w[k] * w[k];
      multiply(out, k, num[0] - square * num[2], w[k] * num[1]);
      divide(out, k, den[0] - square * den[2], w[k] * den[1]);
    }
  }
  return out;
}

function multiply(z: Complex, k: number, re: number, im: number): void {
  const first = z.re[k];
  z.re[k] = first * re - z.im[k] * im;
  z.im[k] = first * im + z.im[k] * re;
}

function divide(z: Complex, k: number, re: number, im: number): void {
  const size = re * re + im * im;
  multiply(z, k, re / size, -im / size);
}

/** Response (n,) of the controller as it runs, with its delay and added hold. */
export function response(c: Controller, f: Real): Complex {
  const own = c.precision === "double" ? series(c.blocks.map(section), warped(c, f)) : cascade(biquads(c), f, c.rate_hz);
  if (!c.computation_delay_s && !c.added_hold) return own;
  for (let k = 0; k < f.length; k++) {
    const late = c.computation_delay_s + (c.added_hold ? 0.5 / c.rate_hz : 0);
    const x = (Math.PI * f[k]) / c.rate_hz;
    const size = c.added_hold && x ? Math.sin(x) / x : 1;
    const turn = -TWO_PI * f[k] * late;
    multiply(own, k, size * Math.cos(turn), size * Math.sin(turn));
  }
  return own;
}

const responses = new WeakMap<Controller, Map<Real, Complex>>();

/** The same, once for a controller and frequencies that several plants share. */
export function responseOn(c: Controller, f: Real): Complex {
  const known = responses.get(c) ?? new Map<Real, Complex>();
  responses.set(c, known);
  const found = known.get(f) ?? response(c, f);
  known.set(f, found);
  return found;
}

/** One block's response as it runs, for what it costs and for its handles. */
export function blockResponse(c: Controller, block: Block, f: Real): Complex {
  return series([section(block)], warped(c, f));
}

function cascade(sections: number[][], f: Real, rate_hz: number): Complex {
  const out = zeros(f.length);
  out.re.fill(1);
  for (let k = 0; k < f.length; k++) {
    const half = (0.5 * TWO_PI * f[k]) / rate_hz;
    const [ure, uim] = [2 * Math.sin(half) ** 2, 2 * Math.sin(half) * Math.cos(half)];
    const at = (p0: number, p1: number, p2: number): [number, number] => {
      const [are, aim] = [p1 + 2 * p2 - ure * p2, -uim * p2];
      return [p0 + p1 + p2 - (ure * are - uim * aim), -(ure * aim + uim * are)];
    };
    for (const [b0, b1, b2, a1, a2] of sections) {
      multiply(out, k, ...at(b0, b1, b2));
      divide(out, k, ...at(1, a1, a2));
    }
  }
  return out;
}

/** Discrete sections b0, b1, b2, a1, a2 with a0 = 1, by Tustin's rule, rounded to the precision. */
export function biquads(c: Controller): number[][] {
  const k = tustinConstant(c);
  return c.blocks.map((block) => {
    const row = tustin(section(block), k).map((value) => rounded(value, c.precision));
    if (integratorsOf(block) === 1 && section(block)[1][2] !== 0) row[4] = -1 - row[3]; // the integrator stays at z = 1
    return row;
  });
}

function tustin([num, den]: Section, k: number): number[] {
  let [b, a] = [num, den].map((p) => [
    p[0] + k * p[1] + k * k * p[2],
    2 * p[0] - 2 * k * k * p[2],
    p[0] - k * p[1] + k * k * p[2],
  ]);
  if (num[2] === 0 && den[2] === 0) [b, a] = [num, den].map((p) => [p[0] + k * p[1], p[0] - k * p[1], 0]);
  if (!num[1] && !den[1] && !num[2] && !den[2]) [b, a] = [[num[0], 0, 0], [den[0], 0, 0]];
  return [b[0] / a[0], b[1] / a[0], b[2] / a[0], a[1] / a[0], a[2] / a[0]];
}

function rounded(value: number, precision: string): number {
  if (precision === "double") return value;
  if (precision === "single") return Math.fround(value);
  const unit = 2 ** Number(precision.split(".")[1]);
  return rint(value * unit) / unit;
}

/** Why the sections cannot run in the target's numbers, in words; nothing where they can. */
export function refusal(c: Controller): string | null {
  if (c.precision === "double") return null;
  const limit = c.precision === "single" ? 3.4028234663852886e38 : 2 ** (Number(/q(\d+)/.exec(c.precision)?.[1]) - 1);
  for (const [k, row] of biquads(c).entries()) {
    const where = `block ${k + 1} (${c.blocks[k].kind})`;
    if (row.some((value) => value < -limit || value >= limit)) return `a coefficient of ${where} does not fit ${c.precision}`;
    const why = roundedRefusal(c.blocks[k], row);
    if (why) return `${where} ${why} in ${c.precision}: use a finer precision`;
  }
  return null;
}

function roundedRefusal(block: Block, [b0, b1, b2, a1, a2]: number[]): string | null {
  const outside = "has a pole on or outside the unit circle";
  if (!b0 && !b1 && !b2 && section(block)[0].some(Boolean)) return "lets nothing pass";
  if (integratorsOf(block) <= 0) return Math.abs(a2) < 1 && Math.abs(a1) < 1 + a2 ? null : outside;
  if (b0 + b1 + b2 === 0) return "loses its integrator";
  return integratorsOf(block) === 1 && !(Math.abs(a2) < 1) ? outside : null;
}

/** Poles at s = 0, less zeros there. */
export const integrators = (c: Controller): number => c.blocks.reduce((sum, block) => sum + integratorsOf(block), 0);

/** Zeros of the controller as it runs, [re, im] in z. */
export function zerosOf(c: Controller): [number, number][] {
  return biquads(c).flatMap(([b0, b1, b2]): [number, number][] => {
    if (b0 === 0) return b1 === 0 ? [] : [[-b2 / b1, 0]];
    const turn = b1 * b1 - 4 * b0 * b2;
    const [middle, half] = [-b1 / (2 * b0), Math.sqrt(Math.abs(turn)) / (2 * b0)];
    return turn < 0 ? [[middle, half], [middle, -half]] : [[middle + half, 0], [middle - half, 0]];
  });
}

/** Centres and half widths in Hz of the controller's oscillatory poles as it runs. */
export function poles(c: Controller): [number, number][] {
  const found: [number, number][] = [];
  for (const [, , , a1, a2] of biquads(c)) {
    const turn = 4 * a2 - a1 * a1;
    if (turn <= 0) continue;
    const [re, im] = [-0.5 * a1, 0.5 * Math.sqrt(turn)];
    found.push([
      (c.rate_hz * Math.atan2(im, re)) / TWO_PI,
      Math.abs(c.rate_hz * Math.log(Math.hypot(re, im))) / TWO_PI,
    ]);
  }
  return found;
}

/** Highest frequency in Hz at which |C|, without integrators, is within 3 dB of its largest. */
export function bandwidthHz(c: Controller): number {
  const found = bandwidths.get(c) ?? bandwidthOf(c);
  bandwidths.set(c, found);
  return found;
}

const bandwidths = new WeakMap<Controller, number>();

function bandwidthOf(c: Controller): number {
  const f = geometric(1e-6 * c.rate_hz, 0.4999 * c.rate_hz, 360);
  const own = series(c.blocks.map((block) => bounded(section(block))), warped(c, f));
  const size = own.re.map((re, k) => Math.log(Math.hypot(re, own.im[k])));
  const most = size.reduce((a, b) => Math.max(a, b), -Infinity);
  const room = size.map((value) => value - (most - 0.5 * Math.log(2)));
  let k = f.length - 1;
  while (k > 0 && room[k] < 0) k--;
  if (k === f.length - 1) return 0.5 * c.rate_hz;
  return f[k] * (f[k + 1] / f[k]) ** clip(room[k] / (room[k] - room[k + 1]), 0, 1);
}
