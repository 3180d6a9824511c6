"""Training a score-map network: random behaviours first, then its own mistakes (DAgger).

A stage trains on all journeys so far. Behind each stage but the last, the network drives through
the training drives itself, and what it saw joins the journeys: the labels of the pictures that
its own settings lead to. (Ross, Gordon, Bagnell: A reduction of imitation learning, 2011.)
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from rig.core.errors import ModelError, UsageError
from rig.models.export import Proof
from rig.models.names import SCORE_MAPS
from rig.models.scoremap.closed_loop import (
    Chances,
    NetworkCars,
    Score,
    own_journeys,
    random_journeys,
    scores,
)
from rig.models.scoremap.continue_from import begin_with
from rig.models.scoremap.grid import SettingsGrid
from rig.models.scoremap.lessons import Lessons, PathSamples, gather
from rig.models.scoremap.network import TOLD, ScoreMapNetwork
from rig.models.scoremap.rollout import Journey, Trip
from rig.models.scoremap.seen import SeenDrive
from rig.models.scoremap.values import UTILITIES, Utility

_BEGINNING_SAMPLES = 2_048
"""From so many samples the folded normalisations of a network to begin with are filled in."""


@dataclass(frozen=True, slots=True)
class PathRecipe:
    """What decides a score-map network besides its data.

    `width` is that of the network. `steps` are the optimiser's steps of each stage; `behaviours`
    and `own_journeys` the journeys through every drive, at random and after each stage, on trips
    as `chances` has them; `utility` is what moves are worth in the lesson, and stages are compared
    by what they reach in the front ends that it cares for;
    `objective` names one of OBJECTIVES; `temperature` turns values into the probabilities to
    learn; `noise` scales the own journeys' errors, off for every other round.
    """

    seed: int = 0
    width: int = 1
    steps: tuple[int, ...] = (2000, 1500, 1500)
    learning_rates: tuple[float, ...] = (2e-3, 1.5e-3, 1.5e-3)
    batch_size: int = 256
    behaviours: int = 12
    own_journeys: int = 12
    objective: str = "values"
    temperature: float = 0.05
    smoothing: float = 0.0
    noise: float = 0.25
    weight_decay: float = 1e-2
    utility: Utility = field(default_factory=Utility)
    chances: Chances = field(default_factory=lambda: Chances((0, 1, 2), relit=0.6))


def make_recipe(
    net: str,
    seed: int,
    steps: Sequence[int] = (),
    learning_rate: float = 2e-3,
    batch_size: int = 256,
    front_end: str = "both",
    discount: float | None = None,
    lost_cost: float | None = None,
) -> PathRecipe:
    """Return a recipe with these options; later stages learn at three quarters of the rate.

    `net` is a name of SCORE_MAPS, `front_end` of UTILITIES, whose `discount` and `lost_cost` are
    taken when None; `steps` are those of each stage, PathRecipe's when empty. Raises UsageError
    when one is out of range or unknown.
    """
    steps = tuple(steps) or PathRecipe().steps
    if min(steps) < 1 or batch_size < 2:
        raise UsageError("--steps must be at least 1 and --batch-size at least 2")
    if not (math.isfinite(learning_rate) and learning_rate > 0):
        raise UsageError(f"--learning-rate must be above 0, got {learning_rate}")
    if front_end not in UTILITIES:
        raise UsageError(f"--front-end must be one of {', '.join(UTILITIES)}, got {front_end}")
    rates = (learning_rate, *(0.75 * learning_rate for _ in steps[1:]))
    return PathRecipe(
        seed=seed,
        width=SCORE_MAPS[net],
        steps=steps,
        learning_rates=rates,
        batch_size=batch_size,
        utility=_utility(front_end, discount, lost_cost),
    )


def _utility(front_end: str, discount: float | None, lost_cost: float | None) -> Utility:
    utility = UTILITIES[front_end]
    if lost_cost is not None and front_end == "orb":
        raise UsageError("--lost-cost is about viso2's odometry: it does not go with orb alone")
    if lost_cost is not None and not (math.isfinite(lost_cost) and lost_cost >= 0):
        raise UsageError(f"--lost-cost must be at least 0, got {lost_cost}")
    return replace(
        utility,
        discount=utility.discount if discount is None else discount,
        lost_cost=utility.lost_cost if lost_cost is None else lost_cost,
    )


Batch = tuple[Tensor, Tensor, Tensor]
"""Images, settings and values, as in `PathSamples.batch`."""


def toward_values(network: ScoreMapNetwork, batch: Batch, recipe: PathRecipe) -> Tensor:
    """Return the cross-entropy of the scores against the softmax of the values."""
    images, settings, values = batch
    wanted = functional.softmax(values / recipe.temperature, 1)
    found = functional.log_softmax(network.scores(images, settings), 1)
    return -(wanted * found).sum(1).mean()


def toward_best(network: ScoreMapNetwork, batch: Batch, _recipe: PathRecipe) -> Tensor:
    """Return the absolute error of the answer against the cell of the highest value (eq. 4.15)."""
    images, settings, values = batch
    answer = network.logarithmic(network(images, settings).repeat(1, TOLD // 2))[:, :2]
    return (answer - network.cells[values.argmax(1)]).abs().mean()


OBJECTIVES: Mapping[str, Callable[[ScoreMapNetwork, Batch, PathRecipe], Tensor]] = {
    "values": toward_values,
    "best": toward_best,
}
"""What a score map may be taught: the values of all cells, or the best one as a regression."""


@dataclass(frozen=True, slots=True)
class StageResult:
    """The last smoothed loss of a stage, and what the network then reached when held back.

    `late` is with cameras of the longest latency that it learned for; empty where that is none.
    """

    loss: float
    held_back: tuple[Score, ...]
    late: tuple[Score, ...] = ()

    def worth(self, front_end: str) -> float:
        """Return what stages are compared by: the mean worth of all drives, prompt and late."""
        return float(np.mean([score.worth(front_end) for score in (*self.held_back, *self.late)]))


StageProgress = Callable[[int, int, int, float], None]
"""Told the stage, the step, the steps of the stage and the smoothed loss."""


class PathFit:
    """One training of a score-map network; call `stage` until `finished`, then `best_network`.

    A stage draws everything from (seed, stage), so a training that goes on from a saved stage
    ends in the same weights as one that never stopped.
    """

    def __init__(
        self,
        recipe: PathRecipe,
        grid: SettingsGrid,
        training: Sequence[SeenDrive],
        held_back: Sequence[SeenDrive],
    ) -> None:
        self.recipe, self.grid = recipe, grid
        self.history: list[StageResult] = []
        self.best_stage = 0
        self._training, self._held_back = training, held_back
        torch.manual_seed(recipe.seed)
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.network = self._new_network().to(self._device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._best = copy.deepcopy(self.network.state_dict())
        self._lessons = Lessons(training, grid, recipe.utility)
        rng = np.random.default_rng([recipe.seed, 1_000])
        self._journeys = random_journeys(training, grid, recipe.behaviours, recipe.chances, rng)
        self._own: list[Journey] = []

    @property
    def finished(self) -> bool:
        """Return whether all stages are done."""
        return len(self.history) >= len(self.recipe.steps)

    def stage(self, progress: StageProgress) -> None:
        """Train one stage, judge it on the held-back drives, and let the network drive itself.

        Without held-back drives the last stage counts as the best. Raises ModelError when the
        loss is no number any more.
        """
        number, recipe = len(self.history), self.recipe
        rng = np.random.default_rng([recipe.seed, number])
        torch.manual_seed(int(rng.integers(2**63)))
        samples = gather(self._journeys + self._own, self._lessons)
        loss = self._train(samples, number, rng, progress)
        if not math.isfinite(loss):
            raise ModelError(f"training diverged in stage {number + 1}: its loss is {loss}")
        reached = self._reached(0)
        latency = max(recipe.chances.latencies)
        late = self._reached(latency) if latency else ()
        self.history.append(StageResult(loss, reached, late))
        if not reached or self._worth(number) > self._worth(self.best_stage):
            self.best_stage = number
        if self.best_stage == number:
            self._best = copy.deepcopy(self.network.state_dict())
        if not self.finished:
            self._drive_itself(recipe.noise if number % 2 == 0 else 0.0, rng)

    def begin_with(self, model: Path) -> None:
        """Go on from an exported network, whose own drives join the first stage's journeys.

        Raises ModelError when the file is of another kind of network.
        """
        begin_with(self.network, model, Proof(*self.proof_samples(_BEGINNING_SAMPLES)))
        self._drive_itself(self.recipe.noise, np.random.default_rng([self.recipe.seed, 2_000]))

    def best_network(self) -> ScoreMapNetwork:
        """Return the network of the best stage, ready to answer."""
        network = self._new_network()
        network.load_state_dict(self._best)
        return network.eval()

    def proof_samples(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return images and settings from all over the journeys, to prove an exported file on."""
        samples = gather(self._journeys, self._lessons)
        rows = np.linspace(0, len(samples) - 1, count).astype(np.int64)
        images, settings, _ = samples.batch(torch.from_numpy(rows))
        return images.numpy(), settings.numpy()

    def state(self) -> dict[str, Any]:
        """Return everything that `restore` needs: tensors, numbers and words only."""
        return {
            "network": self.network.state_dict(),
            "best": self._best,
            "best_stage": self.best_stage,
            "history": [
                [
                    one.loss,
                    *(
                        [list(astuple(score)) for score in some]
                        for some in (one.held_back, one.late)
                    ),
                ]
                for one in self.history
            ],
            "own": [
                [
                    [own.trip.drive, own.trip.latency, torch.from_numpy(own.trip.light)],
                    torch.from_numpy(own.frames),
                    torch.from_numpy(own.used),
                ]
                for own in self._own
            ],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state of the same recipe and drives."""
        self.network.load_state_dict(state["network"])
        self._best, self.best_stage = state["best"], state["best_stage"]
        self.history = [
            StageResult(loss, *(tuple(Score(*score) for score in some) for some in reached))
            for loss, *reached in state["history"]
        ]
        self._own = [
            Journey(Trip(drive, latency, light.numpy()), frames.numpy(), used.numpy())
            for (drive, latency, light), frames, used in state["own"]
        ]

    def _drive_itself(self, noise: float, rng: np.random.Generator) -> None:
        recipe = self.recipe
        self._own += own_journeys(
            self.network,
            self._training,
            self.grid,
            recipe.own_journeys,
            recipe.chances,
            noise,
            rng,
        )

    def _reached(self, latency: int) -> tuple[Score, ...]:
        return tuple(scores(NetworkCars(self.network), self._held_back, self.grid, latency))

    def _worth(self, stage: int) -> float:
        return self.history[stage].worth(self.recipe.utility.front_end)

    def _new_network(self) -> ScoreMapNetwork:
        return ScoreMapNetwork(self.grid, smoothing=self.recipe.smoothing, width=self.recipe.width)

    def _train(
        self,
        samples: PathSamples,
        number: int,
        rng: np.random.Generator,
        progress: StageProgress,
    ) -> float:
        recipe, rate = self.recipe, self.recipe.learning_rates[number]
        steps = recipe.steps[number]
        optimiser = torch.optim.AdamW(
            self.network.parameters(), rate, weight_decay=recipe.weight_decay
        )
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, rate, total_steps=steps, pct_start=0.15
        )
        self.network.train()
        objective, samples = OBJECTIVES[recipe.objective], samples.to(self._device)
        smooth = 0.0
        for step in range(steps):
            chosen = torch.from_numpy(rng.integers(0, len(samples), recipe.batch_size))
            mirrored = torch.from_numpy(rng.random(len(chosen)) < 0.5)
            images, settings, values = samples.batch(chosen.to(self._device))
            sides = mirrored.to(self._device)[:, None, None, None]
            images = torch.where(sides, images.flip(-1), images)
            loss = objective(self.network, (images, settings, values), recipe)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            schedule.step()
            smooth = loss.item() if step == 0 else 0.98 * smooth + 0.02 * loss.item()
            progress(number, step + 1, steps, smooth)
        self.network.eval()
        return smooth
