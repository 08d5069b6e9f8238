// Nyquist's count with the contour closed, and what keeps the lines from carrying it (Python: loop/stability.py,
// obstacles.py, doubt.py, holes.py). What cannot be proved here is undecided.

import { clip, concat, deg, magnitudes, placeIn, times, TWO_PI, type Complex, type Real } from "./arrays";
import { pastResonances, short, type Obstacle, type Past } from "./between";
import * as control from "./controller";
import { sumsOf, type Draws } from "./dense";
import { judgedLines, type Loop } from "./loop";
import { angleOf, chords } from "./turns";

export interface Stability {
  outcome: "stable" | "unstable" | "undecided";
  reason: string;
  band_hz: [number, number] | null;
}

const undecided = (reason: string, band_hz: [number, number] | null = null): Stability => ({ outcome: "undecided", reason, band_hz });

/** Whether the closed loop is stable, as far as these data carry the count. */
export function closedLoopStability(loop: Loop): Stability {
  const { point, f, L } = loop;
  if (point.integrators === null) {
    return undecided("the number of integrators of the plant is not known: declare integrators in the requirements");
  }
  if (point.unstable_poles === null) {
    return undecided("the number of unstable poles of the plant is not known: declare unstable_poles in the requirements");
  }
  if (judgedLines(loop) === null) {
    const size = Math.hypot(L.re[0], L.im[0]);
    return undecided(
      `|L| is ${short(size, 2)} at the first line already, ${short(f[0])} Hz: the crossover lies lower, measure there`,
    );
  }
  const poles = unstableCount(loop, point.unstable_poles);
  if (typeof poles !== "number") return undecided(poles.reason, poles.band_hz);
  if (poles < 0) return undecided(`${-poles} encirclements too many for ${point.unstable_poles} unstable poles`);
  if (poles) return { outcome: "unstable", reason: `${poles} closed-loop poles in the right half plane`, band_hz: null };
  return { outcome: "stable", reason: "the encirclements of -1 balance the unstable poles", band_hz: null };
}

function unstableCount(loop: Loop, unstable: number): number | Obstacle {
  const { point, controller, integrators, denseL } = loop;
  const fitDeg = loop.plant.source.constants.fit_deg;
  const belowC = control.response(controller, point.below_f);
  const led = point.modelled ? times(belowC, point.below[0]) : null;
  const between = pastResonances(loop);
  const found = obstacle(loop, between, startOf(loop, led, unstable));
  if (found) return found;
  let poles = countUnstable(denseL, integrators, unstable, led, fitDeg);
  if (poles === null && !point.modelled) {
    const counts = new Set(point.below.map((P) => countUnstable(denseL, integrators, unstable, times(belowC, P), fitDeg)));
    poles = counts.size === 1 ? [...counts][0] : null;
  }
  return poles === null ? misfit(loop) : poles - 2 * between.turns;
}

function misfit(loop: Loop): Obstacle {
  const { f, L, integrators } = loop;
  const phase = Math.round(deg(Math.atan2(L.im[0], L.re[0])));
  const reason =
    `the phase of L at the first line (${short(f[0])} Hz, ${phase} deg) does not fit ${integrators} integrators (the` +
    " controller's included): fit a model, measure lower, or declare integrators in the requirements";
  return { reason, band_hz: [0.1 * f[0], f[0]] };
}

/** 1 + L where it comes from to the first line; null where a model leads there. */
function startOf(loop: Loop, led: Complex | null, unstable: number): number[] | null {
  if (led) return null;
  const { integrators, denseL: L } = loop;
  const negative = unstable % 2 === 1;
  if (integrators < 0) return [1, 0];
  if (!integrators) return [1 + (negative ? -1 : 1) * Math.abs(L.re[0]), 0];
  const size = 1e3 * (1 + Math.hypot(L.re[0], L.im[0])) * (negative ? -1 : 1);
  const quarter = integrators % 4;
  return [1 + size * [1, 0, -1, 0][quarter], size * [0, -1, 0, 1][quarter]];
}

