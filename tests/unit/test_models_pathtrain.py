"""A score map learns, resumes to the same bytes, is exported as it was, and drives a camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic_drives import GRID, make_drive

from rig.cli.main import run
from rig.controllers.network import NetworkController
from rig.core.errors import ModelError, RecordingError, UsageError
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.models.cars import NetworkCars, scores
from rig.models.fit import Checkpoint
from rig.models.pathfit import PathFit, PathRecipe, make_recipe
from rig.models.paths import DriveSource, PathTargets
from rig.models.pathtrain import train_paths
from rig.models.scoremap import ScoreMapEnsemble, ScoreMapNetwork

QUICK = PathRecipe(steps=(60, 20), learning_rates=(5e-3, 2e-3), batch_size=32, behaviours=2)


def save(path: Path, seeds: range) -> Path:
    drives = tuple(make_drive(seed) for seed in seeds)
    sources = tuple(
        DriveSource(f"tunnel?seed={seed}", f"{seed}", drive.cameras, drive.world_version)
        for seed, drive in zip(seeds, drives, strict=True)
    )
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
    quick = replace(QUICK, steps=(4,), learning_rates=(5e-3,), behaviours=1)
    paths = [save(tmp_path / "paths.npz", range(3))]
    result = train_paths(paths, "map-small", tmp_path / "two.onnx", quick, members=2)
    assert [member.seed for member in result.members] == [0, 1]
    assert result.parity.difference < 1e-5 and len(result.together) == 1
    assert "--members 2" in result.card.read_text()
    with torch.inference_mode():
        networks = [ScoreMapNetwork(GRID).eval() for _ in range(3)]
        images, settings = torch.rand(4, 6, 48, 64), torch.rand(4, 6)
        shares = [torch.softmax(one.scores(images, settings), 1) for one in networks]
        together = ScoreMapEnsemble(networks)(images, settings)
        expected = networks[0].decode(torch.log(sum(shares) / 3), settings)
    assert torch.allclose(together, expected, atol=1e-6)


@pytest.mark.parametrize("objective", ["values", "best"])
def test_it_learns_to_follow_the_light(objective: str) -> None:
    recipe = replace(QUICK, objective=objective)
    fit = PathFit(recipe, GRID, [make_drive(seed) for seed in range(4)], [make_drive(9)])
    before = scores(NetworkCars(fit.network), [make_drive(9)], GRID)[0]
    losses: list[float] = []
    while not fit.finished:
        fit.stage(lambda _stage, _step, _steps, loss: losses.append(loss))
    reached = fit.history[fit.best_stage].held_back[0]
    assert losses[-1] < 0.9 * losses[0]
    assert reached.median > before.median + 100
    assert reached.median > 300


def test_the_answer_lies_around_the_best_cells() -> None:
    network = ScoreMapNetwork(GRID).eval()
    peaks = torch.full((1, len(GRID)), -20.0)
    peaks[0, [2 * 4 + 1, 3 * 4 + 1]] = 5.0
    peaks[0, 8 * 4 + 3] = 5.1  # a single high cell, but less in all
    answer = network.decode(peaks, torch.zeros(1, 6))[0].detach().numpy()
    cells = GRID.cells()[[2 * 4 + 1, 3 * 4 + 1]]
    exposure_us = 75 + answer[0] * 29_925
    assert exposure_us == pytest.approx(np.sqrt(cells[0, 0] * cells[1, 0]), rel=1e-3)
    assert answer[1] * 30 == pytest.approx(cells[0, 1], rel=1e-3)


def test_smoothing_keeps_a_share_of_the_present_settings() -> None:
    scored = torch.zeros(1, len(GRID))
    now = torch.tensor([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    free = ScoreMapNetwork(GRID).decode(scored, now)
    half = ScoreMapNetwork(GRID, smoothing=0.5).decode(scored, now)
    assert half[0, 1] == pytest.approx((free[0, 1] + 1) / 2)


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
    for words in ("map-small", "rig targets", "--hold-back", "(kept)", "seed=3"):
        assert words in card


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


def test_targets_come_back_as_they_were_saved(tmp_path: Path) -> None:
    path = save(tmp_path / "paths.npz", range(2))
    loaded = PathTargets.load(path)
    assert loaded.grid == GRID
    assert np.array_equal(loaded.drives[1].moves, make_drive(1).moves)
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
    assert run(["train", "p.npz", "--net", "dual-small", "--steps", "3", *out]) == 2
    assert "--steps does not go with --net dual-small" in capsys.readouterr().err
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
