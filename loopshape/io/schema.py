"""Tables of files read as nouns, field by field (cattrs): a refusal names the place, what was received, the way out.

What a class may say of its table:

READ_AS    the keys that differ from their fields
READS      the fields that a file may have, where it may not have all
ALSO_READ  keys that `unfolded(table)` turns into fields
ELSEWHERE  keys that the file has above the table
WRITTEN    fields that are written at their default too
MARK       the key by which a table is known as this one of several kinds
made()     what is given in its place

A class without `READ_AS` whose `from_table` is its own reads itself.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache, partial
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from loopshape.core.errors import LoopshapeError, WrongUseError, meant
from loopshape.io.files import short

T = TypeVar("T")
_WANTED = {float: "a finite number", int: "a whole number", str: "a text in quotes", bool: "true or false"}
_MANY = {float: "numbers", int: "whole numbers", str: "texts in quotes"}
_LARGEST = {float: 1e300, int: 2**63}
_LISTS, _PAIR = (tuple, list, Sequence), tuple[float, float]


class UnfitError(Exception):
    """A value that is not what is wanted here, or none of the words `known`; `entry` of a list, counted from 1."""

    def __init__(self, value: object, wanted: str, known: Sequence[str] = (), entry: int = 0) -> None:
        self.value, self.wanted, self.known, self.entry = value, wanted, known, entry


def read(kind: type[T], table: object, where: str, *, own: bool = False, **elsewhere: object) -> T:
    """A table as a noun of this kind; `where` stands in front of every refusal. `elsewhere` are keys not in it.

    Refuses unknown keys, missing ones, values of another kind, and what the noun refuses. In what the program itself
    wrote (`own`) numbers may be infinite or no number, as "inf" and "nan", and texts empty.
    """
    return _taken(kind, table, table, where, own, **elsewhere)


def value_of(hint: Any, value: object, key: str, where: str, *, own: bool = False) -> Any:
    """One value under a key as a type; refuses another kind."""
    return _taken(hint, value, {key: value}, where, own, key)


def _taken(hint: Any, value: object, table: object, where: str, own: bool, *path: str, **elsewhere: object) -> Any:
    from cattrs.errors import BaseValidationError

    try:
        return _converter(own).structure(beside(value, **elsewhere), hint)
    except (BaseValidationError, LoopshapeError, UnfitError) as error:
        raise _refusal(error, table, where, path) from None


def beside(table: Any, **elsewhere: object) -> Any:
    """A table with what its file says of it elsewhere; refuses one that says so itself."""
    if isinstance(table, dict) and (twice := [key for key in elsewhere if key in table]):
        raise WrongUseError("unknown key", repr(twice[0]), "leave it out: it is known without it")
    return table | elsewhere if isinstance(table, dict) else table


def table_of(noun: Any) -> dict[str, Any]:
    """The table that `read` takes; what is at its default is left out, but for the fields in `WRITTEN`."""
    always, found = getattr(noun, "WRITTEN", ()), {}
    for field in _read_fields(type(noun)):
        value = getattr(noun, field.name)
        default = field.default_factory() if callable(field.default_factory) else field.default
        if value != default or field.name in always:
            found[_key(type(noun), field.name)] = _plain(value)
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if hasattr(value, "to_table"):
        return value.to_table()
    return table_of(value) if is_dataclass(value) else value


def keys(kind: type) -> list[str]:
    """The keys that a table of this kind may have; those `ELSEWHERE` its file says above it."""
    own = [_key(kind, field.name) for field in _read_fields(kind)]
    return [*(one for one in own if one not in getattr(kind, "ELSEWHERE", ())), *getattr(kind, "ALSO_READ", ())]


def _key(kind: type, field: str) -> str:
    return str(getattr(kind, "READ_AS", {}).get(field, field))


def _read_fields(kind: type) -> list[Any]:
    among = getattr(kind, "READS", None)
    return [one for one in fields(kind) if one.init and (among is None or one.name in among)]


@cache
def _converter(own: bool) -> Any:
    from cattrs import Converter

    made = Converter(forbid_extra_keys=True)
    for kind in _WANTED:
        made.register_structure_hook(kind, _scalar(kind, own))
    made.register_structure_hook_factory(lambda hint: get_origin(hint) is Annotated, lambda hint: _bounded(hint, made))
    made.register_structure_hook_factory(_is_marked, lambda hint: _marked(hint, made))
    made.register_structure_hook_factory(lambda hint: get_origin(hint) in _LISTS, lambda hint: _list(hint, made))
    made.register_structure_hook_func(lambda hint: getattr(hint, "__origin__", hint) is np.ndarray, _array)
    made.register_structure_hook_factory(lambda hint: get_origin(hint) is Mapping, lambda hint: _mapping(hint, made))
    made.register_structure_hook(
        complex, lambda value, _: complex(*value) if isinstance(value, list) else complex(value)
    )
    made.register_structure_hook_factory(is_dataclass, lambda kind: _noun(kind, made))
    return made


def _scalar(kind: Any, own: bool) -> Callable[[Any, Any], Any]:
    def taken(value: Any, hint: Any) -> Any:
        if issubclass(hint, StrEnum):  # which is a text's kind to the converter
            return _word(value, hint)
        if own and kind is float and isinstance(value, str):
            with suppress(ValueError):
                return float(value)
        fits = isinstance(value, int | float if kind is float else kind) and isinstance(value, bool) == (kind is bool)
        if not fits or (kind in _LARGEST and not abs(value) < _LARGEST[kind]) or (value == "" and not own):
            raise UnfitError(value, _WANTED[kind])
        return kind(value)

    return taken


def _bounded(hint: Any, converter: Any) -> Callable[[Any, Any], Any]:
    wanted, plain = hint.__metadata__[0], converter.get_structure_hook(hint.__origin__)

    def taken(value: Any, _: Any) -> Any:
        found = plain(value, hint.__origin__)
        if found < 0 or (found == 0 and wanted == "positive"):
            raise UnfitError(value, wanted)
        return found

    return taken


def _is_marked(hint: Any) -> bool:
    return get_origin(hint) in (Union, types.UnionType) and any(hasattr(one, "MARK") for one in get_args(hint))


def _marked(hint: Any, converter: Any) -> Callable[[Any, Any], Any]:
    """Of several kinds the one whose key `MARK` a table has; that without a mark where it has none."""
    kinds = sorted((one for one in get_args(hint) if one is not type(None)), key=lambda kind: not hasattr(kind, "MARK"))

    def taken(value: Any, _: Any) -> Any:
        kind = next(kind for kind in kinds if getattr(kind, "MARK", None) in (None, *_table(value)))
        return converter.structure(value, kind.read_by() if hasattr(kind, "read_by") else kind)

    return taken


def _word(value: Any, kind: Any) -> Any:
    if value not in list(kind):
        raise UnfitError(value, "", [str(one) for one in kind])
    return kind(value)


def _list(hint: Any, converter: Any) -> Callable[[Any, Any], Any]:
    """Lists as tuples; a list of as many elements as a tuple's hint has."""
    inner = get_args(hint)
    length = None if inner[1:] in ((), (...,)) else len(inner)
    wanted = "a pair of numbers" if hint == _PAIR else f"a list of {_many(inner[0])}"
    each = converter.get_structure_hook(inner[0])

    def taken(value: Any, _: Any) -> Any:
        from cattrs.errors import IterableValidationError, IterableValidationNote

        if not isinstance(value, list | tuple) or (length is not None and len(value) != length):
            raise UnfitError(value, wanted)
        found = []
        for k, one in enumerate(value):
            try:
                found.append(each(one, inner[0]))
            except UnfitError as error:
                raise (error if error.known else UnfitError(one, wanted, entry=k + 1)) from None
            except Exception as error:
                error.add_note(IterableValidationNote("", k, inner[0]))
                raise IterableValidationError("", [error], hint) from None
        return tuple(found)

    return taken


