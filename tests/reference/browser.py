"""Pages in a real browser: headless Chromium loads one at a given width, does something on it, and says what became of
it."""

import html
import json
import pathlib
import shutil
import subprocess
import tempfile
from typing import NamedTuple

import pytest

_BEFORE = """<script>window.wrong = [];
addEventListener("error", (e) => wrong.push(e.message || `not loaded: ${e.target.src}`), true);
addEventListener("unhandledrejection", (e) => wrong.push(String(e.reason)));
console.error = console.warn = (...words) => wrong.push(words.join(" "));</script>"""

_FRAME = """<!DOCTYPE html><meta charset="utf-8"><body style="margin:0">
<iframe id="page" style="border:0;width:WIDTHpx;height:900px" srcdoc="PAGE"></iframe><pre id="found"></pre>
<script>addEventListener("load", async () => {
  const inside = document.getElementById("page").contentWindow, root = inside.document.documentElement;
  const later = () => new Promise((done) => setTimeout(done, 50));
  const lazy = [...root.querySelectorAll("img[loading]")];
  for (const image of lazy) image.loading = "eager";
  await later();
  const answer = await (async (window, document, later) => { ACTION })(inside, inside.document, later);
  const images = [...root.querySelectorAll("img")];
  const paths = [...root.querySelectorAll(".charts path")];
  document.getElementById("found").textContent = JSON.stringify({
    wrong: inside.wrong, answer: answer ?? null, overflow: root.scrollWidth - root.clientWidth, images: images.length,
    empty: images.filter((x) => !(x.complete && x.naturalWidth > 0)).map((x) => x.alt),
    broken: paths.filter((x) => /NaN|undefined|Infinity/.test(x.getAttribute("d"))).length,
    outside: [...root.querySelectorAll("[src],link[href]")].map((x) => x.getAttribute("src") ?? x.getAttribute("href"))
      .filter((x) => /^(https?:)?\\/\\//.test(x)),
  });
});</script></body>"""


class Seen(NamedTuple):
    """What a browser says of a page: errors of its console, pixels that it is too wide, its images and those of them
    that are not drawn, paths with broken numbers, what it would load from elsewhere, and what the action returned."""

    wrong: list
    overflow: int
    images: int
    empty: list
    broken: int
    outside: list
    answer: object


def seen(page: pathlib.Path, width: int = 1100, action: str = "", media: str = "screen") -> Seen:
    """Load a page at a width, run an action (JavaScript with `window`, `document` and `later()`), and look.

    `media`: "print" takes the rules for paper."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium on this machine: pages are not looked at in a browser.")
    text = page.read_text(encoding="utf-8").replace("<head>", f"<head>{_BEFORE}", 1)
    text = text.replace("@media print", "@media all") if media == "print" else text
    frame = _FRAME.replace("WIDTH", str(width)).replace("ACTION", action).replace("PAGE", html.escape(text))
    wrapper = page.with_name(f"looked-at-{page.stem}.html")
    wrapper.write_text(frame, encoding="utf-8")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"]
        options += [f"--user-data-dir={profile}", f"--window-size={width},900"]
        done = subprocess.run(
            [browser, *options, wrapper.resolve().as_uri()],
            capture_output=True,
            text=True,
            timeout=60,
        )
    wrapper.unlink()
    said = done.stdout.rpartition('<pre id="found">')[2].partition("</pre>")[0]
    assert said, done.stderr[-2000:]
    return Seen(**json.loads(html.unescape(said)))


_ON_PAPER = """
const shown = (x) => x.getClientRects().length > 0;
const all = (name) => [...document.querySelectorAll(name)];
return {
  controls: all("select, button, .tabs > label").filter(shown).length,
  hidden: all("figure, table").filter((x) => !x.checkVisibility() && !x.closest("[hidden]")).length,
  cut: all(".wide, table, figure").filter((x) => x.scrollWidth > x.clientWidth + 1
    && window.getComputedStyle(x).overflowX !== "visible").length,
};
"""
_PAPER = 703  # pixels of A4 between margins of 12 mm


def assert_prints(page: pathlib.Path) -> None:
    """On paper nothing is cut, hidden or there to be clicked on."""
    found = seen(page, _PAPER, _ON_PAPER, "print")
    assert found.answer == {"controls": 0, "hidden": 0, "cut": 0} and found.overflow <= 0, f"{page.name}: {found}"


def assert_fine(page: pathlib.Path) -> None:
    """Below 3 MB, nothing from elsewhere, nothing wrong, everything drawn, no wider than a phone or a screen."""
    assert page.stat().st_size < 3e6
    for width in (400, 1100):
        found = seen(page, width)
        assert (found.wrong, found.empty, found.broken, found.outside) == ([], [], 0, []), f"{page.name}, {width} px"
        assert found.overflow <= 0, f"{page.name} is {found.overflow} px wider than {width} px"
    assert_prints(page)
