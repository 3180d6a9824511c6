"""What a watched live page costs the loop: time in `write`, and how punctual the triggers stay.

A loop at 10 and at 55 Hz in real time hands over records with pictures of the camera's full size,
once without a page and once with a page that a client reads as fast as it may. Times in `write`
are processor time of the loop's thread; lateness is how long after its moment a trigger fired.
"""

from __future__ import annotations

import argparse
import http.client
import json
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from rig.core.types import Decision, Frame, Pair, PairRecord, Settings
from rig.web.live import LiveView
from rig.web.watch import WatchedRecorder, warm_up

TOKEN = "a-token-for-the-bench"
SETTINGS = Settings(1000.0, 0.0)


class Nowhere:
    """A recorder that keeps nothing."""

    def write(self, record: PairRecord) -> None:
        pass


def make_record(trigger: int, image: np.ndarray) -> PairRecord:
    frame = Frame(image, "bayer_rggb8", trigger, 0, 0, SETTINGS)
    both = Pair(SETTINGS, SETTINGS)
    decision = Decision("bench", SETTINGS, 0.1)
    return PairRecord(
        trigger, trigger, both, both, Pair(frame, frame), Pair(decision, decision), 8_000, ""
    )


def read_page(view: LiveView, stop: threading.Event, states: list[int]) -> None:
    """Do what the page does: ask for the next state, then for both pictures."""
    headers = {"Cookie": f"{view.server.guard.cookie}={TOKEN}"}
    known = 0
    while not stop.is_set():
        for path in (f"/state?after={known}", "/primary.jpg", "/secondary.jpg"):
            connection = http.client.HTTPConnection("127.0.0.1", view.server.guard.port)
            connection.request("GET", path, headers=headers)
            body = connection.getresponse().read()
            connection.close()
            if path.startswith("/state"):
                newer = json.loads(body)["n"]
                states += [newer] * (newer > known)
                known = newer


def drive(rate_hz: float, seconds: float, images: list[np.ndarray], watched: bool) -> str:
    stop, states = threading.Event(), list[int]()
    spent_us, late_ms = [], []
    with ExitStack() as stack:
        recorder = Nowhere()
        if watched:
            view = stack.enter_context(LiveView.open("127.0.0.1", 0, TOKEN))
            recorder = WatchedRecorder(recorder, view.slot, "bench", Path(), None)
            client = threading.Thread(target=read_page, args=(view, stop, states))
            client.start()
        begun_s = time.monotonic()
        for trigger in range(int(seconds * rate_hz)):
            due_s = begun_s + trigger / rate_hz
            time.sleep(max(0.0, due_s - time.monotonic()))
            late_ms.append((time.monotonic() - due_s) * 1e3)
            record = make_record(trigger, images[trigger % len(images)])
            before_ns = time.thread_time_ns()
            recorder.write(record)
            spent_us.append((time.thread_time_ns() - before_ns) / 1e3)
        stop.set()
        if watched:
            client.join()
    spent, late = np.percentile(spent_us, [50, 99]), np.percentile(late_ms, [50, 99, 100])
    told = f"{len(states) / seconds:.1f} states/s" if watched else "no page"
    return (
        f"{rate_hz:4.0f} Hz, {told:>12}: write {spent[0]:5.1f} us median, {spent[1]:6.1f} us p99; "
        f"late {late[0]:.2f} ms median, {late[1]:.2f} p99, {late[2]:.2f} worst"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    base = rng.integers(0, 255, (24, 32)).astype(np.float32)
    import cv2

    scene = cv2.resize(base, (2048, 1536), interpolation=cv2.INTER_CUBIC)
    images = [
        np.clip(scene + rng.normal(0, 4, scene.shape), 0, 255).astype(np.uint8) for _ in range(4)
    ]
    warm_up()
    for rate_hz in (10.0, 55.0):
        for watched in (False, True):
            print(drive(rate_hz, options.seconds, images, watched), flush=True)


if __name__ == "__main__":
    main()
