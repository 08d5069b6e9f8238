// The plots of one loop in a report: curves of all operating points with their 95 % bands, linked by one marked frequency.

import { button, el } from "./dom";
import { limitSizes, phaseGuides, sizeGuides, type RequiredLimits } from "./draw/guides";
import { coloursOf, Plot, type Axis, type Curve, type Style } from "./draw/plot";
import { magnitudeWords, phaseWords, viewOf, type NearestPoint, type Ring, type View } from "./draw/reported";
import type { Point } from "./draw/reported";
import { frequencyAxis, interpolated, nearestLine, nicholsAxis, nicholsChart, phaseAxis, sizeAxis, type Response } from "./draw/views";
import { Zoom } from "./draw/zoom";

export interface Loop {
  points: Point[];
  required: RequiredLimits;
  rings: Ring[];
  /** Of more operating points than these the band shows of the marked one alone. */
  bandsAtOnce: number;
}

const SHOWN: Response[] = ["P", "L", "S", "T", "CS", "PS"];
const NONE: Axis = { low: 1, high: 10, log: true, label: "" };

/** One plot of the page, what it draws of each operating point, and how the reader's cursor stands on it. */
interface Panel {
  plot: Plot;
  name: Response;
  kind: string;
  views: View[];
}

export class Board {
  private readonly visible: boolean[];
  private readonly panels: Panel[];
  private readonly readout = el("output", { class: "readout", "aria-live": "polite", hidden: true });
  private readonly tip = el("div", { class: "tip", "aria-hidden": "true", hidden: true });
  private readonly zoom = new Zoom((plot) => this.followers(plot), () => this.draw());
  private readonly entries: HTMLElement[];
  private looks: { colour: string; dash: number[] }[] = [];
  private at: NearestPoint | null = null;
  private front: number | null = null;
  private waits = false;

  constructor(box: HTMLElement, private readonly loop: Loop) {
    this.visible = loop.points.map(() => true);
    this.panels = [...box.querySelectorAll<HTMLCanvasElement>("canvas[data-plot]")].map((canvas) => this.panelOf(canvas));
    box.append(this.readout);
    this.entries = [...box.querySelectorAll<HTMLElement>(".legend > li")];
    if (this.entries.length > 1) this.legend(box.querySelector(".legend") as HTMLElement);
    for (const panel of this.panels) this.listen(panel);
    this.drawNow();
  }

  private panelOf(canvas: HTMLCanvasElement): Panel {
    const [name, kind] = canvas.dataset.plot!.split("-") as [Response, string];
    const plot = new Plot(canvas, NONE, NONE);
    const panel = { plot, name, kind, views: this.loop.points.map((point) => viewOf(point, name, kind)) };
    plot.show(...this.axesOf(panel, canvas.dataset.label ?? ""));
    return panel;
  }

  private axesOf({ name, kind, views }: Panel, label: string): [Axis, Axis] {
    const { points, required } = this.loop;
    if (kind === "nichols") return [{ low: -360, high: 0, log: false, label: "phase of L [deg]", ticks: 45 }, nicholsAxis(points)];
    const curves = views.map(({ places }) => places.y as Float64Array);
    const hz = frequencyAxis(points, "frequency [Hz]");
    if (kind === "deg") return [hz, { ...phaseAxis(curves), label }];
    return [hz, { ...sizeAxis([...curves, limitSizes(required, name)], name, name === "P" || name === "L" ? 100 : 60), label }];
  }

  private followers(plot: Plot): Plot[] {
    if (!plot.x.log) return [];
    return this.panels.map((panel) => panel.plot).filter((one) => one !== plot && one.x.log);
  }

  /** Draws once before the browser paints, however often it is asked. */
  private draw(): void {
    if (this.waits) return;
    this.waits = true;
    requestAnimationFrame(() => this.drawNow());
  }

  drawNow(): void {
    this.waits = false;
    this.looks = this.entries.map((entry) => {
      const { stroke, strokeDasharray } = getComputedStyle(entry.querySelector("path") as SVGPathElement);
      return { colour: stroke, dash: strokeDasharray === "none" ? [] : strokeDasharray.split(/[ ,]+/).map(parseFloat) };
    });
    for (const panel of this.panels) this.drawPanel(panel);
  }

