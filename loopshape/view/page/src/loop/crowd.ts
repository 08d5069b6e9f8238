// Resonances close together, as Python fitted them to the plant: how 1 + L turns past them in each way that the lines
// allow (Python: `Crowd.response` of loop/stability/mode_clusters.py, `turns_past_crowd` of loop/margin/between.py).

import { clip, placeIn, times, TWO_PI, zeros, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import type { Loop } from "./loop";
import type { Crowd } from "../payload";
import { angleOf, chords, turnAlong } from "./turns";

/** Least and most whole turns more than the path's, how near to -1 the likeliest way comes in each gap. */
export interface Turns {
  least: number;
  most: number;
  near: Real;
  /** Whether L turns slowly enough about -1 to be followed. */
  sure: boolean;
}

export function turnsPastCrowd(crowd: Crowd, loop: Loop): Turns {
  const { f, dense, denseL } = loop;
  const own = f.subarray(crowd.low, crowd.high + 1);
  const straight = turnAlong(denseL, placeIn(dense.f, own[0]), placeIn(dense.f, own[own.length - 1]));
  const out: Turns = { least: Infinity, most: -Infinity, near: new Float64Array(0), sure: true };
  alongOf(crowd, loop).forEach(({ at, P }, way) => {
    const L = times(control.response(loop.controller, at), P);
    if (way === 0) out.near = nearIn(own, at, chords(L));
    const { turn, sure } = turned(new Way(crowd, way, loop), at, L);
    const more = Math.round((turn - straight) / TWO_PI);
    [out.least, out.most, out.sure] = [Math.min(out.least, more), Math.max(out.most, more), out.sure && sure];
  });
  return out;
}

/** The least of values of steps at rising places in each gap between lines. */
function nearIn(own: Real, at: Real, values: Real): Real {
  const begin = Array.from(own.subarray(0, -1), (x) => placeIn(at, x));
  return Float64Array.from(begin, (from, k) => values.subarray(from, begin[k + 1] ?? values.length).reduce((a, b) => Math.min(a, b), Infinity));
}

/** P past a crowd in one of its ways, anywhere. */
class Way {
  constructor(
    private readonly crowd: Crowd,
    private readonly way: number,
    private readonly loop: Loop,
  ) {}

  get constants(): { far: number; rounds: number } {
    return this.loop.plant.source.constants;
  }

  get places(): Real {
    const { crowd, way, loop } = this;
    const own = loop.f.subarray(crowd.low, crowd.high + 1);
    const [start, end] = [own[0], own[own.length - 1]];
    const { along } = loop.plant.source.constants;
    const count = crowd.poles.re.length / crowd.ways;
    const near: number[] = [];
    for (let k = way * count; k < (way + 1) * count; k++) near.push(...along.map((x) => crowd.poles.re[k] + Math.abs(crowd.poles.im[k]) * x));
    const even = Array.from({ length: 4 * own.length }, (_, k) => start + ((end - start) * k) / (4 * own.length - 1));
    return Float64Array.from([...near, ...own, ...even], (x) => clip(x, start, end)).sort();
  }

  response(f: Real): Complex {
    const out = zeros(f.length);
    for (let k = 0; k < f.length; k++) [out.re[k], out.im[k]] = this.at(f[k]);
    return out;
  }

  L(f: Real): Complex {
    return times(control.response(this.loop.controller, f), this.response(f));
  }

  private at(hz: number): [number, number] {
    const { crowd, way, loop } = this;
    const [start, end] = [loop.f[crowd.low], loop.f[crowd.high]];
    const x = (2 * Math.log(hz / start)) / Math.log(end / start) - 1;
    let [re, im] = horner(crowd.polynomials, crowd.polynomials.re.length / crowd.ways, way, x);
    const count = crowd.poles.re.length / crowd.ways;
    for (let k = way * count; k < (way + 1) * count; k++) {
      const [dr, di] = [hz - crowd.poles.re[k], -crowd.poles.im[k]];
      const size = dr * dr + di * di;
      re += (crowd.residues.im[k] * dr - crowd.residues.re[k] * di) / size;
      im -= (crowd.residues.re[k] * dr + crowd.residues.im[k] * di) / size;
    }
    const ln = Math.log(hz / crowd.middle_hz);
    const grown = Math.exp(crowd.power[0] * ln);
    const turn = crowd.power[1] * ln - TWO_PI * crowd.delay_s * (hz - start);
    const [c, s] = [grown * Math.cos(turn), grown * Math.sin(turn)];
    return [re * c - im * s, re * s + im * c];
  }
}

/** The polynomial of a way at x. */
function horner(all: Complex, terms: number, way: number, x: number): [number, number] {
  let [re, im] = [0, 0];
  for (let k = (way + 1) * terms - 1; k >= way * terms; k--) [re, im] = [re * x + all.re[k], im * x + all.im[k]];
  return [re, im];
}

interface Along {
  at: Real;
  P: Complex;
}

const known = new WeakMap<Crowd, Along[]>();

/** Places along the lines of a crowd, dense about its poles, with P there: of no controller, once. */
function alongOf(crowd: Crowd, loop: Loop): Along[] {
  const made = known.get(crowd) ?? Array.from({ length: crowd.ways }, (_, k) => {
    const way = new Way(crowd, k, loop);
    const at = way.places;
    return { at, P: way.response(at) };
  });
  known.set(crowd, made);
  return made;
}

/** How far 1 + L turns; steps that turn too far are halved, so many times. */
function turned(way: Way, at: Real, L: Complex): { turn: number; sure: boolean } {
  const { far, rounds } = way.constants;
  for (let round = 1; ; round++) {
    const steps = stepsOf(L);
    const wide = Array.from(steps.keys()).filter((k) => Math.abs(steps[k]) > far);
    if (!wide.length || round === rounds) return { turn: steps.reduce((a, b) => a + b, 0), sure: !wide.length };
    const middles = Float64Array.from(wide, (k) => 0.5 * (at[k] + at[k + 1]));
    [at, L] = merged(at, L, wide, middles, way.L(middles));
  }
}

function stepsOf(L: Complex): Real {
  const n = Math.max(L.re.length - 1, 0);
  return Float64Array.from({ length: n }, (_, k) => angleOf(1 + L.re[k + 1], L.im[k + 1], 1 + L.re[k], L.im[k]) || 0);
}

/** Places and values with others behind some of them. */
function merged(at: Real, L: Complex, behind: number[], more: Real, moreL: Complex): [Real, Complex] {
  const n = at.length + more.length;
  const out: [Real, Complex] = [new Float64Array(n), zeros(n)];
  for (let k = 0, next = 0, i = 0; k < at.length; k++) {
    [out[0][i], out[1].re[i], out[1].im[i]] = [at[k], L.re[k], L.im[k]];
    i += 1;
    if (behind[next] !== k) continue;
    [out[0][i], out[1].re[i], out[1].im[i]] = [more[next], moreL.re[next], moreL.im[next]];
    i += 1;
    next += 1;
  }
  return out;
}
