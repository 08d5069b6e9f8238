"""The one way our kernels are compiled. With NUMBA_DISABLE_JIT=1 the plain functions beneath run instead.

Numba's cache notices a change in a kernel's own file, not in a file it calls into: after editing a kernel,
`make clean` empties the cache.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile with numba: cached, without the interpreter's lock, IEEE division, contraction allowed."""
    return _compile(function)


def compiled_in_line(function: F) -> F:
    """As `compiled`, and put into its callers' code: for what a kernel calls many times a step."""
    return _compile(function, forceinline=True)


def _compile(function: F, **options: bool) -> F:
    options |= {"nogil": True}
    common: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
    try:
        return cast(F, numba.njit(cache=True, **common, **options)(function))
    except RuntimeError:  # no folder for the cache can be written: compile in each process
        return cast(F, numba.njit(**common, **options)(function))
