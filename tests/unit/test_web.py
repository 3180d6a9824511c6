"""The live page's server: who is let in, what it answers, and that it never holds up the loop."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic_run import SyntheticRun

from rig.core.errors import RigError, UsageError
from rig.core.types import Frame, Pair, PairRecord, Settings
from rig.web.guard import Guard, parse_listen
from rig.web.live import FASTEST_HZ, LiveView
from rig.web.page import Page, encode
from rig.web.slot import Glimpse, Slot
from rig.web.watch import WatchedRecorder

TOKEN = "a-token-of-enough-letters"
NOTHING: Pair[Frame | None] = Pair(None, None)


@pytest.fixture
def pressed() -> list[str]:
    return []


@pytest.fixture
def view(pressed: list[str]) -> Iterator[LiveView]:
    def press(key: str) -> bool:
        pressed.append(key)
        return key == "o"

    with LiveView.open("127.0.0.1", 0, TOKEN, press) as opened:
        yield opened


def ask(
    view: LiveView,
    path: str,
    headers: dict[str, str] | None = None,
    method: str = "GET",
    body: bytes | None = None,
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", view.server.guard.port, timeout=10)
    connection.request(method, path, body=body, headers=headers or {})
    answer = connection.getresponse()
    told = {name.lower(): value for name, value in answer.getheaders()}
    content = answer.read()
    connection.close()
    return answer.status, told, content


def cookie(view: LiveView) -> dict[str, str]:
    return {"Cookie": f"{view.server.guard.cookie}={TOKEN}"}


def origin(view: LiveView) -> str:
    return f"http://127.0.0.1:{view.server.guard.port}"


def frame(width_px: int = 320, sequence: int = 0) -> Frame:
    image = np.full((width_px * 3 // 4, width_px), 90, np.uint8)
    return Frame(image, "bayer_rggb8", sequence, 0, 0, Settings(1000.0, 0.0))


def test_without_a_token_nothing_is_told(view: LiveView) -> None:
    for path in ("/", "/state", "/page.js", "/primary.jpg", "/?token=wrong"):
        status, _, body = ask(view, path)
        assert (status, body) == (403, b"refused: no valid token")


def test_the_token_is_moved_into_a_cookie(view: LiveView) -> None:
    status, told, _ = ask(view, f"/?token={TOKEN}")
    assert (status, told["location"]) == (303, "/")
    assert "HttpOnly" in told["set-cookie"]
    assert "SameSite=Strict" in told["set-cookie"]
    status, _, body = ask(view, "/", {"Cookie": told["set-cookie"].split(";")[0]})
    assert status == 200
    assert b"<title>rig live</title>" in body


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil:80"])
def test_an_unknown_host_is_refused(view: LiveView, host: str) -> None:
    status, _, body = ask(view, "/state", cookie(view) | {"Host": host})
    assert (status, body) == (403, b"refused: unknown Host")


def test_localhost_is_known(view: LiveView) -> None:
    host = f"localhost:{view.server.guard.port}"
    assert ask(view, "/state", cookie(view) | {"Host": host})[0] == 200


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "http://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}],
)
def test_other_pages_are_refused(view: LiveView, headers: dict[str, str]) -> None:
    assert ask(view, "/state", cookie(view) | headers)[0] == 403


def test_every_answer_forbids_what_it_does_not_need(view: LiveView) -> None:
    for path in ("/", "/nothing", "/state"):
        _, told, _ = ask(view, path, cookie(view))
        assert "default-src 'none'" in told["content-security-policy"]
        assert "unsafe" not in told["content-security-policy"]
        assert told["x-content-type-options"] == "nosniff"
        assert told["cache-control"] == "no-store"
        assert "access-control-allow-origin" not in told


def test_a_key_needs_its_origin_and_the_token(view: LiveView, pressed: list[str]) -> None:
    at_home = {"Origin": origin(view)}
    assert ask(view, "/key", cookie(view), "POST", b"o")[0] == 403
    assert ask(view, "/key", at_home, "POST", b"o")[0] == 403
    assert pressed == []
    assert ask(view, "/key", cookie(view) | at_home, "POST", b"o")[0] == 200
    assert ask(view, "/key", cookie(view) | at_home, "POST", b"z")[0] == 400
    assert ask(view, "/key", cookie(view) | at_home, "POST", b"o" * 100)[0] == 400
    assert pressed == ["o", "z"]


def test_a_run_takes_no_keys() -> None:
    with LiveView.open("127.0.0.1", 0, TOKEN) as view:
        headers = cookie(view) | {"Origin": origin(view)}
        assert ask(view, "/key", headers, "POST", b"o")[0] == 405


def test_state_and_pictures_arrive(view: LiveView) -> None:
    view.slot.put(Glimpse(Pair(frame(), None), lambda: {"title": "hello"}))
    state = json.loads(ask(view, "/state?after=0", cookie(view))[2])
    assert state == {"title": "hello", "n": 1}
    status, told, body = ask(view, "/primary.jpg", cookie(view))
    assert (status, told["content-type"]) == (200, "image/jpeg")
    picture = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (240, 320, 3)
    assert ask(view, "/secondary.jpg", cookie(view))[0] == 404


def test_pictures_are_no_wider_than_480() -> None:
    coded = encode(frame(2048))
    picture = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (360, 480, 3)
    assert picture.mean() == pytest.approx(90, abs=2)


def test_a_slot_keeps_the_newest_only() -> None:
    slot = Slot()
    for number in range(5):
        slot.put(Glimpse(NOTHING, lambda n=number: {"n": n}))
    taken = slot.take(0.0)
    assert taken is not None
    assert taken.describe() == {"n": 4}
    assert slot.take(0.0) is None


def test_no_more_than_ten_pictures_a_second(view: LiveView) -> None:
    begun_s = time.monotonic()
    shown: list[int] = []
    while time.monotonic() - begun_s < 0.6:
        view.slot.put(Glimpse(NOTHING, lambda: shown.append(1) or {}))
        time.sleep(0.002)
    spent_s = time.monotonic() - begun_s
    assert 1 <= len(shown) <= spent_s * FASTEST_HZ + 2


def test_the_loop_does_not_wait_for_a_slow_page(view: LiveView) -> None:
    painting, go_on = threading.Event(), threading.Event()

    def describe() -> dict[str, str]:
        painting.set()
        go_on.wait(10)
        return {}

    view.slot.put(Glimpse(NOTHING, describe))
    assert painting.wait(5)
    before = time.thread_time()
    for _ in range(1000):
        view.slot.put(Glimpse(NOTHING, dict))
    spent_s = time.thread_time() - before
    go_on.set()
    assert spent_s < 0.2


def test_the_end_is_told() -> None:
    with LiveView.open("127.0.0.1", 0, TOKEN) as view:
        view.slot.put(Glimpse(NOTHING, lambda: {"title": "t"}))
    assert json.loads(view.page.state_after(0, 0.0))["ended"] is True


def test_waiting_for_a_newer_state_ends() -> None:
    page = Page()
    assert json.loads(page.state_after(5, 0.01)) == {"n": 0}


class Kept:
    """A recorder that remembers."""

    def __init__(self) -> None:
        self.records: list[PairRecord] = []

    def write(self, record: PairRecord) -> None:
        self.records.append(record)


def test_a_watched_recorder_passes_all_on_and_tells_what_it_saw(tmp_path: Path) -> None:
    kept, slot = Kept(), Slot()
    watched = WatchedRecorder(kept, slot, "a race", tmp_path, 12)
    run = SyntheticRun(triggers=12, lost={5: "timeout"})
    records = list(run.records())
    for record in records:
        watched.write(record)
    assert kept.records == records
    glimpse = slot.take(0.0)
    assert glimpse is not None
    state = glimpse.describe()
    values = {row[0]: row[1:] for row in state["values"]}
    assert state["status"] == "pair 12 of 12"
    assert state["notes"][:2] == ["11 pairs complete, 1 dropped", "dropped 1: timeout"]
    assert state["notes"][-1].startswith("disk: ")
    assert all(count.isdecimal() for count in values["ORB inliers"])
    assert values["exposure"][0].endswith(" us")


@pytest.mark.parametrize(
    ("address", "token", "message"),
    [
        ("8080", None, "write HOST:PORT"),
        ("127.0.0.1:x", None, "write HOST:PORT"),
        ("0.0.0.0:80", TOKEN, "not every one at once"),
        ("192.168.1.5:8080", None, "give a --web-token"),
        ("127.0.0.1:0", "short", "at least 16 characters, got 5"),
    ],
)
def test_addresses_that_are_refused(address: str, token: str | None, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_listen(address, token)


def test_addresses_that_are_taken() -> None:
    assert parse_listen("192.168.1.5:8080", TOKEN) == ("192.168.1.5", 8080, TOKEN)
    assert parse_listen("[::1]:0", TOKEN)[0] == "::1"
    assert len(parse_listen("localhost:0", None)[2]) >= 16


def test_a_server_on_another_address_knows_only_its_own_name() -> None:
    guard = Guard("192.168.1.5", 8080, TOKEN)
    assert guard.names == {"192.168.1.5:8080"}
    headers = {"host": "localhost:8080", "cookie": f"{guard.cookie}={TOKEN}"}
    assert guard.refuses(headers, "", writes=False) == "unknown Host"


def test_a_taken_port_is_named(view: LiveView) -> None:
    with pytest.raises(RigError, match=r"cannot be opened .* name another port"):
        LiveView.open("127.0.0.1", view.server.guard.port, TOKEN)
