// A smoothed plant with draws of its error, on its lines and on places between them (Python: data/smoothed.py).

import { clip, concat, placeIn, plus, times, union, zeros, type Complex, type Real } from "./arrays";
import type { Constants, Point } from "../payload";
import { Normals, type State } from "./random";
import { slopes, valueAt } from "./spline";

/** Draws (draws,) of the error of one place, with what is summed over them. */
export class Drawn {
  private sums: { power: number; most: number; mean: [number, number] } | null = null;
  private before: Drawn | null = null;
  private cross = 0;

  constructor(
    readonly re: Real,
    readonly im: Real,
  ) {}

  static fresh(count: number): Drawn {
    return new Drawn(new Float64Array(count), new Float64Array(count));
  }

  get count(): number {
    return this.re.length;
  }

  private get summed(): { power: number; most: number; mean: [number, number] } {
    if (this.sums) return this.sums;
    let [power, most, x, y] = [0, 0, 0, 0];
    for (let d = 0; d < this.count; d++) {
      const size = this.re[d] * this.re[d] + this.im[d] * this.im[d];
      power += size;
      most = size > most ? size : most;
      x += this.re[d];
      y += this.im[d];
    }
    this.sums = { power, most: Math.sqrt(most), mean: [x / this.count, y / this.count] };
    return this.sums;
  }

  /** Sum of squares. */
  get power(): number {
    return this.summed.power;
  }

  /** The largest. */
  get most(): number {
    return this.summed.most;
  }

  /** Root mean square. */
  get rms(): number {
    return Math.sqrt(this.power / this.count);
  }

  /** Deviation from the mean. */
  get std(): number {
    const { power, mean } = this.summed;
    return Math.sqrt(Math.max(power / this.count - mean[0] ** 2 - mean[1] ** 2, 0));
  }

  /** How far the errors of a neighbour are the same. */
  common(before: Drawn): number {
    if (this.before !== before) {
      let [x, y] = [0, 0];
      for (let d = 0; d < this.count; d++) {
        x += this.re[d] * before.re[d] + this.im[d] * before.im[d];
        y += this.im[d] * before.re[d] - this.re[d] * before.im[d];
      }
      [this.before, this.cross] = [before, Math.hypot(x, y)];
    }
    return this.cross / (Math.max(Math.sqrt(this.power), 1e-150) * Math.max(Math.sqrt(before.power), 1e-150));
  }

  plus(other: Drawn, sign = 1): Drawn {
    return new Drawn(this.re.map((x, d) => x + sign * other.re[d]), this.im.map((x, d) => x + sign * other.im[d]));
  }

  /** Adds another's draws times a number. */
  add({ re, im }: Drawn, x: number, y = 0): void {
    const [ownRe, ownIm] = [this.re, this.im];
    for (let d = 0; d < re.length; d++) {
      ownRe[d] += x * re[d];
      ownIm[d] += x * im[d];
    }
    if (y === 0) return;
    for (let d = 0; d < re.length; d++) {
      ownRe[d] -= y * im[d];
      ownIm[d] += y * re[d];
    }
  }
}

/** Draws at each place. */
export type Draws = Drawn[];

export interface Dense {
  f: Real;
  P: Complex;
  reference: Complex;
  draws: Draws | null;
  /** Of how many draws these are the first, where they are not all. */
  of?: number;
}

/** What is common to all plants: the first normal numbers of a generator, as many as were asked for so far. */
class Stream {
  private known: Float64Array = new Float64Array(0);
  constructor(private readonly normals: Normals) {}

  first(count: number): Float64Array {
    if (count > this.known.length) this.known = concat(this.known, this.normals.take(count - this.known.length));
    return this.known;
  }
}

export class Source {
  private readonly stream: Stream;
  private readonly sideNormals: Float64Array;
  constructor(
    readonly constants: Constants,
    smoothing: State,
    between: State,
  ) {
    this.stream = new Stream(new Normals(smoothing));
    this.sideNormals = new Normals(between).take(2 * constants.draws);
  }

