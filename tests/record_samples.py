"""Small records of every kind, and how to write them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.core.types import (
    Auto,
    Command,
    Decision,
    Frame,
    Intrinsics,
    Limits,
    Lost,
    Pair,
    PairRecord,
    Settings,
    Truth,
)
from rig.record.header import RunHeader
from rig.record.writer import RecordWriter

INTRINSICS = Intrinsics(32, 24, 28.2, 28.3, 16.0, 12.0)
HEADER = RunHeader(
    command="race",
    cameras="sim:tunnel?seed=3",
    seed=3,
    world_version="7",
    versions={"rig": "0.1.0", "python": "3.11"},
    git="abc",
    serials=Pair("1001", "1002"),
    intrinsics=Pair(INTRINSICS, replace(INTRINSICS, fx_px=1 / 3)),
    controllers=Pair("ae", "shin"),
    options={"frames": "5", "leader": "ae"},
    models={"ours": "ff00"},
)
AUTO = Auto(
    Limits((75.0, 9_000.0), (0.0, 12.0)), 99.5, 0.25, Settings(1_234.5, 1.5), "spot", "exposure"
)
DECISION = Decision("shin", Settings(701.25, 0.5), 0.125, {"score": 0.1, "state": "expanding"})
TRUTH = Truth((1.0, 2.5, 3.0), (0.0, 0.1, 0.2, 0.97), 512.25)

COUNTS = {
    "/primary/camera_info": 1,
    "/secondary/camera_info": 1,
    "/primary/frame_meta": 3,
    "/secondary/frame_meta": 3,
    "/primary/image_raw": 3,
    "/secondary/image_raw": 2,
    "/primary/decision": 2,
    "/secondary/decision": 2,
    "/ground_truth/pose": 3,
    "/ground_truth/light": 3,
    "/pair": 3,
}
"""Messages of [record(0), half(1), record(2)] by topic."""


def frame(trigger: int, offset_ns: int = 0) -> Frame:
    pixels = np.random.default_rng([trigger, offset_ns]).integers(0, 256, (24, 32), np.uint8)
    time_ns = trigger * 100_000_000 + offset_ns
    return Frame(pixels, "bayer_rggb8", trigger, time_ns, time_ns + 9_000, Settings(700.5, 3.0))


def record(trigger: int) -> PairRecord:
    commands: Pair[Command] = Pair(Settings(700.0, 3.0), AUTO)
    return PairRecord(
        trigger=trigger,
        pose_index=trigger // 2,
        asked=commands,
        applied=Pair(Settings(700.5, 3.0), AUTO),
        shot=Pair(frame(trigger), frame(trigger, 40)),
        decisions=Pair(DECISION, replace(DECISION, controller="ae", command=AUTO)),
        offset_ns=40,
        cause="",
        truth=TRUTH,
    )


def half(trigger: int) -> PairRecord:
    shot: Pair[Frame | Lost] = Pair(frame(trigger), Lost(trigger, "no frame in 0.5 s"))
    none: Pair[Decision | None] = Pair(None, None)
    cause = "secondary: no frame in 0.5 s"
    return replace(record(trigger), shot=shot, decisions=none, offset_ns=None, cause=cause)


def neither(trigger: int) -> PairRecord:
    lost: Pair[Frame | Lost] = Pair(Lost(trigger, "gone"), Lost(trigger, "gone too"))
    return replace(half(trigger), shot=lost, cause="both gone", truth=None)


def mispaired(trigger: int) -> PairRecord:
    shot: Pair[Frame | Lost] = Pair(frame(trigger), frame(trigger, 2_000_000))
    return replace(record(trigger), shot=shot, offset_ns=2_000_000, cause="offset 2 ms")


def write(folder: Path, records: list[PairRecord], header: RunHeader = HEADER) -> Path:
    with RecordWriter(folder, header, real_time=False) as writer:
        for each in records:
            writer.write(each)
    return folder / "run.mcap"


def assert_same(found: PairRecord, expected: PairRecord) -> None:
    for a, b in zip(found.shot, expected.shot, strict=True):
        if isinstance(a, Frame) and isinstance(b, Frame):
            assert np.array_equal(a.image, b.image)
            assert a.image.dtype == np.uint8
            assert (a.pixel_format, a.sequence, a.device_time_ns, a.host_time_ns, a.used) == (
                b.pixel_format,
                b.sequence,
                b.device_time_ns,
                b.host_time_ns,
                b.used,
            )
        else:
            assert a == b
    assert replace(found, shot=expected.shot) == expected
