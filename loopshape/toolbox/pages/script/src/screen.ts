// The plots with what a pointer, a wheel and keys do on them, linked by one frequency.

import { placeIn } from "./numbers/arrays";
import type { Controller } from "./numbers/controller";
import type { Design, DesignBlock } from "./design/design";
import { el, shown } from "./dom";
import { carried, dragged, handlesOf, widened, type Handle } from "./draw/handles";
import { limitSizes, phaseGuides, sizeGuides, type RequiredLimits } from "./draw/guides";
import { axisCrossings, unitCrossings } from "./loop/margins";
import type { FitModel } from "./payload";
import { coloursOf, Plot, type Axis } from "./draw/plot";
import type { Step } from "./numbers/step";
import {
  frequencyAxis, interpolated, nearestLine, nicholsAxis, nicholsChart, nicholsCurve, nicholsPlaces, nyquistChart, phaseAxis,
  phaseDeg, responseOf, RESPONSES, sizeAxis, sizeDb, stepAxes, styleOf, type Response, type Trace,
} from "./draw/views";
import { Zoom } from "./draw/zoom";

export interface Asked {
  design: () => Design;
  controller: () => Controller;
  /** What is required at one operating point. */
  required: (point: number) => RequiredLimits;
  change: (blocks: DesignBlock[], goesOn: boolean) => void;
  ended: () => void;
  crossover: () => number;
  /** The fit of an operating point, and the step of its loop: null where it does not come to rest. */
  fit: (point: number) => FitModel | null;
  step: (point: number, other: boolean) => Step | null;
}

interface Hold {
  handle: Handle;
  from: DesignBlock;
  startHz: number;
  startDb: number;
}

/** A place of the curve in front on the Nichols plot that follows the mouse: its frequency, and where it was taken. */
interface Carry {
  from: DesignBlock[];
  controller: Controller;
  hz: number;
  x: number;
  y: number;
}

/** How near the mouse must come to a curve, and how far it must go sideways before the phase follows, in pixels. */
const NEAR = 9;
const SIDEWAYS = 6;

/** How near a finger must come to a handle, in pixels. */
const FINGER = 28;

const KEY = [["worst", "worst operating point"], ["chosen", "chosen"], ["point", "others"], ["other", "B"]];

const LINEAR = (low: number, high: number, label: string, ticks: number): Axis => ({ low, high, log: false, label, ticks });

export class Screen {
  readonly element = el("div", { class: "screen" });
  private readonly size = this.canvas("magnitude", "Bode plot, magnitude");
  private readonly phase = this.canvas("phase", "Bode plot, phase");
  private readonly step = this.canvas("step", "Step of the closed loop of the fit");
  private readonly nichols = this.canvas("nichols", "Nichols plot of L");
  private readonly nyquist = this.canvas("nyquist", "Nyquist plot of L");
  private readonly readout = el("p", { class: "readout", id: "readout" });
  private readonly legend = el("ul", { class: "legend" });
  private readonly hidden = new Set<number>();
  private shown: Response = "L";
  private stepping = false;
  private cursorS: number | null = null;
  private readonly stepWords = el("p", { class: "readout", id: "step-words" });
  private chosen: number | null = null;
  private cursorHz: number | null = null;
  private hold: Hold | null = null;
  private carry: Carry | null = null;
  private traces: Trace[] = [];
  private others: Trace[] | null = null;
  private worst = 0;
  private readonly plots: Plot[];
  private measured = false;
  private readonly zoom = new Zoom((plot) => this.followers(plot), () => this.redraw());
  /** Where the cursor stands on each plot, in pixels. */
  private readonly marked = new Map<Plot, [number, number]>();
  private handlePlaces: { handle: Handle; px: number; py: number }[] = [];