  /** Errors of lines: circular, of a variance, neighbours correlated by taps. */
  errors(variance: Real, taps: number[]): Draws {
    const { draws: count } = this.constants;
    const wide = variance.length + taps.length - 1;
    const white = this.stream.first(2 * count * wide);
    const power = taps.reduce((sum, tap) => sum + tap * tap, 0);
    return Array.from(variance, (v, k) => {
      const out = Drawn.fresh(count);
      const scale = Math.sqrt((0.5 * v) / power);
      for (let d = 0; d < count; d++) {
        let [re, im] = [0, 0];
        for (let t = 0; t < taps.length; t++) {
          re += taps[t] * white[d * wide + k + t];
          im += taps[t] * white[(count + d) * wide + k + t];
        }
        [out.re[d], out.im[d]] = [re * scale, im * scale];
      }
      return out;
    });
  }

  /** One complex number a draw, by which a spline may lie off straight lines. */
  sides(count: number): Complex {
    const out = zeros(count);
    let power = 0;
    for (let d = 0; d < count; d++) {
      out.re[d] = this.sideNormals[2 * d];
      out.im[d] = this.sideNormals[2 * d + 1];
      power += out.re[d] ** 2 + out.im[d] ** 2;
    }
    const scale = Math.sqrt(2 / (power / count));
    return { re: out.re.map((x) => x * scale), im: out.im.map((x) => x * scale) };
  }
}

/** The plant's lines and what is known between them; with draws where they are asked for. */
export function knownPlant(point: Point, source: Source, drawn: boolean): Dense {
  const lines = drawn ? drawnLines(point, source) : null;
  if (!point.terms.length) return { f: point.f, P: point.P, reference: lines?.reference ?? point.P, draws: lines && lines.moved };
  const f = point.f;
  const places = point.terms.flatMap((x) => source.constants.places.map((p) => x.pole[0] + Math.abs(x.pole[1]) * p));
  const between = Float64Array.from(places.filter((x) => x > f[0] && x < f[f.length - 1]));
  const at = union(f, between);
  const poles = termResponse(point, f);
  const rest = minus(point.P, poles);
  const smooth: Dense = { f, P: rest, reference: lines ? minus(lines.reference, poles) : rest, draws: lines && lines.strayed };
  const dense = densified(smooth, at, source);
  const more = termResponse(point, at);
  const moved = lines && termMoves(point, at, lines.errors);
  const draws = moved && (dense.draws as Draws).map((one, k) => one.plus(moved[k]));
  return { f: at, P: plus(dense.P, more), reference: plus(dense.reference, more), draws };
}

function minus(a: Complex, b: Complex): Complex {
  return { re: a.re.map((x, k) => x - b.re[k]), im: a.im.map((x, k) => x - b.im[k]) };
}

interface DrawnLines {
  reference: Complex;
  errors: Draws;
  strayed: Draws;
  moved: Draws;
}

function drawnLines(point: Point, source: Source): DrawnLines {
  if (point.variance.every((v) => v === 0)) {
    const none = Array.from(point.f, () => Drawn.fresh(1));
    return { reference: point.P, errors: none, strayed: none, moved: none };
  }
  const errors = source.errors(point.variance, point.taps);
  const poles = termMoves(point, point.f, errors);
  const strayed = smoothedDraws(point, errors.map((one, k) => one.plus(poles[k], -1)), source.constants.degree);
  const moved = strayed.map((one, k) => one.plus(poles[k]));
  return { reference: referenceOf(point, source.constants.degree), errors, strayed, moved };
}

