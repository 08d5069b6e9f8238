// The report's script: plots of each loop, tables that sort, frames that the keyboard reaches. No network, no storage.

import { Board, type Loop } from "./board";
import { el } from "./dom";
import { unpacked } from "./numbers/arrays";
import type { Requirements } from "./payload";
import { pointOf, type RawReport } from "./draw/reported";

const root = document.documentElement;

function loopsOf(raw: RawReport): Loop[] {
  return raw.loops.map(({ points, requirements, rings }) => {
    const every = requirements ?? ({ loop: "" } as Requirements);
    const required = { requirements: every, every, limits: raw.limits };
    return { points: points.map(pointOf), required, rings, bandsAtOnce: raw.bands_at_once };
  });
}

/** A cell's number; NaN where there is none. */
function valueOf(cell: HTMLTableCellElement): number {
  const words = cell.dataset.value;
  return words === undefined ? NaN : Number(words.replace("inf", "Infinity"));
}

/** Rising order of two cells; what is not there stands last in both orders. */
function compare(a: HTMLTableCellElement, b: HTMLTableCellElement, rising: boolean): number {
  const [x, y] = [valueOf(a), valueOf(b)];
  const sign = rising ? 1 : -1;
  if (Number.isNaN(x) && Number.isNaN(y)) return sign * a.textContent!.localeCompare(b.textContent!, "en", { numeric: true });
  if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
  return x === y ? 0 : sign * (x < y ? -1 : 1);
}

function sortable(table: HTMLTableElement): void {
  const heads = [...table.tHead!.rows[0].cells];
  const [body] = table.tBodies;
  heads.forEach((head, column) => {
    const sort = (): void => {
      const rising = head.ariaSort !== "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.ariaSort = rising ? "ascending" : "descending";
      body.append(...[...body.rows].sort((a, b) => compare(a.cells[column], b.cells[column], rising)));
    };
    head.replaceChildren(el("button", { type: "button", click: sort }, ...head.childNodes));
  });
}

/** A frame that scrolls must be reached by the keyboard. */
function reachable(): void {
  for (const frame of document.querySelectorAll<HTMLElement>(".scroll")) {
    if (frame.scrollWidth <= frame.clientWidth + 1) continue;
    frame.tabIndex = 0;
    frame.role = "region";
    frame.ariaLabel = "Table that scrolls sideways";
  }
}

function measure(): void {
  root.dataset.width = String(root.clientWidth);
  root.dataset.overflow = String(root.scrollWidth - root.clientWidth);
  reachable();
}

function start(): void {
  let errors = 0;
  window.addEventListener("error", () => (root.dataset.errors = String(++errors)));
  root.dataset.errors = "0";
  root.classList.add("js");
  const loops = loopsOf(unpacked(JSON.parse(document.getElementById("report-data")!.textContent!)) as RawReport);
  const boards = [...document.querySelectorAll<HTMLElement>(".plots")].map((box, k) => new Board(box, loops[k]));
  const draw = (): void => boards.forEach((board) => board.drawNow());
  document.querySelectorAll<HTMLTableElement>("table.sortable").forEach(sortable);
  window.addEventListener("beforeprint", () => {
    for (const part of document.querySelectorAll<HTMLDetailsElement>("details:not(.screen)")) part.open = true;
    root.classList.add("printing");
    draw();
  });
  window.addEventListener("afterprint", () => {
    root.classList.remove("printing");
    draw();
  });
  window.addEventListener("resize", () => {
    measure();
    draw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  measure();
  root.dataset.report = "ready";
}

start();
