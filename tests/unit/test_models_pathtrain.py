"""A score map learns, resumes to the same bytes, is exported as it was, and drives a camera."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from synthetic_drives import GRID, make_drive, worth_of

from rig.cli.main import run
from rig.controllers.network import NetworkController
from rig.core.errors import ModelError, RecordingError, UsageError
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.models.dataset import scale_settings
from rig.models.fit import Checkpoint
from rig.models.scoremap.closed_loop import LIGHT_POSES, Chances, NetworkCars, Score, scores
from rig.models.scoremap.fit import PathFit, PathRecipe, StageResult, make_recipe
from rig.models.scoremap.grid import brightness_ev
from rig.models.scoremap.lessons import Lessons, gather
from rig.models.scoremap.network import ScoreMapEnsemble, ScoreMapNetwork
from rig.models.scoremap.paths import DriveSource, PathTargets
from rig.models.scoremap.rollout import Journey, Trip, roll_out
from rig.models.scoremap.seen import SeenDrive
from rig.models.scoremap.train import train_paths
from rig.models.scoremap.values import (
    UTILITIES,
    Utility,
    kept_share,
    kept_share_at_exits,
    move_values,
)

QUICK = PathRecipe(
    steps=(120, 40),
    learning_rates=(5e-3, 2e-3),
    batch_size=32,
    behaviours=2,
    own_journeys=2,
    chances=Chances(latencies=(0, 2), relit=0.3),
)


def source(drive: SeenDrive) -> DriveSource:
    name, poses = drive.cameras.removeprefix("sim:"), len(drive.thumbnails)
    return DriveSource(name, "0", drive.cameras, drive.world_version, drive.first_pose, poses)


def save(path: Path, seeds: range) -> Path:
    drives = tuple(make_drive(seed) for seed in seeds)
    sources = tuple(map(source, drives))
    PathTargets(GRID, drives, sources).save(path)
    return path


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    out = folder / "map.onnx"
    result = train_paths([save(folder / "paths.npz", range(5))], "map-small", out, QUICK)
    assert len(result.split.held_back) == 1
    assert result.parity.difference < 1e-5
    return out


def test_members_answer_together_by_the_mean_of_their_probabilities(tmp_path: Path) -> None:
    quick = replace(QUICK, steps=(12,), learning_rates=(5e-3,), behaviours=1)
    quick = replace(quick, utility=replace(UTILITIES["viso2"], discount=0.5, lost_cost=0.0))
    paths = [save(tmp_path / "paths.npz", range(3))]
    result = train_paths(paths, "map-small", tmp_path / "two.onnx", quick, members=2)
    assert [member.seed for member in result.members] == [0, 1]
    assert result.parity.difference < 1e-5 and len(result.together) == 1
    card = result.card.read_text()
    assert "--front-end viso2 --discount 0.5 --lost-cost 0 --members 2" in card
    assert "for viso2-style matching alone" in card
    with torch.inference_mode():
        networks = [ScoreMapNetwork(GRID).eval() for _ in range(3)]
        images, settings = torch.rand(4, 6, 48, 64), torch.rand(4, 8)
        shares = [torch.softmax(one.scores(images, settings), 1) for one in networks]
        together = ScoreMapEnsemble(networks)(images, settings)
        expected = networks[0].decode(torch.log(sum(shares) / 3), settings)
    assert torch.allclose(together, expected, atol=1e-6)


@pytest.mark.parametrize("objective", ["values", "best"])
def test_it_learns_to_follow_the_light(objective: str) -> None:
    recipe = replace(QUICK, steps=(160, 40), objective=objective, utility=UTILITIES["orb"])
    fit = PathFit(recipe, GRID, [make_drive(seed) for seed in range(4)], [make_drive(9)])
    standing = scores(lambda _pose, _frames, used: used, [make_drive(9)], GRID)[0]
    losses: list[float] = []
    while not fit.finished:
        fit.stage(lambda _stage, _step, _steps, loss: losses.append(loss))
    reached = fit.history[fit.best_stage].held_back[0]
    assert losses[-1] < 0.9 * losses[0]
    assert reached.median > standing.median + 100
    assert reached.median > 300
    assert fit.history[-1].late == tuple(scores(NetworkCars(fit.network), [make_drive(9)], GRID, 2))


def test_a_stage_is_worth_more_for_either_front_end_and_for_its_worst_pair() -> None:
    def worth(*score: float) -> float:
        return StageResult(1.0, (Score(500.0, 30.0, 350.0, 40.0), Score(*score))).worth("both")

    usual = worth(500.0, 30.0, 350.0, 40.0)
    gains = [worth(550, 30, 350, 40), worth(500, 33, 350, 40)]
    gains += [worth(500, 30, 385, 40), worth(500, 30, 350, 44)]
    assert min(gains) > usual
    assert worth(500, 60, 350, 40) > worth(550, 30, 350, 40)
    assert worth(500, 30, 350, 80) > worth(500, 30, 385, 40)


def test_a_lesson_for_one_front_end_ignores_the_other() -> None:
    few_or_many = np.array([5.0, 500.0], np.float32)
    for front_end, cares_for_orb in (("orb", True), ("viso2", False)):
        recipe = make_recipe("map-small", 0, front_end=front_end)
        of_orb = float(np.ptp(recipe.utility.of(few_or_many)))
        of_viso2 = float(np.ptp(recipe.utility.of_other(few_or_many, few_or_many)))
        assert recipe.utility.front_end == front_end
        assert (of_orb > 0) is cares_for_orb and (of_viso2 > 0) is not cares_for_orb
        better_orb = Score(600, 40, 300, 30).worth(front_end)
        better_viso2 = Score(500, 30, 400, 40).worth(front_end)
        assert (better_orb > better_viso2) is cares_for_orb
    assert make_recipe("map-small", 0).utility == Utility() and Utility().front_end == "both"
    with pytest.raises(UsageError, match="--front-end must be one of both, orb, viso2, got sift"):
        make_recipe("map-small", 0, front_end="sift")


def test_what_follows_and_a_motion_lost_can_be_weighed() -> None:
    assert make_recipe("map-small", 0, discount=0.0, lost_cost=1.0).utility == Utility(
        discount=0.0, lost_cost=1.0
    )
    assert make_recipe("map-small", 0, front_end="viso2").utility.lost_cost == 2
    with pytest.raises(UsageError, match=r"discount must be in \[0, 1\), got 1"):
        make_recipe("map-small", 0, discount=1.0)
    with pytest.raises(UsageError, match="--lost-cost must be at least 0, got -1"):
        make_recipe("map-small", 0, lost_cost=-1.0)
    with pytest.raises(UsageError, match="does not go with orb alone"):
        make_recipe("map-small", 0, front_end="orb", lost_cost=1.0)


def test_the_answer_lies_around_the_best_cells() -> None:
    network = ScoreMapNetwork(GRID).eval()
    peaks = torch.full((1, len(GRID)), -20.0)
    peaks[0, [2 * 4 + 1, 3 * 4 + 1]] = 5.0
    peaks[0, 8 * 4 + 3] = 5.1  # a single high cell, but less in all
    answer = network.decode(peaks, torch.zeros(1, 8))[0].detach().numpy()
    cells = GRID.cells()[[2 * 4 + 1, 3 * 4 + 1]]
    exposure_us = 75 + answer[0] * 29_925
    assert exposure_us == pytest.approx(np.sqrt(cells[0, 0] * cells[1, 0]), rel=1e-3)
    assert answer[1] * 30 == pytest.approx(cells[0, 1], rel=1e-3)


def test_smoothing_keeps_a_share_of_what_was_asked_for() -> None:
    scored = torch.zeros(1, len(GRID))
    told = torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]])
    free = ScoreMapNetwork(GRID).decode(scored, told)
    half = ScoreMapNetwork(GRID, smoothing=0.5).decode(scored, told)
    assert half[0, 1] == pytest.approx((free[0, 1] + 1) / 2)


def test_a_lesson_is_about_the_frame_that_a_command_reaches() -> None:
    drive = make_drive(3)
    lessons = Lessons([drive], GRID, Utility())
    cells = np.random.default_rng(4).integers(0, len(GRID), 40)
    used = GRID.cells()[cells]
    frames = drive.thumbnails[np.arange(40), cells]
    worth = worth_of(drive.moves, drive.steady, Utility(), drive.told)
    worth = move_values(worth, Utility().discount)
    for late in (0, 2):
        samples = gather([Journey(Trip(0, late), frames, used)], lessons)
        assert len(samples) == 39 - late
        pose = np.arange(39 - late)
        expected = worth[pose + late, cells[pose + late]]
        images, settings, values = samples.batch(torch.arange(39 - late))
        assert np.allclose(values.numpy(), expected, atol=1e-4)
        assert np.allclose(images[7, 0].numpy(), frames[7, 0] / 255)
        told = settings[7].reshape(4, 2).numpy()
        assert np.allclose(told[:3], scale_settings(*used[[7, 6, 5]].T), atol=1e-6)
        assert np.allclose(told[3], scale_settings(*used[[7 + late]].T)[0], atol=1e-6)


def test_a_change_from_between_cells_is_as_large_as_it_is() -> None:
    drive = make_drive(3)
    rich = replace(drive, steady=np.full_like(drive.steady, 300))
    utility = Utility(log_weight=0.0, fear=0.0, opposed_cost=0.0, discount=0.0)
    between = np.tile(np.sqrt(GRID.cells()[12] * GRID.cells()[12 + GRID.shape[1]]), (40, 1))
    values = Lessons([rich], GRID, utility).of(Journey(Trip(0), drive.thumbnails[:, 12], between))
    apart_ev = np.abs(brightness_ev(between[:1]) - brightness_ev(GRID.cells()))
    usual, at_exits = (300 * share(apart_ev) for share in (kept_share, kept_share_at_exits))
    wanted = utility.of_other(usual.astype(np.float32), at_exits.astype(np.float32))
    assert values[5] == pytest.approx(wanted, abs=1e-3)


def test_no_lesson_knows_that_the_light_will_change() -> None:
    drive = make_drive(3)
    lessons = Lessons([drive], GRID, Utility())
    used = np.tile(GRID.cells()[13], (40, 1))
    light = np.where(np.arange(40) < 20, 0, 2)
    late = 1
    stepped = lessons.of(Journey(Trip(0, late, light), drive.thumbnails[:, 13], used))
    before, after = (
        lessons.of(Journey(Trip(0, late, np.array([steps])), drive.thumbnails[:, 13], used))
        for steps in (0, 2)
    )
    assert np.array_equal(stepped[:20], before[:20])
    assert np.array_equal(stepped[20:], after[20:])
    assert not np.array_equal(before[19], after[19])


def test_trips_are_as_likely_late_and_relit_as_asked_for() -> None:
    rng = np.random.default_rng(0)
    chances = Chances(latencies=(0, 2), relit=0.5, darkest=-1, brightest=2)
    trips = [chances.trip(5, 100, rng) for _ in range(400)]
    assert {trip.drive for trip in trips} == {5}
    assert {trip.latency for trip in trips} == {0, 2}
    assert sum(trip.latency == 2 for trip in trips) == pytest.approx(200, abs=50)
    relit = [trip for trip in trips if len(trip.light) > 1]
    assert len(relit) == pytest.approx(200, abs=50)
    assert {int(steps) for trip in relit for steps in trip.light} == {-1, 0, 1, 2}
    assert {len(trip.light) for trip in relit} == {100}
    levels = np.stack([trip.light for trip in relit])
    assert np.mean(levels == 0) == pytest.approx(0.5 + 0.5 / 4, abs=0.1)
    changes = [np.flatnonzero(np.diff(one)) for one in levels]
    assert {int(gap) % LIGHT_POSES for one in changes for gap in np.diff(one)} == {0}


def test_cars_are_told_what_they_asked_for_last() -> None:
    network, told = ScoreMapNetwork(GRID).eval(), []
    network.register_forward_pre_hook(lambda _network, inputs: told.append(inputs[1].numpy()))
    start = np.array([[1_000.0, 0.0]])
    trip = Trip(0, latency=2)
    journey = roll_out([make_drive(1)], GRID, [trip], start, NetworkCars(network))[0]
    for pose in (0, 1, 10):
        assert np.allclose(told[pose][0, 6:], scale_settings(*journey.used[[pose + 2]].T)[0])
        assert np.allclose(told[pose][0, :2], scale_settings(*journey.used[[pose]].T)[0])


def test_the_file_drives_as_the_network_does(trained: Path) -> None:
    controller = NetworkController(trained)
    controller.reset(THESIS_LIMITS)
    image = np.full((96, 128), 40, np.uint8)
    dark = controller.step(Frame(image, "bayer_rggb8", 0, 0, 0, Settings(1_000.0, 0.0)))
    controller.reset(THESIS_LIMITS)
    bright = controller.step(
        Frame(np.full_like(image, 255), "bayer_rggb8", 0, 0, 0, Settings(1_000.0, 0.0))
    )
    assert isinstance(dark, Settings) and isinstance(bright, Settings)
    gained = dark.exposure_us * 10 ** (dark.gain_db / 20)
    assert gained > 2 * bright.exposure_us * 10 ** (bright.gain_db / 20)
    card = trained.with_suffix(".md").read_text()
    late = ("Settings took effect 0, 2 frames late", "In 30 %", "the same, 2 frames late")
    for words in (
        "map-small",
        "rig targets",
        "--hold-back",
        "(kept)",
        "seed=3",
        "--steps 120 --steps 40",
        *late,
    ):
        assert words in card


def test_the_card_makes_drives_of_other_lengths_by_other_commands(tmp_path: Path) -> None:
    short = make_drive(0, poses=30)
    whole = save(tmp_path / "long.npz", range(1, 3))
    PathTargets(GRID, (short,), (source(short),)).save(tmp_path / "short.npz")
    result = train_paths([whole, tmp_path / "short.npz"], "map-small", tmp_path / "m.onnx", QUICK)
    made = result.card.read_text().split("```")[1]
    assert "'sim:tunnel?seed=0' --metric path --frames 30 --out paths-30.npz" in made
    assert made.count("sim:tunnel?seed=0'") == 1
    assert "--frames 40 --out paths-40.npz" in made
    assert "map-small paths-30.npz paths-40.npz " in made


def test_the_card_makes_stretches_by_other_commands(tmp_path: Path) -> None:
    stretch = replace(make_drive(0, poses=30), first_pose=160)
    whole = save(tmp_path / "whole.npz", range(1, 3))
    PathTargets(GRID, (stretch,), (source(stretch),)).save(tmp_path / "stretch.npz")
    result = train_paths([whole, tmp_path / "stretch.npz"], "map-small", tmp_path / "m.onnx", QUICK)
    card = result.card.read_text()
    assert "--metric path --first 160 --frames 30 --out paths-160-30.npz" in card
    assert "map-small paths-40.npz paths-160-30.npz " in card
    assert "30 poses from 160 on" in card


def test_an_interrupted_training_keeps_a_checkpoint_of_its_own(tmp_path: Path) -> None:
    paths = save(tmp_path / "paths.npz", range(2))

    def interrupt(_member: int, stage: int, step: int, _steps: int, _loss: float) -> None:
        if (stage, step) == (1, 3):
            raise KeyboardInterrupt

    out = tmp_path / "map.onnx"
    with pytest.raises(KeyboardInterrupt):
        train_paths([paths], "map-small", out, QUICK, progress=interrupt)
    assert not out.exists() and out.with_suffix(".checkpoint").exists()
    with pytest.raises(ModelError, match="other data or options"):
        train_paths([paths], "map-small", out, PathRecipe(seed=1))


def test_a_training_that_goes_on_ends_in_the_same_weights(tmp_path: Path) -> None:
    drives = [make_drive(0), make_drive(1)]
    whole, first, second = (PathFit(QUICK, GRID, drives, [make_drive(2)]) for _ in range(3))
    checkpoint = Checkpoint(tmp_path / "kept", "this one")

    def quiet(_stage: int, _step: int, _steps: int, _loss: float) -> None: ...

    first.stage(quiet)
    checkpoint.save(first)
    checkpoint.resume(second)
    second.stage(quiet)
    while not whole.finished:
        whole.stage(quiet)
    assert second.finished and second.history == whole.history
    for a, b in zip(
        whole.best_network().parameters(), second.best_network().parameters(), strict=True
    ):
        assert torch.equal(a, b)


def test_a_training_goes_on_from_an_exported_network(trained: Path, tmp_path: Path) -> None:
    still = replace(QUICK, steps=(1,), learning_rates=(1e-9,))
    out, paths = tmp_path / "second.onnx", [save(tmp_path / "paths.npz", range(5))]
    result = train_paths(paths, "map-small", out, still, begin_with=trained)
    before, after = (onnxruntime.InferenceSession(file) for file in (trained, out))
    drives = [make_drive(seed) for seed in range(2)]
    fit = PathFit(QUICK, GRID, drives, [])
    shown = dict(zip(("images", "settings"), fit.proof_samples(50), strict=True))
    apart = np.abs(before.run(None, shown)[0] - after.run(None, shown)[0]).max(1)
    assert np.median(apart) < 0.02
    card = result.card.read_text()
    assert "--learning-rate 1e-09" in card and "--begin-with map.onnx" in card
    assert hashlib.sha256(trained.read_bytes()).hexdigest() in card
    fit.begin_with(trained)
    with torch.inference_mode():
        images, settings = (torch.from_numpy(of) for of in shown.values())
        again = fit.network(images, settings).numpy()
    assert np.allclose(again, before.run(None, shown)[0], atol=1e-4)


def test_only_a_score_map_of_its_kind_can_be_begun_with(trained: Path, tmp_path: Path) -> None:
    paths, out = [save(tmp_path / "paths.npz", range(3))], tmp_path / "next.onnx"
    text = tmp_path / "text.onnx"
    text.write_text("no")
    with pytest.raises(ModelError, match="not a score map of this kind"):
        train_paths(paths, "map-large", out, replace(QUICK, width=2), begin_with=trained)
    with pytest.raises(ModelError, match="no network to begin with"):
        train_paths(paths, "map-small", out, QUICK, begin_with=text)
    with pytest.raises(UsageError, match="no such file"):
        train_paths(paths, "map-small", out, QUICK, begin_with=tmp_path / "missing.onnx")
    assert not out.exists()


def test_targets_come_back_as_they_were_saved(tmp_path: Path) -> None:
    path = save(tmp_path / "paths.npz", range(2))
    loaded = PathTargets.load(path)
    assert loaded.grid == GRID
    assert np.array_equal(loaded.drives[1].moves, make_drive(1).moves)
    assert np.array_equal(loaded.drives[1].steady, make_drive(1).steady)
    assert np.array_equal(loaded.drives[1].told, make_drive(1).told)
    assert np.array_equal(loaded.drives[1].thumbnails, make_drive(1).thumbnails)
    with pytest.raises(UsageError, match="exists"):
        loaded.save(path)


def test_what_is_no_path_file_is_refused(tmp_path: Path) -> None:
    text, other = tmp_path / "a.npz", tmp_path / "b.npz"
    text.write_text("no")
    np.savez(other, header=np.array("{}"))
    for path, complaint in ((text, "not a file of path targets"), (other, "schema is None")):
        with pytest.raises(RecordingError, match=complaint):
            PathTargets.load(path)
    with pytest.raises(RecordingError, match="no such target file"):
        PathTargets.load(tmp_path / "missing.npz")


def test_options_of_the_other_kind_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "x.onnx")]
    assert run(["train", "p.npz", "--net", "map-small", "--epochs", "3", *out]) == 2
    assert "--epochs does not go with --net map-small" in capsys.readouterr().err
    assert run(["train", "p.npz", "--net", "map-small", "--int8", *out]) == 2
    assert "--int8 does not go with --net map-small" in capsys.readouterr().err
    assert run(["train", "p.npz", "--net", "dual-small", "--steps", "3", *out]) == 2
    assert "--steps does not go with --net dual-small" in capsys.readouterr().err
    assert run(["train", "p.npz", "--net", "dual-small", "--front-end", "orb", *out]) == 2
    assert "--front-end does not go with --net dual-small" in capsys.readouterr().err
    assert run(["train", "p.npz", "--net", "dual-small", "--discount", "0", *out]) == 2
    assert "--discount does not go with --net dual-small" in capsys.readouterr().err
    assert run(["train", "p.npz", "--net", "map-small", "--front-end", "sift", *out]) == 2
    assert "--front-end must be one of both, orb, viso2" in capsys.readouterr().err
    for command, complaint in (
        (["targets", "sim:tunnel"], "--metric path"),
        (["targets", "drive", "--seeds", "1-2"], "simulated cameras only"),
        (["targets", "sim:tunnel", "--seeds", "1,1", "--metric", "path"], "named twice"),
    ):
        assert run([*command, "--out", str(tmp_path / "t.npz")]) == 2
        assert complaint in capsys.readouterr().err


def test_a_recipe_out_of_range_is_refused() -> None:
    assert make_recipe("map-small", 0, (5, 5)).learning_rates == (2e-3, 1.5e-3)
    for options in ({"steps": (0,)}, {"learning_rate": 0.0}, {"batch_size": 1}):
        with pytest.raises(UsageError):
            make_recipe("map-small", 0, **options)  # type: ignore[arg-type]
