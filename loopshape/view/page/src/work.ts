// Intervals and stability beside the page: some workers, each with its share of the operating points.

import type { Controller } from "./controller";
import type { Margins } from "./margins";
import { payloadOf, type Payload, type Raw } from "./payload";
import { Engine } from "./verdict";

interface Task {
  id: number;
  loop: number;
  controller: Controller;
  fromHz: number | null;
}

interface Start {
  raw: Raw;
  share: number;
  of: number;
}

interface Answer {
  id: number;
  points: [number, Margins][];
}

export interface Worked {
  controller: Controller;
  fromHz: number | null;
  loop: number;
  margins: Margins[];
}

/** What runs in a worker: the newest task is done, those that it overtook are not. */
export function workHere(scope: DedicatedWorkerGlobalScope): void {
  let start: Start | null = null;
  const engines = new Map<number, Engine>();
  let payload: Payload | null = null;
  let next: Task | null = null;
  const work = (): void => {
    if (!next || !start || !payload) return;
    const task = next;
    next = null;
    const known = engines.get(task.loop) ?? new Engine(payload, payload.loops[task.loop], [...engines.values()][0]?.source);
    engines.set(task.loop, known);
    const points: [number, Margins][] = [];
    for (let k = start.share; k < known.size; k += start.of) points.push([k, known.settled(k, task.controller, task.fromHz)]);
    scope.postMessage({ id: task.id, points } satisfies Answer);
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

/** Workers, and what they are asked. */
export class Pool {
  private readonly workers: Worker[];
  private readonly asked = new Map<number, { task: Task; left: number; margins: Margins[] }>();
  private waiting: Task | null = null;
  private busy = 0;
  private last = 0;

  constructor(raw: Raw, script: string, done: (worked: Worked) => void) {
    const most = Math.max(...raw.loops.map((loop) => loop.points.length));
    const count = Math.max(1, Math.min(4, (navigator.hardwareConcurrency || 2) - 1, most));
    const address = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
    this.workers = Array.from({ length: count }, (_, share) => {
      const worker = new Worker(address);
      worker.onmessage = ({ data }: MessageEvent<Answer>) => this.answered(data, done);
      worker.postMessage({ raw, share, of: count } satisfies Start);
      return worker;
    });
  }

  /** Ask about a controller; what is under way is finished first, and of those that wait only the newest is done. */
  ask(loop: number, controller: Controller, fromHz: number | null): void {
    this.last += 1;
    this.waiting = { id: this.last, loop, controller, fromHz };
    if (!this.busy) this.send();
  }

  private send(): void {
    const task = this.waiting;
    if (!task) return;
    this.waiting = null;
    this.busy = this.workers.length;
    this.asked.set(task.id, { task, left: this.workers.length, margins: [] });
    for (const worker of this.workers) worker.postMessage(task);
  }

  private answered({ id, points }: Answer, done: (worked: Worked) => void): void {
    const one = this.asked.get(id);
    if (!one) return;
    for (const [k, margins] of points) one.margins[k] = margins;
    one.left -= 1;
    if (one.left) return;
    this.asked.delete(id);
    this.busy = 0;
    const { controller, fromHz, loop } = one.task;
    done({ controller, fromHz, loop, margins: one.margins });
    this.send();
  }
}
