from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.errors import UsageError
from rig.models.metrics import Drive, Window, find_metric


def _drive(count: int, seed: int = 0, pictures: int = 2) -> Drive:
    rng = np.random.default_rng(seed)
    shape = (count, pictures)
    return Drive(
        used=np.stack([rng.uniform(75, 30_000, shape), rng.uniform(0, 30, shape)], -1),
        features=rng.integers(0, 6, shape),
        uniformity=rng.uniform(0, 1, shape),
        inliers=rng.integers(0, 6, (count - 1, pictures, pictures)),
        pose_errors_deg=rng.uniform(0, 9, (count - 1, pictures, pictures)),
    )


def _eq_4_11(drive: Drive, pose: int, window: int) -> tuple[float, float]:
    best, chosen = -1, (0.0, 0.0)
    for later in range(pose + 1, min(pose + window, len(drive.used) - 1) + 1):
        for camera in range(2):
            if drive.features[later, camera] > best:
                best, chosen = drive.features[later, camera], tuple(drive.used[later, camera])
    return chosen


def _eq_4_12(drive: Drive, pose: int, window: int) -> tuple[float, float]:
    best, chosen = -1, (0.0, 0.0)
    for a in range(window):
        if pose + a + 1 >= len(drive.used):
            break
        for i in range(2):
            for j in range(2):
                if drive.inliers[pose + a, i, j] > best:
                    best = drive.inliers[pose + a, i, j]
                    chosen = tuple(drive.used[pose + a + 1, j])
    return chosen


@given(st.integers(2, 9), st.integers(1, 5), st.integers(0, 10_000))
def test_targets_are_those_of_the_equations(count: int, window: int, seed: int) -> None:
    drive = _drive(count, seed)
    poses = range(count - 1)
    feat = find_metric("feat").choose(drive, Window(window))
    grid = find_metric("grid").choose(drive, Window(window))
    np.testing.assert_array_equal(feat, [_eq_4_11(drive, pose, window) for pose in poses])
    np.testing.assert_array_equal(grid, [_eq_4_12(drive, pose, window) for pose in poses])
    hybrid = find_metric("hybrid").choose(drive, Window(window, alpha=0.25))
    np.testing.assert_allclose(hybrid, 0.25 * feat + 0.75 * grid)


def test_grid_takes_the_settings_of_the_later_picture_and_its_camera() -> None:
    drive = _drive(4)
    drive.inliers[:] = 0
    drive.inliers[1, 0, 1] = 50
    chosen = find_metric("grid").choose(drive, Window(2))
    np.testing.assert_array_equal(chosen[0], drive.used[2, 1])
    np.testing.assert_array_equal(chosen[1], drive.used[2, 1])
    np.testing.assert_array_equal(chosen[2], drive.used[3, 0])


def test_sequence_follows_the_picture_chosen_before() -> None:
    drive = _drive(5, pictures=7)
    chosen, targets = int(drive.features[0].argmax()), []
    for pose in range(4):
        chosen = int(drive.inliers[pose, chosen].argmax())
        targets.append(drive.used[pose + 1, chosen])
    np.testing.assert_array_equal(find_metric("seq").choose(drive, Window(4)), targets)


def test_evenness_and_pose_choose_the_largest_and_the_smallest_of_all_pictures() -> None:
    drive = _drive(3, pictures=7)
    even = drive.uniformity[1].argmax()
    np.testing.assert_array_equal(
        find_metric("uni").choose(drive, Window(1))[0], drive.used[1, even]
    )
    _, later = np.unravel_index(drive.pose_errors_deg[1].argmin(), (7, 7))
    np.testing.assert_array_equal(
        find_metric("pose").choose(drive, Window(1))[1], drive.used[2, later]
    )


def test_metrics_say_what_they_need() -> None:
    assert (find_metric("feat").needs_features, find_metric("feat").needs_inliers) == (True, False)
    assert (find_metric("grid").needs_features, find_metric("grid").needs_inliers) == (False, True)
    assert find_metric("hybrid").needs_features
    assert find_metric("hybrid").needs_inliers


def test_unknown_metric_gets_a_suggestion() -> None:
    with pytest.raises(UsageError, match=r"'hybird'.*did you mean 'hybrid'"):
        find_metric("hybird")
    with pytest.raises(UsageError, match="choose from feat, uni, grid, seq, hybrid, pose"):
        find_metric("xyz")


@pytest.mark.parametrize(
    ("window", "alpha", "message"),
    [(0, 0.5, "--window"), (4, 1.5, "--alpha"), (4, float("nan"), "--alpha")],
)
def test_bad_windows_are_refused(window: int, alpha: float, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Window(window, alpha)
