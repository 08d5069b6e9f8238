// A design for a bandwidth: free numbers of its blocks scaled to it, then moved until the page's own margins leave all
// that is required (Levenberg 1944, Marquardt 1963, on what is missed); intervals have the last word.

import { clip, placeIn } from "../numbers/arrays";
import { response, refusal } from "../numbers/controller";
import { controllerOf, designBlock, type Design, type DesignBlock } from "./design";
import { numbersOf } from "../numbers/forms";
import { onColumn, type Margins } from "../loop/margins";
import { seenResonances } from "../loop/shifted";
import { polesOf } from "../loop/stability";
import type { Engine } from "../loop/verdict";
import type { PlantLoop, ReadLimit, Requirements } from "../payload";

/** Blocks that a tuning gives, and whether intervals and stability leave all that is required, and the bandwidth. */
export interface Tuned {
  blocks: DesignBlock[];
  feasible: boolean;
}

/** What counts as much as another: dB, degrees, shares as ln; and how much of that must be left. */
const UNITS: Record<string, number> = { dB: 1, deg: 5 };
const [SHARE, LEFT] = [0.1, 0.05];
/** Corners of a lead about the bandwidth, as ratios, from which a search begins besides the scaled design. */
const SPREADS = [3, 2, 5];
/** Closeness to -1 that is kept where nothing else is required of it. */
const LEAST = { sensitivity_peak_db: 6 };
const CLOSE = ["modulus_margin", "sensitivity_peak_db", "disk_margin", "phase_margin_deg"];

const free = ({ off, locked }: DesignBlock, name: string): boolean => !off && !locked.includes(name);

/** The design with its corners moved from one bandwidth to another; notches stay on their resonances. */
function moved(blocks: DesignBlock[], ratio: number, most: number): DesignBlock[] {
  return blocks.map((block) => {
    const p = { ...block.parameters };
    if (block.kind === "section" || (block.kind === "notch" && p.f1_hz === p.f2_hz)) return block;
    for (const name of Object.keys(p)) if (name.endsWith("_hz") && free(block, name)) p[name] = Math.min(p[name] * ratio, most);
    return { ...block, parameters: p };
  });
}

/** The same with a free gain such that |L| is 1 or more at a frequency at every operating point. */
function levelled(design: Design, { points }: PlantLoop, hz: number): Design {
  const k = design.blocks.findIndex((block) => "gain" in block.parameters && free(block, "gain"));
  if (k < 0) return design;
  const least = Math.min(...points.map(({ f, P }) => {
    const at = clip(placeIn(f, hz), 0, f.length - 1);
    const C = response(controllerOf(design), f.subarray(at, at + 1));
    return Math.hypot(C.re[0], C.im[0]) * Math.hypot(P.re[at], P.im[at]);
  }));
  const blocks = [...design.blocks];
  blocks[k] = { ...blocks[k], parameters: { ...blocks[k].parameters, gain: blocks[k].parameters.gain / least } };
  return { ...design, blocks };
}

/** What a design looks like at another bandwidth before anything is searched. */
export const scaledTo = (design: Design, loop: PlantLoop, from_hz: number, hz: number): Design =>
  levelled({ ...design, blocks: moved(design.blocks, from_hz ? hz / from_hz : 1, 0.45 * loop.rate_hz) }, loop, hz);

/** A lead, a low-pass and notches for a design that is nothing but a gain. */
function furnished(engine: Engine, design: Design, hz: number): Design {
  if (design.blocks.some(({ kind, off }) => !off && kind !== "gain")) return design;
  const most = 0.45 * design.rate_hz;
  const seen = engine.loop.points.flatMap((_, k) => seenResonances(engine.quickLoop(k, controllerOf(levelled(design, engine.loop, hz))))).filter((one) => one.hz > hz);
  const notches = seen.sort((a, b) => b.peak - a.peak).filter((one, k, all) => all.findIndex((other) => Math.abs(Math.log(other.hz / one.hz)) < 0.3) === k).slice(0, 2);
  return {
    ...design,
    blocks: [
      ...(design.blocks.length ? design.blocks : [designBlock({ kind: "gain", parameters: { gain: 1 } })]),
      designBlock({ kind: "lead_lag", parameters: { f1_hz: hz / 3, f2_hz: Math.min(3 * hz, most) } }),
      ...notches.map((one) => designBlock({ kind: "notch", parameters: { f1_hz: one.hz, f2_hz: one.hz, damping1: 0.1, damping2: 0.5 } })),
      designBlock({ kind: "low_pass_2", parameters: { f_hz: Math.min(10 * hz, most), damping: 0.8 } }),
    ],
  };
}

/** Free numbers of a design as logarithms, what is equal once; and the design with others. */
class Free {
  private readonly names: [number, string][];
  readonly start: number[];

