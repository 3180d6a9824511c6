from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from synthetic_targets import make_poses, make_source, make_targets_file

from rig.core.errors import UsageError
from rig.models.dataset import Samples, scale_settings
from rig.models.split import hold_back, world_of
from rig.models.targets import Poses, Targets


def _samples(*files: Targets) -> Samples:
    return Samples(files, frozenset(s.sha256 for file in files for s in file.recordings))


def _two_drives() -> Targets:
    drives = [make_poses(4, 1, recording=0, drive=0), make_poses(3, 2, recording=1, drive=1)]
    joined = {f.name: np.concatenate([getattr(d, f.name) for d in drives]) for f in fields(Poses)}
    return Targets("feat", 4, 0.5, (make_source(1), make_source(2)), Poses(**joined))


def test_settings_scale_to_the_limits() -> None:
    scaled = scale_settings(np.array([75.0, 30_000.0, 15_037.5]), np.array([0.0, 30.0, 15.0]))
    np.testing.assert_allclose(scaled, [[0, 0], [1, 1], [0.5, 0.5]])


def test_a_pose_gives_eight_samples_and_the_first_ones_fewer() -> None:
    assert len(_samples(make_targets_file(0, count=1))) == 2
    assert len(_samples(make_targets_file(0, count=2))) == 2 + 4
    assert len(_samples(make_targets_file(0, count=5))) == 2 + 4 + 3 * 8


def test_samples_are_the_frames_of_their_pose_newest_first() -> None:
    targets = _two_drives()
    samples, poses = _samples(targets), targets.poses
    batch = samples.batch(np.arange(len(samples)))
    assert batch.images.shape == (len(samples), 9, 224, 224)
    assert batch.images.dtype == np.uint8
    seen = {
        poses.images[pose, camera].tobytes(): (pose, camera)
        for pose in range(len(poses))
        for camera in range(2)
    }
    assert len(seen) == 2 * len(poses)
    used = scale_settings(poses.used_exposure_us, poses.used_gain_db)
    aim = scale_settings(poses.target_exposure_us, poses.target_gain_db)
    combinations = set()
    for row in range(len(samples)):
        frames = [seen[batch.images[row, 3 * k : 3 * k + 3].tobytes()] for k in range(3)]
        pose, start = frames[0][0], 4 * (frames[0][0] >= 4)
        assert [at for at, _ in frames] == [max(pose - back, start) for back in range(3)]
        expected = np.concatenate([used[frame] for frame in frames])
        np.testing.assert_array_equal(batch.settings[row], expected)
        np.testing.assert_array_equal(batch.targets[row], aim[pose])
        combinations.add(tuple(frames))
    assert len(combinations) == len(samples)


def test_only_the_wanted_recordings_give_samples() -> None:
    targets = _two_drives()
    second = Samples([targets], frozenset([make_source(2).sha256]))
    assert len(second) == 2 + 4 + 8
    batch = second.batch(np.array([0]))
    np.testing.assert_array_equal(batch.images[0, :3], targets.poses.images[4, 0])


def test_samples_of_several_files_are_gathered_in_the_order_asked() -> None:
    files = [make_targets_file(1, count=1), make_targets_file(2, count=1)]
    batch = _samples(*files).batch(np.array([3, 0]))
    np.testing.assert_array_equal(batch.images[0, :3], files[1].poses.images[0, 1])
    np.testing.assert_array_equal(batch.images[1, :3], files[0].poses.images[0, 0])


def test_batches_pass_over_every_sample_once() -> None:
    samples = _samples(make_targets_file(0, count=3))
    sizes = [len(batch.targets) for batch in samples.batches(5)]
    assert sizes == [5, 5, 4]


def test_worlds_are_held_back_whole() -> None:
    sources = [make_source(seed) for seed in range(10)]
    again = replace(sources[3], name="again", sha256="f" * 64,
                    cameras="sim:tunnel?seed=3&split=train&speed_mps=20")  # fmt: skip
    split = hold_back([*sources, again], (), seed=1)
    held = {world_of(source) for source in split.held_back}
    assert len(held) == 2
    assert held.isdisjoint(world_of(source) for source in split.training)
    assert len(split.training) + len(split.held_back) == 11
    assert hold_back([*sources, again], (), seed=1) == split
    drawn = [hold_back(sources, (), seed).held_back for seed in range(8)]
    assert any(held_back != drawn[0] for held_back in drawn)


@pytest.mark.parametrize(
    "cameras",
    [
        "sim:tunnel",
        "sim:tunnel?seed=0",
        "sim:tunnel?size=320x240&split=train",
        "gige:sim:tunnel?seed=0&split=train",
    ],
)
def test_a_world_is_one_however_it_is_spelled(cameras: str) -> None:
    assert world_of(make_source(0, cameras)) == "sim:tunnel?split=train&seed=0"


def test_a_single_world_is_not_held_back() -> None:
    assert hold_back([make_source(0)], (), 0).held_back == ()


def test_real_drives_are_worlds_of_their_own() -> None:
    a, b = make_source(0, "aravis:123,456"), make_source(1, "aravis:123,456")
    assert world_of(a) != world_of(b)


def test_recordings_can_be_held_back_by_name() -> None:
    sources = [make_source(seed) for seed in range(3)]
    assert hold_back(sources, ["drive-1"], 0).held_back == (sources[1],)
    with pytest.raises(UsageError, match=r"'drive_1'.*did you mean 'drive-"):
        hold_back(sources, ["drive_1"], 0)
    with pytest.raises(UsageError, match="every recording is held back"):
        hold_back(sources, ["drive-0", "drive-1", "drive-2"], 0)


def test_a_sweep_gives_up_to_25_samples_from_too_dark_to_too_bright() -> None:
    rng = np.random.default_rng(1)
    count, pictures = 4, 50
    exposure_us = np.tile(np.geomspace(75, 30_000, pictures), (count, 1))
    poses = replace(
        make_targets_file(0, count).poses,
        images=rng.integers(0, 256, (count, pictures, 3, 224, 224), np.uint8),
        used_exposure_us=exposure_us,
        used_gain_db=np.full((count, pictures), 10.0),
        target_exposure_us=np.full(count, 1_500.0),
        target_gain_db=np.full(count, 10.0),
    )
    samples = _samples(replace(make_targets_file(0, count), poses=poses))
    assert 20 * count < len(samples) <= 25 * count
    last = samples.batch(np.arange(len(samples) - 25, len(samples)))
    newest = 75 + 29_925 * last.settings[:, 0]
    assert newest.min() < 400 and newest.max() > 6_000
    assert np.median(newest) == pytest.approx(1_500, rel=0.5)
    assert len(np.unique(last.settings, axis=0)) == 25
