"""Random search of the training's own parameters on held-back worlds (thesis 4.2.5)."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from rig.core.errors import ModelError, UsageError
from rig.models.dataset import Samples
from rig.models.fit import Fit, Progress, Recipe

LEARNING_RATES = (3e-5, 3e-3)
BATCH_SIZES = (32, 64, 128)


def draw_recipe(recipe: Recipe, trial: int) -> Recipe:
    """Return the recipe of one trial; the first is the given one, others come from its seed."""
    if trial == 0:
        return recipe
    rng = np.random.default_rng([recipe.seed, trial])
    low, high = LEARNING_RATES
    rate = float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.2g}")
    return replace(recipe, learning_rate=rate, batch_size=int(rng.choice(BATCH_SIZES)))


def best_recipe(
    recipe: Recipe,
    trials: int,
    training: Samples,
    validation: Samples,
    log: Path,
    progress: Progress,
) -> Recipe:
    """Train `trials` networks and return the recipe with the smallest held-back loss.

    Each ends as `recipe` says. Finished trials are lines of `log`: an interrupted search goes on.
    Raises UsageError when nothing is held back to judge them by.
    """
    if trials < 1 or not len(validation):
        raise UsageError("--search needs at least 1 trial and a world to hold back")
    losses = _read(log)
    for trial in range(trials):
        tried = draw_recipe(recipe, trial)
        name = f"{tried.learning_rate:g} {tried.batch_size}"
        if name not in losses:
            losses[name] = _loss(tried, training, validation, progress)
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps([name, losses[name]]) + "\n")
    drawn = [draw_recipe(recipe, trial) for trial in range(trials)]
    return min(drawn, key=lambda tried: losses[f"{tried.learning_rate:g} {tried.batch_size}"])


def _loss(recipe: Recipe, training: Samples, validation: Samples, progress: Progress) -> float:
    """Return the best held-back loss of one training; one that diverges loses."""
    with torch.random.fork_rng():
        fit = Fit(recipe)
        try:
            while not fit.finished:
                fit.epoch(training, validation, progress)
        except ModelError:
            return math.inf
    return min(loss.validation for loss in fit.history if loss.validation is not None)


def _read(log: Path) -> dict[str, float]:
    if not log.exists():
        return {}
    try:
        return dict(json.loads(line) for line in log.read_text(encoding="utf-8").splitlines())
    except ValueError as error:
        raise ModelError(f"{log}: no log of a search ({error}); delete it") from error