  constructor(
    private readonly names: string[],
    private readonly asked: Asked,
  ) {
    const choice = el("fieldset", { class: "responses" }, el("legend", {}, "Bode plot of"));
    for (const name of RESPONSES) {
      const input = el("input", { type: "radio", name: "response", id: `response-${name}`, change: () => this.pick(name) });
      input.checked = name === this.shown;
      choice.append(el("label", { for: `response-${name}` }, input, name));
    }
    const steps = el("input", { type: "checkbox", id: "show-step", change: () => this.pickStep(steps.checked) });
    choice.append(el("label", { for: "show-step", title: "in place of the phase" }, steps, "step of the fit"));
    const points = el("details", { class: "points" }, el("summary", {}, `Operating points (${names.length})`), this.legend);
    if (names.length > 1) points.open = names.length <= 8;
    this.element.append(
      choice,
      el("div", { class: "bode" }, this.size.canvas, this.phase.canvas, this.step.canvas, this.stepWords),
      el("div", { class: "maps" }, this.nichols.canvas, this.nyquist.canvas),
      this.readout,
      el("p", { class: "key", "aria-hidden": "true" }, ...KEY.map(([name, words]) => el("span", { class: name }, words))),
      points,
    );
    this.fillLegend();
    this.plots = [this.size, this.phase, this.nichols, this.nyquist, this.step];
    for (const plot of this.plots) this.listen(plot);
    this.pickStep(false);
  }

  private canvas(id: string, label: string): Plot {
    const canvas = el("canvas", { id, tabindex: "0", role: "img", "aria-label": label });
    return new Plot(canvas, { low: 1, high: 10, log: true, label: "" }, { low: -1, high: 1, log: false, label: "" });
  }

  /** The step of the fit in place of the phase, or the phase. */
  private pickStep(on: boolean): void {
    this.stepping = on;
    this.phase.canvas.hidden = on;
    this.step.canvas.hidden = this.stepWords.hidden = !on;
    this.resized();
  }

  private pick(name: Response): void {
    this.shown = name;
    this.size.reset();
    this.phase.reset();
    this.redraw();
  }

  private fillLegend(): void {
    this.legend.replaceChildren(...this.names.map((name, k) => {
      const box = el("input", { type: "checkbox", id: `point-${k}`, change: () => {
        if (box.checked) this.hidden.delete(k);
        else this.hidden.add(k);
        this.redraw();
      } });
      box.checked = !this.hidden.has(k);
      const pick = el("button", { type: "button", class: "link", "aria-label": `highlight ${name}`, click: () => this.look(this.chosen === k ? null : k, null) }, name);
      return el("li", {}, el("label", { class: "check", for: `point-${k}` }, box, el("span", { class: "hidden-label" }, `show ${name}`)), pick);
    }));
  }

  /** Bring an operating point to the front, and the cursor to a frequency. */
  look(point: number | null, hz: number | null): void {
    this.chosen = point === this.worst ? null : point;
    if (hz !== null) this.cursorHz = hz;
    this.redraw();
  }

  draw(traces: Trace[], worst: number, others: Trace[] | null): void {
    [this.traces, this.worst, this.others] = [traces, worst, others];
    this.redraw();
  }

  get places(): Record<string, [number, number]> {
    return Object.fromEntries(this.handlePlaces.map(({ handle, px, py }) => [handle.label, [px, py]]));
  }

  private get front(): number {
    return this.chosen ?? this.worst;
  }

  /** Draws with sizes and colours as they are now. */
  resized(): void {
    this.measured = false;
    this.redraw();
  }

  private redraw(): void {
    if (!this.traces.length) return;
    if (!this.measured) {
      const colours = coloursOf(this.element);
      for (const plot of this.plots) plot.measure(colours);
      this.measured = true;
    }
    this.drawBode();
    if (this.stepping) this.drawStep();
    this.drawMap(this.nichols);
    this.drawMap(this.nyquist);
    this.readValues();
    [...this.legend.children].forEach((row, k) => row.classList.toggle("worst", k === this.worst));
  }

  /** Indices of operating points to draw, those in front last. */
  private order(): number[] {
    const rest = this.traces.map((_, k) => k).filter((k) => !this.hidden.has(k) && k !== this.worst && k !== this.chosen);
    const front = [this.worst, this.chosen].filter((k): k is number => k !== null && !this.hidden.has(k));
    return [...rest, ...new Set(front)];
  }

