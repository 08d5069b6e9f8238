// A small canvas with two axes: grid, curves, marks and words, zoom, and what lies under the pointer.
// Curves of operating points lie on frequencies of their own, and Nichols and Nyquist are no functions of x: one layer
// draws them all, so that cursor, zoom and colours are one.

export interface Axis {
  low: number;
  high: number;
  log: boolean;
  label: string;
  ticks?: number;
}

export interface Colours {
  ink: string;
  quiet: string;
  grid: string;
  paper: string;
  point: string;
  worst: string;
  chosen: string;
  other: string;
  limit: string;
  handle: string;
}

export interface Style {
  colour: string;
  width?: number;
  dash?: number[];
  alpha?: number;
}

export type Curve = { x: ArrayLike<number>; y: ArrayLike<number> };

/** Places of a curve so near to the last one, in pixels, are not drawn. */
const FINE = 0.7;
const FONT = "12px system-ui, sans-serif";
const LEFT = 54;
const RIGHT = 10;
const TOP = 8;
const BOTTOM = 36;

/** The page's colours as its style sheet has them now: they differ by day and by night. */
export function coloursOf(element: Element): Colours {
  const style = getComputedStyle(element);
  const of = (name: string): string => style.getPropertyValue(`--${name}`).trim();
  return {
    ink: of("ink"), quiet: of("quiet"), grid: of("grid"), paper: of("paper"), point: of("point"),
    worst: of("worst"), chosen: of("chosen"), other: of("other"), limit: of("limit"), handle: of("handle"),
  };
}

function niceStep(span: number, count: number, steps: number[]): number {
  const coarse = span / count;
  const size = 10 ** Math.floor(Math.log10(coarse));
  const degrees = steps.find((step) => step >= coarse);
  if (span > 60 && degrees) return degrees;
  return ([1, 2, 5, 10].find((k) => k * size >= coarse) ?? 10) * size;
}

export function words(value: number): string {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return value.toExponential(1).replace("e+", "e");
  return String(Number(value.toPrecision(4)));
}

export class Plot {
  readonly ctx: CanvasRenderingContext2D;
  colours = {} as Colours;
  private home: { x: Axis; y: Axis };
  private zoomed = false;
  private above: (() => void)[] = [];
  width = 0;
  height = 0;

  constructor(
    readonly canvas: HTMLCanvasElement,
    public x: Axis,
    public y: Axis,
  ) {
    this.ctx = canvas.getContext("2d") as CanvasRenderingContext2D;
    this.home = { x: { ...x }, y: { ...y } };
  }

  get isZoomed(): boolean {
    return this.zoomed;
  }

  /** Axes to show unless the reader zoomed. */
  show(x: Axis, y: Axis): void {
    this.home = { x, y };
    if (!this.zoomed) [this.x, this.y] = [{ ...x }, { ...y }];
    else [this.x.label, this.y.label] = [x.label, y.label];
  }

  reset(): void {
    this.zoomed = false;
    [this.x, this.y] = [{ ...this.home.x }, { ...this.home.y }];
  }

  /** Frequencies shown, as another plot shows them. */
  follow(x: Axis): void {
    this.x = { ...this.x, low: x.low, high: x.high };
    this.zoomed = true;
  }

  zoom(factor: number, px: number, py: number): void {
    this.x = scaled(this.x, this.toX(px), factor);
    this.y = scaled(this.y, this.toY(py), factor);
    this.zoomed = true;
  }

  pan(dx: number, dy: number): void {
    const wide = this.width - LEFT - RIGHT;
    const tall = this.height - TOP - BOTTOM;
    this.x = moved(this.x, -dx / wide);
    this.y = moved(this.y, dy / tall);
    this.zoomed = true;
  }

  /** Where it is zoomed and a place lies outside, moves so that the place comes to the middle. */
  bring([px, py]: [number, number]): void {
    const inside = px >= LEFT && px <= this.width - RIGHT && py >= TOP && py <= this.height - BOTTOM;
    if (this.zoomed && !inside) this.pan(this.width / 2 - px, this.height / 2 - py);
  }

  /** Takes colours, and the size as laid out: asking for either lays the page out anew. */
  measure(colours: Colours): void {
    [this.colours, this.width, this.height] = [colours, this.canvas.clientWidth, this.canvas.clientHeight];
  }

  start(): void {
    const ratio = Math.max(window.devicePixelRatio || 1, this.canvas.closest(".printing") ? 3 : 1);
    const [w, h] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
    this.ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.ctx.fillStyle = this.colours.paper;
    this.ctx.fillRect(0, 0, this.width, this.height);
    this.ctx.font = FONT;
    this.ctx.lineJoin = "round";
    this.grid();
    this.ctx.save();
    this.ctx.beginPath();
    this.ctx.rect(LEFT, TOP, this.width - LEFT - RIGHT, this.height - TOP - BOTTOM);
    this.ctx.clip();
  }

