// What a drag, the wheel, a double click and keys do to what plots show; plots over the same frequencies move together.

import { focusedIn } from "../dom";
import type { Plot } from "./plot";

export class Zoom {
  private last: PointerEvent | null = null;

  constructor(
    /** Plots whose frequencies follow those of one. */
    private readonly followers: (plot: Plot) => Plot[],
    private readonly changed: () => void,
  ) {}

  /** Begins a drag; a finger scrolls the page. */
  down(plot: Plot, event: PointerEvent): void {
    if (event.pointerType === "touch") return;
    plot.canvas.setPointerCapture(event.pointerId);
    this.last = event;
  }

  /** Whether a drag is on; then the plot moved with it. */
  move(plot: Plot, event: PointerEvent): boolean {
    if (!this.last) return false;
    plot.pan(event.offsetX - this.last.offsetX, event.offsetY - this.last.offsetY);
    this.last = event;
    this.link(plot);
    return true;
  }

  up(): void {
    this.last = null;
  }

  /** The wheel zooms with Ctrl, and on the plot that has the focus; else it scrolls the page. */
  wheel(plot: Plot, event: WheelEvent): void {
    if (!event.ctrlKey && focusedIn(plot.canvas) !== plot.canvas) return;
    event.preventDefault();
    plot.zoom(event.deltaY > 0 ? 1.15 : 1 / 1.15, event.offsetX, event.offsetY);
    this.link(plot);
  }

  /** Whether a key zooms: + and - about a place, 0 shows all. */
  key(plot: Plot, key: string, place: [number, number] | null): boolean {
    const factors: Record<string, number> = { "+": 1 / 1.25, "-": 1.25 };
    if (key === "0") this.home(plot);
    else if (factors[key]) {
      plot.zoom(factors[key], ...(place ?? [plot.width / 2, plot.height / 2]));
      this.link(plot);
    } else return false;
    return true;
  }

  home(plot: Plot): void {
    for (const one of [plot, ...this.followers(plot)]) one.reset();
    this.changed();
  }

  link(plot: Plot): void {
    if (plot.isZoomed) for (const one of this.followers(plot)) one.follow(plot.x);
    this.changed();
  }
}
