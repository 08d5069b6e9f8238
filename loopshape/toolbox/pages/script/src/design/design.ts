// What a person designs: blocks that may be switched off and locked, and what is required; as text and back.

import type { Block, Controller, Kind } from "../numbers/controller";
import { refusal, section, sectionRefusal } from "../numbers/controller";
import { NEW_BLOCKS, parameterRefusal } from "../numbers/forms";
import { limitsOver, MASKED } from "../loop/limits";
import type { Payload, PlantLoop, Requirements } from "../payload";
import { readToml, tomlText, Whole, type Table, type Toml } from "./toml";

export interface DesignBlock extends Block {
  off: boolean;
  locked: string[];
}

/** One loop's design. */
export interface Design extends Omit<Controller, "blocks"> {
  blocks: DesignBlock[];
  requirements: Requirements;
}

/** A block of a design; the coefficients of a section are not shaped by hand. */
export function designBlock({ kind, parameters }: Block): DesignBlock {
  return { kind, parameters: { ...parameters }, off: false, locked: kind === "section" ? Object.keys(parameters) : [] };
}

export function designOf(controller: Controller, requirements: Requirements): Design {
  return { ...controller, blocks: controller.blocks.map(designBlock), requirements: { ...requirements } };
}

/** The controller as it runs: without what is switched off; a gain of 1 where nothing is left. */
export function controllerOf({ requirements: _, ...design }: Design): Controller {
  const blocks = design.blocks.filter((block) => !block.off).map(({ kind, parameters }) => ({ kind, parameters }));
  return { ...design, blocks: blocks.length ? blocks : [{ kind: "gain", parameters: { gain: 1 } }] };
}

/** A new block about a frequency in Hz, which changes little at first. */
export function newBlock(word: string, hz: number): DesignBlock {
  const { kind, parameters } = NEW_BLOCKS[word][1](Number(hz.toPrecision(3)));
  const round = (x: number): number => (kind === "section" ? x : Number(x.toPrecision(3)));
  return designBlock({ kind, parameters: Object.fromEntries(Object.entries(parameters).map(([key, value]) => [key, round(value)])) });
}

function blockTable({ kind, parameters }: Block): Record<string, number | string | Whole> {
  if (kind === "low_pass_1") return { kind: "low_pass", order: new Whole(1), ...parameters };
  if (kind === "low_pass_2") return { kind: "low_pass", order: new Whole(2), ...parameters };
  return { kind, ...parameters };
}

/** The controller file, as Python writes it. */
export function controllerText(designs: Design[], version: string): string {
  const loops = designs.map((design) => {
    const c = controllerOf(design);
    return {
      name: c.loop,
      discretisation: c.discretisation,
      ...(c.prewarp_hz === null ? {} : { prewarp_hz: c.prewarp_hz }),
      ...(c.computation_delay_s ? { computation_delay_s: c.computation_delay_s } : {}),
      ...(c.added_hold ? { added_hold: true } : {}),
      ...(c.precision === "double" ? {} : { precision: c.precision }),
      controller: c.blocks.map(blockTable),
    };
  });
  const top = { format: "loopshape-controllers/1", rate_hz: designs[0].rate_hz };
  return tomlText(top, { notes: { loopshape: version } }, { loop: loops });
}

const WHOLE = ["integrators", "unstable_poles", "order"];

function written(key: string, value: unknown): Toml {
  if (typeof value === "number") return (WHOLE.includes(key) ? new Whole(value) : value) as unknown as Toml;
  if (Array.isArray(value)) return value.map((one) => written(key, one));
  if (typeof value === "object" && value !== null) {
    return Object.fromEntries(Object.entries(value).map(([name, one]) => [name, written(name, one)]));
  }
  return value as Toml;
}

/** The requirements file. */
export function requirementsText(designs: Design[]): string {
  const loops = designs.map(({ requirements: { loop, ...rest } }) => ({ name: loop, ...(written("", rest) as Table) }));
  return tomlText({ format: "loopshape-requirements/1" }, {}, { loop: loops as unknown as Record<string, number>[] });
}

function refuse(words: string): never {
  throw new Error(words);
}

function numberOf(table: Table, key: string, otherwise: number | null): number | null {
  const value = table[key] ?? otherwise;
  return value === null || typeof value === "number" ? value : refuse(`${key} must be a number`);
}

function blockOf(payload: Payload, given: Toml): Block {
  if (typeof given !== "object" || Array.isArray(given)) return refuse("a block is a table with kind and its parameters");
  const { kind: word, order, ...parameters } = given;
  const kind = word === "low_pass" ? `low_pass_${String(order ?? "?")}` : String(word);
  const wanted = Object.hasOwn(payload.blocks, kind) && (word === "low_pass" || order === undefined) ? payload.blocks[kind] : null;
  if (!wanted) return refuse(`a block of kind ${String(word)} is not known: use gain, lead_lag, notch, pi, pid, section, or low_pass with order 1 or 2`);
  const names = Object.keys(parameters);
  if (names.length !== wanted.length || !wanted.every((name) => name in parameters)) {
    return refuse(`a ${kind} block has the parameters ${wanted.join(", ")}, and not ${names.join(", ") || "none"}`);
  }
  for (const name of wanted) {
    const value = parameters[name];
    const why = typeof value === "number" ? parameterRefusal(name, value) : `${name} must be a number`;
    if (why) return refuse(`${why} (${kind} block)`);
  }
  const made = { kind: kind as Kind, parameters: Object.fromEntries(wanted.map((name) => [name, parameters[name] as number])) };
  const why = kind === "section" ? sectionRefusal(section(made)) : null;
  return why ? refuse(why) : made;
}