  end(): void {
    for (const write of this.above.splice(0)) write();
    this.ctx.restore();
    this.ctx.strokeStyle = this.colours.quiet;
    this.ctx.lineWidth = 1;
    this.ctx.strokeRect(LEFT, TOP, this.width - LEFT - RIGHT, this.height - TOP - BOTTOM);
  }

  px(x: number): number {
    return LEFT + shareOf(this.x, x) * (this.width - LEFT - RIGHT);
  }

  py(y: number): number {
    return this.height - BOTTOM - shareOf(this.y, y) * (this.height - TOP - BOTTOM);
  }

  toX(px: number): number {
    return at(this.x, (px - LEFT) / (this.width - LEFT - RIGHT));
  }

  toY(py: number): number {
    return at(this.y, (this.height - BOTTOM - py) / (this.height - TOP - BOTTOM));
  }

  /** Whether a place lies on the paper, so many pixels within its edges. */
  holds(x: number, y: number, room = 0): boolean {
    const [px, py] = [this.px(x), this.py(y)];
    const across = px >= LEFT + room && px <= this.width - RIGHT - room;
    return across && py >= TOP + room && py <= this.height - BOTTOM - room;
  }

  /** Which place of a curve that is in view lies nearest to a pixel, and how far from it. */
  nearest({ x, y }: Curve, px: number, py: number): [number, number] {
    let [best, least] = [0, Infinity];
    for (let k = 0; k < x.length; k++) {
      const far = Math.hypot(this.px(x[k]) - px, this.py(y[k]) - py);
      if (far < least && this.holds(x[k], y[k], -1)) [best, least] = [k, far];
    }
    return [best, least];
  }

