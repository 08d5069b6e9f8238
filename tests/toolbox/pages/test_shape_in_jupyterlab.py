"""The widget of `shape` in a running JupyterLab: a number that is typed in the cell is in Python, and back."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import page_in_browser
import pytest

HELPERS = Path(__file__).parents[2] / "helpers"
TOKEN = "shape"
CELLS = (
    f"import sys; sys.path[:0] = {[str(HELPERS / name) for name in ('', 'loops', 'nouns')]!r}\n"
    "import loopshape as ls, shaped_cases\n"
    "P, R, C = shaped_cases.bench()\n"
    "w = ls.shape(P, C, R, None)\n"
    "w",
    "print('gain', w.controller.blocks[0].parameters['gain'])",
    "w.controller = ls.controller(ls.gain(7.0), rate_hz=2500.0, loop='motor')\n"
    "print('assigned', w.check().outcome.value)",
)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a notebook in JupyterLab on loopback, with a home of its own."""
    pytest.importorskip("jupyterlab", reason="jupyterlab is not installed: pip install jupyterlab")
    pytest.importorskip("anywidget", reason="the extra notebook is not installed")
    home = tmp_path_factory.mktemp("lab")
    cells = [{"cell_type": "code", "id": f"c{k}", "metadata": {}, "outputs": [], "execution_count": None, "source": x}
             for k, x in enumerate(CELLS)]  # fmt: skip
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    book = {"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    (home / "bench.ipynb").write_text(json.dumps(book))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = [
        sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--ServerApp.ip=127.0.0.1",
        f"--ServerApp.port={port}", f"--IdentityProvider.token={TOKEN}", f"--ServerApp.root_dir={home}",
    ]  # fmt: skip
    own = {"HOME": str(home), "JUPYTER_CONFIG_DIR": str(home / "config"), "IPYTHONDIR": str(home / "ipython")}
    with (home / "said").open("w") as said:
        process = subprocess.Popen(words, env=os.environ | own, stdout=said, stderr=said)
        try:
            answered(f"http://127.0.0.1:{port}/api?token={TOKEN}", process, home / "said")
            yield f"http://127.0.0.1:{port}/lab/tree/bench.ipynb?token={TOKEN}"
        finally:
            process.terminate()
            process.wait(30)


def answered(address: str, process: subprocess.Popen[bytes], said: Path) -> None:
    end = time.monotonic() + 90.0
    while time.monotonic() < end and process.poll() is None:
        try:
            urlopen(address, timeout=5).close()
            return
        except (URLError, OSError):
            time.sleep(0.3)
    raise AssertionError(f"JupyterLab did not answer: {said.read_text()[-2000:]}")


def run(page: Any, cell: int) -> None:
    """Clicks into a cell and runs it, as a person does."""
    page.locator(".jp-CodeCell .jp-InputArea-editor").nth(cell).click()
    page.keyboard.press("Control+Enter")


def printed(page: Any, cell: int, words: str) -> None:
    """Runs a cell until it prints words."""
    for _ in range(40):
        run(page, cell)
        page.wait_for_timeout(500)
        if words in page.locator(".jp-CodeCell").nth(cell).locator(".jp-OutputArea").inner_text():
            return
    raise AssertionError(page.locator(".jp-CodeCell").nth(cell).inner_text())


@pytest.mark.long
@pytest.mark.hour
def test_a_number_typed_in_the_cell_is_in_python_and_back(lab: str, tmp_path: Path) -> None:
    with page_in_browser.browser() as browser:
        page = browser.new_context(viewport={"width": 1440, "height": 1600}).new_page()
        page.set_default_timeout(90_000)
        page.goto(lab)
        page.locator(".jp-Notebook .jp-CodeCell").nth(2).wait_for()
        page.locator(
            ".jp-NotebookPanel-toolbar [title*='Idle'], .jp-Notebook-ExecutionIndicator[data-status='idle']"
        ).first.wait_for(state="attached")
        run(page, 0)
        page.locator("#magnitude").wait_for()
        page.locator("#verdict-badge .badge:not(.none)").wait_for()  # its worker has answered
        field = page.get_by_label("gain of block 1, gain", exact=True)
        field.click()
        page.keyboard.press("Control+a")
        page.keyboard.type("9.5")
        page.keyboard.press("Enter")
        printed(page, 1, "gain 9.5")
        box = page.locator("#magnitude").bounding_box()
        assert box["width"] > 300
        page.screenshot(path=tmp_path / "lab.png")
        run(page, 2)
        page.locator(".jp-OutputArea", has_text="assigned failed").first.wait_for()
        for _ in range(100):
            if field.input_value() == "7":
                break
            page.wait_for_timeout(100)
        assert field.input_value() == "7"
        print(tmp_path / "lab.png")
