// Special functions that intervals are read from (Python: scipy.special).

import { TWO_PI } from "./arrays";

/** Normal distribution function of numbers at or below zero: by its series near zero, by a continued fraction beyond. */
export function normalBelow(x: number): number {
  if (!(x > -9)) return 0; // below 1e-18
  const density = Math.exp(-0.5 * x * x) / Math.sqrt(TWO_PI);
  const size = -x;
  if (size < 3) {
    let [term, total] = [size, size];
    for (let k = 1; k < 100; k++) {
      term *= (size * size) / (2 * k + 1);
      total += term;
    }
    return 0.5 - density * total;
  }
  let fraction = 0;
  for (let k = 80; k > 0; k--) fraction = k / (size + fraction);
  return density / (size + fraction);
}

/** ln of the gamma function (Lanczos 1964). */
function lnGamma(x: number): number {
  const [first, ...rest] = [
    0.99999999999980993, 676.5203681218851, -1259.1392167224028, 771.32342877765313, -176.61502916214059, 12.507343278686905,
    -0.13857109526572012, 9.9843695780195716e-6, 1.5056327351493116e-7,
  ];
  const t = x + 6.5;
  return 0.5 * Math.log(2 * Math.PI) + (x - 0.5) * Math.log(t) - t + Math.log(rest.reduce((sum, c, k) => sum + c / (x + k), first));
}

/** The regularised lower incomplete gamma function, by its series or its continued fraction (Lentz). */
function gammaBelow(a: number, x: number): number {
  if (x <= 0) return 0;
  const front = Math.exp(a * Math.log(x) - x - lnGamma(a));
  if (x < a + 1) {
    let [term, total] = [1 / a, 1 / a];
    for (let k = 1; term > 1e-17 * total; k++) total += term *= x / (a + k);
    return front * total;
  }
  let [b, c, d] = [x + 1 - a, 1e300, 1 / (x + 1 - a)];
  let h = d;
  for (let k = 1; k < 100000; k++) {
    b += 2;
    d = 1 / (k * (a - k) * d + b);
    c = b + (k * (a - k)) / c;
    h *= c * d;
    if (Math.abs(c * d - 1) < 1e-15) break;
  }
  return 1 - front * h;
}

/** Where the regularised lower incomplete gamma function is `level`. */
export function gammaInverse(a: number, level: number): number {
  let [low, high] = [0, a + 1];
  while (gammaBelow(a, high) < level) high *= 2;
  for (let k = 0; k < 100 && high - low > 1e-15 * high; k++) {
    const middle = 0.5 * (low + high);
    if (gammaBelow(a, middle) < level) low = middle;
    else high = middle;
  }
  return 0.5 * (low + high);
}

/** Where a normal number lies above with a small chance. */
export function normalAbove(chance: number): number {
  let [low, high] = [0, 9];
  for (let k = 0; k < 60; k++) {
    const middle = 0.5 * (low + high);
    if (normalBelow(-middle) > chance) low = middle;
    else high = middle;
  }
  return 0.5 * (low + high);
}
