"""How far off are the zeros of real drives that are not EMPS? The force that acts at no speed, over the largest.

`python experiments/emps/zeros.py` writes zeros.csv; `ORDINARY_ZERO` of the servo axis comes from here.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, sosfiltfilt

HERE = Path(__file__).parent
DATA = Path(os.environ.get("LOOPSHAPE_DATA", HERE.parent.parent / ".." / "shared" / "data"))
PASS_HZ = 30.0
SLIDING = (0.003, 0.01, 0.03, 0.1)  # speed over the top speed at which friction has turned; the best is taken
EDGE = 200  # samples at both ends, where the low-pass settles


def main() -> None:
    """Write the table; says where the recordings are not there."""
    if not DATA.is_dir():
        print("the recordings are absent: set LOOPSHAPE_DATA to their folder")
        return
    rows = [*(qube(path) for path in sorted((DATA / "qube").glob("*.csv"))), *(bench(kind) for kind in "AB")]
    machines = {machine: max(r[4] for r in rows if r[0] == machine) for machine, *_ in rows}
    largest, n = max(machines.values()), len(machines)
    bound = round(largest * (n + 1) / n, 4)
    with (HERE / "zeros.csv").open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["machine", "recording", "zero", "largest", "share", "unit"])
        out.writerows([*rows, ["bound", f"largest of {n} machines times {n + 1}/{n}", "", "", bound, "1"]])
    print(*rows, f"bound {bound:.2%}", sep="\n")


def qube(path: Path) -> list:
    """A pendulum's arm: volts less what inertia, friction and the pendulum take, by least squares."""
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8", autostrip=True)
    volts, rate_hz = np.asarray(table["plant_input"], dtype=float), 500.0
    angle, pendulum = (np.asarray(table[c], dtype=float) for c in ("theta", "alpha"))
    swung = passed(pendulum, rate_hz)
    speed = np.gradient(passed(angle, rate_hz)) * rate_hz
    others = [np.gradient(speed) * rate_hz, speed, np.sin(swung), np.gradient(np.gradient(swung)) * rate_hz**2]
    zero = least(passed(volts, rate_hz), speed, others)
    return row("QUBE", path.stem, zero, volts, "V")


def bench(kind: str) -> list:
    """The Tokyo bench, in place under a multisine without a mean: the current's mean over whole periods."""
    current = loadmat(DATA / "tokyo_bench" / f"MultisineType{kind}.mat")["iq_adx"].ravel()
    return row("Tokyo bench", f"Type{kind}", float(current.mean()), current, "A")


def passed(values: np.ndarray, rate_hz: float) -> np.ndarray:
    """Behind the low-pass, forwards and backwards."""
    return np.asarray(sosfiltfilt(butter(4, PASS_HZ, fs=rate_hz, output="sos"), values))


def least(force: np.ndarray, speed: np.ndarray, others: list[np.ndarray]) -> float:
    """The constant in the best fit over the widths of sliding friction."""
    top, found = np.quantile(np.abs(speed), 0.999), []
    for width in SLIDING:
        columns = [np.ones_like(speed), np.tanh(speed / (width * top)), *others]
        a, b = np.stack(columns, axis=1)[EDGE:-EDGE], force[EDGE:-EDGE]
        x = np.linalg.lstsq(a, b, rcond=None)[0]
        found.append((float(np.std(b - a @ x)), float(x[0])))
    return min(found)[1]


def row(machine: str, recording: str, zero: float, force: np.ndarray, unit: str) -> list:
    """One line; the largest force is what one sample in a thousand passes, as for a servo axis."""
    largest = float(np.quantile(np.abs(force), 0.999))
    return [machine, recording, f"{zero:.4g}", f"{largest:.4g}", round(abs(zero) / largest, 4), unit]


if __name__ == "__main__":
    main()
