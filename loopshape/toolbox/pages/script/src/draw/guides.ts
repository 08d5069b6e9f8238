// What stands behind the curves: limits of the requirements, 0 dB, -180 degrees, and the required margins.

import { db } from "../numbers/arrays";
import { MASKED, masksOn } from "../loop/limits";
import type { Limit, Requirements } from "../payload";
import type { Plot, Style } from "./plot";

/** What is required of the point in front and of all of them, and the table of limits with the response that each limits. */
export interface RequiredLimits {
  requirements: Requirements;
  every: Requirements;
  limits: Limit[];
}

export function limitOf({ requirements }: RequiredLimits, name: string): number | null {
  const value = requirements[name];
  return typeof value === "number" ? value : null;
}

/** The sharper of the limits on |S|'s peak and on the modulus margin, as |S| in dB; null without either. */
export function closestDb(required: RequiredLimits): number | null {
  const [peak, modulus] = [limitOf(required, "sensitivity_peak_db"), limitOf(required, "modulus_margin")];
  const limits = [peak, modulus === null ? null : -db(modulus)].filter((x) => x !== null && x > 0) as number[];
  return limits.length ? Math.min(...limits) : null;
}

/** Upper limits of a response in dB, each with the frequency it begins at (0: everywhere). */
export function ceilings(required: RequiredLimits, name: string): { level: number; fromHz: number }[] {
  if (name === "S") return [closestDb(required)].flatMap((level) => (level === null ? [] : [{ level, fromHz: 0 }]));
  const own = required.limits.filter(({ name: limit, plot, sense, unit }) => plot === name && sense === "at_most" && unit === "dB" && !MASKED.includes(limit));
  return own.flatMap((limit) => {
    const level = limitOf(required, limit.name);
    const from = limit.name === "control_high_frequency_db" ? limitOf(required, "control_high_frequency_from_hz") : 0;
    return level === null ? [] : [{ level, fromHz: from ?? 0 }];
  });
}

/** Values in dB that an axis must span to show the limits of a response. */
export function limitSizes(required: RequiredLimits, name: string): Float64Array {
  const tops = ceilings(required, name).flatMap(({ level }) => [level, level + 3]);
  return Float64Array.from([...tops, ...masksOn(required.every, name).flatMap(({ points }) => points.map(([, level]) => level))]);
}

const across = (plot: Plot): Style => ({ colour: plot.colours.ink, width: 1, dash: [6, 3] });
const edge = (plot: Plot): Style => ({ colour: plot.colours.limit, width: 1.6 });

/** 0 dB, limits with their forbidden side tinted (masks of other points dashed), and of L the required bandwidth. */
export function sizeGuides(plot: Plot, name: string, required: RequiredLimits): void {
  const { limit } = plot.colours;
  plot.level(0, across(plot));
  for (const { level, fromHz } of ceilings(required, name)) {
    const left = Math.max(fromHz, plot.x.low);
    if (left >= plot.x.high) continue;
    forbid(plot, [left, plot.x.high], [level, level], plot.y.high);
    const from = fromHz ? ` from ${fromHz} Hz` : "";
    plot.say(`at most ${Number(level.toPrecision(4))} dB${from}`, plot.px(plot.x.high) - 6, plot.py(level) - 4, limit, "right");
  }
  for (const mask of masksOn(required.every, name)) {
    const [hz, levels] = [mask.points.map(([f]) => f), mask.points.map(([, level]) => level)];
    const isOwn = masksOn(required.requirements, name).includes(mask);
    if (isOwn) forbid(plot, hz, levels, mask.sense === "at_least" ? plot.y.low : plot.y.high);
    else plot.curve({ x: hz, y: levels }, { ...edge(plot), dash: [5, 3] });
  }
  const bandwidth = name === "L" ? limitOf(required, "bandwidth_hz") : null;
  if (bandwidth === null) return;
  plot.upright(bandwidth, edge(plot));
  const isLeft = plot.px(bandwidth) > plot.width / 2;
  const place = plot.px(bandwidth) + (isLeft ? -5 : 5);
  plot.say(`bandwidth at least ${bandwidth} Hz`, place, plot.py(plot.y.low) - 6, limit, isLeft ? "right" : "left");
}

function forbid(plot: Plot, x: number[], y: number[], end: number): void {
  plot.fill({ x: [x[0], ...x, x[x.length - 1]], y: [end, ...y, end] }, plot.colours.limit, 0.11);
  plot.curve({ x, y }, edge(plot));
}

/** Phases at which -1 lies, and the phase that the required margin leaves to the first of them. */
export function phaseGuides(plot: Plot, required: RequiredLimits): void {
  for (const turn of turns(plot.y.low, plot.y.high)) plot.level(turn - 180, across(plot));
  const margin = limitOf(required, "phase_margin_deg");
  if (margin === null) return;
  plot.level(margin - 180, { ...edge(plot), dash: [2, 3] });
  plot.say(`phase margin ${margin} deg`, plot.px(plot.x.high) - 6, plot.py(margin - 180) - 5, plot.colours.limit, "right");
}

/** Whole turns in degrees by which -180 is repeated within a range of phases. */
function turns(low: number, high: number): number[] {
  const [first, last] = [Math.ceil((low + 180) / 360), Math.floor((high + 180) / 360)];
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, k) => 360 * (first + k));
}

/** Required margins at the critical point: sideways the phase, down the gain, up its reduction. */
export function marginCross(plot: Plot, required: RequiredLimits): void {
  const phase = limitOf(required, "phase_margin_deg") ?? 0;
  const [down, up] = [limitOf(required, "gain_margin_db") ?? 0, limitOf(required, "gain_reduction_margin_db") ?? 0];
  const style = { colour: plot.colours.limit, width: 2.2 };
  if (phase) plot.curve({ x: [-180 - phase, -180 + phase], y: [0, 0] }, style);
  if (down || up) plot.curve({ x: [-180, -180], y: [-down, up] }, style);
}
