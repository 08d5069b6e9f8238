// The table of requirements: what is required, the worst case with its interval, slack and verdict; and stability.

import { button, el, numberField, shown, setField } from "./dom";
import { MASKED, requirementsAt } from "./loop/limits";
import type { Margins } from "./loop/margins";
import { STABILITY, worstReading, type DetuningReading } from "./loop/detuning";
import type { Limit, Requirements } from "./payload";
import type { Verdict, Outcome, Row } from "./loop/verdict";
import type { Stage } from "./work";

export const OUTCOMES: Record<Outcome, [string, string]> = {
  passed: ["✓", "passed"],
  failed: ["✗", "failed"],
  undecided: ["?", "undecided"],
};

export function badge(outcome: Outcome | null): HTMLElement {
  const [sign, word] = outcome ? OUTCOMES[outcome] : ["…", "computing"];
  return el("span", { class: `badge ${outcome ?? "none"}` }, `${sign} ${word}`);
}

/** The last that is known beside estimates, of this design or of one of a moment ago. */
export type Late = Partial<Record<Stage, Verdict>>;

/** Whether intervals and stability, and after them detuning margins, are of this design; and the last that are known. */
export interface Known {
  settled: boolean;
  detuned: boolean;
  late: Late;
}

interface Cells {
  row: HTMLTableRowElement;
  /** Where what all operating points share is typed; null where some alone are limited so. */
  required: HTMLInputElement | null;
  own: HTMLElement;
  found: HTMLTableCellElement;
  slack: HTMLTableCellElement;
  where: HTMLButtonElement;
  place: [number, number | null];
  outcome: HTMLTableCellElement;
}

export class RequirementTable {
  readonly element = el("div");
  /** The rows in short, which a narrow screen keeps in sight. */
  readonly strip = el("p", { class: "strip", id: "strip", "aria-hidden": "true" });
  private readonly body = el("tbody");
  private readonly stability = el("p", { class: "stability" });
  private readonly detuning = el("p", { class: "stability", id: "detuning" });
  private readonly resonances = el("ul", { class: "stability", id: "resonances", "aria-label": "Detuning margins of single resonances" });
  private readonly disturbed = el("p", { class: "stability", id: "disturbed" });
  private readonly adder = el("select", { id: "add-requirement" });
  private readonly cells = new Map<string, Cells>();
  private shape: string | null = null;

  constructor(
    private readonly limits: Limit[],
    private readonly names: string[],
    private readonly change: (name: string, value: number | null, goesOn: boolean) => void,
    private readonly choose: (point: number, hz: number | null) => void,
  ) {
    const head = ["Requirement", "Required", "Worst case, 95 % interval", "Slack", "Where", "Verdict"];
    const row = el("tr", {}, ...head.map((text) => el("th", { scope: "col" }, text)), el("td"));
    const table = el("table", { id: "requirements" }, el("thead", {}, row), this.body);
    const label = el("label", { for: "add-requirement" }, "Add a requirement ");
    const add = button("Add", "add the requirement that is chosen", () => this.added());
    this.element.append(el("div", { class: "scroll" }, table), this.stability, this.detuning, this.resonances, this.disturbed, el("p", { class: "row" }, label, this.adder, add));
  }

