"""Time the judges: front ends on rendered pictures, and the report of a long run.

    .venv/bin/python tools/bench_evaluation.py            front ends, on the tunnel's pictures
    .venv/bin/python tools/bench_evaluation.py RECORDING  judging and the report, of it repeated

Every figure is processor time of one thread, in milliseconds, the least of several goes: it does
not grow when the machine is busy.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Frame, Pair, PairRecord, Settings
from rig.drivers.registry import open_source
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.source import SimulatedSource
from rig.evaluation.front_ends import FRONT_ENDS
from rig.evaluation.report import write_report
from rig.evaluation.series import measure
from rig.evaluation.summary import summarise
from rig.record.header import RunHeader
from rig.record.reader import Recording, open_recording
from rig.vision.bayer import to_grey

SIZES = ("2048x1536", "1024x768", "640x480")
PLACES = {"inside": (40, Settings(8_000.0, 18.0)), "outside": (110, Settings(1_500.0, 1.0))}
"""A trigger of the tunnel's drive, and settings that suit it."""

LONG_PAIRS = 1_000
GOES = 7


def main() -> None:
    cv2.setNumThreads(1)
    if len(sys.argv) > 1:
        report(open_recording(Path(sys.argv[1])))
    else:
        front_ends()


def front_ends() -> None:
    """Print what each picture of a drive costs each front end."""
    for size, place in product(SIZES, PLACES):
        (raw_a, pixel_format), (raw_b, _) = pictures(size, *PLACES[place])
        a, b = to_grey(raw_a, pixel_format), to_grey(raw_b, pixel_format)
        grey_ms = least_ms(lambda raw=raw_b, kind=pixel_format: to_grey(raw, kind))
        for name, recipe in FRONT_ENDS.items():
            front_end = recipe.front_end(None)
            before = front_end.features(a)
            now = least_ms(lambda f=front_end, picture=b: f.features(picture))
            after = front_end.features(b)
            pair = least_ms(lambda f=front_end, x=before, y=after: f.match(x, y))
            counts = recipe.compare(a, b, None).counts
            total = now + pair + (grey_ms if name == "orb" else 0.0)
            print(
                f"{size} {place} {name}: {total:.1f} ms a picture (features {now:.1f}, "
                f"matching and inliers {pair:.1f}; grey {grey_ms:.1f}); {counts}"
            )


def pictures(size: str, trigger: int, settings: Settings) -> list[tuple[NDArray[np.uint8], str]]:
    """Return two neighbouring raw pictures of the tunnel and their pixel format."""
    address = f"sim:tunnel?size={size}"
    with closing(open_source(address, seed=0, split="test")) as source:
        assert isinstance(source, SimulatedSource)
        lens = source.scene.intrinsics("primary")
        sensor = Sensor(source.drive.model, (lens.height_px, lens.width_px), seed=0)
        views = [
            source.scene.view("primary", source.drive.scene_time_s(k))
            for k in (trigger, trigger + 1)
        ]
        return [
            (
                sensor.develop(view.exposed(settings.exposure_us), settings, k),
                source.drive.model.picture.format,
            )
            for k, view in enumerate(views)
        ]


def report(recording: Recording) -> None:
    """Print what judging a recording costs, and its report when it is as long as 2,000 frames."""
    frames = 2 * len(recording)
    read = least_ms(lambda: sum(1 for _ in recording.records()), goes=2) / frames
    for name in FRONT_ENDS:
        only = {name: FRONT_ENDS[name]}
        judged = least_ms(lambda o=only: measure(recording.records(), o, lenses(recording)), goes=2)
        print(f"{name}: {judged / frames:.1f} ms a frame, of it {read:.1f} for reading")
    long = Repeated(recording, LONG_PAIRS)
    summary = summarise(long)
    with TemporaryDirectory() as folder:
        for pictures in (True, False):
            page = Path(folder) / "report.html"
            spent = least_ms(
                lambda p=page, shown=pictures: write_report(p, long, summary, pictures=shown),
                goes=1,
            )
            what = "with" if pictures else "without"
            megabytes = page.stat().st_size / 1e6
            print(
                f"report of {2 * LONG_PAIRS} frames {what} pictures: {spent / 1e3:.2f} s, "
                f"{megabytes:.2f} MB"
            )


def lenses(recording: Recording) -> Pair:
    return recording.header.intrinsics


@dataclass(frozen=True)
class Repeated:
    """A recording driven again and again until it has so many pairs."""

    recording: Recording
    pairs: int

    @property
    def header(self) -> RunHeader:
        return self.recording.header

    def records(self) -> Iterator[PairRecord]:
        return islice(self._for_ever(), self.pairs)

    def _for_ever(self) -> Iterator[PairRecord]:
        trigger = 0
        while True:
            for record in self.recording.records():
                shot = Pair(*(later(frame, trigger) for frame in record.shot))
                yield replace(record, trigger=trigger, pose_index=trigger, shot=shot)
                trigger += 1


def later(frame: Frame, trigger: int) -> Frame:
    time_ns = trigger * 100_000_000
    return replace(frame, sequence=trigger, device_time_ns=time_ns, host_time_ns=time_ns)


def least_ms(action: Callable[[], object], goes: int = GOES) -> float:
    """Return the least processor time of an action, compiled beforehand."""
    if goes > 2:
        action()
    spent = []
    for _ in range(goes):
        start_s = time.process_time()
        action()
        spent.append(1e3 * (time.process_time() - start_s))
    return min(spent)


if __name__ == "__main__":
    main()
