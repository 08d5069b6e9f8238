// Blocks by the names that a person gives them, each of a kind that a controller file has; and their numbers: parameters
// and what follows from them, as a notch's depth and width (Python: data/control/shorthand.py).

import { db, fromDb, TWO_PI } from "./arrays";
import type { Block, Kind } from "./controller";

type Parameters = Record<string, number>;

export const KIND_NAMES: Record<Kind, string> = {
  gain: "gain",
  lead_lag: "lead or lag",
  notch: "notch",
  low_pass_1: "low-pass, order 1",
  low_pass_2: "low-pass, order 2",
  pi: "PI (integrator)",
  pid: "PID",
  section: "section",
};

const PARAMETER_NAMES: Record<string, string> = {
  gain: "gain",
  f_hz: "corner [Hz]",
  f1_hz: "zero [Hz]",
  f2_hz: "pole [Hz]",
  fi_hz: "integral corner [Hz]",
  fd_hz: "derivative corner [Hz]",
  ff_hz: "filter corner [Hz]",
  damping: "damping",
  damping1: "zero damping",
  damping2: "pole damping",
};

/** A section of first order: (n0 + n1 s)/(d0 + d1 s), s in rad/s. */
const firstOrder = (n0: number, n1: number, d0: number, d1: number): Block => ({ kind: "section", parameters: { n0, n1, n2: 0, d0, d1, d2: 0 } });
const integrator = (hz: number): Block => firstOrder(TWO_PI * hz, 0, 0, 1);
const highPass = (hz: number): Block => firstOrder(0, 1 / (TWO_PI * hz), 1, 1 / (TWO_PI * hz));

const of = (kind: Kind, parameters: Parameters): Block => ({ kind, parameters });

/** What the page adds, about a frequency in Hz: by the word of its choice, its name, and the block. */
export const NEW_BLOCKS: Record<string, [string, (hz: number) => Block]> = {
  gain: [KIND_NAMES.gain, () => of("gain", { gain: 1 })],
  lead_lag: [KIND_NAMES.lead_lag, (hz) => of("lead_lag", { f1_hz: hz / 3, f2_hz: hz * 3 })],
  complex_lead: ["complex lead", (hz) => of("notch", { f1_hz: hz / 2, f2_hz: hz * 2, damping1: 0.5, damping2: 0.5 })],
  notch: [KIND_NAMES.notch, (hz) => of("notch", { f1_hz: hz, f2_hz: hz, damping1: 0.1, damping2: 0.5 })],
  resonator: ["resonator", (hz) => of("notch", { f1_hz: hz / 5, f2_hz: hz / 5, damping1: 0.2, damping2: 0.1 })],
  low_pass_1: [KIND_NAMES.low_pass_1, (hz) => of("low_pass_1", { f_hz: 5 * hz })],
  low_pass_2: [KIND_NAMES.low_pass_2, (hz) => of("low_pass_2", { f_hz: 5 * hz, damping: 0.7 })],
  high_pass: ["high-pass", (hz) => highPass(hz / 10)],
  integrator: ["integrator", integrator],
  pi: [KIND_NAMES.pi, (hz) => of("pi", { f_hz: hz / 10 })],
  pid: [KIND_NAMES.pid, (hz) => of("pid", { gain: 1, fi_hz: hz / 10, fd_hz: 2 * hz, ff_hz: 10 * hz })],
};

const isIntegrator = ({ n0, n1, n2, d0, d1, d2 }: Parameters): boolean => n0 > 0 && d1 === 1 && !n1 && !n2 && !d0 && !d2;
const isHighPass = ({ n0, n1, n2, d0, d1, d2 }: Parameters): boolean => n1 > 0 && n1 === d1 && d0 === 1 && !n0 && !n2 && !d2;

/** Name of a block by what it is. */
export function nameOf({ kind, parameters: p }: Block): string {
  if (kind === "section") return isIntegrator(p) ? "integrator" : isHighPass(p) ? "high-pass" : KIND_NAMES.section;
  if (kind !== "notch") return KIND_NAMES[kind];
  if (p.f1_hz === p.f2_hz) return p.damping1 > p.damping2 ? "resonator" : KIND_NAMES.notch;
  return p.damping1 !== p.damping2 ? KIND_NAMES.notch : p.f1_hz < p.f2_hz ? "complex lead" : "complex lag";
}