/** Closed-loop poles in the right half plane by the bare count, null where the first value fits badly. */
export function countUnstable(
  L: Complex, integrators: number, unstable: number, below: Complex | null, fitDeg: number,
): number | null {
  const led = below !== null && below.re.length > 0;
  const re = led ? concat(below.re, L.re) : L.re;
  const im = led ? concat(below.im, L.im) : L.im;
  const start = turnToFirst(re[0], im[0], integrators, unstable % 2 === 1, led, fitDeg);
  if (start === null) return null;
  let turn = start;
  for (let k = 1; k < re.length; k++) turn += angleOf(1 + re[k], im[k], 1 + re[k - 1], im[k - 1]);
  const last = re.length - 1;
  turn -= Math.atan2(im[last], 1 + re[last]);
  return Math.round(unstable + 0.5 * Math.max(integrators, 0) - turn / Math.PI);
}

function turnToFirst(
  re: number, im: number, integrators: number, negative: boolean, either: boolean, fitDeg: number,
): number | null {
  // first * j^integrators
  let [ar, ai] = [re, im];
  for (let k = 0; k < Math.abs(integrators); k++) [ar, ai] = integrators > 0 ? [-ai, ar] : [ai, -ar];
  const flipped = either ? ar < 0 : negative;
  const swing = flipped ? Math.atan2(-ai, -ar) : Math.atan2(ai, ar);
  if (Math.abs(deg(swing)) > fitDeg) return null;
  if (integrators < 0) return Math.atan2(im, 1 + re);
  if (integrators) return swing + angleOf(1 + re, im, re, im);
  if (flipped && !either && re > -1) return null;
  return Math.atan2(im, 1 + re) - (re < -1 ? Math.PI : 0) * Math.sign(im || 1);
}

function obstacle(loop: Loop, between: Past, start: number[] | null): Obstacle | null {
  return tooShort(loop) ?? comesUpAgain(loop) ?? onIt(loop, between) ?? doubt(loop, between, start) ?? between.unclear ?? hole(loop);
}

function tooShort({ f, L }: Loop): Obstacle | null {
  const last = f.length - 1;
  const size = Math.hypot(L.re[last], L.im[last]);
  if (size < 1) return null;
  return { reason: `|L| is still ${short(size, 2)} at the last line, ${short(f[last])} Hz: measure higher`, band_hz: null };
}

function comesUpAgain({ point, controller }: Loop): Obstacle | null {
  if (!point.beyond) return null;
  const f = point.beyond.f.filter((x) => x < 0.5 * controller.rate_hz);
  if (!f.length) return null;
  const L = times(control.response(controller, f), point.beyond.P);
  const size = magnitudes(L);
  const k = size.reduce((best, value, i) => (value > size[best] ? i : best), 0);
  if (size[k] < 1) return null;
  return {
    reason: `|L| reaches ${short(size[k], 2)} at ${short(f[k])} Hz, above the band that is known well: excite more there`,
    band_hz: null,
  };
}

/** Places of the path within gaps past a resonance that was followed, its lines not among them. */
function pastPlaces({ f, dense }: Loop, between: Past): Uint8Array {
  const out = new Uint8Array(dense.f.length);
  if (!between.followed.some(Boolean)) return out;
  for (let k = 0, gap = -1; k < dense.f.length; k++) {
    if (gap + 1 < f.length && dense.f[k] === f[gap + 1]) gap += 1;
    else out[k] = between.followed[clip(gap, 0, between.followed.length - 1)];
  }
  return out;
}

function onIt(loop: Loop, between: Past): Obstacle | null {
  const past = pastPlaces(loop, between);
  const near = chords(loop.denseL).map((value, k) => (past[k] || past[k + 1] ? Infinity : value));
  const k = near.reduce((best, value, i) => (value < near[best] ? i : best), 0);
  if (!near.length || near[k] >= loop.plant.source.constants.on_it) return null;
  const at = loop.dense.f[k];
  return { reason: `L passes -1 within ${short(near[k], 1)} at ${short(at)} Hz`, band_hz: null };
}

/** Deviation of L at each place, and how far neighbours' errors are the same. */
function sizesOf(draws: Draws, n: number): { std: Real; common: Real } {
  const { power, crossRe, crossIm } = sumsOf(draws, n);
  const size = power.map((value) => Math.max(Math.sqrt(value), 1e-150));
  const common = crossRe.map((value, k) => (k === 0 ? 0 : Math.hypot(value, crossIm[k]) / (size[k] * size[k - 1])));
  return { std: power.map((value) => Math.sqrt(value / draws.count)), common };
}

