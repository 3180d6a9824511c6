"""Videos and folders: the same counts as the front end's, in the right order, plain refusals."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.evaluation.pictures import grey_pictures, judge_pictures
from rig.vision.orb import OrbFrontEnd

PICTURES = 12


def picture(index: int) -> NDArray[np.uint8]:
    blocks = np.random.default_rng(5).integers(30, 220, (40, 60, 3), dtype=np.uint8)
    wall = np.kron(blocks, np.ones((8, 8, 1), np.uint8))
    return np.ascontiguousarray(wall[:240, 3 * index : 3 * index + 320])


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (320, 240))
    assert writer.isOpened()
    for index in range(PICTURES):
        writer.write(picture(index))
    writer.release()
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "pictures"
    path.mkdir()
    for index in range(PICTURES):
        assert cv2.imwrite(str(path / f"img{index}.png"), picture(index))
    (path / "notes.txt").write_text("not a picture")
    return path


def test_a_video_is_judged_without_settings(video: Path) -> None:
    series = judge_pictures(video)
    counts = series.inliers["orb"]
    assert len(counts) == PICTURES
    assert np.flatnonzero(np.isnan(counts)).tolist() == [0]
    statistics = series.statistics()["orb"]
    assert list(statistics) == ["median", "min", "mean", "p5", "blind_frames"]
    assert statistics["median"] == np.median(counts[1:]) > 200
    assert statistics["blind_frames"] == 0


def test_counts_are_the_front_ends_in_natural_order(folder: Path) -> None:
    orb = OrbFrontEnd()
    grey = [cv2.cvtColor(picture(i), cv2.COLOR_BGR2GRAY) for i in range(PICTURES)]
    expected = [orb.match(orb.features(a), orb.features(b)).inliers for a, b in pairwise(grey)]
    assert judge_pictures(folder).inliers["orb"][1:].tolist() == expected


def test_every_nth_picture(folder: Path) -> None:
    series = judge_pictures(folder, step=5)
    assert len(series.mean_grey_dn) == 3
    means = [cv2.cvtColor(picture(i), cv2.COLOR_BGR2GRAY).mean() for i in (0, 5, 10)]
    np.testing.assert_allclose(series.mean_grey_dn, means)


def test_a_blind_stretch_is_seen(folder: Path) -> None:
    black = np.zeros((240, 320, 3), np.uint8)
    cv2.imwrite(str(folder / "img6.png"), black)
    counts = judge_pictures(folder).inliers["orb"]
    assert counts[6] == counts[7] == 0
    assert judge_pictures(folder).statistics()["orb"]["blind_frames"] == 2


def test_what_cannot_be_judged_is_refused_in_one_line(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere: no such video or folder"):
        list(grey_pictures(tmp_path / "nowhere"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"empty: no picture in this folder"):
        list(grey_pictures(tmp_path / "empty"))
    (folder / "img3.png").write_bytes(b"not a png")
    with pytest.raises(RecordingError, match=r"img3\.png: cannot be read as a picture"):
        list(grey_pictures(folder))
    (tmp_path / "film.mp4").write_bytes(b"not a video")
    with pytest.raises(RecordingError, match=r"film\.mp4: cannot be read as a video"):
        list(grey_pictures(tmp_path / "film.mp4"))
    with pytest.raises(ValueError, match="at least 1"):
        judge_pictures(folder, step=0)
