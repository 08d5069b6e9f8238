// The plots: Bode of one response, Nichols and Nyquist of L; all operating points, the worst in front.

import { fromDb, TWO_PI, type Complex, type Real } from "./arrays";
import { wrappedDown } from "./phase";
import type { Axis, Curve, Plot, Style } from "./plot";
import type { Step } from "./step";

/** What there is to draw of one operating point. */
export interface Trace {
  name: string;
  f: Real;
  P: Complex;
  C: Complex;
  L: Complex;
}

export const RESPONSES = ["L", "P", "C", "S", "T", "CS", "PS"] as const;
export type Response = (typeof RESPONSES)[number];

/** One of a loop's responses on its lines. */
export function responseOf({ P, C, L }: Trace, name: Response): Complex {
  if (name === "L" || name === "P" || name === "C") return { L, P, C }[name];
  const top = { S: null, T: L, CS: C, PS: P }[name];
  const n = L.re.length;
  const out = { re: new Float64Array(n), im: new Float64Array(n) };
  for (let k = 0; k < n; k++) {
    const [x, y] = [1 + L.re[k], L.im[k]];
    const size = x * x + y * y;
    const [a, b] = top ? [top.re[k], top.im[k]] : [1, 0];
    out.re[k] = (a * x + b * y) / size;
    out.im[k] = (b * x - a * y) / size;
  }
  return out;
}

export const sizeDb = (z: Complex): Real => z.re.map((re, k) => 10 * Math.log10(re * re + z.im[k] * z.im[k]));
export const phaseDeg = (z: Complex): Real => wrappedDown(z);

const range = (curves: Real[], step: number, least: number, low: number, high: number): [number, number] => {
  let [down, up] = [Infinity, -Infinity];
  for (const curve of curves) {
    for (const value of curve) {
      if (Number.isFinite(value)) [down, up] = [Math.min(down, value), Math.max(up, value)];
    }
  }
  if (up < down) return [low, high];
  [down, up] = [Math.max(down, low), Math.min(up, high)];
  if (up - down < least) [down, up] = [(up + down - least) / 2, (up + down + least) / 2];
  return [Math.floor((down - 2) / step) * step, Math.ceil((up + 2) / step) * step];
};

export function frequencyAxis(traces: Trace[], label: string): Axis {
  const low = Math.min(...traces.map((x) => x.f[0]));
  const high = Math.max(...traces.map((x) => x.f[x.f.length - 1]));
  return { low: low / 1.08, high: high * 1.08, log: true, label };
}

/** dB of curves, and of limits that are drawn among them. */
export function sizeAxis(curves: Real[], name: string): Axis {
  const [low, high] = range(curves, 10, 40, -120, 120);
  return { low, high, log: false, label: `|${name}| [dB]`, ticks: high - low > 100 ? 20 : 10 };
}

export function phaseAxis(curves: Real[]): Axis {
  const [low, high] = range(curves, 45, 180, -720, 360);
  return { low, high, log: false, label: "phase [deg]", ticks: high - low > 400 ? 90 : 45 };
}

/** dB from what is seen of L, 0 among them; far more than that only where all of L lies there. */
export function nicholsAxis(traces: Trace[]): Axis {
  const [low, high] = range(traces.map(({ L }) => sizeDb(L)), 10, 40, -90, 60);
  return { low: Math.min(high < 0 ? low : Math.max(low, -40), -20), high: Math.max(Math.min(high, 40), 20), log: false, label: "|L| [dB]", ticks: low < -60 && high < 0 ? 20 : 10 };
}

/** Axes of steps: as long as the one in front takes, or else the longest. */
export function stepAxes(steps: (Step | null)[], front: Step | null): [Axis, Axis] {
  const known = steps.filter((one) => one !== null);
  const longest = Math.max(...known.map((one) => one.timeS[one.timeS.length - 1]), 1e-6);
  const end = front ? Math.min(front.timeS[front.timeS.length - 1], 2.5 * front.settlingS || Infinity) : longest;
  const low = Math.min(0, ...known.map((one) => one.y.reduce((a, b) => Math.min(a, b), 0)));
  const high = Math.max(1, ...known.map((one) => one.y.reduce((a, b) => Math.max(a, b), 0)));
  const room = 0.06 * (Math.min(high, 4) - Math.max(low, -2));
  const x: Axis = { low: 0, high: end, log: false, label: "time [s]" };
  return [x, { low: Math.max(low, -2) - room, high: Math.min(high, 4) + room, log: false, label: "step of the fit" }];
}