  /** Rows as asked for now; found numbers of the page's loop, null while nothing is known. */
  show(requirements: Requirements, found: Verdict, known: Known, before: Verdict | null, outcome: Outcome | null): void {
    const everywhere = requirementsAt({ ...requirements, at: [] }, {});
    const asked = this.limits.filter((limit) => found.rows.some((row) => row.quantity === limit.name));
    const shape = asked.map(({ name }) => `${name} ${name in everywhere}`).join();
    if (shape !== this.shape) this.rebuild(asked, everywhere);
    this.shape = shape;
    for (const limit of asked) {
      const row = found.rows.find((one) => one.quantity === limit.name);
      const cells = this.cells.get(limit.name);
      if (!row || !cells) continue;
      const common = everywhere[limit.name];
      if (cells.required) setField(cells.required, String(common));
      cells.own.textContent = row.required === common ? "" : `${signOf(limit)} ${shown(row.required)} ${unit(limit)} at this operating point`;
      const [isKnown, late] = limit.name === DETUNING ? [known.detuned, known.late.detuning] : [known.settled, known.late.intervals];
      this.fill(limit, row, cells, isKnown, rowOf(late, limit), rowOf(before, limit));
    }
    this.tellInShort(found, known.settled, outcome);
    const counted = known.settled ? found : known.late.intervals;
    this.stability.replaceChildren(...(counted ? this.stabilityWords(counted) : ["Stability: computing"]));
    this.stability.classList.toggle("late", !known.settled);
    this.tellDetuning(known.detuned, known.late);
    this.disturbed.textContent = this.disturbedWords(found, everywhere);
  }

  /** The verdict, then what is missed first. */
  private tellInShort({ rows, unstable }: Verdict, settled: boolean, outcome: Outcome | null): void {
    const lost = settled && unstable.length ? el("span", { class: "line failed" }, `not stable at ${unstable.length} of ${this.names.length}`) : "";
    const short = WORST_FIRST.flatMap((word) => rows.filter((row) => row.outcome === word)).map((row) => {
      const [word, limit] = [row.outcome, this.limits.find(({ name }) => name === row.quantity) as Limit];
      return el("span", { class: `line ${word}` }, `${OUTCOMES[word][0]} ${limit.label} ${isKnown(row) ? `${shown(row.value)} ${unit(limit)}` : openWord(row)}`);
    });
    this.strip.replaceChildren(badge(outcome), lost, ...short);
    this.strip.classList.toggle("late", !settled);
  }

  /** The last detuning margin, slanted while it is of a design of a moment ago. */
  private tellDetuning(isKnown: boolean, { detuning, resonances }: Late): void {
    this.detuning.textContent = detuning ? this.detuningWords(detuning) : "Detuning margin: computing";
    this.detuning.classList.toggle("late", !isKnown);
    const lines = resonances ? this.resonanceWords(resonances) : [];
    this.resonances.replaceChildren(...lines.map((words) => el("li", {}, words)));
    this.resonances.classList.toggle("late", resonances !== detuning);
    this.resonances.hidden = !lines.length;
  }

  /** Rms of error and plant input under what disturbed the loop, at the operating point with the largest error. */
  private disturbedWords({ margins, unstable }: Verdict, required: Requirements): string {
    const each = margins.flatMap(({ disturbed, stability }, k) => (disturbed ? [{ ...disturbed, k, lost: stability?.outcome === "unstable" }] : []));
    if (!each.length) return "";
    const { error, control, k, lost } = each.reduce((a, b) => (b.lost || (!a.lost && b.error > a.error) ? b : a));
    const most = (name: string): string => (typeof required[name] === "number" ? ` (at most ${shown(required[name])} required)` : "");
    const where = margins.length > 1 ? ` at ${this.names[k]}` : "";
    if (lost) return `Error rms: without bound${where}, where the loop is unstable.`;
    return `Error rms ${shown(error)}${most("error_rms")}, plant input rms ${shown(control)}${most("control_rms")}${where}, under what disturbed the loop when it was recorded${unstable.length ? ", if the loop is stable" : ""}; a requirement has its interval.`;
  }

