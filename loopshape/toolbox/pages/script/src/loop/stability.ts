// Nyquist's count with the contour closed, and what keeps the lines from carrying it (Python: loop/stability.py,
// obstacles.py, holes.py). What cannot be proved here is undecided.

import { clip, concat, deg, joined, magnitudes, placeIn, rint, steepness, times, TWO_PI, type Complex, type Real } from "../numbers/arrays";
import { pastResonances, short, type Undecided, type Past } from "./between";
import * as control from "../numbers/controller";
import { belowLines, chordsOf, feedsBackPositively, holdsBelow, inSight, isLarge, isTold, orderOf, type Loop } from "./loop";
import { aboveHz } from "./margins";
import { normalBelow } from "../numbers/special";
import type { Gap } from "../payload";
import { angleOf, turnAlong } from "./turns";

export interface Stability {
  outcome: "stable" | "unstable" | "undecided";
  reason: string;
  band_hz: [number, number] | null;
}

const undecided = (reason: string, band_hz: [number, number] | null = null): Stability => ({ outcome: "undecided", reason, band_hz });

/** Whether the closed loop is stable, as far as these data carry the count. */
export function closedLoopStability(loop: Loop): Stability {
  const { point, f, L } = loop;
  const hidden = hiddenMode(loop);
  if (hidden) return { outcome: "unstable", reason: hidden, band_hz: null };
  if (point.integrators === null) {
    return undecided("the number of integrators of the plant is not known: declare integrators in the requirements");
  }
  if (point.unstable_poles === null) {
    return undecided("the number of unstable poles of the plant is not known: declare unstable_poles in the requirements");
  }
  if (!inSight(loop)) {
    const size = Math.hypot(L.re[0], L.im[0]);
    return undecided(
      `|L| is ${short(size, 2)} at the first line already, ${short(f[0])} Hz: the crossover lies lower, measure there`,
    );
  }
  const poles = unstableCount(loop, point.unstable_poles);
  if ((typeof poles !== "number" || poles % 2 === 0) && feedsBackPositively(loop)) {
    const phase = Math.round(deg(Math.atan2(L.im[0], L.re[0])));
    const reason =
      `the feedback is positive: towards 0 Hz L is -k/s^${loop.integrators}, k > 0 (phase ${phase} deg at ${short(f[0])} Hz);` +
      " turn the controller's sign, by a gain of -1";
    return { outcome: "unstable", reason, band_hz: null };
  }
  if (typeof poles !== "number") return undecided(poles.reason, poles.band_hz);
  if (poles < 0) return undecided(`${-poles} encirclements too many for ${point.unstable_poles} unstable poles`);
  if (poles) return { outcome: "unstable", reason: `${poles} closed-loop poles in the right half plane`, band_hz: null };
  return { outcome: "stable", reason: "the encirclements of -1 balance the unstable poles", band_hz: null };
}

/** What of the closed loop L does not show, in words: a pole that a zero cancels on or right of the imaginary axis. */
function hiddenMode({ point, controller, plant }: Loop): string {
  const integrators = point.integrators ?? 0;
  const own = controller.blocks.map(control.integratorsOf);
  const zeroOfOwn = own.some((n) => n < 0);
  if (own.some((n) => n > 0) && (integrators < 0 || zeroOfOwn)) {
    const whose = integrators < 0 ? "plant" : "controller";
    return (
      `a zero of the ${whose} at 0 Hz cancels the controller's integrator: its output drifts without bound, and L` +
      " does not show it; leave the integrator out"
    );
  }
  if (integrators > 0 && zeroOfOwn) {
    return "a zero of the controller at 0 Hz cancels the plant's integrator: it drifts, and L does not show it";
  }
  const zeros = point.fitted_poles.length ? control.zerosOf(controller) : [];
  for (const [re, im] of point.fitted_poles) {
    const [x, y] = [re / controller.rate_hz, im / controller.rate_hz];
    const near = plant.source.constants.same * Math.hypot(x, y);
    if (zeros.some(([a, b]) => Math.hypot(a - Math.exp(x) * Math.cos(y), b - Math.exp(x) * Math.sin(y)) <= near)) {
      const hz = Math.hypot(re, im) / TWO_PI;
      return `a zero of the controller cancels the plant's pole at ${short(hz, 4)} Hz, which is not stable: L does not show it`;
    }
  }
  return "";
}