/** What the smoothing makes of its own answer: what draws are added to. */
function referenceOf(point: Point, degree: number): Complex {
  const poles = termResponse(point, point.f);
  const rest = minus(point.P, poles);
  const smooth = smoothedDraws(point, Array.from(point.f, (_, k) => new Drawn(rest.re.subarray(k, k + 1), rest.im.subarray(k, k + 1))), degree);
  return plus({ re: Float64Array.from(smooth, ({ re }) => re[0]), im: Float64Array.from(smooth, ({ im }) => im[0]) }, poles);
}

/** What narrow resonances add at f: r/(j (f - z)) and its mirror is in P already, as Python's `Resonance.response`. */
function termResponse(point: Point, f: Real): Complex {
  const out = zeros(f.length);
  for (const { residue, pole } of point.terms) addPole(out, f, residue, pole);
  return out;
}

export function addPole(out: Complex, f: Real, [rr, ri]: [number, number], [zr, zi]: [number, number]): void {
  for (let k = 0; k < f.length; k++) {
    // r/(j (f - z)) = -j r/(f - z), and conj(r)/(j (f + conj(z)))
    for (const [re, im, dr, di] of [[rr, ri, f[k] - zr, -zi], [rr, -ri, f[k] + zr, -zi]]) {
      const size = dr * dr + di * di;
      const [qr, qi] = [(re * dr + im * di) / size, (im * dr - re * di) / size];
      out.re[k] += qi;
      out.im[k] -= qr;
    }
  }
}

function termMoves(point: Point, f: Real, errors: Draws): Draws {
  const { count } = errors[0];
  const out = Array.from(f, () => Drawn.fresh(count));
  for (const { residue, pole, first, influence } of point.terms) {
    const width = influence.re.length / 2;
    const [byResidue, byPole] = [0, 1].map((row) => {
      const moved = Drawn.fresh(count);
      for (let k = row * width; k < (row + 1) * width; k++) moved.add(errors[first + (k % width)], influence.re[k], influence.im[k]);
      return moved;
    });
    out.forEach((one, k) => {
      // r/(j (f - z)): what the residue adds, and the pole
      const across = inverse(f[k] - pole[0], -pole[1]);
      const turned = product(product(across, across), residue);
      one.add(byResidue, across[1], -across[0]);
      one.add(byPole, turned[1], -turned[0]);
    });
  }
  return out;
}

type Pair = number[];
const product = (a: Pair, b: Pair): Pair => [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]];
const sum = (a: Pair, b: Pair): Pair => [a[0] + b[0], a[1] + b[1]];

function inverse(re: number, im: number): Pair {
  const size = re * re + im * im;
  return [re / size, -im / size];
}

function smoothedDraws(point: Point, errors: Draws, degree: number): Draws {
  const x = point.f.map(Math.log);
  const size = point.raw.re.map((re, k) => re * re + point.raw.im[k] ** 2);
  const floor = point.variance.map((v, k) => Math.max(v, 1e-20 * size[k] + 1e-300));
  return errors.map(({ count }, k) => {
    const { first, weights } = smoothingWeights(x, floor, k, point.halves[k], degree);
    const out = Drawn.fresh(count);
    weights.forEach((weight, i) => out.add(errors[first + i], weight));
    return out;
  });
}

/** First line and weights by which a window's lines make the response at line k (kernels/smoothing.py). */
function smoothingWeights(x: Real, v: Real, k: number, half: number, degree: number): { first: number; weights: Real } {
  const lines = x.length;
  const first = Math.min(Math.max(k - half, 0), lines - 2 * half - 1);
  const n = 2 * half + 1;
  if (n === 1) return { first, weights: Float64Array.of(1) };
  const w = v.slice(first, first + n).map((value) => 1 / value);
  const basis = orthonormal(x.slice(first, first + n).map((value) => value - x[k]), w, Math.min(degree, n - 1));
  const weights = w.map((weight, i) => weight * basis.reduce((total, q) => total + q[k - first] * q[i], 0));
  return { first, weights };
}

