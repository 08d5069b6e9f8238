"""The page on which a loop is shaped by hand: data, style and script in one text that loads nothing."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from importlib.resources import files

from loopshape.view.html.markup import Markup, json_block, tag
from loopshape.view.page.payload import Shaped, payload

#: the script, built from `src` by esbuild; `npm ci && npm run build` in this folder makes it anew
SCRIPT, STYLE = "shape.js", "shape.css"


def shape_page(loops: Sequence[Shaped], title: str, version: str, *, served: bool = False) -> str:
    """The whole page as HTML; the same loops give the same text. `served` by a server, it may ask it and no other."""
    script = resource(SCRIPT)
    body = [
        tag("div", tag("p", "This page needs JavaScript."), id="page"),
        json_block("data", payload(loops, title, version) | {"served": served}),
        tag("script", Markup(script)),
    ]
    html = tag("html", _head(script, title, served), tag("body", *body), lang="en")
    return f"<!DOCTYPE html>\n{html}\n"


def resource(name: str) -> str:
    """Style or script that is shipped with the package."""
    return files("loopshape.view.page").joinpath(name).read_text(encoding="utf-8")


def _head(script: str, title: str, served: bool) -> Markup:
    """Title, style, and a policy under which the page can neither load nor run anything but its own."""
    digest = b64encode(sha256(script.encode()).digest()).decode("ascii")
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; worker-src blob:"
    policy += "; connect-src 'self'" if served else ""
    return tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"{title} · loopshape shape"),
        tag("style", Markup(resource(STYLE))),
    )
