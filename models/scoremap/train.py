"""From path targets to a shipped score-map network: stages, the best of them, proof, card."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from rig.core.errors import UsageError
from rig.models.export import Parity, Proof, write_proven
from rig.models.fit import Checkpoint
from rig.models.names import SCORE_MAPS
from rig.models.plot import write_losses
from rig.models.scoremap.closed_loop import NetworkCars, Score, scores
from rig.models.scoremap.fit import PathFit, PathRecipe, StageProgress, StageResult
from rig.models.scoremap.grid import SettingsGrid
from rig.models.scoremap.network import ScoreMapEnsemble
from rig.models.scoremap.paths import DriveSource, PathTargets
from rig.models.scoremap.seen import SeenDrive
from rig.models.split import Split, hold_back
from rig.models.targets import require_new

MemberProgress = Callable[[int, int, int, int, float], None]
"""Told the member, then what `StageProgress` is told."""

INPUT = "thumbnails 2x48x64 (brightness, saturation) in 0..1, newest frame first; settings scaled"
PROOF_SAMPLES = 64


@dataclass(frozen=True, slots=True)
class Member:
    """How one network learned; `best_stage` counts from 0 and is the one kept."""

    seed: int
    history: tuple[StageResult, ...]
    best_stage: int


@dataclass(frozen=True, slots=True)
class Beginning:
    """The file that a training went on from."""

    name: str
    sha256: str


@dataclass(frozen=True, slots=True)
class PathTrainingResult:
    """A trained and exported score-map network, and how each of its members learned."""

    model: Path
    card: Path
    net: str
    recipe: PathRecipe
    files: tuple[Path, ...]
    beginning: Beginning | None
    split: Split[DriveSource]
    members: tuple[Member, ...]
    together: tuple[Score, ...]
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
    members: int = 1,
    held_back: Sequence[str] = (),
    half: bool = False,
    begin_with: Path | None = None,
    progress: MemberProgress = lambda _member, _stage, _step, _steps, _loss: None,
) -> PathTrainingResult:
    """Train `net` on path targets and write `out` (ONNX) with its model card beside it.

    More `members` than one, with seeds from that of the recipe on, answer together. `held_back`
    names worlds, such as `tunnel?seed=90`, to choose the stage by; without it one world in five is
    held back. Members go on from the exported network `begin_with` where it is given. An
    interrupted training goes on from its last whole stage. Raises UsageError for a bad option,
    RecordingError for a bad file, ModelError when training diverges or `begin_with` is no score
    map of this kind.
    """
    from rig.models.scoremap.card import write_path_card

    _check(net, out, members)
    data = _load(targets, held_back, recipe.seed)
    beginning = None if begin_with is None else _beginning(begin_with)
    recipes = [replace(recipe, seed=recipe.seed + member) for member in range(members)]
    fits = []
    for member, own in enumerate(recipes):
        fit = PathFit(own, data.grid, data.training, data.judging)
        held = [source.sha256 for source in data.split.held_back]
        told = repr((net, own, data.sha256, held, beginning and beginning.sha256))
        checkpoint = Checkpoint(_checkpoint(out, member), told)
        _finish(fit, checkpoint, begin_with, partial(progress, member))
        fits.append(fit)
    networks = [fit.best_network() for fit in fits]
    network = networks[0] if members == 1 else ScoreMapEnsemble(networks)
    proof = Proof(*fits[0].proof_samples(PROOF_SAMPLES))
    metadata = _metadata(net, data.sha256, recipe.seed)
    parity = write_proven(network, network, out, proof, metadata, half=half)
    result = PathTrainingResult(
        model=out,
        card=out.with_suffix(".md"),
        net=net,
        recipe=recipe,
        files=tuple(targets),
        beginning=beginning,
        split=data.split,
        members=tuple(Member(f.recipe.seed, tuple(f.history), f.best_stage) for f in fits),
        together=tuple(scores(NetworkCars(network.eval()), data.judging, data.grid)),
        training_sha256=data.sha256,
        half=half,
        parity=parity,
        parameters=sum(weights.numel() for weights in network.parameters()),
    )
    write_path_card(result)
    curves = {f"seed {f.recipe.seed}": [stage.loss for stage in f.history] for f in fits}
    write_losses(out.with_suffix(".svg"), curves, "stage")
    for member in range(members):
        _checkpoint(out, member).unlink(missing_ok=True)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Drives:
    """What is learned from, what is judged by, and the digest of both."""

    grid: SettingsGrid
    split: Split[DriveSource]
    training: list[SeenDrive]
    judging: list[SeenDrive]
    sha256: str


def _check(net: str, out: Path, members: int) -> None:
    if members < 1:
        raise UsageError(f"--members must be at least 1, got {members}")
    if net not in SCORE_MAPS:
        raise UsageError(f"{net} does not learn from path targets; choose {', '.join(SCORE_MAPS)}")
    if out.suffix != ".onnx":
        raise UsageError(f"--out must end in .onnx, got {out}")
    require_new(out)


def _load(targets: Sequence[Path], held_back: Sequence[str], seed: int) -> _Drives:
    files = [PathTargets.load(path) for path in targets]
    grid = files[0].grid
    if any(file.grid != grid for file in files):
        raise UsageError("the target files have different grids of settings: make them anew")
    sources = [source for file in files for source in file.sources]
    drives = [drive for file in files for drive in file.drives]
    split = hold_back(sources, held_back, seed)
    training, judging = (_of(drives, sources, part) for part in (split.training, split.held_back))
    digest = hashlib.sha256(" ".join(source.sha256 for source in sources).encode()).hexdigest()
    return _Drives(grid, split, training, judging, digest)


def _metadata(net: str, training_sha256: str, seed: int) -> dict[str, str]:
    return {
        "net": net,
        "picture": "thumbnail",
        "training_sha256": training_sha256,
        "seed": str(seed),
        "input": INPUT,
    }


def _checkpoint(out: Path, member: int) -> Path:
    return out.with_suffix(f".{member}.checkpoint" if member else ".checkpoint")


def _beginning(model: Path) -> Beginning:
    if not model.exists():
        raise UsageError(f"--begin-with {model}: no such file; `rig train` writes networks")
    return Beginning(model.name, hashlib.sha256(model.read_bytes()).hexdigest())


def _finish(
    fit: PathFit, checkpoint: Checkpoint, begin_with: Path | None, progress: StageProgress
) -> None:
    with torch.random.fork_rng():
        checkpoint.resume(fit)
        if begin_with is not None and not fit.history:
            fit.begin_with(begin_with)
        while not fit.finished:
            fit.stage(progress)
            checkpoint.save(fit)


def _of(
    drives: Sequence[SeenDrive], sources: Sequence[DriveSource], wanted: Sequence[DriveSource]
) -> list[SeenDrive]:
    return [drive for drive, source in zip(drives, sources, strict=True) if source in wanted]