function orthonormal(x: Real, w: Real, degree: number): Real[] {
  const n = x.length;
  const largest = Math.max(Math.abs(x[0]), Math.abs(x[n - 1]));
  const basis: Real[] = [];
  for (let j = 0; j <= degree; j++) {
    const q = j === 0 ? new Float64Array(n).fill(1) : basis[j - 1].map((value, i) => (value * x[i]) / largest);
    for (let pass = 0; pass < 2; pass++) {
      for (const other of basis) {
        let projection = 0;
        for (let i = 0; i < n; i++) projection += w[i] * other[i] * q[i];
        for (let i = 0; i < n; i++) q[i] -= projection * other[i];
      }
    }
    let size = 0;
    for (let i = 0; i < n; i++) size += w[i] * q[i] * q[i];
    size = Math.sqrt(size);
    basis.push(q.map((value) => value / size));
  }
  return basis;
}

/** d ln P/d ln f of the lowest lines; 0 where they tell none. */
function lowestPower(f: Real, P: Complex, { lowest, steepest }: Constants): Pair {
  const count = Math.min(Math.max(placeIn(f, lowest * f[0]), 4), f.length);
  if (count < 2) return [0, 0];
  const x = Array.from({ length: count }, (_, k) => Math.log(f[k] / f[0]));
  const mean = x.reduce((a, b) => a + b, 0) / count;
  let [re, im, squares, angle, before] = [0, 0, 0, 0, 0];
  for (let k = 0; k < count; k++) {
    const size = Math.hypot(P.re[k], P.im[k]);
    if (size === 0) return [0, 0];
    const now = Math.atan2(P.im[k], P.re[k]);
    let step = now - before;
    if (k > 0) step -= 2 * Math.PI * Math.round(step / (2 * Math.PI));
    angle = k === 0 ? now : angle + step;
    before = now;
    re += (x[k] - mean) * Math.log(size);
    im += (x[k] - mean) * angle;
    squares += (x[k] - mean) ** 2;
  }
  const power = [re / squares, im / squares];
  return Math.hypot(power[0], power[1]) <= steepest ? power : [0, 0];
}

interface Curve {
  own: Complex;
  power: Pair;
  P: Complex;
  reference: Complex;
  slopeP: Complex;
  slopeReference: Complex;
}

const curves = new WeakMap<Real, Curve>();

/** The plant without the power of f that its lowest lines follow, and its splines; remembered by its reference. */
function curveOf(dense: Dense, constants: Constants): Curve {
  const found = curves.get(dense.reference.re);
  if (found) return found;
  const power = lowestPower(dense.f, dense.P, constants);
  const own = powers(dense.f, dense.f[0], [-power[0], -power[1]]);
  const P = times(dense.P, own);
  const reference = times(dense.reference, own);
  const made = { own, power, P, reference, slopeP: slopes(dense.f, P), slopeReference: slopes(dense.f, reference) };
  curves.set(dense.reference.re, made);
  return made;
}

function powers(f: Real, first: number, power: Pair): Complex {
  const out = zeros(f.length);
  for (let k = 0; k < f.length; k++) put(out, k, powerAt(f[k] / first, power));
  return out;
}

function powerAt(ratio: number, power: Pair): Pair {
  const ln = Math.log(ratio);
  const size = Math.exp(power[0] * ln);
  return [size * Math.cos(power[1] * ln), size * Math.sin(power[1] * ln)];
}

/** Straight value and how far the spline lies off it, at a place of the k-th gap. */
function curved(f: Real, values: Complex, slope: Complex, k: number, at: number, share: number): [Pair, Pair] {
  const straight = [
    values.re[k] * (1 - share) + values.re[k + 1] * share,
    values.im[k] * (1 - share) + values.im[k + 1] * share,
  ];
  const step = (i: number): number => Math.hypot(values.re[i + 1] - values.re[i], values.im[i + 1] - values.im[i]);
  const most = 0.5 * Math.max(step(Math.max(k - 1, 0)), step(k), step(Math.min(k + 1, f.length - 2)));
  const off = [
    valueAt(f, values.re, slope.re, k, at) - straight[0],
    valueAt(f, values.im, slope.im, k, at) - straight[1],
  ];
  const scale = most / Math.max(Math.hypot(off[0], off[1]), Math.max(most, 1e-300));
  return [straight, [off[0] * scale, off[1] * scale]];
}

