"""The training loop, epoch by epoch, and the checkpoint that lets it be interrupted."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from rig.core.errors import ModelError, UsageError
from rig.models.dataset import Batch, Samples
from rig.models.networks import make_network

GAIN_WEIGHT = 0.5
"""Epsilon of thesis eq. 4.15."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """What decides a network besides its data; the same recipe and data give the same weights.

    Training ends after `epochs`, or after `patience` epochs without a better validation loss.
    """

    net: str
    seed: int = 0
    epochs: int = 20
    batch_size: int = 64
    learning_rate: float = 1e-4
    patience: int = 5

    def __post_init__(self) -> None:
        for option in ("epochs", "batch_size", "patience"):
            if getattr(self, option) < 1:
                raise UsageError(f"--{option.replace('_', '-')} must be at least 1")
        if not (math.isfinite(self.learning_rate) and self.learning_rate > 0):
            raise UsageError(f"--learning-rate must be above 0, got {self.learning_rate}")


@dataclass(frozen=True, slots=True)
class EpochLoss:
    """The mean loss over one epoch's samples, and over the held-back ones if there are any."""

    training: float
    validation: float | None


@dataclass(frozen=True, slots=True)
class TrainingProgress:
    """Where training stands; `loss` is that of the last batch."""

    epoch: int
    epochs: int
    batch: int
    batches: int
    loss: float


Progress = Callable[[TrainingProgress], None]


def exposure_loss(answers: Tensor, targets: Tensor) -> Tensor:
    """Return the weighted mean absolute error of gain and exposure (thesis eq. 4.15)."""
    exposure, gain = (answers - targets).abs().mean(0)
    loss: Tensor = GAIN_WEIGHT * gain + (1.0 - GAIN_WEIGHT) * exposure
    return loss


