"""How fast a recording is written and read, beside a plain sequential write of the same bytes.

Two streams of 2048 x 1536 8-bit pictures, the frames made before the clock starts. Plain write
and recording take turns, so that a disk whose speed drifts treats them alike:

    .venv/bin/python tools/bench_recording.py [--pairs 300] [--rounds 3] [--folder DIR]

Random access and compression are measured on 640 x 480 pictures of the simulated tunnel.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import cv2
import lz4.frame
import numpy as np
import zstandard

from rig.cli.main import run
from rig.core.types import SIDES, Decision, Frame, Intrinsics, Pair, PairRecord, Settings, Truth
from rig.record import file as recording_file
from rig.record.frames import Frames
from rig.record.header import RunHeader
from rig.record.reader import open_recording
from rig.record.sink import Sink
from rig.record.verify import verify
from rig.record.writer import RecordWriter

WIDTH_PX, HEIGHT_PX = 2048, 1536
RATE_HZ = 55
STREAM_MB_PER_S = 2 * RATE_HZ * WIDTH_PX * HEIGHT_PX / 1e6
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


@dataclass(frozen=True, slots=True)
class Cost:
    """What some work took."""

    mb_per_s: float
    cpu_s: float
    cpu_s_per_gb: float

    @property
    def cores(self) -> float:
        """Return the processors that two cameras would keep busy."""
        return self.cpu_s_per_gb * STREAM_MB_PER_S / 1e3


def pictures(count: int) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    return [random.integers(0, 256, (HEIGHT_PX, WIDTH_PX), np.uint8) for _ in range(count)]


def pair_record(trigger: int, images: list[np.ndarray]) -> PairRecord:
    settings = Settings(700.0 + trigger, 3.0)
    time_ns = round(trigger / RATE_HZ * 1e9)
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


def plain(path: Path, images: list[np.ndarray], pairs: int) -> None:
    """Write the pixels one after the other and wait until the disk has them."""
    with path.open("wb", buffering=0) as file:
        for k in range(2 * pairs):
            file.write(images[k % len(images)].data)
        os.fsync(file.fileno())


def record_all(path: Path, images: list[np.ndarray], pairs: int) -> None:
    """Write as the recorder's thread does with cameras, as fast as the disk takes it."""
    path.mkdir()
    sink = Sink(path / "run.mcap", HEADER, live=True)
    for trigger in range(pairs):
        sink.take(pair_record(trigger, images))
    sink.finish()
    sink.close_file()


def record_live(path: Path, images: list[np.ndarray], pairs: int) -> float:
    """Record at the cameras' pace; return the longest that the loop waited for `write`."""
    slowest_s = 0.0
    with RecordWriter(path, HEADER, real_time=True) as writer:
        start_s = time.perf_counter()
        for trigger in range(pairs):
            time.sleep(max(0.0, start_s + trigger / RATE_HZ - time.perf_counter()))
            record = pair_record(trigger, images)
            before_s = time.perf_counter()
            writer.write(record)
            slowest_s = max(slowest_s, time.perf_counter() - before_s)
    return slowest_s


def cost(megabytes: float, work: Callable[[], object]) -> Cost:
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    work()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    return Cost(megabytes / wall_s, cpu_s, cpu_s / megabytes * 1e3)


def say(name: str, costs: list[Cost]) -> None:
    rate, gigabyte = (median(getattr(c, k) for c in costs) for k in ("mb_per_s", "cpu_s_per_gb"))
    cores = median(c.cores for c in costs)
    print(
        f"{name:32} {rate:7.0f} MB/s   {gigabyte:5.2f} CPU s/GB = "
        f"{cores:.2f} cores at {STREAM_MB_PER_S:.0f} MB/s"
    )


