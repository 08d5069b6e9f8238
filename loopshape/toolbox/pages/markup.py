"""HTML and SVG as text: everything is escaped unless it was made here."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping
from hashlib import sha256
from html import escape as _escape
from typing import Any

import numpy as np

#: elements without content or end tag
VOID = frozenset({"meta", "img", "br", "hr", "input", "col", "link"})
#: what XML and HTML cannot hold, and what reorders the text around it (bidirectional overrides)
_UNFIT = dict.fromkeys([*range(9), 11, 12, *range(14, 32), 127, *range(0x202A, 0x202F), *range(0x2066, 0x206A)], " ")
_UNFIT |= dict.fromkeys([*range(0xD800, 0xE000), 0xFFFE, 0xFFFF], "\N{REPLACEMENT CHARACTER}")


class Markup(str):
    """Text that is HTML already; any other text is escaped when it enters a tag. What is added to it is escaped too."""

    __slots__ = ()

    def __add__(self, other: str) -> Markup:
        return Markup(str.__add__(self, text(other)))


Content = Markup | str | float | int | None | Iterable["Content"]


def text(value: object) -> Markup:
    """A value as HTML text: `&<>"'` become entities, characters that HTML cannot hold become blanks."""
    return value if isinstance(value, Markup) else Markup(_escape(str(value).translate(_UNFIT), quote=True))


def joined(parts: Iterable[Content], between: str = "") -> Markup:
    """Parts one after the other, None left out; `between` is escaped too."""
    return Markup(text(between).join(content(part) for part in parts if part is not None))


def content(part: Content) -> Markup:
    """What stands inside a tag: one part, or several in a row."""
    if part is None:
        return Markup("")
    if isinstance(part, str | float | int):
        return text(part)
    return joined(part)


def tag(name: str, /, *inside: Content, **attributes: object) -> Markup:
    """An element. `class_` is class, `data_x` is data-x; an attribute that is None or False is left out, True bare."""
    words = "".join(_attribute(key, value) for key, value in attributes.items())
    if name in VOID:
        return Markup(f"<{name}{words}>")
    return Markup(f"<{name}{words}>{joined(inside)}</{name}>")


def _attribute(key: str, value: object) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{text(value)}"'


def head(title: str, style: str, script: str, *allowed: str) -> Markup:
    """Title, style, and a policy under which the page can neither load nor run anything but its own and `allowed`."""
    digest = b64encode(sha256(script.encode()).digest()).decode("ascii")
    own = ("default-src 'none'", "style-src 'unsafe-inline'", f"script-src 'sha256-{digest}'")
    return tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content="; ".join((*own, *allowed))),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", title),
        tag("style", Markup(style)),
    )


def json_block(identity: str, data: Mapping[str, Any]) -> Markup:
    """Data for the page's script. No character in it can end the block or begin a comment."""
    words = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    for sign in "<>&":
        words = words.replace(sign, f"\\u{ord(sign):04x}")
    return tag("script", Markup(words), type="application/json", id=identity)


def packed(values: np.ndarray) -> dict[str, str]:
    """An array of float64, complex128, complex64 or uint8 as base64, least byte first, with its kind: {"f8": "..."}."""
    whole = np.ascontiguousarray(values)
    kinds = {np.complex128: "c16", np.complex64: "c8", np.uint8: "u1"}
    kind = kinds.get(whole.dtype.type, "f8")
    return {kind: b64encode(whole.astype(f"<{kind}").tobytes()).decode("ascii")}
