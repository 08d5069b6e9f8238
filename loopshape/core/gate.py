"""The gate of public functions and nouns: every argument is of a kind that its annotation names.

Annotations say what a function takes; here they are held to it, so that an FRF in a controller's place, a text in a
number's or two arguments given the wrong way round end in a sentence and not somewhere inside. Arrays pass: what they
may hold is asked in `loopshape.data.arrays`. Which words a text may be, and which numbers make sense, each noun says.
"""

from __future__ import annotations

import errno
import inspect
import math
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from enum import Enum, StrEnum
from functools import cache, wraps
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongCallError, WrongUseError, an, meant
from loopshape.core.toolboxes import found

Positive = Annotated[float, "positive"]  # what readers of files hold these to
FromZero = Annotated[float, "a number from 0 on"]
Count = Annotated[int, "a whole number from 0 on"]

F = TypeVar("F", bound=Callable[..., Any])
#: numbers from here on are none that anything can be computed with
TOO_LARGE = 1e300
_OWN = ("self", "cls")
_NAMED = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_WORD_OF = {float: "a number", int: "a whole number", str: "a text", bool: "True or False", Path: "a path"}
_TYPES: dict[type, Any] = {bool: bool | np.bool_, str: str, Path: PathLike}


class _Public(dict[str, Any]):
    """Names of the public face, for annotations whose module imports them for the type checker alone."""

    def __missing__(self, name: str) -> Any:
        face = sys.modules["loopshape"]
        if not name[:1].isupper():
            raise KeyError(name)
        if name in face.__all__:
            return getattr(face, name)
        at = found().all("names").get(name)
        if at is None:
            raise KeyError(name)
        return getattr(import_module(at), name)


def _hint(annotation: Any, module: str) -> Any:
    """An annotation as a type; Any without one, and where its names are known to the type checker alone."""
    if annotation is inspect.Parameter.empty:
        return Any
    holder = types.SimpleNamespace(__annotations__={"it": annotation})
    try:
        return get_type_hints(holder, vars(sys.modules[module]), _Public())["it"]
    except NameError:
        return Any


@cache
def _hints(of: Callable[..., Any]) -> dict[str, Any]:
    """What each parameter of a function, or field of a noun, may be."""
    if isinstance(of, type):
        home = {name: one.__module__ for one in reversed(of.__mro__) for name in vars(one).get("__annotations__", ())}
        return {f.name: _hint(f.type, home[f.name]) for f in fields(of) if f.init}
    return {name: _hint(one.annotation, of.__module__) for name, one in inspect.signature(of).parameters.items()}


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is of the kind that a type names; elements of lists, tuples and dicts too, and no array's."""
    if hint is Any or isinstance(hint, TypeVar | str):
        return True
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is not None:
        return _fits_whole(value, origin, inner)
    if hint is None or hint is type(None):
        return value is None
    if hint in _WORD_OF:
        return _fits_plain(value, hint)
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return isinstance(value, str)  # which words it may be, the noun says
    return isinstance(value, hint) if isinstance(hint, type) else True


def _fits_plain(value: Any, hint: type) -> bool:
    if hint in _TYPES:
        return isinstance(value, _TYPES[hint])
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if hint is int:
        return whole and abs(value) < 2**63
    return (whole or isinstance(value, float | np.floating)) and (
        value != value or abs(value) < TOO_LARGE or value in (math.inf, -math.inf)
    )


def _fits_whole(value: Any, origin: Any, inner: tuple[Any, ...]) -> bool:
    if not isinstance(origin, type) or origin.__module__.startswith("numpy"):
        return True
    if issubclass(origin, Mapping):
        keys, values = inner or (Any, Any)
        pairs = value.items() if isinstance(value, dict) else ()
        return isinstance(value, Mapping) and all(fits(k, keys) and fits(v, values) for k, v in pairs)
    if issubclass(origin, Sequence):
        return _fits_sequence(value, inner if origin is tuple else (*inner, ...))
    if origin is Iterable or issubclass(origin, Iterable):
        if isinstance(value, list | tuple | set | frozenset | np.ndarray):
            return _fits_sequence(list(value) if isinstance(value, set | frozenset) else value, (*inner, ...))
        return isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping | Path)
    return callable(value) if origin is Callable or issubclass(origin, types.FunctionType) else True