  private grid(): void {
    const { ctx, colours } = this;
    ctx.lineWidth = 1;
    ctx.fillStyle = colours.ink;
    ctx.textAlign = "center";
    ctx.textBaseline = "top";
    const [bottom, right] = [this.height - BOTTOM, this.width - RIGHT];
    let lastEnd = -Infinity;
    for (const [value, main] of this.ticksOf(this.x, this.width / 80)) {
      const x = Math.round(this.px(value)) + 0.5;
      this.hair(x, TOP, x, bottom, main ? 1 : 0.45);
      const text = words(value);
      const half = ctx.measureText(text).width / 2;
      if (!main || x - half < lastEnd + 6 || x + half > this.width) continue;
      ctx.fillText(text, x, bottom + 7);
      lastEnd = x + half;
    }
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    for (const [value, main] of this.ticksOf(this.y, this.height / 45)) {
      const y = Math.round(this.py(value)) + 0.5;
      this.hair(LEFT, y, right, y, main ? 1 : 0.45);
      if (main) ctx.fillText(words(value), LEFT - 5, y);
    }
    ctx.fillStyle = colours.quiet;
    ctx.textAlign = "center";
    ctx.textBaseline = "alphabetic";
    ctx.fillText(this.x.label, (LEFT + right) / 2, this.height - 5);
    ctx.save();
    ctx.translate(11, (TOP + bottom) / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.fillText(this.y.label, 0, 0);
    ctx.restore();
  }

  private hair(x0: number, y0: number, x1: number, y1: number, alpha: number): void {
    this.ctx.globalAlpha = alpha;
    this.ctx.strokeStyle = this.colours.grid;
    this.ctx.beginPath();
    this.ctx.moveTo(x0, y0);
    this.ctx.lineTo(x1, y1);
    this.ctx.stroke();
    this.ctx.globalAlpha = 1;
  }

  private ticksOf(axis: Axis, count: number): [number, boolean][] {
    const out: [number, boolean][] = [];
    if (!axis.log) {
      const span = axis.high - axis.low;
      const wanted = axis.ticks ?? niceStep(span, count, [10, 15, 30, 45, 60, 90, 180]);
      const step = span / wanted > 1.7 * count ? 2 * wanted : wanted;
      for (let k = Math.ceil(axis.low / step); k * step <= axis.high * (1 + 1e-12) + 1e-12; k++) out.push([k * step, true]);
      return out;
    }
    const few = axis.high / axis.low < 30;
    for (let p = Math.floor(Math.log10(axis.low)); p <= Math.log10(axis.high); p++) {
      for (let k = 1; k < 10; k++) {
        const value = k * 10 ** p;
        if (value >= axis.low && value <= axis.high) out.push([value, k === 1 || (few && [2, 5].includes(k)) || axis.high / axis.low < 4]);
      }
    }
    return out;
  }

  curve({ x, y }: Curve, { colour, width = 1.5, dash = [], alpha = 1 }: Style): void {
    const { ctx } = this;
    ctx.globalAlpha = alpha;
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.setLineDash(dash);
    ctx.beginPath();
    const { log, low } = this.x;
    const [left, wide] = [this.px(low), (this.width - LEFT - RIGHT) / (log ? Math.log(this.x.high / low) : this.x.high - low)];
    const [bottom, tall] = [this.py(0), this.py(1) - this.py(0)]; // no y is logarithmic
    let [down, a0, b0] = [false, 0, 0];
    for (let k = 0; k < x.length; k++) {
      const a = left + wide * (log ? Math.log(x[k] / low) : x[k] - low);
      const b = bottom + tall * y[k];
      if (!(Math.abs(a) < Infinity && Math.abs(b) < Infinity)) {
        down = false;
        continue;
      }
      if (down && k + 1 < x.length && Math.abs(a - a0) < FINE && Math.abs(b - b0) < FINE) continue;
      if (down) ctx.lineTo(a, clamp(b));
      else ctx.moveTo(a, clamp(b));
      [down, a0, b0] = [true, a, b];
    }
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
  }

  fill({ x, y }: Curve, colour: string, alpha: number): void {
    const { ctx } = this;
    ctx.globalAlpha = alpha;
    ctx.fillStyle = colour;
    ctx.beginPath();
    for (let k = 0; k < x.length; k++) ctx.lineTo(this.px(x[k]), clamp(this.py(y[k])));
    ctx.fill();
    ctx.globalAlpha = 1;
  }

  /** The area between two curves over the same x. */
  between(x: ArrayLike<number>, low: ArrayLike<number>, high: ArrayLike<number>, colour: string, alpha: number): void {
    const round = (up: ArrayLike<number>, down: ArrayLike<number>): number[] => [...Array.from(up), ...Array.from(down).reverse()];
    this.fill({ x: round(x, x), y: round(high, low) }, colour, alpha);
  }

  /** Places as small points. */
  points({ x, y }: Curve, colour: string, alpha: number): void {
    const { ctx } = this;
    ctx.globalAlpha = alpha;
    ctx.fillStyle = colour;
    for (let k = 0; k < x.length; k++) ctx.fillRect(this.px(x[k]) - 1, clamp(this.py(y[k])) - 1, 2, 2);
    ctx.globalAlpha = 1;
  }

  level(y: number, style: Style): void {
    this.curve({ x: [this.x.low, this.x.high], y: [y, y] }, style);
  }

  upright(x: number, style: Style): void {
    this.curve({ x: [x, x], y: [this.y.low, this.y.high] }, style);
  }

  dot(x: number, y: number, radius: number, fill: string, edge: string): void {
    const { ctx } = this;
    ctx.beginPath();
    ctx.arc(this.px(x), clamp(this.py(y)), radius, 0, 2 * Math.PI);
    ctx.fillStyle = fill;
    ctx.fill();
    ctx.lineWidth = 2;
    ctx.strokeStyle = edge;
    ctx.stroke();
  }

  cross(x: number, y: number, colour: string): void {
    const { ctx } = this;
    const [a, b] = [this.px(x), this.py(y)];
    ctx.strokeStyle = colour;
    ctx.lineWidth = 2.5;
    ctx.beginPath();
    ctx.moveTo(a - 6, b);
    ctx.lineTo(a + 6, b);
    ctx.moveTo(a, b - 6);
    ctx.lineTo(a, b + 6);
    ctx.stroke();
  }

  /** Words that stand above all curves, whenever they are given. */
  say(text: string, px: number, py: number, colour: string, align: CanvasTextAlign = "left"): void {
    this.above.push(() => this.text(text, px, py, colour, align));
  }

  /** Words with a halo of paper. */
  text(text: string, px: number, py: number, colour: string, align: CanvasTextAlign = "left"): void {
    const { ctx } = this;
    ctx.font = FONT;
    ctx.textAlign = align;
    ctx.textBaseline = "alphabetic";
    ctx.lineWidth = 3;
    ctx.strokeStyle = this.colours.paper;
    ctx.strokeText(text, px, py);
    ctx.fillStyle = colour;
    ctx.fillText(text, px, py);
  }
}

const clamp = (y: number): number => Math.max(-1e4, Math.min(1e4, y));

function shareOf({ low, high, log }: Axis, value: number): number {
  return log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}

function at({ low, high, log }: Axis, share: number): number {
  return log ? low * (high / low) ** share : low + (high - low) * share;
}

function scaled(axis: Axis, about: number, factor: number): Axis {
  if (axis.log) {
    return { ...axis, low: about * (axis.low / about) ** factor, high: about * (axis.high / about) ** factor };
  }
  return { ...axis, low: about + (axis.low - about) * factor, high: about + (axis.high - about) * factor };
}

function moved(axis: Axis, share: number): Axis {
  return { ...axis, low: at(axis, share), high: at(axis, 1 + share) };
}
