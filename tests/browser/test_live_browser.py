"""The live page in a real browser: it follows a run, presses keys, and asks nobody else."""

from __future__ import annotations

import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from live_browser import BROWSER, browse

from rig.core.types import Frame, Pair, Settings
from rig.web.live import LiveView
from rig.web.slot import Glimpse

if BROWSER is None:
    pytest.skip("chromium is not installed", allow_module_level=True)

TOKEN = "a-token-of-enough-letters"
HOSTILE = "<img src=x onerror=console.error(1)>"


def frame() -> Frame:
    image = np.tile(np.arange(0, 256, dtype=np.uint8), (240, 1))[:, :256]
    return Frame(np.ascontiguousarray(image), "bayer_rggb8", 0, 0, 0, Settings(1000.0, 0.0))


def state() -> dict[str, object]:
    return {
        "title": HOSTILE,
        "status": "pair 7 of 12",
        "big": "+0.42",
        "hint": "open the ring",
        "level": "warn",
        "values": [["exposure", "1000 us", "2000 us"]],
        "notes": ["disk: 12.0 GB left"],
        "keys": [["o", "open"]],
        "history": [0.5, 0.4, 0.3],
    }


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[str]]:
    """Let a browser watch a run that goes on for a while and then ends."""
    with LiveView.open("127.0.0.1", 0, TOKEN, lambda key: key == "o") as view:
        done = threading.Event()

        def drive() -> None:
            while not done.wait(0.05):
                view.slot.put(Glimpse(Pair(frame(), frame()), state))

        loop = threading.Thread(target=drive)
        loop.start()
        try:
            folder = tmp_path_factory.mktemp("live")
            return browse(view.url, folder, "--virtual-time-budget=1500")
        finally:
            done.set()
            loop.join()


def test_the_page_shows_the_run(seen: tuple[str, list[str]]) -> None:
    dom, _ = seen
    assert re.search(r'<p id="status"[^>]*>pair 7 of 12</p>', dom)
    assert re.search(r'<p id="big"[^>]*class="warn"[^>]*>\+0\.42</p>', dom)
    assert "<td>1000 us</td><td>2000 us</td>" in dom
    assert '<button data-key="o">open</button>' in dom
    assert "disk: 12.0 GB left" in dom


def test_it_keeps_following(seen: tuple[str, list[str]]) -> None:
    number = re.search(r'data-n="(\d+)"', seen[0])
    assert number is not None
    assert int(number[1]) > 1


def test_the_console_is_clean(seen: tuple[str, list[str]]) -> None:
    assert seen[1] == []


def test_names_run_no_script(seen: tuple[str, list[str]]) -> None:
    assert "&lt;img src=x" in seen[0]
    assert "<img src=" not in seen[0].replace('<img id="', "")


def test_pictures_decode_and_a_key_arrives(tmp_path: Path) -> None:
    pressed: list[str] = []

    def press(key: str) -> bool:
        pressed.append(key)
        return True

    probe = b"""
    addEventListener("load", () => setInterval(() => {
      const wide = [...document.images].map((i) => i.naturalWidth);
      document.body.dataset.wide = wide.join(",");
      const button = document.querySelector("button");
      if (button && !document.body.dataset.pressed) {
        document.body.dataset.pressed = "yes";
        button.click();
      }
    }, 50));
    """
    with LiveView.open("127.0.0.1", 0, TOKEN, press) as view:
        script = tmp_path / "page.js"
        here = Path(__file__).parents[2] / "rig" / "web" / "page.js"
        script.write_bytes(here.read_bytes() + probe)
        from rig.web import server

        files = dict(server._FILES)
        server._FILES["/page.js"] = (str(script), files["/page.js"][1])
        try:
            view.slot.put(Glimpse(Pair(frame(), frame()), state))
            time.sleep(0.3)
            dom, console = browse(view.url, tmp_path, "--virtual-time-budget=1500")
        finally:
            server._FILES |= files
    assert 'data-wide="256,256"' in dom
    assert pressed == ["o"]
    assert console == []
