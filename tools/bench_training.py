"""What targets and training cost, on made-up drives, so that no recording is needed.

python tools/bench_training.py [--net dual-small] [--batches 8] [--threads 2]

Prints wall and CPU time: on a busy machine only the CPU time means anything.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch

from rig.core.types import Frame, Intrinsics, Pair, PairRecord, Settings, Truth
from rig.models.dataset import Samples
from rig.models.fit import Fit, Recipe
from rig.models.measuring import stretches
from rig.models.metrics import METRICS
from rig.models.targets import Poses, RecordingSource, Targets

BATCH = 64
LENSES = Pair(*(Intrinsics(1024, 768, 903.0, 903.0, 512.0, 384.0) for _ in range(2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--net", default="dual-small")
    parser.add_argument("--batches", type=int, default=8)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    for name in METRICS:
        bench_targets(name)
    bench_gather()
    bench_training(arguments.net, arguments.batches)


def bench_targets(metric: str) -> None:
    records = made_records(12)
    list(stretches(records[:3], METRICS[metric], LENSES))
    wall_s, cpu_s = timed(lambda: list(stretches(records, METRICS[metric], LENSES)))
    count = len(records)
    wall_ms, cpu_ms = 1e3 * wall_s / count, 1e3 * cpu_s / count
    print(f"targets {metric:7} {wall_ms:7.1f} ms wall, {cpu_ms:.1f} CPU, a pair")


def bench_gather() -> None:
    samples = samples_of(made_targets(200))
    chosen = np.random.default_rng(0).integers(0, len(samples), BATCH)
    wall_s, cpu_s = timed(lambda: samples.batch(chosen))
    print(f"gather 64       {1e3 * wall_s:7.1f} ms wall, {1e3 * cpu_s:.1f} CPU, a batch")


def bench_training(net: str, batches: int) -> None:
    targets = made_targets(batches * BATCH // 8 + 2)
    samples, none = samples_of(targets), Samples([targets], frozenset())
    with torch.random.fork_rng():
        fit = Fit(Recipe(net, epochs=2, batch_size=BATCH))
        fit.epoch(samples, none, lambda _: None)
        wall_s, cpu_s = timed(lambda: fit.epoch(samples, none, lambda _: None))
    count = len(samples) // BATCH * BATCH
    print(f"train {net} {count / wall_s:7.1f} samples/s wall, {count / cpu_s:.1f} a CPU second")


def timed(work: Callable[[], object]) -> tuple[float, float]:
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall_s, time.process_time() - cpu_s


def samples_of(targets: Targets) -> Samples:
    return Samples([targets], frozenset(source.sha256 for source in targets.recordings))


def made_targets(count: int) -> Targets:
    rng = np.random.default_rng(0)
    at = np.arange(count)
    source = RecordingSource("made", "0", count, "", "", 0, "", {})
    poses = Poses(
        images=rng.integers(0, 256, (count, 2, 3, 224, 224), np.uint8),
        used_exposure_us=rng.uniform(75, 30_000, (count, 2)),
        used_gain_db=rng.uniform(0, 30, (count, 2)),
        target_exposure_us=rng.uniform(75, 30_000, count),
        target_gain_db=rng.uniform(0, 30, count),
        trigger=at,
        pose_index=at,
        recording=0 * at,
        drive=0 * at,
    )
    return Targets("hybrid", 4, 0.5, (source,), poses)


def made_records(count: int) -> list[PairRecord]:
    """Return a moving textured wall, 1024 x 768, at two brightnesses."""
    rng = np.random.default_rng(0)
    wall = rng.integers(0, 256, (96, 160), np.uint8).repeat(8, 0).repeat(8, 1)
    return [made_record(trigger, wall) for trigger in range(count)]


def made_record(trigger: int, wall: np.ndarray) -> PairRecord:
    def frame(divisor: int) -> Frame:
        view = wall[:, 2 * trigger : 2 * trigger + 1024] // divisor
        return Frame(view, "bayer_rggb8", trigger, 0, 0, Settings(1_000.0 / divisor, 0.0))

    shot = Pair(frame(1), frame(2))
    used = Pair(*(taken.used for taken in shot))
    truth = Truth((0.1 * trigger, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 100.0)
    return PairRecord(trigger, trigger, used, used, shot, Pair(None, None), 0, "", truth)


if __name__ == "__main__":
    main()