  /** `late` is the row as it was known last: while this one is not, its interval is shown. */
  private fill(limit: Limit, row: Row, cells: Cells, settled: boolean, late: Row | null, before: Row | null): void {
    cells.row.className = `${row.outcome}${settled ? "" : " pending"}`;
    const known = settled ? row : late;
    const small = known ? intervalWords(known) : "interval follows";
    const compare = before ? el("span", { class: "other" }, `B: ${shown(before.value)}`) : null;
    const best = limit.name === DETUNING && known ? known : row;
    cells.found.replaceChildren(...(isKnown(best) || !settled ? [el("b", {}, `${best.is_bound ? "≥ " : ""}${shown(best.value)}`), ` ${unit(limit)}`] : [el("b", {}, openWord(best))]), el("small", {}, small), compare ?? "");
    cells.slack.textContent = isKnown(row) ? shown(row.slack) : "–";
    const at = row.at_hz === null ? "" : `${shown(row.at_hz)} Hz`;
    const name = this.names[row.point];
    cells.place = [row.point, row.at_hz];
    cells.where.setAttribute("aria-label", `show ${name} ${at}`);
    cells.where.replaceChildren(...(at ? [el("span", {}, at), " "] : []), el("span", {}, name));
    const waits = limit.name === DETUNING && !settled;
    cells.outcome.replaceChildren(badge(waits ? null : row.outcome));
    if (row.bound !== null && row.outcome === "undecided") {
      cells.outcome.append(el("small", {}, "decided beyond the measured lines"));
    }
    if (Number.isNaN(row.value) && !waits) cells.outcome.append(el("small", {}, "known where stability is decided"));
  }

  private rebuild(asked: Limit[], requirements: Requirements): void {
    this.cells.clear();
    this.body.replaceChildren();
    for (const limit of asked) {
      const required = typeof requirements[limit.name] === "number" ? this.field(limit, requirements[limit.name] as number) : null;
      const cells: Cells = {
        row: el("tr"), required, own: el("small"), found: el("td", { class: "number" }), slack: el("td", { class: "number" }),
        where: button("", "show", () => this.choose(...cells.place), { class: "link" }), place: [0, null], outcome: el("td"),
      };
      const gone = button("×", `remove the requirement ${limit.label}`, () => this.change(limit.name, null, false), { class: "plain" });
      cells.row.append(
        el("th", { scope: "row" }, limit.label),
        el("td", { class: "required" }, ...(required ? [`${signOf(limit)} `, required, ` ${unit(limit)}`] : []), cells.own),
        cells.found, cells.slack, el("td", {}, cells.where), cells.outcome, el("td", {}, required && gone),
      );
      this.body.append(cells.row);
      this.cells.set(limit.name, cells);
    }
    const rest = this.limits.filter(({ name }) => !(name in requirements) && !MASKED.includes(name));
    const options = rest.map((limit) => el("option", { value: limit.name }, limit.label));
    this.adder.replaceChildren(el("option", { value: "" }, "choose …"), ...options);
  }

  private field(limit: Limit, value: number): HTMLInputElement {
    return numberField(`required ${limit.label}`, value, (wanted, goesOn) => {
      if (!Number.isFinite(wanted)) return `${limit.label} must be finite; received ${wanted}; remove the requirement instead`;
      this.change(limit.name, wanted, goesOn);
      return null;
    });
  }

  /** What a requirement starts from when it is added. */
  private added(): void {
    const typical: Record<string, number> = {
      gain_margin_db: 6, gain_reduction_margin_db: 6, phase_margin_deg: 45, modulus_margin: 0.5, delay_margin_s: 0.001,
      sensitivity_peak_db: 6, complementary_peak_db: 6, control_peak_db: 40, control_high_frequency_db: 20,
      bandwidth_hz: 10, disk_margin: 0.7, process_peak_db: 0, sensitivity_bandwidth_hz: 5,
      complementary_bandwidth_hz: 10, controller_bandwidth_hz: 100, detuning_percent: 2,
    };
    const name = this.adder.value;
    if (name) this.change(name, typical[name] ?? 1, false);
  }

