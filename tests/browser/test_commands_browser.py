"""`--web` of the commands, watched by a real browser while they run."""

from __future__ import annotations

import http.client
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from live_browser import BROWSER, browse

if BROWSER is None:
    pytest.skip("chromium is not installed", allow_module_level=True)

TOKEN = "a-token-of-enough-letters"
RIG = [sys.executable, "-c", "from rig.cli.main import main; main()"]
PAGE = "--virtual-time-budget=1500"


@dataclass(frozen=True)
class Run:
    """A command that runs, and the address of its page."""

    process: subprocess.Popen[str]
    url: str

    def ask(self, method: str, path: str, body: str = "", **headers: str) -> tuple[int, bytes]:
        place = urlsplit(self.url)
        connection = http.client.HTTPConnection(place.netloc, timeout=20)
        cookie = {"Cookie": f"rig-{place.port}={TOKEN}"}
        connection.request(method, path, body or None, cookie | headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, content

    def wait_for(self, words: str) -> None:
        """Wait until the state that the page is told has some words in it."""
        until_s = time.monotonic() + 60
        while not re.search(words, self.ask("GET", "/state?after=0")[1].decode()):
            assert time.monotonic() < until_s
            time.sleep(0.1)

    def press(self, key: str) -> int:
        return self.ask("POST", "/key", key, Origin=f"http://{urlsplit(self.url).netloc}")[0]


@contextmanager
def running(folder: Path, *arguments: str) -> Iterator[Run]:
    command = [*RIG, *arguments, "--web", "--web-token", TOKEN, "--out", str(folder / "out")]
    process = subprocess.Popen(
        [*command, "--json"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            assert process.stderr is not None
            said = next(line for line in process.stderr if line.startswith("live page: "))
            yield Run(process, said.removeprefix("live page: ").strip())
        finally:
            process.kill()


def big_of(dom: str) -> str:
    found = re.search(r'<p id="big"[^>]*>([^<]*)</p>', dom)
    assert found is not None
    return found[1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["race", "aeag", "fixed:exposure_us=900,gain_db=3"],
        pytest.param(["collect", "--perturb", "cycle"], marks=pytest.mark.heavy),
    ],
)
def test_a_drive_is_watched(arguments: list[str], tmp_path: Path) -> None:
    cameras = ["--cameras", "sim:tunnel?size=640x480", "--frames", "3000"]
    with running(tmp_path, *arguments, *cameras) as run:
        run.wait_for(r'"ORB inliers", *"\d')
        dom, console = browse(run.url, tmp_path, PAGE)
        assert run.press("o") == 405
        run.process.send_signal(signal.SIGINT)
        assert run.process.wait(60) == 130
    assert console == []
    assert re.search(r"<h1[^>]*>SIMULATED · out</h1>", dom)
    assert re.search(r">pair \d+ of 3000<", dom)
    for row in ("controller", "exposure", "gain", "ORB inliers"):
        assert re.search(rf"<th>{row}</th><td>[^<]+</td><td>[^<]+</td>", dom), row
    assert re.search(r"<li>\d+ pairs complete, 0 dropped</li>", dom)
    assert re.search(r"<li>disk: \d+\.\d GB left</li>", dom)
    assert "TOKEN" not in dom and TOKEN not in dom


def test_a_person_calibrates_the_aperture_on_the_page(tmp_path: Path) -> None:
    wall = ["--cameras", "sim:wall?size=320x240&aperture_offset_stops=-0.3", "--hold-s", "0.5"]
    with running(tmp_path, "calibrate-aperture", *wall) as run:
        run.wait_for('"big"')
        dom, console = browse(run.url, tmp_path, PAGE)
        assert console == []
        assert big_of(dom) == "-0.30"
        assert re.search(r'<p id="hint"[^>]*class="warn"[^>]*>OPEN</p>', dom)
        assert dom.count("<button") == 4
        assert run.press("z") == 400
        until_s = time.monotonic() + 60
        with suppress(ConnectionError):
            while time.monotonic() < until_s:
                state = json.loads(run.ask("GET", "/state?after=0")[1])
                key = {"OPEN": "O", "CLOSE": "C"}.get(state["hint"])
                if key:
                    assert run.press(key) == 200
                time.sleep(0.4)
        assert run.process.stdout is not None
        values = json.loads(run.process.stdout.read())
    assert values["passed"]


@pytest.mark.heavy
def test_intrinsics_are_watched(tmp_path: Path) -> None:
    board = ["--cameras", "sim:chessboard?size=640x480", "--frames", "5000"]
    with running(tmp_path, "calibrate-intrinsics", *board) as run:
        dom, console = browse(run.url, tmp_path, PAGE)
    assert console == []
    assert int(big_of(dom)) >= 0
    assert "parts covered" in dom


@pytest.mark.heavy
def test_a_bracket_is_watched(tmp_path: Path) -> None:
    with running(tmp_path, "calibrate-response", "--cameras", "sim:wall?size=2048x1536") as run:
        dom, console = browse(run.url, tmp_path, PAGE)
    assert console == []
    assert re.search(r"looking for saturation|step \d+ of \d+", dom)
