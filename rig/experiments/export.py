"""Recordings in the formats of other tools: pictures, EuRoC, KITTI, TUM, video."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.core.errors import RecordingError
from rig.core.types import SIDES, Frame, Intrinsics, PairRecord, Side, Truth
from rig.core.units import NS_PER_S
from rig.record.reader import Recording
from rig.vision.bayer import to_bgr, to_grey

EUROC_CAMERAS = {"primary": "cam0", "secondary": "cam1"}
_LIST = ["trigger", "file", "device_time_ns", "exposure_us", "gain_db", "pose_index"]

Progress = Callable[[int], None]


def export_png(recording: Recording, folder: Path, progress: Progress) -> None:
    """Write colour pictures, `P/000000.png`, and `P/frames.csv` with the settings used."""
    _export_pictures(recording, folder, progress, lambda f: to_bgr(f.image, f.pixel_format))


def export_mosaic(recording: Recording, folder: Path, progress: Progress) -> None:
    """Write the sensor's own pixels as grey pictures, otherwise like `export_png`."""
    _export_pictures(recording, folder, progress, lambda f: f.image)


def export_euroc(recording: Recording, folder: Path, progress: Progress) -> None:
    """Write `mav0/cam0`, `mav0/cam1` with grey pictures and, of a simulation, the true poses.

    The body frame is the primary's optical frame. A recording does not know where the secondary
    stands, so its `sensor.yaml` has no pose.
    """
    root = folder / "mav0"
    with ExitStack() as files:
        lists = {}
        for side, lens in zip(SIDES, recording.header.intrinsics, strict=True):
            camera = root / EUROC_CAMERAS[side]
            (camera / "data").mkdir(parents=True)
            (camera / "sensor.yaml").write_text(_sensor_yaml(side, lens), encoding="utf-8")
            lists[side] = _table(files, camera / "data.csv", ["#timestamp [ns]", "filename"])
        truths: list[tuple[int, Truth]] = []
        for record in _watched(recording, progress):
            for side, frame in _frames(record):
                name = f"{frame.device_time_ns}.png"
                grey = to_grey(frame.image, frame.pixel_format)
                _save(root / EUROC_CAMERAS[side] / "data" / name, grey)
                lists[side].writerow([frame.device_time_ns, name])
            truths += _timed_truth(record)
        if truths:
            (root / "state_groundtruth_estimate0").mkdir()
            path = root / "state_groundtruth_estimate0" / "data.csv"
            _write_euroc_truth(files, path, truths)


def export_tum(recording: Recording, folder: Path, progress: Progress) -> None:
    """Write `groundtruth.tum`: seconds, position in metres, quaternion x y z w."""
    lines = [
        " ".join(
            f"{value:.9f}" for value in (time_ns / NS_PER_S, *t.position_m, *t.orientation_xyzw)
        )
        for time_ns, t in _truths(recording, progress)
    ]
    folder.mkdir(parents=True)
    _write_lines(folder / "groundtruth.tum", lines)


def export_kitti(recording: Recording, folder: Path, progress: Progress) -> None:
    """Write `poses.txt`, 12 numbers a line against the first optical frame, and `times.txt`."""
    truths = _truths(recording, progress)
    poses = [_matrix(truth) for _, truth in truths]
    first = np.linalg.inv(poses[0])
    start_ns = truths[0][0]
    folder.mkdir(parents=True)
    rows = [" ".join(f"{value:.9e}" for value in (first @ pose)[:3].ravel()) for pose in poses]
    _write_lines(folder / "poses.txt", rows)
    _write_lines(
        folder / "times.txt", [f"{(time_ns - start_ns) / NS_PER_S:.9e}" for time_ns, _ in truths]
    )


def export_mp4(recording: Recording, folder: Path, progress: Progress) -> None:
    """Write `primary.mp4` and `secondary.mp4`; in place of a lost frame the one before stays."""
    folder.mkdir(parents=True)
    rate_hz = _rate_hz(recording)
    with ExitStack() as films:
        writers = {
            side: _film(films, folder / f"{side}.mp4", lens, rate_hz)
            for side, lens in zip(SIDES, recording.header.intrinsics, strict=True)
        }
        last: dict[Side, NDArray[np.uint8]] = {}
        for record in _watched(recording, progress):
            for side, frame in _frames(record):
                last[side] = to_bgr(frame.image, frame.pixel_format)
            for side, picture in last.items():
                writers[side].write(picture)


