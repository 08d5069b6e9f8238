"""What interaction cannot be asked of, and the sentence that says so."""

import numpy as np
import pytest
from bench_nouns import Block
from interaction_nouns import F, coupled_by, matrix_frf

import loopshape as ls
from loopshape.data.algebra.propagation import pick
from loopshape.toolbox.diagrams.coupling.interaction import closing_the_others, relative_gain

FRF22 = matrix_frf(coupled_by(-30.0), error=0.01)
TALL = matrix_frf(np.ones((F.size, 3, 2)), outputs=("a_m", "b_m", "c_m"))
K = ls.Controller("theta9", (Block("gain", {"gain": 1.0}),), 1000.0)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (
            lambda: ls.interaction(FRF22, ("theta1", "nose")),
            "a loop is not in the FRF; received nose; it has theta1, the",
        ),
        (lambda: ls.interaction(FRF22, ("theta1",)), "between two loops at least, each once; received theta1"),
        (lambda: ls.interaction(FRF22, ("theta1", "theta1")), "between two loops at least, each once"),
        (lambda: ls.interaction(pick(FRF22, [0], [0])), "loopshape frf RUN --matrix"),
        (lambda: ls.interaction(TALL), "3 outputs (a_m, b_m, c_m) for the loops theta1, theta2; name the outputs"),
        (lambda: ls.interaction(TALL, outputs=("a_m",)), "1 outputs for 2 loops"),
        (lambda: ls.interaction(TALL, outputs=("a_m", "z_m")), "go by their names"),
        (lambda: ls.interaction(FRF22, limit_db=float("nan")), "a number of dB"),
        (lambda: ls.interaction(FRF22, bands=((2.0, 1.0),)), "two rising frequencies in Hz; received 2 to 1"),
        (lambda: ls.interaction(FRF22, controllers={"theta9": K}), "a controller is of no loop of this FRF"),
        (lambda: closing_the_others(FRF22, ("theta1", "theta2"), "nose", {}), "a loop is not in the FRF"),
        (lambda: closing_the_others(FRF22, ("theta1", "theta2"), "theta1", {}), "received none of theta2"),
        (lambda: relative_gain(TALL), "those of a square FRF; received 3 x 2"),
        (
            lambda: relative_gain(matrix_frf(np.ones((F.size, 2, 2)))),
            "has no inverse at every frequency; received 0.1 Hz",
        ),
        (lambda: ls.interaction(matrix_frf(coupled_by(-30.0), valid=F > 99.0)), "is valid"),
    ],
)
def test_refusals_say_what_and_the_way_out(ask, words):
    with pytest.raises(ls.errors.WrongUseError) as caught:
        ask()
    assert words in str(caught.value)
