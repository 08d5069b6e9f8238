"""What kernels call with other constants, or with arrays of their own, is compiled once."""

import numba
import numpy as np
import pytest

from loopshape.core.kernels.compiled import compiled, compiled_reading


@compiled
def scaled(x, factor):
    return factor * x


@compiled_reading("out")
def summed(x, out):
    out[0] += scaled(x[0], 2) + scaled(x[1], 3)


@compiled
def of_both(x):
    own, out = x + 1.0, np.zeros(1)
    summed(x, out)
    summed(own, out)
    return out[0]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_constants_and_arrays_of_a_kernel_s_own_share_one_form():
    given = np.array([1.0, 10.0])
    given.setflags(write=False)
    assert of_both(given) == 2.0 * 1.0 + 3.0 * 10.0 + 2.0 * 2.0 + 3.0 * 11.0
    assert [len(one.signatures) for one in (scaled, summed)] == [1, 1]


def test_what_it_reads_may_not_be_written():
    @compiled_reading("out")
    def turned(x, out):
        x[0] = out[0]

    @compiled
    def caller(x):
        turned(x, x)

    if not numba.config.DISABLE_JIT:
        with pytest.raises(numba.TypingError, match=r"[Cc]annot"):
            caller(np.zeros(1))
