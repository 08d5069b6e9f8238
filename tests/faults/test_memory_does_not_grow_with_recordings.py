"""A run of many recordings is checked and estimated in the memory of a few."""

from pathlib import Path

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from memory_limit import in_a_child

import loopshape as ls

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits are set as Linux has them")

RATE_HZ = 1000.0
SIZES = [(50, 160_000), (100, 80_000)]  # recordings, rows of each: 200 MB in all
MOST_BYTES = 90_000_000

BEFORE = """
import numpy as np
import loopshape.io.run.tables as tables
tables.KEPT_BYTES = 20_000_000
from loopshape.io.run.verify import verify
from loopshape.io.run.run_folder import check_recordings, read_run
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings
folder = Path(sys.argv[1])
run = read_run(folder)
settings = Settings(resolution_hz=1.0)
estimate_frf(run.recordings[0], run.loop("a"), settings)
"""


@pytest.fixture(scope="module", params=SIZES, ids="{0[0]} recordings of {0[1]} rows".format)
def many(request, tmp_path_factory):
    recordings, rows = request.param
    rng = np.random.default_rng(0)
    u = rng.integers(-500, 500, rows) / 100.0
    y = 0.5 * np.convolve(u, 0.9 ** np.arange(50))[:rows]
    folder = tmp_path_factory.mktemp("many") / "run"
    loop = LoopSetup("a", reference="r_m", injected=None, control="z_v", output="y_m", controller=None)
    every = tuple(
        ls.Recording(
            RecordingInfo(f"r{k:03d}.parquet", "noise", "reference", excites="a"),
            RATE_HZ,
            {"r_m": u, "z_v": u - y, "y_m": np.round(y + 0.01 * k, 3)},
        )
        for k in range(recordings)
    )
    ls.write(ls.Run(rate_hz=RATE_HZ, loops=(loop,), recordings=every), folder)
    return folder


@pytest.mark.long
def test_verify(many):
    in_a_child(BEFORE, "assert all(f.sound is not False for f in verify(folder))", MOST_BYTES, many)


@pytest.mark.long
def test_looking_at_signals_and_estimating(many):
    work = "check_recordings(run)\nfrfs = [estimate_frf(r, run.loop('a'), settings) for r in run.recordings]"
    in_a_child(BEFORE, work, MOST_BYTES, many)
