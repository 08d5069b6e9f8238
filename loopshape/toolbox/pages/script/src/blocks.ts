// The controller's blocks: numbers to type, locks, order, and what each costs at the crossover.

import type { Controller } from "./numbers/controller";
import { newBlock, type Design, type DesignBlock } from "./design/design";
import { button, el, focusedIn, numberField, shown, setField, written } from "./dom";
import { nameOf, NEW_BLOCKS, numbersOf, type BlockNumber } from "./numbers/forms";
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
  private readonly delayed = numberField("computation delay [s]", 0, (value, goesOn) => this.delay(value, goesOn), { id: "delay" });
  private shape = "";
  private cards: Card[] = [];

  constructor(
    private readonly design: () => Design,
    private readonly change: (blocks: DesignBlock[], goesOn: boolean, words?: string) => string | null,
    private readonly delay: (delay_s: number, goesOn: boolean) => string | null,
    private readonly crossover: () => number,
  ) {
    this.kind.append(...Object.entries(NEW_BLOCKS).map(([word, [name]]) => el("option", { value: word }, name)));
    this.kind.value = "notch";
    const add = button("Add block", "add a block of this kind", () => this.add());
    this.element.append(this.list, el("p", { class: "row" }, el("label", { for: "new-kind" }, "New block "), this.kind, add), this.budget,
      el("p", { class: "row parameter" }, el("label", { for: this.delayed.id, title: "from sampling to when the output takes effect, as far as the measured plant does not contain it" }, "Computation delay [s]"), this.delayed));
  }

  private add(): void {
    const made = newBlock(this.kind.value, this.crossover() || 10);
    this.change([...this.design().blocks, made], false, `${nameOf(made)} added`);
  }

  show(controller: Controller): void {
    const { blocks, computation_delay_s } = this.design();
    const numbers = blocks.map((block) => numbersOf(block, block.locked));
    const shape = JSON.stringify(blocks.map((block, k) => [nameOf(block), block.off, block.locked, numbers[k].map(({ name }) => name)]));
    if (shape !== this.shape) this.rebuild(blocks);
    this.shape = shape;
    const hz = this.crossover();
    blocks.forEach((block, k) => {
      for (const { name, value } of numbers[k]) setField(this.cards[k].fields.get(name) as HTMLInputElement, written(value));
      const cost = block.off ? null : costAt(controller, block, hz);
      this.cards[k].cost.textContent = block.off ? "off" : cost ? `${signed(cost.deg)}°, ${signed(cost.db)} dB` : "";
    });
    setField(this.delayed, written(computation_delay_s));
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
    const where = `block ${k + 1}, ${nameOf(block)}`;
    const parts: HTMLElement[] = numbersOf(block, block.locked).map((number) => {
      const field = this.field(block, k, number, where);
      fields.set(number.name, field);
      const lock = number.of.length === 1 ? this.lock(block, k, number, where) : null;
      return el("span", { class: "parameter" }, el("label", { for: field.id }, number.label), field, lock);
    });
    if (!parts.length) parts.push(el("p", { class: "quiet" }, sectionWords(block.parameters)));
    const on = el("input", { type: "checkbox", id: `on-${k}`, change: () => this.edit(k, { off: !block.off }) });
    on.checked = !block.off;
    const head = el(
      "div", { class: "head" },
      el("b", {}, `${k + 1} ${nameOf(block)}`), cost,
      el("label", { class: "check" }, on, "on"),
      button("↑", `move ${where} up`, () => this.move(k, -1), { id: `up-${k}`, class: "plain", disabled: k === 0 }),
      button("↓", `move ${where} down`, () => this.move(k, 1), { id: `down-${k}`, class: "plain", disabled: k === this.design().blocks.length - 1 }),
      button("×", `remove ${where}`, () => this.remove(k), { id: `gone-${k}`, class: "plain" }),
    );
    return el("li", { class: block.off ? "off" : "" }, head, el("div", { class: "parameters" }, ...parts));
  }

  private field(block: DesignBlock, k: number, { name, label, of, value }: BlockNumber, where: string): HTMLInputElement {
    const field = numberField(`${label} of ${where}`, value, (wanted, goesOn) => {
      const now = this.design().blocks[k];
      const parameters = numbersOf(now, now.locked).find((number) => number.name === name)?.with(wanted) ?? null;
      return typeof parameters === "object" && parameters ? this.edit(k, { parameters }, goesOn) : parameters;
    });
    field.id = `b${k}-${name}`;
    field.disabled = of.some((one) => block.locked.includes(one));
    return field;
  }

  private lock(block: DesignBlock, k: number, { name, label: shownAs }: BlockNumber, where: string): HTMLButtonElement {
    const locked = block.locked.includes(name);
    const label = `${locked ? "unlock" : "lock"} ${shownAs} of ${where}`;
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
    this.change(blocks.filter((_, i) => i !== k), false, `${nameOf(blocks[k])} removed`);
  }
}

/** A section's coefficients, which come from a file and stay. */
function sectionWords(p: Record<string, number>): string {
  const sum = (part: string): string => ["", " s", " s²"].map((s, k) => `${shown(p[`${part}${k}`])}${s}`).join(" + ");
  return `(${sum("n")}) / (${sum("d")}), s in rad/s`;
}

const signed = (value: number): string => `${Number(value.toFixed(1)) >= 0 ? "+" : "−"}${Math.abs(value).toFixed(1)}`;
