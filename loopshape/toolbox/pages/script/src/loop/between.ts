// What the lines step over: a resonance between them that may encircle -1, and turns of 1 + L past those close together
// (Python: loop/between.py, and `sampling` of loop/obstacles.py).

import { clip, magnitudes, placeIn, type Real } from "../numbers/arrays";
import { turnsPastCluster } from "./cluster";
import { chordsOf, type Loop } from "./loop";
import type { ModeCluster } from "../payload";

export interface Undecided {
  reason: string;
  band_hz: [number, number] | null;
}

export const short = (value: number, digits = 3): string => String(Number(value.toPrecision(digits)));

/** What lies between lines and not on a path along them (Python: `Sampling`). */
export interface Past {
  turns: number;
  interpolated: Uint8Array;
  unclear: Undecided | null;
}

/** Turns of 1 + L past resonances of the plant that lines and path step over. */
export function pastResonances(loop: Loop): Past {
  const { point, f } = loop;
  const out: Past = { turns: 0, interpolated: new Uint8Array(Math.max(f.length - 1, 0)), unclear: null };
  const near = point.clusters.length || point.hidden.length || point.interpolation_residual ? nearest(loop) : null;
  const clusters = near ? reached(loop, near) : [];
  for (const cluster of clusters) if (cluster.left !== "scatter") pastCluster(loop, cluster, out);
  const size = near && point.hidden.length ? largerC(loop) : new Float64Array(0);
  for (const { low_hz, high_hz, centre_hz, peak } of near ? point.hidden : []) {
    const first = clip(placeIn(f, low_hz, true) - 1, 0, f.length - 2);
    const last = clip(placeIn(f, high_hz), first + 1, f.length - 1);
    const largest = peak * Math.max(...size.subarray(first, last));
    if (out.interpolated[clip(placeIn(f, centre_hz) - 1, 0, f.length - 2)] || !near || largest <= Math.min(...near.subarray(first, last))) continue;
    out.interpolated.fill(1, first, last);
    const words = `a resonance between ${short(f[first], 4)} and ${short(f[last], 4)} Hz, sharper than the lines, may or may not encircle -1`;
    out.unclear ??= { reason: `${words}: measure finer there`, band_hz: [f[first], f[last]] };
  }
  if (near) out.unclear ??= scatters(loop, near, clusters.filter(({ left }) => left === "scatter"));
  return out;
}

/** How near the path comes to -1 in each gap between lines. */
function nearest(loop: Loop): Real {
  const { f, dense } = loop;
  const near = chordsOf(loop);
  const at = Array.from(f, (x) => placeIn(dense.f, x));
  return Float64Array.from({ length: f.length - 1 }, (_, k) => near.subarray(at[k], at[k + 1]).reduce((a, b) => Math.min(a, b), Infinity));
}

/** The larger |C| on either side of each gap. */
function largerC({ C }: Loop): Real {
  const size = magnitudes(C);
  return size.subarray(1).map((value, k) => Math.max(value, size[k]));
}

/** Resonances close together that might encircle -1. */
function reached(loop: Loop, near: Real): ModeCluster[] {
  const { f, point, plant } = loop;
  const { sharpest, peak } = plant.source.constants;
  const largest = largerC(loop).map((size, k) => size * Math.min((f[k + 1] - f[k]) / (sharpest * f[k]), peak));
  return point.clusters.filter(({ low, high, polynomial_residual }) => largest.subarray(low, high).some((size, k) => polynomial_residual * size > near[low + k]));
}

function pastCluster(loop: Loop, cluster: ModeCluster, out: Past): void {
  const { f, plant } = loop;
  const { low, high } = cluster;
  const { least, most, near, sure } = turnsPastCluster(cluster, loop);
  out.turns += least;
  out.interpolated.fill(1, low, high);
  const size = largerC(loop);
  const hidden = gapsWhere(near, (value, k) => size[low + k] * cluster.hidden[k] > plant.source.constants.sharpest * f[low + k] * value);
  if (hidden.length) out.unclear ??= unexplained(f[low + hidden[0]], f[low + hidden[hidden.length - 1] + 1]);
  else if (least !== most || !sure) {
    const words = `resonances between ${short(f[low], 4)} and ${short(f[high], 4)} Hz, close together, may or may not encircle -1`;
    out.unclear ??= { reason: `${words}: measure finer there`, band_hz: [f[low], f[high]] };
  }
}

/** Gaps about which lines scatter so near -1 that their error, a disk about them, holds it. */
function scatters(loop: Loop, near: Real, clusters: ModeCluster[]): Undecided | null {
  const { f, point, plant } = loop;
  const { interpolation_residual } = point;
  if (!interpolation_residual) return null;
  const scatter = new Uint8Array(interpolation_residual.length);
  for (const k of point.scattered) scatter[k] = 1;
  for (const { low, high } of clusters) scatter.fill(1, low, high);
  const gaps = gapsWhere(largerC(loop), (size, k) => scatter[k] > 0 && plant.source.constants.scatter * size * interpolation_residual[k] > near[k]);
  return gaps.length ? unexplained(f[gaps[0]], f[gaps[gaps.length - 1] + 1]) : null;
}

const gapsWhere = (values: Real, holds: (value: number, k: number) => boolean): number[] =>
  Array.from(values.keys()).filter((k) => holds(values[k], k));

function unexplained(low: number, high: number): Undecided {
  const reason = `neither noise nor resonances explain the lines between ${short(low, 4)} and ${short(high, 4)} Hz: measure finer there`;
  return { reason, band_hz: [low, high] };
}
