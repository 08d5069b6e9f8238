// The page: what a person does changes a design, and what is seen follows from it.

import { times } from "./numbers/arrays";
import { BlockList } from "./blocks";
import { refusal, responseOn, type Controller } from "./numbers/controller";
import {
  addressOf, controllerOf, controllerText, designOf, History, requirementsText, withFile, type Design,
} from "./design/design";
import { button, download, el, focusedIn, shown, slider } from "./dom";
import { Cell, OwnDocument, type Guest, type Host, type Model } from "./host";
import { quantityOf, requirementsAt, unjudged } from "./loop/limits";
import { unitCrossings } from "./loop/margins";
import { payloadOf, type Payload, type PlantLoop, type Raw } from "./payload";
import { Screen } from "./screen";
import { scaledTo } from "./design/tune";
import { stepOf, type Step } from "./numbers/step";
import { badge, RequirementTable, type Late } from "./table";
import { Engine, worstOf, type Outcome, type Verdict } from "./loop/verdict";
import type { Trace } from "./draw/views";
import { DETUNED, Pool, STAGES, workHere, type Worked } from "./work";

class Page implements Guest {
  private readonly engines: Engine[];
  designs: Design[];
  private readonly first: string[];
  private others: (Design | null)[];
  private histories: History[];
  private current = 0;
  private found: Verdict | null = null;
  private settled = false;
  /** Whether detuning margins are known of what is shown. */
  private detuned = false;
  private otherVerdict: Verdict | null = null;
  /** The last answers of the workers, of this design or of one of a moment ago. */
  private late: Late = {};
  private traces: Trace[] = [];
  private queued = 0;
  private worst = 0;
  private table!: RequirementTable;
  private blocks!: BlockList;
  private bandwidth!: ReturnType<typeof slider>;
  /** From which design the bandwidth is moved, where it was, and what was made of it. */
  private scaledFrom: { design: Design; hz: number; now: Design } | null = null;
  private screen!: Screen;
  private readonly pool: Pool;
  private readonly message = el("p", { id: "message", role: "status", "aria-live": "polite" });
  private readonly verdict = el("span", { id: "verdict-badge" });
  private readonly unjudged = el("p", { class: "line undecided", id: "unjudged" });
  private readonly certificate = el("p", { class: "quiet", id: "certificate" });
  private readonly closed = el("p", { id: "closed", "aria-live": "polite" });
  private readonly redraw = (): void => this.screen.resized();
  private readonly sizes = new ResizeObserver(this.redraw);
  private readonly dark = matchMedia("(prefers-color-scheme: dark)");
  /** Milliseconds from a change to its picture, its intervals, its detuning margins, where they are found: read by who measures. */
  readonly timings: Record<"picture" | "intervals" | "detuning", number[]> = { picture: [], intervals: [], detuning: [] };
  private changedAt = 0;

  constructor(
    readonly payload: Payload,
    raw: Raw,
    private readonly host: Host,
  ) {
    this.engines = payload.loops.map((loop) => new Engine(payload, loop));
    this.designs = payload.loops.map((loop) => designOf(loop.controller, loop.requirements));
    this.first = this.designs.map((design) => JSON.stringify(design));
    this.others = payload.loops.map(() => null);
    this.histories = this.designs.map((design) => new History(design));
    this.pool = new Pool(raw, host.script, (worked) => this.worked(worked));
    this.build();
    this.listen();
    host.joined(this);
    this.histories = this.designs.map((design) => new History(design)); // what it begins with cannot be undone
    this.refresh();
  }

  private get root(): HTMLElement {
    return this.host.root;
  }

  /** Ends what goes on beside the page. */
  left(): void {
    this.pool.end();
    this.sizes.disconnect();
    this.dark.removeEventListener("change", this.redraw);
  }

  get loop(): PlantLoop {
    return this.payload.loops[this.current];
  }

  get design(): Design {
    return this.designs[this.current];
  }

  replace(loop: number, design: Design): void {
    this.designs[loop] = design;
    this.histories[loop].push(design, false);
    this.refresh();
  }

  controllerAt(loop: number): Controller {
    return this.running(this.designs[loop]);
  }

