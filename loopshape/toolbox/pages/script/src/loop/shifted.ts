// A plant whose resonances have moved, all or one, and what margins and count read from it (Python: loop/shifted.py).

import { clip, concat, placeIn, plus, times, type Complex, type Real } from "../numbers/arrays";
import * as control from "../numbers/controller";
import { addPole, Drawn, type Dense, type Draws } from "../numbers/dense";
import { interpolated, inSight, isLarge, largestAbove, type Loop, type Plant } from "./loop";
import { aboveHz } from "./margins";
import type { Seen } from "../payload";
import type { Reader } from "./limits";
import * as kernel from "./reading";
import { countUnstable, swingNear } from "./stability";

/** Margins by column, unstable poles by the bare count, and the least distance of L from -1 over its deviation. */
export interface Reading {
  values: Float64Array;
  poles: number | null;
  clear: number;
}

/** A plant at a shift: its frequency axis stretched by a factor, P on it, and what leads below its first line. */
interface Stand {
  by: number;
  P: Complex;
  belowP: Complex | null;
}

/** Lines that margins are read from, with deviation and draws of P, and frequencies below and above them. */
interface Lines {
  f: Real;
  P: Complex;
  std: Real;
  draws: Draws;
  belowF: Real;
  belowP: Complex | null;
  aboveF: Real;
  aheadOf: number; // lines before the first one that was measured
}

/** What a controller makes of lines that stand at a place. */
interface AtShift {
  grid: kernel.Grid;
  C: Complex;
  belowC: Complex | null;
}

/** The unmoved plant of a loop, and how it stands when its axis is stretched or one resonance is moved. */
export class Shiftable {
  readonly lines: Lines;

  constructor(
    readonly loop: Loop,
    plant: Plant,
    readonly reader: Reader,
  ) {
    this.lines = linesOf(loop, plant);
  }

  /** The plant with its whole frequency axis stretched. */
  stretched(): Moved {
    const { P, belowP } = this.lines;
    return new Moved(this, (percent) => ({ by: 1 + 0.01 * percent, P, belowP }));
  }

  /** The plant with one of its resonances moved alone: taken out, and put back moved. */
  withMoved(one: Seen): Moved {
    const { f, P, belowF, belowP } = this.lines;
    return new Moved(this, (percent) => ({
      by: 1,
      P: plus(P, change(one, f, 0.01 * percent)),
      belowP: belowP && plus(belowP, change(one, belowF, 0.01 * percent)),
    }));
  }
}

/** What a relative shift of a resonance adds to P: mode shape and mass are kept, so R of R/(s² + 2 zeta w s + w²). */
function change({ pole, residue }: Seen, f: Real, shift: number): Complex {
  const out = { re: new Float64Array(f.length), im: new Float64Array(f.length) };
  const scaled = ([re, im]: [number, number], by: number): [number, number] => [re * by, im * by];
  addPole(out, f, scaled(residue, 1 / (1 + shift)), scaled(pole, 1 + shift));
  addPole(out, f, scaled(residue, -1), pole);
  return out;
}

/** A plant at shifts in per cent, read once at each. */
export class Moved {
  readonly readings = new Map<number, Reading>();
  private readonly scatters = new Map<number, { bias: Float64Array; half_width: Float64Array }>();
  private last: { by: number; at_shift: AtShift } | null = null;

  constructor(
    private readonly of: Shiftable,
    private readonly at: (percent: number) => Stand,
  ) {}

  /** What margins and count are at a shift. */
  reading(percent: number): Reading {
    const known = this.readings.get(percent);
    if (known) return known;
    const { by, P, belowP } = this.at(percent);
    const { grid, C, belowC } = this.shiftedBy(by);
    const { loop, lines } = this.of;
    const { integrators, point, plant } = loop;
    const n = grid.f.length;
    const L = times(C, { re: P.re.subarray(0, n), im: P.im.subarray(0, n) });
    const { found } = kernel.read(grid, L);
    let clear = Infinity;
    for (let k = 0; k < n; k++) {
      const share = Math.hypot(1 + L.re[k], L.im[k]) / (Math.hypot(C.re[k], C.im[k]) * lines.std[k]);
      if (!(share >= clear)) clear = share;
    }
    const below = belowC && belowP && times(belowC, belowP);
    const from = Math.hypot(L.re[lines.aheadOf], L.im[lines.aheadOf]) >= 1 ? lines.aheadOf : 0;
    const counted = { re: L.re.subarray(from), im: L.im.subarray(from) }; // it says how L starts by its first value
    const poles = countUnstable(counted, integrators, point.unstable_poles ?? 0, below, plant.source.constants.fit_deg, below ? 0 : swingNear(loop));
    const made = { values: found, poles, clear };
    this.readings.set(percent, made);
    return made;
  }

  /** Bias and half interval of a reading's columns, by draws of the plant's error; infinite where one jumps. */
  scatter(percent: number): { bias: Float64Array; half_width: Float64Array } {
    const known = this.scatters.get(percent);
    if (known) return known;
    const made = this.scattered(percent);
    this.scatters.set(percent, made);
    return made;
  }

