// What can be taken hold of on the Bode plot: where a block's handle stands, and what dragging it does.

import { blockResponse, type Controller } from "../numbers/controller";
import { db, fromDb } from "../numbers/arrays";
import type { DesignBlock } from "../design/design";
import { numbersOf, parameterRefusal } from "../numbers/forms";

export interface Handle {
  block: number;
  name: string;
  hz: number;
  label: string;
}

/** Handles of blocks that are on, in order. */
export function handlesOf(blocks: DesignBlock[], gainHz: number): Handle[] {
  const out: Handle[] = [];
  blocks.forEach((block, k) => {
    if (block.off) return;
    const p = block.parameters;
    const add = (name: string, hz: number, label: string): number => out.push({ block: k, name, hz, label });
    if (block.kind === "gain") add("gain", gainHz, "K");
    else if (block.kind === "pid") {
      add("fi_hz", p.fi_hz, "I");
      add("fd_hz", p.fd_hz, "D");
      add("ff_hz", p.ff_hz, "F");
    } else if (block.kind === "lead_lag") {
      add("f1_hz", p.f1_hz, "z");
      add("f2_hz", p.f2_hz, "p");
    } else if (block.kind === "notch") add("f1_hz", p.f1_hz, "N");
    else if (block.kind === "section") for (const { name, value } of numbersOf(block, [])) add(name, value, p.d0 ? "H" : "I");
    else add("f_hz", p.f_hz, block.kind === "pi" ? "I" : "L");
  });
  return out;
}

function set(block: DesignBlock, values: Record<string, number>): DesignBlock {
  const parameters = { ...block.parameters };
  for (const [name, value] of Object.entries(values)) {
    if (!block.locked.includes(name) && parameterRefusal(name, value) === null) parameters[name] = value;
  }
  return { ...block, parameters };
}

/** An integrator or a high-pass elsewhere: its coefficients are no numbers to lock. */
function moved(block: DesignBlock, hz: number): DesignBlock {
  const parameters = numbersOf(block, [])[0]?.with(hz);
  return typeof parameters === "object" ? { ...block, parameters } : block;
}

/** A block whose handle was dragged to a frequency, and up by some dB since it was taken hold of at `from`. */
export function dragged(from: DesignBlock, name: string, hz: number, upDb: number): DesignBlock {
  const p = from.parameters;
  if (name === "gain") return set(from, { gain: p.gain * fromDb(upDb) });
  if (from.kind === "notch") {
    const tied = p.f1_hz === p.f2_hz;
    const shift = hz / p.f1_hz;
    return set(from, {
      f1_hz: hz,
      f2_hz: tied || from.locked.includes("f2_hz") ? (tied ? hz : p.f2_hz) : p.f2_hz * shift,
      damping1: p.damping1 * fromDb(upDb),
      ...(!tied && p.damping1 === p.damping2 ? { damping2: p.damping2 * fromDb(upDb) } : {}), // of a complex lead
    });
  }
  if (from.kind === "section") return moved(from, hz);
  if (from.kind === "pid") return set(from, { [name]: hz, gain: p.gain * fromDb(upDb) });
  if (from.kind === "low_pass_2") return set(from, { f_hz: hz, damping: p.damping * fromDb(-upDb) });
  return set(from, { [name]: hz });
}

/** A block widened by a factor: both dampings of a notch, the distance of a lead's corners, a PID's gain, another's damping. */
export function widened(block: DesignBlock, factor: number): DesignBlock {
  const p = block.parameters;
  if (block.kind === "gain" || block.kind === "pid") return set(block, { gain: p.gain * factor });
  if (block.kind === "notch") return set(block, { damping1: p.damping1 * factor, damping2: p.damping2 * factor });
  if (block.kind === "low_pass_2") return set(block, { damping: p.damping * factor });
  if (block.kind === "section") return moved(block, numbersOf(block, [])[0]?.value * factor);
  if (block.kind !== "lead_lag") return set(block, { f_hz: p.f_hz * factor });
  const wider = p.f1_hz < p.f2_hz ? factor : 1 / factor;
  return set(block, { f1_hz: p.f1_hz / wider, f2_hz: p.f2_hz * wider });
}

const isOn = ({ off }: DesignBlock): boolean => !off;

/** Blocks whose response at `hz` is `upDb` larger and turned by `turnDeg`, as far as a lead that is not locked can: its
 * corners move apart or together, and a gain makes up for what that adds. Null where no gain is free. */
export function carried(controller: Controller, blocks: DesignBlock[], hz: number, upDb: number, turnDeg: number): DesignBlock[] | null {
  const gain = blocks.findIndex((block) => isOn(block) && "gain" in block.parameters && !block.locked.includes("gain"));
  if (gain < 0) return null;
  const lead = turnDeg ? blocks.findIndex((block) => isOn(block) && block.kind === "lead_lag" && !block.locked.length) : -1;
  const made = [...blocks];
  let db = upDb;
  if (lead >= 0) {
    const before = costAt(controller, blocks[lead], hz);
    made[lead] = turned(controller, blocks[lead], hz, (before?.deg ?? 0) + turnDeg);
    db -= (costAt(controller, made[lead], hz)?.db ?? 0) - (before?.db ?? 0);
  }
  made[gain] = set(blocks[gain], { gain: blocks[gain].parameters.gain * fromDb(db) });
  return made;
}

/** Factors of the two corners about theirs within which a lead is spread. */
const SPREAD = Math.log(100);

/** A lead or lag spread until it turns by `deg` at a frequency in Hz, or as far as it may. */
function turned(controller: Controller, lead: DesignBlock, hz: number, deg: number): DesignBlock {
  const { f1_hz, f2_hz } = lead.parameters;
  const spread = (by: number): DesignBlock => set(lead, { f1_hz: f1_hz / Math.exp(by), f2_hz: f2_hz * Math.exp(by) });
  let [low, high] = [-SPREAD, SPREAD];
  for (let k = 0; k < 50; k++) {
    const middle = 0.5 * (low + high);
    if ((costAt(controller, spread(middle), hz)?.deg ?? 0) < deg) low = middle;
    else high = middle;
  }
  return spread(0.5 * (low + high));
}

/** What a block adds at a frequency in Hz: degrees and dB. */
export function costAt(controller: Controller, block: DesignBlock, hz: number): { deg: number; db: number } | null {
  if (!(hz > 0 && hz < 0.5 * controller.rate_hz)) return null;
  const one = blockResponse(controller, block, Float64Array.of(hz));
  const size = Math.hypot(one.re[0], one.im[0]);
  return { deg: (Math.atan2(one.im[0], one.re[0]) * 180) / Math.PI, db: db(size) };
}
