"""The page of `shape` on loopback, with three more buttons: check, tune from here, save.

Only this machine is served, under a path with a random token; a request of another origin or host is refused, so that
no other page in the browser can ask.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from secrets import compare_digest, token_urlsafe
from socket import SHUT_RDWR, socket
from threading import Lock
from time import monotonic
from typing import Any

from loopshape.core.errors import LoopshapeError, WrongUseError
from loopshape.core.interrupts import until_interrupted
from loopshape.data.control.block import BLOCK_KINDS, Block, BlockTemplate, Free
from loopshape.loop.verdict import check
from loopshape.toolbox.pages.shape.payload import (
    ShapingSession,
    controller_from,
    controller_words,
    requirements_from,
)
from loopshape.toolbox.pages.shape.shaping import ShapedLoops, page_of

#: connections at once; a further one takes the place of the one that has been sending its request for longest
MOST_CONNECTIONS = 16
#: within which a request has come whole, and each part of an answer is taken
MOST_S = 10.0
#: what the page is given for the file that Save writes, in place of the mark of its present content
_MARK = token_urlsafe(24)
#: a free parameter may be tuned to so many times its value and as little
FREE_FACTOR = 10.0


class ShapeServer:
    """Answers of one page; `serve` runs until it is interrupted, `url` has the token."""

    def __init__(
        self, loops: Sequence[ShapingSession], title: str, save: Path, several: ShapedLoops | None = None
    ) -> None:
        self.title, self.several = title, several
        self.save_to, self.token, self.lock = save, token_urlsafe(24), Lock()
        self._show(loops)
        self.http = _Bounded(("127.0.0.1", 0), _handler(self))

    def _show(self, loops: Sequence[ShapingSession]) -> None:
        self.loops = {one.controller.loop: one for one in loops}
        self._page = page_of(loops, self.title, _MARK)

    @property
    def page(self) -> bytes:
        """The page, with the mark of what Save would replace."""
        return self._page.replace(_MARK.encode(), self._mark().encode())

    def _mark(self) -> str:
        """What tells the content of Save's file from any other, "none" where there is no file."""
        from loopshape.io.input_guard import own
        from loopshape.io.provenance import file_sha256

        own(self.save_to)  # that another writes it is what this is for, and ends no command
        found = file_sha256(self.save_to) if self.save_to.exists() else "none"
        own(self.save_to)
        return found

    @property
    def origin(self) -> str:
        """Scheme, address and port."""
        return f"http://127.0.0.1:{self.http.server_address[1]}"

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"{self.origin}/{self.token}/"

    def serve(self) -> None:
        """Answer until interrupted."""
        try:
            self.http.serve_forever()
        finally:
            self.http.server_close()

    def serve_until_interrupted(self) -> None:
        """The same for a command: Ctrl-C is its right end."""
        with until_interrupted():
            self.serve()

    def answer(self, name: str, asked: Mapping[str, Any]) -> dict[str, Any]:
        """What a button asks: "check", "tune", "save" or "close" (the other loops, as they are now); one at a time."""
        does: dict[str, Callable[[ShapingSession, Mapping[str, Any]], dict[str, Any]]]
        does = {"check": self._check, "tune": self._tune, "save": self._save, "close": self._close}
        if name not in does:
            raise WrongUseError("the page asks for what is not known", name, f"one of {', '.join(does)}")
        controller = asked.get("controller")
        loop = controller.get("loop") if isinstance(controller, Mapping) else None
        if loop not in self.loops:
            raise WrongUseError("the page asks about another loop", repr(loop), f"one of {', '.join(self.loops)}")
        with self.lock:
            return does[name](self.loops[loop], asked)

    def _check(self, one: ShapingSession, asked: Mapping[str, Any]) -> dict[str, Any]:
        controller, required = controller_from(asked["controller"]), requirements_from(asked["requirements"])
        verdict = check(one.frfs, controller, one.of_plant(required), one.fits, disturbances=one.disturbances)
        return {"certificate": {"outcome": verdict.outcome.value}, "words": repr(verdict)}

    def _tune(self, one: ShapingSession, asked: Mapping[str, Any]) -> dict[str, Any]:
        from loopshape.design.tune import Search, tune

        start = controller_from(asked["controller"])
        structure = tuple(_template(block, locked) for block, locked in zip(start.blocks, asked["locked"], strict=True))
        required = replace(one.of_plant(requirements_from(asked["requirements"])), structure=structure)
        found = tune(one.frfs, required, one.fits, start=start, search=Search(starts=1), disturbances=one.disturbances)
        word = "meets all requirements" if found.feasible else f"does not meet all: {found.outcome}"
        return {"controller": controller_words(found.controller), "words": f"tuned from here; the best found {word}"}

    def _close(self, one: ShapingSession, asked: Mapping[str, Any]) -> dict[str, Any]:
        if self.several is None:
            raise WrongUseError("the page has single loops", "close", "serve it with --matrix")
        self._show(self.several.sessions([controller_from(words) for words in asked["controllers"]]))
        return {"words": "each loop has the others closed as they are now"}

    def _save(self, one: ShapingSession, asked: Mapping[str, Any]) -> dict[str, Any]:
        from loopshape.io.files import make_folder
        from loopshape.io.folder_lock import locked
        from loopshape.io.write.controllers import write_controllers

        mine = controller_from(asked["controller"])
        make_folder(self.save_to.parent)
        with locked(self.save_to.parent):
            if asked["saved"] != self._mark():
                raise WrongUseError(
                    "not saved: the file was changed by another since this page was loaded or saved it last",
                    str(self.save_to), "keep a copy of it if it is needed, load the page again, which keeps this"
                    " design, and save",
                )  # fmt: skip
            self.loops[mine.loop] = replace(one, controller=mine)
            write_controllers(self.save_to, [x.controller for x in self.loops.values()], None)
            return {"words": f"saved to {self.save_to}", "saved": self._mark()}


