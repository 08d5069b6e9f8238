// What disturbed a loop when it was recorded, under another controller: rms of error and plant input, the input's peak and
// rate, with 95 % intervals (Python: loop/margin/disturbed.py, without `control_range`).

import { clip, placeIn, TWO_PI, zeros, type Complex, type Real } from "../numbers/arrays";
import { response, type Controller } from "../numbers/controller";
import { fromLines, transform } from "../numbers/fourier";
import { Normals, type State } from "../numbers/random";
import { gammaInverse, normalAbove } from "../numbers/special";

/** Power of the error on its lines under the old controller and its variance, and the plant there; of the plant's own
 * lines the frequencies, the relative variance and the last value. */
export interface Disturbance {
  f: Real;
  power: Real;
  scatter: Real;
  P: Complex;
  recorded_under: Controller | null;
  own_hz: Real;
  variance: Real;
  last: [number, number];
  overlap: number;
  rms: number;
  /** Samples that a peak belongs to; null where no length is known. */
  samples: number | null;
  /** The recorded error times 1 + C0 P on the lines of so many samples, with the plant there where it is another. */
  record: { count: number; error: Complex; P: Complex | null } | null;
}

/** The old controller on the lines, and the line of the plant below each, with its share of ln P there. */
interface Before {
  C0: Complex;
  line: Int32Array;
  share: Real;
}

const befores = new WeakMap<Complex, Before>();

function beforeOf({ f, P, recorded_under, own_hz }: Disturbance): Before {
  const known = befores.get(P);
  if (known) return known;
  const C0 = recorded_under ? response(recorded_under, f) : zeros(f.length);
  const line = Int32Array.from(f, (hz) => clip(placeIn(own_hz, hz, true) - 1, 0, own_hz.length - 2));
  const share = f.map((hz, k) => clip(Math.log(own_hz[line[k] + 1] / hz) / Math.log(own_hz[line[k] + 1] / own_hz[line[k]]), 0, 1));
  befores.set(P, { C0, line, share });
  return { C0, line, share };
}

/** Numbers of Python's tolerances, and the state of its generator. */
export interface RecordConstants {
  parts: number;
  surrogates: number;
  bursts: number;
  unlike: number;
  largest: number;
  alone: number;
  normal_95: number;
  random: State;
}

/** Rms of the error and of the plant's input. */
export interface Rms {
  error: number;
  control: number;
}

export type Disturbed = Record<string, { value: number; interval: [number, number] }>;

interface Power {
  mean: number;
  rms: [number, number, number];
}

const abs2 = (z: Complex, k: number): number => z.re[k] ** 2 + z.im[k] ** 2;
const awayOf = (C: Complex, P: Complex, k: number): [number, number] => [1 + C.re[k] * P.re[k] - C.im[k] * P.im[k], C.re[k] * P.im[k] + C.im[k] * P.re[k]];
const sizeOf = ([x, y]: [number, number]): number => x * x + y * y;

/** Power of the error on each line under a controller, freed of what the plant's noise adds, with all that intervals ask. */
class Carried {
  readonly C: Complex;
  readonly kept: Real;

  constructor(readonly known: Disturbance, controller: Controller) {
    const { f, power, P, variance } = known;
    const { C0, line, share } = beforeOf(known);
    this.C = response(controller, f);
    this.kept = power.map((one, k) => {
      const [before, after] = [sizeOf(awayOf(C0, P, k)), sizeOf(awayOf(this.C, P, k))];
      const moved = (abs2(P, k) * ((C0.re[k] - this.C.re[k]) ** 2 + (C0.im[k] - this.C.im[k]) ** 2)) / after;
      const bias = share[k] ** 2 * variance[line[k]] + (1 - share[k]) ** 2 * variance[line[k] + 1];
      return one * Math.max((before - moved * bias) / after, 0);
    });
  }

  mean(weight: Real): number {
    return this.kept.reduce((sum, one, k) => sum + weight[k] * one, 0);
  }

