// What the lines step over: turns of 1 + L past resonances between them, and past those that stand close together
// (Python: loop/between.py, and `sampling` of loop/obstacles.py).

import { clip, magnitudes, placeIn, times, TWO_PI, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import { turnsPastCluster } from "./cluster";
import { narrowAt } from "../numbers/dense";
import type { Loop } from "./loop";
import type { ModeCluster, Hidden } from "../payload";
import { angleOf, chords, turnAlong } from "./turns";

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
  const near = point.clusters.length || point.interpolation_residual ? nearest(loop) : null;
  const clusters = near ? reached(loop, near) : [];
  for (const cluster of clusters) if (cluster.left !== "scatter") pastCluster(loop, cluster, out);
  for (const pole of point.hidden) {
    if (out.interpolated[clip(placeIn(f, pole.centre[0]) - 1, 0, f.length - 2)]) continue;
    const { first, last, least, most, sure } = turnsPast(loop, pole);
    out.turns += least;
    out.interpolated.fill(1, first, last);
    if (least === most && sure) continue;
    const words = `a resonance between ${short(f[first], 4)} and ${short(f[last], 4)} Hz, sharper than the lines, may or may not encircle -1`;
    out.unclear ??= { reason: `${words}: measure finer there`, band_hz: [f[first], f[last]] };
  }
  if (near) out.unclear ??= scatters(loop, near, clusters.filter(({ left }) => left === "scatter"));
  return out;
}

/** How near the path comes to -1 in each gap between lines. */
function nearest({ f, dense, denseL }: Loop): Real {
  const near = chords(denseL);
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

interface Turns {
  first: number;
  last: number;
  least: number;
  most: number;
  sure: boolean;
}

function turnsPast(loop: Loop, pole: Hidden): Turns {
  const { point, f, denseL, dense, controller } = loop;
  const { neighbour_lines } = loop.plant.source.constants;
  const low = clip(placeIn(f, pole.low_hz, true) - 1, 0, f.length - 2);
  const high = clip(placeIn(f, pole.high_hz), low + 1, f.length - 1);
  const first = Math.max(low - neighbour_lines, 0);
  const last = Math.min(high + neighbour_lines, f.length - 1);
  const own = f.slice(first, last + 1);
  const rest: Complex = { re: point.raw.re.slice(first, last + 1), im: point.raw.im.slice(first, last + 1) };
  for (let k = 0; k < own.length; k++) {
    const narrow = narrowAt(point, own[k]);
    rest.re[k] -= narrow[0];
    rest.im[k] -= narrow[1];
  }
  const [here, there] = [placeIn(dense.f, own[0]), placeIn(dense.f, own[own.length - 1])];
  const straight = turnAlong(denseL, here, there);
  const out: Turns = { first, last, least: Infinity, most: -Infinity, sure: true };
  for (let c = 0; c < pole.centre.length; c++) {
    const path = pastPole(loop, pole, c, own, rest);
    const turns = Math.round((turnAlong(path.L, 0, path.at.length - 1) - straight) / TWO_PI);
    out.least = Math.min(out.least, turns);
    out.most = Math.max(out.most, turns);
    if (c === 0) {
      const bulge = bulges(own, times(control.response(controller, own), path.smooth), loop.plant.source.constants.bulge);
      out.sure = chords(path.L).every((near, k) => near > bulge[clip(placeIn(own, path.at[k], true) - 1, 0, own.length - 2)]);
    }
  }
  return out;
}

function pastPole(loop: Loop, pole: Hidden, c: number, own: Real, rest: Complex): { at: Real; L: Complex; smooth: Complex } {
  const [zr, zi] = [pole.centre[c], pole.width[c]];
  const [rr, ri] = [pole.residue.re[c], pole.residue.im[c]];
  const term = (x: number): [number, number] => {
    const size = (x - zr) ** 2 + zi * zi;
    const [qr, qi] = [(rr * (x - zr) - ri * zi) / size, (ri * (x - zr) + rr * zi) / size];
    return [qi, -qr];
  };
  const smooth: Complex = { re: rest.re.slice(), im: rest.im.slice() };
  own.forEach((x, k) => {
    const [re, im] = term(x);
    smooth.re[k] -= re;
    smooth.im[k] -= im;
  });
  const [start, end] = [own[0], own[own.length - 1]];
  const even = Array.from({ length: 4 * own.length }, (_, k) => start + ((end - start) * k) / (4 * own.length - 1));
  const near = loop.plant.source.constants.path_half_widths.map((place) => zr + Math.abs(zi) * place);
  const at = Float64Array.from([...near, ...own, ...even], (x) => clip(x, start, end)).sort();
  const P: Complex = { re: new Float64Array(at.length), im: new Float64Array(at.length) };
  for (let k = 0; k < at.length; k++) {
    const gap = clip(placeIn(own, at[k], true) - 1, 0, own.length - 2);
    const share = (at[k] - own[gap]) / (own[gap + 1] - own[gap]);
    const [re, im] = term(at[k]);
    const narrow = narrowAt(loop.point, at[k]);
    P.re[k] = re + smooth.re[gap] + share * (smooth.re[gap + 1] - smooth.re[gap]) + narrow[0];
    P.im[k] = im + smooth.im[gap] + share * (smooth.im[gap + 1] - smooth.im[gap]) + narrow[1];
  }
  return { at, L: times(control.response(loop.controller, at), P), smooth };
}

/** How far L may leave its curve between lines (`bulges`). */
function bulges(f: Real, L: Complex, share: number): Real {
  const n = f.length;
  const off = new Float64Array(n);
  for (let k = 1; k < n - 1; k++) {
    const part = Math.log(f[k] / f[k - 1]) / Math.log(f[k + 1] / f[k - 1]);
    const size = Math.hypot(L.re[k + 1], L.im[k + 1]) / Math.hypot(L.re[k - 1], L.im[k - 1]);
    const turn = angleOf(L.re[k + 1], L.im[k + 1], L.re[k - 1], L.im[k - 1]) * part;
    const [qr, qi] = [size ** part * Math.cos(turn), size ** part * Math.sin(turn)];
    const re = L.re[k - 1] * qr - L.im[k - 1] * qi;
    const im = L.re[k - 1] * qi + L.im[k - 1] * qr;
    const value = Math.hypot(L.re[k] - re, L.im[k] - im);
    off[k] = Number.isFinite(value) ? value : 0;
  }
  off[0] = off[1];
  off[n - 1] = off[n - 2];
  return Float64Array.from({ length: n - 1 }, (_, k) => share * Math.max(off[k], off[k + 1]));
}