  /** What stands behind # for these designs; nothing where they are those that the page came with. */
  get address(): string {
    const own = this.designs.map((design, k) => (JSON.stringify(design) === this.first[k] ? "" : addressOf(design)));
    return own.some(Boolean) ? own.join(".") : "";
  }

  private build(): void {
    const names = this.loop.points.map((point) => point.name);
    this.table = new RequirementTable(
      this.payload.limits, names,
      (name, value, goesOn) => this.require(name, value, goesOn),
      (point, hz) => this.screen.look(point, hz),
    );
    this.blocks = new BlockList(() => this.design, (blocks, goesOn, words) => this.change({ blocks }, goesOn, words), (delay_s, goesOn) => this.delay(delay_s, goesOn), () => this.crossover());
    const [low, high] = [Math.min(...this.loop.points.map(({ f }) => f[0])), Math.min(0.2 * this.loop.rate_hz, ...this.loop.points.map(({ f }) => f[f.length - 1]))];
    this.bandwidth = slider("bandwidth", "Bandwidth [Hz]", low, high, (hz) => this.scale(hz), (hz) => void this.tuneTo(hz));
    this.screen = new Screen(names, {
      design: () => this.design,
      controller: () => this.controller,
      required: (point) => ({
        requirements: requirementsAt(this.design.requirements, this.loop.points[point].operating_point),
        every: this.design.requirements,
        limits: this.payload.limits,
      }),
      change: (blocks, goesOn) => this.change({ blocks }, goesOn),
      ended: () => this.histories[this.current].close(),
      crossover: () => this.crossover(),
      fit: (point) => this.loop.points[point].fit,
      step: (point, other) => this.step(point, other),
    });
    this.root.replaceChildren(
      this.header(),
      this.closed,
      this.message,
      el("main", {},
        el("section", { id: "verdict", "aria-label": "Verdict" }, el("h2", {}, "Requirements ", this.verdict), this.unjudged, this.table.element, this.certificate, this.notes()),
        el("section", { id: "plots", "aria-label": "Plots" }, this.screen.element),
        el("section", { id: "controller", "aria-label": "Controller" }, el("h2", {}, "Controller"), this.bandwidth.element, this.blocks.element),
      ),
      el("footer", {}, el("p", { class: "quiet" }, KEYS)),
      this.table.strip,
    );
  }

  /** What had to be assumed of the plant. */
  private notes(): HTMLElement {
    return el("ul", { class: "quiet", id: "notes" }, ...this.loop.notes.map((note) => el("li", {}, note)));
  }

  private header(): HTMLElement {
    const many = this.payload.loops.length > 1;
    const choice = el("select", { id: "loop", "aria-label": "Loop", change: () => this.switchTo(Number(choice.value)) });
    choice.append(...this.payload.loops.map((loop, k) => el("option", { value: String(k) }, loop.name)));
    choice.value = String(this.current);
    const file = el("input", { type: "file", id: "file", accept: ".toml,text/plain", "aria-label": "Open a controller or requirements file", change: () => this.opened(file) });
    const bar = el(
      "div", { class: "bar", role: "toolbar", "aria-label": "Design" },
      button("Undo", "undo (Ctrl+Z)", () => this.back(-1), { id: "undo" }),
      button("Redo", "redo (Ctrl+Y)", () => this.back(1), { id: "redo" }),
      button("Keep as B", "keep this design to compare with", () => this.keep(), { id: "keep" }),
      button("Swap A and B", "continue with the design that was kept", () => this.swap(), { id: "swap" }),
      button("controller.toml", "download the controller", () => this.save("controller.toml"), { id: "save-controller" }),
      button("requirements.toml", "download the requirements", () => this.save("requirements.toml"), { id: "save-requirements" }),
      button("Copy", "copy the controller file to the clipboard", () => this.copy(), { id: "copy" }),
      el("label", { class: "file" }, "Open", file),
      ...(this.payload.served ? this.servedButtons() : []),
    );
    return el("header", {}, el("h1", {}, this.payload.title, ...(many ? [" ", choice] : [` ${this.loop.name}`])), bar);
  }

  private servedButtons(): HTMLElement[] {
    return [
      button("Tune from here", "let loopshape tune what is not locked, from this design", () => void this.tune(), { id: "tune" }),
      button("Certify", "let loopshape check this design", () => void this.certify(), { id: "certify" }),
      button("Save", "save the controller on this machine", () => void this.serverSays("save"), { id: "save" }),
      ...(this.loop.closed.length ? [button("Close others", "close the other loops as they are designed now", () => void this.closeOthers(), { id: "close" })] : []),
    ];
  }

