"""The tools of the field open a recording: Foxglove's packages, rerun, and ROS image decoding."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_samples import COUNTS, frame, half, record, write
from rosbags.highlevel import AnyReader
from rosbags.image import message_to_cvimage

from rig.cli.main import run

NODE = Path(__file__).parents[1] / "node"
INSTALLED = Path(sys.prefix) / "node-tests"
RECORDS = [record(0), half(1), record(2)]
RED, GREEN, BLUE = 200, 100, 50


def coloured() -> np.ndarray[Any, np.dtype[np.uint8]]:
    mosaic = np.empty((24, 32), np.uint8)
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = RED, BLUE
    mosaic[0::2, 1::2] = mosaic[1::2, 0::2] = GREEN
    return mosaic


@pytest.fixture(scope="module")
def npm() -> Path:
    """Return a folder with Foxglove's packages, installed once beside the Python ones."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm are not installed")
    INSTALLED.mkdir(exist_ok=True)
    for name in ("package.json", "read.mjs"):
        shutil.copy(NODE / name, INSTALLED / name)
    wanted = json.loads((NODE / "package.json").read_text())["dependencies"]
    found = [INSTALLED / "node_modules" / name / "package.json" for name in wanted]
    if not all(path.exists() for path in found):
        command = ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock"]
        done = subprocess.run(command, cwd=INSTALLED, capture_output=True, timeout=120)
        if done.returncode != 0:
            pytest.skip("npm packages cannot be installed")
    return INSTALLED


def seen_by_node(npm: Path, file: Path) -> dict[str, Any]:
    command = ["node", "read.mjs", str(file)]
    done = subprocess.run(command, cwd=npm, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    values: dict[str, Any] = json.loads(done.stdout)
    return values


def test_foxglove_reads_every_message_by_index_and_as_a_stream(npm: Path, tmp_path: Path) -> None:
    seen = seen_by_node(npm, write(tmp_path, RECORDS))
    assert seen["profile"] == "ros2"
    assert seen["indexed"] == COUNTS
    assert seen["streamed"] == sum(COUNTS.values())
    assert seen["done"] is True
    image = seen["first"]["/primary/image_raw"]
    assert base64.b64decode(image["data"]) == frame(0).image.tobytes()
    assert (image["encoding"], image["width"], image["height"]) == ("bayer_rggb8", 32, 24)
    meta = seen["first"]["/primary/frame_meta"]
    assert (meta["used"]["exposure_us"], meta["asked"]["settings"]["gain_db"]) == (700.5, 3.0)


def test_the_messages_are_those_that_foxglove_published(npm: Path, tmp_path: Path) -> None:
    seen = seen_by_node(npm, write(tmp_path, RECORDS))
    standard = {
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CameraInfo",
        "geometry_msgs/msg/PoseStamped",
    }
    assert seen["published"] == dict.fromkeys(standard, True)
    assert seen["foxglove"] == {"RawImage": True, "CameraCalibration": True, "PoseInFrame": True}
    assert seen["bayer"] is True


def test_rosbags_reads_an_archive(tmp_path: Path) -> None:
    write(tmp_path / "run", RECORDS)
    out = tmp_path / "archive"
    assert run(["export", str(tmp_path / "run"), "--to", "archive", "--out", str(out)]) == 0
    with AnyReader([out]) as reader:
        assert sum(1 for _ in reader.messages()) == sum(COUNTS.values())


def rerun(*arguments: str) -> str:
    found = Path(sys.prefix) / "bin" / "rerun"
    if not found.exists():
        pytest.skip("rerun-sdk is not installed")
    done = subprocess.run(
        [str(found), *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        env={"PATH": "/usr/bin:/bin", "HOME": "/nonexistent", "NO_COLOR": "1"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_rerun_finds_nothing_wrong(tmp_path: Path) -> None:
    checked = rerun("mcap", "check", "--full", str(write(tmp_path, RECORDS)))
    rows = [line.split() for line in checked.splitlines() if "/" in line and "─" not in line]
    states = {row[3]: row[0] for row in rows if len(row) > 3}
    assert states == dict.fromkeys(COUNTS, "ok"), checked


def test_rerun_decodes_pictures_lenses_and_our_own_messages(tmp_path: Path) -> None:
    out = tmp_path / "run.rrd"
    rerun("mcap", "convert", str(write(tmp_path, RECORDS)), "-o", str(out))
    printed = rerun("rrd", "print", "-v", str(out))
    for columns in (
        "3 rows (5.6 KiB) - /primary/image_raw",
        "/primary/image_raw@Image:buffer /primary/image_raw@Image:format",
        "/primary/camera_info@Pinhole:image_from_camera",
        "/primary/frame_meta@rig_msgs.msg.FrameMeta:message",
        "/ground_truth/pose@InstancePoses3D:translations",
    ):
        assert columns in printed


def test_rerun_sees_the_pixels_as_the_mosaic_that_they_are(tmp_path: Path) -> None:
    given = record(0)
    shot = given.shot._replace(primary=replace(frame(0), image=coloured()))
    out = tmp_path / "run.rrd"
    file = write(tmp_path, [replace(given, shot=shot)])
    rerun("mcap", "convert", str(file), "-o", str(out))
    printed = rerun("rrd", "print", "-vvv", str(out))
    known = pytest.importorskip("rerun", reason="rerun-sdk is not installed").PixelFormat
    assert f"pixel_format: {known.BayerRGGB8.value}" in printed
    assert f"[[{RED}, {GREEN}, {RED}, {GREEN}, " in printed


def test_a_coloured_scene_has_its_colours_in_ros(tmp_path: Path) -> None:
    given = record(0)
    shot = given.shot._replace(primary=replace(frame(0), image=coloured()))
    write(tmp_path, [replace(given, shot=shot)])
    with AnyReader([tmp_path]) as reader:
        connections = [each for each in reader.connections if each.topic == "/primary/image_raw"]
        ((connection, _, data),) = reader.messages(connections=connections)
        message = reader.deserialize(data, connection.msgtype)
    picture = message_to_cvimage(message, "bgr8")
    assert picture[4:-4, 4:-4].reshape(-1, 3).mean(axis=0).tolist() == [BLUE, GREEN, RED]
