"""Training a score-map network: random behaviours first, then its own mistakes (DAgger).

A stage trains on all journeys so far. Behind each stage but the last, the network drives through
the training drives itself, and what it saw joins the journeys: the labels of the pictures that
its own settings lead to. (Ross, Gordon, Bagnell: A reduction of imitation learning, 2011.)
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from rig.core.errors import ModelError, UsageError
from rig.models.cars import Chances, NetworkCars, Score, own_journeys, random_journeys, scores
from rig.models.dataset import scale_settings
from rig.models.grid import SettingsGrid
from rig.models.names import SCORE_MAPS
from rig.models.rollout import Journey, Trip
from rig.models.scoremap import FRAMES, TOLD, ScoreMapNetwork
from rig.models.seen import SeenDrive
from rig.models.values import (
    UTILITIES,
    Utility,
    Values,
    change_worth,
    denoised,
    move_values,
    move_worth,
)


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
    behaviours: int = 20
    own_journeys: int = 6
    objective: str = "values"
    temperature: float = 0.05
    smoothing: float = 0.0
    noise: float = 0.25
    weight_decay: float = 1e-2
    utility: Utility = field(default_factory=Utility)
    chances: Chances = field(default_factory=lambda: Chances((0, 1, 2), relit=0.5))


def make_recipe(
    net: str,
    seed: int,
    steps: Sequence[int] = (),
    learning_rate: float = 2e-3,
    batch_size: int = 256,
    front_end: str = "both",
) -> PathRecipe:
    """Return a recipe with these options; later stages learn at three quarters of the rate.

    `net` is a name of SCORE_MAPS, `front_end` of UTILITIES; `steps` are those of each stage,
    PathRecipe's when empty. Raises UsageError when one is out of range or unknown.
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
        utility=UTILITIES[front_end],
    )


Batch = tuple[Tensor, Tensor, Tensor]
"""Images, settings and values, as in `PathSamples.batch`."""


@dataclass(frozen=True, slots=True, eq=False)
class PathSamples:
    """N decisions: the frames to look at (N x 3, newest first) and the value of each answer.

    `asked` is N x 2, the settings asked for last, scaled as `settings` are.
    """

    frames: Tensor
    settings: Tensor
    newest_first: Tensor
    asked: Tensor
    values: Tensor

    def __len__(self) -> int:
        return len(self.newest_first)

    def to(self, device: torch.device) -> PathSamples:
        """Return the same samples on a device."""
        return PathSamples(
            self.frames.to(device),
            self.settings.to(device),
            self.newest_first.to(device),
            self.asked.to(device),
            self.values.to(device),
        )

    def batch(self, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return images N x 6 x 48 x 64, settings N x 8 and values N x S."""
        rows = self.newest_first[chosen]
        images = self.frames[rows].flatten(1, 2).float() / 255
        settings = torch.cat([self.settings[rows].flatten(1), self.asked[chosen]], 1)
        return images, settings, self.values[chosen]


@dataclass(frozen=True, slots=True, eq=False)
class _Lesson:
    """What a drive teaches in one light, for each of P-1 pairs.

    `matched` is what the matches of each move are worth, S x S; `steady` the inliers of the other
    front end where a setting stays, S; `following` what is worth having reached a setting, S.
    """

    matched: Values
    steady: Values
    following: Values


class Lessons:
    """What moves are worth in some drives, in any light; worked out when first asked for."""

    def __init__(self, drives: Sequence[SeenDrive], grid: SettingsGrid, utility: Utility) -> None:
        self._drives, self._grid, self._utility = drives, grid, utility
        self._known: dict[tuple[int, int], _Lesson] = {}

    def of(self, journey: Journey) -> NDArray[np.float32]:
        """Return decisions x S values: what each answer is worth to the frame that it reaches.

        Nobody knows that the light will change: in the lesson it stays as it is at the decision.
        The move begins at what was asked for last, which is used by then. Between cells its matches
        are a mixture; the change of brightness, which the other front end suffers from, is exact.
        """
        late = journey.trip.latency
        asked = journey.used[late:-1]
        light = journey.trip.light_at(np.arange(len(asked)))
        values = np.empty((len(asked), len(self._grid)), np.float32)
        for steps in np.unique(light):
            now = np.flatnonzero(light == steps)
            lesson = self._lesson(journey.trip.drive, int(steps))
            values[now] = self._values(lesson, now + late, asked[now])
        return values

    def _values(
        self, lesson: _Lesson, pairs: NDArray[np.int64], asked: NDArray[np.float64]
    ) -> Values:
        """Return N x S values of moves from N settings, each at a pair of its own."""
        cells, corners = self._grid.corners(asked)
        weights = corners.astype(np.float32)
        rows = pairs[:, None], cells
        matched = np.einsum("nc,ncs->ns", weights, lesson.matched[rows])
        before = (weights * lesson.steady[rows]).sum(1)
        after = lesson.steady[pairs]
        besides = change_worth(before, after, asked, self._utility, self._grid)
        return np.asarray(matched + besides + lesson.following[pairs])

    def _lesson(self, drive: int, light: int) -> _Lesson:
        """Return what a drive teaches where all light is `light` steps brighter."""
        if (drive, light) not in self._known:
            like = self._grid.relit(light)
            seen, utility = self._drives[drive], self._utility
            moves, steady = seen.moves[:, like][:, :, like], seen.steady[:, like]
            values = move_values(move_worth(moves, steady, utility, self._grid), utility.discount)
            reached = np.concatenate([values[1:].max(2), np.zeros_like(values[:1, 0])])
            self._known[drive, light] = _Lesson(
                matched=utility.of(denoised(moves)),
                steady=denoised(steady),
                following=np.float32(utility.discount) * reached,
            )
        return self._known[drive, light]


def gather(journeys: Sequence[Journey], lessons: Lessons) -> PathSamples:
    """Return the decisions of journeys; those whose effect lies behind the end are left out."""
    rows, asked, answers, start = [], [], [], 0
    for journey in journeys:
        answers.append(lessons.of(journey))
        pose = np.arange(len(answers[-1]))
        rows.append(start + np.stack([np.maximum(pose - back, 0) for back in range(FRAMES)], 1))
        asked.append(journey.used[pose + journey.trip.latency])
        start += len(journey.used)
    used, last = np.concatenate([journey.used for journey in journeys]), np.concatenate(asked)
    return PathSamples(
        frames=torch.from_numpy(np.concatenate([journey.frames for journey in journeys])),
        settings=torch.from_numpy(scale_settings(used[:, 0], used[:, 1])),
        newest_first=torch.from_numpy(np.concatenate(rows)),
        asked=torch.from_numpy(scale_settings(last[:, 0], last[:, 1])),
        values=torch.from_numpy(np.concatenate(answers)),
    )


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
            noise = recipe.noise if number % 2 == 0 else 0.0
            self._own += own_journeys(
                self.network,
                self._training,
                self.grid,
                recipe.own_journeys,
                recipe.chances,
                noise,
                rng,
            )

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