  /** Asks the server that gave this page; what it answers, or null after an error was shown. */
  private async serverSays(what: string): Promise<Record<string, unknown> | null> {
    const on = this.design.blocks.filter((block) => !block.off);
    const controllers = this.designs.map((design) => this.running(design));
    const asked = { saved: this.payload.saved, controller: this.controller, controllers, requirements: this.design.requirements, locked: on.length ? on.map((block) => block.locked) : [[]] };
    this.say("Asking loopshape …");
    try {
      const headers = { "Content-Type": "application/json" };
      const response = await fetch(what, { method: "POST", headers, body: JSON.stringify(asked) });
      const answer = (await response.json()) as Record<string, unknown>;
      this.say(String(answer.error ?? answer.words));
      if (typeof answer.saved === "string") this.payload.saved = answer.saved;
      return response.ok ? answer : null;
    } catch {
      this.say("The server does not answer: is loopshape shape --serve still running?");
      return null;
    }
  }

  /** The page again, each loop on the plant that it meets with the others as they are now; the address keeps designs. */
  private async closeOthers(): Promise<void> {
    if (!(await this.serverSays("close"))) return;
    this.host.changed(this);
    location.reload();
  }

  /** Designs of other loops that were changed since they were closed. */
  private movedOthers(): Design[] {
    const { closed, requirements } = this.loop;
    const text = (controller: Controller): string => JSON.stringify(controllerOf(designOf(controller, requirements)));
    return this.designs.filter((design) => closed.some((own) => own.loop === design.loop && text(own) !== JSON.stringify(controllerOf(design))));
  }

  private closedWords(): string {
    const { closed, name } = this.loop;
    if (!closed.length) return "";
    const moved = this.movedOthers();
    const names = closed.map((own) => own.loop).join(", ");
    if (!moved.length) return `Loop ${name}, with ${names} closed.`;
    const way = this.payload.served ? "Press Close others." : "Save controller.toml and write the page again from it.";
    return `Loop ${name}, with ${names} closed as this page was made. Changed since: ${moved.map((own) => own.loop).join(", ")}, so ${name} meets another plant now. ${way}`;
  }

  private async certify(): Promise<void> {
    const { loop, controller } = this;
    const { requirements } = this.design;
    const answer = await this.serverSays("check");
    if (!answer) return;
    Object.assign(loop, { certificate: answer.certificate, controller, requirements });
    this.refresh();
  }

  private async tune(): Promise<void> {
    const before = this.design;
    const answer = await this.serverSays("tune");
    if (!answer || this.design !== before) return;
    const found = answer.controller as Controller;
    let next = 0;
    const blocks = before.blocks.map((block) => (block.off ? block : { ...block, ...found.blocks[next++] }));
    this.set({ ...before, blocks }, false);
  }

  /** Where the bandwidth is moved from: the design, and the lowest of all operating points in Hz, by estimates. */
  private get origin(): { design: Design; hz: number; now: Design } {
    const { design, controller } = this;
    if (this.scaledFrom?.now === design) return this.scaledFrom;
    const found = this.engines[this.current].estimates(controller, design.requirements);
    return { design, hz: Math.min(...found.map(({ values }) => values.bandwidth_hz || 0)), now: design };
  }

  /** The design moved to a bandwidth in Hz, before anything is searched. */
  private scale(hz: number): void {
    this.scaledFrom = this.origin;
    this.change({ blocks: scaledTo(this.scaledFrom.design, this.loop, this.scaledFrom.hz, hz).blocks }, true, `Scaled to ${shown(hz)} Hz: let go to tune`);
    this.scaledFrom.now = this.design;
  }

