"""A table of a user's file, read word by word: what is missing, unknown or of the wrong kind is named."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from loopshape.core.errors import LoopshapeError, UnreadableInputError, WrongUseError, refuse_unknown
from loopshape.core.gate import Count, Positive
from loopshape.io.files import read_toml, short
from loopshape.io.schema import label, missing_keys, read, unknown_keys, value_of

T = TypeVar("T")


@contextmanager
def said_in(where: str) -> Iterator[None]:
    """Put the place in front of a refusal that does not know it."""
    try:
        yield
    except LoopshapeError as error:
        raise type(error)(f"{where}: {error.what}", error.received, error.way_out) from None


@dataclass(frozen=True)
class ConfigTable:
    """One table and its place, which every refusal (`WrongUseError`) names."""

    table: Mapping[str, Any]
    where: str

    def only(self, *known: str) -> None:
        """Refuse keys that are not known, by name."""
        if unknown := [key for key in self.table if key not in known]:
            with said_in(self.where):
                raise unknown_keys(unknown, known)

    def need(self, *keys: str) -> None:
        """Refuse a table without these keys, naming all that are missing."""
        if missing := [key for key in keys if key not in self.table]:
            with said_in(self.where):
                raise missing_keys(missing)

    def value(self, key: str, hint: Any, default: Any = None) -> Any:
        """A value of a type; without a default a missing key is refused."""
        if key not in self.table and default is not None:
            return default
        self.need(key)
        return value_of(hint, self.table[key], key, self.where)

    def text(self, key: str, default: str | None = None) -> str:
        """A text; without a default a missing key is refused."""
        return str(self.value(key, str, default))

    def maybe_text(self, key: str) -> str | None:
        """A text, or None where the key is missing."""
        return self.text(key) if key in self.table else None

    def one_of(self, key: str, known: Sequence[str], default: str | None = None) -> str:
        """A text out of `known`."""
        value = self.text(key, default)
        refuse_unknown(f"{self.where}: {key} is not known", value, known)
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; without a default a missing key is refused."""
        return float(self.value(key, float, default))

    def positive(self, key: str, default: float | None = None) -> float:
        """A finite number above zero."""
        return float(self.value(key, Positive, default))

    def whole(self, key: str, default: int) -> int:
        """A whole number from 0 on."""
        return int(self.value(key, Count, default))

    def list_of_texts(self, key: str) -> tuple[str, ...]:
        """A list of texts; empty where it is missing."""
        return tuple(self.value(key, tuple[str, ...], ()))

    def inner(self, key: str) -> ConfigTable:
        """A table inside this one; empty where it is missing."""
        return ConfigTable(self.value(key, Mapping[str, Any], {}), f"{self.where}, {short(key)}")

    def numbers(self, key: str) -> dict[str, float]:
        """A table of numbers; empty where it is missing."""
        return dict(self.value(key, Mapping[str, float], {}))

    def tables(self, key: str) -> tuple[ConfigTable, ...]:
        """A list of tables, each placed by its name or number; empty where it is missing."""
        value = self.value(key, tuple[Mapping[str, Any], ...], ())
        return tuple(ConfigTable(v, f"{self.where}, {key} {label(v, i)}") for i, v in enumerate(value, start=1))


def read_file(path: Path, kind: type[T], file_format: str) -> T:
    """A TOML file of one format as a noun; refuses another format by name, and what `schema.read` refuses."""
    table = dict(read_words(path, file_format).table)
    del table["format"]
    return read(kind, table, path.name)


def read_words(path: Path, file_format: str) -> ConfigTable:
    """The table of a TOML file of one format; refuses another format by name."""
    words = ConfigTable(read_toml(path), path.name)
    found = words.table.get("format")
    if found != file_format:
        raise UnreadableInputError(
            f"{path} is not of the format {file_format}",
            short(f"format = {found!r}") if found is not None else "no format",
            f'begin the file with format = "{file_format}"',
        )
    return words


def refuse_doubles(names: Iterable[str], where: str, what: str) -> None:
    """Refuse a name that stands twice."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise WrongUseError(f"{where}: two {what} have one name", short(repr(name)), "give each its own")
        seen.add(name)