/** Phase of L in Nichols coordinates, (-360, 0], with a break where it wraps. */
export function nicholsCurve(L: Complex): Curve {
  const [x, y]: [number[], number[]] = [[], []];
  let before = 0;
  for (let k = 0; k < L.re.length; k++) {
    const raw = (Math.atan2(L.im[k], L.re[k]) * 180) / Math.PI;
    const phase = raw > 0 ? raw - 360 : raw;
    if (k > 0 && Math.abs(phase - before) > 180) {
      x.push(NaN);
      y.push(NaN);
    }
    x.push(phase);
    y.push(10 * Math.log10(L.re[k] ** 2 + L.im[k] ** 2));
    before = phase;
  }
  return { x, y };
}

function inNichols(points: [number, number][]): Curve {
  const z = { re: Float64Array.from(points, (p) => p[0]), im: Float64Array.from(points, (p) => p[1]) };
  return nicholsCurve(z);
}

const TURNS = Array.from({ length: 361 }, (_, k) => 1e-6 + ((TWO_PI - 2e-6) * k) / 360);

/** Open loops with |S| at a level in dB: a circle about -1. */
function constantS(level: number): [number, number][] {
  return TURNS.map((t) => [-1 + Math.cos(t) / fromDb(level), Math.sin(t) / fromDb(level)]);
}

/** Open loops with |T| at a level in dB. */
function constantT(level: number): [number, number][] {
  const size = fromDb(level);
  return TURNS.map((t) => {
    const [a, b] = [size * Math.cos(t), size * Math.sin(t)];
    const [x, y] = [1 - a, -b];
    const d = x * x + y * y;
    return [(a * x + b * y) / d, (b * x - a * y) / d];
  });
}

/** Chart of a Nichols plot: contours of |S| and |T|, and the region that a peak of |S| excludes. */
export function nicholsChart(plot: Plot, peakDb: number | null, peakT: number | null): void {
  const { grid, quiet, limit } = plot.colours;
  for (const level of [-12, -6, -3, 0, 3, 6, 12]) {
    plot.curve(inNichols(constantS(level)), { colour: quiet, width: 0.8, alpha: 0.55 });
  }
  for (const level of [-12, -6, -3, 1, 3, 6, 12]) {
    plot.curve(inNichols(constantT(level)), { colour: quiet, width: 0.8, dash: [3, 3], alpha: 0.55 });
  }
  if (peakDb !== null && peakDb > 0) {
    plot.fill(inNichols(constantS(peakDb)), limit, 0.14);
    plot.curve(inNichols(constantS(peakDb)), { colour: limit, width: 1.6 });
  }
  if (peakT !== null && peakT > 0) plot.curve(inNichols(constantT(peakT)), { colour: limit, width: 1.4, dash: [5, 4] });
  plot.level(0, { colour: grid, width: 1.2 });
  plot.cross(-180, 0, plot.colours.ink);
}

export function nyquistChart(plot: Plot, peakDb: number | null): void {
  const { quiet, limit, ink } = plot.colours;
  const circle = (radius: number, centre: number): Curve => ({
    x: TURNS.map((t) => centre + radius * Math.cos(t)),
    y: TURNS.map((t) => radius * Math.sin(t)),
  });
  plot.curve(circle(1, 0), { colour: quiet, width: 1, dash: [3, 3] });
  if (peakDb !== null && peakDb > 0) {
    plot.fill(circle(1 / fromDb(peakDb), -1), limit, 0.14);
    plot.curve(circle(1 / fromDb(peakDb), -1), { colour: limit, width: 1.6 });
  }
  plot.cross(-1, 0, ink);
}

/** How each operating point is drawn: the rest thin, the chosen one and the worst in front. */
export function styleOf(plot: Plot, index: number, worst: number, chosen: number | null, alone: boolean): Style {
  const { point, worst: hot, chosen: cold } = plot.colours;
  if (index === chosen) return { colour: cold, width: 2.6 };
  if (index === worst) return { colour: hot, width: 2.4 };
  return { colour: point, width: 1.1, alpha: alone ? 1 : 0.6 };
}