  /** Tunes what is not locked for a bandwidth in Hz: judged here, as by check; whether all that is required is left. */
  async tuneTo(hz: number): Promise<boolean> {
    const { design, hz: from_hz } = this.origin;
    const [before, loop] = [this.design, this.current];
    this.scaledFrom = null;
    this.say(`Tuning for ${shown(hz)} Hz …`);
    const { blocks, feasible } = await this.pool.tune({ loop, design, from_hz, hz });
    if (this.design !== before || this.current !== loop) return feasible;
    const missed = "and all that is required were not reached together with what is free: the nearest is shown; add a lead or a notch, unlock numbers, or ask for less";
    this.change({ blocks }, true, `${shown(hz)} Hz ${feasible ? `and all that is required${this.open.length ? " and judged here" : ""} are reached, with intervals and stability` : missed}`);
    this.histories[this.current].close();
    return feasible;
  }

  private listen(): void {
    const { area } = this.host as { area: HTMLElement };
    area.addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.altKey) return;
      const key = event.key.toLowerCase();
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      focusedIn(this.root)?.blur();
      this.back(key === "y" || event.shiftKey ? 1 : -1);
    });
    area.addEventListener("dragover", (event) => event.preventDefault());
    area.addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file) void file.text().then((text) => this.take(text, file.name));
    });
    this.sizes.observe(this.screen.element);
    this.dark.addEventListener("change", this.redraw);
  }

  say(words: string): void {
    this.message.textContent = words;
  }

  private get controller(): Controller {
    return this.running(this.design);
  }

  private readonly controllers = new WeakMap<Design, Controller>();

  /** The controller of a design, the same one as long as the design is: responses are remembered by it. */
  private running(design: Design): Controller {
    const made = this.controllers.get(design) ?? controllerOf(design);
    this.controllers.set(design, made);
    return made;
  }

  private crossover(): number {
    const trace = this.traces[this.worst];
    return (trace && unitCrossings(trace.f, trace.L)[0]) ?? 0;
  }

  private delay(computation_delay_s: number, goesOn: boolean): string | null {
    if (!(computation_delay_s >= 0)) return `computation delay [s] must not be negative; received ${computation_delay_s}; give 0 or more`;
    return this.change({ computation_delay_s }, goesOn);
  }

  /** The design as changed, or why not, in words. */
  private change(part: Partial<Design>, goesOn: boolean, words?: string): string | null {
    const next = { ...this.design, ...part };
    const why = refusal(controllerOf(next));
    if (why) {
      this.say(`Not possible: ${why}.`);
      return why;
    }
    this.set(next, goesOn);
    this.say(words ? `${words}.` : "");
    return null;
  }

  private require(name: string, value: number | null, goesOn: boolean): void {
    const requirements = { ...this.design.requirements };
    if (value === null) delete requirements[name];
    else requirements[name] = value;
    if (value === null && requirements.masks) requirements.masks = requirements.masks.filter((mask) => quantityOf(mask) !== name);
    if (name === "control_high_frequency_db") {
      if (value === null) delete requirements.control_high_frequency_from_hz;
      else requirements.control_high_frequency_from_hz ??= Number((0.1 * this.design.rate_hz).toPrecision(3));
    }
    this.set({ ...this.design, requirements }, goesOn);
  }

  private set(design: Design, goesOn: boolean): void {
    this.designs[this.current] = design;
    this.histories[this.current].push(design, goesOn);
    this.refresh();
  }

  /** Step of the fit of an operating point under the design, or under B. */
  step(point: number, other = false): Step | null {
    const design = other ? this.others[this.current] : this.design;
    const { fit } = this.loop.points[point];
    return fit && design && stepOf(fit, this.running(design), this.payload.constants.step_response);
  }

  private back(by: -1 | 1): void {
    const design = this.histories[this.current].move(by);
    if (!design) {
      this.say(by < 0 ? "Nothing to undo." : "Nothing to redo.");
      return;
    }
    this.designs[this.current] = design;
    this.refresh();
  }

  private keep(): void {
    this.others[this.current] = structuredClone(this.design);
    this.otherVerdict = this.settled ? this.found : null;
    this.say("Kept as B: drawn dashed, its worst cases stand beside yours.");
    this.refresh();
  }

  private swap(): void {
    const other = this.others[this.current];
    if (!other) {
      this.say("There is no B yet: keep a design first.");
      return;
    }
    this.others[this.current] = this.design;
    this.otherVerdict = this.settled ? this.found : null;
    this.set(other, false);
  }

  private switchTo(loop: number): void {
    this.current = loop;
    this.otherVerdict = null;
    this.late = {};
    this.build();
    this.sizes.disconnect();
    this.sizes.observe(this.screen.element);
    this.refresh();
  }

  /** The command that signs what is designed here. */
  private get signing(): string {
    return this.loop.closed.length ? "check --matrix" : "check";
  }

  private text(name: string): string {
    return name === "controller.toml" ? controllerText(this.designs, this.payload.version) : requirementsText(this.designs);
  }

  private save(name: string): void {
    download(name, this.text(name));
    this.say(`${name} downloaded; verify it: loopshape ${this.signing} RUN controller.toml --require requirements.toml`);
  }

  private copy(): void {
    const text = this.text("controller.toml");
    const failed = (): void => this.say("The browser does not allow the clipboard here: download the file.");
    if (!navigator.clipboard) failed();
    else navigator.clipboard.writeText(text).then(() => this.say("controller.toml copied."), failed);
  }

  private opened(input: HTMLInputElement): void {
    const file = input.files?.[0];
    if (file) void file.text().then((text) => this.take(text, file.name));
    input.value = "";
  }

  /** The text of a file, as the design, or in words why not. */
  take(text: string, name: string): void {
    try {
      const { design, what } = withFile(this.payload, this.loop, this.design, text);
      this.set(design, false);
      this.say(`${what} read from ${name}.`);
    } catch (error) {
      this.say(`${name} was not read: ${(error as Error).message}.`);
    }
  }

  private refresh(): void {
    if (!this.changedAt) this.changedAt = performance.now();
    this.settled = this.detuned = false;
    if (!this.queued) {
      this.queued = requestAnimationFrame(() => {
        this.queued = 0;
        this.update();
      });
    }
  }

  private update(): void {
    const controller = this.controller;
    this.traces = this.traced(controller);
    const engine = this.engines[this.current];
    const { requirements } = this.design;
    if (!this.settled) this.found = engine.verdict(requirements, engine.estimates(controller, requirements));
    this.worst = worstOf(this.found as Verdict);
    this.pool.ask({ loop: this.current, controller, requirements, at: this.changedAt });
    this.show();
    this.timings.picture.push(performance.now() - this.changedAt);
    this.changedAt = 0;
    this.tellSoon();
  }

  private timer = 0;

  private tellSoon(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.host.changed(this);
      this.entitle();
    }, 150);
  }

  private traced(controller: Controller): Trace[] {
    return this.loop.points.map(({ name, f, P }) => {
      const C = responseOn(controller, f);
      return { name, f, P, C, L: times(C, P) };
    });
  }

  private worked(worked: Worked): void {
    if (worked.loop !== this.current) return;
    const { controller, requirements, margins, stage, at } = worked;
    if (stage !== "resonances") this.timings[stage].push(performance.now() - at);
    const now = { controller: this.controller, requirements: this.design.requirements };
    const found = this.engines[this.current].verdict(requirements, margins);
    for (const known of STAGES.slice(0, STAGES.indexOf(stage) + 1)) this.late[known] = found;
    if (JSON.stringify([controller, requirements]) !== JSON.stringify([now.controller, now.requirements])) {
      if (!this.queued) this.tabulate(); // of a moment ago: what moves is drawn already, or is about to be
      return;
    }
    this.found = found;
    this.worst = worstOf(found);
    this.settled = true;
    this.detuned = stage !== "intervals";
    this.show();
  }

  /** Whether all that the verdict depends on is known. */
  private get decided(): boolean {
    return this.settled && (this.detuned || typeof this.design.requirements.detuning_percent !== "number");
  }

  /** What is required and not judged here. */
  private get open(): string[] {
    return unjudged(this.design.requirements, this.payload, this.loop.weighted);
  }

  /** The verdict, null while it is computed: at best undecided where something required is not judged here. */
  private get outcome(): Outcome | null {
    if (!this.decided || !this.found) return null;
    return this.found.outcome === "passed" && this.open.length ? "undecided" : this.found.outcome;
  }

  private isStart(): boolean {
    const { controller, requirements } = this.loop;
    return JSON.stringify([this.controller, this.design.requirements]) === JSON.stringify([controllerOf(designOf(controller, requirements)), requirements]);
  }

  private show(): void {
    const found = this.found as Verdict;
    const asked = found.rows.length > 0;
    const open = this.open;
    this.draw(); // first: a canvas asks for styles, which words that changed would make anew
    this.verdict.replaceChildren(badge(this.outcome));
    this.unjudged.textContent = open.length ? `Required and not judged on this page: ${open.join("; ")}. Judge these with loopshape ${this.signing}.` : "";
    this.unjudged.hidden = !open.length;
    this.verdict.title = asked ? "" : "stability alone: nothing is required";
    this.tabulate();
    this.blocks.show(this.controller);
    if (this.scaledFrom?.now !== this.design) this.bandwidth.show(this.crossover());
    this.closed.textContent = this.closedWords();
    this.closed.hidden = !this.loop.closed.length;
    this.closed.classList.toggle("moved", this.movedOthers().length > 0);
    const { certificate } = this.loop;
    const here = "The numbers above are computed here, from the same draws.";
    const word = certificate?.outcome ?? "none";
    this.certificate.textContent = this.isStart()
      ? `Certificate of loopshape check for this design: ${word}. ${here}`
      : `The certificate (${word}) is of an earlier design. ${here} Sign this one with loopshape ${this.signing}.`;
    const can = { undo: this.histories[this.current].can(-1), redo: this.histories[this.current].can(1), swap: this.others[this.current] !== null };
    for (const [id, may] of Object.entries(can)) (this.root.querySelector(`#${id}`) as HTMLButtonElement).disabled = !may;
    if (this.outcome) this.entitle();
  }

  private entitle(): void {
    this.host.titled(`${this.outcome ?? "…"} · ${this.loop.name} · loopshape shape`);
  }

  private tabulate(): void {
    const { settled, detuned, late } = this;
    if (this.found) this.table.show(this.design.requirements, this.found, { settled, detuned, late }, this.otherVerdict, this.outcome);
  }

  private draw(): void {
    if (!this.found) return;
    const other = this.others[this.current];
    this.screen.draw(this.traces, this.worst, other ? this.traced(this.running(other)) : null);
  }

  /** What is found of a controller, as `check` finds it: for scripts and tests. */
  async ask(controller: Controller): Promise<Verdict> {
    const engine = this.engines[this.current];
    const { requirements } = this.design;
    const margins = Array.from({ length: engine.size }, (_, k) =>
      DETUNED.reduce((m, stage) => engine[stage](k, controller, requirements, m), engine.settled(k, controller, requirements, true)),
    );
    return engine.verdict(requirements, margins);
  }

  /** Where the handles of the Bode plot stand on it, in pixels, by their letters. */
  get handles(): Record<string, [number, number]> {
    return this.screen.places;
  }

  get state(): { settled: boolean; detuned: boolean; outcome: string | null; rows: string[]; controller: Controller } {
    const rows = (this.found?.rows ?? []).map((row) => `${row.quantity} ${shown(row.value)} ${row.outcome}`);
    return { settled: this.settled, detuned: this.detuned, outcome: this.outcome, rows, controller: this.controller };
  }
}