def _template(block: Block, locked: Sequence[str]) -> BlockTemplate:
    """A block as a structure: what is not locked may move, a notch's equal frequencies together."""
    values = dict(block.parameters)
    tied = block.kind == "notch" and values["f1_hz"] == values["f2_hz"] and not {"f1_hz", "f2_hz"} & set(locked)
    tie = {"f2_hz": "f1_hz"} if tied else {}
    fixed = {name for name in BLOCK_KINDS[block.kind].parameters if name in locked or values[name] <= 0.0}
    made = {
        name: value if name in fixed else Free(value / FREE_FACTOR, value * FREE_FACTOR, value)
        for name, value in values.items()
        if name not in tie
    }
    return BlockTemplate(block.kind, made, tie)


class _Bounded(ThreadingHTTPServer):
    """A bounded number of connections, each of which says its request in a bounded time."""

    daemon_threads = True

    def __init__(self, *given: Any) -> None:
        self._since: dict[socket, float] = {}
        self._asking: set[socket] = set()
        self._counting = Lock()
        super().__init__(*given)

    def process_request(self, request: Any, client_address: Any) -> None:
        """In a thread of its own; the one that has been asking for longest goes where there are too many."""
        with self._counting:
            if len(self._since) >= MOST_CONNECTIONS:
                for one in list(self._since):
                    if one in self._asking:
                        self._drop(one)
                        break
                else:
                    self.shutdown_request(request)  # all of them are being answered
                    return
            self._since[request] = monotonic()
            self._asking.add(request)
        super().process_request(request, client_address)

    def asked(self, request: Any) -> None:
        """A request has come whole."""
        with self._counting:
            self._asking.discard(request)

    def shutdown_request(self, request: Any) -> None:
        """Its end, whoever ended it."""
        super().shutdown_request(request)
        self._since.pop(request, None)
        self._asking.discard(request)

    def service_actions(self) -> None:
        """Twice a second: requests that are not whole in time are dropped."""
        with self._counting:
            for one in [one for one in self._asking if monotonic() - self._since.get(one, 0.0) > MOST_S]:
                self._drop(one)

    def _drop(self, one: socket) -> None:
        self._since.pop(one, None)
        self._asking.discard(one)
        with suppress(OSError):
            one.shutdown(SHUT_RDWR)  # its thread reads the end, and closes it

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing: a connection that broke is no news."""


def _handler(server: ShapeServer) -> type[BaseHTTPRequestHandler]:
    """The class that answers requests for a server."""

    class Handler(BaseHTTPRequestHandler):
        """Requests of the page alone."""

        timeout = MOST_S

        def do_GET(self) -> None:
            """The page."""
            server.http.asked(self.connection)
            if self._allowed(""):
                self._send(200, "text/html; charset=utf-8", server.page)

        def do_POST(self) -> None:
            """A button's request."""
            name = self.path.rsplit("/", 1)[-1]
            if not self._allowed(name):
                return
            try:
                answer = server.answer(name, self._asked())
            except LoopshapeError as error:
                self._send(400, "application/json", json.dumps({"error": str(error)}).encode())
            except RecursionError:
                self._send(400, "application/json", b'{"error": "a request without sense: it is nested too deeply"}')
            except (KeyError, TypeError, ValueError) as error:
                self._send(400, "application/json", json.dumps({"error": f"a request without sense: {error}"}).encode())
            else:
                self._send(200, "application/json", json.dumps(answer).encode())

        def _allowed(self, name: str) -> bool:
            own = f"/{server.token}/{name}"
            same = self.headers.get("Host") == server.origin.removeprefix("http://")
            origin = self.headers.get("Origin")
            if same and origin in (None, server.origin) and compare_digest(self.path.encode(), own.encode()):
                return True
            self._send(403, "text/plain; charset=utf-8", b"refused: another origin, or no token\n")
            return False

        def _asked(self) -> Mapping[str, Any]:
            size = int(self.headers.get("Content-Length") or 0)
            most_bytes = 1_000_000  # a request of the page is far smaller
            if not 0 < size <= most_bytes or self.headers.get("Content-Type") != "application/json":
                raise WrongUseError("a request of the page is JSON of up to 1 MB", f"{size} bytes")
            text = self.rfile.read(size)
            server.http.asked(self.connection)
            asked = json.loads(text)
            if not isinstance(asked, dict):
                raise WrongUseError("a request of the page is a JSON object", type(asked).__name__)
            return asked

        def _send(self, code: int, kind: str, body: bytes) -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: the command's own words are enough."""

    return Handler
