"""Makes the recordings of this example from those of their source, at a constant rate.

python examples/double_pendulum/make.py FOLDER      (holds trajectory_NN.csv or .parquet)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

HERE = Path(__file__).parent
RATE_HZ, FROM_S, TO_S = 500.0, 1.0, 5.5
COLUMNS = {"torque1_nm": "tau_meas1", "torque2_nm": "tau_meas2", "angle1_rad": "pos_meas1", "angle2_rad": "pos_meas2"}
SMALL = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
NUMBERS = ("00", "02", "03", "05", "13")


def main(folder: Path) -> None:
    """Seconds 1 to 5.5 of each trajectory, by straight lines between the stamps, in single precision."""
    for number in NUMBERS:
        found = next(p for p in folder.glob(f"trajectory_{number}.*"))
        table = pd.read_csv(found) if found.suffix == ".csv" else pd.read_parquet(found)
        t = np.arange(FROM_S, TO_S, 1.0 / RATE_HZ)
        columns = {new: np.interp(t, table["time"], table[old]) for new, old in COLUMNS.items()}
        pd.DataFrame(columns).astype("float32").to_parquet(HERE / f"swing_{number}.parquet", index=False, **SMALL)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