function unstableCount(loop: Loop, unstable: number): number | Undecided {
  const below = waysBelow(loop);
  const between = pastResonances(loop);
  const poles = counted(loop, unstable, between, below);
  const known = isTold(loop) || (poles !== null && holdsBelow(loop, poles));
  const untold = known ? null : poles === null ? misfit(loop) : unknownBelow(loop);
  const found = doubtBelow(loop) ?? undecidedBy(loop, between, startOf(loop, below[0] ?? null, unstable)) ?? untold;
  return found ?? poles ?? misfit(loop);
}

/** Closed-loop poles in the right half plane by the bare count, null where it is not known. */
export const polesOf = (loop: Loop): number | null => counted(loop, loop.point.unstable_poles ?? 0, pastResonances(loop), waysBelow(loop));

/** The count along the lines, null where its ways below them differ or do not fit the integrators. */
function counted(loop: Loop, unstable: number, between: Past, below: Complex[]): number | null {
  const near = below.length ? 0 : swingNear(loop);
  const ways: (Complex | null)[] = below.length ? below : [null];
  const fitDeg = loop.plant.source.constants.fit_deg;
  const along = turnAlong(loop.denseL, 0, loop.denseL.re.length - 1);
  const counts = new Set(ways.map((way) => countUnstable(loop.denseL, loop.integrators, unstable, way, fitDeg, near, along)));
  const poles = counts.size === 1 ? [...counts][0] : null;
  return poles === null ? null : poles - 2 * between.turns;
}

/** L below the first line towards 0 Hz, by each model that tells it; none where what lies there does not matter. */
function waysBelow(loop: Loop): Complex[] {
  const { point, controller } = loop;
  const fitted = point.fitted_f.length ? [times(control.response(controller, point.fitted_f), point.fitted)] : [];
  return isLarge(loop) ? fitted : [...fitted, ...belowLines(loop)];
}

/** Angle in rad from the phase of L's integrators to that at its first line: the controller's, and poles' below it. */
export function swingNear(loop: Loop): number {
  const { point, controller, f, plant } = loop;
  const C = control.response(controller, concat(point.below_f, f.subarray(0, 1)));
  let turn = 0;
  for (let k = 1; k < C.re.length; k++) turn += angleOf(C.re[k], C.im[k], C.re[k - 1], C.im[k - 1]);
  const [phase, slope] = orderOf(loop);
  const known = !point.unstable_poles && Math.abs(phase - slope) < plant.source.constants.agree;
  const more = known ? Math.max(rint(slope - (point.integrators ?? 0)), 0) : 0;
  return turn - 0.5 * Math.PI * more;
}

/** Where the error of a model of the lowest lines may carry L over -1 below them. */
function doubtBelow(loop: Loop): Undecided | null {
  if (!loop.dense.draws || isLarge(loop)) return null;
  const { below_ratios, radius_95 } = loop.plant.source.constants;
  const f = Float64Array.from(below_ratios.slice(1), (ratio) => loop.f[0] * ratio);
  const C = control.response(loop.controller, f);
  for (const model of loop.point.extrapolated) {
    const L = times(C, { re: model.P.re.subarray(1), im: model.P.im.subarray(1) });
    const moved = loop.plant.movesBelow(model).slice(1);
    const far = f.map((_, k) => Math.hypot(1 + L.re[k], L.im[k]) / Math.max(Math.hypot(C.re[k], C.im[k]) * moved[k].rms, 1e-300));
    const k = far.reduce((best, value, i) => (value < far[best] ? i : best), 0);
    if (far[k] < radius_95) {
      const reason = `-1 lies within the uncertainty of L at ${short(f[k])} Hz, below the first frequency, ${short(loop.f[0])} Hz`;
      return { reason: `${reason}: measure lower`, band_hz: [f[k], loop.f[0]] };
    }
  }
  return null;
}

function unknownBelow({ f, L }: Loop): Undecided {
  const size = short(Math.hypot(L.re[0], L.im[0]), 2);
  const reason = `the lowest lines do not tell how L, ${size} at ${short(f[0])} Hz, goes on below them: measure lower`;
  return { reason, band_hz: [0.1 * f[0], f[0]] };
}

function misfit(loop: Loop): Undecided {
  const { f, L, integrators } = loop;
  const phase = Math.round(deg(Math.atan2(L.im[0], L.re[0])));
  const reason =
    `the phase of L at the first line (${short(f[0])} Hz, ${phase} deg) does not fit ${integrators} integrators (the` +
    " controller's included): measure lower, or correct the declaration";
  return { reason, band_hz: [0.1 * f[0], f[0]] };
}

