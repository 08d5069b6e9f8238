"""Debian's Firefox, driven by WebDriver BiDi over its own websocket: no driver, and no browser of Playwright's.

W3C, WebDriver BiDi, https://www.w3.org/TR/webdriver-bidi/. A page has the few calls that the tests of `shape` need.
"""

import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FIREFOX = next((p for n in ("firefox-esr", "firefox") if (p := shutil.which(n))), None)
KEYS = {"Enter": "\ue007", "Tab": "\ue004", "Control": "\ue009", "Shift": "\ue008", "ArrowUp": "\ue013"}
#: nothing is fetched but the page
QUIET = """user_pref("app.update.enabled", false);
user_pref("datareporting.policy.dataSubmissionEnabled", false);
user_pref("network.captive-portal-service.enabled", false);
user_pref("network.connectivity-service.enabled", false);
user_pref("browser.download.folderList", 2);
user_pref("browser.download.dir", "FOLDER");
"""


class Page:
    """A tab."""

    def __init__(self, ask: Any, context: str) -> None:
        self.ask, self.context = ask, context

    def goto(self, path: Path) -> None:
        """Opens a file; answers once its first intervals are there."""
        self.ask("browsingContext.navigate", context=self.context, url=path.as_uri(), wait="complete")
        self.until("loopshape.state.settled")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression, waited for where it is a promise; what it throws is an AssertionError."""
        words = f"Promise.resolve({expression}).then(value => JSON.stringify(value ?? null))"
        answer = self.ask("script.evaluate", expression=words, target={"context": self.context}, awaitPromise=True)
        assert answer["type"] == "success", answer["exceptionDetails"]["text"]
        return json.loads(answer["result"]["value"])

    def until(self, true: str, seconds: float = 20.0) -> None:
        """Waits until an expression is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.evaluate(f"(() => {{ try {{ return !!({true}) }} catch {{ return false }} }})()"):
                return
            time.sleep(0.03)
        raise AssertionError(f"{true} did not become true within {seconds:g} s")

    def press(self, *keys: str) -> None:
        """Presses keys together; words are names of `KEYS`, and a longer text is typed letter by letter."""
        down = [KEYS.get(key, key) for key in keys]
        acts = [{"type": "keyDown", "value": key} for key in down]
        self._act({"type": "key", "id": "keys", "actions": acts + [{"type": "keyUp", "value": k} for k in down[::-1]]})

    def fill(self, label: str, text: str) -> None:
        """Types into the field of a label in place of what it holds, and Enter."""
        self.evaluate(
            f"""(() => {{ const x = document.querySelector('[aria-label="{label}"]'); x.focus(); x.select() }})()"""
        )
        for letter in text:
            self.press(letter)
        self.press("Enter")

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        """Drags from one place of the window to another."""
        between = [[a + (b - a) * k / steps for a, b in zip(start, end, strict=True)] for k in range(steps + 1)]
        moves = [{"type": "pointerMove", "x": round(x), "y": round(y)} for x, y in between]
        acts = [moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]
        self._act({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": acts})

    def follow(self, places: list[tuple[float, float]], pause_ms: int) -> None:
        """Drags along places of the window, a move each so many milliseconds."""
        moves = [{"type": "pointerMove", "x": round(x), "y": round(y), "duration": pause_ms} for x, y in places]
        acts = [moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]
        self._act({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": acts})

    def click(self, label: str) -> None:
        """Clicks the button of a label."""
        self.evaluate(f"document.querySelector('[aria-label=\"{label}\"]').click()")

    def give(self, selector: str, file: Path) -> None:
        """Chooses a file for an input."""
        nodes = self.ask(
            "browsingContext.locateNodes", context=self.context, locator={"type": "css", "value": selector}
        )["nodes"]
        self.ask("input.setFiles", context=self.context, element={"sharedId": nodes[0]["sharedId"]}, files=[str(file)])

    def close(self) -> None:
        """Closes the tab."""
        self.ask("browsingContext.close", context=self.context)

    def _act(self, source: dict[str, Any]) -> None:
        self.ask("input.performActions", context=self.context, actions=[source])


class Firefox:
    """A running Firefox; `downloads` is where it saves."""

    def __init__(self, socket: Any, downloads: Path) -> None:
        self.socket, self.downloads, self.asked = socket, downloads, 0
        self.ask("session.new", capabilities={})

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command and its answer; an error is an AssertionError."""
        self.asked += 1
        self.socket.send(json.dumps({"id": self.asked, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv(timeout=60.0))
            if answer.get("id") == self.asked:
                assert answer["type"] == "success", f"{method}: {answer.get('message')}"
                return dict(answer["result"])

    def opened(self, path: Path) -> Page:
        """A file in a new tab."""
        page = Page(self.ask, self.ask("browsingContext.create", type="tab")["context"])
        self.ask("browsingContext.setViewport", context=page.context, viewport={"width": 1440, "height": 1000})
        page.goto(path)
        return page


@contextmanager
def firefox(folder: Path) -> Iterator[Firefox]:
    """Firefox with a profile of its own in a folder; a skip that says what is missing."""
    client = pytest.importorskip("websockets.sync.client", reason="the extra dev (websockets) is not installed")
    if FIREFOX is None:
        pytest.skip("no firefox-esr or firefox on PATH")
    profile, downloads = folder / "profile", folder / "downloads"
    profile.mkdir()
    downloads.mkdir()
    (profile / "user.js").write_text(QUIET.replace("FOLDER", str(downloads)))
    words = [FIREFOX, "--headless", "--no-remote", "--profile", str(profile), "--remote-debugging-port", "0"]
    with (folder / "said").open("w+") as said:
        process = subprocess.Popen(words, stderr=said, stdout=subprocess.DEVNULL)
        try:
            with client.connect(f"{_address(process, folder / 'said')}/session", max_size=None) as socket:
                yield Firefox(socket, downloads)
        finally:
            process.terminate()
            process.wait(20)


def _address(process: subprocess.Popen[bytes], said: Path) -> str:
    """Where a Firefox that starts listens, as it says; a skip where it ends instead."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end and process.poll() is None:
        line = next((x for x in said.read_text().splitlines() if "listening on ws" in x), "")
        if line:
            return line.split()[-1]
        time.sleep(0.03)
    pytest.skip("Firefox does not start here")
