"""`rig train --net NET TARGETS...`: a network from target files, exported and proven."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Advance, Terminal
from rig.core.errors import RigError

if TYPE_CHECKING:
    from rig.models.fit import TrainingProgress


def train(
    *targets: Path,
    out: Path,
    net: str = "dual-small",
    epochs: int = 20,
    batch_size: int = 64,
    learning_rate: float = 1e-4,
    patience: int = 5,
    hold_back: tuple[str, ...] = (),
    half: bool = False,
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
        dual-small or dual-large.
    hold_back:
        Recordings to validate on; one world in five when absent.
    half:
        Store the weights in half precision.
    """
    try:
        from rig.models.train import train as fit
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise RigError("rig train needs torch: pip install 'exposure-rig[train]'") from None
    with terminal.progress("training", None) as advance:
        result = fit(
            targets,
            net,
            out,
            seed=seed,
            epochs=epochs,
            batch_size=batch_size,
            learning_rate=learning_rate,
            patience=patience,
            held_back=hold_back,
            half=half,
            progress=reporter(advance, terminal),
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
        },
    )
    return OK


def reporter(advance: Advance, terminal: Terminal) -> Callable[[TrainingProgress], None]:
    """Return what shows training's progress: a bar, and with --verbose a line an epoch."""

    def report(now: TrainingProgress) -> None:
        advance(now.epoch * now.batches + now.batch, now.epochs * now.batches)
        if now.batch == now.batches:
            terminal.detail(f"epoch {now.epoch + 1} of {now.epochs}: loss {now.loss:.4f}")

    return report
