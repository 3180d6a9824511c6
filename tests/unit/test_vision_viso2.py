"""The viso2-style front end does what its description says, step by step and as a whole."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import viso2_reference
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.core.types import Intrinsics
from rig.vision.viso2.bucketing import bucketed
from rig.vision.viso2.delaunay import triangulate
from rig.vision.viso2.front_end import MatchedPoints, Viso2FrontEnd
from rig.vision.viso2.fundamental import fundamental, inliers
from rig.vision.viso2.motion import Mount, estimate_motion, ground_distance

LENS = Intrinsics(1024, 768, 900.0, 900.0, 511.5, 383.5)
MOUNT = Mount(height_m=1.4)
Points = NDArray[np.float64]


def wall(height_px: int, width_px: int, seed: int = 3) -> NDArray[np.uint8]:
    """Return a picture of blots of many sizes."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((height_px, width_px), np.float64)
    for blot_px in (1.2, 2.5, 6.0):
        noise = rng.normal(size=picture.shape)
        blurred = cv2.GaussianBlur(noise, (0, 0), blot_px)
        picture += blurred / blurred.std()
    return np.clip(128 + 30 * picture, 0, 255).astype(np.uint8)


def zoomed(picture: NDArray[np.uint8], factor: float, shift_px: float) -> NDArray[np.uint8]:
    """Return the picture as from a little nearer and from beside."""
    height_px, width_px = picture.shape
    move = np.array(
        [
            [factor, 0.02, shift_px + (1 - factor) * width_px / 2],
            [-0.02, factor, (1 - factor) * height_px / 2],
        ]
    )
    warped = cv2.warpAffine(picture, move, (width_px, height_px), borderMode=cv2.BORDER_REFLECT)
    noise = np.random.default_rng(1).normal(0, 3, warped.shape)
    return np.clip(warped + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("half_resolution", [True, False])
def test_matches_are_those_of_the_plain_description(half_resolution: bool) -> None:
    before = wall(171, 233)
    now = zoomed(before, 1.04, 5)
    front_end = Viso2FrontEnd(half_resolution)
    found = front_end.matched(front_end.features(before), front_end.features(now))
    rows = np.concatenate([found.previous_px, found.current_px], axis=1)
    expected = viso2_reference.matched(before, now, half_resolution)
    assert len(expected) > 40
    assert sorted(rows.tolist()) == sorted(expected.tolist())


def test_all_matches_of_a_moved_picture_are_right() -> None:
    front_end = Viso2FrontEnd()
    wide = wall(480, 700)
    a, b = (front_end.features(np.ascontiguousarray(wide[:, x : x + 640])) for x in (0, 12))
    matches = front_end.match(a, b)
    assert len(matches) > 1000
    error_px = np.abs(matches.points_a_px - matches.points_b_px - (12, 0)).max(axis=1)
    assert np.mean(error_px <= 1) > 0.99


@pytest.mark.parametrize("value", [0, 255])
def test_a_flat_picture_has_no_features_and_no_matches(value: int) -> None:
    front_end = Viso2FrontEnd()
    flat = front_end.features(np.full((240, 320), value, np.uint8))
    some = front_end.features(wall(240, 320))
    assert len(flat) == 0
    for a, b in ((flat, some), (some, flat), (flat, flat)):
        matches = front_end.match(a, b)
        assert len(matches) == matches.inliers == 0


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=3, max_size=60))
def test_triangles_are_delaunays(places: list[tuple[int, int]]) -> None:
    points = np.array(places, np.int32)
    triangles = triangulate(points).astype(int)
    distinct = np.unique(points, axis=0)
    spread = distinct - distinct[0]
    on_a_line = np.linalg.matrix_rank(spread) < 2
    if on_a_line:
        assert len(triangles) == 0
        return
    area = 0
    for a, b, c in points[triangles].astype(int):
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert turn > 0
        area += turn
        sides = np.stack([a, b, c])
        for point in distinct:
            rows = np.column_stack([sides - point, ((sides - point) ** 2).sum(axis=1)])
            assert round(np.linalg.det(rows)) <= 0 + 1e-6
    hull = cv2.convexHull(distinct).reshape(-1, 2)
    assert area == pytest.approx(2 * cv2.contourArea(hull))


