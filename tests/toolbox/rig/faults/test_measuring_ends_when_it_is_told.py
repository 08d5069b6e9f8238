"""A request to terminate ends a simulated measurement as Ctrl-C does, also where a shell lets it ignore Ctrl-C."""

import signal
import subprocess
import sys
import time

import pytest
from run_files import finished, verify

pytestmark = pytest.mark.long

STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }]
"""
EXPERIMENT = """
[[experiment]]
name = "e%d"
excites = "theta2"
excitation = { kind = "multisine", f_low_hz = 0.5, f_high_hz = 9.0, period_s = 5.0, periods = 40, amplitude_deg = 1.0 }
"""


def in_background():
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_what_is_finished_is_kept(tmp_path, how):
    study, run = tmp_path / "study.toml", tmp_path / "run"
    study.write_text(STUDY + "".join(EXPERIMENT % k for k in range(30)))
    command = [sys.executable, "-m", "loopshape.cli.main", "measure", str(study), "--out", str(run)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=in_background)
    until = time.monotonic() + 120.0
    while len(list(run.glob("e*.parquet"))) < 2:  # a table is there before it is listed
        assert process.poll() is None
        assert time.monotonic() < until
        time.sleep(0.02)
    process.send_signal(how)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert 0 < len(finished(run)) < 30
    assert all(finding.sound is not False for finding in verify(run))