function loopTables(table: Table, format: string): Table[] {
  if (table.format !== format) refuse(`format must be "${format}", and is ${JSON.stringify(table.format ?? "missing")}`);
  const loops = table.loop;
  if (!Array.isArray(loops) || !loops.length) return refuse("the file has no [[loop]]");
  return loops.map((loop) => (typeof loop === "object" && !Array.isArray(loop) ? loop : refuse("a [[loop]] is a table")));
}

/** The controller of a loop in a file; an Error has the reason. */
function readController(payload: Payload, loop: PlantLoop, table: Table): Controller {
  const own = loopTables(table, "loopshape-controllers/1").find((one) => one.name === loop.name);
  if (!own) return refuse(`the file has no controller of loop ${loop.name}`);
  if (table.rate_hz !== loop.rate_hz) refuse(`the file's rate is ${String(table.rate_hz)} Hz, and this loop runs at ${loop.rate_hz} Hz`);
  if (!Array.isArray(own.controller) || !own.controller.length) return refuse("the loop has no blocks (key controller)");
  const precision = own.precision ?? "double";
  if (typeof precision !== "string" || !/^(double|single|q[1-9]\d?\.[1-9]\d?)$/.test(precision)) {
    return refuse('precision is "double", "single" or fixed point such as "q5.27"');
  }
  const prewarp = numberOf(own, "prewarp_hz", null);
  const delay = numberOf(own, "computation_delay_s", 0) ?? 0;
  if (prewarp !== null && !(prewarp > 0 && prewarp < 0.5 * loop.rate_hz)) refuse("prewarp_hz must lie above 0 and below half the rate");
  if (delay < 0) refuse("computation_delay_s must not be negative");
  const made: Controller = {
    loop: loop.name,
    blocks: own.controller.map((block) => blockOf(payload, block)),
    rate_hz: loop.rate_hz,
    discretisation: "tustin",
    prewarp_hz: prewarp,
    computation_delay_s: delay,
    added_hold: own.added_hold === true,
    precision,
  };
  const why = refusal(made);
  return why ? refuse(why) : made;
}

function readRequirements(payload: Payload, loop: PlantLoop, table: Table): Requirements {
  const own = loopTables(table, "loopshape-requirements/1").find((one) => one.name === loop.name);
  if (!own) return refuse(`the file has no requirements of loop ${loop.name}`);
  const { name: _, masks, at, ...rest } = own;
  for (const limit of payload.limits) {
    const value = rest[limit.name];
    if (value !== undefined && typeof value !== "number") refuse(`${limit.name} must be a number`);
  }
  for (const key of ["integrators", "unstable_poles", "band_hz"]) {
    const fixed = loop.requirements[key];
    if (rest[key] !== undefined && JSON.stringify(rest[key]) !== JSON.stringify(fixed)) {
      refuse(`${key} differs from that of this page, and the plant's lines depend on it: make the page anew with this file`);
    }
  }
  return { ...rest, ...limitsOver({ masks, at }, atPoints(payload)), loop: loop.name };
}

const OF_ALL_POINTS = ["controller_bandwidth_hz", "detuning_percent", ...MASKED];

/** Names of the limits that may differ from operating point to operating point. */
const atPoints = ({ limits }: Payload): string[] => limits.map(({ name }) => name).filter((name) => !OF_ALL_POINTS.includes(name));

/** A design changed by the text of a file, whichever of the two kinds it is. */
export function withFile(payload: Payload, loop: PlantLoop, design: Design, text: string): { design: Design; what: string } {
  const table = readToml(text);
  if (String(table.format).startsWith("loopshape-requirements")) {
    return { design: { ...design, requirements: readRequirements(payload, loop, table) }, what: "requirements" };
  }
  const controller = readController(payload, loop, table);
  return { design: designOf(controller, design.requirements), what: "controller" };
}

/** A design as a word that stands in an address, and back; null where it is none. */
export function addressOf(design: Design): string {
  const bytes = new TextEncoder().encode(JSON.stringify(design));
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

export function fromAddress(word: string, payload: Payload): Design | null {
  try {
    const bytes = Uint8Array.from(atob(word.replaceAll("-", "+").replaceAll("_", "/")), (x) => x.charCodeAt(0));
    const design = JSON.parse(new TextDecoder().decode(bytes)) as Design;
    for (const block of design.blocks) {
      const wanted = payload.blocks[block.kind];
      if (!wanted.every((name) => parameterRefusal(name, block.parameters[name]) === null)) return null;
      if (!Array.isArray(block.locked)) return null;
      if (block.kind === "section" && sectionRefusal(section(block))) return null;
    }
    limitsOver(design.requirements, atPoints(payload));
    return typeof design.requirements.loop === "string" && refusal(controllerOf(design)) === null ? design : null;
  } catch {
    return null;
  }
}

/** Steps back and forth without end; a step that goes on from the last one within a moment is one with it. */
export class History {
  private readonly steps: string[];
  private at = 0;
  private open = false;

  constructor(first: Design) {
    this.steps = [JSON.stringify(first)];
  }

  push(design: Design, goesOn: boolean): void {
    const text = JSON.stringify(design);
    if (text === this.steps[this.at]) return;
    if (goesOn && this.open) this.steps[this.at] = text;
    else {
      this.steps.length = this.at + 1;
      this.steps.push(text);
      this.at += 1;
    }
    this.open = goesOn;
  }

  /** What comes next is a step of its own. */
  close(): void {
    this.open = false;
  }

  move(by: -1 | 1): Design | null {
    if (!this.can(by)) return null;
    this.at += by;
    this.open = false;
    return JSON.parse(this.steps[this.at]) as Design;
  }

  can(by: -1 | 1): boolean {
    return this.at + by >= 0 && this.at + by < this.steps.length;
  }
}