/** 1 + L where it comes from to the first line; null where a model leads there. */
function startOf(loop: Loop, extrapolated: Complex | null, unstable: number): number[] | null {
  if (extrapolated) return null;
  const { integrators, denseL: L } = loop;
  const negative = unstable % 2 === 1;
  if (integrators < 0) return [1, 0];
  if (!integrators) return [1 + (negative ? -1 : 1) * Math.abs(L.re[0]), 0];
  const size = 1e3 * (1 + Math.hypot(L.re[0], L.im[0])) * (negative ? -1 : 1);
  const quarter = integrators % 4;
  return [1 + size * [1, 0, -1, 0][quarter], size * [0, -1, 0, 1][quarter]];
}

/** Closed-loop poles in the right half plane by the bare count, null where the first value fits badly; `along` is how far
 * 1 + L turns along its lines. */
export function countUnstable(
  L: Complex, integrators: number, unstable: number, below: Complex | null, fitDeg: number, near = 0, along = turnAlong(L, 0, L.re.length - 1),
): number | null {
  const lower = below?.re.length ? joined(below, { re: L.re.subarray(0, 1), im: L.im.subarray(0, 1) }) : null;
  const { re, im } = lower ?? L;
  const start = turnToFirst(re[0], im[0], integrators, unstable % 2 === 1, lower !== null, fitDeg, near);
  if (start === null) return null;
  const last = L.re.length - 1;
  const turn = start + (lower ? turnAlong(lower, 0, re.length - 1) : 0) + along - Math.atan2(L.im[last], 1 + L.re[last]);
  return Math.round(unstable + 0.5 * Math.max(integrators, 0) - turn / Math.PI);
}

function turnToFirst(
  re: number, im: number, integrators: number, negative: boolean, either: boolean, fitDeg: number, near: number,
): number | null {
  // first * j^integrators
  let [ar, ai] = [re, im];
  for (let k = 0; k < Math.abs(integrators); k++) [ar, ai] = integrators > 0 ? [-ai, ar] : [ai, -ar];
  const flipped = either ? ar < 0 : negative;
  let swing = flipped ? Math.atan2(-ai, -ar) : Math.atan2(ai, ar);
  swing += TWO_PI * rint((near - swing) / TWO_PI);
  if (Math.abs(deg(swing - near)) > fitDeg) return null;
  if (integrators < 0) return Math.atan2(im, 1 + re);
  if (integrators) return swing + angleOf(1 + re, im, re, im);
  if (flipped && !either && re > -1) return null;
  if (near && Math.hypot(re, im) > 1) return swing + angleOf(1 + re, im, re, im);
  return Math.atan2(im, 1 + re) - (re < -1 ? Math.PI : 0) * Math.sign(im || 1);
}

function undecidedBy(loop: Loop, between: Past, start: number[] | null): Undecided | null {
  return tooShort(loop) ?? risesAbove(loop) ?? comesUpAgain(loop) ?? onIt(loop, between) ?? doubt(loop, between, start) ?? between.unclear ?? hole(loop);
}

function tooShort({ f, L }: Loop): Undecided | null {
  const last = f.length - 1;
  const size = Math.hypot(L.re[last], L.im[last]);
  if (size < 1) return null;
  return { reason: `|L| is still ${short(size, 2)} at the last line, ${short(f[last])} Hz: measure higher`, band_hz: null };
}

/** |L| where it is largest above all lines, |P| falling on as over the highest; 0 where it does not rise (`Loop.rise_above`). */
function riseAbove({ point, f, L, C, controller }: Loop): number {
  const own = magnitudes(L).map((x, k) => x / Math.hypot(C.re[k], C.im[k]));
  const more = point.above_band;
  const lines = more ? concat(f, more.f) : f;
  const size = more ? concat(own, magnitudes(more.P)) : own;
  const end = lines.length - 1;
  const aboveF = aboveHz(f[f.length - 1], controller.rate_hz).filter((x) => x > lines[end]);
  if (!aboveF.length) return 0;
  const first = placeIn(lines, 0.6 * lines[end]);
  const slope = end - first < 2 ? -1 : Math.min(steepness(lines.subarray(first), size.subarray(first)), 0);
  const largest = Math.max(...magnitudes(control.responseOn(controller, aboveF)).map((c, k) => size[end] * (aboveF[k] / lines[end]) ** slope * c));
  const [last] = magnitudes(control.responseOn(controller, lines.subarray(end)));
  return largest > size[end] * last ? largest : 0;
}

