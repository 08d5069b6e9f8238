"""A campaign on one and two workers beside one and two bare simulations, which take turns: what all but them costs."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

RECORDINGS, ROUNDS = 80, 3
STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }]
[[experiment]]
name = "angle"
excites = "theta2"
[experiment.excitation]
kind = "multisine"
f_low_hz = 0.5
f_high_hz = 10.0
period_s = 10.0
periods = 9
ramp_s = 5.0
amplitude_deg = 2.0
"""
CAMPAIGN = 'format = "loopshape-campaign/1"\nstudy = "study.toml"\ndraws = {draws}\nseed = 1\n'


#: makes recordings in memory for some seconds, and prints what one takes
BARE = """
import sys, time
from pathlib import Path
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig import registry
from loopshape.toolbox.campaign.parallel import Job, done
from loopshape.toolbox.rig.simulated import listed
study = read_study(Path(sys.argv[1]))
plant = registry.plant(study.plant)
job = Job("one", study, listed(study, plant)[0], {})
done(plant, job)
print("ready", flush=True)
sys.stdin.read(1)
begun = time.perf_counter()
for _ in range(40):
    done(plant, job)
print((time.perf_counter() - begun) / 40)
"""


def per_recording(folder: Path, workers: int) -> float:
    """Wall time of a further recording of 100 s, by when the tables were written: start-up is left out."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        words = ["campaign", str(folder / "campaign.toml"), "--out", name, "--workers", str(workers)]
        subprocess.run([sys.executable, "-m", "loopshape.cli.main", *words], check=True, capture_output=True)
        written = sorted(table.stat().st_mtime for table in Path(name).glob("*/*.parquet"))
    first, last = RECORDINGS // 10, RECORDINGS - RECORDINGS // 10
    return (written[last] - written[first]) / (last - first)


def simulated(folder: Path, processes: int) -> float:
    """Wall time of a further recording made in memory by processes that know nothing of each other."""
    words = [sys.executable, "-c", BARE, str(folder / "study.toml")]
    all_of_them = [
        subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(processes)
    ]
    for one in all_of_them:
        assert one.stdout
        one.stdout.readline()
    for one in all_of_them:
        assert one.stdin
        one.stdin.write(".")
        one.stdin.flush()
    return median(float(one.communicate()[0]) for one in all_of_them) / processes


def table() -> tuple[float, float, float, float]:
    """Seconds a recording: bare, two bare at once, a campaign of one worker, of two; medians of rounds in turns."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "study.toml").write_text(STUDY)
        (folder / "campaign.toml").write_text(CAMPAIGN.format(draws=RECORDINGS))
        rounds = [
            (simulated(folder, 1), simulated(folder, 2), per_recording(folder, 1), per_recording(folder, 2))
            for _ in range(ROUNDS)
        ]
    bare, two_bare, one, two = (median(column) for column in zip(*rounds, strict=True))
    return bare, two_bare, one, two