function doubt(loop: Loop, between: Past, start: number[] | null): Obstacle | null {
  const { denseL: L, dense, draws } = loop;
  const { wrong, reach_95, strays } = loop.plant.source.constants;
  const n = dense.f.length;
  if (!draws) return { reason: "intervals are still being computed", band_hz: null };
  const { std, common } = sizesOf(draws, n);
  const chord = chords(L);
  const past = pastPlaces(loop, between);
  const reach = new Float64Array(n);
  for (let k = 0; k < n; k++) {
    const near = Math.min(Math.hypot(1 + L.re[k], L.im[k]), chord[k - 1] ?? Infinity, chord[k] ?? Infinity);
    reach[k] = past[k] || !(std[k] > 0) ? Infinity : near / std[k];
  }
  if (start && std[0] > 0) reach[0] = Math.min(reach[0], Math.hypot(start[0], start[1]) / std[0]);
  const k = reach.reduce((best, value, i) => (value < reach[best] ? i : best), 0);
  if (reach[k] < reach_95) return uncertain(loop, k, std, strays);
  if (chanceOfError(reach, common, k) <= wrong) return null;
  return { reason: "errors of L may carry it over -1: measure longer or excite more", band_hz: null };
}

function uncertain({ f, dense }: Loop, k: number, std: Real, strays: number): Obstacle {
  const at = dense.f[k];
  const i = clip(placeIn(f, at), 1, f.length - 1);
  const [low, high] = [f[i - 1], f[i]];
  const beside = Math.max(std[placeIn(dense.f, low)], std[placeIn(dense.f, high)]);
  if (f[placeIn(f, at)] !== at && std[k] > strays * beside) {
    const words = `L bends too much between ${short(low, 4)} and ${short(high, 4)} Hz to tell on which side it passes -1`;
    return { reason: `${words}: measure finer there`, band_hz: [low, high] };
  }
  return {
    reason: `-1 lies within the uncertainty of L at ${short(at)} Hz: measure longer or excite more`,
    band_hz: [low, high],
  };
}

/** Chance that errors carry a path over a point: as often as a normal process rises through a level (Rice 1945). */
function chanceOfError(reach: Real, common: Real, nearest: number): number {
  const n = reach.length;
  const level = reach.map((x) => Math.exp(-x * x));
  const beyond = reach.map((x) => normalBelow(-Math.SQRT2 * x));
  let chance = beyond[nearest];
  level[nearest] = 0;
  beyond[nearest] = 0;
  for (let k = 1; k < n; k++) {
    const rising = (Math.acos(clip(common[k], 0, 1)) / TWO_PI) * (level[k] + level[k - 1]);
    chance += 0.5 * Math.min(rising, beyond[k] + beyond[k - 1]);
  }
  return Math.min(chance, 1);
}

/** Normal distribution function of numbers at or below zero: by its series near zero, by a continued fraction beyond. */
export function normalBelow(x: number): number {
  if (!Number.isFinite(x)) return 0;
  const density = Math.exp(-0.5 * x * x) / Math.sqrt(TWO_PI);
  const size = -x;
  if (size < 3) {
    let [term, total] = [size, size];
    for (let k = 1; k < 100; k++) {
      term *= (size * size) / (2 * k + 1);
      total += term;
    }
    return 0.5 - density * total;
  }
  let fraction = 0;
  for (let k = 80; k > 0; k--) fraction = k / (size + fraction);
  return density / (size + fraction);
}

function hole(loop: Loop): Obstacle | null {
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
  for (let k = 0; k < f.length - 1; k++) {
    const near = Math.max(size[k], size[k + 1]) > c.hole_far && Math.min(size[k], size[k + 1]) < 1 / c.hole_far;
    if (near && controller.computation_delay_s * (f[k + 1] - f[k]) > c.hole_turn) {
      const reason = `the controller's delay of ${controller.computation_delay_s} s turns L too far between lines: measure finer, or correct the delay`;
      return { reason, band_hz: [f[k], f[k + 1]] };
    }
  }
  return null;
}
