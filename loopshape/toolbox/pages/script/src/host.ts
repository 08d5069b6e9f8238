// What the page stands in: a file or a server's answer, whose address holds the design, or a cell of a notebook.

import { designOf, fromAddress, type Design } from "./design/design";
import type { Controller } from "./numbers/controller";
import type { Payload, PlantLoop, Requirements } from "./payload";

/** The page, as far as its surroundings need it. */
export interface Guest {
  readonly payload: Payload;
  readonly designs: readonly Design[];
  /** What stands behind # for the designs; nothing where they are those that the page came with. */
  readonly address: string;
  controllerAt(loop: number): Controller;
  say(words: string): void;
  /** Goes on with another design of a loop. */
  replace(loop: number, design: Design): void;
}

export interface Host {
  /** Where the page is built. */
  readonly root: HTMLElement;
  /** Where keys and dropped files are taken. */
  readonly area: Document | HTMLElement;
  /** The text of this module, for workers. */
  readonly script: string;
  /** Begins to give the page designs from outside. */
  joined(page: Guest): void;
  /** The designs are others now. */
  changed(page: Guest): void;
  titled(words: string): void;
}

/** A document of its own. */
export class OwnDocument implements Host {
  readonly root = document.getElementById("page") as HTMLElement;
  readonly area = document;
  readonly script = document.getElementById("script")?.textContent ?? "";

  joined(page: Guest): void {
    this.read(page);
    addEventListener("hashchange", () => this.read(page));
  }

  private read(page: Guest): void {
    location.hash.slice(1).split(".").forEach((word, k) => {
      const design = word && k < page.designs.length ? fromAddress(word, page.payload) : null;
      if (design && belongs(design, page.payload.loops[k])) page.replace(k, design);
      else if (word) page.say("The design in the address could not be read; the page starts from its own controller.");
    });
  }

  changed({ address }: Guest): void {
    history.replaceState(null, "", address ? `#${address}` : location.pathname + location.search);
  }

  titled(words: string): void {
    if (document.title !== words) document.title = words;
  }
}

const belongs = (design: Design, loop: PlantLoop): boolean => design.loop === loop.name && design.rate_hz === loop.rate_hz;

/** The model behind a widget, as the anywidget protocol has it. */
export interface Model {
  get(name: string): unknown;
  set(name: string, value: unknown): void;
  save_changes(): void;
  on(event: string, does: () => void): void;
  off(event: string, does: () => void): void;
}

const listed = <T>(value: T | T[]): T[] => (Array.isArray(value) ? value : [value]);

/** A cell of a notebook: controllers and requirements, of several loops in lists, are the model's, both ways. */
export class Cell implements Host {
  readonly root: HTMLElement;
  readonly area: HTMLElement;
  readonly script: string;
  private known = "";
  private end = (): void => {};

  constructor(
    private readonly model: Model,
    element: HTMLElement,
  ) {
    // ids, labels and style are the cell's own; a notebook's shortcuts must not take the keys that are typed here
    element.setAttribute("data-lm-suppress-shortcuts", "true");
    const shadow = element.attachShadow({ mode: "open" });
    const style = document.createElement("style");
    style.textContent = String(model.get("style"));
    [this.root, this.area, this.script] = [document.createElement("div"), element, String(model.get("script"))];
    this.root.id = "page";
    shadow.append(style, this.root);
    element.addEventListener("keydown", (event) => event.stopPropagation());
  }

  joined(page: Guest): void {
    const read = (): void => this.read(page);
    read();
    for (const event of EVENTS) this.model.on(event, read);
    this.end = () => EVENTS.forEach((event) => this.model.off(event, read));
  }

  private read(page: Guest): void {
    const controllers = listed(this.model.get("controller") as Controller);
    const required = listed(this.model.get("requirements") as Requirements);
    const text = JSON.stringify([controllers, required]);
    if (text === this.known) return;
    this.known = text;
    controllers.forEach((controller, k) => {
      const [requirements, design] = [required[k], page.designs[k]];
      const kept = JSON.stringify(controller) === JSON.stringify(page.controllerAt(k));
      if (kept && JSON.stringify(requirements) === JSON.stringify(design.requirements)) return;
      page.replace(k, kept ? { ...design, requirements } : designOf(controller, requirements));
    });
  }

  changed(page: Guest): void {
    const [controllers, required] = [page.designs.map((_, k) => page.controllerAt(k)), page.designs.map((one) => one.requirements)];
    const text = JSON.stringify([controllers, required]);
    if (text === this.known) return;
    this.known = text;
    const several = controllers.length > 1;
    this.model.set("controller", several ? controllers : controllers[0]);
    this.model.set("requirements", several ? required : required[0]);
    this.model.save_changes();
  }

  titled(): void {}

  left(): void {
    this.end();
  }
}

const EVENTS = ["change:controller", "change:requirements"];