def writing(folder: Path, pairs: int, rounds: int) -> None:
    images = pictures(8)
    megabytes = pairs * 2 * WIDTH_PX * HEIGHT_PX / 1e6
    recording_file.keep_picture_buffers()
    plain_costs, record_costs = [], []
    for number in range(rounds):
        path = folder / f"plain-{number}"
        plain_costs.append(cost(megabytes, lambda path=path: plain(path, images, pairs)))
        path.unlink()
        path = folder / f"fast-{number}"
        record_costs.append(cost(megabytes, lambda path=path: record_all(path, images, pairs)))
        if number < rounds - 1:
            shutil.rmtree(path)
    say("plain write, synced", plain_costs)
    say("recording, synced", record_costs)
    ratios = [r.mb_per_s / p.mb_per_s for r, p in zip(record_costs, plain_costs, strict=True)]
    told = ", ".join(f"{each:.2f}" for each in ratios)
    print(f"recording / plain, round by round: {told}; median {median(ratios):.2f}")
    fast = folder / f"fast-{rounds - 1}"
    say("read back", [cost(megabytes, lambda: sum(1 for _ in open_recording(fast).records()))])
    say("verify", [cost(megabytes, lambda: verify(fast))])
    shutil.rmtree(fast)
    slowest_s = [0.0]

    def live() -> None:
        slowest_s[0] = record_live(folder / "live", images, pairs)

    say(f"recording live at {RATE_HZ} Hz", [cost(megabytes, live)])
    found = verify(folder / "live")
    most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"live: sound {found.sound}, {found.pairs} of {pairs} pairs, lost {dict(found.lost)}")
    print(
        f"live: the loop waited {slowest_s[0] * 1e3:.2f} ms at most; peak memory {most_mb:.0f} MB"
    )
    shutil.rmtree(folder / "live")


def reading(folder: Path, frames: int) -> None:
    """Shuffled frames of a tunnel drive by index, one core, pages dropped and then warm."""
    drive = folder / "drive"
    arguments = ["--cameras", "sim:tunnel?size=640x480", "--frames", str(frames), "-q"]
    run(["collect", "--perturb", "cycle", *arguments, "--out", str(drive)])
    order = np.random.default_rng(0).permutation(frames)
    with (drive / "run.mcap").open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    started_s = time.perf_counter()
    with Frames(drive) as found:
        print(f"opening {frames} triggers: {(time.perf_counter() - started_s) * 1e3:.1f} ms")
        for state in ("cold", "warm"):
            wall_s, cpu_s = time.perf_counter(), time.thread_time()
            for trigger in order.tolist():
                for side in SIDES:
                    found.frame(trigger, side)
            wall_s, cpu_s = time.perf_counter() - wall_s, time.thread_time() - cpu_s
            rate = 2 * frames
            print(f"shuffled 640x480, {state}: {rate / wall_s:.0f} frames/s, "
                  f"{rate / cpu_s:.0f} a CPU second")  # fmt: skip
    compressing(drive)


def compressing(drive: Path) -> None:
    """Lossless compression of the recorded pictures, by several ways."""
    with closing(open_recording(drive).records()) as records:
        shots = [
            shot for record, _ in zip(records, range(60), strict=False) for shot in record.shot
        ]
    images = [shot.image for shot in shots if isinstance(shot, Frame)]
    megabytes = sum(image.nbytes for image in images) / 1e6
    ways: dict[str, Callable[[np.ndarray], bytes]] = {
        "lz4": lambda image: lz4.frame.compress(image.tobytes()),
        "zstd 1": lambda image: zstandard.ZstdCompressor(1).compress(image.tobytes()),
        "zstd 3": lambda image: zstandard.ZstdCompressor(3).compress(image.tobytes()),
        "zstd 9": lambda image: zstandard.ZstdCompressor(9).compress(image.tobytes()),
        "rows' differences, zstd 1": lambda image: zstandard.ZstdCompressor(1).compress(
            (image - np.vstack([image[:2] * 0, image[:-2]])).tobytes()
        ),
        "png": lambda image: cv2.imencode(".png", image)[1].tobytes(),
    }
    for name, pack in ways.items():
        cpu_s = time.thread_time()
        size = sum(len(pack(image)) for image in images)
        cpu_s = time.thread_time() - cpu_s
        print(f"{name:32} ratio {megabytes * 1e6 / size:.2f}  {megabytes / cpu_s:6.0f} MB/CPU s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--folder", type=Path, default=None)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="bench-recording-", dir=arguments.folder))
    try:
        writing(folder, arguments.pairs, arguments.rounds)
        reading(folder, arguments.frames)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
