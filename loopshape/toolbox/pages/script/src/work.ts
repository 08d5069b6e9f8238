// Intervals and stability, then detuning margins, beside the page: some workers, each with its share of the operating
// points; and tunings.

import type { Design } from "./design/design";
import type { Controller } from "./numbers/controller";
import type { Margins } from "./loop/margins";
import { payloadOf, type Payload, type Raw, type Requirements } from "./payload";
import { Engine } from "./loop/verdict";
import { tuned, type Tuned } from "./design/tune";

/** What is asked about. */
export interface Asked {
  loop: number;
  controller: Controller;
  requirements: Requirements;
  /** When the design changed to this one. */
  at: number;
}

interface Task extends Asked {
  id: number;
}

/** A design to be tuned for a bandwidth, from where it stands. */
export interface Tuning {
  loop: number;
  design: Design;
  from_hz: number;
  hz: number;
}

interface Start {
  raw: Raw;
  share: number;
  of: number;
}

/** What an answer has: intervals and stability, detuning margins too, and those of single resonances. */
export const DETUNED = ["detuning", "resonances"] as const;
export const STAGES = ["intervals", ...DETUNED] as const;
export type Stage = (typeof STAGES)[number];

interface Answer {
  id: number;
  stage: Stage;
  points: [number, Margins][];
}

interface Done {
  tuned: Tuned;
}

/** Milliseconds that a tuning may take: for one operating point, and for each one more. */
const [TUNING, MORE] = [2000, 100];

/** Margins at all operating points. */
export interface Worked extends Asked {
  margins: Margins[];
  stage: Stage;
}

/** Detuning that takes no longer, in ms, is finished while something is dragged; what takes longer waits for a pause. */
const [QUICK, PAUSE] = [30, 60];

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
  const tell = (task: Task, stage: Stage, points: [number, Margins][]): void => scope.postMessage({ id: task.id, stage, points } satisfies Answer);
  const work = (): void => {
    if (!next || !start || !payload) return;
    const task = next;
    [current, next] = [task, null];
    const engine = engineOf(task.loop, payload);
    const points: [number, Margins][] = [];
    for (let k = start.share; k < engine.size; k += start.of) points.push([k, engine.settled(k, task.controller, task.requirements)]);
    tell(task, "intervals", points);
    const steps = stepsOf(engine, task, points);
    if (took < QUICK) atOnce(steps);
    else setTimeout(() => inPieces(task, steps), PAUSE);
  };
  /** Milliseconds that the last detuning took. */
  let took = Infinity;
  /** All detuning of a task, a piece at a time: first of whole plants, then of single resonances. */
  function* stepsOf(engine: Engine, task: Task, points: [number, Margins][]): Generator<void> {
    let spent = 0;
    for (const stage of DETUNED) {
      for (const one of points) {
        const start_ms = performance.now();
        one[1] = engine[stage](one[0], task.controller, task.requirements, one[1]);
        spent += performance.now() - start_ms;
        yield;
      }
      tell(task, stage, points);
    }
    took = spent;
  }
  const atOnce = (steps: Generator<void>): void => {
    while (!steps.next().done);
  };
  const inPieces = (task: Task, steps: Generator<void>): void => {
    if (!next && current === task && !steps.next().done) setTimeout(() => inPieces(task, steps), 0);
  };
  scope.onmessage = ({ data }: MessageEvent<Start | Task | Tuning>) => {
    if ("raw" in data) {
      start = data;
      payload = payloadOf(data.raw);
      return;
    }
    if ("design" in data) {
      const engine = engineOf(data.loop, payload as Payload);
      scope.postMessage({ tuned: tuned(engine, data.design, data.from_hz, data.hz, TUNING + MORE * (engine.size - 1)) } satisfies Done);
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

/** A task that is under way: shares of each answer that are still missing, and what came. */
interface Open {
  task: Task;
  answers: Map<Stage, { left: number; margins: Margins[] }>;
}

/** Workers, and what they are asked. */
export class Pool {
  private readonly workers: Worker[];
  private open: Open[] = [];
  private waiting: Task | null = null;
  private busy = false;
  private last = 0;
  private readonly tunings: ((found: Tuned) => void)[] = [];

  constructor(raw: Raw, script: string, private readonly done: (worked: Worked) => void) {
    const most = Math.max(...raw.loops.map((loop) => loop.points.length));
    const count = Math.max(1, Math.min(4, (navigator.hardwareConcurrency || 2) - 1, most));
    const address = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
    this.workers = Array.from({ length: count }, (_, share) => {
      const worker = new Worker(address);
      worker.onmessage = ({ data }: MessageEvent<Answer | Done>) => ("tuned" in data ? this.tunings.shift()?.(data.tuned) : this.answered(data));
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

  /** A design tuned for a bandwidth, in the first worker. */
  tune(asked: Tuning): Promise<Tuned> {
    this.workers[0].postMessage(asked);
    return new Promise((done) => this.tunings.push(done));
  }

  end(): void {
    for (const worker of this.workers) worker.terminate();
  }

  private send(): void {
    const task = this.waiting;
    if (!task) return;
    [this.waiting, this.busy] = [null, true];
    this.open = [...this.open.slice(-2), { task, answers: new Map() }];
    for (const worker of this.workers) worker.postMessage(task);
  }

  private answered({ id, stage, points }: Answer): void {
    const open = this.open.find(({ task }) => task.id === id);
    if (!open) return;
    const one = open.answers.get(stage) ?? { left: this.workers.length, margins: [] };
    open.answers.set(stage, one);
    for (const [k, margins] of points) one.margins[k] = margins;
    one.left -= 1;
    if (one.left) return;
    if (stage !== "intervals") this.open = this.open.filter(({ task }) => task.id >= id); // older ones were overtaken
    if (stage === "intervals") this.busy = false;
    this.done({ ...open.task, margins: one.margins, stage });
    if (stage === "intervals") this.send();
  }
}