  /** Mean square through a filter of squared magnitude `weight` and its interval; it scatters `bursts` times. With none
   * the estimate alone. */
  through(weight: Real, bursts: number | null): Power {
    if (bursts === null) {
      const own = this.mean(weight);
      return { mean: own, rms: [Math.sqrt(own), Math.sqrt(own), Math.sqrt(own)] };
    }
    const { f, power, scatter, P, own_hz, variance, last, overlap } = this.known;
    const { C0, line, share } = beforeOf(this.known);
    const [re, im] = [new Float64Array(variance.length), new Float64Array(variance.length)];
    let [spread, before, flat, kept] = [0, 0, 0, 0];
    const end = { re: Float64Array.of(last[0]), im: Float64Array.of(last[1]) };
    for (let k = 0; k < f.length; k++) {
      const [old, now] = [awayOf(C0, P, k), awayOf(this.C, P, k)];
      const [was, is] = [sizeOf(old), sizeOf(now)];
      // conj(old/now) P (C0 - C1)/now² by a relative error of P
      const [dx, dy] = [C0.re[k] - this.C.re[k], C0.im[k] - this.C.im[k]];
      const [px, py] = [P.re[k] * dx - P.im[k] * dy, P.re[k] * dy + P.im[k] * dx];
      const [qx, qy] = [px * old[0] + py * old[1], py * old[0] - px * old[1]];
      const pull = (weight[k] * power[k]) / (is * is);
      const [x, y] = [pull * (qx * now[0] + qy * now[1]), pull * (qy * now[0] - qx * now[1])];
      for (const [place, part] of [[line[k], share[k]], [line[k] + 1, 1 - share[k]]]) [re[place], im[place]] = [re[place] + part * x, im[place] + part * y];
      spread += scatter[k] * (was / is) ** 2 * weight[k] ** 2;
      if (f[k] <= own_hz[own_hz.length - 1]) continue;
      const one = (C: Complex): number => sizeOf(awayOf({ re: C.re.subarray(k, k + 1), im: C.im.subarray(k, k + 1) }, end, 0));
      before += weight[k] * power[k];
      flat += (weight[k] * power[k] * one(C0)) / one(this.C);
      kept += weight[k] * this.kept[k];
    }
    const mean = this.mean(weight);
    const pulled = variance.reduce((sum, one, k) => sum + one * (re[k] ** 2 + im[k] ** 2), 0);
    const [low, high] = rmsInterval(mean, 2 * overlap * pulled + bursts * spread);
    const apart = [before - kept, flat - kept];
    return { mean, rms: [Math.sqrt(mean), Math.sqrt(Math.max(low ** 2 + Math.min(0, ...apart), 0)), Math.sqrt(high ** 2 + Math.max(0, ...apart))] };
  }
}

/** 95 % interval of a rms, from the mean square and its variance, as that of chi square with their ratio. */
function rmsInterval(power: number, variance: number): [number, number] {
  if (power <= 0 || variance <= 0) return [Math.sqrt(Math.max(power, 0)), Math.sqrt(Math.max(power, 0))];
  const half = power ** 2 / variance;
  return [0.975, 0.025].map((level) => Math.sqrt((power * half) / gammaInverse(half, level))) as [number, number];
}

const lastCarried = new WeakMap<Complex, { controller: Controller; carried: Carried }>();

function carriedUnder(known: Disturbance, controller: Controller): Carried {
  const last = lastCarried.get(known.P);
  if (last?.controller === controller) return last.carried;
  const carried = new Carried(known, controller);
  lastCarried.set(known.P, { controller, carried });
  return carried;
}

/** What a stable loop makes of it under a controller. */
export function rmsUnder(known: Disturbance, controller: Controller): Rms {
  const carried = carriedUnder(known, controller);
  const control = known.f.map((_, k) => abs2(carried.C, k));
  return { error: Math.sqrt(carried.mean(known.f.map(() => 1))), control: Math.sqrt(carried.mean(control)) };
}

/** What is asked about of it: rms, and the input's peak and rate, with intervals; estimates leave out how a record differs
 * from noise. */
