"""`rig export`: what other tools get is what was recorded."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from record_disk import SmallDisk
from record_samples import HEADER, assert_same, frame, half, record, write
from scipy.spatial.transform import Rotation

from rig.cli.main import run
from rig.core.errors import RecordingError
from rig.core.types import Frame, PairRecord, Truth
from rig.record import archive, backing, cdr, file, sink, topics
from rig.record.container import parts
from rig.record.frames import Frames
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.verify import verify


def turned(trigger: int) -> PairRecord:
    angle = Rotation.from_euler("z", 10 * trigger, degrees=True).as_quat()
    where = (1.0 + trigger, 2.0, -3.0)
    truth = Truth(where, tuple(angle.tolist()), 10.0)
    return replace(record(trigger), truth=truth)


RECORDS = [turned(0), replace(half(1), truth=turned(1).truth), turned(2), turned(3)]


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    write(tmp_path / "run", RECORDS)
    return tmp_path / "run"


def exported(recorded: Path, to: str) -> Path:
    out = recorded.parent / to
    assert run(["export", str(recorded), "--to", to, "--out", str(out)]) == 0
    return out


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return picture


def test_mosaics_are_the_pixels_with_their_settings(recorded: Path) -> None:
    out = exported(recorded, "mosaic")
    for trigger in range(4):
        assert np.array_equal(read(out / "primary" / f"{trigger:06}.png"), frame(trigger).image)
    found = rows(out / "secondary" / "frames.csv")
    assert [each["trigger"] for each in found] == ["0", "2", "3"]
    assert (found[1]["exposure_us"], found[1]["gain_db"]) == ("700.5", "3.0")
    assert found[1]["device_time_ns"] == str(frame(2, 40).device_time_ns)


def test_pictures_have_the_colours_of_the_scene(tmp_path: Path) -> None:
    mosaic = np.zeros((24, 32), np.uint8)
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = 200, 50
    mosaic[0::2, 1::2] = mosaic[1::2, 0::2] = 100
    coloured = replace(frame(0), image=mosaic)
    given = record(0)
    write(tmp_path / "run", [replace(given, shot=given.shot._replace(primary=coloured))])
    picture = read(exported(tmp_path / "run", "png") / "primary" / "000000.png")
    assert picture[4:-4, 4:-4].reshape(-1, 3).mean(axis=0).tolist() == [50.0, 100.0, 200.0]


def test_euroc_has_its_layout(recorded: Path) -> None:
    root = exported(recorded, "euroc") / "mav0"
    listed = rows(root / "cam1" / "data.csv")
    assert [each["filename"] for each in listed] == ["40.png", "200000040.png", "300000040.png"]
    assert all(read(root / "cam1" / "data" / each["filename"]).ndim == 2 for each in listed)
    assert len(list((root / "cam0" / "data").iterdir())) == 4
    sensor = (root / "cam0" / "sensor.yaml").read_text()
    assert "resolution: [32, 24]" in sensor
    assert "intrinsics: [28.2, 28.3, 16.0, 12.0]" in sensor
    truth = rows(root / "state_groundtruth_estimate0" / "data.csv")
    assert truth[2]["#timestamp"] == "200000000"
    assert float(truth[2]["p_RS_R_x [m]"]) == 3.0
    assert float(truth[2]["q_RS_w []"]) == pytest.approx(np.cos(np.radians(10)))
    assert "T_BS" not in (root / "cam1" / "sensor.yaml").read_text()


def test_tum_and_kitti_tell_the_same_way(recorded: Path) -> None:
    tum = np.loadtxt(exported(recorded, "tum") / "groundtruth.tum")
    assert tum[:, 0].tolist() == [0.0, 0.1, 0.2, 0.3]
    assert tum[3, 1:4].tolist() == [4.0, 2.0, -3.0]
    folder = exported(recorded, "kitti")
    kitti = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    assert np.allclose(kitti[0], np.eye(4)[:3])
    turn = Rotation.from_quat(tum[3, 4:]).as_matrix()
    assert np.allclose(kitti[3][:, :3], turn)
    assert np.allclose(kitti[3][:, 3], [3.0, 0.0, 0.0])
    assert np.loadtxt(folder / "times.txt").tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_a_run_without_truth_has_no_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "run", [replace(record(0), truth=None)])
    out = tmp_path / "out"
    assert run(["export", str(tmp_path / "run"), "--to", "tum", "--out", str(out)]) == 1
    assert "only a simulation knows them" in capsys.readouterr().err
    assert not out.exists()


def test_a_video_has_every_trigger_at_the_recorded_rate(recorded: Path) -> None:
    out = exported(recorded, "mp4")
    for side in ("primary", "secondary"):
        film = cv2.VideoCapture(str(out / f"{side}.mp4"))
        assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
        assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 4
        assert (film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (32, 24)
        film.release()


def test_an_archive_for_which_there_is_no_room_is_taken_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "run", [record(trigger) for trigger in range(60)])
    monkeypatch.setattr(archive, "_RESERVE_BYTES", 1000)
    for module in (backing, file):
        monkeypatch.setattr(module, "os", SmallDisk(capacity=1500))
    out = tmp_path / "archived"
    with pytest.raises(RecordingError, match=f"cannot write {out}: No space left on device"):
        archive.archive(open_recording(tmp_path / "run"), out, lambda _: None)
    assert not out.exists()


def test_an_archive_is_the_same_recording_in_fewer_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sink, "CHUNK_BYTES", 10_000)
    monkeypatch.setattr(sink, "PART_BYTES", 60_000)
    smooth = np.full((24, 32), 90, np.uint8)

    def flat(trigger: int) -> PairRecord:
        shot = record(trigger).shot
        return replace(turned(trigger), shot=type(shot)(*(replace(f, image=smooth) for f in shot)))  # type: ignore[type-var]

    given = [flat(trigger) for trigger in range(60)]
    write(tmp_path / "run", given)
    out = exported(tmp_path / "run", "archive")
    before, now = (
        [p.stat().st_size for p in parts(f / "run.mcap")] for f in (tmp_path / "run", out)
    )
    assert len(before) == len(now) > 1
    assert sum(now) < sum(before) / 2
    found = verify(out)
    assert (found.sound, found.pairs) == (True, 60)
    recording = open_recording(out)
    assert recording.header == HEADER
    for each, expected in zip(recording.records(), given, strict=True):
        assert_same(each, expected)
    with Frames(out) as frames:
        shot = frames.frame(41, "secondary")
        assert isinstance(shot, Frame)
        assert np.array_equal(shot.image, smooth)
    assert not recover(out).repaired


@pytest.mark.parametrize(
    ("to", "out", "code", "words"),
    [
        ("gif", "new", 2, "'gif' is no format; known: png"),
        ("png", "run", 1, "exists, nothing is overwritten"),
    ],
)
def test_what_cannot_be_exported_is_said(
    recorded: Path, to: str, out: str, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(recorded.parent / out)
    assert run(["export", str(recorded), "--to", to, "--out", folder]) == code
    assert words in capsys.readouterr().err


def test_the_result_can_be_read_by_a_script(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = recorded.parent / "out"
    assert run(["export", str(recorded), "--to", "tum", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == 1


def values_at(kind: str, path: list[str]) -> None:
    """Follow a path of names through message definitions; raises KeyError where it ends."""
    for name in path:
        named = {field.name: field.type for field in cdr.message_type(kind).fields}
        kind = named[name]


def test_the_foxglove_layout_shows_what_a_recording_has() -> None:
    layout = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"
    panels = json.loads(layout.read_text())["configById"]
    shown = [each["value"] for panel in panels.values() for each in panel.get("paths", [])]
    shown += [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    for panel in panels.values():
        shown += panel.get("imageMode", {}).values()
    assert len(shown) >= 10
    for path in shown:
        topic, *names = path.split(".")
        values_at(topics.TOPICS[topic].name, names)