function risesAbove(loop: Loop): Undecided | null {
  const rise = riseAbove(loop);
  if (rise < 1) return null;
  const last = short(loop.f[loop.f.length - 1]);
  return { reason: `the controller rises above the last line, ${last} Hz: |L| may reach ${short(rise, 2)} there; measure higher`, band_hz: null };
}

function comesUpAgain({ point, controller }: Loop): Undecided | null {
  if (!point.above_band) return null;
  const f = point.above_band.f.filter((x) => x < 0.5 * controller.rate_hz);
  if (!f.length) return null;
  const L = times(control.response(controller, f), point.above_band.P);
  const size = magnitudes(L);
  const k = size.reduce((best, value, i) => (value > size[best] ? i : best), 0);
  if (size[k] < 1) return null;
  return {
    reason: `|L| reaches ${short(size[k], 2)} at ${short(f[k])} Hz, above the band that is known well: excite more there`,
    band_hz: null,
  };
}

/** Places of the path within gaps past a resonance that was interpolated, its lines not among them. */
function pastPlaces({ f, dense }: Loop, between: Past): Uint8Array {
  const out = new Uint8Array(dense.f.length);
  if (!between.interpolated.some(Boolean)) return out;
  for (let k = 0, gap = -1; k < dense.f.length; k++) {
    if (gap + 1 < f.length && dense.f[k] === f[gap + 1]) gap += 1;
    else out[k] = between.interpolated[clip(gap, 0, between.interpolated.length - 1)];
  }
  return out;
}

function onIt(loop: Loop, between: Past): Undecided | null {
  const past = pastPlaces(loop, between);
  const near = chordsOf(loop).map((value, k) => (past[k] || past[k + 1] ? Infinity : value));
  const k = near.reduce((best, value, i) => (value < near[best] ? i : best), 0);
  if (!near.length || near[k] >= loop.plant.source.constants.on_it) return null;
  const at = loop.dense.f[k];
  return { reason: `L passes -1 within ${short(near[k], 1)} at ${short(at)} Hz`, band_hz: null };
}

function doubt(loop: Loop, between: Past, start: number[] | null): Undecided | null {
  const { denseL: L, denseC: C, dense } = loop;
  const { draws } = dense;
  const { wrong, radius_95, uncertain_ratio } = loop.plant.source.constants;
  const n = dense.f.length;
  if (!draws) return { reason: "intervals are still being computed", band_hz: null };
  const std = magnitudes(C).map((size, k) => size * draws[k].rms);
  const common = Float64Array.from(draws, (one, k) => (k ? one.common(draws[k - 1]) : 0));
  const chord = chordsOf(loop);
  const past = pastPlaces(loop, between);
  const radius = new Float64Array(n);
  for (let k = 0; k < n; k++) {
    const near = Math.min(Math.sqrt((1 + L.re[k]) ** 2 + L.im[k] ** 2), chord[k - 1] ?? Infinity, chord[k] ?? Infinity);
    radius[k] = past[k] || !(std[k] > 0) ? Infinity : near / std[k];
  }
  if (start && std[0] > 0) radius[0] = Math.min(radius[0], Math.hypot(start[0], start[1]) / std[0]);
  const k = radius.reduce((best, value, i) => (value < radius[best] ? i : best), 0);
  if (radius[k] < radius_95) return uncertain(loop, k, std, uncertain_ratio);
  if (chanceOfError(radius, common, k) <= wrong) return null;
  return { reason: "errors of L may carry it over -1: measure longer or excite more", band_hz: null };
}

function uncertain({ f, dense }: Loop, k: number, std: Real, uncertain_ratio: number): Undecided {
  const at = dense.f[k];
  const i = clip(placeIn(f, at), 1, f.length - 1);
  const [low, high] = [f[i - 1], f[i]];
  const beside = Math.max(std[placeIn(dense.f, low)], std[placeIn(dense.f, high)]);
  if (f[placeIn(f, at)] !== at && std[k] > uncertain_ratio * beside) {
    const words = `L bends too much between ${short(low, 4)} and ${short(high, 4)} Hz to tell on which side it passes -1`;
    return { reason: `${words}: measure finer there`, band_hz: [low, high] };
  }
  return {
    reason: `-1 lies within the uncertainty of L at ${short(at)} Hz: measure longer or excite more`,
    band_hz: [low, high],
  };
}

