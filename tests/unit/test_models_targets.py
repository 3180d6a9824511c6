from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_run import SyntheticRun
from synthetic_targets import make_targets_file

from rig.core.errors import RecordingError, UsageError
from rig.core.types import Frame, Truth
from rig.models import targets
from rig.models.measuring import stretches
from rig.models.metrics import find_metric
from rig.models.posing import LOST_DEG, pose_error_deg, true_motion
from rig.models.targets import Poses, Targets, make_targets
from rig.record.writer import RecordWriter
from rig.vision.bayer import to_grey, to_rgb224
from rig.vision.orb import OrbFeatures, OrbFrontEnd

_NONE = (np.empty((0, 2), np.float32), np.empty((0, 32), np.uint8))
CAMERAS = "sim:tunnel?seed=4&split=train"


def _record(folder: Path, run: SyntheticRun) -> Path:
    with RecordWriter(folder, run.header, real_time=False) as writer:
        for record in run.records():
            writer.write(record)
    return folder


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eleven pairs, of which 4 lost a frame: drives of pairs 0-3 and 5-10."""
    run = SyntheticRun(triggers=11, cameras=CAMERAS, lost={4: "timeout"}, options={"perturb": "x"})
    return _record(tmp_path_factory.mktemp("runs") / "drive", run)


@pytest.fixture(scope="module")
def hybrid(recording: Path) -> Targets:
    return make_targets([recording], "hybrid", 3, 0.25)


def test_lost_frames_end_drives_and_last_poses_have_no_target(hybrid: Targets) -> None:
    assert hybrid.poses.trigger.tolist() == [0, 1, 2, 5, 6, 7, 8, 9]
    assert hybrid.poses.drive.tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    assert hybrid.poses.recording.tolist() == [0] * 8


def test_pictures_and_settings_are_those_of_the_frames(hybrid: Targets) -> None:
    run = SyntheticRun(triggers=11, cameras=CAMERAS)
    records = {record.trigger: record for record in run.records()}
    for at, trigger in enumerate(hybrid.poses.trigger):
        for camera, frame in enumerate(records[int(trigger)].shot):
            assert isinstance(frame, Frame)
            assert hybrid.poses.used_exposure_us[at, camera] == frame.used.exposure_us
            assert hybrid.poses.used_gain_db[at, camera] == frame.used.gain_db
            exact = 255 * to_rgb224(frame.image, frame.pixel_format)
            stored = hybrid.poses.images[at, camera].astype(np.float32)
            np.testing.assert_allclose(stored, exact, atol=0.501)


def test_measures_are_feature_counts_and_inliers_of_all_four_combinations() -> None:
    run = SyntheticRun(triggers=8)
    records = list(run.records())[:3]
    (stretch,) = stretches(records, find_metric("hybrid"), run.header.intrinsics)
    grey = [
        [to_grey(f.image, f.pixel_format) for f in r.shot if isinstance(f, Frame)] for r in records
    ]
    orb = OrbFrontEnd()
    for pose in range(2):
        for i in range(2):
            assert stretch.drive.features[pose, i] == OrbFrontEnd(10_000).count(grey[pose][i])
            for j in range(2):
                a, b = orb.features(grey[pose][i]), orb.features(grey[pose + 1][j])
                assert stretch.drive.inliers[pose, i, j] == orb.match(a, b).inliers
    assert stretch.drive.inliers.min() > 100
    assert len(np.unique(stretch.drive.inliers)) > 4


def test_hybrid_mixes_the_targets_of_feat_and_grid(recording: Path, hybrid: Targets) -> None:
    feat = make_targets([recording], "feat", 3).poses
    grid = make_targets([recording], "grid", 3).poses
    for name in ("target_exposure_us", "target_gain_db"):
        mixed = 0.25 * getattr(feat, name) + 0.75 * getattr(grid, name)
        np.testing.assert_allclose(getattr(hybrid.poses, name), mixed)
    assert (feat.target_gain_db != grid.target_gain_db).any()


def test_targets_are_settings_used_inside_the_window_of_the_same_drive(recording: Path) -> None:
    poses = make_targets([recording], "grid", 4).poses
    used = {
        record.trigger: [
            (f.used.exposure_us, f.used.gain_db) for f in record.shot if isinstance(f, Frame)
        ]
        for record in SyntheticRun(triggers=11, cameras=CAMERAS, lost={4: "timeout"}).records()
    }
    for at, trigger in enumerate(poses.trigger.tolist()):
        end = 3 if trigger < 4 else 10
        ahead = [used[later] for later in range(trigger + 1, min(trigger + 4, end) + 1)]
        target = (poses.target_exposure_us[at], poses.target_gain_db[at])
        assert target in [settings for pair in ahead for settings in pair]


def test_file_says_where_it_came_from(hybrid: Targets, recording: Path) -> None:
    (source,) = hybrid.recordings
    assert (source.name, source.cameras, source.triggers) == ("drive", CAMERAS, 11)
    assert (source.leader, source.options) == ("ours", {"perturb": "x"})
    assert len(source.sha256) == 64
    assert make_targets([recording / "run.mcap"], "feat").recordings == (source,)


def test_saved_targets_come_back_and_equal_targets_are_equal_bytes(
    hybrid: Targets, tmp_path: Path
) -> None:
    hybrid.save(tmp_path / "a.npz")
    hybrid.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    loaded = Targets.load(tmp_path / "a.npz")
    assert isinstance(loaded.poses.images, np.memmap)
    for field in fields(Poses):
        np.testing.assert_array_equal(
            getattr(loaded.poses, field.name), getattr(hybrid.poses, field.name)
        )
    assert (loaded.recordings, loaded.metric) == (hybrid.recordings, "hybrid")
    assert (loaded.window, loaded.alpha) == (3, 0.25)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_existing_files_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    path.write_text("mine")
    with pytest.raises(UsageError, match=r"t\.npz exists"):
        make_targets_file(0).save(path)
    assert path.read_text() == "mine"


def test_two_recordings_are_told_apart(recording: Path, tmp_path: Path) -> None:
    other = _record(tmp_path / "other", SyntheticRun(triggers=4, seed=9, cameras=CAMERAS))
    seen: list[tuple[str, int, int]] = []
    both = make_targets([recording, other], "feat", 2, progress=lambda *at: seen.append(at))
    assert [source.name for source in both.recordings] == ["drive", "other"]
    assert both.poses.recording.tolist() == [0] * 8 + [1] * 3
    assert both.poses.drive.tolist() == [0] * 3 + [1] * 5 + [2] * 3
    assert seen[10] == ("drive", 11, 11)
    assert seen[-1] == ("other", 4, 4)


def test_recordings_that_finish_in_another_order_give_the_same_bytes(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = [
        _record(tmp_path / f"other-{k}", SyntheticRun(triggers=4, seed=k, cameras=CAMERAS))
        for k in (7, 8)
    ]
    recordings = [recording, *others]
    make_targets(recordings, "feat", 2).save(tmp_path / "one.npz")

    def last_first(work: Any, tasks: dict[str, Path], _: object) -> Iterator[tuple[str, Any]]:
        for name in reversed(tasks):
            yield name, work(tasks[name])

    monkeypatch.setattr(targets, "run_tasks", last_first)
    late = make_targets(recordings, "feat", 2, folder=tmp_path)
    assert isinstance(late.poses.images.base, np.memmap), "the pictures are not held in memory"
    late.save(tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


@dataclass
class _Sweep(SyntheticRun):
    def records(self):  # type: ignore[no-untyped-def]
        for record in super().records():
            yield replace(record, pose_index=record.trigger // 2)


def test_pictures_taken_standing_still_belong_to_one_pose(tmp_path: Path) -> None:
    sweep = _record(tmp_path / "sweep", _Sweep(triggers=6))
    poses = make_targets([sweep], "feat", 1).poses
    assert poses.images.shape[:2] == (2, 4)
    assert (poses.trigger.tolist(), poses.pose_index.tolist()) == ([0, 2], [0, 1])
    assert poses.target_gain_db[0] in poses.used_gain_db[1]
    lost = _record(tmp_path / "lost", _Sweep(triggers=10, lost={5: "timeout"}))
    assert make_targets([lost], "feat", 1).poses.trigger.tolist() == [0, 6]


def test_sweeps_and_pairs_do_not_share_a_file(tmp_path: Path, recording: Path) -> None:
    sweep = _record(tmp_path / "sweep", _Sweep(triggers=4))
    with pytest.raises(UsageError, match="drive has 2 pictures a pose and sweep has 4"):
        make_targets([recording, sweep], "feat")


def test_a_motion_is_recovered_and_a_wrong_one_is_as_wrong_as_it_is() -> None:
    rng = np.random.default_rng(4)
    lens = SyntheticRun().header.intrinsics.primary
    points_m = rng.uniform((-3, -2, 4), (3, 2, 12), (300, 3))
    words = rng.integers(0, 256, (300, 32)).astype(np.uint8)
    start = Truth((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0)
    half = 0.02
    end = Truth((0.1, 0.0, 0.5), (0.0, np.sin(half), 0.0, np.cos(half)), 1.0)

    def seen(truth: Truth) -> OrbFeatures:
        turn = Rotation.from_quat(truth.orientation_xyzw).as_matrix()
        there = (points_m - truth.position_m) @ turn
        pixels = there[:, :2] / there[:, 2:] * lens.fx_px + (lens.cx_px, lens.cy_px)
        analysed = (pixels + 0.5) * (512 / lens.width_px) - 0.5
        return OrbFeatures(analysed.astype(np.float32), words)

    a, b = seen(start), seen(end)
    assert pose_error_deg(a, b, lens, true_motion(start, end)) < 0.05
    unturned = replace(end, orientation_xyzw=start.orientation_xyzw)
    wrong = pose_error_deg(a, b, lens, true_motion(start, unturned))
    assert wrong == pytest.approx(2 * np.degrees(2 * half), abs=0.1)
    assert pose_error_deg(a, OrbFeatures(*_NONE), lens, true_motion(start, end)) == LOST_DEG


def test_pose_targets_need_true_poses(tmp_path: Path) -> None:
    class Blind(SyntheticRun):
        def records(self):  # type: ignore[no-untyped-def]
            for record in super().records():
                yield replace(record, truth=None)

    blind = _record(tmp_path / "blind", Blind(triggers=3))
    with pytest.raises(RecordingError, match="no true poses"):
        make_targets([blind], "pose")
    seen = _record(tmp_path / "seen", SyntheticRun(triggers=3))
    assert len(make_targets([seen], "pose", 1).poses) == 2


def test_recordings_without_two_pairs_in_a_row_are_refused(tmp_path: Path) -> None:
    lost: Mapping[int, str] = {1: "timeout", 3: "timeout"}
    holes = _record(tmp_path / "holes", SyntheticRun(triggers=4, lost=lost))
    with pytest.raises(RecordingError, match="holes: no two complete poses"):
        make_targets([holes], "feat")


def test_no_recordings_are_a_usage_error() -> None:
    with pytest.raises(UsageError, match="no recordings given"):
        make_targets([], "feat")


def test_files_that_are_no_targets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none\.npz: no such target file"):
        Targets.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no zip")
    with pytest.raises(RecordingError, match=r"text\.npz: not a target file"):
        Targets.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", header=np.array('{"schema": "rig.targets/9"}'))
    with pytest.raises(RecordingError, match=r"other\.npz: not a target file"):
        Targets.load(tmp_path / "other.npz")
    np.savez(tmp_path / "pickle.npz", header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(RecordingError, match=r"pickle\.npz: not a target file"):
        Targets.load(tmp_path / "pickle.npz")


def test_compressed_pictures_are_refused_not_misread(tmp_path: Path) -> None:
    make_targets_file(0, count=3).save(tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz") as plain:
        np.savez_compressed(tmp_path / "small.npz", **plain)
    with pytest.raises(RecordingError, match="not stored as plain uint8"):
        Targets.load(tmp_path / "small.npz")


def test_cut_files_are_refused(tmp_path: Path) -> None:
    make_targets_file(0, count=3).save(tmp_path / "whole.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:200_000])
    with pytest.raises(RecordingError, match=r"cut\.npz: not a target file"):
        Targets.load(tmp_path / "cut.npz")
