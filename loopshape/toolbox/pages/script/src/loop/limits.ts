// Limits over frequency and over operating points (Python: data/limits_over.py, Requirements.of).

import { fromDb, type Real } from "../numbers/arrays";
import type { ReadLimit, Requirements } from "../payload";

/** How far the worst frequency lies beyond all masks of a kind, in the order of the kernel's columns. */
export const MASKED = [
  "sensitivity_mask_db", "complementary_mask_db", "control_mask_db", "process_mask_db", "loop_mask_db", "loop_floor_db",
];
const RESPONSES = ["S", "T", "CS", "PS", "L"];

/** A limit on |response| in dB, straight over ln f between points (Hz, dB), none outside them. */
export interface Mask {
  response: string;
  points: [number, number][];
  sense: "at_most" | "at_least";
}

/** Limits, by their names, that take the place of a loop's others where the operating point lies in all ranges. */
export type AtPoints = Record<string, unknown> & { where: Record<string, [number, number]>; masks?: Mask[] };

export type OperatingPoint = Record<string, number>;

/** What the reading of margins has to know of the requirements at one operating point. */
export interface Reader {
  fromHz: number;
  masks: Mask[];
  limits: ReadLimit[];
  /** Whether an actuator's range is required: what saturates is simulated by `check` alone. */
  ranged: boolean;
}

/** A reader for the requirements at one operating point: of all limits. */
export function readerOf({ control_high_frequency_from_hz: from, masks = [], control_range }: Requirements, limits: ReadLimit[]): Reader {
  return { fromHz: typeof from === "number" ? from : Infinity, masks, limits, ranged: control_range !== undefined };
}

/** Limits on what disturbs the loop. */
export const DISTURBED = ["error_rms", "control_rms", "control_peak", "control_rate"];

/** What is required, and what the page shows of any design. */
export const askedOf = (required: Requirements, limits: ReadLimit[]): ReadLimit[] => limits.filter(({ name }) => typeof required[name] === "number" || SHOWN.includes(name));
const SHOWN = ["modulus_margin", "bandwidth_hz"];

/** Name of the limit that a mask belongs to. */
export const quantityOf = ({ response, sense }: Mask): string =>
  sense === "at_least" ? "loop_floor_db" : MASKED[RESPONSES.indexOf(response)];

/** The limit in dB at frequencies in Hz; outside its points none: Infinity, of a floor -Infinity. */
export function levelDb({ points, sense }: Mask, f: Real): Real {
  const [hz, none] = [points.map(([one]) => Math.log(one)), sense === "at_least" ? -Infinity : Infinity];
  return f.map((one) => {
    const x = Math.log(one);
    if (!(x >= hz[0] && x <= hz[hz.length - 1])) return none;
    const after = Math.max(hz.findIndex((end) => end >= x), 1);
    const share = (x - hz[after - 1]) / (hz[after] - hz[after - 1]);
    return points[after - 1][1] + share * (points[after][1] - points[after - 1][1]);
  });
}

/** What squared magnitudes are multiplied with to be 1 at the sharpest limit, a row a quantity; null without masks. */
export function weights(masks: Mask[], f: Real): Real[] | null {
  if (!masks.length) return null;
  const out = MASKED.map(() => new Float64Array(f.length));
  for (const mask of masks) {
    const row = out[MASKED.indexOf(quantityOf(mask))];
    const sign = mask.sense === "at_least" ? 1 : -1;
    levelDb(mask, f).forEach((level, k) => (row[k] = Math.max(row[k], fromDb(sign * level) ** 2)));
  }
  return out;
}

export const holdsAt = ({ where }: AtPoints, point: OperatingPoint): boolean =>
  Object.entries(where).every(([name, [low, high]]) => low <= point[name] && point[name] <= high);

function replacing(own: Requirements, { where: _, masks = [], ...limits }: AtPoints): Requirements {
  const replaced = masks.map(quantityOf);
  return { ...own, ...limits, masks: [...(own.masks ?? []).filter((mask) => !replaced.includes(quantityOf(mask))), ...masks] };
}