  constructor(private readonly design: Design) {
    this.names = design.blocks.flatMap((block, k) => {
      const { kind, parameters: p } = block;
      const ties = kind === "notch" ? [p.f1_hz === p.f2_hz ? "f2_hz" : "", p.f1_hz !== p.f2_hz && p.damping1 === p.damping2 ? "damping2" : ""] : [];
      if (kind === "section") return [];
      return Object.keys(p).filter((name) => p[name] !== 0 && free(block, name) && !ties.includes(name)).map((name): [number, string] => [k, name]);
    });
    this.start = this.names.map(([k, name]) => Math.log(Math.abs(design.blocks[k].parameters[name])));
  }

  at(x: number[]): Design {
    const blocks = [...this.design.blocks];
    this.names.forEach(([k, name], i) => {
      const most = name.endsWith("_hz") ? 0.45 * this.design.rate_hz : name.startsWith("damping") ? 3 : Infinity;
      const size = clip(Math.exp(x[i]), name.startsWith("damping") ? 5e-3 : 1e-12, most);
      const value = Number((Math.sign(blocks[k].parameters[name]) * size).toPrecision(7));
      const parameters = numbersOf(blocks[k], blocks[k].locked).find((one) => one.name === name)?.with(value);
      if (typeof parameters === "object") blocks[k] = { ...blocks[k], parameters };
    });
    return { ...this.design, blocks };
  }
}

/** What is asked for at each operating point while tuning: what the page requires, the bandwidth, and some room to -1. */
function asked(engine: Engine, requirements: Requirements, hz: number): Requirements[] {
  return engine.asked(requirements).map((own) => ({
    ...(CLOSE.some((name) => typeof own[name] === "number") ? {} : LEAST), ...own,
    bandwidth_hz: Math.max(hz, typeof own.bandwidth_hz === "number" ? own.bandwidth_hz : 0),
  }));
}

const signOf = ({ scale, sense }: ReadLimit): number => ((sense === "at_least") !== (scale === "inverse") ? 1 : -1);
/** A value where errors are nearest to normal; of what no column is read as a logarithm. */
const scaled = (limit: ReadLimit, value: number): number => (limit.column === null ? Math.log(value) : onColumn(limit, value));

/** What each limit misses at an operating point, in its unit, 0 where nothing; `off` is by how much intervals are worse. */
function missed(limits: ReadLimit[], required: Requirements, { values }: Margins, off: number[]): number[] {
  return limits.map((limit, k) => {
    const wanted = required[limit.name];
    if (typeof wanted !== "number") return 0;
    const slack = signOf(limit) * (scaled(limit, values[limit.name]) - scaled(limit, wanted));
    const units = (slack - off[k]) / (limit.scale === "plain" ? UNITS[limit.unit] ?? SHARE : SHARE);
    return Number.isNaN(units) ? 20 : clip(LEFT - units, 0, 20);
  });
}

/** By how much the bad ends of intervals lie beyond estimates. */
function offsets(limits: ReadLimit[], { values }: Margins, { intervals }: Margins): number[] {
  return limits.map((limit) => {
    const ends = intervals[limit.name]?.map((end) => signOf(limit) * (scaled(limit, values[limit.name]) - scaled(limit, end))) ?? [];
    const off = Math.max(0, ...ends);
    return Number.isFinite(off) ? off : 0;
  });
}

type Misses = (x: number[]) => number[] | null;
const sum = (values: number[]): number => values.reduce((a, b) => a + b * b, 0);
/** What a number's way from its start costs, as a logarithm: what changes little stays. */
const STAY = 0.02;
/** Share by which a step must lessen what is missed for the search to go on. */
const GAIN = 0.02;

/** Least squares of what is missed, from a start until a time in ms; null counts as infinitely much. */
function searched(misses: Misses, start: number[], until: number): number[] {
  const all = (x: number[]): number[] | null => misses(x)?.concat(x.map((value, k) => STAY * (value - start[k]))) ?? null;
  const isMet = (r: number[]): boolean => sum(r.slice(0, r.length - start.length)) === 0;
  let x = start;
  let now = all(x);
  for (let lambda = 0.01; now && !isMet(now) && lambda < 1e3 && performance.now() < until; ) {
    const here = now;
    const slopes = x.map((_, i) => {
      const other = all(x.map((value, k) => (k === i ? value + 1e-3 : value)));
      return here.map((value, k) => (other ? (other[k] - value) / 1e-3 : 0));
    });
    let better = false;
    while (!better && lambda < 1e3 && performance.now() < until) {
      const step = solved(slopes, here, lambda);
      const next = x.map((value, i) => value + clip(step[i], -0.7, 0.7));
      const then = all(next);
      better = then !== null && sum(then) < sum(here);
      if (better) [x, now] = [next, then];
      lambda *= better ? 0.3 : 5;
    }
    if (better && now && sum(now) > sum(here) * (1 - GAIN)) break;
  }
  return x;
}