def _many(hint: Any) -> str:
    if get_origin(hint) in _LISTS:
        return "pairs of numbers" if hint == _PAIR else "lists"
    return _MANY.get(getattr(hint, "__origin__", hint), "tables")


def _array(value: Any, _: Any) -> Any:
    """An array as it is, or a list of numbers as one."""
    return value if isinstance(value, np.ndarray) else np.array(value, dtype=float)


def _mapping(hint: Any, converter: Any) -> Callable[[Any, Any], Any]:
    _, inner = get_args(hint)
    plain = converter.get_structure_hook(dict[str, inner])  # type: ignore[valid-type]
    return lambda value, _: plain(_table(value), hint)


def _table(value: Any) -> Any:
    if not isinstance(value, dict):
        raise UnfitError(value, "a table")
    return value


def _noun(kind: type, converter: Any) -> Callable[[Any, Any], Any]:
    from cattrs.gen import make_dict_structure_fn, override

    if not hasattr(kind, "READ_AS") and hasattr(kind, "from_table"):
        own: Callable[[Any], Any] = kind.from_table
        return lambda value, _: own(_table(value))
    hints = get_type_hints(kind, include_extras=True)  # cattrs takes them without what Annotated adds
    renamed: Any = {one.name: override(omit=True) for one in fields(kind)}
    for one in _read_fields(kind):
        hook: Any = partial(lambda hint, value, _: converter.structure(value, hint), hints[one.name])
        renamed[one.name] = override(rename=_key(kind, one.name), struct_hook=hook)
    plain: Any = make_dict_structure_fn(kind, converter, **renamed)
    unfolded, made = getattr(kind, "unfolded", dict), getattr(kind, "made", lambda noun: noun)
    return lambda value, _: made(plain(unfolded(_table(value)), kind))