  private drawBode(): void {
    const responses = this.traces.map((trace) => responseOf(trace, this.shown));
    const [sizes, phases] = [responses.map(sizeDb), responses.map(phaseDeg)];
    if (!this.hold) {
      // axes stand still while something is dragged on them
      this.size.show(frequencyAxis(this.traces, this.stepping ? "frequency [Hz]" : ""), sizeAxis([...sizes, limitSizes(this.required, this.shown)], this.shown));
      this.phase.show(frequencyAxis(this.traces, "frequency [Hz]"), phaseAxis(phases));
    }
    for (const [plot, curves] of [[this.size, sizes], [this.phase, phases]] as const) {
      if (plot.canvas.hidden) continue;
      plot.start();
      this.guides(plot);
      if (this.others && !this.hidden.has(this.front)) {
        const other = responseOf(this.others[this.front], this.shown);
        const y = plot === this.size ? sizeDb(other) : phaseDeg(other);
        plot.curve({ x: this.others[this.front].f, y }, { colour: plot.colours.other, width: 2, dash: [7, 4] });
      }
      for (const k of this.order()) plot.curve({ x: this.traces[k].f, y: curves[k] }, this.style(plot, k));
      if (this.cursorHz !== null) {
        plot.upright(this.cursorHz, { colour: plot.colours.ink, width: 1, dash: [2, 3] });
        this.marked.set(plot, [plot.px(this.cursorHz), plot.py(interpolated(this.traces[this.front].f, curves[this.front], this.cursorHz))]);
      }
      this.marks(plot, curves[this.front]);
      if (plot === this.size && (this.shown === "L" || this.shown === "C")) this.drawHandles(curves[this.front]);
      plot.end();
    }
  }

  private drawStep(): void {
    const plot = this.step;
    const steps = new Map(this.order().map((k) => [k, this.asked.step(k, false)]));
    const front = steps.get(this.front) ?? null;
    const other = this.others && !this.hidden.has(this.front) ? this.asked.step(this.front, true) : null;
    if (!this.hold) plot.show(...stepAxes([...steps.values(), other], front));
    plot.start();
    plot.level(1, { colour: plot.colours.ink, width: 1, dash: [6, 3] });
    if (other) plot.curve({ x: other.timeS, y: other.y }, { colour: plot.colours.other, width: 2, dash: [7, 4] });
    for (const [k, one] of steps) if (one) plot.curve({ x: one.timeS, y: one.y }, this.style(plot, k));
    if (this.cursorS !== null) {
      plot.upright(this.cursorS, { colour: plot.colours.ink, width: 1, dash: [2, 3] });
      this.marked.set(plot, [plot.px(this.cursorS), plot.py(front ? interpolatedAt(front, this.cursorS) : 0)]);
    }
    plot.end();
    this.stepWords.textContent = this.wordsOfStep(front);
  }

  /** Of which fit the step in front is, and what is read off it. */
  private wordsOfStep(step: Step | null): string {
    const fit = this.asked.fit(this.front);
    const who = this.names[this.front];
    if (!fit) return `${who}: no fit of this FRF. Make one with loopshape fit, then write this page again.`;
    const quality = `misfit ${shown(fit.misfit_db)} dB, leaves ${fit.sufficient ? "nothing but noise" : "more than noise"}`;
    const model = `${who}: fit ${fit.structure.replaceAll("_", " ")} (${quality}), sampled, with the controller as it runs`;
    if (!step) return `${model}. Its closed loop does not come to rest: no step.`;
    const settles = Number.isNaN(step.settlingS) ? "not settled" : `within 2 % from ${shown(step.settlingS)} s on`;
    const there = this.cursorS === null ? "" : `; ${shown(interpolatedAt(step, this.cursorS))} at ${shown(this.cursorS)} s`;
    return `${model}. Overshoot ${shown(Number((100 * step.overshoot).toFixed(2)))} %, ${settles}${there}.`;
  }

  private style(plot: Plot, k: number): ReturnType<typeof styleOf> {
    return styleOf(plot, k, this.worst, this.chosen, this.traces.length === 1);
  }

  private get required(): RequiredLimits {
    return this.asked.required(this.front);
  }