/** Step d that makes |r + J d|² least, damped; J's columns are `slopes`. By elimination: the matrix is definite. */
function solved(slopes: number[][], r: number[], lambda: number): number[] {
  const dot = (a: number[], b: number[]): number => a.reduce((total, value, k) => total + value * b[k], 0);
  const A = slopes.map((one, i) => [...slopes.map((other, k) => dot(one, other) * (i === k ? 1 + lambda : 1) + (i === k ? 1e-3 * lambda + 1e-9 : 0)), -dot(one, r)]);
  const n = A.length;
  for (let i = 0; i < n; i++) {
    for (let k = i + 1; k < n; k++) {
      const share = A[k][i] / A[i][i];
      for (let j = i; j <= n; j++) A[k][j] -= share * A[i][j];
    }
  }
  const out = new Array<number>(n).fill(0);
  for (let i = n - 1; i >= 0; i--) out[i] = (A[i][n] - dot(A[i].slice(i + 1, n), out.slice(i + 1))) / A[i][i];
  return out;
}

/** Operating points that a search looks at, those that miss most; ends of the others are seen to between searches. */
const LOOKED = 4;

/** A design tuned for a bandwidth in Hz within some ms, from where it stands at another. */
export function tuned(engine: Engine, design: Design, from_hz: number, wanted_hz: number, most_ms: number): Tuned {
  const until = performance.now() + most_ms;
  const { loop } = engine;
  const required = asked(engine, design.requirements, wanted_hz);
  const hz = Math.max(...required.map((own) => own.bandwidth_hz as number));
  const limits = engine.payload.limits.filter(({ name }) => name !== "detuning_percent" && required.some((own) => typeof own[name] === "number"));
  const every = Array.from(loop.points.keys());
  const missedAt = (one: Design, points: number[], off: number[][]): number[][] | null => {
    const controller = controllerOf(one);
    if (refusal(controller) || points.some((k) => polesOf(engine.quickLoop(k, controller)) !== 0)) return null;
    return points.map((k) => missed(limits, required[k], engine.estimate(k, controller, required[k]), off[k]));
  };
  const none = every.map(() => limits.map(() => 0));
  const cost = (one: Design, off: number[][]): number => sum(missedAt(one, every, off)?.flat() ?? [Infinity]);
  const own = furnished(engine, design, hz);
  const levels = [1, 0.5, 0.25].map((share) => share * hz); // a lower bandwidth where all else is not stable
  const begins = levels.flatMap((level) => [scaledTo(own, loop, from_hz, level), ...SPREADS.map((spread) => levelled(spreadOut(own, level, spread), loop, level))]);
  const starts = begins.map((one) => ({ one, cost: cost(one, none) })).filter((start) => start.cost < Infinity);
  starts.sort((a, b) => a.cost - b.cost);
  let best = { one: starts[0]?.one ?? begins[0], cost: Infinity };
  for (let k = 0; k < Math.min(starts.length, 4) && best.cost > 0 && performance.now() < until; k++) {
    const end = performance.now() + (until - performance.now()) / Math.min(2, starts.length - k);
    let { one } = starts[k];
    let off = none;
    for (let round = 0; round < 4 && performance.now() < end; round++) {
      const misses = missedAt(one, every, off)?.map(sum) ?? every.map(() => 0);
      const points = every.toSorted((a, b) => misses[b] - misses[a]).slice(0, LOOKED);
      const space = new Free(one);
      one = space.at(searched((x) => missedAt(space.at(x), points, off)?.flat() ?? null, space.start, end));
      const controller = controllerOf(one);
      off = every.map((k) => offsets(limits, engine.estimate(k, controller, required[k]), engine.settled(k, controller, required[k])));
      const now = cost(one, off);
      if (now < best.cost) best = { one, cost: now };
      if (now === 0) break;
    }
  }
  return { blocks: best.one.blocks, feasible: holds(engine, best.one, required) };
}

/** A design with its lead, PI and low-pass about a bandwidth. */
function spreadOut(design: Design, hz: number, spread: number): Design {
  const blocks = design.blocks.map((block) => {
    const p = { ...block.parameters };
    if (block.kind === "lead_lag" && p.f1_hz < p.f2_hz && !block.locked.length) Object.assign(p, { f1_hz: hz / spread, f2_hz: hz * spread });
    if (block.kind === "pi" && free(block, "f_hz")) p.f_hz = 0.1 * hz;
    if (block.kind.startsWith("low_pass") && free(block, "f_hz")) p.f_hz = Math.max(p.f_hz, Math.min(10 * hz, 0.45 * design.rate_hz));
    return { ...block, parameters: p };
  });
  return { ...design, blocks };
}

/** Whether intervals and stability leave what is asked for. */
function holds(engine: Engine, design: Design, required: Requirements[]): boolean {
  const without = required.map(({ detuning_percent: _, ...own }) => own as Requirements);
  const controller = controllerOf(design);
  return engine.verdictOf(without, required.map((own, k) => engine.settled(k, controller, own))).outcome === "passed";
}
