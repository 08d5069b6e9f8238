"""A test that hangs is a failure after its time limit, also in a worker and in code that hears no signal."""

import subprocess
import sys
from pathlib import Path

import pytest

SETTINGS = Path(__file__).resolve().parents[2] / "pyproject.toml"
SLEEPS = "import time\ndef test_hangs():\n    time.sleep(60)\n"
DEAF = f"import signal\nsignal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])\n{SLEEPS}"
LONG = "import pytest\n@pytest.mark.long\ndef test_of_minutes():\n    pass\n"


def outcome(folder, text, *words):
    """Exit code and output of pytest, with the project's settings, on a file of one test."""
    (folder / "test_one.py").write_text(text)
    settings = ["-c", SETTINGS, "--rootdir", folder, "-p", "no:cacheprovider", "-o", "faulthandler_timeout=3"]
    command = [sys.executable, "-m", "pytest", *settings, *words, folder / "test_one.py"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False, cwd=folder)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.long
@pytest.mark.parametrize("workers", [[], ["-n", "1"]], ids=["here", "worker"])
@pytest.mark.parametrize(
    ("text", "said"), [(SLEEPS, "Timeout (>1.0s)"), (DEAF, "Timeout (0:00:03)!")], ids=["sleeps", "deaf"]
)
def test_a_test_that_hangs_is_ended(tmp_path, text, said, workers):
    code, output = outcome(tmp_path, text, "-o", "timeout=1", *workers)
    assert code == 1
    assert said in output


@pytest.mark.long
def test_long_tests_run_on_request_alone(tmp_path):
    assert outcome(tmp_path, LONG)[0] == pytest.ExitCode.NO_TESTS_COLLECTED
    assert outcome(tmp_path, LONG, "-m", "long")[0] == pytest.ExitCode.OK


def test_every_test_has_a_limit(request):
    assert float(request.config.getini("timeout")) == 300
