// The controller's blocks: numbers to type, locks, order, and what each costs at the crossover.

import type { Controller, Kind } from "./numbers/controller";
import { KIND_NAMES, NEW_KINDS, PARAMETER_NAMES, newBlock, parameterRefusal, type Design, type DesignBlock } from "./design";
import { button, el, focusedIn, numberField, shown, written } from "./dom";
import { costAt } from "./draw/handles";

interface Card {
  fields: Map<string, HTMLInputElement>;
  cost: HTMLElement;
}

export class BlockList {
  readonly element = el("div");
  private readonly list = el("ol", { class: "blocks" });
  private readonly budget = el("p", { class: "quiet", id: "budget" });
  private readonly kind = el("select", { id: "new-kind" });
  private shape = "";
  private cards: Card[] = [];

  constructor(
    private readonly design: () => Design,
    private readonly change: (blocks: DesignBlock[], goesOn: boolean, words?: string) => string | null,
    private readonly crossover: () => number,
  ) {
    const kinds = NEW_KINDS.map((kind) => el("option", { value: kind }, KIND_NAMES[kind]));
    this.kind.append(...kinds);
    this.kind.value = "notch";
    const add = button("Add block", "add a block of this kind", () => this.add());
    this.element.append(this.list, el("p", { class: "row" }, el("label", { for: "new-kind" }, "New block "), this.kind, add), this.budget);
  }

  private add(): void {
    const made = newBlock(this.kind.value as Kind, this.crossover() || 10);
    this.change([...this.design().blocks, made], false, `${KIND_NAMES[made.kind]} added`);
  }

  show(controller: Controller): void {
    const { blocks } = this.design();
    const shape = JSON.stringify(blocks.map(({ kind, off, locked }) => [kind, off, locked]));
    if (shape !== this.shape) this.rebuild(blocks);
    this.shape = shape;
    const hz = this.crossover();
    blocks.forEach((block, k) => {
      for (const [name, field] of this.cards[k].fields) {
        if (focusedIn(field) !== field) field.value = written(block.parameters[name]);
      }
      const cost = block.off ? null : costAt(controller, block, hz);
      this.cards[k].cost.textContent = block.off ? "off" : cost ? `${signed(cost.deg)}°, ${signed(cost.db)} dB` : "";
    });
    this.budget.textContent = hz ? `Degrees and dB that each block adds at the crossover, ${shown(hz)} Hz.` : "No crossover.";
  }

  private rebuild(blocks: DesignBlock[]): void {
    const focused = this.list.contains(focusedIn(this.list)) ? focusedIn(this.list)?.id : null;
    this.cards = [];
    this.list.replaceChildren(...blocks.map((block, k) => this.card(block, k)));
    if (focused) (this.list.querySelector<HTMLElement>(`#${focused}`) ?? this.kind).focus();
  }

  private card(block: DesignBlock, k: number): HTMLLIElement {
    const fields = new Map<string, HTMLInputElement>();
    const cost = el("span", { class: "cost" });
    this.cards.push({ fields, cost });
    const where = `block ${k + 1}, ${KIND_NAMES[block.kind]}`;
    const names = block.kind === "section" ? [] : Object.keys(block.parameters);
    const parts: HTMLElement[] = names.map((name) => {
      const field = this.field(block, k, name, where);
      fields.set(name, field);
      return el("span", { class: "parameter" }, el("label", { for: field.id }, PARAMETER_NAMES[name]), field, this.lock(block, k, name, where));
    });
    if (block.kind === "section") parts.push(el("p", { class: "quiet" }, sectionWords(block.parameters)));
    const on = el("input", { type: "checkbox", id: `on-${k}`, change: () => this.edit(k, { off: !block.off }) });
    on.checked = !block.off;
    const head = el(
      "div", { class: "head" },
      el("b", {}, `${k + 1} ${KIND_NAMES[block.kind]}`), cost,
      el("label", { class: "check" }, on, "on"),
      button("↑", `move ${where} up`, () => this.move(k, -1), { id: `up-${k}`, class: "plain", disabled: k === 0 }),
      button("↓", `move ${where} down`, () => this.move(k, 1), { id: `down-${k}`, class: "plain", disabled: k === this.design().blocks.length - 1 }),
      button("×", `remove ${where}`, () => this.remove(k), { id: `gone-${k}`, class: "plain" }),
    );
    return el("li", { class: block.off ? "off" : "" }, head, el("div", { class: "parameters" }, ...parts));
  }

  private field(block: DesignBlock, k: number, name: string, where: string): HTMLInputElement {
    const field = numberField(`${PARAMETER_NAMES[name]} of ${where}`, block.parameters[name], (value, goesOn) => {
      const why = parameterRefusal(name, value);
      if (why) return why;
      const own = this.design().blocks[k].parameters;
      const tied = block.kind === "notch" && own.f1_hz === own.f2_hz && name === "f1_hz" && !this.design().blocks[k].locked.includes("f2_hz");
      return this.edit(k, { parameters: { ...own, [name]: value, ...(tied ? { f2_hz: value } : {}) } }, goesOn);
    });
    field.id = `b${k}-${name}`;
    field.disabled = block.locked.includes(name);
    return field;
  }

  private lock(block: DesignBlock, k: number, name: string, where: string): HTMLButtonElement {
    const locked = block.locked.includes(name);
    const label = `${locked ? "unlock" : "lock"} ${PARAMETER_NAMES[name]} of ${where}`;
    const flip = (): void => {
      this.edit(k, { locked: locked ? block.locked.filter((x) => x !== name) : [...block.locked, name] });
    };
    return button(locked ? "locked" : "lock", label, flip, { class: "plain lock", id: `lock-${k}-${name}`, "aria-pressed": String(locked) });
  }

  private edit(k: number, change: Partial<DesignBlock>, goesOn = false): string | null {
    return this.change(this.design().blocks.map((block, i) => (i === k ? { ...block, ...change } : block)), goesOn);
  }

  private move(k: number, by: number): void {
    const blocks = [...this.design().blocks];
    [blocks[k], blocks[k + by]] = [blocks[k + by], blocks[k]];
    this.change(blocks, false);
    this.list.querySelector<HTMLElement>(`#${by < 0 ? "up" : "down"}-${k + by}`)?.focus();
  }

  private remove(k: number): void {
    const { blocks } = this.design();
    this.change(blocks.filter((_, i) => i !== k), false, `${KIND_NAMES[blocks[k].kind]} removed`);
  }
}

/** A section's coefficients, which come from a file and stay. */
function sectionWords(p: Record<string, number>): string {
  const sum = (part: string): string => ["", " s", " s²"].map((s, k) => `${shown(p[`${part}${k}`])}${s}`).join(" + ");
  return `(${sum("n")}) / (${sum("d")}), s in rad/s`;
}

const signed = (value: number): string => `${value >= 0 ? "+" : "−"}${Math.abs(value).toFixed(1)}`;