def test_a_bucket_keeps_two_and_the_seed_decides_which() -> None:
    current = np.random.default_rng(0).integers(0, 300, (500, 2)).astype(np.int32)
    rows = bucketed(current, 0)
    all_buckets, all_counts = np.unique(current // 50, axis=0, return_counts=True)
    buckets, counts = np.unique(current[rows] // 50, axis=0, return_counts=True)
    assert buckets.tolist() == all_buckets.tolist()
    assert counts.tolist() == np.minimum(all_counts, 2).tolist()
    assert len(set(rows.tolist())) == len(rows)
    assert rows.tolist() == bucketed(current, 0).tolist()
    assert rows.tolist() != bucketed(current, 1).tolist()


def road(count: int, seed: int = 0) -> Points:
    """Return points in front of a camera 1.4 m over a flat road, N x 3 (x right, y down)."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack(
        [rng.uniform(-6, 6, count // 2), np.full(count // 2, 1.4), rng.uniform(4, 25, count // 2)]
    )
    rest = count - count // 2
    air = np.column_stack(
        [rng.uniform(-8, 8, rest), rng.uniform(-5, 1.0, rest), rng.uniform(5, 30, rest)]
    )
    return np.concatenate([ground, air])


def seen(points: Points) -> Points:
    centre, focal = (LENS.cx_px, LENS.cy_px), (LENS.fx_px, LENS.fy_px)
    return points[:, :2] / points[:, 2:] * focal + centre


def moved(points: Points, turn_deg: float, ahead_m: float) -> tuple[Points, NDArray[np.float64]]:
    """Return the points as seen after a step, and the 4 x 4 that brings them there."""
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("y", turn_deg, degrees=True).as_matrix()
    transform[:3, 3] = (0.05, 0.0, -ahead_m)
    return points @ transform[:3, :3].T + transform[:3, 3], transform


def test_the_motion_of_a_known_scene_with_wrong_matches_in_it() -> None:
    points = road(400)
    after, truth = moved(points, 2.0, 1.2)
    previous, current = seen(points), seen(after)
    previous[::5] += np.random.default_rng(2).uniform(30, 90, previous[::5].shape)
    motion = estimate_motion(previous, current, LENS, MOUNT, seed=0)
    assert motion.failure == ""
    assert motion.transform is not None
    assert 300 <= motion.inliers <= 340
    assert motion.transform == pytest.approx(truth, abs=0.02)


def test_the_geometry_of_exact_matches_is_exact() -> None:
    points = road(60)
    previous, current = seen(points), seen(moved(points, 1.0, 0.8)[0])
    assert inliers(previous, current, seed=0).all()
    f = fundamental(previous, current)
    homogeneous = [np.column_stack([p, np.ones(len(p))]) for p in (previous, current)]
    miss = np.einsum("ni,ij,nj->n", homogeneous[1], f / np.linalg.norm(f), homogeneous[0])
    assert np.abs(miss).max() < 1e-8
    assert np.linalg.matrix_rank(f / np.linalg.norm(f), tol=1e-10) == 2


def test_every_reason_to_fail_is_told() -> None:
    points = road(200)
    previous, current = seen(points), seen(moved(points, 1.0, 1.0)[0])

    def failure(a: Points, b: Points) -> str:
        motion = estimate_motion(a, b, LENS, MOUNT, seed=0)
        assert (motion.transform is None) == (motion.failure != "")
        return motion.failure

    assert failure(previous, current) == ""
    assert failure(previous[:9], current[:9]) == "few matches"
    assert failure(previous[:0], current[:0]) == "few matches"
    random = np.random.default_rng(0).uniform(0, 700, (2, 12, 2))
    assert failure(random[0], random[1]) == "few inliers"
    far = points * 300
    assert failure(seen(far), seen(moved(far, 1.0, 1.0)[0])) == "too little motion"
    sky = points[points[:, 1] < 0]
    above = sky - (0, 3, 0)
    assert failure(seen(above), seen(moved(above, 0.0, 1.0)[0])) == "no ground"


def test_points_behind_the_camera_tell_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    points = road(200)
    previous, current = seen(points), seen(moved(points, 1.0, 1.0)[0])
    monkeypatch.setattr("rig.vision.viso2.motion.IN_FRONT_MIN", 1000)
    motion = estimate_motion(previous, current, LENS, MOUNT, seed=0)
    assert motion.failure == "few points in front"


def test_the_ground_is_where_most_points_are_crowded() -> None:
    rng = np.random.default_rng(0)
    below = np.concatenate([rng.normal(1.4, 0.01, 60), rng.uniform(0.2, 6.0, 60)])
    points = np.column_stack([np.zeros(120), below, np.full(120, 8.0)])
    assert ground_distance(points, 9.0, 0.0) == pytest.approx(1.4, abs=0.03)
    assert ground_distance(points * (1, -1, 1), 9.0, 0.0) is None


def test_a_camera_that_looks_down_has_a_negative_pitch() -> None:
    down_rad = 0.1
    x, y, z = road(200)[:100].T
    cosine, sine = np.cos(down_rad), np.sin(down_rad)
    seen_from_it = np.column_stack([x, y * cosine - z * sine, y * sine + z * cosine])
    assert ground_distance(seen_from_it, 15.0, -down_rad) == pytest.approx(1.4, abs=1e-6)
    assert ground_distance(seen_from_it, 15.0, down_rad) != pytest.approx(1.4, abs=0.1)


def test_the_same_pictures_give_the_same_answer() -> None:
    before = wall(240, 320)
    now = zoomed(before, 1.03, 4)
    front_end = Viso2FrontEnd()
    a, b = front_end.features(before), front_end.features(now)
    first, second = front_end.match(a, b), front_end.match(a, b)
    assert first.inlier_mask.tolist() == second.inlier_mask.tolist()
    few = front_end.bucket(MatchedPoints(first.points_a_px, first.points_b_px))
    assert 10 <= len(few) <= 2 * 7 * 5
