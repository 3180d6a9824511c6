"""A run as a film: both cameras side by side, their settings, their inliers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RigError
from rig.core.types import Frame, PairRecord
from rig.evaluation.inliers import arrived, grey_of
from rig.evaluation.report.wording import labels
from rig.evaluation.segments import Kind
from rig.evaluation.summary import RACE_SIDES, RaceSide, Recorded, Summary, at
from rig.vision.bayer import to_bgr
from rig.vision.orb import ANALYSIS_SIZE_PX, OrbFeatures, OrbFrontEnd

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

PICTURE_WIDTH_PX = 640
CAPTION_PX, CURVE_PX, GAP_PX = 60, 120, 8
CODEC = "mp4v"
"""MPEG-4 part 2: players show it, browsers do not; VP9, which they do, takes 100 times as long."""

PAPER: Colour = (28, 24, 20)
INK: Colour = (236, 232, 228)
SOFT: Colour = (184, 173, 163)
FLOW: Colour = (77, 225, 255)
SIDES: dict[RaceSide, Colour] = {"left": (240, 180, 90), "right": (63, 152, 240)}
LIGHT: dict[Kind, Colour] = {
    "static": PAPER,
    "approaching": (38, 48, 66),
    "inside": (58, 44, 40),
    "leaving": (70, 56, 32),
}


def write_video(path: Path, recording: Recorded, summary: Summary) -> None:
    """Write the film of a run to `path`, one picture a trigger at the run's rate.

    Over each picture lie the ORB inliers with the one before, under it settings and counts, and
    below both the inliers of the whole drive. Reads the recording once. Raises RigError when the
    film cannot be written.
    """
    if not len(summary.series):
        raise RigError(f"{path}: the run has no pictures to show")
    film = _Film(summary)
    with _writer(path, film.size_px, _rate_hz(summary)) as writer:
        for row, record in enumerate(recording.records()):
            writer.write(film.picture(row, record))


@contextmanager
def _writer(path: Path, size_px: tuple[int, int], rate_hz: float) -> Iterator[cv2.VideoWriter]:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODEC), rate_hz, size_px)
    if not writer.isOpened():
        raise RigError(f"{path}: cannot be written as a film; name a file that can be made")
    try:
        yield writer
    finally:
        writer.release()


def _rate_hz(summary: Summary) -> float:
    steps_s = np.diff(summary.series.time_s)
    steps_s = steps_s[np.isfinite(steps_s) & (steps_s > 0)]
    return float(np.clip(1 / np.median(steps_s), 1, 120)) if steps_s.size else 10.0


class _Film:
    """Draws one picture after the other; keeps the features of the last pictures."""

    def __init__(self, summary: Summary) -> None:
        self._summary = summary
        lens = summary.header.intrinsics.primary
        height_px = round(PICTURE_WIDTH_PX * lens.height_px / lens.width_px)
        self._picture_px = (PICTURE_WIDTH_PX, height_px)
        width_px = 2 * PICTURE_WIDTH_PX + GAP_PX
        total_px = height_px + CAPTION_PX + CURVE_PX
        self.size_px = (width_px, total_px + total_px % 2)
        self._names = dict(
            zip(RACE_SIDES, labels(summary.left.controller, summary.right.controller), strict=True)
        )
        self._curve = _curve(summary, width_px)
        self._flow = {side: _Flow() for side in RACE_SIDES}

    def picture(self, row: int, record: PairRecord) -> Image:
        """Return the picture of one trigger, H x W x 3 in OpenCV's order of colours."""
        canvas = np.full((self.size_px[1], self.size_px[0], 3), PAPER, np.uint8)
        top = self._picture_px[1]
        for column, side in enumerate(RACE_SIDES):
            left = column * (PICTURE_WIDTH_PX + GAP_PX)
            shown = canvas[:top, left : left + PICTURE_WIDTH_PX]
            if record.complete:
                frame = arrived(at(record.shot, self._summary.wired(side)))
                shown[:] = self._seen(side, frame, record.trigger)
            else:
                _write(shown, f"lost: {record.cause}", (20, top // 2), SOFT)
            self._caption(canvas[top : top + CAPTION_PX, left : left + PICTURE_WIDTH_PX], side, row)
        below = canvas[top + CAPTION_PX : top + CAPTION_PX + CURVE_PX]
        below[:] = self._curve
        x = _across(row, len(self._summary.series), below.shape[1])
        cv2.line(below, (x, 0), (x, CURVE_PX), INK, 1)
        return canvas

    def _seen(self, side: RaceSide, frame: Frame, trigger: int) -> Image:
        bgr = to_bgr(frame.image, frame.pixel_format)
        small = cv2.resize(bgr, self._picture_px, interpolation=cv2.INTER_AREA)
        before, now = self._flow[side].follow(trigger, grey_of(frame))
        scale = np.divide(self._picture_px, ANALYSIS_SIZE_PX)
        lines = np.round(np.stack([before, now], axis=1) * scale * 16).astype(np.int32)
        cv2.polylines(small, list(lines), False, FLOW, 1, cv2.LINE_AA, shift=4)
        return np.asarray(small, np.uint8)

    def _caption(self, place: Image, side: RaceSide, row: int) -> None:
        camera = self._summary.camera(side)
        trigger = int(self._summary.series.trigger[row])
        cv2.rectangle(place, (0, 0), (5, CAPTION_PX - 8), SIDES[side], -1)
        _write(place, self._names[side], (16, 22), SIDES[side], bold=True)
        _write(place, f"pair {trigger}", (place.shape[1] - 100, 22), SOFT)
        counts = [f"{name} {_told(values[row])}" for name, values in camera.inliers.items()]
        settings = f"{_told(camera.exposure_us[row])} us   {_told(camera.gain_db[row], 1)} dB"
        _write(place, f"{settings}   inliers: {'  '.join(counts)}", (16, 46), INK)


class _Flow:
    """Follows one camera's ORB inliers from picture to picture."""

    def __init__(self) -> None:
        self._orb = OrbFrontEnd()
        self._last: tuple[int, OrbFeatures] | None = None

    def follow(self, trigger: int, grey: Image) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return where the inliers were and are, N x 2 each; none after a gap."""
        last, features = self._last, self._orb.features(grey)
        self._last = (trigger, features)
        if last is None or last[0] != trigger - 1:
            return np.empty((0, 2), np.float32), np.empty((0, 2), np.float32)
        matches = self._orb.match(last[1], features)
        return matches.points_a_px[matches.inlier_mask], matches.points_b_px[matches.inlier_mask]


def _curve(summary: Summary, width_px: int) -> Image:
    """Return the ORB inliers of the whole drive, with the parts of the drive shaded."""
    plot = np.full((CURVE_PX, width_px, 3), PAPER, np.uint8)
    rows = len(summary.series)
    for part in summary.segments:
        first, last = (_across(row, rows, width_px) for row in (part.first, part.last + 1))
        plot[:, first:last] = LIGHT[part.kind]
    columns = {side: summary.camera(side).inliers["orb"] for side in RACE_SIDES}
    most = max([np.nanmax(c) for c in columns.values() if not np.isnan(c).all()] + [1.0])
    for side, counts in columns.items():
        x = [_across(row, rows, width_px) for row in range(rows)]
        y = CURVE_PX - 8 - np.nan_to_num(counts) / most * (CURVE_PX - 28)
        for stretch in _unbroken(counts):
            points = np.column_stack([x, y])[stretch].round().astype(np.int32)
            cv2.polylines(plot, [points], False, SIDES[side], 2, cv2.LINE_AA)
    _write(plot, f"ORB inliers, 0 to {most:.0f}", (10, 18), SOFT)
    return plot


def _unbroken(counts: NDArray[np.float64]) -> Sequence[NDArray[np.int64]]:
    rows = np.flatnonzero(~np.isnan(counts))
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)


def _across(row: int, rows: int, width_px: int) -> int:
    return round(row / max(rows - 1, 1) * (width_px - 1))


def _told(value: float, places: int = 0) -> str:
    return "-" if np.isnan(value) else f"{value:.{places}f}"


def _write(
    place: Image, text: str, at_px: tuple[int, int], colour: Colour, *, bold: bool = False
) -> None:
    size, weight = (0.62, 2) if bold else (0.5, 1)
    cv2.putText(place, text, at_px, cv2.FONT_HERSHEY_SIMPLEX, size, colour, weight, cv2.LINE_AA)