class Fit:
    """One training: call `epoch` until `finished`, then take `best_network`.

    Every epoch draws its order, flips and dropout from (seed, epoch) alone, so a training that
    goes on from a saved epoch ends in the same weights as one that never stopped.
    """

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self.history: list[EpochLoss] = []
        self.best_epoch = 0
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        torch.manual_seed(recipe.seed)
        self._network = make_network(recipe.net).to(self._device)
        self._network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._optimiser = torch.optim.Adam(self._network.parameters(), recipe.learning_rate)
        self._best = copy.deepcopy(self._network.state_dict())

    @property
    def finished(self) -> bool:
        """Return whether the epochs are over or validation stopped improving."""
        waited = len(self.history) - 1 - self.best_epoch
        return len(self.history) >= self.recipe.epochs or waited >= self.recipe.patience

    def epoch(self, training: Samples, validation: Samples, progress: Progress) -> None:
        """Pass once over the training samples and judge the result on the held-back ones.

        Without held-back samples the last epoch counts as the best. Raises ModelError when the
        loss is no number any more.
        """
        number = len(self.history)
        trained = self._train(training, number, progress)
        validated = self._mean_loss(validation) if len(validation) else None
        if not math.isfinite(trained if validated is None else trained + validated):
            raise ModelError(
                f"training diverged in epoch {number + 1} (loss {trained}, validation {validated}):"
                f" try a smaller --learning-rate than {self.recipe.learning_rate}"
            )
        self.history.append(EpochLoss(trained, validated))
        if validated is None or validated < self._best_validation():
            self.best_epoch = number
            self._best = copy.deepcopy(self._network.state_dict())

    def best_network(self) -> nn.Module:
        """Return the network of the best epoch, on the CPU, ready to answer."""
        network = make_network(self.recipe.net)
        network.load_state_dict(self._best)
        return network.eval()

    def state(self) -> dict[str, Any]:
        """Return everything that `restore` needs: tensors, numbers and words only."""
        return {
            "network": self._network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "best": self._best,
            "best_epoch": self.best_epoch,
            "history": [[loss.training, loss.validation] for loss in self.history],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state of the same recipe."""
        self._network.load_state_dict(state["network"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._best = state["best"]
        self.best_epoch = state["best_epoch"]
        self.history = [EpochLoss(*losses) for losses in state["history"]]

    def _best_validation(self) -> float:
        earlier = [loss.validation for loss in self.history[:-1] if loss.validation is not None]
        return min(earlier, default=math.inf)

    def _train(self, samples: Samples, epoch: int, progress: Progress) -> float:
        rng = np.random.default_rng([self.recipe.seed, epoch])
        torch.manual_seed(int(rng.integers(2**63)))
        self._network.train()
        order = list(_batches(rng.permutation(len(samples)), self.recipe.batch_size))
        losses = []
        for index, chosen in enumerate(order):
            batch = samples.batch(chosen)
            loss = self._loss(batch, flipped=torch.from_numpy(rng.random(len(chosen)) < 0.5))
            self._optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            losses.append(loss.item())
            progress(TrainingProgress(epoch, self.recipe.epochs, index + 1, len(order), losses[-1]))
        return float(np.mean(losses))

    def _mean_loss(self, samples: Samples) -> float:
        self._network.eval()
        with torch.inference_mode():
            losses = [
                (self._loss(batch).item(), len(batch.targets))
                for batch in samples.batches(self.recipe.batch_size)
            ]
        values, weights = zip(*losses, strict=True)
        return float(np.average(values, weights=weights))

    def _loss(self, batch: Batch, flipped: Tensor | None = None) -> Tensor:
        stored = torch.from_numpy(batch.images)
        if flipped is not None:
            stored[flipped] = stored[flipped].flip(-1)
        images = stored.to(self._device, memory_format=torch.channels_last).float().div_(255)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=_fast_bf16(self._device)):
            answers = self._network(images, torch.from_numpy(batch.settings).to(self._device))
        return exposure_loss(answers.float(), torch.from_numpy(batch.targets).to(self._device))


class Resumable(Protocol):
    """A training whose state can be kept."""

    def state(self) -> dict[str, Any]:
        """Return tensors, numbers and words that say where it stands."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        ...


class Checkpoint:
    """A file that holds one training's state after its last whole epoch or stage.

    `identity` says which recipe and data it belongs to.
    """

    def __init__(self, path: Path, identity: str) -> None:
        self._path = path
        self._identity = identity

    def save(self, fit: Resumable) -> None:
        """Replace the file by the present state."""
        unfinished = self._path.with_name(self._path.name + ".part")
        torch.save({"identity": self._identity, "state": fit.state()}, unfinished)
        unfinished.replace(self._path)

    def resume(self, fit: Resumable) -> None:
        """Bring a fresh training to the state in the file, if there is one.

        Raises ModelError when the file belongs to another training or cannot be read.
        """
        if not self._path.exists():
            return
        try:
            saved = torch.load(self._path, weights_only=True, map_location="cpu")
            same = saved["identity"] == self._identity
        except (OSError, RuntimeError, KeyError, TypeError, EOFError, pickle.UnpicklingError) as e:
            raise ModelError(f"{self._path}: not a checkpoint ({e}); delete it") from e
        if not same:
            raise ModelError(
                f"{self._path} belongs to a training with other data or options: delete it, or "
                "repeat the interrupted command"
            )
        fit.restore(saved["state"])

    def remove(self) -> None:
        """Delete the file, if there is one."""
        self._path.unlink(missing_ok=True)


def identity(recipe: Recipe, training_sha256: str, held_back: list[str]) -> str:
    """Return what must be equal for a checkpoint to be gone on with; epochs may be more."""
    known = {**asdict(recipe), "epochs": None, "data": training_sha256, "held_back": held_back}
    return repr(sorted(known.items()))


def _batches(order: NDArray[np.intp], size: int) -> Iterator[NDArray[np.intp]]:
    """Yield whole batches; batch normalisation cannot use a rest, so the next epoch gets it."""
    size = min(size, len(order))
    for start in range(0, len(order) - size + 1, size):
        yield order[start : start + size]


def _fast_bf16(device: torch.device) -> bool:
    """Return whether bfloat16 arithmetic is in hardware, where it halves the time."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))
