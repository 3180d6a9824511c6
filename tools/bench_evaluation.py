"""Times the judging of a recording: milliseconds a frame for inliers, and for the report."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from rig.evaluation.report import write_report
from rig.evaluation.summary import summarise
from rig.record.reader import open_recording


def main() -> None:
    recording = open_recording(Path(sys.argv[1]))
    frames = 2 * len(recording)
    read = timed(lambda: sum(1 for _ in recording.records()))
    summary = summarise(recording)
    judged = timed(lambda: summarise(recording))
    with TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        report = timed(lambda: write_report(page, recording, summary))
        size = page.stat().st_size
    print(
        f"{frames} frames: read {1e3 * read / frames:.1f} ms, judged {1e3 * judged / frames:.1f} ms"
    )
    print(f"report: {report:.2f} s, {size / 1e6:.2f} MB")


def timed(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