def _refusal(error: Exception, table: object, where: str, within: Sequence[str]) -> Exception:
    """The first refusal of what was read, in a sentence."""
    path, leaf = _first(error)
    key, at = "", table
    for step in (*within, *path):
        if key and isinstance(at, dict):
            where, key = f"{where}, {short(key)}", ""
        if isinstance(step, int) and isinstance(at, list | tuple) and step < len(at):
            at = at[step]
            where, key = (f"{where}, {key} {label(at, step + 1)}", "") if isinstance(at, dict) else (where, key)
        elif isinstance(at, dict) and step in at:
            key, at = str(step), at[step]
    if isinstance(leaf, UnfitError):
        return _unfit(leaf, key, where)
    where += f", {short(key)}" if key and isinstance(at, dict) else ""
    if isinstance(leaf, LoopshapeError):
        return type(leaf)(f"{where}: {leaf.what}", leaf.received, leaf.way_out)
    return leaf


def label(table: Mapping[str, Any], number: int) -> str:
    """What a table in a list is called: its name or file, else its number from 1."""
    name = table.get("name", table.get("file"))
    return short(repr(name)) if isinstance(name, str) else str(number)


def _unfit(found: UnfitError, key: str, where: str) -> LoopshapeError:
    what = f"{where}: {short(key)}" if key else where
    if found.known:
        way_out = f"{meant(found.value, found.known)}use {', '.join(found.known)}"
        return WrongUseError(f"{what} is not known", short(repr(found.value)), way_out)
    received = short(repr(found.value)) + (f" as entry {found.entry}" if found.entry else "")
    return WrongUseError(f"{what} must be {found.wanted}", received, "" if found.entry else _cure(found, short(key)))


def _cure(found: UnfitError, key: str) -> str:
    """The way out in the user's own value, where it is plain what was meant."""
    value, wanted = found.value, found.wanted
    if "number" in wanted and isinstance(value, str) and value.split():
        bare = value.split()[0]
        number = bare.lstrip("+-")[:1].isdigit() and bare[-1:].isdigit()
        say = "leave the unit out" if bare != value else "write it without quotes"
        return f"{say}: {key} = {bare}" if number else ""
    if wanted == "a text in quotes" and isinstance(value, int | float) and not isinstance(value, bool):
        return f'put it in quotes: {key} = "{value}"'
    if wanted == "true or false" and str(value).lower() in ("true", "false", "0", "1"):
        return f"write {key} = {'true' if str(value).lower() in ('true', '1') else 'false'}"
    return f"write {key} = [{value}]" if wanted == "a list of numbers" and isinstance(value, int | float) else ""


def _first(error: Exception) -> tuple[list[Any], Exception]:
    """The first refusal within groups, and the keys and numbers that lead to it: unknown keys first, then missing."""
    from cattrs.errors import BaseValidationError, ForbiddenExtraKeysError

    path: list[Any] = []
    while isinstance(error, BaseValidationError):
        group, within = error, error.exceptions
        unknown = [one for one in within if isinstance(one, ForbiddenExtraKeysError)]
        missing = [one.args[0] for one in within if isinstance(one, KeyError)]
        if unknown:
            return path, unknown_keys(sorted(unknown[0].extra_fields), keys(unknown[0].cl))
        if missing:
            return path, missing_keys(missing)
        error = within[0]
        for note in getattr(error, "__notes__", ()):
            if hasattr(note, "type"):
                path.append(_key(group.cl, note.name) if hasattr(note, "name") else note.index)
                break
    return path, error


def unknown_keys(words: Sequence[str], known: Sequence[str]) -> WrongUseError:
    """The refusal of keys that are not known."""
    own = short(", ".join(map(repr, words)))
    return WrongUseError("unknown key", own, f"{meant(words[0], known)}known are {', '.join(known)}")


def missing_keys(words: Sequence[str]) -> WrongUseError:
    """The refusal of a table without these keys."""
    what, them = ("keys are", "them") if len(words) > 1 else ("a key is", "it")
    return WrongUseError(f"{what} missing", f"no {', '.join(words)}", f"write {them}")
