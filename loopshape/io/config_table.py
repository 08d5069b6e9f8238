"""A table of a user's file, read word by word: what is missing, unknown or of the wrong kind is named."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopshape.core.errors import LoopshapeError, UnreadableInputError, WrongUseError, meant, refuse_unknown
from loopshape.io.files import read_toml, short


@contextmanager
def said_in(where: str) -> Iterator[None]:
    """Put the place in front of a refusal that does not know it."""
    try:
        yield
    except LoopshapeError as error:
        raise type(error)(f"{where}: {error.what}", error.received, error.way_out) from None


def is_number(value: object) -> bool:
    """Whether a value is a finite number and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e300 < value < 1e300


@dataclass(frozen=True)
class ConfigTable:
    """One table and its place, which every refusal (`WrongUseError`) names."""

    table: Mapping[str, Any]
    where: str

    def only(self, *known: str) -> None:
        """Refuse keys that are not known, by name."""
        if unknown := [key for key in self.table if key not in known]:
            raise WrongUseError(
                f"{self.where}: unknown key", short(", ".join(map(repr, unknown))),
                f"{meant(unknown[0], known)}known are {', '.join(known)}",
            )  # fmt: skip

    def need(self, *keys: str) -> None:
        """Refuse a table without these keys, naming all that are missing."""
        if missing := [key for key in keys if key not in self.table]:
            raise WrongUseError(
                f"{self.where}: {'keys are' if len(missing) > 1 else 'a key is'} missing",
                f"no {', '.join(missing)}",
                "write them" if len(missing) > 1 else "write it",
            )

    def _wrong(self, key: str, wanted: str) -> WrongUseError:
        return WrongUseError(f"{self.where}: {short(key)} must be {wanted}", short(repr(self.table[key])))

    def text(self, key: str, default: str | None = None) -> str:
        """A text; without a default a missing key is refused."""
        if key not in self.table and default is not None:
            return default
        self.need(key)
        value = self.table[key]
        if not isinstance(value, str) or not value:
            raise self._wrong(key, "a text in quotes")
        return value

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
        if key not in self.table and default is not None:
            return default
        self.need(key)
        if not is_number(self.table[key]):
            raise self._wrong(key, "a finite number")
        return float(self.table[key])

    def maybe_number(self, key: str) -> float | None:
        """A finite number, or None where the key is missing."""
        return self.number(key) if key in self.table else None

    def positive(self, key: str, default: float | None = None) -> float:
        """A finite number above zero."""
        value = self.number(key, default)
        if value <= 0.0:
            raise self._wrong(key, "positive")
        return value

    def whole(self, key: str, default: int) -> int:
        """A whole number from 0 on."""
        value = self.table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
            raise self._wrong(key, "a whole number from 0 on")
        return value

    def truth(self, key: str, default: bool) -> bool:
        """true or false."""
        value = self.table.get(key, default)
        if not isinstance(value, bool):
            raise self._wrong(key, "true or false")
        return value

    def list_of_numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers."""
        self.need(key)
        value = self.table[key]
        if not isinstance(value, list) or not all(is_number(v) for v in value):
            raise self._wrong(key, "a list of numbers")
        return tuple(float(v) for v in value)

    def list_of_texts(self, key: str) -> tuple[str, ...]:
        """A list of texts; empty where it is missing."""
        value = self.table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) and v for v in value):
            raise self._wrong(key, "a list of texts in quotes")
        return tuple(value)

    def list_of_texts_or_empty(self, key: str) -> tuple[str, ...]:
        """A list of texts, of which some may be empty; empty where it is missing."""
        value = self.table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self._wrong(key, "a list of texts in quotes")
        return tuple(value)

    def inner(self, key: str) -> ConfigTable:
        """A table inside this one; empty where it is missing."""
        value = self.table.get(key, {})
        if not isinstance(value, dict):
            raise self._wrong(key, "a table")
        return ConfigTable(value, f"{self.where}, {short(key)}")

    def numbers(self, key: str) -> dict[str, float]:
        """A table of numbers; empty where it is missing."""
        inner = self.inner(key)
        return {name: inner.number(name) for name in inner.table}

    def tables(self, key: str) -> tuple[ConfigTable, ...]:
        """A list of tables, each placed by its name or number; empty where it is missing."""
        value = self.table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self._wrong(key, "a list of tables")
        return tuple(ConfigTable(v, f"{self.where}, {key} {_label(v, i)}") for i, v in enumerate(value, start=1))


def _label(table: Mapping[str, Any], number: int) -> str:
    name = table.get("name", table.get("file"))
    return short(repr(name)) if isinstance(name, str) else str(number)


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
