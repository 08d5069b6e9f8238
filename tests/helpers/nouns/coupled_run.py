"""A run of two coupled loops with its requirements, for check and report."""

import numpy as np
import typer
from conversions import TWO_PI
from run_files import write_controllers, write_matrices
from several_cases import frf_of, gain, noisy
from typer.testing import CliRunner

from loopshape.cli.verify.check import check

APP = typer.Typer()
APP.command()(check)

F = np.arange(0.1, 20.0, 0.1)
S = 1j * TWO_PI * F
REQUIREMENTS = """
format = "loopshape-requirements/1"

[[loop]]
name = "a"
modulus_margin = 0.5

[[loop]]
name = "b"
modulus_margin = 0.5

[several]
disk_margin = {disk}
sensitivity_peak_db = 8.0
integrators = 2
unstable_poles = 0
"""


def matrix(coupling, recording="exact"):
    G = np.array([[1.0, coupling], [-coupling, 1.0]]) * (4.0 / (S * (0.02 * S + 1.0)))[:, None, None]
    return noisy(frf_of(F, G, 0.01, loop="a+b", recording=recording), np.random.default_rng(0))


def coupled_run(folder):
    """Its folder, with c.toml and r.toml."""
    write_matrices(folder, [matrix(0.3)])
    write_controllers(folder / "c.toml", [gain("a"), gain("b")])
    (folder / "r.toml").write_text(REQUIREMENTS.format(disk=0.5))
    return folder


def checked(run, *more, by=None):
    """What `loopshape check` does with it, or with the files of another folder (`by`)."""
    of = by or run
    return CliRunner().invoke(APP, [str(run), str(of / "c.toml"), "--require", str(of / "r.toml"), *more])
