// Intervals and stability, then detuning margins, beside the page: some workers, each with its share of the operating
// points.

import type { Controller } from "./controller";
import type { Margins } from "./margins";
import { payloadOf, type Payload, type Raw, type Requirements } from "./payload";
import { Engine } from "./verdict";

/** What is asked about. */
export interface Asked {
  loop: number;
  controller: Controller;
  requirements: Requirements;
}

interface Task extends Asked {
  id: number;
}

interface Start {
  raw: Raw;
  share: number;
  of: number;
}

interface Answer {
  id: number;
  detuned: boolean;
  points: [number, Margins][];
}

/** Margins at all operating points; `detuned` tells that detuning margins are in them. */
export interface Worked extends Asked {
  margins: Margins[];
  detuned: boolean;
}

/** What runs in a worker: the newest task is done, those that it overtook are not; a margin at a time between messages. */
export function workHere(scope: DedicatedWorkerGlobalScope): void {
  let start: Start | null = null;
  const engines = new Map<number, Engine>();
  let payload: Payload | null = null;
  let next: Task | null = null;
  let current: Task | null = null;
  const engineOf = (loop: number, known: Payload): Engine => {
    const made = engines.get(loop) ?? new Engine(known, known.loops[loop], [...engines.values()][0]?.source);
    engines.set(loop, made);
    return made;
  };
  const work = (): void => {
    if (!next || !start || !payload) return;
    const task = next;
    [current, next] = [task, null];
    const engine = engineOf(task.loop, payload);
    const points: [number, Margins][] = [];
    for (let k = start.share; k < engine.size; k += start.of) points.push([k, engine.settled(k, task.controller, task.requirements)]);
    scope.postMessage({ id: task.id, detuned: false, points } satisfies Answer);
    setTimeout(() => detune(engine, task, points, 0), 0);
  };
  const detune = (engine: Engine, task: Task, points: [number, Margins][], at: number): void => {
    if (next || current !== task) return;
    if (at === points.length) {
      scope.postMessage({ id: task.id, detuned: true, points } satisfies Answer);
      return;
    }
    const [k, margins] = points[at];
    points[at] = [k, engine.detuned(k, task.controller, task.requirements, margins)];
    setTimeout(() => detune(engine, task, points, at + 1), 0);
  };
  scope.onmessage = ({ data }: MessageEvent<Start | Task>) => {
    if ("raw" in data) {
      start = data;
      payload = payloadOf(data.raw);
      return;
    }
    if (!next) setTimeout(work, 0);
    next = data;
  };
}

interface DedicatedWorkerGlobalScope {
  onmessage: ((event: MessageEvent) => void) | null;
  postMessage(message: unknown): void;
}

/** Shares of an answer that are still missing, and what came. */
interface Gathered {
  left: number;
  margins: Margins[];
}

/** Workers, and what they are asked. */
export class Pool {
  private readonly workers: Worker[];
  private task: Task | null = null;
  private gathered = new Map<boolean, Gathered>();
  private waiting: Task | null = null;
  private busy = false;
  private last = 0;

  constructor(raw: Raw, script: string, private readonly done: (worked: Worked) => void) {
    const most = Math.max(...raw.loops.map((loop) => loop.points.length));
    const count = Math.max(1, Math.min(4, (navigator.hardwareConcurrency || 2) - 1, most));
    const address = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
    this.workers = Array.from({ length: count }, (_, share) => {
      const worker = new Worker(address);
      worker.onmessage = ({ data }: MessageEvent<Answer>) => this.answered(data);
      worker.postMessage({ raw, share, of: count } satisfies Start);
      return worker;
    });
  }

  /** Ask; intervals under way are finished first, and of those that wait only the newest is done. */
  ask(asked: Asked): void {
    this.last += 1;
    this.waiting = { id: this.last, ...asked };
    if (!this.busy) this.send();
  }

  end(): void {
    for (const worker of this.workers) worker.terminate();
  }

  private send(): void {
    const task = this.waiting;
    if (!task) return;
    [this.waiting, this.task, this.busy] = [null, task, true];
    this.gathered = new Map([false, true].map((detuned) => [detuned, { left: this.workers.length, margins: [] }]));
    for (const worker of this.workers) worker.postMessage(task);
  }

  private answered({ id, detuned, points }: Answer): void {
    const { task } = this;
    const one = this.gathered.get(detuned);
    if (!task || !one || task.id !== id) return;
    for (const [k, margins] of points) one.margins[k] = margins;
    one.left -= 1;
    if (one.left) return;
    const { loop, controller, requirements } = task;
    if (!detuned) this.busy = false;
    this.done({ loop, controller, requirements, margins: one.margins, detuned });
    if (!detuned) this.send();
  }
}
