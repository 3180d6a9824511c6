"""Ways from steps, errors against the truth, and that evo reads our files and agrees."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.core.types import Intrinsics, Settings
from rig.drivers.registry import open_source
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.source import SimulatedSource
from rig.evaluation.front_ends import FRONT_ENDS
from rig.evaluation.odometry import (
    REFERENCE_AGE_MAX,
    Odometry,
    OdometryCounter,
    Step,
    Trajectory,
    accuracy,
    align,
    chain,
    failures,
    mean_inlier_pct,
    pose_matrix,
    processed_pct,
    quaternion_xyzw,
    write_tum,
)
from rig.vision.bayer import to_grey
from rig.vision.viso2.motion import Mount

Array = NDArray[np.float64]
EVO = Path(sys.executable).parent


def wavy(poses: int) -> Trajectory:
    """Return a drive through a bend, up and down a little."""
    t = np.arange(poses) * 0.3
    places = np.column_stack([t, 3 * np.sin(t / 4), 0.2 * np.cos(t)])
    turns = Rotation.from_euler("zyx", np.column_stack([t / 5, 0.1 * np.sin(t), 0.05 * t]))
    matrices = np.tile(np.eye(4), (poses, 1, 1))
    matrices[:, :3, :3] = turns.as_matrix()
    matrices[:, :3, 3] = places
    return Trajectory(np.arange(poses), matrices)


def drifting(truth: Trajectory, seed: int) -> Trajectory:
    """Return an estimate of a way: elsewhere, turned, at another scale, and with errors."""
    rng = np.random.default_rng(seed)
    moves = np.linalg.inv(truth.poses[:-1]) @ truth.poses[1:]
    poses = [pose_matrix((4.0, -2.0, 1.0), Rotation.from_euler("z", 0.7).as_quat())]
    for move in moves:
        error = np.eye(4)
        error[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix()
        error[:3, 3] = rng.normal(0, 0.02, 3)
        step = move @ error
        step[:3, 3] *= 0.6
        poses.append(poses[-1] @ step)
    return Trajectory(truth.triggers, np.array(poses))


def step(trigger: int, reference: int, transform: Array | None, failure: str = "") -> Step:
    return Step(trigger, reference, 50, 40, failure, transform)  # type: ignore[arg-type]


def ahead(metres: float) -> Array:
    move = np.eye(4)
    move[2, 3] = -metres
    return move


def test_steps_make_a_way_and_a_failure_leaves_a_hole() -> None:
    steps = [step(1, 0, ahead(1)), step(2, 1, None, "few inliers"), step(3, 1, ahead(3))]
    way = chain(steps)
    assert way.triggers.tolist() == [0, 1, 3]
    assert way.positions.tolist() == [[0, 0, 0], [0, 0, 1], [0, 0, 4]]


def test_a_reference_given_up_goes_on_from_where_the_way_was() -> None:
    way = chain([step(1, 0, ahead(1)), step(2, 1, None, "few matches"), step(3, 2, ahead(2))])
    assert way.triggers.tolist() == [0, 1, 2, 3]
    assert way.positions[:, 2].tolist() == [0, 1, 1, 3]
    assert len(chain([])) == 0


def test_alignment_undoes_what_was_done() -> None:
    truth = wavy(40).positions
    turn = Rotation.from_euler("xyz", (0.3, -0.2, 1.0)).as_matrix()
    scaled = (truth - (5.0, 2.0, 1.0)) @ turn / 3.0
    found = align(scaled, truth)
    assert found is not None
    scale, rotation, shift = found
    assert scale == pytest.approx(3.0)
    assert scale * scaled @ rotation.T + shift == pytest.approx(truth, abs=1e-9)
    assert align(np.zeros((5, 3)), truth[:5]) is None


def test_a_true_way_has_no_error_whatever_its_frame_and_scale() -> None:
    truth = wavy(30)
    poses = np.linalg.inv(truth.poses[0]) @ truth.poses
    poses[:, :3, 3] *= 0.25
    told = accuracy(Trajectory(truth.triggers, poses), truth)
    assert told is not None
    assert (told.ate_m, told.rpe_m, told.rpe_deg) == pytest.approx((0, 0, 0), abs=1e-5)
    assert told.scale == pytest.approx(4.0)
    assert told.poses == 30


def test_fewer_than_three_poses_and_a_camera_that_stood_have_no_error() -> None:
    truth = wavy(10)
    assert accuracy(wavy(2), truth) is None
    stood = Trajectory(truth.triggers, np.tile(np.eye(4), (10, 1, 1)))
    assert accuracy(stood, truth) is None
    assert accuracy(truth, stood) is None


@pytest.mark.parametrize("seed", range(4))
def test_quaternions_there_and_back(seed: int) -> None:
    rotation = Rotation.random(rng=np.random.default_rng(seed))
    told = quaternion_xyzw(rotation.as_matrix())
    assert told == pytest.approx(rotation.as_quat(canonical=True))
    assert pose_matrix((1, 2, 3), tuple(told))[:3, :3] == pytest.approx(rotation.as_matrix())


def evo(folder: Path, program: str, *arguments: str) -> dict[str, float]:
    """Run one of evo's programs on truth.tum and way.tum; return its statistics."""
    results = folder / f"{program}-{len(list(folder.iterdir()))}.zip"
    command = [EVO / program, "tum", "truth.tum", "way.tum", *arguments, "--save_results", results]
    environment = {**os.environ, "HOME": str(folder), "MPLBACKEND": "Agg"}
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    with zipfile.ZipFile(results) as archive:
        statistics: dict[str, float] = json.loads(archive.read("stats.json"))
    return statistics