def _fits_sequence(value: Any, inner: tuple[Any, ...]) -> bool:
    if isinstance(value, np.ndarray) and value.ndim and value.size:
        value = value.tolist()
    if not isinstance(value, Sequence) or isinstance(value, str | bytes | Enum):
        return False
    if not isinstance(value, list | tuple | range):
        return True  # loaded when asked for
    if len(inner) == 2 and inner[1] is ...:
        return all(fits(one, inner[0]) for one in value)
    return len(value) == len(inner) and all(map(fits, value, inner))


def described(hint: Any) -> str:
    """A type in words, as a sentence says what is taken."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        words = list(dict.fromkeys(described(one) for one in inner if one is not type(None)))
        words = [word for word in words if word != "a text"] if "a path" in words else words
        return ", ".join(words[:-1]) + " or " * (len(words) > 1) + words[-1]
    if origin is tuple and ... not in inner:
        return f"({', '.join(described(one) for one in inner)})"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return "a mapping" if Any in inner else f"a mapping to {described(inner[1])}"
    if origin is not None:
        return (
            f"a sequence of {described(inner[0]).split(' ', 1)[-1]}"
            if origin is not Callable and inner
            else "a function"
        )
    name = getattr(hint, "__name__", str(hint))
    return _WORD_OF.get(hint, an(name))


def received(value: Any) -> str:
    """What was given, in short."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 2**63:
        return "a longer whole number"
    if value is None or isinstance(value, str | int | float | bytes):
        text = f"{value:g}" if isinstance(value, float) else ascii(value)
        return text if len(text) < 80 else f"{text[:77]}..."
    if isinstance(value, list | tuple):
        kinds = list(dict.fromkeys(type(one).__name__ for one in value))
        return f"{type(value).__name__} of {', '.join(kinds[:4])}" if kinds else f"an empty {type(value).__name__}"
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype}"
    return value.__name__ if isinstance(value, type | types.ModuleType) else type(value).__name__


def gated(function: F, public: str = "") -> F:
    """The function behind the gate: an argument of another kind is refused, and swapped ones are told apart.

    `public` is the name that sentences give it, `ls.` and its own by default.
    """
    signature, name = inspect.signature(function), public or f"ls.{function.__qualname__}"

    @wraps(function)
    def behind(*args: Any, **words: Any) -> Any:
        try:
            bound = signature.bind(*args, **words)
        except TypeError as why:
            raise _wrong_call(name, signature, words, why) from None
        hints = _hints(function)
        _pass(name, bound.arguments, hints, signature)
        bound.arguments.update({one: _plain(value, hints[one]) for one, value in bound.arguments.items()})
        try:
            return function(*bound.args, **bound.kwargs)
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            raise WrongUseError(f"a path of {name} is too long", received(error.filename), "shorten it") from error

    return behind  # type: ignore[return-value]


@cache
def with_sentences(cls: type, public: str) -> None:
    """Let wrong calls of a public noun and of its methods end in a sentence, as those of public functions do."""
    for name, one in list(vars(cls).items()):
        inner = getattr(one, "__func__", one)  # of a method of the class
        if isinstance(inner, types.FunctionType) and (name in ("__init__", "__call__") or name[0] != "_"):
            made = _with_sentence(inner, public if name[0] == "_" else f"{public}.{name}")
            setattr(cls, name, made if inner is one else type(one)(made))


def _with_sentence(function: F, public: str) -> F:
    @wraps(function)
    def called(*args: Any, **words: Any) -> Any:
        try:
            return function(*args, **words)
        except TypeError:
            signature = inspect.signature(function)
            try:
                signature.bind(*args, **words)
            except TypeError as why:
                raise _wrong_call(public, signature, words, why) from None
            raise  # from inside

    return called  # type: ignore[return-value]