  private scattered(percent: number): { bias: Float64Array; half_width: Float64Array } {
    const { by, P } = this.at(percent);
    const { grid, C } = this.shiftedBy(by);
    const { values } = this.reading(percent);
    const L = times(C, { re: P.re.subarray(0, C.re.length), im: P.im.subarray(0, C.re.length) });
    const { found } = kernel.ended(grid, kernel.scan(grid, { L, reference: L, factor: C, draws: this.of.lines.draws }, kernel.linesOf(grid.f.length)[0]), true);
    const made = { bias: new Float64Array(kernel.COLUMNS), half_width: new Float64Array(kernel.COLUMNS) };
    for (let c = 0; c < kernel.COLUMNS; c++) {
      const off = found[c].subarray(2).map((value) => kernel.inUnits(c, value) - values[c]);
      const known = Number.isFinite(values[c]) && off.every(Number.isFinite);
      const mean = known ? off.reduce((a, b) => a + b, 0) / off.length : 0;
      const squares = known ? off.reduce((a, b) => a + (b - mean) ** 2, 0) / off.length : 0;
      made.bias[c] = mean;
      made.half_width[c] = known ? this.of.loop.plant.source.constants.detuning.half_width * Math.sqrt(squares) : Infinity;
    }
    return made;
  }

  /** Lines below half the rate with the controller there, once for a reading and its scatter. */
  private shiftedBy(by: number): AtShift {
    if (this.last?.by === by) return this.last.at_shift;
    const { loop, lines, reader } = this.of;
    const { controller } = loop;
    const { rate_hz } = controller;
    const stretched = lines.f.map((x) => x * by);
    const f = stretched.subarray(0, placeIn(stretched, 0.499 * rate_hz));
    const above = lines.aboveF.map((x) => x * by);
    const more = lines.aboveF.filter((x) => above.length > 0 && x > above[above.length - 1]);
    const aboveF = concat(above, more).filter((x) => x > f[f.length - 1] && x <= 0.45 * rate_hz);
    const C = control.response(controller, f);
    const belowC = lines.belowP && control.response(controller, lines.belowF.map((x) => x * by));
    const aboveC2 = kernel.squares(control.response(controller, aboveF));
    const grid = kernel.gridOf(f, kernel.squares(C), aboveF, aboveC2, reader, largestAbove(loop));
    this.last = { by, at_shift: { grid, C, belowC } };
    return this.last.at_shift;
  }
}

/** Resonances of the plant whose peak matters to L. */
export function seenResonances({ point, controller, plant }: Loop): Seen[] {
  const { matters, near } = plant.source.constants.detuning;
  return point.resonances.filter(({ hz, peak }) => {
    if (hz >= (0.5 * controller.rate_hz) / (1 + near[near.length - 1])) return false;
    const C = control.response(controller, Float64Array.from(near, (x) => hz * (1 + x)));
    return Math.max(...kernel.squares(C)) ** 0.5 * peak > matters;
  });
}

function linesOf(loop: Loop, plant: Plant): Lines {
  const { point, controller } = loop;
  const dense = interpolated(fewerDraws(plant.dense, plant.source.constants.detuning.draws), controller, plant.source);
  const own = { f: dense.f, P: dense.P, std: deviations(plant, dense.f), draws: dense.draws as Draws, aheadOf: 0 };
  return {
    ...withExtrapolated(loop, own),
    belowF: point.fitted_f,
    belowP: point.fitted_f.length ? point.fitted : null,
    aboveF: aboveHz(point.f[point.f.length - 1], controller.rate_hz),
  };
}

function fewerDraws(dense: Dense, count: number): Dense {
  const draws = dense.draws as Draws;
  return { ...dense, draws: draws.map(({ re, im }) => new Drawn(re.subarray(0, count), im.subarray(0, count))), of: draws[0].count };
}

/** Deviation of the plant at frequencies among its lines, straight between them. */
function deviations({ point, dense }: Plant, at: Real): Real {
  const draws = dense.draws as Draws;
  const std = point.f.map((x) => draws[placeIn(dense.f, x)].rms);
  return at.map((x) => {
    const k = clip(placeIn(point.f, x, true) - 1, 0, point.f.length - 2);
    return std[k] + ((std[k + 1] - std[k]) / (point.f[k + 1] - point.f[k])) * (x - point.f[k]);
  });
}

type Known = Pick<Lines, "f" | "P" | "std" | "draws" | "aheadOf">;

/** The lines with those before them where a model leads to the first one: as unsure as that. */
function withExtrapolated(loop: Loop, own: Known): Known {
  const [model] = loop.point.extrapolated;
  if (!model || isLarge(loop) || !inSight(loop)) return own;
  const skipped = loop.integrators > 0 ? 1 : 0;
  const ahead = { re: model.P.re.subarray(skipped), im: model.P.im.subarray(skipped) };
  const below_f = Float64Array.from(loop.plant.source.constants.below_ratios.slice(skipped), (share) => loop.f[0] * share);
  const [pr, pi] = [own.P.re[0], own.P.im[0]];
  const size = pr * pr + pi * pi;
  const share: Complex = {
    re: ahead.re.map((x, k) => (x * pr + ahead.im[k] * pi) / size),
    im: ahead.re.map((x, k) => (ahead.im[k] * pr - x * pi) / size),
  };
  const draws = Array.from(below_f, (_, k) => {
    const out = Drawn.fresh(own.draws[0].count);
    out.add(own.draws[0], share.re[k], share.im[k]);
    return out;
  });
  return {
    f: concat(below_f, own.f),
    P: { re: concat(ahead.re, own.P.re), im: concat(ahead.im, own.P.im) },
    std: concat(share.re.map((x, k) => own.std[0] * Math.hypot(x, share.im[k])), own.std),
    draws: [...draws, ...own.draws],
    aheadOf: below_f.length,
  };
}