/** What is required at an operating point; where there are masks nothing may exceed them, unless so much is allowed. */
export function requirementsAt({ at = [], ...own }: Requirements, point: OperatingPoint): Requirements {
  const made = at.filter((one) => holdsAt(one, point)).reduce(replacing, own as Requirements);
  const none = Object.fromEntries((made.masks ?? []).map((mask) => [quantityOf(mask), 0]));
  return { ...none, ...made };
}

/** Labels of what is required, at some operating point perhaps, and not judged here. */
export function unjudged({ at = [], ...own }: Requirements, { unread, limits }: { unread: Record<string, string>; limits: ReadLimit[] }, weighted: boolean): string[] {
  const ranged = own.control_range === undefined ? [] : limits.filter(({ name }) => DISTURBED.includes(name)).map(({ name, label }) => [name, label]);
  const names = [...Object.entries(unread), ...ranged].filter(([name]) => (name === "weighted_norm" ? weighted : [own, ...at].some((one) => typeof one[name] === "number")));
  return names.map(([, label]) => label);
}

/** Masks of a response: first those of all operating points, then those of some alone. */
export function masksOn({ masks = [], at = [] }: Requirements, response: string): Mask[] {
  return [...masks, ...at.flatMap((one) => one.masks ?? [])].filter((mask) => mask.response === response);
}

const isPair = (value: unknown): value is [number, number] => Array.isArray(value) && value.length === 2 && value.every(Number.isFinite);

/** A mask of a file; an Error has the reason. */
export function maskOf(given: unknown): Mask {
  const { response, points, sense = "at_most", ...more } = (typeof given === "object" ? given : {}) as Record<string, unknown>;
  if (Object.keys(more).length) throw new Error(`a mask has response, points and perhaps sense, and not ${Object.keys(more).join(", ")}`);
  if (!RESPONSES.includes(response as string)) throw new Error("a mask limits S, T, CS, PS or L (key response)");
  if (sense !== "at_most" && !(sense === "at_least" && response === "L")) throw new Error("the sense of a mask is at_most, of L at_least too");
  const rising = Array.isArray(points) && points.length > 1 && points.every(isPair) && points.every(([hz], k) => hz > (k ? points[k - 1][0] : 0));
  if (!rising) throw new Error(`the points of the mask on |${String(response)}| are two pairs [Hz, dB] at least, with frequencies that rise`);
  return { response: response as string, points: points as [number, number][], sense };
}

const list = (given: unknown): unknown[] => (Array.isArray(given) ? given : []);

function rangesOf(given: unknown): Record<string, [number, number]> {
  const ranges = Object.entries((given ?? {}) as Record<string, unknown>).map(([name, ends]) => {
    const pair = typeof ends === "number" ? [ends, ends] : ends;
    if (!isPair(pair) || pair[0] > pair[1]) throw new Error(`where ${name} of an operating point is a range [low, high]`);
    return [name, pair];
  });
  return Object.fromEntries(ranges) as Record<string, [number, number]>;
}

/** Limits of some operating points, of a file; `known` are the names of limits that may differ from point to point. */
export function atPointsOf(given: unknown, known: string[]): AtPoints {
  const { where, masks, ...limits } = (typeof given === "object" ? given : {}) as Record<string, unknown>;
  const made = { where: rangesOf(where), ...limits, masks: list(masks).map(maskOf) };
  const wrong = Object.entries(limits).find(([name, value]) => !known.includes(name) || typeof value !== "number");
  if (wrong) throw new Error(`at operating points ${wrong[0]} cannot be limited by ${JSON.stringify(wrong[1])}`);
  const count = Object.keys(limits).length + made.masks.length;
  if (!Object.keys(made.where).length || !count) throw new Error("limits at operating points need where and a limit");
  return made;
}

/** Masks and limits of operating points of a file's requirements, read. */
export function limitsOver({ masks, at }: Record<string, unknown>, known: string[]): { masks?: Mask[]; at?: AtPoints[] } {
  const made = { masks: list(masks).map(maskOf), at: list(at).map((one) => atPointsOf(one, known)) };
  return { ...(made.masks.length ? { masks: made.masks } : {}), ...(made.at.length ? { at: made.at } : {}) };
}