  /** 0 dB, -180 degrees, and limits of the response that is shown. */
  private guides(plot: Plot): void {
    if (plot === this.size) sizeGuides(plot, this.shown, this.required);
    else if (this.shown === "L") phaseGuides(plot, this.required);
  }

  /** Crossovers, crossings of -180 degrees, and the margins between them and the guides, of the point in front. */
  private marks(plot: Plot, curve: ArrayLike<number>): void {
    if (this.shown !== "L" || this.hidden.has(this.front)) return;
    const trace = this.traces[this.front];
    const { paper, ink } = plot.colours;
    const value = (hz: number): number => interpolated(trace.f, curve, hz);
    const isSize = plot === this.size;
    const upright = (hz: number, from: number): void => plot.curve({ x: [hz, hz], y: [from, value(hz)] }, { colour: ink, width: 2 });
    for (const hz of unitCrossings(trace.f, trace.L)) {
      if (!isSize) upright(hz, -180 + 360 * Math.round((value(hz) + 180) / 360));
      plot.dot(hz, value(hz), 4, paper, ink);
    }
    for (const hz of axisCrossings(trace.f, trace.L)) {
      if (isSize) upright(hz, 0);
      plot.dot(hz, value(hz), 4, ink, ink);
    }
  }

  private drawHandles(curve: ArrayLike<number>): void {
    const trace = this.traces[this.front];
    const { x } = this.size;
    const edge = (hz: number, off: number): number => this.size.toX(this.size.px(hz) + off);
    const blocks = this.asked.design().blocks;
    // what lies left of the plot stands at its edge, side by side, and gains behind that
    let left = handlesOf(blocks, Infinity).filter(({ hz }) => hz < edge(x.low, 12)).length;
    const gainHz = edge(x.low, 12 + 22 * left);
    const { handle: colour, paper } = this.size.colours;
    this.handlePlaces = handlesOf(blocks, gainHz).map((handle) => {
      const outside = handle.name !== "gain" && handle.hz < edge(x.low, 12);
      const hz = outside ? edge(x.low, 12 + 22 * --left) : Math.min(handle.hz, edge(x.high, -12));
      const db = interpolated(trace.f, curve, hz);
      const on = this.hold?.handle.block === handle.block && this.hold.handle.name === handle.name;
      this.size.dot(hz, db, on ? 11 : 9, on ? colour : paper, colour);
      const [px, py] = [this.size.px(hz), this.size.py(db)];
      const { ctx } = this.size;
      ctx.fillStyle = on ? paper : colour;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.font = "bold 12px system-ui, sans-serif";
      ctx.fillText(handle.label, px, py + 0.5);
      return { handle, px, py };
    });
  }

  private drawMap(plot: Plot): void {
    const isNichols = plot === this.nichols;
    if (isNichols) {
      if (!this.carry) plot.show(LINEAR(-360, 0, "phase of L [deg]", 45), nicholsAxis(this.traces));
    } else {
      const tall = plot.height / Math.max(plot.width, 1);
      plot.show(LINEAR(-3, 1.5, "Re L", 0.5), LINEAR(-2.25 * tall, 2.25 * tall, "Im L", 0.5));
    }
    plot.start();
    (isNichols ? nicholsChart : nyquistChart)(plot, this.required);
    const curveOf = ({ L }: Trace) => (isNichols ? nicholsCurve(L) : { x: L.re, y: L.im });
    if (this.others && !this.hidden.has(this.front)) {
      plot.curve(curveOf(this.others[this.front]), { colour: plot.colours.other, width: 2, dash: [7, 4] });
    }
    for (const k of this.order()) plot.curve(curveOf(this.traces[k]), this.style(plot, k));
    if (this.cursorHz !== null && !this.hidden.has(this.front)) {
      const at = this.pointAt(this.traces[this.front], this.cursorHz);
      const one = curveOf({ ...this.traces[this.front], L: { re: Float64Array.of(at.re), im: Float64Array.of(at.im) } });
      plot.dot(one.x[0], one.y[0], 5, plot.colours.paper, plot.colours.ink);
      this.marked.set(plot, [plot.px(one.x[0]), plot.py(one.y[0])]);
    }
    plot.end();
  }