  private drawPanel(panel: Panel): void {
    const { plot, kind, name, views } = panel;
    const { required } = this.loop;
    plot.measure(coloursOf(plot.canvas));
    plot.start();
    if (kind === "nichols") nicholsChart(plot, required);
    else if (kind === "db") sizeGuides(plot, name, required);
    else if (name === "L") phaseGuides(plot, required);
    const shown = views.map((_, k) => k).filter((k) => this.visible[k]);
    for (const k of shown) this.drawBand(plot, views[k], k);
    for (const k of shown) plot.points(views[k].dots, this.looks[k].colour, 0.35 * this.dimmed(k));
    for (const k of shown) if (k !== this.front) plot.curve(views[k].curve, this.styleOf(k));
    if (this.front !== null && this.visible[this.front]) plot.curve(views[this.front].curve, this.styleOf(this.front));
    this.drawRings(panel);
    if (this.at) this.drawMark(plot, views[this.at.point].places, this.at.line);
    plot.end();
  }

  private drawBand(plot: Plot, { places, low, high }: View, k: number): void {
    const few = this.visible.length <= this.loop.bandsAtOnce;
    if (!low || !high || (!few && k !== this.front)) return;
    plot.between(places.x, low, high, this.looks[k].colour, k === this.front ? 0.3 : 0.22 * this.dimmed(k));
  }

  private dimmed(k: number): number {
    return this.front === null || this.front === k || this.visible.length === 1 ? 1 : 0.28;
  }

  private styleOf(k: number): Style {
    const isFront = k === this.front && this.visible.length > 1;
    return { ...this.looks[k], width: isFront ? 2.4 : 1.4, alpha: this.dimmed(k) };
  }

  /** Where requirements are worst, on the curves that show it. */
  private drawRings({ plot, name, kind, views }: Panel): void {
    for (const { plot: on, point, hz, outcome } of this.loop.rings) {
      if (on !== `${name}-${kind}` || !this.visible[point]) continue;
      const { f } = this.loop.points[point];
      if (hz < f[0] || hz > f[f.length - 1]) continue;
      const colour = getComputedStyle(plot.canvas).getPropertyValue(`--${outcome}`).trim();
      plot.dot(hz, interpolated(f, views[point].places.y, hz), 6, "transparent", colour);
    }
  }

  private drawMark(plot: Plot, { x, y }: Curve, k: number): void {
    if (plot.x.log) plot.upright(x[k], { colour: plot.colours.ink, width: 1, dash: [3, 3] });
    plot.dot(x[k], y[k], 4.5, plot.colours.paper, plot.colours.ink);
  }

  /** Marks one line of one operating point in every plot; `here` is the plot that gets the note. */
  private look(found: NearestPoint | null, here: Panel | null): void {
    this.at = found;
    this.front = found?.point ?? null;
    this.readout.hidden = this.tip.hidden = found === null;
    if (found && here) {
      this.readout.replaceChildren(...this.values(found));
      this.note(here, found);
    }
    this.draw();
  }

  private values({ point: k, line }: NearestPoint): HTMLElement[] {
    const point = this.loop.points[k];
    const head = el("span", {}, el("b", {}, point.name), ` ${point.label} at `, el("b", {}, `${shownHz(point.f[line])} Hz`));
    const values = SHOWN.filter((name) => name === "P" || point.L.re.length).map((name) => {
      const phase = name === "P" || name === "L" ? `, ${phaseWords(point, name, line)}` : "";
      return el("span", {}, el("b", {}, `|${name}| `), magnitudeWords(point, name, line) + phase);
    });
    return [head, ...values, el("small", {}, "in brackets the 95 % half width at this frequency")];
  }

  /** A note beside the mark that covers neither it nor the critical point. */
  private note({ plot, views, kind }: Panel, { point: k, line }: NearestPoint): void {
    const point = this.loop.points[k];
    const words = [point.label ? `${point.name}: ${point.label}` : point.name, `${shownHz(point.f[line])} Hz`, ...views[k].words(line)];
    this.tip.replaceChildren(...words.map((one) => el("div", {}, one)));
    const { canvas } = plot;
    canvas.parentElement!.append(this.tip);
    const [px, py] = [plot.px(views[k].places.x[line]), plot.py(views[k].places.y[line])];
    const [wide, tall] = [this.tip.offsetWidth, this.tip.offsetHeight];
    const critical = kind === "nichols" ? [plot.px(-180), plot.py(0)] : null;
    const corners = [[12, 12], [-12 - wide, 12], [12, -12 - tall], [-12 - wide, -12 - tall]];
    const good = corners.map(([dx, dy]) => [px + dx, py + dy]).find(([left, top]) => {
      const fits = left >= 0 && top >= 0 && left + wide <= plot.width && top + tall <= plot.height;
      const [cx, cy] = critical ?? [-1, -1];
      return fits && !(cx > left - 8 && cx < left + wide + 8 && cy > top - 8 && cy < top + tall + 8);
    }) ?? [px + 12, plot.height - tall];
    this.tip.style.left = `${canvas.offsetLeft + Math.max(0, Math.min(good[0], plot.width - wide))}px`;
    this.tip.style.top = `${canvas.offsetTop + good[1]}px`;
  }

