"""From path targets to a shipped score-map network: stages, the best of them, proof, card."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from rig.core.errors import UsageError
from rig.models.export import Parity, Proof, write_proven
from rig.models.fit import Checkpoint
from rig.models.names import SCORE_MAPS
from rig.models.pathfit import PathFit, PathRecipe, StageProgress, StageResult
from rig.models.paths import DriveSource, PathTargets
from rig.models.seen import SeenDrive
from rig.models.split import Split, hold_back
from rig.models.targets import refuse_existing

INPUT = "thumbnails 2x48x64 (brightness, saturation) in 0..1, newest frame first; settings scaled"
PROOF_SAMPLES = 64


@dataclass(frozen=True, slots=True)
class PathTrainingResult:
    """A trained and exported score-map network; `best_stage` counts from 0 and is the one kept."""

    model: Path
    card: Path
    net: str
    recipe: PathRecipe
    files: tuple[Path, ...]
    split: Split[DriveSource]
    history: tuple[StageResult, ...]
    best_stage: int
    training_sha256: str
    half: bool
    parity: Parity
    parameters: int


def train_paths(
    targets: Sequence[Path],
    net: str,
    out: Path,
    recipe: PathRecipe,
    *,
    held_back: Sequence[str] = (),
    half: bool = False,
    progress: StageProgress = lambda _stage, _step, _steps, _loss: None,
) -> PathTrainingResult:
    """Train `net` on path targets and write `out` (ONNX) with its model card beside it.

    `held_back` names worlds, such as `tunnel?seed=90`, to choose the stage by; without it one
    world in five is held back. An interrupted training goes on from its last whole stage. Raises
    UsageError for a bad option, RecordingError for a bad file, ModelError when training diverges.
    """
    from rig.models.pathcard import write_path_card

    if net not in SCORE_MAPS:
        raise UsageError(f"{net} does not learn from path targets; choose {', '.join(SCORE_MAPS)}")
    if out.suffix != ".onnx":
        raise UsageError(f"--out must end in .onnx, got {out}")
    refuse_existing(out)
    files = [PathTargets.load(path) for path in targets]
    grid = files[0].grid
    if any(file.grid != grid for file in files):
        raise UsageError("the target files have different grids of settings: make them anew")
    sources = [source for file in files for source in file.sources]
    drives = [drive for file in files for drive in file.drives]
    split = hold_back(sources, held_back, recipe.seed)
    digest = hashlib.sha256(" ".join(source.sha256 for source in sources).encode()).hexdigest()
    fit = _fit(
        recipe,
        PathFit(
            recipe,
            grid,
            _of(drives, sources, split.training),
            _of(drives, sources, split.held_back),
        ),
        Checkpoint(
            out.with_suffix(".checkpoint"),
            repr((net, recipe, digest, [source.sha256 for source in split.held_back])),
        ),
        progress,
    )
    network = fit.best_network()
    parity = write_proven(
        network,
        network,
        out,
        Proof(*fit.proof_samples(PROOF_SAMPLES)),
        {
            "net": net,
            "picture": "thumbnail",
            "training_sha256": digest,
            "seed": str(recipe.seed),
            "input": INPUT,
        },
        half=half,
    )
    result = PathTrainingResult(
        model=out,
        card=out.with_suffix(".md"),
        net=net,
        recipe=recipe,
        files=tuple(targets),
        split=split,
        history=tuple(fit.history),
        best_stage=fit.best_stage,
        training_sha256=digest,
        half=half,
        parity=parity,
        parameters=sum(weights.numel() for weights in network.parameters()),
    )
    write_path_card(result)
    out.with_suffix(".checkpoint").unlink(missing_ok=True)
    return result


def _fit(
    recipe: PathRecipe, fit: PathFit, checkpoint: Checkpoint, progress: StageProgress
) -> PathFit:
    with torch.random.fork_rng():
        checkpoint.resume(fit)
        while not fit.finished:
            fit.stage(progress)
            checkpoint.save(fit)
    return fit


def _of(
    drives: Sequence[SeenDrive], sources: Sequence[DriveSource], wanted: Sequence[DriveSource]
) -> list[SeenDrive]:
    return [drive for drive, source in zip(drives, sources, strict=True) if source in wanted]