/** Chance that errors carry a path over a point: as often as a normal process rises through a level (Rice 1945). */
function chanceOfError(radius: Real, common: Real, nearest: number): number {
  const n = radius.length;
  const level = radius.map((x) => Math.exp(-x * x));
  const tails = radius.map((x) => normalBelow(-Math.SQRT2 * x));
  let chance = tails[nearest];
  level[nearest] = 0;
  tails[nearest] = 0;
  for (let k = 1; k < n; k++) {
    const rising = (Math.acos(clip(common[k], 0, 1)) / TWO_PI) * (level[k] + level[k - 1]);
    chance += 0.5 * Math.min(rising, tails[k] + tails[k - 1]);
  }
  return Math.min(chance, 1);
}

/** A gap, how far a resonance in it may move L at most, and the least |1 + L| and |L| at its ends (`Hidden`). */
interface Hidden extends Gap {
  moved: number;
  room: number;
  least: number;
}

/** What may hide in the gaps of a loop (`hidden_in`). */
export function hiddenIn({ point, controller, plant }: Loop): Hidden[] {
  if (!point.gaps.length) return [];
  const { least_damping, poor_damping } = plant.source.constants;
  const C = control.response(controller, Float64Array.from(point.gaps.flatMap((gap) => gap.hz)));
  return point.gaps.map((gap, k) => {
    const ends = gap.P.map(([re, im], i) => {
      const [x, y] = [C.re[2 * k + i], C.im[2 * k + i]];
      const [u, v] = [x * re - y * im, x * im + y * re];
      return [Math.hypot(x, y), Math.hypot(1 + u, v), Math.hypot(u, v)];
    });
    const width = (gap.missing ? least_damping : poor_damping) * Math.sqrt(gap.hz[0] * gap.hz[1]);
    const moved = (Math.max(ends[0][0], ends[1][0]) * gap.residue) / width;
    return { ...gap, moved, room: Math.min(ends[0][1], ends[1][1]), least: Math.min(ends[0][2], ends[1][2]) };
  });
}

/** Where a resonance might encircle -1 between lines that are missing or too uncertain to show it (`_unseen`). */
function unseen(loop: Loop): Undecided | null {
  const { gaps } = loop.point;
  const hides = hiddenIn(loop).map(({ moved, room, least }) => least < 1 / loop.plant.source.constants.hole_far && moved > room);
  const first = hides.indexOf(true);
  if (first < 0) return null;
  let last = first;
  gaps.forEach((gap, k) => {
    if (k > first && hides[k] && gap.hz[0] <= (gap.missing ? 1 : 2) * gaps[last].hz[1]) last = k;
  });
  const [low, high] = [gaps[first].hz[0], gaps[last].hz[1]];
  if (gaps[first].missing && last !== first) {
    const words = `the lines between ${short(low, 4)} and ${short(high, 4)} Hz lie too far apart to show a resonance that encircles -1`;
    return { reason: `${words}: measure finer there`, band_hz: [low, high] };
  }
  const reason =
    gaps[first].missing
      ? `no frequency lies between ${short(low, 4)} and ${short(high, 4)} Hz, and a resonance there might encircle -1 without a trace: measure there`
      : `the lines between ${short(low, 4)} and ${short(high, 4)} Hz are too uncertain to show whether L encircles -1 there: measure longer or excite more`;
  return { reason, band_hz: [low, high] };
}

function hole(loop: Loop): Undecided | null {
  const { f, L, controller } = loop;
  const c = loop.plant.source.constants;
  if (f.length < c.hole_fewest) {
    return { reason: `${f.length} lines are too few to tell what lies between them (${c.hole_fewest} at least)`, band_hz: null };
  }
  const size = magnitudes(L);
  for (let k = 0; k < f.length - 1; k++) {
    const near = Math.max(size[k], size[k + 1]) > c.hole_far && Math.min(size[k], size[k + 1]) < 1 / c.hole_far;
    if (near && f[k + 1] > c.hole_apart * f[k]) {
      const words = `no line lies between ${short(f[k])} and ${short(f[k + 1])} Hz, where L may pass -1: measure there`;
      return { reason: words, band_hz: [f[k], f[k + 1]] };
    }
  }
  const found = unseen(loop);
  if (found) return found;
  for (let k = 0; k < f.length - 1; k++) {
    const near = Math.max(size[k], size[k + 1]) > c.hole_far && Math.min(size[k], size[k + 1]) < 1 / c.hole_far;
    if (near && controller.computation_delay_s * (f[k + 1] - f[k]) > c.hole_turn) {
      const reason = `the controller's delay of ${controller.computation_delay_s} s turns L too far between lines: measure finer, or correct the delay`;
      return { reason, band_hz: [f[k], f[k + 1]] };
    }
  }
  return null;
}