/** A number of a block: a parameter, or what `of` parameters follows; where one of these is locked it cannot be typed. */
export interface BlockNumber {
  name: string;
  label: string;
  of: string[];
  value: number;
  /** The parameters with another value, or in words why not. */
  with(value: number): Parameters | string;
}

/** Numbers of a block, in order; `locked` parameters stay where others that are equal to them are typed. */
export function numbersOf({ kind, parameters: p }: Block, locked: string[]): BlockNumber[] {
  if (kind === "section") {
    const [hz, made] = isIntegrator(p) ? [p.n0 / TWO_PI, integrator] : [1 / (TWO_PI * p.n1), highPass];
    if (!isIntegrator(p) && !isHighPass(p)) return [];
    const label = isIntegrator(p) ? "0 dB at [Hz]" : PARAMETER_NAMES.f_hz;
    return [{ name: "f_hz", label, of: [], value: hz, with: (value) => parameterRefusal("f_hz", value) ?? made(value).parameters }];
  }
  const own = Object.keys(p).map((name): BlockNumber => ({
    name, label: PARAMETER_NAMES[name], of: [name], value: p[name],
    with: (value) => parameterRefusal(name, value) ?? { ...p, [name]: value, ...tied(kind, p, name, value, locked) },
  }));
  const ratio = p.damping1 / p.damping2;
  if (kind !== "notch" || p.f1_hz !== p.f2_hz || !(ratio < Math.SQRT1_2)) return own;
  const dampings = ["damping1", "damping2"];
  const width = 2 * p.f1_hz * p.damping2 * Math.sqrt(1 - 2 * ratio ** 2);
  const notch = (wide: number, deep: number): Parameters => {
    const damping2 = wide / (2 * p.f1_hz * Math.sqrt(1 - 2 * deep ** 2));
    return { ...p, damping1: deep * damping2, damping2 };
  };
  return [
    ...own,
    {
      name: "depth_db", label: "depth [dB]", of: dampings, value: -db(ratio),
      with: (value) => (fromDb(-value) < Math.SQRT1_2 ? notch(width, fromDb(-value)) : refused("depth [dB]", value, "must be above 3.01", "use a smaller pole damping for a flat one")),
    },
    { name: "width_hz", label: "width at −3 dB [Hz]", of: dampings, value: width, with: (value) => parameterRefusal("width_hz", value) ?? notch(value, ratio) },
  ];
}

/** What goes with a parameter: the second frequency of a notch where both are equal, else the second damping. */
function tied(kind: Kind, p: Parameters, name: string, value: number, locked: string[]): Parameters {
  const goes = (one: string, other: string): boolean => kind === "notch" && name === one && p[one] === p[other] && !locked.includes(other);
  if (goes("f1_hz", "f2_hz")) return { f2_hz: value };
  return goes("damping1", "damping2") && p.f1_hz !== p.f2_hz ? { damping2: value } : {};
}

const refused = (what: string, value: number, why: string, way: string): string => `${what} ${why}; received ${value}; ${way}`;

/** Why a parameter may not have a value, in words: what, received, way out; null where it may. */
export function parameterRefusal(name: string, value: number): string | null {
  const label = PARAMETER_NAMES[name] ?? (name === "width_hz" ? "width at −3 dB [Hz]" : name);
  if (!Number.isFinite(value)) return refused(label, value, "must be a number", "write digits, as 12.5");
  const largest = name.endsWith("_hz") ? 1e9 : 1e100;
  if (Math.abs(value) > largest) return refused(label, value, `is too large: it must not exceed ${largest} in magnitude`, "check its unit");
  if (name === "gain" || /^[nd]\d$/.test(name) || value > 0 || (name === "damping1" && value === 0)) return null;
  return refused(label, value, "must be positive", "give a number above 0");
}
