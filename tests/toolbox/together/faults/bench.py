"""A run folder with all that commands make of it, and commands run in processes of their own, stopped where asked."""

import os
import sys
import traceback
from dataclasses import dataclass

import numpy as np
from commands import said_by

from loopshape.io import input_guard
from loopshape.toolbox.campaign import parallel

MAP = """
format = "loopshape-map/1"
rate_hz = 200.0
[columns]
r_m = { from = "r", unit = "m" }
z_v = { from = "z", unit = "V" }
y_m = { from = "y", unit = "m" }
[[loop]]
name = "axis"
reference = "r_m"
control = "z_v"
output = "y_m"
controller = [{ kind = "gain", gain = 2.0 }]
[recording]
name = "a"
kind = "multisine"
excites = "axis"
injection = "reference"
period_s = 2.0
periodic_from_s = 2.0
"""
REQUIRE = """
format = "loopshape-requirements/1"
[[loop]]
name = "axis"
integrators = 0
unstable_poles = 0
sensitivity_peak_db = 6.0
phase_margin_deg = 40.0
structure = [{ kind = "gain", gain = { min = 0.1, max = 10.0 } }]
"""
NOW = """
format = "loopshape-controllers/1"
rate_hz = 200.0
[[loop]]
name = "axis"
controller = [{ kind = "gain", gain = 2.0 }]
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (None: killed), what it printed, what it complained of."""

    code: int | None
    out: str
    err: str


def in_a_child(work):
    """Do work in a fork; gives what it returned as text, and the exit status (None: killed)."""
    reader, writer = os.pipe()
    pid = os.fork()
    if not pid:
        os.close(reader)
        code = 70
        try:
            with os.fdopen(writer, "w", encoding="utf-8", errors="backslashreplace") as file:
                file.write(work())
            code = 0
        except BaseException:
            traceback.print_exc(file=sys.__stderr__)
        os._exit(code)
    os.close(writer)
    with os.fdopen(reader, encoding="utf-8") as file:
        text = file.read()
    _, status = os.waitpid(pid, 0)
    return text, os.WEXITSTATUS(status) if os.WIFEXITED(status) else None


def one_by_one(work, jobs, _processes):
    """A campaign's jobs in this process: a fork of one with threads cannot start others."""
    for job in jobs:
        yield job, work(job)()


def command(words, before=lambda: None):
    """Run a command in a fork, after `before` was done there; of campaigns all but their processes."""

    def work():
        parallel.by_processes = one_by_one
        input_guard._noted, input_guard._alone = None, 0  # a process of its own has read nothing yet
        before()
        return said_by(words)

    text, status = in_a_child(work)
    if status is None:
        return Ended(None, "", "")
    code, out, err = text.split("\0", 2)
    return Ended(int(code), out, err)


def prepare(folder):
    """Files to import, controllers, and a run with FRFs, fits, a prediction, and a second run; the parent is warm."""
    folder.mkdir(exist_ok=True)
    (folder / "a.csv").write_text(recorded(1.0))
    (folder / "map.toml").write_text(MAP)
    (folder / "other.toml").write_text(MAP.replace('from = "y", unit = "m"', 'from = "y", unit = "m", gain = 1.01'))
    (folder / "more.toml").write_text(MAP.replace('name = "a"', 'name = "more"'))
    (folder / "require.toml").write_text(REQUIRE)
    (folder / "now.toml").write_text(NOW)
    words = commands(folder)
    (folder / "b.csv").write_text(recorded(1.01, seed=3))
    second = ("import", folder / "b.csv", "--map", folder / "map.toml", "--out", folder / "run2")
    for made in (*(words[name] for name in ("import", "frf", "fit", "tune", "predict")), second):
        code, _, err = said_by(made).split("\0")
        assert code in "01", (made, err)
    return folder


def recorded(gain, seed=2):
    """Text of a recording: five periods of a multisine as the reference of an axis under a gain."""
    k = np.arange(400)
    lines = np.arange(1, 120)
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, lines.size)
    r = np.tile(np.cos(2.0 * np.pi * np.outer(k, lines) / k.size + phases).sum(axis=1) / 20.0, 5)
    y, z, rows = 0.0, 0.0, ["r,z,y"]
    noise = 1e-3 * np.random.default_rng(seed).normal(size=r.size)
    for now, spread in zip(r, noise, strict=True):
        z = 2.0 * (now - y - spread)
        rows.append(f"{now:.17g},{z:.17g},{y + spread:.17g}")
        y = 0.939 * y + 0.305 * gain * z
    return "\n".join(rows) + "\n"


def commands(folder):
    """Words of every command that reads a run or writes into it."""
    run, require, controller = folder / "run", folder / "require.toml", folder / "controller.toml"
    add = ("import", folder / "a.csv", "--out", run, "--map")
    return {
        "import": (*add, folder / "map.toml"),
        "import another": (*add, folder / "more.toml"),
        "import --replace": (*add, folder / "other.toml", "--replace"),
        "frf": ("frf", run, "--no-figures"),
        "frf otherwise": ("frf", run, "--estimator", "direct", "--no-figures"),
        "fit": ("fit", run, "--structure", "rational", "--denominator", "1"),
        "fit otherwise": ("fit", run, "--structure", "third_order"),
        "tune": ("tune", run, "--require", require, "--out", controller),
        "predict": ("predict", run, folder / "now.toml", "--out", folder / "prediction.npz", "--no-figures"),
        "check": ("check", run, controller, "--require", require, "--no-figures", "--json"),
        "compare": ("compare", run, folder / "prediction.npz", "--no-figures", "--json"),
        "report": ("report", run, "--controller", controller, "--date", "today"),
        "figures": ("figures", run),
        "plan": ("plan", run, "--std-db", "0.05"),
        "bound": ("bound", run, controller, "--require", require, "--json"),
        "schedule": ("schedule", run, "--require", require, "--controller", controller, "--no-figures", "--json"),
        "export": ("export", run, "--to", "csv"),
        "verify": ("verify", run, "--json"),
        "gap": ("gap", run, folder / "run2", "--json"),
    }