def test_evo_reads_the_files_and_finds_the_same_errors(tmp_path: Path) -> None:
    if not (EVO / "evo_ape").is_file():
        pytest.skip("evo is not installed")
    truth = wavy(60)
    way = drifting(truth, seed=0).only([t for t in range(60) if t % 9 != 4])
    times_s = {trigger: 0.1 * trigger for trigger in range(60)}
    write_tum(tmp_path / "truth.tum", times_s, truth)
    write_tum(tmp_path / "way.tum", times_s, way)
    told = accuracy(way, truth)
    assert told is not None
    every_pose = ("--align", "--correct_scale", "--delta", "1", "--delta_unit", "f")
    ape = evo(tmp_path, "evo_ape", "--align", "--correct_scale")
    assert told.ate_m == pytest.approx(ape["rmse"], rel=1e-5)
    rpe = evo(tmp_path, "evo_rpe", *every_pose, "--pose_relation", "trans_part")
    assert told.rpe_m == pytest.approx(rpe["rmse"], rel=1e-5)
    turned = evo(tmp_path, "evo_rpe", *every_pose, "--pose_relation", "angle_deg")
    assert told.rpe_deg == pytest.approx(turned["rmse"], rel=1e-4)


def test_the_shares_of_table_5_5() -> None:
    steps = [step(1, 0, ahead(1)), step(2, 1, None, "few matches"), step(3, 1, ahead(1)),
             step(4, 3, None, "too little motion")]  # fmt: skip
    assert processed_pct(steps) == 50.0
    assert mean_inlier_pct(steps) == 40.0
    assert failures(steps) == {"few matches": 1, "too little motion": 1}
    assert processed_pct([]) is None
    assert mean_inlier_pct([]) is None
    assert Odometry(tuple(steps), wavy(5)).way(since=2).triggers.tolist() == [1, 3]
    told = Odometry(tuple(steps), wavy(5)).as_json(since=2)
    assert (told["frames"], told["frames_lost"]) == (3, 2)