  private pointAt({ f, L }: Trace, hz: number): { re: number; im: number } {
    const k = nearestLine(f, hz);
    return { re: L.re[k], im: L.im[k] };
  }

  private readValues(): void {
    const trace = this.traces[this.front];
    const who = `${this.names[this.front]}${this.front === this.worst ? " (worst)" : ""}`;
    if (this.cursorHz === null) {
      this.readout.textContent = `In front: ${who}. Point at a plot to read its values.`;
      return;
    }
    const hz = this.cursorHz;
    const { re, im } = this.pointAt(trace, hz);
    const db = (x: number): string => shown(20 * Math.log10(x));
    const far = Math.hypot(1 + re, im);
    const size = Math.hypot(re, im);
    const phase = (Math.atan2(im, re) * 180) / Math.PI;
    const down = shown(Number((phase > 0 ? phase - 360 : phase).toFixed(1)));
    this.readout.textContent =
      `${shown(hz)} Hz, ${who}: |L| ${db(size)} dB, phase ${down}°, |S| ${db(1 / far)} dB, |T| ${db(size / far)} dB`;
  }

  private listen(plot: Plot): void {
    const { canvas } = plot;
    canvas.addEventListener("pointerdown", (event) => {
      this.hold = plot === this.size ? this.taken(event) : null;
      this.carry = plot === this.nichols ? this.curveTaken(event) : null;
      if (this.hold || this.carry) canvas.setPointerCapture(event.pointerId);
      else this.zoom.down(plot, event);
      this.redraw();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.hold) this.drag(event);
      else if (this.carry) this.carryOn(this.carry, event);
      else if (!this.zoom.move(plot, event)) this.point(plot, event);
    });
    const up = (): void => {
      if (this.hold || this.carry) this.asked.ended();
      this.hold = this.carry = null;
      this.zoom.up();
      this.redraw();
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("touchstart", (event) => {
      // a finger on a handle drags it, up and down too; elsewhere it scrolls the page
      const [touch, box] = [event.touches[0], canvas.getBoundingClientRect()];
      if (plot === this.size && this.nearest(touch.clientX - box.left, touch.clientY - box.top, FINGER)) event.preventDefault();
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.zoom.home(plot));
    canvas.addEventListener("wheel", (event) => this.wheel(plot, event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(plot, event));
  }

  private nearest(x: number, y: number, radius = 18): Handle | null {
    const far = this.handlePlaces.map(({ px, py }) => Math.hypot(px - x, py - y));
    const k = far.indexOf(Math.min(...far));
    return k >= 0 && far[k] < radius ? this.handlePlaces[k].handle : null;
  }

  private taken(event: PointerEvent): Hold | null {
    const handle = this.nearest(event.offsetX, event.offsetY, event.pointerType === "touch" ? FINGER : undefined);
    if (!handle) return null;
    event.preventDefault();
    const from = structuredClone(this.asked.design().blocks[handle.block]);
    return { handle, from, startHz: this.size.toX(event.offsetX), startDb: this.size.toY(event.offsetY) };
  }

  private drag(event: PointerEvent): void {
    const { handle, from, startHz, startDb } = this.hold as Hold;
    const hz = handle.hz * (this.size.toX(event.offsetX) / startHz);
    const up = this.size.toY(event.offsetY) - startDb;
    this.replace(handle.block, dragged(from, handle.name, Number(hz.toPrecision(5)), up));
  }

  /** The place of the curve in front under the mouse; a finger scrolls the page. */
  private curveTaken(event: PointerEvent): Carry | null {
    const at = this.onCurve(event);
    if (at === null || event.pointerType === "touch" || this.hidden.has(this.front)) return null;
    event.preventDefault();
    this.cursorHz = this.traces[this.front].f[at];
    return { from: structuredClone(this.asked.design().blocks), controller: this.asked.controller(), hz: this.cursorHz, x: event.offsetX, y: event.offsetY };
  }

  private onCurve(event: PointerEvent): number | null {
    const [k, far] = this.nichols.nearest(nicholsPlaces(this.traces[this.front].L), event.offsetX, event.offsetY);
    return far < NEAR ? k : null;
  }

  private carryOn({ from, controller, hz, x, y }: Carry, event: PointerEvent): void {
    const plot = this.nichols;
    const turn = Math.abs(event.offsetX - x) > SIDEWAYS ? plot.toX(event.offsetX) - plot.toX(x) : 0;
    const blocks = carried(controller, from, hz, plot.toY(event.offsetY) - plot.toY(y), turn);
    if (blocks) this.asked.change(blocks, true);
  }

  private replace(k: number, block: DesignBlock): void {
    this.asked.change(this.asked.design().blocks.map((one, i) => (i === k ? block : one)), true);
  }

  private point(plot: Plot, event: PointerEvent): void {
    if (plot === this.size) this.size.canvas.style.cursor = this.nearest(event.offsetX, event.offsetY) ? "grab" : "crosshair";
    if (plot === this.nichols) plot.canvas.style.cursor = this.onCurve(event) === null ? "crosshair" : "grab";
    if (plot === this.step) this.cursorS = Math.max(plot.toX(event.offsetX), 0);
    else if (plot === this.size || plot === this.phase) this.cursorHz = this.inRange(plot.toX(event.offsetX));
    else {
      const { f, L } = this.traces[this.front];
      this.cursorHz = f[plot.nearest(plot === this.nichols ? nicholsPlaces(L) : { x: L.re, y: L.im }, event.offsetX, event.offsetY)[0]];
    }
    this.redraw();
  }

  private inRange(hz: number): number {
    const { f } = this.traces[this.front];
    return f[nearestLine(f, hz)];
  }

  /** Magnitude and phase show the same frequencies. */
  private followers(plot: Plot): Plot[] {
    return plot === this.size ? [this.phase] : plot === this.phase ? [this.size] : [];
  }

  private wheel(plot: Plot, event: WheelEvent): void {
    const handle = plot === this.size ? this.nearest(event.offsetX, event.offsetY) : null;
    if (!handle) return this.zoom.wheel(plot, event);
    event.preventDefault();
    const share = event.shiftKey ? 1.01 : 1.05;
    this.replace(handle.block, widened(this.asked.design().blocks[handle.block], event.deltaY < 0 ? share : 1 / share));
  }

  private key(plot: Plot, event: KeyboardEvent): void {
    const { f } = this.traces[this.front];
    const k = placeIn(f, this.cursorHz ?? this.asked.crossover());
    const by = event.shiftKey ? 10 : 1;
    const steps: Partial<Record<string, () => void>> = {
      ArrowRight: () => this.moveCursor(plot, f, k, by),
      ArrowLeft: () => this.moveCursor(plot, f, k, -by),
      ArrowDown: () => this.look((this.front + 1) % this.traces.length, null),
      ArrowUp: () => this.look((this.front + this.traces.length - 1) % this.traces.length, null),
    };
    if (event.ctrlKey || event.metaKey) return;
    const step = steps[event.key];
    if (!step && !this.zoom.key(plot, event.key, this.marked.get(plot) ?? null)) return;
    event.preventDefault();
    step?.();
    this.redraw();
    const mark = step ? this.marked.get(plot) : null;
    if (!mark) return;
    plot.bring(mark);
    this.zoom.link(plot);
  }

  private moveCursor(plot: Plot, f: Float64Array, k: number, by: number): void {
    if (plot !== this.step) this.cursorHz = f[Math.min(Math.max(k + by, 0), f.length - 1)];
    else this.cursorS = Math.min(Math.max((this.cursorS ?? 0) + 0.005 * by * plot.x.high, 0), plot.x.high);
  }
}

function interpolatedAt({ timeS, y }: Step, at: number): number {
  const k = Math.min(Math.max(placeIn(timeS, at, true) - 1, 0), timeS.length - 2);
  const share = Math.min((at - timeS[k]) / (timeS[k + 1] - timeS[k]), 1);
  return y[k] + share * (y[k + 1] - y[k]);
}
