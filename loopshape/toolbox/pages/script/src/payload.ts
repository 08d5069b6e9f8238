// What Python puts into the page: the measured plants, what their draws are made from, and all constants by name.

import { unpacked, type Complex, type Real } from "./numbers/arrays";
import type { Controller } from "./numbers/controller";
import type { AtPoints, Mask, OperatingPoint } from "./loop/limits";
import type { Disturbance, RecordConstants } from "./loop/disturbed";
import type { State } from "./numbers/random";

export interface Limit {
  name: string;
  sense: "at_least" | "at_most";
  unit: string;
  label: string;
  /** The response on which its worst place is marked. */
  plot: string;
}

/** A row of the table of limits that the page reads itself (Python: Limit). */
export interface ReadLimit extends Limit {
  /** The kernel's column, null of what is read elsewhere, and its scale. */
  column: number | null;
  scale: "plain" | "ln" | "inverse";
  ceiling: number | null;
  distance: number;
  asked: boolean;
  crossing: boolean;
  open: boolean;
}

/** Numbers of the Python modules, under their names there. */
export interface Constants {
  half_width: number;
  radius_95: number;
  between: number;
  fewest: number;
  lowest: number;
  steepest: number;
  degree: number;
  step: number;
  small: number;
  far_below: number;
  most: number;
  wide: number;
  sharpest: number;
  fit_deg: number;
  wrong: number;
  uncertain_ratio: number;
  on_it: number;
  /** Of resonances close together and of lines that scatter (Python: loop/obstacles.py, loop/between.py). */
  peak: number;
  scatter: number;
  far: number;
  rounds: number;
  hole_fewest: number;
  hole_apart: number;
  hole_turn: number;
  hole_far: number;
  places: number[];
  path_half_widths: number[];
  draws: number;
  below_ratios: number[];
  /** Of what lies below the first line, and of holes (Python: loop/low_end.py, loop/holes.py). */
  extrapolated_below: number;
  agree: number;
  large: number;
  at_zero: number;
  same: number;
  least_damping: number;
  poor_damping: number;
  detuning: {
    searched: number;
    warned: number;
    coarse: number;
    fine: number;
    finest: number;
    outer: number[];
    fewer: number[];
    steps: number;
    finest_step: number;
    rounding: number;
    draws: number;
    half_width: number;
    matters: number;
    near: number[];
  };
  step_response: StepConstants;
  record: RecordConstants;
}

export interface StepConstants {
  small: number;
  flat: number;
  longest: number;
}

export type Requirements = Record<string, unknown> & { loop: string; masks?: Mask[]; at?: AtPoints[] };

/** A model fitted to an operating point, num(s)/den(s) exp(-s delay) in descending powers, and how well it does. */
export interface FitModel {
  structure: string;
  misfit_db: number;
  sufficient: boolean;
  num: number[];
  den: number[];
  delay_s: number;
}

/** A resonance of the plant: frequency in Hz, damping, the height of its peak, and r and z of r/(j (f - z)) and its mirror. */
export interface Seen {
  hz: number;
  damping: number;
  peak: number;
  pole: [number, number];
  residue: [number, number];
}

/** Lines `low` .. `high` that resonances close together explain, in each of some `ways`: poles over a polynomial in ln f. */
export interface ModeCluster {
  low: number;
  high: number;
  /** Largest residual of its lines from a polynomial. */
  polynomial_residual: number;
  left: "noise" | "more" | "scatter";
  delay_s: number;
  power: [number, number];
  middle_hz: number;
  ways: number;
  /** One way after the other. */
  poles: Complex;
  residues: Complex;
  polynomials: Complex;
  /** Largest residue in each gap that may hide there besides. */
  hidden: Real;
}

export interface Term {
  residue: [number, number];
  pole: [number, number];
  first: number;
  influence: Complex;
}

/** A small model's response below the first line, and what errors of the lowest lines do to its coefficients. */
export interface ExtrapolatedModel {
  P: Complex;
  slopes: Complex;
  influence: Real;
  lines: number;
}

/** Two frequencies between which lines are missing or too uncertain, the plant at both, and what may hide there. */
export interface Gap {
  hz: [number, number];
  P: [[number, number], [number, number]];
  residue: number;
  missing: boolean;
}

export interface Hidden {
  low_hz: number;
  high_hz: number;
  centre_hz: number;
  /** Largest height that the lines allow it. */
  peak: number;
}

/** One operating point: a measured plant, smoothed, and everything that does not depend on the controller. */
export interface Point {
  name: string;
  operating_point: OperatingPoint;
  f: Real;
  P: Complex;
  raw: Complex;
  variance: Real;
  halves: Uint8Array;
  taps: number[];
  terms: Term[];
  integrators: number | null;
  unstable_poles: number | null;
  fitted_f: Real;
  fitted: Complex;
  fitted_poles: [number, number][];
  below_f: Real;
  below: Complex[];
  extrapolated: ExtrapolatedModel[];
  simple: boolean;
  /** Sign of k, as the plant goes as k/s^n towards 0 Hz, 0 where it is not known; whether a model knows it. */
  sign: number;
  knows_sign: boolean;
  order: [number, number, number];
  gaps: Gap[];
  above_band: { f: Real; P: Complex; half_width: Real; known: boolean[] } | null;
  clusters: ModeCluster[];
  /** Gaps about which lines scatter, and how far from its lines P may come in each gap, where that matters. */
  scattered: number[];
  interpolation_residual: Real | null;
  resonances: Seen[];
  fit: FitModel | null;
  hidden: Hidden[];
  /** What disturbed the loop there, where the page was given it. */
  disturbed: Disturbance | null;
}

/** Python's verdict on the controller that the page was made with. */
export interface Certificate {
  outcome: string;
}

export interface PlantLoop {
  name: string;
  rate_hz: number;
  requirements: Requirements;
  controller: Controller;
  points: Point[];
  /** Controllers of the plant's other loops, closed while this one is shaped. */
  closed: Controller[];
  certificate: Certificate | null;
  notes: string[];
  /** Whether a norm of the weighted loop is required, which the page leaves out. */
  weighted: boolean;
}

export interface Payload {
  format: string;
  version: string;
  title: string;
  limits: ReadLimit[];
  /** Labels of the limits that `check` alone judges, by their names. */
  unread: Record<string, string>;
  blocks: Record<string, string[]>;
  constants: Constants;
  random: { smoothing: State; between: State };
  loops: PlantLoop[];
  served: boolean;
  /** What tells the content of the server's file from any other, as it was when this page was loaded or saved it. */
  saved: string;
}

/** The same as it stands in the page. */
export interface Raw {
  loops: { points: unknown[] }[];
}

export const payloadOf = (raw: Raw): Payload => unpacked(raw) as Payload;
