"""What the driver costs, on a simulated pair that shows stored pictures.

    .venv/bin/python tools/bench_cameras.py [--seconds 60] [--cycles 300]

Prints the software-triggered cycle beyond exposure and readout, over GigE Vision on loopback and
over the tests' USB stand-in; the loss and the client's processor time at 2 x 55 Hz; and the time
from a command to its first frame. Wall times: on an idle machine.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from usb3.bus import load
from usb3.pair import UsbPair, reach_as_it_runs

from rig.config import load_camera_model
from rig.core.clock import SystemClock
from rig.core.types import Frame, Pair, Settings
from rig.drivers.aravis.binding import Picture
from rig.drivers.aravis.session import Mode, PairSpec
from rig.drivers.aravis.source import AravisSource, Surroundings, open_pair
from rig.drivers.simulated.gige.server import PairPlan, Server
from rig.pair import CameraPair

MODEL = load_camera_model("blackfly-s-u3-31s4")
EXPOSURE_US = 2_000.0
SIZES = ((640, 480), (2048, 1536))
RATE_HZ = 55.0

OpenedPair = Callable[[int, int], AbstractContextManager[AravisSource]]


def stored_plan(width_px: int, height_px: int) -> PairPlan:
    stored = np.random.default_rng(0).integers(0, 255, (2, height_px, width_px), np.uint8)
    pictures = Pair(lambda *_: stored[0], lambda *_: stored[1])
    return PairPlan(MODEL, width_px, height_px, pictures)


def serve_stored(pipe: Connection, width_px: int, height_px: int) -> None:
    """Serve one stored picture a camera until the other end of the pipe speaks."""
    server = Server(stored_plan(width_px, height_px))
    pipe.send(server.addresses)
    server.run(lambda: not pipe.poll())
    pipe.send(time.process_time())
    server.close()


@contextmanager
def stored_pair(width_px: int, height_px: int) -> Iterator[Pair[str]]:
    here, there = multiprocessing.Pipe()
    spawn = multiprocessing.get_context("spawn")
    process = spawn.Process(target=serve_stored, args=(there, width_px, height_px))
    process.start()
    try:
        yield Pair(*here.recv())
    finally:
        here.send("end")
        print(f"    server: {here.recv():.1f} s of processor time in all")
        process.join()


def open_stored(addresses: Pair[str], mode: Mode, rate_hz: float | None) -> AravisSource:
    return open_pair(PairSpec(addresses, mode=mode, rate_hz=rate_hz), Surroundings("gige:stored"))


@contextmanager
def over_gige(width_px: int, height_px: int) -> Iterator[AravisSource]:
    with (
        stored_pair(width_px, height_px) as addresses,
        closing(open_stored(addresses, "next-frame", None)) as source,
    ):
        yield source


@contextmanager
def over_usb(width_px: int, height_px: int) -> Iterator[AravisSource]:
    """Open cameras on the stand-in's bus, which live in a thread of this process."""
    pair = UsbPair(stored_plan(width_px, height_px), SystemClock())
    going = threading.Event()
    going.set()
    runner = threading.Thread(target=pair.run, args=(going.is_set,))
    runner.start()
    try:
        spec, surroundings = PairSpec(pair.labels, rate_hz=None), Surroundings("usb:stored")
        with closing(open_pair(spec, surroundings, reach=reach_as_it_runs(pair))) as source:
            yield source
    finally:
        going.clear()
        runner.join()
        pair.close()


def cycle(link: str, opened: OpenedPair, width_px: int, height_px: int, cycles: int) -> None:
    needed_ms = EXPOSURE_US * 1e-3 + MODEL.timing.readout_s * 1e3
    with opened(width_px, height_px) as source:
        pair, extra_ms, lost = CameraPair(source), [], 0
        spent_s = time.process_time()
        for k in range(cycles):
            commands = Pair(Settings(EXPOSURE_US, k % 20), Settings(EXPOSURE_US, (k + 7) % 20))
            begin_s = time.perf_counter()
            pair.apply(commands)
            shot = pair.shoot()
            extra_ms.append((time.perf_counter() - begin_s) * 1e3 - needed_ms)
            lost += shot.cause != ""
            if shot.cause:
                print(f"    lost: {shot.cause}, offset {shot.offset_ns} ns")
            used = [frame.used for frame in shot.frames if isinstance(frame, Frame)]
            assert not used or tuple(used) == commands
        spent_ms = (time.process_time() - spent_s) * 1e3 / cycles
    p10, p90 = np.percentile(extra_ms, [10, 90])
    print(
        f"{link}, {width_px}x{height_px}: a cycle takes {statistics.median(extra_ms):.2f} ms "
        f"beyond exposure and readout (p10 {p10:.2f}, p90 {p90:.2f}), {spent_ms:.2f} ms of "
        f"processor time, {lost} of {cycles} pairs lost"
    )


def rate(seconds: float) -> None:
    width_px, height_px = SIZES[-1]
    with (
        stored_pair(width_px, height_px) as addresses,
        closing(open_stored(addresses, "free-run", RATE_HZ)) as source,
    ):
        session = source.segments.running("bench")
        assert session is not None
        spent_s, end_s = time.process_time(), time.perf_counter() + seconds
        ids: Pair[list[int]] = Pair([], [])
        spoiled = 0
        while time.perf_counter() < end_s:
            for camera, seen in zip(session.cameras, ids, strict=True):
                came = camera.next_picture(0.2)
                if isinstance(came, Picture):
                    seen.append(came.frame_id)
                else:
                    spoiled += 1
        spent_s = time.process_time() - spent_s
    lost = sum(seen[-1] - seen[0] + 1 - len(seen) for seen in ids)
    print(
        f"2 x {RATE_HZ:g} Hz at {width_px}x{height_px} for {seconds:g} s: "
        f"{len(ids[0])} + {len(ids[1])} pictures, {lost} lost, {spoiled} spoiled or late, "
        f"client {spent_s / seconds:.2f} cores"
    )


def first_frame() -> None:
    with stored_pair(*SIZES[0]) as addresses, tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", "from rig.cli.main import main; main()", "collect"]
        command += ["--perturb", "none", "--frames", "1", "-q"]
        command += ["--cameras", f"aravis:{addresses.primary},{addresses.secondary}"]
        begin_s, spent_s = time.perf_counter(), children_s()
        subprocess.run([*command, "--out", str(Path(folder) / "run")], check=True)
        print(
            f"one recorded pair {time.perf_counter() - begin_s:.2f} s after the command, "
            f"{children_s() - spent_s:.2f} s of processor time"
        )


def children_s() -> float:
    """Return the processor time of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cycles", type=int, default=300)
    options = parser.parse_args()
    load(Path(tempfile.gettempdir()))
    for size in SIZES:
        cycle("GigE", over_gige, *size, options.cycles)
    for size in SIZES:
        cycle("USB stand-in", over_usb, *size, options.cycles)
    first_frame()
    rate(options.seconds)


if __name__ == "__main__":
    main()
