"""The one way our kernels are compiled. With NUMBA_DISABLE_JIT=1 the plain functions beneath run instead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from loopshape.core.kernels.kept import keep

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile with numba: kept on disk, without the interpreter's lock, IEEE division, contraction allowed."""
    return _compile(function)


def compiled_in_line(function: F) -> F:
    """As `compiled`, and put into its callers' code: for what a kernel calls many times a step."""
    return _compile(function, forceinline=True)


def _compile(function: F, **options: bool) -> F:
    dispatcher = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"}, **options)(function)
    if dispatcher is not function:
        dispatcher._cache = keep(function) or dispatcher._cache
    return cast(F, dispatcher)
