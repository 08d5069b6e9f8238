// Cubic splines through given places, their third derivative continuous at the second and the last but one (de Boor).

import type { Complex, Real } from "./arrays";

/** Slopes at the places of a complex spline. */
export function slopes(x: Real, values: Complex): Complex {
  return { re: slopesOf(x, values.re), im: slopesOf(x, values.im) };
}

function slopesOf(x: Real, y: Real): Real {
  const n = x.length;
  const dx = x.subarray(1).map((value, k) => value - x[k]);
  const rise = dx.map((step, k) => (y[k + 1] - y[k]) / step);
  if (n === 2) return Float64Array.of(rise[0], rise[0]);
  if (n === 3) return parabola(dx, rise);
  const lower = new Float64Array(n);
  const middle = new Float64Array(n);
  const upper = new Float64Array(n);
  const right = new Float64Array(n);
  for (let k = 1; k < n - 1; k++) {
    lower[k] = dx[k];
    middle[k] = 2 * (dx[k - 1] + dx[k]);
    upper[k] = dx[k - 1];
    right[k] = 3 * (dx[k] * rise[k - 1] + dx[k - 1] * rise[k]);
  }
  const first = x[2] - x[0];
  middle[0] = dx[1];
  upper[0] = first;
  right[0] = ((dx[0] + 2 * first) * dx[1] * rise[0] + dx[0] ** 2 * rise[1]) / first;
  const last = x[n - 1] - x[n - 3];
  middle[n - 1] = dx[n - 3];
  lower[n - 1] = last;
  right[n - 1] = (dx[n - 2] ** 2 * rise[n - 3] + (2 * last + dx[n - 2]) * dx[n - 3] * rise[n - 2]) / last;
  return solved(lower, middle, upper, right);
}

function parabola(dx: Real, rise: Real): Real {
  const bend = (rise[1] - rise[0]) / (dx[0] + dx[1]);
  const middle = rise[0] + bend * dx[0];
  return Float64Array.of(rise[0] - bend * dx[0], middle, rise[1] + bend * dx[1]);
}

function solved(lower: Real, middle: Real, upper: Real, right: Real): Real {
  const n = right.length;
  for (let k = 1; k < n; k++) {
    const share = lower[k] / middle[k - 1];
    middle[k] -= share * upper[k - 1];
    right[k] -= share * right[k - 1];
  }
  right[n - 1] /= middle[n - 1];
  for (let k = n - 2; k >= 0; k--) right[k] = (right[k] - upper[k] * right[k + 1]) / middle[k];
  return right;
}

/** Value `at` a place in the k-th gap. */
export function valueAt(x: Real, y: Real, slope: Real, k: number, at: number): number {
  const step = x[k + 1] - x[k];
  const rise = (y[k + 1] - y[k]) / step;
  const t = (slope[k] + slope[k + 1] - 2 * rise) / step;
  const off = at - x[k];
  return y[k] + off * (slope[k] + off * ((rise - slope[k]) / step - t + (off * t) / step));
}
