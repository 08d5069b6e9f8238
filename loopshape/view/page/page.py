"""The page on which a loop is shaped by hand: data, style and script in one text that loads nothing."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

from loopshape.view.html.markup import Markup, head, json_block, tag
from loopshape.view.page.payload import ShapingSession, payload

#: the script, built from `src` by esbuild; `npm ci && npm run build` in this folder makes it anew
SCRIPT, STYLE = "shape.js", "shape.css"


def shape_page(loops: Sequence[ShapingSession], title: str, version: str, *, saved: str | None = None) -> str:
    """The whole page as HTML; the same loops give the same text. Of a server, it may ask it and no other,
    and says which content of the server's file, `saved`, it may replace.
    """
    script = resource(SCRIPT)
    body = [
        tag("div", tag("p", "This page needs JavaScript."), id="page"),
        json_block("data", payload(loops, title, version) | {"served": saved is not None, "saved": saved or ""}),
        tag("script", Markup(script), id="script"),
    ]
    allowed = ("worker-src blob:", *["connect-src 'self'"] * (saved is not None))
    top = head(f"{title} · loopshape shape", resource(STYLE), script, *allowed)
    html = tag("html", top, tag("body", *body), lang="en")
    return f"<!DOCTYPE html>\n{html}\n"


def resource(name: str) -> str:
    """Style or script that is shipped with the package."""
    return files("loopshape.view.page").joinpath(name).read_text(encoding="utf-8")
