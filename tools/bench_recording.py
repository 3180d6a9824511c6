"""How fast a recording is written and read, beside a plain sequential write.

Two streams of 2048 x 1536 8-bit pictures, the frames made before the clock starts:

    .venv/bin/python tools/bench_recording.py [--pairs 300] [--folder DIR]
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from rig.core.types import Decision, Frame, Intrinsics, Pair, PairRecord, Settings, Truth
from rig.record.header import RunHeader
from rig.record.reader import open_recording
from rig.record.verify import verify
from rig.record.writer import RecordWriter

WIDTH_PX, HEIGHT_PX = 2048, 1536
RATE_HZ = 55
LENS = Intrinsics(WIDTH_PX, HEIGHT_PX, 1806.0, 1806.0, 1024.0, 768.0)
HEADER = RunHeader(
    command="bench",
    cameras="none",
    seed=0,
    world_version="",
    versions={},
    git="",
    serials=Pair("1", "2"),
    intrinsics=Pair(LENS, LENS),
    controllers=Pair("a", "b"),
    options={},
    models={},
)


def pictures(count: int) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    return [random.integers(0, 256, (HEIGHT_PX, WIDTH_PX), np.uint8) for _ in range(count)]


def pair_record(trigger: int, images: list[np.ndarray]) -> PairRecord:
    settings = Settings(1_000.0, 0.0)
    time_ns = trigger * 1_000_000_000 // RATE_HZ
    decision = Decision("a", settings, 0.1, {"mean": 100.0})

    def frame(image: np.ndarray) -> Frame:
        return Frame(image, "bayer_rggb8", trigger, time_ns, time_ns, settings)

    first = 2 * trigger % len(images)
    return PairRecord(
        trigger=trigger,
        pose_index=trigger,
        asked=Pair(settings, settings),
        applied=Pair(settings, settings),
        shot=Pair(frame(images[first]), frame(images[first + 1])),
        decisions=Pair(decision, decision),
        offset_ns=0,
        cause="",
        truth=Truth((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0),
    )


def plain(folder: Path, images: list[np.ndarray], pairs: int) -> None:
    with (folder / "plain").open("wb", buffering=0) as file:
        for k in range(2 * pairs):
            file.write(images[k % len(images)].data)
        os.fsync(file.fileno())


def record_all(folder: Path, images: list[np.ndarray], pairs: int, *, real_time: bool) -> None:
    with RecordWriter(folder, HEADER, real_time=real_time) as writer:
        start_s = time.perf_counter()
        for trigger in range(pairs):
            if real_time:
                time.sleep(max(0.0, start_s + trigger / RATE_HZ - time.perf_counter()))
            writer.write(pair_record(trigger, images))


def timed(name: str, megabytes: float, work: object) -> None:
    assert callable(work)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    work()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    print(f"{name:34} {megabytes / wall_s:7.0f} MB/s  {wall_s:6.2f} s  {cpu_s / wall_s:5.2f} cores")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=300)
    parser.add_argument("--folder", type=Path, default=None)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="bench-recording-", dir=arguments.folder))
    pairs, images = arguments.pairs, pictures(8)
    megabytes = pairs * 2 * WIDTH_PX * HEIGHT_PX / 1e6
    fast, live = folder / "fast", folder / "live"
    try:
        timed("plain write, synced", megabytes, lambda: plain(folder, images, pairs))
        (folder / "plain").unlink()
        timed("record, as fast as it goes", megabytes,
              lambda: record_all(fast, images, pairs, real_time=False))  # fmt: skip
        timed("read back", megabytes, lambda: sum(1 for _ in open_recording(fast).records()))
        timed("verify", megabytes, lambda: verify(fast))
        shutil.rmtree(fast)
        timed(f"record live at {RATE_HZ} Hz", megabytes,
              lambda: record_all(live, images, pairs, real_time=True))  # fmt: skip
        print(f"live: {verify(live)}")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