@dataclass
class ScriptedFrontEnd:
    """Stands for the front end: a picture is its trigger, and some triggers tell no motion."""

    blind: set[int]
    asked: list[tuple[int, int]] = field(default_factory=list)

    def features(self, grey: NDArray[np.uint8]) -> int:
        return int(grey[0, 0])

    def matched(self, a: int, b: int) -> Any:
        return (a, b)

    def judged(self, points: Any) -> Any:
        return type("Judged", (), {"inliers": 100 * points[0] + points[1]})

    def bucket(self, points: Any) -> Any:
        return points

    def motion(self, points: tuple[int, int], intrinsics: Intrinsics, mount: Mount) -> Any:
        self.asked.append(points)
        lost = points[1] in self.blind
        told = {"failure": "few matches" if lost else "", "inliers": 1}
        return type("Motion", (), {**told, "transform": None if lost else ahead(1)})


def follow(front_end: ScriptedFrontEnd, triggers: list[int]) -> tuple[OdometryCounter, list[float]]:
    lens = Intrinsics(8, 8, 8.0, 8.0, 3.5, 3.5)
    counter = OdometryCounter(front_end, lens, Mount())  # type: ignore[arg-type]
    return counter, [counter.count(k, np.full((8, 8), k, np.uint8)) for k in triggers]


def test_after_a_failure_the_older_picture_stays_the_reference() -> None:
    front_end = ScriptedFrontEnd(blind={2, 3})
    counter, counts = follow(front_end, [0, 1, 2, 3, 4, 5])
    assert front_end.asked == [(0, 1), (1, 2), (1, 3), (1, 4), (4, 5)]
    assert counts[1:] == [1, 102, 203, 304, 405], "inliers are of neighbours all the same"
    assert [s.reference for s in counter.steps] == [0, 1, 1, 1, 4]
    assert [s.failure for s in counter.steps] == ["", "few matches", "few matches", "", ""]


def test_a_lost_frame_takes_a_count_and_no_step_of_the_way() -> None:
    front_end = ScriptedFrontEnd(blind=set())
    _, counts = follow(front_end, [0, 1, 3, 4])
    assert np.isnan(counts).tolist() == [True, False, True, False]
    assert front_end.asked == [(0, 1), (1, 3), (3, 4)]


def test_a_reference_too_old_is_given_up() -> None:
    front_end = ScriptedFrontEnd(blind=set(range(2, 30)))
    follow(front_end, list(range(REFERENCE_AGE_MAX + 4)))
    references = [pair[0] for pair in front_end.asked]
    assert references == [0, *[1] * REFERENCE_AGE_MAX, *[REFERENCE_AGE_MAX + 1] * 2]


@pytest.mark.heavy
def test_odometry_tells_the_way_out_of_the_simulated_tunnel() -> None:
    settings = Settings(8_000.0, 10.0)  # what the underpass asks for: docs/decisions/0010
    with closing(open_source("sim:tunnel?size=640x480", seed=0, split="test")) as source:
        assert isinstance(source, SimulatedSource)
        lens = source.scene.intrinsics("primary")
        sensor = Sensor(source.drive.model, (lens.height_px, lens.width_px), seed=0)
        counter = FRONT_ENDS["viso2"].counter(lens)
        assert isinstance(counter, OdometryCounter)
        poses = []
        for trigger in range(40, 65):
            view = source.scene.view("primary", source.drive.scene_time_s(trigger))
            raw = sensor.develop(view.exposed(8_000.0), settings, trigger)
            counter.count(trigger, to_grey(raw, source.drive.model.picture.format))
            truth = source.truth(trigger)
            poses.append(pose_matrix(truth.position_m, truth.orientation_xyzw))
    true = Trajectory(np.arange(40, 65), np.array(poses))
    told = accuracy(chain(counter.steps), true)
    assert told is not None
    assert told.poses == 25
    assert told.ate_m < 0.01 * np.linalg.norm(np.diff(true.positions, axis=0), axis=1).sum()
    assert 0.85 < told.scale < 1.1