/** The same at other frequencies within these: by splines, draws straight from line to line (`Dense.at`). */
export function densified(dense: Dense, at: Real, source: Source): Dense {
  const { f, draws } = dense;
  const [n, m] = [f.length, at.length];
  const sides = draws && source.sides(dense.of ?? draws[0].count);
  const curve = curveOf(dense, source.constants);
  const out: Dense = { f: at, P: zeros(m), reference: zeros(m), draws: draws && new Array<Drawn>(m), of: dense.of };
  for (let j = 0; j < m; j++) {
    const line = placeIn(f, at[j], true) - 1;
    if (line >= 0 && f[line] === at[j]) {
      if (draws) (out.draws as Draws)[j] = draws[line];
      put(out.P, j, [dense.P.re[line], dense.P.im[line]]);
      put(out.reference, j, [dense.reference.re[line], dense.reference.im[line]]);
      continue;
    }
    const k = clip(line, 0, n - 2);
    const share = (at[j] - f[k]) / (f[k + 1] - f[k]);
    const b = powerAt(at[j] / f[0], curve.power);
    const [straight, bent] = curved(f, curve.P, curve.slopeP, k, at[j], share);
    const again = curved(f, curve.reference, curve.slopeReference, k, at[j], share);
    put(out.P, j, product(b, sum(straight, bent)));
    put(out.reference, j, product(b, sum(again[0], again[1])));
    if (!draws || !sides) continue;
    const [here, next] = [product(b, [curve.own.re[k], curve.own.im[k]]), product(b, [curve.own.re[k + 1], curve.own.im[k + 1]])];
    const [size, bentBack] = [Math.sqrt(0.5) * source.constants.between, product(b, bent)];
    const weights = [...here.map((x) => x * (1 - share)), ...next.map((x) => x * share), ...bentBack.map((x) => x * size)];
    (out.draws as Draws)[j] = between(draws[k], draws[k + 1], sides, weights);
  }
  return out;
}

function put(z: Complex, k: number, value: Pair): void {
  z.re[k] = value[0];
  z.im[k] = value[1];
}

/** Draws at a place: by those on the lines beside it and a part that is common to all places. */
function between(low: Drawn, high: Drawn, sides: Complex, [lr, li, hr, hi, sr, si]: number[]): Drawn {
  const out = Drawn.fresh(low.count);
  for (let d = 0; d < low.count; d++) {
    const [ar, ai, br, bi, cr, ci] = [low.re[d], low.im[d], high.re[d], high.im[d], sides.re[d], sides.im[d]];
    out.re[d] = ar * lr - ai * li + br * hr - bi * hi + cr * sr - ci * si;
    out.im[d] = ar * li + ai * lr + br * hi + bi * hr + cr * si + ci * sr;
  }
  return out;
}

/** The same with places between lines where it moves by more than a step of the room there (`Dense.between`). */
export function withBetween(dense: Dense, moved: Real, room: Real, source: Source): Dense {
  const { step, most, fewest } = source.constants;
  const f = dense.f;
  if (f.length < fewest) return dense;
  const more: number[] = [];
  for (let k = 0; k < moved.length; k++) {
    const whole = moved[k] / (step * room[k]);
    const ratio = Number.isNaN(whole) ? 0 : Math.min(whole, most);
    if (ratio <= 1) continue;
    const count = clip(Math.ceil(ratio), 2, most);
    for (let i = 1; i < count; i++) more.push(f[k] + ((f[k + 1] - f[k]) * i) / count);
  }
  return more.length ? densified(dense, union(f, Float64Array.from(more)), source) : dense;
}
