"""Answers that are kept as long as what they are about is there."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

About = TypeVar("About")
More = ParamSpec("More")
Answer = TypeVar("Answer")


def remembered(function: Callable[Concatenate[About, More], Answer]) -> Callable[Concatenate[About, More], Answer]:
    """The function, asked once about a noun that is told apart by what it is, and about each of its other arguments."""
    known: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()

    @wraps(function)
    def answer(noun: About, *more: More.args, **words: More.kwargs) -> Answer:
        about, asked = known.setdefault(noun, {}), (more, *words.items())
        if asked not in about:
            about[asked] = function(noun, *more, **words)
        return about[asked]

    return answer
