// One operating point under one controller: the lines that margins are read from (Python: loop/between.py, low_end.py,
// and the first half of loop/margins.py).

import { concat, joined, magnitudes, placeIn, rint, steepness, times, union, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import type { Controller } from "../numbers/controller";
import { densified, Drawn, knownPlant, withBetween, type Dense, type Draws, type Source } from "../numbers/dense";
import type { ExtrapolatedModel, Point } from "../payload";
import { chords } from "./turns";

/** A measured plant with what is known between its lines, with draws or without. */
export class Plant {
  private known: Dense | null = null;
  private readonly moves = new Map<ExtrapolatedModel, Draws>();
  constructor(
    readonly point: Point,
    readonly source: Source,
    readonly drawn: boolean,
  ) {}

  get dense(): Dense {
    this.known ??= knownPlant(this.point, this.source, this.drawn);
    return this.known;
  }

  /** What errors of the lowest lines do to a small model of them, at its places below them (Python: LowModel.deviations). */
  movesBelow(model: ExtrapolatedModel): Draws {
    const made = this.moves.get(model) ?? movesOf(this, model);
    this.moves.set(model, made);
    return made;
  }
}

function movesOf({ dense, point }: Plant, { slopes, influence, lines, P }: ExtrapolatedModel): Draws {
  const own = Array.from({ length: lines }, (_, k) => (dense.draws as Draws)[placeIn(dense.f, point.f[k])]);
  const [{ count: draws }] = own;
  const count = influence.length / (2 * lines);
  const changes = Array.from({ length: count }, (_, p) => {
    const out = new Float64Array(draws);
    for (let i = 0, row = p * 2 * lines; i < lines; i++, row++) {
      for (let d = 0; d < draws; d++) out[d] += influence[row] * own[i].re[d] + influence[row + lines] * own[i].im[d];
    }
    return new Drawn(out, new Float64Array(draws));
  });
  return Array.from(P.re, (_, k) => {
    const out = Drawn.fresh(draws);
    changes.forEach((change, p) => out.add(change, slopes.re[k * count + p], slopes.im[k * count + p]));
    return out;
  });
}

/** A plant under a controller: L on its lines, and on places between them where 1 + L moves far. */
export class Loop {
  readonly f: Real;
  readonly C: Complex;
  readonly L: Complex;
  readonly dense: Dense;
  readonly denseC: Complex;
  readonly denseL: Complex;

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

/** Lines that margins are read from; draws of L are `reference` and `factor` times `draws`. */
export interface Judged {
  f: Real;
  L: Complex;
  C: Complex;
  reference: Complex;
  factor: Complex;
  draws: Draws | null;
  /** Those from the first measured one on, where a model leads to it. */
  measured?: Judged;
}

/** What is found of a loop, once. */
function once<T>(find: (loop: Loop) => T): (loop: Loop) => T {
  const known = new WeakMap<Loop, T>();
  return (loop) => {
    if (!known.has(loop)) known.set(loop, find(loop));
    return known.get(loop) as T;
  };
}

/** Whether the lines show where |L| first falls through 1, or tell that it does not do so below them (`in_sight`). */
export const inSight = once((loop: Loop): boolean => {
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
});

/** How far towards -1 lines above those used may reach that are known well; 0 where none does (`Loop.largest_above`). */
export const largestAbove = once(({ point, controller }: Loop): number => {
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
});

/** Distance of each chord of L from -1, between its lines and places. */
export const chordsOf = once(({ denseL }: Loop): Real => chords(denseL));

/** L below the first line, by each small model of the lowest lines. */
export const belowLines = once(({ point, controller }: Loop): Complex[] => {
  const C = control.response(controller, point.below_f);
  return point.below.map((P) => times(C, P));
});

/** -slope/20 dB a decade of L over the lowest lines, a factor of 1.6 in frequency and four at least. */
export const slopeOf = once(({ point, f, C }: Loop): number => {
  const size = magnitudes(times(C, point.raw));
  const count = Math.min(Math.max(4, placeIn(f, 1.6 * f[0])), f.length);
  return count < 2 ? 0 : -steepness(f.subarray(0, count), size.subarray(0, count));
});

/** Whether L starts so large that nothing below its first line comes near -1 (`is_large`). */
export const isLarge = once((loop: Loop): boolean => {
  const { large, agree } = loop.plant.source.constants;
  return Math.hypot(loop.L.re[0], loop.L.im[0]) >= large && loop.integrators >= 0 && slopeOf(loop) > -agree;
});

/** Whether the lowest lines tell how L goes on below them (`is_told`). */
export function isTold(loop: Loop): boolean {
  const { point, integrators } = loop;
  const { agree } = loop.plant.source.constants;
  const fitted = point.fitted_f.length > 0;
  if (point.unstable_poles && !fitted) return point.simple;
  if (fitted || point.knows_sign) return true;
  const [[phase, slope], room] = [orderOf(loop), point.order[2]];
  if (slope < (point.integrators ?? 0) - room) return false; // a zero below, on either side: the sign at 0 is open
  if (isLarge(loop) && Math.abs(phase - slope) < 1) return true;
  return integrators >= 0 && Math.abs(phase - slope) < room && slopeOf(loop) > -agree;
}

/** Whether L goes to -k/s^n towards 0 Hz over a stable plant (`feeds_back_positively`). */
export function feedsBackPositively(loop: Loop): boolean {
  const { point, integrators, L } = loop;
  if (point.unstable_poles !== 0 || point.fitted_f.length || integrators < 1 || Math.hypot(L.re[0], L.im[0]) < 1) return false;
  return point.sign * (isNegative(loop) ? -1 : 1) < 0;
}

/** Whether the controller goes as -k/s^n towards 0 Hz (`is_negative`). */
const isNegative = once(({ point, controller, integrators }: Loop): boolean => {
  const C = control.response(controller, point.below_f.subarray(0, 1));
  const own = (((integrators - (point.integrators ?? 0)) % 4) + 4) % 4;
  return [C.re[0], -C.im[0], -C.re[0], C.im[0]][own] < 0;
});

/** Order by phase and slope of the lowest lines, the plant's sign turned where the controller's is (`order_of`). */
export function orderOf(loop: Loop): [number, number] {
  const [phase, slope] = loop.point.order;
  return [isNegative(loop) ? ((((phase - 1.5) % 4) + 4) % 4) - 0.5 : phase, slope];
}

/** Whether a count has the right outcome where the lowest lines leave open how L goes on below them (`holds_below`). */
export function holdsBelow(loop: Loop, poles: number): boolean {
  const { order, integrators, unstable_poles } = loop.point;
  const asDeclared = isLarge(loop) && rint(order[1]) === (integrators ?? 0);
  return asDeclared && (poles === 0 || Math.abs(poles % 2) === 1 || poles > (unstable_poles ?? 0));
}

/** The lines that a loop's margins are read from, once for each model that tells what lies below them. */
export function readings(loop: Loop): Judged[] {
  const { dense, denseC, denseL, point } = loop;
  const reference = dense.reference === dense.P ? denseL : times(denseC, dense.reference);
  const j = { f: dense.f, L: denseL, C: denseC, reference, factor: denseC, draws: dense.draws };
  if (point.integrators === null || isLarge(loop) || !inSight(loop)) return [j];
  const models = j.draws ? point.extrapolated : point.extrapolated.slice(0, 1); // the others widen intervals
  return models.length ? fromBelow(loop, j, models) : [j];
}

/** The lines with those before them as models tell them, down to 0 Hz where L is finite there (`_from_below`). */
function fromBelow(loop: Loop, j: Judged, models: ExtrapolatedModel[]): Judged[] {
  const finite = loop.integrators <= 0;
  const skipped = finite ? 0 : 1;
  const shares = loop.plant.source.constants.below_ratios.slice(skipped);
  const own = Float64Array.from(shares, (share) => j.f[0] * share);
  const below = control.response(loop.controller, own);
  const factor = joined(below, j.factor);
  if (finite) [factor.re[0], factor.im[0]] = [1, 0];
  const [f, C] = [concat(own, j.f), joined(below, j.C)];
  return models.map((model) => {
    const L = times(below, { re: model.P.re.subarray(skipped), im: model.P.im.subarray(skipped) });
    const draws = j.draws && loop.plant.movesBelow(model).slice(skipped);
    if (finite) L.im[0] = L.re[0] < 0 ? -1e-9 * Math.hypot(L.re[0], L.im[0]) * (L.im[1] >= 0 ? 1 : -1) : 0;
    if (finite && draws) {
      const [{ re, im }] = draws;
      draws[0] = new Drawn(re.map((x, d) => below.re[0] * x - below.im[0] * im[d]), new Float64Array(re.length));
    }
    const whole = joined(L, j.L);
    return { f, L: whole, C, reference: j.reference === j.L ? whole : joined(L, j.reference), factor, draws: draws && draws.concat(j.draws as Draws), measured: j };
  });
}
