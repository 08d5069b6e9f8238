// What Python puts into a report: curves of operating points, their 95 % half widths, and where requirements are worst.

import { db, times, type Real } from "../numbers/arrays";
import type { Limit, Requirements } from "../payload";
import type { Curve } from "./plot";
import { nicholsCurve, nicholsPlaces, responseOf, sizeDb, type Response, type Trace } from "./views";

type Banded = "P" | "S" | "T";

/** Whose relative error a response has: its own factor on that of P, to first order. */
const BAND_OF: Record<Response, Banded> = { P: "P", L: "P", C: "P", S: "S", CS: "S", T: "T", PS: "T" };

/** An operating point: its responses on chosen lines, phases that go on over all of them, and P as it was measured. */
export interface Point extends Trace {
  label: string;
  phase: { P: Real; L: Real };
  half_width: Record<Banded, Real>;
  dots: { f: Real; size: Real; phase: Real };
}

/** Where a requirement is worst: on which plot, of which operating point. */
export interface Ring {
  plot: string;
  point: number;
  hz: number;
  outcome: string;
}

export interface NearestPoint {
  point: number;
  line: number;
}

export interface RawReport {
  limits: Limit[];
  bands_at_once: number;
  loops: { points: RawPoint[]; requirements: Requirements | null; rings: Ring[] }[];
}

type RawPoint = Omit<Point, "L">;

export const pointOf = (raw: RawPoint): Point => ({ ...raw, L: raw.C.re.length ? times(raw.P, raw.C) : raw.C });

/** What a plot shows of one operating point: a place for each line, the curve, ends of its band, and words for a line. */
export interface View {
  places: Curve;
  curve: Curve;
  low: Real | null;
  high: Real | null;
  dots: Curve;
  words: (line: number) => string[];
}

const NOTHING: Curve = { x: [], y: [] };

export function viewOf(point: Point, name: Response, kind: string): View {
  if (kind === "nichols") {
    const words = (k: number): string[] => [magnitudeWords(point, "L", k), phaseWords(point, "L", k)];
    return { places: nicholsPlaces(point.L), curve: nicholsCurve(point.L), low: null, high: null, dots: NOTHING, words };
  }
  const { f, dots } = point;
  const [y, measured] = kind === "deg" ? [point.phase[name as "P" | "L"], dots.phase] : [sizeOf(point, name), dots.size];
  const places = { x: f, y };
  const [low, high] = kind === "deg" ? phaseBand(y, point.half_width.P) : sizeBand(y, point.half_width[BAND_OF[name]]);
  const words = (k: number): string[] => [kind === "deg" ? phaseWords(point, name, k) : magnitudeWords(point, name, k)];
  return { places, curve: places, low, high, dots: name === "P" ? { x: dots.f, y: measured } : NOTHING, words };
}

const sizeOf = (point: Point, name: Response): Real => sizeDb(responseOf(point, name));

/** Ends of the band of a magnitude in dB with a relative half width; the lower is -inf where zero lies within it. */
function sizeBand(size: Real, half_width: Real): [Real, Real] {
  return [size.map((x, k) => x + db(Math.max(1 - half_width[k], 0))), size.map((x, k) => x + db(1 + half_width[k]))];
}

/** Half width of a phase band in degrees; 180 where the band of the response holds zero. */
const phaseHalfWidth = (relative: number): number => (relative < 1 ? (Math.asin(relative) * 180) / Math.PI : 180);

function phaseBand(phase: Real, half_width: Real): [Real, Real] {
  return [phase.map((x, k) => x - phaseHalfWidth(half_width[k])), phase.map((x, k) => x + phaseHalfWidth(half_width[k]))];
}

function shown(value: number, decimals: number): string {
  if (!Number.isFinite(value)) return value < 0 ? "−∞" : "–";
  return value.toFixed(decimals).replace("-", "−");
}

/** Magnitude of a response on one line with its 95 % band. */
export function magnitudeWords(point: Point, name: Response, k: number): string {
  const z = responseOf({ ...point, ...one(point, k) }, name);
  const size = sizeDb(z);
  const [low, high] = sizeBand(size, point.half_width[BAND_OF[name]].subarray(k, k + 1));
  return Number.isFinite(size[0]) ? `${shown(size[0], 2)} dB (${shown(low[0], 2)} … ${shown(high[0], 2)})` : "–";
}

function one({ f, P, C, L }: Trace, k: number): Pick<Trace, "f" | "P" | "C" | "L"> {
  const cut = (z: { re: Real; im: Real }) => ({ re: z.re.subarray(k, k + 1), im: z.im.subarray(k, k + 1) });
  return { f: f.subarray(k, k + 1), P: cut(P), C: cut(C), L: cut(L) };
}

export function phaseWords({ phase, half_width }: Point, name: Response, k: number): string {
  return `${shown(phase[name as "P" | "L"][k], 1)} deg (±${shown(phaseHalfWidth(half_width.P[k]), 1)})`;
}
