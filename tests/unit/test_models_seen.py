"""Matches by ground truth agree with geometry, and drives are seen as they are taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.config import load_camera_model
from rig.core.errors import UsageError
from rig.core.types import Settings
from rig.drivers.registry import open_source
from rig.drivers.scenes.trajectories import Pose
from rig.drivers.scenes.world import lens_for
from rig.drivers.sensor.sensor import Sensor
from rig.models.scoremap import seen
from rig.models.scoremap.paths import make_paths
from rig.models.scoremap.tracking import HAMMING_MAX, count_moves, feature_sets, flow
from rig.vision.bayer import to_grey
from rig.vision.orb import OrbFeatures, OrbFrontEnd
from rig.vision.thumbnail import thumbnail
from rig.vision.viso2.front_end import Viso2FrontEnd
from rig.vision.viso2.motion import Mount

WALL = "sim:wall?size=160x120&seed=1"
ROAD = "sim:road?size=320x240&seed=1"


def features(points: np.ndarray, descriptors: np.ndarray) -> OrbFeatures:
    return OrbFeatures(points.astype(np.float32), descriptors)


def test_points_flow_as_a_plane_in_front_of_a_moving_camera() -> None:
    lens = lens_for(640, 480)
    depth_m = np.full((480, 640), 10.0, np.float32)
    here = Pose(np.eye(3), np.zeros(3))
    there = Pose(np.eye(3), np.array([1.0, 0.0, 2.0]))
    points = np.array([[100.0, 200.0], [255.5, 191.5]], np.float32)
    middle = np.array([255.5, 191.5])
    f = lens.fx_px * 512 / 640
    expected = middle + ((points - middle) * 10 - [f, 0]) / 8
    assert np.allclose(flow(points, depth_m, lens, here, there), expected, atol=0.01)
    behind = Pose(np.eye(3), np.array([0.0, 0.0, 11.0]))
    assert np.isnan(flow(points, depth_m, lens, here, behind)).all()


def test_a_match_is_near_where_it_should_be_and_looks_the_same() -> None:
    rng = np.random.default_rng(0)
    words = rng.integers(0, 256, (5, 32), dtype=np.uint8)
    points = np.array([[50, 50], [100, 50], [150, 50], [200, 50], [250, 50]], float)
    moved = points + np.array([[0, 2.9], [0, 3.2], [0, 0], [0, 0], [0, 0]])
    other = words.copy()
    other[2] = ~other[2]
    before = feature_sets([features(points, words)], [1_000.0])
    after = feature_sets([features(moved, other)], [1_000.0])
    allowed = np.ones((1, 1), bool)
    assert count_moves(before, after, before.points_px, 1e5, allowed)[0, 0] == 3
    assert count_moves(before, after, before.points_px, 1e5, ~allowed)[0, 0] == 0
    flipped = words.copy()
    flipped[:, : HAMMING_MAX // 8 + 1] ^= 255
    strange = feature_sets([features(points, flipped)], [1_000.0])
    assert count_moves(before, strange, before.points_px, 1e5, allowed)[0, 0] == 0


def test_a_blurred_feature_is_looked_for_in_the_middle_of_its_exposure() -> None:
    words = np.zeros((1, 32), np.uint8)
    before = feature_sets([features(np.array([[100.0, 100.0]]), words)], [0.0])
    predicted = np.array([[120.0, 100.0]], np.float32)
    late = feature_sets([features(np.array([[124.5, 100.0]]), words)], [40_000.0])
    allowed = np.ones((1, 1), bool)
    assert count_moves(before, late, predicted, 100_000.0, allowed)[0, 0] == 1
    late.exposures_us[0] = 0.0
    assert count_moves(before, late, predicted, 100_000.0, allowed)[0, 0] == 0


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seen, "cached", lambda _kind, _key, make: make())


@pytest.mark.usefixtures("no_cache")
def test_a_drive_is_seen_as_its_camera_takes_it() -> None:
    told: list[tuple[int, int]] = []
    found = make_paths([WALL], frames=3, processes=1, progress=lambda *done: told.append(done))
    drive = found.drives[0]
    cells = len(found.grid.cells())
    assert drive.thumbnails.shape == (3, cells, 2, 48, 64)
    assert drive.moves.shape == (2, cells, cells)
    assert told == [(0, 1), (1, 1)]
    assert found.sources[0].world_version == drive.world_version
    cell = int(np.diagonal(drive.moves[0]).argmax())
    settings = Settings(*found.grid.cells()[cell].tolist())
    source = open_source(WALL, seed=0, split="train")
    model = load_camera_model("blackfly-s-u3-31s4")
    pictures = [
        Sensor(model, (120, 160), seed=0).develop(
            source.scene.view("primary", pose / 10).exposed(settings.exposure_us),  # type: ignore[attr-defined]
            settings,
            99 + pose,
        )
        for pose in (0, 1)
    ]
    shown = thumbnail(pictures[0], "bayer_rggb8").astype(int)
    assert np.abs(shown - drive.thumbnails[0, cell])[0].mean() < 4
    front_end = OrbFrontEnd()
    a, b = (front_end.features(to_grey(picture, "bayer_rggb8")) for picture in pictures)
    inliers = front_end.match(a, b).inliers
    assert drive.moves[0, cell, cell] == pytest.approx(inliers, rel=0.35)
    viso2 = Viso2FrontEnd()
    a2, b2 = (viso2.features(to_grey(picture, "bayer_rggb8")) for picture in pictures)
    assert drive.steady.shape == (2, cells)
    assert drive.steady[0, cell] == pytest.approx(viso2.match(a2, b2).inliers, rel=0.35)
    assert drive.told.shape == (2, cells) and drive.told.all()  # it stands


@pytest.mark.usefixtures("no_cache")
def test_a_drive_says_which_settings_tell_a_motion() -> None:
    found = make_paths([ROAD], frames=2, processes=1)
    told, cells = found.drives[0].told[0], found.grid.cells()
    assert told.any() and not told.all()
    cell = int(np.argmax(found.drives[0].steady[0] * told))
    source = open_source(ROAD, seed=0, split="train")
    sensor = Sensor(load_camera_model("blackfly-s-u3-31s4"), (240, 320), seed=0)
    settings, viso2 = Settings(*cells[cell].tolist()), Viso2FrontEnd()
    views = [source.scene.view("primary", pose / 10) for pose in (0, 1)]  # type: ignore[attr-defined]
    greys = [
        to_grey(sensor.develop(view.exposed(settings.exposure_us), settings, 99), "bayer_rggb8")
        for view in views
    ]
    points = viso2.bucket(viso2.matched(*map(viso2.features, greys)))
    lens = source.scene.intrinsics("primary")  # type: ignore[attr-defined]
    assert not viso2.motion(points, lens, Mount()).failure
    assert not told[found.drives[0].steady[0] == 0].any()


@pytest.mark.usefixtures("no_cache")
def test_pieces_join_as_if_they_were_one(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = make_paths([WALL], frames=4, processes=1)
    monkeypatch.setattr(seen, "_POSES_A_PIECE", 2)
    parts = make_paths([WALL], frames=4, processes=1)
    assert np.array_equal(whole.drives[0].moves, parts.drives[0].moves)
    assert np.array_equal(whole.drives[0].steady, parts.drives[0].steady)
    assert np.array_equal(whole.drives[0].thumbnails, parts.drives[0].thumbnails)
    assert whole.sources == parts.sources


@pytest.mark.usefixtures("no_cache")
def test_a_drive_may_begin_on_the_way() -> None:
    whole, part = make_paths([WALL], frames=4), make_paths([WALL], first=2, frames=2)
    assert np.array_equal(whole.drives[0].moves[2:], part.drives[0].moves)
    assert np.array_equal(whole.drives[0].thumbnails[2:], part.drives[0].thumbnails)
    assert (part.sources[0].first_pose, part.sources[0].poses) == (2, 2)
    assert part.sources[0].name == f"{whole.sources[0].name}@2"


@pytest.mark.parametrize(
    ("cameras", "options", "complaint"),
    [
        ([], {}, "name at least one world"),
        ([WALL, WALL], {}, "named twice"),
        ([WALL, f"{WALL}&split=train"], {}, "named twice"),
        (["replay:/nowhere"], {}, "only simulated cameras"),
        ([WALL], {"frames": 1}, "at least 2"),
        ([WALL], {"first": -1}, "at least 0, got -1"),
        ([WALL], {"first": 100_000}, "leaves fewer than two"),
        ([WALL], {"processes": 0}, "number of processes"),
    ],
)
def test_cameras_that_cannot_be_seen_are_refused(
    cameras: list[str], options: dict[str, int], complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=complaint):
        make_paths(cameras, **options)  # type: ignore[arg-type]
