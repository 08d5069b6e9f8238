"""A campaign on one and two workers, beside the simulation alone: what handing over, compressing and writing cost."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

RECORDINGS = 40
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


def seconds(draws: int, workers: int) -> float:
    """Wall time of the whole command."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "study.toml").write_text(STUDY)
        (folder / "campaign.toml").write_text(CAMPAIGN.format(draws=draws))
        words = ["campaign", str(folder / "campaign.toml"), "--out", str(folder / "out"), "--workers", str(workers)]
        began = time.perf_counter()
        subprocess.run([sys.executable, "-m", "loopshape.cli.main", *words], check=True, capture_output=True)
        return time.perf_counter() - began


def per_recording(workers: int) -> float:
    """Wall time of a further recording of 100 s, start-up taken off."""
    return (seconds(RECORDINGS, workers) - seconds(2, workers)) / (RECORDINGS - 2)


def simulation_alone() -> float:
    """Processor time of making such a recording in memory: signals, simulation, columns."""
    from loopshape.io.study import read_study
    from loopshape.model import registry
    from loopshape.rig.many import Job, done
    from loopshape.rig.simulated import listed

    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "study.toml").write_text(STUDY)
        study = read_study(Path(name) / "study.toml")
    plant = registry.plant(study.plant)
    job = Job("one", study, listed(study, plant)[0], {})
    times = []
    for _ in range(10):
        begun = time.process_time()
        done(plant, job)
        times.append(time.process_time() - begun)
    return min(times)
