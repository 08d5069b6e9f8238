// The table of requirements: what is required, the worst case with its interval, slack and verdict; and stability.

import { button, el, numberField, shown } from "./dom";
import type { Margins } from "./margins";
import type { Limit, Requirements } from "./payload";
import type { Found, Outcome, Row } from "./verdict";

export const OUTCOMES: Record<Outcome, [string, string]> = {
  passed: ["✓", "passed"],
  failed: ["✗", "failed"],
  undecided: ["?", "undecided"],
};

export function badge(outcome: Outcome | null): HTMLElement {
  const [sign, word] = outcome ? OUTCOMES[outcome] : ["…", "computing"];
  return el("span", { class: `badge ${outcome ?? "none"}` }, `${sign} ${word}`);
}

interface Cells {
  row: HTMLTableRowElement;
  required: HTMLInputElement;
  found: HTMLTableCellElement;
  slack: HTMLTableCellElement;
  where: HTMLTableCellElement;
  outcome: HTMLTableCellElement;
}

export class RequirementTable {
  readonly element = el("div");
  private readonly body = el("tbody");
  private readonly stability = el("p", { class: "stability" });
  private readonly adder = el("select", { id: "add-requirement", change: () => this.added() });
  private readonly cells = new Map<string, Cells>();

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
    this.element.append(el("div", { class: "scroll" }, table), this.stability, el("p", {}, label, this.adder));
  }

  /** Rows as asked for now; found numbers of the page's loop, null while nothing is known. */
  show(requirements: Requirements, found: Found, settled: boolean, before: Found | null): void {
    const asked = this.limits.filter((limit) => typeof requirements[limit.name] === "number");
    if (asked.map((x) => x.name).join() !== [...this.cells.keys()].join()) this.rebuild(asked, requirements);
    for (const limit of asked) {
      const row = found.rows.find((one) => one.quantity === limit.name);
      const cells = this.cells.get(limit.name);
      if (!row || !cells) continue;
      if (document.activeElement !== cells.required) cells.required.value = String(row.wished);
      this.fill(limit, row, cells, settled, before?.rows.find((one) => one.quantity === limit.name) ?? null);
    }
    this.stability.replaceChildren(...this.stabilityWords(found, settled));
  }

  private fill(limit: Limit, row: Row, cells: Cells, settled: boolean, before: Row | null): void {
    cells.row.className = `${row.outcome}${settled ? "" : " pending"}`;
    const interval = row.interval ? `${shown(row.interval[0])} … ${shown(row.interval[1])}` : "no interval";
    const small = settled ? interval : "interval follows";
    const compare = before ? el("span", { class: "other" }, `B: ${shown(before.found)}`) : null;
    cells.found.replaceChildren(el("b", {}, shown(row.found)), ` ${unit(limit)}`, el("small", {}, small), compare ?? "");
    cells.slack.textContent = shown(row.spare);
    const at = row.at_hz === null ? "" : `${shown(row.at_hz)} Hz`;
    const name = this.names[row.point];
    const show = button("", `show ${name} ${at}`, () => this.choose(row.point, row.at_hz), { class: "link" });
    show.append(...(at ? [el("span", {}, at), " "] : []), el("span", {}, name));
    cells.where.replaceChildren(show);
    cells.outcome.replaceChildren(badge(row.outcome));
    if (row.bound !== null && row.outcome === "undecided") {
      cells.outcome.append(el("small", {}, "decided above the last frequency"));
    }
    if (Number.isNaN(row.found)) cells.outcome.append(el("small", {}, "told by loopshape check alone"));
  }

  private rebuild(asked: Limit[], requirements: Requirements): void {
    this.cells.clear();
    this.body.replaceChildren();
    for (const limit of asked) {
      const required = numberField(`required ${limit.label}`, requirements[limit.name] as number, (value, goesOn) => {
        if (!Number.isFinite(value)) return `${limit.label} must be a number`;
        this.change(limit.name, value, goesOn);
        return null;
      });
      const cells: Cells = {
        row: el("tr"), required, found: el("td", { class: "number" }), slack: el("td", { class: "number" }),
        where: el("td"), outcome: el("td"),
      };
      const sign = limit.sense === "at_least" ? "≥" : "≤";
      const gone = button("×", `remove the requirement ${limit.label}`, () => this.change(limit.name, null, false), { class: "plain" });
      cells.row.append(
        el("th", { scope: "row" }, limit.label),
        el("td", { class: "required" }, `${sign} `, required, ` ${unit(limit)}`),
        cells.found, cells.slack, cells.where, cells.outcome, el("td", {}, gone),
      );
      this.body.append(cells.row);
      this.cells.set(limit.name, cells);
    }
    const rest = this.limits.filter((limit) => !asked.includes(limit) && limit.name !== "detuning_percent");
    const options = rest.map((limit) => el("option", { value: limit.name }, limit.label));
    this.adder.replaceChildren(el("option", { value: "" }, "choose …"), ...options);
  }

  /** What a requirement starts from when it is added. */
  private added(): void {
    const typical: Record<string, number> = {
      gain_margin_db: 6, gain_reduction_margin_db: 6, phase_margin_deg: 45, modulus_margin: 0.5, delay_margin_s: 0.001,
      sensitivity_peak_db: 6, complementary_peak_db: 6, control_peak_db: 40, control_high_frequency_db: 20,
      bandwidth_hz: 10, disk_margin: 0.7, process_peak_db: 0, sensitivity_bandwidth_hz: 5,
      complementary_bandwidth_hz: 10, controller_bandwidth_hz: 100,
    };
    const name = this.adder.value;
    if (name) this.change(name, typical[name] ?? 1, false);
  }

  private stabilityWords(found: Found, settled: boolean): (Node | string)[] {
    if (!settled) return ["Stability: computing"];
    const count = found.margins.length;
    if (!found.unstable.length) return [`Closed loop stable at ${count === 1 ? "the" : `all ${count}`} operating point${count === 1 ? "" : "s"}.`];
    return found.unstable.slice(0, 3).map((k) => {
      const { stability } = found.margins[k] as Margins;
      const word = stability?.outcome === "unstable" ? "failed" : "undecided";
      return el("span", { class: `line ${word}` }, `${this.names[k]}: ${stability?.outcome ?? ""}, ${stability?.reason ?? ""}`);
    });
  }
}

const unit = (limit: Limit): string => (limit.unit === "1" ? "" : limit.unit === "deg" ? "°" : limit.unit);