def _wrong_call(whose: str, signature: inspect.Signature, words: Mapping[str, Any], why: TypeError) -> WrongCallError:
    """What does not fit between a call and the arguments of a function: Python's words, and the right call."""
    takes = [one.replace(annotation=one.empty) for name, one in signature.parameters.items() if name not in _OWN]
    takes = [one.replace(default=None) if isinstance(one.default, types.FunctionType) else one for one in takes]
    named = [one.name for one in takes if one.kind in _NAMED]
    call = f"call {whose}{inspect.Signature(takes)}"
    call = call if len(call) < 400 else f"help({whose}) lists its arguments"
    open_ended = any(one.kind is one.VAR_KEYWORD for one in takes)
    strange = next((one for one in words if one not in named and not open_ended), None)
    limits = "limits go into R=ls.Requirements(...); " if strange and "R" in named else ""
    what = f"got an unexpected keyword argument {strange!r}" if strange else why  # Python names what is missing first
    return WrongCallError(f"{whose}: {what}", way_out=(meant(strange, named) or limits) + call)


def _plain(value: Any, hint: Any) -> Any:
    """What inside counts on: a tuple for a list or array where a type names one, a list for an array, Python's number
    for one of numpy's; all others as they are."""
    hints = [one for one in _arms(hint) if one is not Any and fits(value, one)]
    if isinstance(value, np.generic) and any(one in _WORD_OF for one in hints):
        return value.item()
    if not isinstance(value, list | tuple | range | np.ndarray):
        return value
    of = next((get_args(one) for one in hints if get_origin(one) is tuple), None)
    if of is not None:
        values = value.tolist() if isinstance(value, np.ndarray) else value
        return tuple(map(_plain, values, of[:1] * len(values) if of[1:] == (...,) else of))
    return value.tolist() if isinstance(value, np.ndarray) and any(map(_is_sequence, hints)) else value


def _arms(hint: Any) -> tuple[Any, ...]:
    """The types of a union, or the one."""
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _is_sequence(hint: Any) -> bool:
    origin = get_origin(hint)
    return isinstance(origin, type) and not origin.__module__.startswith("numpy") and issubclass(origin, Iterable)


def pass_fields(noun: Any, *names: str) -> None:
    """Refuse a noun whose fields (or those named) are of other kinds than it declares; first in `__post_init__`."""
    cls: Callable[..., Any] = type(noun)
    for field, hint in _hints(cls).items():
        value = getattr(noun, field)
        if names and field not in names:
            continue
        if not fits(value, hint):
            raise WrongUseError(f"{field} of {an(cls.__name__)} must be {described(hint)}", received(value))


def _pass(whose: str, given: Mapping[str, Any], hints: Mapping[str, Any], signature: inspect.Signature) -> None:
    for name, value in given.items():
        kind, hint = signature.parameters[name].kind, hints[name]
        values = value if kind is inspect.Parameter.VAR_POSITIONAL else (value,)
        needed = signature.parameters[name].default is inspect.Parameter.empty and kind in _NAMED
        needed &= hint != ArrayLike  # lengths of arrays are compared with each other, and told together
        if needed and isinstance(value, list | tuple) and not value and all(map(fits, values, [hint])):
            raise WrongUseError(f"{name} of {whose} must hold one at least", received(value), f"give {described(hint)}")
        if kind is inspect.Parameter.VAR_KEYWORD or all(map(fits, values, [hint] * len(values))):
            continue
        wrong = next(one for one in values if not fits(one, hint))
        others = [other for other in given if other != name and fits(wrong, hints[other]) and hints[other] is not Any]
        swapped = [other for other in others if not fits(given[other], hints[other]) and fits(given[other], hint)]
        order = ", ".join(one for one, p in signature.parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD)
        if swapped:
            raise WrongUseError(
                f"{name} and {swapped[0]} of {whose} are given the wrong way round",
                f"{received(wrong)} and {received(given[swapped[0]])}", f"call {whose}({order})",
            )  # fmt: skip
        way_out = f"call {whose}({order})" if any(not fits(given[one], hints[one]) for one in others) else ""
        raise WrongUseError(
            f"{name} of {whose} must be {described(hint)}", received(wrong), way_out or _cure(wrong, hint)
        )


def _cure(value: Any, hint: Any) -> str:
    if hasattr(value, "frequency_response") or (hasattr(value, "frdata") and hasattr(value, "omega")):
        if "Controller" in described(hint):
            return "make a controller of it: ls.controller(*ls.fixed(system, rate_hz=rate_hz), rate_hz=rate_hz)"
        return "make an FRF of a python-control system: ls.FRF.from_control(system, frequency_hz)"
    return ""
