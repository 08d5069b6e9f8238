// Resonances close together, as Python fitted them to the plant: how 1 + L turns past them in each way that the lines
// allow (Python: `ModeCluster.response` of loop/stability/mode_clusters.py, `turns_past_cluster` of loop/margin/between.py).

import { clip, placeIn, times, TWO_PI, zeros, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import type { Loop } from "./loop";
import type { ModeCluster } from "../payload";
import { angleOf, chords, turnAlong } from "./turns";

/** Least and most whole turns more than the path's, how near to -1 the likeliest way comes in each gap. */
export interface Turns {
  least: number;
  most: number;
  near: Real;
  /** Whether L turns slowly enough about -1 to be interpolated. */
  sure: boolean;
}

export function turnsPastCluster(cluster: ModeCluster, loop: Loop): Turns {
  const { f, dense, denseL } = loop;
  const own = f.subarray(cluster.low, cluster.high + 1);
  const straight = turnAlong(denseL, placeIn(dense.f, own[0]), placeIn(dense.f, own[own.length - 1]));
  const out: Turns = { least: Infinity, most: -Infinity, near: new Float64Array(0), sure: true };
  pathsOf(cluster, loop).forEach(({ at, P }, way) => {
    const L = times(control.response(loop.controller, at), P);
    if (way === 0) out.near = nearIn(own, at, chords(L));
    const { turn, sure } = turned(new Way(cluster, way, loop), at, L);
    const more = Math.round((turn - straight) / TWO_PI);
    [out.least, out.most, out.sure] = [Math.min(out.least, more), Math.max(out.most, more), out.sure && sure];
  });
  return out;
}

/** The least of values of steps at rising places in each gap between lines. */
function nearIn(own: Real, at: Real, values: Real): Real {
  const starts = Array.from(own.subarray(0, -1), (x) => placeIn(at, x));
  return Float64Array.from(starts, (from, k) => values.subarray(from, starts[k + 1] ?? values.length).reduce((a, b) => Math.min(a, b), Infinity));
}

/** P past a cluster in one of its ways, anywhere. */
class Way {
  constructor(
    private readonly cluster: ModeCluster,
    private readonly way: number,
    private readonly loop: Loop,
  ) {}

  get constants(): { far: number; rounds: number } {
    return this.loop.plant.source.constants;
  }

  get places(): Real {
    const { cluster, way, loop } = this;
    const own = loop.f.subarray(cluster.low, cluster.high + 1);
    const [start, end] = [own[0], own[own.length - 1]];
    const { path_half_widths } = loop.plant.source.constants;
    const count = cluster.poles.re.length / cluster.ways;
    const near: number[] = [];
    for (let k = way * count; k < (way + 1) * count; k++) near.push(...path_half_widths.map((x) => cluster.poles.re[k] + Math.abs(cluster.poles.im[k]) * x));
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
    const { cluster, way, loop } = this;
    const [start, end] = [loop.f[cluster.low], loop.f[cluster.high]];
    const x = (2 * Math.log(hz / start)) / Math.log(end / start) - 1;
    let [re, im] = horner(cluster.polynomials, cluster.polynomials.re.length / cluster.ways, way, x);
    const count = cluster.poles.re.length / cluster.ways;
    for (let k = way * count; k < (way + 1) * count; k++) {
      const [dr, di] = [hz - cluster.poles.re[k], -cluster.poles.im[k]];
      const size = dr * dr + di * di;
      re += (cluster.residues.im[k] * dr - cluster.residues.re[k] * di) / size;
      im -= (cluster.residues.re[k] * dr + cluster.residues.im[k] * di) / size;
    }
    const ln = Math.log(hz / cluster.middle_hz);
    const grown = Math.exp(cluster.power[0] * ln);
    const turn = cluster.power[1] * ln - TWO_PI * cluster.delay_s * (hz - start);
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

interface ClusterPath {
  at: Real;
  P: Complex;
}

const known = new WeakMap<ModeCluster, ClusterPath[]>();

/** Places along the lines of a cluster, dense about its poles, with P there: of no controller, once. */
function pathsOf(cluster: ModeCluster, loop: Loop): ClusterPath[] {
  const made = known.get(cluster) ?? Array.from({ length: cluster.ways }, (_, k) => {
    const way = new Way(cluster, k, loop);
    const at = way.places;
    return { at, P: way.response(at) };
  });
  known.set(cluster, made);
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