const KEYS =
  "On the Bode plot drag a handle (z zero, p pole, N notch, L low-pass, K gain, I integrator, D and F derivative and filter of a PID); the wheel above a handle widens it." +
  " On the Nichols plot drag the curve: up and down with its gain, sideways with the corners of a lead." +
  " Keyboard: arrow keys in a number change it by 1 %, with Shift by 10 %, with Alt by 0.1 %; on a plot left and right move the cursor," +
  " up and down choose the operating point, + and − zoom, 0 shows all. Ctrl+Z and Ctrl+Y undo and redo. Files may be dropped on the page.";

/** The page in a cell of a notebook (anywidget); what is given back ends it. */
function render({ model, el: element }: { model: Model; el: HTMLElement }): () => void {
  const raw = model.get("payload") as Raw;
  const cell = new Cell(model, element);
  const page = new Page(payloadOf(raw), raw, cell);
  return () => {
    page.left();
    cell.left();
  };
}

export default { render };

// this script is a worker, a page of its own, or what a notebook asks to render
if (typeof document === "undefined") workHere(self as never);
else {
  const data = document.querySelector("script#data[type='application/json']");
  if (data) {
    const raw = JSON.parse(data.textContent ?? "") as Raw;
    (window as unknown as { loopshape: Page }).loopshape = new Page(payloadOf(raw), raw, new OwnDocument());
  }
}
