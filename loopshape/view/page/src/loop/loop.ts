// One operating point under one controller: the lines that margins are read from (Python: loop/between.py, low_end.py,
// and the first half of loop/margins.py).

import { concat, joined, magnitudes, placeIn, rint, times, union, zeros, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import type { Controller } from "../numbers/controller";
import { densified, knownPlant, passingDraws, withBetween, type Dense, type Draws, type Source } from "../numbers/dense";
import type { ExtrapolatedModel, Point } from "../payload";

/** A measured plant with what is known between its lines, with draws or without. */
export class Plant {
  private known: Dense | null = null;
  constructor(
    readonly point: Point,
    readonly source: Source,
    readonly drawn: boolean,
  ) {}

  get dense(): Dense {
    this.known ??= knownPlant(this.point, this.source, this.drawn);
    return this.known;
  }
}

/** A plant under a controller: L on its lines, and on places between them where 1 + L moves far. */
export class Loop {
  readonly f: Real;
  readonly C: Complex;
  readonly L: Complex;
  readonly dense: Dense;
  readonly denseC: Complex;
  readonly denseL: Complex;
  /** Draws of the error of denseL, good until another loop is made. */
  readonly draws: Draws | null;

  constructor(
    readonly plant: Plant,
    readonly controller: Controller,
  ) {
    const { point, source } = plant;
    this.f = point.f;
    this.C = control.responseOn(controller, point.f);
    this.L = times(this.C, point.P);
    this.dense = interpolated(plant.dense, controller, source);
    this.denseC = control.responseOn(controller, this.dense.f);
    this.denseL = times(this.denseC, this.dense.P);
    const own = this.dense.draws;
    this.draws = own && scaled(own, this.denseC, this.dense === plant.dense ? passingDraws(own.count, this.dense.f.length) : own);
  }

  get point(): Point {
    return this.plant.point;
  }

  /** Poles at s = 0 of plant and controller; the plant's count as none where they are not known. */
  get integrators(): number {
    return (this.point.integrators ?? 0) + control.integrators(this.controller);
  }
}

export function interpolated(known: Dense, controller: Controller, source: Source): Dense {
  const { constants } = source;
  let dense = known;
  const own = controllerPlaces(controller, dense.f, source);
  if (own.length) dense = densified(dense, union(dense.f, own), source);
  const L = times(control.responseOn(controller, dense.f), dense.P);
  const gaps = dense.f.length - 1;
  const [moved, room] = [new Float64Array(gaps), new Float64Array(gaps)];
  const near = L.re.map((re, k) => Math.sqrt((1 + re) ** 2 + L.im[k] * L.im[k]));
  const size = magnitudes(L);
  for (let k = 0; k < gaps; k++) {
    room[k] = Math.min(near[k], near[k + 1]);
    const small = Math.max(size[k], size[k + 1]) < constants.small;
    moved[k] = small ? 0 : Math.sqrt((L.re[k + 1] - L.re[k]) ** 2 + (L.im[k + 1] - L.im[k]) ** 2);
  }
  return withBetween(dense, moved, room, source);
}

function controllerPlaces(controller: Controller, f: Real, { constants }: Source): Real {
  const places: number[] = [];
  for (const [centre, half] of control.poles(controller)) {
    const width = Math.max(half, constants.sharpest * centre);
    const k = placeIn(f, centre);
    if (k > 0 && k < f.length && width < constants.wide * (f[k] - f[k - 1])) {
      places.push(...constants.places.map((place) => centre + width * place));
    }
  }
  return Float64Array.from(places.filter((x) => x > f[0] && x < f[f.length - 1]));
}

/** Lines that margins are read from, with L's reference and draws. */
export interface Judged {
  f: Real;
  L: Complex;
  C: Complex;
  reference: Complex;
  draws: Draws | null;
}

/** Whether the lines show where |L| first falls through 1, or tell that it does not do so below them (`in_sight`). */
export function inSight(loop: Loop): boolean {
  const { point, f, L } = loop;
  const { extrapolated_below, far_below, agree } = loop.plant.source.constants;
  if (Math.hypot(L.re[0], L.im[0]) >= 1 && slopeOf(loop) > -agree) return true;
  const below = belowLines(loop).map(magnitudes);
  const largest = below.length ? Math.max(...below.map((size) => Math.max(...size))) : Infinity;
  const falls = loop.integrators < 0 && largest < far_below;
  if (!falls && !point.simple) return false;
  if (loop.integrators <= 0 && largest < 1) return true;
  const from = f[0] / extrapolated_below;
  return below.every((size) => size.some((x, k) => point.below_f[k] >= from && x >= 1));
}

/** How far towards -1 lines above those used may reach that are known well; 0 where none does (`Loop.largest_above`). */
export function largestAbove({ point, controller }: Loop): number {
  if (!point.above_band) return 0;
  const { f, P, half_width, known } = point.above_band;
  const C = control.response(controller, f);
  const L = times(C, P);
  let most = 0;
  for (let k = 0; k < f.length; k++) {
    if (!known[k] || f[k] >= 0.5 * controller.rate_hz) continue;
    const radius = Math.hypot(C.re[k], C.im[k]) * half_width[k];
    const share = 1 - half_width[k] / Math.hypot(P.re[k], P.im[k]);
    most = Math.max(most, 1 - Math.hypot(1 + share * L.re[k], share * L.im[k]) + radius);
  }
  return most;
}

/** L below the first line, by each small model of the lowest lines. */
export function belowLines({ point, controller }: Loop): Complex[] {
  const C = control.response(controller, point.below_f);
  return point.below.map((P) => times(C, P));
}

/** -slope/20 dB a decade of L over the lowest lines, a factor of 1.6 in frequency and four at least. */
export function slopeOf({ point, f, C }: Loop): number {
  const size = magnitudes(times(C, point.raw));
  const count = Math.min(Math.max(4, placeIn(f, 1.6 * f[0])), f.length);
  if (count < 2) return 0;
  const x = Array.from(f.subarray(0, count), Math.log);
  const y = Array.from(size.subarray(0, count), Math.log);
  const [mx, my] = [x, y].map((values) => values.reduce((a, b) => a + b, 0) / count);
  const spread = x.reduce((sum, value) => sum + (value - mx) ** 2, 0);
  return -x.reduce((sum, value, k) => sum + (value - mx) * (y[k] - my), 0) / spread;
}

/** Whether L starts so large that nothing below its first line comes near -1 (`is_large`). */
export function isLarge(loop: Loop): boolean {
  const { large, agree } = loop.plant.source.constants;
  return Math.hypot(loop.L.re[0], loop.L.im[0]) >= large && loop.integrators >= 0 && slopeOf(loop) > -agree;
}

/** Whether the lowest lines tell how L goes on below them (`is_told`). */
export function isTold(loop: Loop): boolean {
  const { point, integrators } = loop;
  const { agree } = loop.plant.source.constants;
  const fitted = point.fitted_f.length > 0;
  if (point.unstable_poles && !fitted) return point.simple;
  if (fitted || point.below.length) return true;
  const [phase, slope, room] = point.order;
  if (isLarge(loop) && Math.abs(phase - slope) < 1) return true;
  return integrators >= 0 && Math.abs(phase - slope) < room && slopeOf(loop) > -agree;
}

/** Whether a count has the right outcome where the lowest lines leave open how L goes on below them (`holds_below`). */
export function holdsBelow(loop: Loop, poles: number): boolean {
  const { order, integrators, unstable_poles } = loop.point;
  const asDeclared = isLarge(loop) && rint(order[1]) === (integrators ?? 0);
  return asDeclared && (poles === 0 || Math.abs(poles % 2) === 1 || poles > (unstable_poles ?? 0));
}

/** The lines that a loop's margins are read from, once for each model that tells what lies below them. */
export function readings(loop: Loop): Judged[] {
  const { dense, denseC, denseL, draws, point } = loop;
  const j = { f: dense.f, L: denseL, C: denseC, reference: times(denseC, dense.reference), draws };
  if (point.integrators === null || isLarge(loop) || !inSight(loop)) return [j];
  const found = point.extrapolated.map((model) => fromBelow(loop, j, model));
  return found.length ? found : [j];
}

function before(draws: Draws, extrapolated: number, at: (d: number, k: number) => [number, number]): Draws {
  const n = draws.re.length / draws.count;
  const wide = n + extrapolated;
  const out = { count: draws.count, re: new Float64Array(draws.count * wide), im: new Float64Array(draws.count * wide) };
  for (let d = 0; d < draws.count; d++) {
    for (let k = 0; k < extrapolated; k++) [out.re[d * wide + k], out.im[d * wide + k]] = at(d, k);
    out.re.set(draws.re.subarray(d * n, (d + 1) * n), d * wide + extrapolated);
    out.im.set(draws.im.subarray(d * n, (d + 1) * n), d * wide + extrapolated);
  }
  return out;
}

/** Draws of P as draws of C P, into `out`, which may be the same. */
function scaled(draws: Draws, C: Complex, out: Draws): Draws {
  const n = C.re.length;
  for (let d = 0, i = 0; d < draws.count; d++) {
    for (let k = 0; k < n; k++, i++) {
      const x = draws.re[i];
      const y = draws.im[i];
      out.re[i] = x * C.re[k] - y * C.im[k];
      out.im[i] = x * C.im[k] + y * C.re[k];
    }
  }
  return out;
}

/** The lines with those before them as a model tells them, down to 0 Hz where L is finite there (`_from_below`). */
function fromBelow(loop: Loop, j: Judged, model: ExtrapolatedModel): Judged {
  const finite = loop.integrators <= 0;
  const skipped = finite ? 0 : 1;
  const shares = loop.plant.source.constants.below_ratios.slice(skipped);
  const f = Float64Array.from(shares, (share) => j.f[0] * share);
  const C = control.response(loop.controller, f);
  const P = { re: model.P.re.subarray(skipped), im: model.P.im.subarray(skipped) };
  const L = times(C, P);
  if (finite) L.im[0] = L.re[0] < 0 ? -1e-9 * Math.hypot(L.re[0], L.im[0]) * (L.im[1] >= 0 ? 1 : -1) : 0;
  let draws: Draws | null = null;
  if (j.draws) {
    const moved = modelMoves(loop, C, model, skipped);
    draws = before(j.draws, f.length, (d, k) => {
      const at = d * f.length + k;
      return [moved.re[at], finite && k === 0 ? 0 : moved.im[at]];
    });
  }
  return { f: concat(f, j.f), L: joined(L, j.L), C: joined(C, j.C), reference: joined(L, j.reference), draws };
}

/** What errors of the lowest lines do to C times a small model, at its places from the one `skipped` on. */
export function modelMoves(loop: Loop, C: Complex, { slopes, influence, lines }: ExtrapolatedModel, skipped: number): Complex {
  const own = loop.plant.dense.draws as Draws;
  const dense = loop.plant.dense.f;
  const n = dense.length;
  const at = Array.from({ length: lines }, (_, k) => placeIn(dense, loop.f[k]));
  const count = influence.length / (2 * lines);
  const change = new Float64Array(count);
  const out = zeros(own.count * C.re.length);
  for (let d = 0; d < own.count; d++) {
    for (let p = 0; p < count; p++) {
      change[p] = 0;
      for (let i = 0; i < lines; i++) {
        const row = p * 2 * lines + i;
        change[p] += influence[row] * own.re[d * n + at[i]] + influence[row + lines] * own.im[d * n + at[i]];
      }
    }
    for (let k = 0; k < C.re.length; k++) {
      let [re, im] = [0, 0];
      for (let p = 0; p < count; p++) {
        re += slopes.re[(k + skipped) * count + p] * change[p];
        im += slopes.im[(k + skipped) * count + p] * change[p];
      }
      const place = d * C.re.length + k;
      out.re[place] = C.re[k] * re - C.im[k] * im;
      out.im[place] = C.re[k] * im + C.im[k] * re;
    }
  }
  return out;
}
