// Which operating point to look at first (Python: loop/points.py).

import { SEVERITY, type Row, type Verdict } from "./verdict";

const CLOSENESS = [
  "modulus_margin", "sensitivity_peak_db", "disk_margin", "phase_margin_deg", "gain_margin_db",
  "gain_reduction_margin_db", "delay_margin_s", "complementary_peak_db",
];
const RANK = { unstable: 0, undecided: 1, stable: 2 };

/** First what is unstable or undecided, then where the worst row about -1 is missed, else what comes nearest to -1. */
export function worstOf(found: Verdict): number {
  const ranks = found.margins.map((m) => (m.stability ? RANK[m.stability.outcome] : 2));
  const least = Math.min(...ranks);
  const missed = found.rows.filter((row) => CLOSENESS.includes(row.quantity) && row.outcome !== "passed");
  if (least === 2 && missed.length) return missed.reduce((a, b) => (order(b) < order(a) ? b : a)).point;
  const near = found.margins.map((m) => m.intervals.modulus_margin?.[0] ?? m.values.modulus_margin);
  return near.reduce((best, value, k) => {
    if (ranks[k] !== least) return best;
    return best < 0 || value < near[best] ? k : best;
  }, -1);
}

const order = (row: Row): number => SEVERITY[row.outcome] * 100 + CLOSENESS.indexOf(row.quantity);
