// One operating point under one controller: the lines that margins are read from (Python: loop/between.py, low_end.py,
// and the first half of loop/margins.py).

import { concat, joined, magnitudes, placeIn, times, union, zeros, type Complex, type Real } from "./arrays";
import * as control from "./controller";
import type { Controller } from "./controller";
import { densified, knownPlant, passingDraws, withBetween, type Dense, type Draws, type Source } from "./dense";
import type { Down, Point } from "./payload";

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
    this.dense = followed(plant.dense, controller, source);
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

export function followed(known: Dense, controller: Controller, source: Source): Dense {
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

/** Frequencies, L and C on lines from the crossover on; null where it is out of sight (`judged_lines`). */
export function judgedLines(loop: Loop): { f: Real; L: Complex; C: Complex; led: number } | null {
  const { point, controller, f, L, C } = loop;
  const own = { f, L, C, led: 0 };
  if (Math.hypot(L.re[0], L.im[0]) >= 1) return own;
  if (!point.below.length) return null;
  const below = control.response(controller, point.below_f);
  const most = Math.max(...point.below.map((P) => magnitudes(times(below, P)).reduce((a, b) => Math.max(a, b), 0)));
  if (loop.integrators <= 0 && most < 1) return own;
  if (!point.modelled) return null;
  const ledC = control.response(controller, point.led_f);
  const ledL = times(ledC, point.led);
  if (Math.hypot(ledL.re[0], ledL.im[0]) < 1) return null;
  return { f: concat(point.led_f, f), L: joined(ledL, L), C: joined(ledC, C), led: point.led_f.length };
}

/** The lines that a loop's margins are read from, once for each model that tells how it starts at 0 Hz. */
export function readings(loop: Loop): Judged[] {
  const j = judged(loop);
  if (loop.integrators || loop.point.integrators === null) return [j.lines];
  const found = loop.point.down.map((down) => fromZero(loop, j.lines, j.led, down));
  return found.length ? found : [j.lines];
}

function judged(loop: Loop): { lines: Judged; led: number } {
  const found = judgedLines(loop) ?? { f: loop.f, L: loop.L, C: loop.C, led: 0 };
  const { led } = found;
  const { dense, denseC, denseL, point } = loop;
  const reference = times(denseC, dense.reference);
  const { draws } = loop;
  if (!led) return { lines: { f: dense.f, L: denseL, C: denseC, reference, draws }, led };
  const first = head(found.L, led);
  const share = quotient(loop.plant.dense.reference, point.P, 0);
  const own = loop.plant.dense.draws;
  return {
    led,
    lines: {
      f: concat(found.f.subarray(0, led), dense.f),
      L: joined(first, denseL),
      C: joined(head(found.C, led), denseC),
      reference: joined(turned(first, share), reference),
      draws: draws && own && beforeDraws(first, firstShares(own, point), draws),
    },
  };
}

const head = (z: Complex, n: number): Complex => ({ re: z.re.subarray(0, n), im: z.im.subarray(0, n) });

function quotient(a: Complex, b: Complex, k: number): [number, number] {
  const size = b.re[k] ** 2 + b.im[k] ** 2;
  return [(a.re[k] * b.re[k] + a.im[k] * b.im[k]) / size, (a.im[k] * b.re[k] - a.re[k] * b.im[k]) / size];
}

function turned(z: Complex, [re, im]: [number, number]): Complex {
  return { re: z.re.map((x, k) => x * re - z.im[k] * im), im: z.re.map((x, k) => x * im + z.im[k] * re) };
}

/** Each draw's error of the first line as a share of it. */
function firstShares(draws: Draws, point: Point): Complex {
  const n = draws.re.length / draws.count;
  const out = zeros(draws.count);
  const first = { re: Float64Array.of(point.P.re[0]), im: Float64Array.of(point.P.im[0]) };
  for (let d = 0; d < draws.count; d++) {
    const error = { re: Float64Array.of(draws.re[d * n]), im: Float64Array.of(draws.im[d * n]) };
    [out.re[d], out.im[d]] = quotient(error, first, 0);
  }
  return out;
}

function beforeDraws(first: Complex, shares: Complex, draws: Draws): Draws {
  return before(draws, first.re.length, (d, k) => [
    first.re[k] * shares.re[d] - first.im[k] * shares.im[d],
    first.re[k] * shares.im[d] + first.im[k] * shares.re[d],
  ]);
}

function before(draws: Draws, led: number, at: (d: number, k: number) => [number, number]): Draws {
  const n = draws.re.length / draws.count;
  const wide = n + led;
  const out = { count: draws.count, re: new Float64Array(draws.count * wide), im: new Float64Array(draws.count * wide) };
  for (let d = 0; d < draws.count; d++) {
    for (let k = 0; k < led; k++) [out.re[d * wide + k], out.im[d * wide + k]] = at(d, k);
    out.re.set(draws.re.subarray(d * n, (d + 1) * n), d * wide + led);
    out.im.set(draws.im.subarray(d * n, (d + 1) * n), d * wide + led);
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

/** The lines with those before them down to 0 Hz, where L starts on the negative real axis (`_from_zero`). */
function fromZero(loop: Loop, j: Judged, led: number, down: Down): Judged {
  const shares = loop.plant.source.constants.down;
  const f = Float64Array.from(shares, (share) => j.f[0] * share);
  const C = control.response(loop.controller, f);
  const L = times(C, led ? down.P_led : down.P);
  if (L.re[0] >= 0) return j;
  L.im[0] = -1e-9 * Math.hypot(L.re[0], L.im[0]) * (L.im[1] >= 0 ? 1 : -1);
  let draws: Draws | null = null;
  if (j.draws) {
    const moved = down.moves ? modelMoves(loop, C, down.moves, down.lines) : firstMoves(j, L);
    draws = before(j.draws, f.length, (d, k) => {
      const at = d * f.length + k;
      return [moved.re[at], k === 0 ? 0 : moved.im[at]];
    });
  }
  return { f: concat(f, j.f), L: joined(L, j.L), C: joined(C, j.C), reference: joined(L, j.reference), draws };
}

function firstMoves(j: Judged, L: Complex): Complex {
  const draws = j.draws as Draws;
  const n = j.f.length;
  const out = zeros(draws.count * L.re.length);
  for (let d = 0; d < draws.count; d++) {
    const error = { re: draws.re.subarray(d * n, d * n + 1), im: draws.im.subarray(d * n, d * n + 1) };
    const [re, im] = quotient(error, j.L, 0);
    for (let k = 0; k < L.re.length; k++) {
      out.re[d * L.re.length + k] = L.re[k] * re - L.im[k] * im;
      out.im[d * L.re.length + k] = L.re[k] * im + L.im[k] * re;
    }
  }
  return out;
}

/** What errors of the lowest lines do to C times a small model, by a matrix (8, 2 lines): real parts, then imaginary. */
function modelMoves(loop: Loop, C: Complex, moves: Complex, lines: number): Complex {
  const own = loop.plant.dense.draws as Draws;
  const dense = loop.plant.dense.f;
  const n = dense.length;
  const at = Array.from({ length: lines }, (_, k) => placeIn(dense, loop.f[k]));
  const out = zeros(own.count * C.re.length);
  for (let d = 0; d < own.count; d++) {
    for (let k = 0; k < C.re.length; k++) {
      let [re, im] = [0, 0];
      for (let i = 0; i < lines; i++) {
        const [er, ei] = [own.re[d * n + at[i]], own.im[d * n + at[i]]];
        const row = k * 2 * lines + i;
        re += moves.re[row] * er + moves.re[row + lines] * ei;
        im += moves.im[row] * er + moves.im[row + lines] * ei;
      }
      const place = d * C.re.length + k;
      out.re[place] = C.re[k] * re - C.im[k] * im;
      out.im[place] = C.re[k] * im + C.im[k] * re;
    }
  }
  return out;
}