export function disturbedUnder(known: Disturbance, controller: Controller, c: RecordConstants, asked: string[], whole: boolean): Disturbed {
  const { f, samples } = known;
  const { rate_hz } = controller;
  const carried = carriedUnder(known, controller);
  const control = f.map((_, k) => abs2(carried.C, k));
  const faster = f.map((hz) => (2 * rate_hz * Math.sin((Math.PI * hz) / rate_hz)) ** 2);
  const own = recorded(whole ? known.record : null, known.P, controller);
  const rates = own.control.subarray(1).map((value, k) => (value - own.control[k]) * rate_hz);
  const weights = [f.map(() => 1), control, control.map((x, k) => x * faster[k]), control.map((x, k) => x * faster[k] ** 2)];
  const signals = [own.error, own.control, rates];
  const bursts = once((k) => (whole ? burstsOf(signals[k], c) : 1));
  const power = once((k) => carried.through(weights[k], whole ? (k < 3 ? bursts(k) : 1) : null));
  const peak = (k: number): Disturbed[string] => peakOf(power(k), power(k + 1), samples as number, rate_hz, signals[k], bursts(k), c);
  const ways: Record<string, () => Disturbed[string]> = {
    error_rms: () => ofRms(power(0)), control_rms: () => ofRms(power(1)),
    ...(samples ? { control_peak: () => peak(1), control_rate: () => peak(2) } : {}),
  };
  return Object.fromEntries(asked.filter((name) => name in ways).map((name) => [name, ways[name]()]));
}

function once<T>(make: (k: number) => T): (k: number) => T {
  const made: T[] = [];
  return (k) => (made[k] ??= make(k));
}

const ofRms = ({ rms: [value, low, high] }: Power): Disturbed[string] => ({ value, interval: [low, high] });

/** The recorded disturbance under a controller, without the ends of the record, which transforms join. */
function recorded(record: Disturbance["record"], onLines: Complex, controller: Controller): { error: Real; control: Real } {
  if (!record) return { error: new Float64Array(0), control: new Float64Array(0) };
  const { count: n, error } = record;
  const P = record.P ?? onLines;
  const f = error.re.map((_, k) => ((k + 1) * controller.rate_hz) / n);
  const C = response(controller, f);
  const [made, driven] = [zeros(n / 2 + 1), zeros(n / 2 + 1)];
  for (let k = 0; k < f.length; k++) {
    const now = awayOf(C, P, k);
    const size = sizeOf(now);
    const [x, y] = [(error.re[k] * now[0] + error.im[k] * now[1]) / size, (error.im[k] * now[0] - error.re[k] * now[1]) / size];
    [made.re[k + 1], made.im[k + 1]] = [x, y];
    [driven.re[k + 1], driven.im[k + 1]] = [x * C.re[k] - y * C.im[k], x * C.im[k] + y * C.re[k]];
  }
  const edge = Math.floor(0.1 * n);
  const [own, control] = fromLines(made, driven).map((signal) => signal.subarray(edge, n - edge));
  return { error: own, control };
}

const turns = new Map<string, Complex>();

/** Turns of surrogates' lines at random, the same each time. */
function turnsOf(count: number, random: State): Complex {
  const key = `${count} ${random.state}`;
  const known = turns.get(key);
  if (known) return known;
  const source = new Normals(random);
  const made = { re: new Float64Array(count), im: new Float64Array(count) };
  for (let k = 0; k < count; k++) {
    const turn = TWO_PI * source.uniform();
    [made.re[k], made.im[k]] = [Math.cos(turn), Math.sin(turn)];
  }
  turns.set(key, made);
  return made;
}

/** How many times as much the mean square of a signal scatters as that of noise with its spectrum; 1 at least. */
function burstsOf(signal: Real, { parts, surrogates, bursts, random }: RecordConstants): number {
  const n = Math.floor(signal.length / (2 * parts)) * 2 * parts;
  if (n < 8 * parts) return 1;
  const whole = transform(signal.subarray(0, n), new Float64Array(n));
  const lines = n / 2 + 1;
  const size = Float64Array.from({ length: lines }, (_, k) => Math.sqrt(abs2(whole, k)));
  const { re, im } = turnsOf((surrogates + (surrogates % 2)) * lines, random);
  const drawn = (d: number): Complex => ({ re: size.map((x, k) => x * re[d * lines + k]), im: size.map((x, k) => x * im[d * lines + k]) });
  const noise: number[] = []; // two at a time
  for (let d = 0; d < surrogates; d += 2) noise.push(...fromLines(drawn(d), drawn(d + 1)).map((signal) => scatterOf(signal, parts)));
  noise.length = surrogates;
  const ratio = scatterOf(signal.subarray(0, n), parts) / Math.max(noise.reduce((a, b) => a + b, 0) / surrogates, 1e-300);
  return ratio > bursts ? ratio : 1;
}

