"""The motor bench of `examples` as a run, read column by column: what a test of the bench needs without a toolbox."""

from pathlib import Path

import pyarrow.parquet as pq
from bench_nouns import LoopSetup, RecordingInfo

import loopshape as ls

FOLDER = Path(__file__).parents[2] / "examples" / "motor_bench"
RATE_HZ = 2500.0
COLUMNS = {"r_current_a": "iq_refx", "current_a": "iq_adx", "theta_m_rad": "theta_mx"}


def run() -> ls.Run:
    """What `map.toml` says of the recording, in Python."""
    table = pq.read_table(FOLDER / "multisine_type_a.parquet")
    columns = {name: table[theirs].to_numpy().astype(float) for name, theirs in COLUMNS.items()}
    info = RecordingInfo("type-a.parquet", "multisine", "reference", excites="motor", period_s=1.0, periodic_from_s=0.0)
    loop = LoopSetup("motor", "r_current_a", None, "current_a", "theta_m_rad", None)
    return ls.Run(RATE_HZ, (loop,), (ls.Recording(info, RATE_HZ, columns),))
