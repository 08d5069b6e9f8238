// The plots: Bode of one response, Nichols and Nyquist of L; all operating points, the worst in front.

import { fromDb, placeIn, TWO_PI, type Complex, type Real } from "../numbers/arrays";
import { closestDb, limitOf, marginCross, type RequiredLimits } from "./guides";
import { wrappedDown } from "./phase";
import type { Axis, Curve, Plot, Style } from "./plot";
import { squares } from "../loop/reading";
import type { Step } from "../numbers/step";

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

/** Remembers what is made of a response: magnitude and phase are drawn on several plots. */
function remembered(make: (z: Complex) => Real): (z: Complex) => Real {
  const known = new WeakMap<Complex, Real>();
  return (z) => {
    const made = known.get(z) ?? make(z);
    known.set(z, made);
    return made;
  };
}

export const sizeDb = remembered((z) => squares(z).map((square) => 10 * Math.log10(square)));
export const phaseDeg = remembered(wrappedDown);

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

/** dB of curves, and of limits that are drawn among them, at most `most` below the top. */
export function sizeAxis(curves: Real[], name: string, most = 240): Axis {
  const [all, high] = range(curves, 10, 40, -120, 120);
  const low = Math.max(all, high - most);
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

/** L in Nichols coordinates, line by line: phase in (-360, 0] and dB. */
export function nicholsPlaces(L: Complex): Curve {
  return { x: phaseDeg(L).map((phase) => phase - 360 * Math.ceil(phase / 360)), y: sizeDb(L) };
}

/** L as a curve in Nichols coordinates, with a break where the phase wraps. */
export function nicholsCurve(L: Complex): Curve {
  const places = nicholsPlaces(L);
  const [x, y]: [number[], number[]] = [[], []];
  for (let k = 0; k < places.x.length; k++) {
    if (k > 0 && Math.abs(places.x[k] - places.x[k - 1]) > 180) {
      x.push(NaN);
      y.push(NaN);
    }
    x.push(places.x[k]);
    y.push(places.y[k]);
  }
  return { x, y };
}

const TURNS = Float64Array.from({ length: 361 }, (_, k) => 1e-6 + ((TWO_PI - 2e-6) * k) / 360);

/** Open loops with |S| at a level in dB: a circle about -1. */
function constantS(level: number): Complex {
  return { re: TURNS.map((t) => -1 + Math.cos(t) / fromDb(level)), im: TURNS.map((t) => Math.sin(t) / fromDb(level)) };
}

/** Open loops with |T| at a level in dB. */
function constantT(level: number): Complex {
  const out = { re: new Float64Array(TURNS.length), im: new Float64Array(TURNS.length) };
  TURNS.forEach((t, k) => {
    const [a, b] = [fromDb(level) * Math.cos(t), fromDb(level) * Math.sin(t)];
    const d = (1 - a) ** 2 + b * b;
    [out.re[k], out.im[k]] = [(a * (1 - a) - b * b) / d, b / d];
  });
  return out;
}

const contours = new Map<string, Curve>();

/** A contour of |S| or |T| on the Nichols plot, made once for each level in dB. */
function contour(of: "S" | "T", level: number): Curve {
  const name = `${of} ${level}`;
  const known = contours.get(name) ?? nicholsCurve(of === "S" ? constantS(level) : constantT(level));
  contours.set(name, known);
  return known;
}

/** Chart of a Nichols plot: contours of |S| and |T|, the region that is excluded, and the required margins. */
export function nicholsChart(plot: Plot, required: RequiredLimits): void {
  const { grid, quiet, limit, ink } = plot.colours;
  const [closest, peakT] = [closestDb(required), limitOf(required, "complementary_peak_db")];
  for (const level of [-12, -6, -3, 1, 3, 6, 12]) {
    plot.curve(contour("T", level), { colour: quiet, width: 0.8, dash: [3, 3], alpha: 0.55 });
  }
  for (const level of [-12, -6, -3, 0, 3, 6, 12].filter((one) => closest === null || one < closest)) contourS(plot, level);
  if (closest !== null) {
    plot.fill(contour("S", closest), limit, 0.14);
    plot.curve(contour("S", closest), { colour: limit, width: 1.6 });
  }
  if (peakT !== null && peakT > 0) plot.curve(contour("T", peakT), { colour: limit, width: 1.4, dash: [5, 4] });
  plot.level(0, { colour: grid, width: 1.2 });
  marginCross(plot, required);
  plot.cross(-180, 0, ink);
}

/** |S| constant, named where it is closed and large at its left end, else on its right branch. */
function contourS(plot: Plot, level: number): void {
  const { x, y } = contour("S", level);
  plot.curve({ x, y }, { colour: plot.colours.quiet, width: 0.8, alpha: 0.55 });
  const k = level > 0 ? Array.from(x).indexOf(Math.min(...Array.from(x).filter(Number.isFinite))) : Math.round(0.93 * x.length);
  const isClear = level <= 0 || plot.px(-180) - plot.px(x[k]) > 40;
  if (isClear && plot.holds(x[k], y[k], 24)) plot.text(`${level} dB`, plot.px(x[k]), plot.py(y[k]) + 4, plot.colours.quiet, "center");
}

export function nyquistChart(plot: Plot, required: RequiredLimits): void {
  const { quiet, limit, ink } = plot.colours;
  const closest = closestDb(required);
  const circle = (radius: number, centre: number): Curve => ({
    x: TURNS.map((t) => centre + radius * Math.cos(t)),
    y: TURNS.map((t) => radius * Math.sin(t)),
  });
  plot.curve(circle(1, 0), { colour: quiet, width: 1, dash: [3, 3] });
  if (closest !== null) {
    plot.fill(circle(1 / fromDb(closest), -1), limit, 0.14);
    plot.curve(circle(1 / fromDb(closest), -1), { colour: limit, width: 1.6 });
  }
  plot.cross(-1, 0, ink);
}

/** How each operating point is drawn: the rest thin, the chosen one and the worst in front. */
export function styleOf(plot: Plot, index: number, worst: number, chosen: number | null, alone: boolean): Style {
  const { point, worst: hot, chosen: cold } = plot.colours;
  if (index === chosen) return { colour: cold, width: 2.6 };
  if (index === worst) return { colour: hot, width: 2.4 };
  return { colour: point, width: 1, alpha: alone ? 1 : 0.65 };
}

/** The line of rising frequencies that is nearest to a frequency. */
export function nearestLine(f: Real, hz: number): number {
  const k = Math.min(Math.max(placeIn(f, hz), 1), f.length - 1);
  return hz * hz < f[k - 1] * f[k] ? k - 1 : k;
}

/** A curve over rising frequencies between its lines, straight over ln f. */
export function interpolated(f: Real, y: ArrayLike<number>, hz: number): number {
  const k = Math.min(Math.max(placeIn(f, hz, true) - 1, 0), f.length - 2);
  const share = Math.min(Math.max(Math.log(hz / f[k]) / Math.log(f[k + 1] / f[k]), 0), 1);
  return y[k] + share * (y[k + 1] - y[k]);
}