FORMATS: dict[str, Callable[[Recording, Path, Progress], None]] = {
    "png": export_png,
    "mosaic": export_mosaic,
    "euroc": export_euroc,
    "kitti": export_kitti,
    "tum": export_tum,
    "mp4": export_mp4,
}


def _export_pictures(
    recording: Recording,
    folder: Path,
    progress: Progress,
    look: Callable[[Frame], NDArray[np.uint8]],
) -> None:
    with ExitStack() as files:
        lists = {}
        for side in SIDES:
            (folder / side).mkdir(parents=True)
            lists[side] = _table(files, folder / side / "frames.csv", _LIST)
        for record in _watched(recording, progress):
            for side, frame in _frames(record):
                name = f"{record.trigger:06}.png"
                _save(folder / side / name, look(frame))
                used = frame.used
                row = [record.trigger, name, frame.device_time_ns, used.exposure_us, used.gain_db]
                lists[side].writerow([*row, record.pose_index])


def _watched(recording: Recording, progress: Progress) -> Iterator[PairRecord]:
    for done, record in enumerate(recording.records(), start=1):
        yield record
        progress(done)


def _frames(record: PairRecord) -> Iterator[tuple[Side, Frame]]:
    for side, shot in zip(SIDES, record.shot, strict=True):
        if isinstance(shot, Frame):
            yield side, shot


def _timed_truth(record: PairRecord) -> Iterator[tuple[int, Truth]]:
    primary = record.shot.primary
    if record.truth is not None and isinstance(primary, Frame):
        yield primary.device_time_ns, record.truth


def _truths(recording: Recording, progress: Progress) -> list[tuple[int, Truth]]:
    found = [each for record in _watched(recording, progress) for each in _timed_truth(record)]
    if not found:
        raise RecordingError(
            f"{recording.path} holds no true poses; only a simulation knows them: "
            "export with --to png, mosaic, euroc or mp4"
        )
    return found


def _matrix(truth: Truth) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(truth.orientation_xyzw).as_matrix()
    pose[:3, 3] = truth.position_m
    return pose


def _write_euroc_truth(files: ExitStack, path: Path, truths: Sequence[tuple[int, Truth]]) -> None:
    names = ["#timestamp", *(f"p_RS_R_{axis} [m]" for axis in "xyz")]
    table = _table(files, path, [*names, *(f"q_RS_{axis} []" for axis in "wxyz")])
    for time_ns, truth in truths:
        x, y, z, w = truth.orientation_xyzw
        table.writerow([time_ns, *truth.position_m, w, x, y, z])


def _sensor_yaml(side: Side, lens: Intrinsics) -> str:
    pose = "T_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    return (
        "sensor_type: camera\n"
        f"comment: {side}\n"
        + (pose if side == "primary" else "")
        + f"resolution: [{lens.width_px}, {lens.height_px}]\n"
        "camera_model: pinhole\n"
        f"intrinsics: [{lens.fx_px}, {lens.fy_px}, {lens.cx_px}, {lens.cy_px}]\n"
        "distortion_model: radial-tangential\n"
        f"distortion_coefficients: [{', '.join(map(str, lens.distortion[:4]))}]\n"
    )


def _rate_hz(recording: Recording) -> float:
    times_ns = [t for record in recording.records() for t in _times_ns(record)]
    steps_ns = [b - a for a, b in pairwise(times_ns)]
    return NS_PER_S / median(steps_ns) if steps_ns else 1.0


def _times_ns(record: PairRecord) -> list[int]:
    return [frame.device_time_ns for _, frame in _frames(record)][:1]


def _film(films: ExitStack, path: Path, lens: Intrinsics, rate_hz: float) -> cv2.VideoWriter:
    size = (lens.width_px, lens.height_px)
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, size)
    films.callback(film.release)
    if not film.isOpened():
        raise RecordingError(f"{path} cannot be written as a video; try --to png")
    return film


def _table(files: ExitStack, path: Path, names: list[str]) -> Any:
    table = csv.writer(files.enter_context(path.open("w", newline="", encoding="utf-8")))
    table.writerow(names)
    return table


def _save(path: Path, picture: NDArray[np.uint8]) -> None:
    done, data = cv2.imencode(".png", picture)
    if not done:
        raise RecordingError(f"{path} cannot be written as a picture")
    path.write_bytes(data.tobytes())


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
