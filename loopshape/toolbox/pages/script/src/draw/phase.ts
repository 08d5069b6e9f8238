// Phase that goes on from frequency to frequency, brought to the turn nearest to -90 degrees at its start.

import { deg, type Complex, type Real } from "../numbers/arrays";

export function wrappedDown(z: Complex): Real {
  const out = new Float64Array(z.re.length);
  let before = 0;
  for (let k = 0; k < out.length; k++) {
    let phase = deg(Math.atan2(z.im[k], z.re[k]));
    const about = k === 0 ? -90 : before;
    phase -= 360 * Math.round((phase - about) / 360);
    out[k] = phase;
    if (Number.isFinite(phase)) before = phase;
  }
  return out;
}
