"""Ten thousand short recordings on a cluster of this machine that loses a worker: none is lost."""

import os
import signal
import subprocess
import sys
import time
import warnings

import pytest
from run_files import verify

import loopshape as ls
from loopshape.toolbox.campaign.parallel import BATCH_S, _next_count

POINTS = ", ".join(f"{{ theta2_deg = {k / 5 - 10:g}, p_ab_bar = 1.0 }}" for k in range(100))
STUDY = f"""
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{POINTS}]
[[experiment]]
name = "rest"
duration_s = 0.5
"""
CAMPAIGN = 'format = "loopshape-campaign/1"\nstudy = "study.toml"\ndraws = 100\nseed = 1\n'


def test_a_task_is_as_many_jobs_as_take_the_seconds_of_a_batch():
    assert _next_count(1, 10.0) == 1
    assert _next_count(10, 0.1) * 0.01 == pytest.approx(BATCH_S)
    assert _next_count(1, 0.0) == 1000


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.timeout(1800)
def test_none_of_them_is_lost_with_a_worker(tmp_path):
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    out = tmp_path / "out"
    words = [sys.executable, "-m", "loopshape.cli.main", "campaign", str(tmp_path / "campaign.toml"), "--out", str(out)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1", silence_logs=50
        ) as cluster:
            process = subprocess.Popen([*words, "--cluster", cluster.scheduler_address], stderr=subprocess.PIPE)
            while len(list(out.glob("d*"))) < 10:
                assert process.poll() is None, process.communicate()
                time.sleep(0.5)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
            _, said = process.communicate(timeout=1500)
    assert process.returncode == 0, said.decode()
    runs = [ls.read(toml.parent) for toml in out.glob("*/run.toml")]
    assert [len(run.recordings) for run in runs] == [100] * 100
    assert not list(out.rglob(".*"))
    assert all(finding.sound is not False for finding in verify(out / "d000050-x1"))
