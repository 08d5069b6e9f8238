// Step of the closed loop of a fitted model with the controller as it runs (Python: loop/step_response.py). The setpoint
// is a square wave of half periods so long that its answer comes to rest within each: half a period is the step.

import { geometric, TWO_PI, type Complex, type Real } from "./arrays";
import { response, responseOn, type Controller } from "./controller";
import type { FitModel, StepConstants } from "../payload";

export interface Step {
  timeS: Real;
  y: Real;
  /** As shares of the final value and in seconds; nan where it never settles. */
  overshoot: number;
  settlingS: number;
}

const known = new WeakMap<Controller, Map<FitModel, Step | null>>();

/** The step, once for a model and a controller; null where the loop does not come to rest. */
export function stepOf(model: FitModel, controller: Controller, c: StepConstants): Step | null {
  const own = known.get(controller) ?? new Map<FitModel, Step | null>();
  known.set(controller, own);
  if (!own.has(model)) own.set(model, found(model, controller, c));
  return own.get(model) as Step | null;
}

function found(model: FitModel, controller: Controller, c: StepConstants): Step | null {
  const { rate_hz } = controller;
  const sweep = sweepOf(rate_hz);
  const T = closed(modelOn(model, sweep), responseOn(controller, sweep));
  const size = T.re.map((re, k) => Math.hypot(re, T.im[k]));
  const last = size.findLastIndex((value) => value > c.small);
  if (last < 0) return null;
  const low = Float64Array.of(1e-9 * rate_hz);
  const final = closed(modelOn(model, low), response(controller, low)).re[0];
  const top = sweep[Math.min(last + 1, sweep.length - 1)];
  const stride = 2 ** Math.max(0, Math.floor(Math.log2(rate_hz / (8 * top))));
  const passed = sweep[size.findLastIndex((value) => value > 0.5 * Math.max(size[0], 1e-9))];
  let half = stride * 2 ** Math.max(4, Math.ceil(Math.log2((4 * rate_hz) / passed / stride)));
  for (; half <= Math.min(Math.max(c.longest, 32 * stride), MOST * stride); half *= 2) {
    const lines = Math.max(1, Math.min(Math.ceil((top * half) / rate_hz), Math.floor((half - 1) / 2) + 1));
    const f = Float64Array.from({ length: lines }, (_, k) => (2 * k + 1) * ((0.5 * rate_hz) / half));
    const y = answer(closed(modelOn(model, f), response(controller, f)), half, stride);
    const end = endOf(y);
    if (rests(y, c.flat) && Math.abs(end - final) < 2 * c.flat * Math.max(Math.abs(final), 1e-9)) {
      return { timeS: y.map((_, k) => (k * stride) / rate_hz), y, ...readOff(y, final, stride / rate_hz) };
    }
  }
  return null;
}

/** Samples of half a period that a page computes while something is dragged; Python goes on. */
const MOST = 2 ** 14;
const sweeps = new Map<number, Real>();

function sweepOf(rate_hz: number): Real {
  const made = sweeps.get(rate_hz) ?? geometric(1e-6 * rate_hz, 0.4999 * rate_hz, 2000);
  sweeps.set(rate_hz, made);
  return made;
}

const models = new WeakMap<FitModel, WeakMap<Real, Complex>>();

/** num(s)/den(s) exp(-s delay) at frequencies in Hz. */
function modelOn(model: FitModel, f: Real): Complex {
  const own = models.get(model) ?? new WeakMap<Real, Complex>();
  models.set(model, own);
  const made = own.get(f) ?? modelResponse(model, f);
  own.set(f, made);
  return made;
}

function modelResponse({ num, den, delay_s }: FitModel, f: Real): Complex {
  const out: Complex = { re: new Float64Array(f.length), im: new Float64Array(f.length) };
  for (let k = 0; k < f.length; k++) {
    const w = TWO_PI * f[k];
    const [a, b] = polynomial(num, w);
    const [x, y] = polynomial(den, w);
    const size = x * x + y * y;
    const [re, im] = [(a * x + b * y) / size, (b * x - a * y) / size];
    const [cos, sin] = [Math.cos(w * delay_s), -Math.sin(w * delay_s)];
    out.re[k] = re * cos - im * sin;
    out.im[k] = re * sin + im * cos;
  }
  return out;
}

