"""From target files to a shipped network: L1 loss, Adam, flips, early stopping, proof, card."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from rig.core.errors import ModelError, UsageError
from rig.models.card import TrainingResult, write_card
from rig.models.dataset import Batch, Samples
from rig.models.export import export_network, int8_file
from rig.models.fit import Checkpoint, Fit, Progress, Recipe, identity
from rig.models.networks import require_network
from rig.models.plot import write_losses
from rig.models.search import best_recipe
from rig.models.split import Split, hold_back
from rig.models.targets import RecordingSource, Targets, require_new
from rig.models.timing import cost_of

PROOF_SAMPLES = 64
CALIBRATION_SAMPLES = 64


def train(
    targets: Sequence[Path],
    net: str,
    out: Path,
    *,
    seed: int = 0,
    epochs: int = 20,
    batch_size: int = 64,
    learning_rate: float = 1e-4,
    patience: int = 5,
    search: int = 0,
    held_back: Sequence[str] = (),
    half: bool = False,
    int8: bool = False,
    progress: Progress | None = None,
) -> TrainingResult:
    """Train `net` on target files and write `out` (ONNX) with its model card and losses beside it.

    With `search`, so many trainings choose the learning rate and the batch size first.
    `held_back` names recordings to validate on; without it one world in five is held back, and
    of a single world none. `half` stores the weights in half precision; `int8` writes a second
    file, in 8-bit integers. An interrupted training leaves a checkpoint beside `out`; the same
    call goes on from the last whole epoch and ends in the same weights. Raises UsageError for a
    bad option, RecordingError for a bad target file, ModelError when training cannot work,
    diverges, or leaves a network that answers all alike or not nearly the same in integers.
    """
    require_network(net)
    recipe = Recipe(net, seed, epochs, batch_size, learning_rate, patience)
    _require_new(out, int8)
    data = _load(targets, held_back, seed)
    tell = progress or (lambda _: None)
    held = [source.sha256 for source in data.split.held_back]
    log = _search_log(out, recipe, identity(recipe, data.sha256, held))
    if search:
        recipe = best_recipe(recipe, search, data.training, data.validation, log, tell)
    told = identity(recipe, data.sha256, held)
    checkpoint = Checkpoint(out.with_suffix(".checkpoint"), told)
    fit = _fit(recipe, checkpoint, data, tell)
    parity = export_network(
        fit.best_network(),
        out,
        _spread(data.validation if len(data.validation) else data.training, PROOF_SAMPLES),
        net=net,
        training_sha256=data.sha256,
        seed=seed,
        half=half,
        calibration=_spread(data.training, CALIBRATION_SAMPLES) if int8 else None,
    )
    result = TrainingResult(
        model=out,
        card=out.with_suffix(".md"),
        recipe=recipe,
        files=tuple(zip(targets, data.files, strict=True)),
        split=data.split,
        training_samples=len(data.training),
        validation_samples=len(data.validation),
        history=tuple(fit.history),
        best_epoch=fit.best_epoch,
        training_sha256=data.sha256,
        half=half,
        parity=parity,
        costs=(cost_of(out), cost_of(int8_file(out))) if int8 else None,
    )
    write_card(result)
    write_losses(out.with_suffix(".svg"), _curves(fit), "epoch")
    checkpoint.remove()
    log.unlink(missing_ok=True)
    return result


def _search_log(out: Path, recipe: Recipe, told: str) -> Path:
    """Return where the trials of a search are kept; those of another training lie elsewhere."""
    words = f"{told} {recipe.epochs}".encode()
    return out.with_suffix(f".{hashlib.sha256(words).hexdigest()[:8]}.search")


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """What is learned from and validated on, and the digest of both."""

    files: list[Targets]
    split: Split[RecordingSource]
    training: Samples
    validation: Samples
    sha256: str


def _load(targets: Sequence[Path], held_back: Sequence[str], seed: int) -> _Data:
    if not targets:
        raise UsageError("no target files given: make one with `rig targets`")
    files = [Targets.load(path) for path in targets]
    split = hold_back([source for file in files for source in file.recordings], held_back, seed)
    training = Samples(files, frozenset(source.sha256 for source in split.training))
    validation = Samples(files, frozenset(source.sha256 for source in split.held_back))
    if len(training) < 2:
        raise ModelError(f"{len(training)} training samples are too few: record more")
    return _Data(files, split, training, validation, _sha256(targets))


def _curves(fit: Fit) -> dict[str, list[float]]:
    held_back = [loss.validation for loss in fit.history if loss.validation is not None]
    curves = {"training, with dropout": [loss.training for loss in fit.history]}
    return curves | {"held back": held_back} if held_back else curves


def _fit(recipe: Recipe, checkpoint: Checkpoint, data: _Data, progress: Progress) -> Fit:
    with torch.random.fork_rng():
        fit = Fit(recipe)
        checkpoint.resume(fit)
        while not fit.finished:
            fit.epoch(data.training, data.validation, progress)
            checkpoint.save(fit)
    return fit


def _require_new(out: Path, int8: bool) -> None:
    if out.suffix != ".onnx":
        raise UsageError(f"--out must end in .onnx, got {out}")
    require_new(out)
    if int8:
        require_new(int8_file(out))


def _spread(samples: Samples, count: int) -> Batch:
    """Return at most `count` samples from all over the drives."""
    count = min(count, len(samples))
    return samples.batch(np.linspace(0, len(samples) - 1, count).astype(np.intp))


def _sha256(targets: Sequence[Path]) -> str:
    """Return the digest of the target files' digests, in the order given."""
    combined = hashlib.sha256()
    for path in targets:
        with path.open("rb") as file:
            combined.update(hashlib.file_digest(file, "sha256").digest())
    return combined.hexdigest()