function scatterOf(signal: Real, parts: number): number {
  const each = partsOf(signal, parts).map((part) => part.reduce((sum, x) => sum + x * x, 0) / part.length);
  const mean = each.reduce((a, b) => a + b, 0) / parts;
  return each.reduce((sum, x) => sum + (x - mean) ** 2, 0) / parts;
}

function partsOf(signal: Real, parts: number): Real[] {
  const length = Math.floor(signal.length / parts);
  return Array.from({ length: parts }, (_, k) => signal.subarray(k * length, (k + 1) * length));
}

const largestOf = (signal: Real): number => signal.reduce((most, x) => Math.max(most, Math.abs(x)), 0);

/** The largest |value| of a record of so many samples at 2.5, 50 and 97.5 %, by the largest of its blocks. */
function largestOfBlocks(signal: Real, samples: number, { parts, largest: tail, alone, normal_95 }: RecordConstants): number[] {
  const found = Float64Array.from(partsOf(signal, parts), largestOf).sort();
  const [threshold, most] = [found[parts - tail - 1], found[parts - 1]];
  const scale = found.subarray(-tail).reduce((a, b) => a + b, 0) / tail - threshold;
  const away = [0.025, 0.5, 0.975].map((level) => scale * Math.log((tail * samples) / signal.length / -Math.log(level)));
  const apart = away.map((one) => Math.hypot(one - away[1], (normal_95 * away[1]) / Math.sqrt(tail)));
  const ends = apart.map((one, k) => Math.max(threshold + away[1] + (k - 1) * one, 1e-9 * Math.max(most, 1e-300)));
  return most > alone * ends[1] ? ends.map((one) => (one * most) / ends[1]) : ends;
}

/** The largest |value| over the rms that Gaussian noise stays below with a probability, in a record of samples. */
function largest(crossings: number, samples: number, level: number): number {
  const rare = -Math.log(level);
  const byCrossings = Math.sqrt(2 * Math.log(Math.max((2 * crossings) / rare, 1)));
  const [one, every] = [1, Math.max(samples, 1)].map((n) => normalAbove(-0.5 * Math.expm1(-rare / n)));
  return Math.min(Math.max(byCrossings, one), every);
}

/** The largest |value| of a signal in a record as long as the disturbance's, and where another record's may lie. */
function peakOf(power: Power, faster: Power, samples: number, rate_hz: number, own: Real, bursts: number, c: RecordConstants): Disturbed[string] {
  const { mean, rms } = power;
  if (rms[0] <= 0) return { value: 0, interval: [0, 0] };
  const crossings = (samples * Math.acos(Math.min(Math.max(1 - (0.5 * faster.mean) / (rate_hz ** 2 * mean), -1), 1))) / TWO_PI;
  const levels = [0.001, 0.025, 0.5, 0.975, 0.999].map((level) => Math.max(largest(crossings, samples, level), 1e-9));
  const most = largestOf(own);
  const isUsual = most === 0 || (levels[0] * rms[0] <= most && most <= levels[4] * rms[0]);
  const [less, middle, more] = isUsual && bursts < c.unlike ? levels.slice(1, 4).map((level) => rms[0] * level) : largestOfBlocks(own, samples, c);
  const [below, above] = [Math.log(rms[0] / Math.max(rms[1], 1e-9 * rms[0])), Math.log(rms[2] / rms[0])];
  return {
    value: middle,
    interval: [middle * Math.exp(-Math.hypot(Math.log(middle / less), below)), middle * Math.exp(Math.hypot(Math.log(more / middle), above))],
  };
}
