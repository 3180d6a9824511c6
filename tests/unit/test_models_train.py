from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from synthetic_targets import make_targets_file

from rig.core.errors import ModelError, UsageError
from rig.models.dataset import Samples
from rig.models.fit import Checkpoint, EpochLoss, Fit, Recipe, exposure_loss
from rig.models.networks import NETWORKS, Architecture, Stage
from rig.models.search import best_recipe
from rig.models.targets import Targets
from rig.models.train import train

TOY = Architecture(
    stages=(Stage(4, 5, 3), Stage(6, 3, 3), Stage(8, 3, 3), Stage(16, 7)),
    hidden=(16, 16, 8),
    parameters=16_000,
)
"""Small enough that hundreds of training steps fit into a test."""

RECIPE = Recipe("toy", seed=1, epochs=3, batch_size=8, learning_rate=1e-3)


@pytest.fixture(autouse=True)
def _toy_network(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    known = {**NETWORKS, "toy": TOY}
    monkeypatch.setattr("rig.models.networks.NETWORKS", known)
    monkeypatch.setattr("rig.models.card.NETWORKS", known)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def _quiet(_: object) -> None:
    pass


@pytest.fixture(scope="module")
def samples() -> Samples:
    targets = make_targets_file(1, count=5)
    return Samples([targets], frozenset(source.sha256 for source in targets.recordings))


@pytest.fixture(scope="module")
def none(samples: Samples) -> Samples:
    return Samples([make_targets_file(1, count=1)], frozenset())


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("targets")
    paths = [folder / "one.npz", folder / "two.npz"]
    for seed, path in enumerate(paths):
        make_targets_file(seed, count=5).save(path)
    return paths


def test_loss_is_equation_4_15() -> None:
    answers, targets = (
        torch.tensor([[0.5, 0.1], [0.2, 0.9]]),
        torch.tensor([[0.1, 0.1], [0.4, 0.3]]),
    )
    exposure, gain = (0.4 + 0.2) / 2, (0.0 + 0.6) / 2
    assert float(exposure_loss(answers, targets)) == pytest.approx(0.5 * gain + 0.5 * exposure)


def test_training_lowers_the_loss_on_what_it_has_seen(samples: Samples, none: Samples) -> None:
    with torch.random.fork_rng():
        fit = Fit(replace(RECIPE, epochs=25, learning_rate=3e-3))
        while not fit.finished:
            fit.epoch(samples, none, _quiet)
    losses = [loss.training for loss in fit.history]
    assert np.mean(losses[-5:]) < 0.7 * np.mean(losses[:2])
    assert fit.best_epoch == 24


def test_stops_without_progress_and_keeps_the_best_epoch(samples: Samples) -> None:
    away = make_targets_file(1, count=3)
    opposite = replace(
        away,
        poses=replace(
            away.poses,
            target_exposure_us=np.full(3, -3e6),
            target_gain_db=np.full(3, -3e3),
        ),
    )
    validation = Samples([opposite], frozenset(s.sha256 for s in opposite.recordings))
    with torch.random.fork_rng():
        fit = Fit(replace(RECIPE, epochs=50, patience=2, learning_rate=1e-2))
        weights = []
        while not fit.finished:
            fit.epoch(samples, validation, _quiet)
            weights.append(fit.state()["network"]["head.10.bias"].clone())
    scored = [loss.validation for loss in fit.history]
    assert len(fit.history) == fit.best_epoch + 3 < 50
    assert scored[fit.best_epoch] == min(scored)
    best = fit.best_network().state_dict()["head.10.bias"]
    assert torch.equal(best, weights[fit.best_epoch])
    assert not torch.equal(best, weights[-1])


def test_interrupted_training_ends_in_the_same_weights(samples: Samples, tmp_path: Path) -> None:
    def trained(interrupt: bool) -> Fit:
        fit = Fit(RECIPE)
        while not fit.finished:
            fit.epoch(samples, samples, _quiet)
            if interrupt:
                checkpoint = Checkpoint(tmp_path / "n.checkpoint", "same")
                checkpoint.save(fit)
                fit = Fit(RECIPE)
                checkpoint.resume(fit)
        return fit

    with torch.random.fork_rng():
        whole, resumed = trained(False), trained(True)
    assert whole.history == resumed.history
    assert whole.best_epoch == resumed.best_epoch
    weights = resumed.best_network().state_dict()
    for name, value in whole.best_network().state_dict().items():
        assert torch.equal(value, weights[name]), name


def test_checkpoints_of_other_trainings_are_refused(tmp_path: Path) -> None:
    with torch.random.fork_rng():
        fit = Fit(RECIPE)
        Checkpoint(tmp_path / "n.checkpoint", "mine").save(fit)
        with pytest.raises(ModelError, match="belongs to a training with other data"):
            Checkpoint(tmp_path / "n.checkpoint", "other").resume(fit)
        (tmp_path / "bad.checkpoint").write_bytes(b"no tensors")
        with pytest.raises(ModelError, match=r"bad\.checkpoint: not a checkpoint"):
            Checkpoint(tmp_path / "bad.checkpoint", "mine").resume(fit)
        Checkpoint(tmp_path / "absent.checkpoint", "mine").resume(fit)
    assert fit.history == []


def test_divergence_is_told(samples: Samples, none: Samples) -> None:
    broken = make_targets_file(1, count=3)
    poses = replace(broken.poses, target_gain_db=np.full(3, np.inf))
    training = Samples(
        [replace(broken, poses=poses)], frozenset(s.sha256 for s in broken.recordings)
    )
    with torch.random.fork_rng(), pytest.raises(ModelError, match="diverged in epoch 1"):
        Fit(RECIPE).epoch(training, none, _quiet)


def test_train_leaves_a_proven_network_and_its_card(files: list[Path], tmp_path: Path) -> None:
    seen = []
    out = tmp_path / "new" / "net.onnx"
    result = train(
        files, "toy", out,
        seed=1, epochs=12, batch_size=8, learning_rate=3e-3, patience=12, progress=seen.append,
    )  # fmt: skip
    assert sorted(path.name for path in out.parent.iterdir()) == ["net.md", "net.onnx", "net.svg"]
    assert "held back" in out.with_suffix(".svg").read_text()
    assert result.model == out
    assert result.parity.difference <= 1e-5
    assert result.parity.spread >= 0.01
    assert len(result.split.training) == len(result.split.held_back) == 1
    assert (result.training_samples, result.validation_samples) == (30, 30)
    assert len(result.history) == 12
    assert all(isinstance(loss, EpochLoss) and loss.validation for loss in result.history)
    assert [(now.epoch, now.batch, now.batches) for now in seen][-1] == (11, 3, 3)
    properties = {p.key: p.value for p in onnx.load(out).metadata_props}
    assert properties["training_sha256"] == result.training_sha256
    card = result.card.read_text()
    held_back = result.split.held_back[0].name
    assert "rig train --net toy one.npz two.npz --seed 1 --epochs 12" in card
    assert f"--hold-back {held_back} --out net.onnx" in card
    for source in (*result.split.training, *result.split.held_back):
        assert f"rig collect --cameras {shlex.quote(source.cameras)} --seed {source.seed}" in card
        assert source.sha256 in card
    assert "Not raced yet" in card
    assert "one aperture" in card
    assert "test world" not in card

    with pytest.raises(UsageError, match=r"net\.onnx exists"):
        train(files, "toy", out)


def test_a_card_keeps_recordings_of_one_name_apart(tmp_path: Path) -> None:
    paths = [tmp_path / "first.npz", tmp_path / "second.npz"]
    for seed, path in enumerate(paths):
        made = make_targets_file(seed, count=5)
        alike = tuple(replace(source, name="tunnel-1") for source in made.recordings)
        replace(made, recordings=alike).save(path)
    make_targets_file(2, count=5).save(tmp_path / "held.npz")
    held = make_targets_file(2, count=5).recordings[0].name
    card = train(
        [*paths, tmp_path / "held.npz"], "toy", tmp_path / "net.onnx",
        seed=1, epochs=12, batch_size=8, learning_rate=3e-3, held_back=(held,),
    ).card.read_text()  # fmt: skip
    for name in ("first", "second"):
        assert f"--out {name}/tunnel-1" in card
        assert f"rig targets {name}/tunnel-1 " in card
    assert f"--out {held}\n" in card


def test_a_card_names_a_recording_that_is_held_back_once(tmp_path: Path) -> None:
    paths = [tmp_path / "first.npz", tmp_path / "second.npz", tmp_path / "third.npz"]
    for seed, path in enumerate(paths):
        made = make_targets_file(seed, count=5)
        name = "tunnel-9" if seed else "tunnel-1"
        named = tuple(replace(source, name=name) for source in made.recordings)
        replace(made, recordings=named).save(path)
    out = tmp_path / "net.onnx"
    options = {"seed": 1, "epochs": 12, "batch_size": 8, "learning_rate": 3e-3}
    result = train(paths, "toy", out, held_back=("tunnel-9",), **options)
    assert len(result.split.held_back) == 2
    assert result.card.read_text().count("--hold-back tunnel-9") == 1


def test_a_search_keeps_the_best_of_what_it_drew(files: list[Path], tmp_path: Path) -> None:
    targets = [Targets.load(path) for path in files]
    worlds = [frozenset(source.sha256 for source in file.recordings) for file in targets]
    training, validation = (Samples(targets, world) for world in worlds)
    given, log = replace(RECIPE, epochs=2, learning_rate=1e-6), tmp_path / "net.search"
    best = best_recipe(given, 4, training, validation, log, _quiet)
    losses = dict(json.loads(line) for line in log.read_text().splitlines())
    assert len(losses) == 4
    assert losses[f"{best.learning_rate:g} {best.batch_size}"] == min(losses.values())

    def refuse(_now: object) -> None:
        raise AssertionError("a finished trial is not repeated")

    assert best_recipe(given, 4, training, validation, log, refuse) == best
    with pytest.raises(UsageError, match="a world to hold back"):
        best_recipe(given, 4, training, Samples(targets, frozenset()), log, _quiet)


def test_same_seed_same_file_and_resumed_file(files: list[Path], tmp_path: Path) -> None:
    options = {"seed": 2, "epochs": 12, "batch_size": 8, "learning_rate": 3e-3, "patience": 12}
    first = train(files, "toy", tmp_path / "a" / "n.onnx", **options)

    def interrupt(now) -> None:  # type: ignore[no-untyped-def]
        if now.epoch == 11:
            raise KeyboardInterrupt

    again = tmp_path / "b" / "n.onnx"
    with pytest.raises(KeyboardInterrupt):
        train(files, "toy", again, **options, progress=interrupt)
    assert [path.name for path in again.parent.iterdir()] == ["n.checkpoint"]
    with pytest.raises(ModelError, match="belongs to a training with other data or options"):
        train(files, "toy", again, **{**options, "seed": 3})
    seen = []
    train(files, "toy", again, **options, progress=seen.append)
    assert {now.epoch for now in seen} == {11}
    assert again.read_bytes() == first.model.read_bytes()


def test_test_worlds_are_named_on_the_card(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    make_targets_file(1, count=5, cameras="sim:tunnel?seed=1&split=test").save(path)
    result = train([path], "toy", tmp_path / "n.onnx", epochs=12, batch_size=8,
                   learning_rate=3e-3, half=True)  # fmt: skip
    card = result.card.read_text()
    assert "results on test worlds prove nothing" in card
    assert "there was only one world" in card
    assert "half precision moved answers" in card
    assert " --half " in card


def test_a_second_file_in_integers_and_its_loss_on_the_card(
    files: list[Path], tmp_path: Path
) -> None:
    options = {"epochs": 12, "batch_size": 8, "learning_rate": 3e-3, "int8": True}
    result = train(files, "toy", tmp_path / "n.onnx", **options)
    small = tmp_path / "n.int8.onnx"
    told, costs = result.parity.int8, result.costs
    assert told is not None and costs is not None
    assert [cost.size_bytes for cost in costs] == [
        path.stat().st_size for path in (result.model, small)
    ]
    card = result.card.read_text()
    assert " --int8 " in card
    assert f"`n.int8.onnx` | {costs[1].size_bytes:,} | {costs[1].forward.median_ms:.2f}" in card
    assert f"{told.mean:.1e} in the mean" in card and f"{told.largest:.1e} at most" in card
    result.model.unlink()
    with pytest.raises(UsageError, match=r"n\.int8\.onnx exists"):
        train(files, "toy", tmp_path / "n.onnx", **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"epochs": 0}, "--epochs must be at least 1"),
        ({"batch_size": 0}, "--batch-size"),
        ({"learning_rate": float("nan")}, "--learning-rate must be above 0"),
        ({"patience": 0}, "--patience"),
        ({"held_back": ["drive-9"]}, "did you mean 'drive-"),
        ({"net": "dual-smol"}, "did you mean 'dual-small'"),
        ({"out": Path("net.pt")}, r"--out must end in \.onnx"),
        ({"targets": []}, "no target files given"),
    ],
)
def test_bad_options_are_refused(
    options: dict[str, object], message: str, files: list[Path], tmp_path: Path
) -> None:
    usual = {"targets": files, "net": "toy", "out": tmp_path / "n.onnx"}
    with pytest.raises(UsageError, match=message):
        train(**{**usual, **options})  # type: ignore[arg-type]