  private listen(panel: Panel): void {
    const { plot } = panel;
    const { canvas } = plot;
    const point = (event: PointerEvent | MouseEvent): void => this.look(this.nearest(panel, event.offsetX, event.offsetY), panel);
    canvas.addEventListener("pointerdown", (event) => this.zoom.down(plot, event));
    canvas.addEventListener("pointermove", (event) => {
      if (!this.zoom.move(plot, event) && event.pointerType !== "touch") point(event);
    });
    canvas.addEventListener("pointerup", () => this.zoom.up());
    canvas.addEventListener("pointercancel", () => this.zoom.up());
    canvas.addEventListener("click", point);
    canvas.addEventListener("pointerleave", (event) => event.pointerType !== "touch" && this.look(null, null));
    canvas.addEventListener("dblclick", () => this.zoom.home(plot));
    canvas.addEventListener("wheel", (event) => this.zoom.wheel(plot, event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(panel, event));
  }

  /** The line of all visible operating points that lies nearest to a place on a plot. */
  private nearest({ plot, views }: Panel, px: number, py: number): NearestPoint | null {
    const found = views.map(({ places }, point) => {
      const [line, far] = this.visible[point] ? plot.nearest(places, px, py) : [0, Infinity];
      return { point, line, far };
    });
    const best = found.reduce((a, b) => (b.far < a.far ? b : a));
    return best.far < Infinity ? best : null;
  }

  private key(panel: Panel, event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey) return;
    const by = event.shiftKey ? 10 : 1;
    const steps: Record<string, [number, number]> = {
      ArrowLeft: [-by, 0], ArrowRight: [by, 0], ArrowUp: [0, -1], ArrowDown: [0, 1], Home: [-Infinity, 0], End: [Infinity, 0],
    };
    const step: [number, number] | undefined = steps[event.key];
    if (step) this.step(panel, ...step);
    else if (event.key === "Escape") this.look(null, null);
    else if (!this.zoom.key(panel.plot, event.key, this.markOn(panel))) return;
    event.preventDefault();
  }

  private markOn({ plot, views }: Panel): [number, number] | null {
    if (!this.at) return null;
    const { x, y } = views[this.at.point].places;
    return [plot.px(x[this.at.line]), plot.py(y[this.at.line])];
  }

  /** Moves the mark along a curve, or across to the next operating point at the nearest frequency. */
  private step(panel: Panel, lines: number, across: number): void {
    const { points } = this.loop;
    const shown = points.map((_, k) => k).filter((k) => this.visible[k]);
    if (!shown.length) return;
    const now = this.at ?? { point: shown[0], line: Math.floor(points[shown[0]].f.length / 2) };
    const point = across ? shown[(Math.max(0, shown.indexOf(now.point)) + across + shown.length) % shown.length] : now.point;
    const { f } = points[point];
    const line = point === now.point ? now.line : nearestLine(f, points[now.point].f[now.line]);
    const moved = this.at ? Math.min(Math.max(line + lines, 0), f.length - 1) : line;
    this.look({ point, line: moved }, panel);
    panel.plot.bring(this.markOn(panel) as [number, number]);
    this.zoom.link(panel.plot);
    this.note(panel, { point, line: moved });
  }

  private legend(list: HTMLElement): void {
    const boxes = this.entries.map((entry, k) => {
      const box = el("input", { type: "checkbox", change: () => this.set(k, box.checked) });
      box.checked = true;
      entry.replaceChildren(el("label", {}, box, ...entry.childNodes));
      entry.addEventListener("pointerenter", () => this.raise(this.visible[k] ? k : null));
      entry.addEventListener("pointerleave", () => this.raise(null));
      return box;
    });
    const choose = (words: string, wanted: (k: number) => boolean): HTMLElement =>
      button(words, words, () => boxes.forEach((box, k) => this.set(k, (box.checked = wanted(k)))));
    const flagged = this.entries.map((entry) => entry.querySelector(".flag") !== null);
    const choices = [choose("Show all", () => true), choose("Hide all", () => false)];
    if (flagged.includes(true)) choices.push(choose("Only the worst", (k) => flagged[k]));
    list.before(el("div", { class: "controls", role: "group", "aria-label": "Operating points shown" }, ...choices));
  }

  private raise(point: number | null): void {
    this.front = point;
    this.draw();
  }

  private set(k: number, on: boolean): void {
    this.visible[k] = on;
    this.entries[k].classList.toggle("hidden-op", !on);
    if (this.at && !this.visible[this.at.point]) this.look(null, null);
    this.draw();
  }
}

const shownHz = (hz: number): string => String(Number(hz.toPrecision(6)));
