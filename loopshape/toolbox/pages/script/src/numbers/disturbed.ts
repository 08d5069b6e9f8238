// What disturbed a loop when it was recorded, under another controller (Python: `Carried.through` of loop/margin/disturbed.py).

import type { Complex, Real } from "./arrays";
import { response, type Controller } from "./controller";

/** Power of the error on its lines under the old controller, the plant and that controller there, and how noise of the
 * plant biases squares; the rms then. */
export interface Disturbance {
  f: Real;
  power: Real;
  P: Complex;
  C0: Complex;
  bias: Real;
  rms: number;
}

/** Rms of the error and of the plant's input. */
export interface Rms {
  error: number;
  control: number;
}

/** What a stable loop makes of it under a controller. */
export function rmsUnder({ f, power, P, C0, bias }: Disturbance, controller: Controller): Rms {
  const C1 = response(controller, f);
  let [error, control] = [0, 0];
  for (let k = 0; k < f.length; k++) {
    const size = P.re[k] ** 2 + P.im[k] ** 2;
    const one = (C: Complex): number => (1 + C.re[k] * P.re[k] - C.im[k] * P.im[k]) ** 2 + (C.re[k] * P.im[k] + C.im[k] * P.re[k]) ** 2;
    const under = one(C1);
    const moved = (size * ((C0.re[k] - C1.re[k]) ** 2 + (C0.im[k] - C1.im[k]) ** 2)) / under;
    const kept = power[k] * Math.max((one(C0) - moved * bias[k]) / under, 0);
    error += kept;
    control += kept * (C1.re[k] ** 2 + C1.im[k] ** 2);
  }
  return { error: Math.sqrt(error), control: Math.sqrt(control) };
}