/** A polynomial in s, descending powers, at s = j w. */
function polynomial(coefficients: number[], w: number): [number, number] {
  let [re, im] = [0, 0];
  for (const one of coefficients) [re, im] = [one - w * im, w * re];
  return [re, im];
}

/** T = C P/(1 + C P). */
function closed(P: Complex, C: Complex): Complex {
  const out: Complex = { re: new Float64Array(P.re.length), im: new Float64Array(P.re.length) };
  for (let k = 0; k < P.re.length; k++) {
    const [a, b] = [P.re[k] * C.re[k] - P.im[k] * C.im[k], P.re[k] * C.im[k] + P.im[k] * C.re[k]];
    const size = (1 + a) * (1 + a) + b * b;
    out.re[k] = (a * (1 + a) + b * b) / size;
    out.im[k] = b / size;
  }
  return out;
}

/** Unit step from rest at 0, of T (lines,) at odd harmonics of a square wave. */
function answer(T: Complex, half: number, stride: number): Real {
  const count = (2 * half) / stride;
  const [re, im] = [new Float64Array(count), new Float64Array(count)];
  for (let i = 0; i < T.re.length; i++) {
    const k = 2 * i + 1;
    // 2/(1 - exp(-j 2 pi k/(2 half))) = 1 - j cot(pi k/(2 half))
    const turn = -1 / Math.tan((0.5 * Math.PI * k) / half);
    const scale = 1 / (2 * half);
    const [x, y] = [scale * (T.re[i] - turn * T.im[i]), scale * (T.re[i] * turn + T.im[i])];
    re[k] += x;
    im[k] += y;
    re[count - k] += x;
    im[count - k] -= y;
  }
  transform(re, im);
  const swing = re.slice(0, count / 2);
  const end = endOf(swing);
  return swing.map((value) => value + end);
}

/** Sum of re + j im times exp(j 2 pi k n/count), in place; as many as a power of 2 (Cooley and Tukey 1965). */
function transform(re: Real, im: Real): void {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) [re[i], re[j], im[i], im[j]] = [re[j], re[i], im[j], im[i]];
  }
  for (let size = 2; size <= n; size *= 2) {
    const part = size / 2;
    for (let k = 0; k < part; k++) {
      const [c, s] = [Math.cos((TWO_PI * k) / size), Math.sin((TWO_PI * k) / size)];
      for (let i = k; i < n; i += size) {
        const j = i + part;
        const [x, y] = [re[j] * c - im[j] * s, re[j] * s + im[j] * c];
        [re[j], im[j]] = [re[i] - x, im[i] - y];
        [re[i], im[i]] = [re[i] + x, im[i] + y];
      }
    }
  }
}

function endOf(y: Real): number {
  const last = y.subarray(-8);
  return last.reduce((a, b) => a + b, 0) / last.length;
}

/** Whether a response stays where it ends over its last quarter, in means of neighbours, weighted 1, 2, 1. */
function rests(y: Real, flat: number): boolean {
  const end = endOf(y);
  for (let k = y.length - Math.floor(y.length / 4) + 1; k < y.length - 1; k++) {
    const smooth = 0.25 * y[k - 1] + 0.5 * y[k] + 0.25 * y[k + 1];
    if (!(Math.abs(smooth - end) < flat * Math.max(Math.abs(end), 1e-9))) return false;
  }
  return true;
}

/** Overshoot, and from when on the response stays within 2 % of its final value (Python: loop/indicators.py). */
function readOff(y: Real, final: number, stepS: number): { overshoot: number; settlingS: number } {
  const far = y.map((value) => Math.abs(value / final - 1));
  const overshoot = Math.max(y.reduce((most, value) => Math.max(most, value / final), -Infinity) - 1, 0);
  const k = far.findLastIndex((value) => value > 0.02);
  if (k < 0) return { overshoot, settlingS: 0 };
  if (k >= y.length - Math.max(1, Math.round(0.2 * y.length))) return { overshoot, settlingS: NaN };
  return { overshoot, settlingS: stepS * (k + (0.02 - far[k]) / (far[k + 1] - far[k])) };
}
