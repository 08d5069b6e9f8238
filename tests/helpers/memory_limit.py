"""A child process that may take so many bytes beyond what it has after its imports, and no more (`RLIMIT_AS`)."""

from __future__ import annotations

import os
import subprocess
import sys

_FRAME = """
import resource, sys
from pathlib import Path
{before}
taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + {most_bytes}, taken + {most_bytes}))
{work}
status = Path("/proc/self/status").read_text().splitlines()
print(next(int(line.split()[1]) for line in status if line.startswith("VmHWM")))
"""
_QUIET = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # others reserve addresses that they do not use
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": "65536",  # what is given back is given back, as of arrays of gigabytes
}


def in_a_child(before: str, work: str, most_bytes: int, *arguments: object, timeout_s: float = 120.0) -> float:
    """Most memory in bytes that a child held while it ran `work` within the limit, after `before` without one."""
    code = _FRAME.format(before=before, work=work, most_bytes=int(most_bytes))
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True, text=True, timeout=timeout_s, env=os.environ | _QUIET, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return 1024.0 * int(done.stdout.split()[-1])
