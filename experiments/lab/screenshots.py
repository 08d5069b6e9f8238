"""Pictures of pages, with the places of their texts noted in the PNG as those of figures are (`text_layout`)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from text_layout import PlacedText, with_texts

#: two columns still stand beside each other, and text of 12 px has 6 pt on paper
WIDTH_PX = 1000

_OF_CANVASES = """
const seen = new Map();
const clear = CanvasRenderingContext2D.prototype.clearRect, fill = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.clearRect = function (...box) {
  seen.set(this.canvas, []);
  return clear.apply(this, box);
};
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, ...more) {
  if (!text.trim()) return;
  const m = this.measureText(text), at = this.getTransform();
  const ends = [
    [x - m.actualBoundingBoxLeft, y - m.actualBoundingBoxAscent],
    [x + m.actualBoundingBoxRight, y + m.actualBoundingBoxDescent],
  ];
  const points = ends.map(([px, py]) => at.transformPoint(new DOMPoint(px, py)));
  if (!seen.has(this.canvas)) seen.set(this.canvas, []);
  seen.get(this.canvas).push({ text, size: parseFloat(this.font.match(/([\\d.]+)px/)[1]), points });
  return fill.call(this, text, x, y, ...more);
};
window.textsOfCanvases = () => [...seen].flatMap(([canvas, texts]) => {
  const box = canvas.getBoundingClientRect(), k = box.width / canvas.width;
  return canvas.isConnected ? texts.map((t) => {
    const xs = t.points.map((p) => box.left + k * p.x), ys = t.points.map((p) => box.top + k * p.y);
    return [t.text, t.size, Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }) : [];
});
"""
_OF_PAGE = """() => {
  const found = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const node = walk.currentNode, parent = node.parentElement;
    const shown = parent.checkVisibility({ visibilityProperty: true, opacityProperty: true });
    if (!node.textContent.trim() || !shown) continue;
    const range = document.createRange(); range.selectNodeContents(node);
    const style = getComputedStyle(parent), size = parseFloat(style.fontSize);
    if (style.clip !== "auto" || style.clipPath !== "none") continue;
    for (const b of range.getClientRects()) {
      const off = (b.height - size) / 2;
      if (b.width > 1) found.push([node.textContent.trim(), size, b.left, b.top + off, b.right, b.bottom - off]);
    }
  }
  return [...found, ...(window.textsOfCanvases ? window.textsOfCanvases() : [])];
}"""


@contextmanager
def chromium() -> Iterator[Any]:
    """The system's browser; ends with a sentence where there is none."""
    from playwright.sync_api import sync_playwright

    path = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
    if path is None:
        raise SystemExit("no chromium, chromium-browser or google-chrome on PATH: no screenshots")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path)
        yield browser
        browser.close()


def watched(page: Any) -> Any:
    """A page that remembers what its canvases write; call before it loads."""
    page.add_init_script(_OF_CANVASES)
    return page


def shoot(page: Any, path: Path) -> None:
    """The visible part of a page; text that goes on below it belongs to no picture."""
    width, height = page.viewport_size["width"], page.viewport_size["height"]
    texts = [PlacedText(*row) for row in page.evaluate(_OF_PAGE)]
    seen = [t for t in texts if t.y0 >= 0.0 and t.y1 <= height and t.x1 > 0.0 and t.x0 < width]
    path.write_bytes(with_texts(page.screenshot(), seen))