  /** How far frequencies of the plant may move, and what breaks first, at the operating point that bears least. */
  private detuningWords({ margins }: Verdict): string {
    const each = margins.flatMap((m, k) => (m.detuning ? [{ ...worstReading(m.detuning), interval: m.intervals[DETUNING], k }] : []));
    if (!each.length) return "Detuning margin: not known where stability is undecided.";
    const least = each.reduce((a, b) => (b.percent < a.percent ? b : a));
    const ends = least.interval ? ` (95 %: ${shown(least.interval[0])} … ${shown(least.interval[1])})` : "";
    const where = margins.length > 1 ? ` at ${this.names[least.k]}` : "";
    if (least.is_bound) return `Detuning margin: nothing breaks while the plant's frequencies move by ±${shown(least.percent)} %${ends}.`;
    const label = this.labelOf(least.breaks);
    if (least.percent === 0) return `Detuning margin: 0 %${where}: ${label} is missed at the plant's own frequencies or at the first shift.`;
    return `Detuning margin: ${shown(least.percent)} %${ends}${where}. Farther shifts of the plant's frequencies break first: ${label}.`;
  }

  private labelOf(breaks: string): string {
    return this.limits.find(({ name }) => name === breaks)?.label ?? STABILITY;
  }

  /** What resonances leave that move alone, the least first. */
  private resonanceWords({ margins }: Verdict): string[] {
    const each = margins.flatMap((m, k) => (m.detuning?.resonances ?? []).map((one) => ({ ...one, least: worstReading(one), k })));
    const one = (reading: DetuningReading, sign: string): string => `${sign}${shown(reading.percent)} %${reading.is_bound ? " and more" : ` (95 %: ${reading.interval.map(shown).join(" … ")}; then ${this.labelOf(reading.breaks)})`}`;
    return each.sort((a, b) => a.least.percent - b.least.percent).slice(0, MOST_RESONANCES).map(({ hz, damping, up, down, k }) => {
      const where = margins.length > 1 ? ` at ${this.names[k]}` : "";
      return `Resonance at ${shown(hz)} Hz (damping ${shown(damping)})${where}, moved alone: ${one(up, "+")}, ${one(down, "−")}`;
    });
  }

  private stabilityWords(found: Verdict): (Node | string)[] {
    const count = found.margins.length;
    if (!found.unstable.length) return [`Closed loop stable at ${count === 1 ? "the" : `all ${count}`} operating point${count === 1 ? "" : "s"}.`];
    return found.unstable.slice(0, 3).map((k) => {
      const { stability } = found.margins[k] as Margins;
      const word = stability?.outcome === "unstable" ? "failed" : "undecided";
      return el("span", { class: `line ${word}` }, `${this.names[k]}: ${stability?.outcome ?? ""}, ${stability?.reason ?? ""}`);
    });
  }
}

const WORST_FIRST: Outcome[] = ["failed", "undecided", "passed"];
const DETUNING = "detuning_percent";
const MOST_RESONANCES = 6;

const rowOf = (found: Verdict | null | undefined, { name }: Limit): Row | null => found?.rows.find((row) => row.quantity === name) ?? null;

/** The interval of a row, a bound among its ends. */
function intervalWords({ interval, bound, value }: Row): string {
  if (interval === null && bound === null) return "no interval";
  const [low, high] = interval ?? [value, value];
  const ends = bound === null ? [low, high] : [Math.min(low, bound), Math.max(high, bound)];
  return `${ends.map(shown).join(" … ")}${bound === null ? "" : " (bound)"}`;
}

/** Whether a worst case is a number; what nothing bounds is none (Python: row_of of data/result/verdict_words.py). */
const isKnown = ({ value, bound }: Row): boolean => Number.isFinite(value) || (!Number.isNaN(value) && bound === null);
const openWord = ({ outcome }: Row): string => (outcome === "undecided" ? "undecided" : "no bound");

const signOf = (limit: Limit): string => (limit.sense === "at_least" ? "≥" : "≤");

const unit = (limit: Limit): string => (limit.unit === "1" ? "" : limit.unit === "deg" ? "°" : limit.unit);
