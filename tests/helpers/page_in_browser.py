"""A browser for pages that are driven as a person drives them: the system's, by Playwright."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

BROWSER = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
QUIET = (
    "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


def skip_without_browser() -> Any:
    """Playwright's entry, or a skip that says what is missing."""
    found = pytest.importorskip("playwright.sync_api", reason="the extra dev (playwright) is not installed")
    if BROWSER is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on PATH")
    return found.sync_playwright


@contextmanager
def browser() -> Iterator[Any]:
    with skip_without_browser()() as playwright:
        made = playwright.chromium.launch(executable_path=BROWSER, args=list(QUIET), chromium_sandbox=False)
        try:
            yield made
        finally:
            made.close()


def opened(context: Any, path: Path) -> Any:
    """The page in a file, with its errors in `page.errors`, once its first intervals are there."""
    page = context.new_page()
    page.errors = []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on("request", lambda request: page.errors.append(request.url) if request.url.startswith("http") else None)
    page.goto(path.as_uri())
    settled(page)
    return page


def until(page: Any, true: str) -> None:
    """Waits until an expression is true in the page, whose policy allows no other way to ask it."""
    for _ in range(400):
        if page.evaluate(true):
            return
        page.wait_for_timeout(25)
    raise AssertionError(f"{true} did not become true within 10 s")


def settled(page: Any) -> None:
    """Waits until intervals and stability of what is shown are there."""
    page.wait_for_timeout(30)
    page.wait_for_selector("#verdict-badge .badge:not(.none)", timeout=20_000)
