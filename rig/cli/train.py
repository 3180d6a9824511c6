"""`rig train --net NET TARGETS...`: a network from target files, exported and proven."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Advance, Terminal
from rig.core.errors import RigError, UsageError
from rig.models.names import SCORE_MAPS

if TYPE_CHECKING:
    from rig.models.fit import TrainingProgress
    from rig.models.scoremap.fit import PathRecipe
    from rig.models.scoremap.train import MemberProgress


def train(
    *targets: Path,
    out: Path,
    net: str = "dual-small",
    epochs: int | None = None,
    steps: tuple[int, ...] = (),
    members: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
    patience: int | None = None,
    search: int | None = None,
    hold_back: tuple[str, ...] = (),
    half: bool = False,
    int8: bool = False,
    front_end: str | None = None,
    discount: float | None = None,
    lost_cost: float | None = None,
    begin_with: Path | None = None,
    seed: int = 0,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Train a network on target files and export it to ONNX with a model card.

    Ctrl-C keeps a checkpoint; the same command goes on from there.

    Parameters
    ----------
    targets:
        Files that `rig targets` wrote.
    out:
        The .onnx file to write; its card lies beside it.
    net:
        dual-small, dual-large, single or resnet18; map-small or map-large for path targets.
    epochs:
        How often to pass over the samples, 20 when absent; not for score maps.
    steps:
        Optimiser steps of a stage of a score map, once a stage.
    members:
        How many score maps to train, with seeds from --seed on, that answer together.
    learning_rate:
        1e-4 when absent; the highest one of a score map's first stage, 2e-3.
    patience:
        Epochs without a better held-back loss before it ends, 5 when absent; not for score maps.
    search:
        Try so many learning rates and batch sizes first, drawn at random; not for score maps.
    hold_back:
        Recordings or worlds to validate on; one world in five when absent.
    half:
        Store the weights in half precision.
    int8:
        Write a second file, .int8.onnx, smaller and faster; not for score maps.
    front_end:
        Whose matches a score map is for: orb, viso2 or both; both when absent.
    discount:
        How much a score map counts what follows, 0 to below 1: 0.95 when absent, and with 0 the
        best next picture alone.
    lost_cost:
        What a motion that odometry cannot tell costs a score map: nothing when absent, 2 for viso2.
    begin_with:
        A score map that `rig train` wrote, of the same --net, to go on from.
    """
    given: dict[str, Any] = {"batch_size": batch_size, "learning_rate": learning_rate}
    try:
        if net in SCORE_MAPS:
            _refuse(net, epochs=epochs, patience=patience, search=search, int8=int8 or None)
            given |= {"front_end": front_end, "discount": discount, "lost_cost": lost_cost}
            recipe = _map_recipe(net, seed, steps, given)
            options = {"held_back": hold_back, "half": half, "begin_with": begin_with}
            return _train_map(targets, net, out, recipe, members, options, terminal)
        _refuse(net, steps=steps or None, members=members, begin_with=begin_with)
        _refuse(net, front_end=front_end, discount=discount, lost_cost=lost_cost)
        given |= {"epochs": epochs, "patience": patience, "search": search}
        given |= {"half": half, "int8": int8}
        return _train_thesis(targets, net, out, given, seed, hold_back, terminal)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise RigError("rig train needs torch: pip install 'exposure-rig[train]'") from None


def _map_recipe(
    net: str, seed: int, steps: tuple[int, ...], given: Mapping[str, Any]
) -> PathRecipe:
    from rig.models.scoremap.fit import make_recipe

    return make_recipe(net, seed, steps, **_only_given(given))


def _train_map(
    targets: tuple[Path, ...],
    net: str,
    out: Path,
    recipe: PathRecipe,
    members: int | None,
    options: Mapping[str, Any],
    terminal: Terminal,
) -> int:
    from rig.models.scoremap.train import train_paths

    count = 1 if members is None else members
    with terminal.progress("training", count * sum(recipe.steps)) as advance:
        result = train_paths(
            targets,
            net,
            out,
            recipe,
            members=count,
            **options,
            progress=stage_reporter(count, recipe.steps, advance, terminal),
        )
    reached = ", ".join(f"{score.median:.0f}/{score.min:.0f}" for score in result.together)
    stages = ", ".join(f"{m.best_stage + 1} of {len(m.history)}" for m in result.members)
    terminal.result(
        f"{result.model}: stage {stages}, held-back median/minimum {reached or 'none'}; "
        f"card: {result.card}",
        {
            "file": str(result.model),
            "card": str(result.card),
            "held_back": [[score.median, score.min] for score in result.together],
            "members": [
                {
                    "seed": member.seed,
                    "best_stage": member.best_stage,
                    "history": [
                        [stage.loss, [[score.median, score.min] for score in stage.held_back]]
                        for stage in member.history
                    ],
                }
                for member in result.members
            ],
        },
    )
    return OK


def _train_thesis(
    targets: tuple[Path, ...],
    net: str,
    out: Path,
    given: Mapping[str, float | None],
    seed: int,
    hold_back: tuple[str, ...],
    terminal: Terminal,
) -> int:
    from rig.models.train import train as fit

    with terminal.progress("training", None) as advance:
        result = fit(
            targets,
            net,
            out,
            seed=seed,
            held_back=hold_back,
            progress=reporter(advance, terminal),
            **_only_given(given),
        )
    best = result.history[result.best_epoch]
    terminal.result(
        f"{result.model}: epoch {result.best_epoch + 1} of {len(result.history)}, "
        f"loss {best.training:.4f}, held back {best.validation}; card: {result.card}",
        {
            "file": str(result.model),
            "card": str(result.card),
            "best_epoch": result.best_epoch,
            "training_samples": result.training_samples,
            "validation_samples": result.validation_samples,
            "history": [[epoch.training, epoch.validation] for epoch in result.history],
            "int8_moved": result.parity.int8 and asdict(result.parity.int8),
        },
    )
    return OK


def _only_given(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _refuse(net: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name.replace('_', '-')} does not go with --net {net}")


def stage_reporter(
    members: int, steps: Sequence[int], advance: Advance, terminal: Terminal
) -> MemberProgress:
    """Return what shows a staged training: a bar, and with --verbose a line a stage."""

    def report(member: int, stage: int, step: int, total: int, loss: float) -> None:
        done = member * sum(steps) + sum(steps[:stage]) + step
        advance(done, members * sum(steps))
        if step == total:
            terminal.detail(
                f"network {member + 1} of {members}, stage {stage + 1} of {len(steps)}: "
                f"loss {loss:.4f}"
            )

    return report


def reporter(advance: Advance, terminal: Terminal) -> Callable[[TrainingProgress], None]:
    """Return what shows training's progress: a bar, and with --verbose a line an epoch."""

    def report(now: TrainingProgress) -> None:
        advance(now.epoch * now.batches + now.batch, now.epochs * now.batches)
        if now.batch == now.batches:
            terminal.detail(f"epoch {now.epoch + 1} of {now.epochs}: loss {now.loss:.4f}")

    return report
