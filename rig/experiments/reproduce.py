"""The experiments behind the published tables and figures, by name.

An experiment is a function that takes a `Job` and returns values for JSON, and one that makes words
of these. A new one is a module and one line of ITEMS; its module is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from rig.core.errors import UsageError


@dataclass(frozen=True, slots=True)
class Item:
    """One experiment: what it shows, the module, and its functions there.

    `run` is called with a Job and returns values for JSON; `words` with these values and returns
    what a person reads; `draw`, where there is one, with these values and returns an SVG.
    """

    shows: str
    module: str
    run: str
    words: str = "words"
    draw: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What an experiment came to: values for JSON, words as Markdown, an SVG or nothing."""

    values: dict[str, Any]
    words: str
    svg: str


ITEMS: Mapping[str, Item] = {
    "rival-tuning": Item(
        "every rival's free parameters, swept on training worlds", "rig.experiments.tuning", "tune"
    ),
    "search-quality": Item(
        "how near each search comes to the best of a dense grid, in how many frames",
        "rig.experiments.searches",
        "search_quality",
        "words_of_quality",
    ),
    "light-step": Item(
        "frames to converge after the light grows tenfold",
        "rig.experiments.searches",
        "light_step",
        "words_of_steps",
    ),
    "metric-paths": Item(
        "tables 4.2 to 4.4, figs. 3.1 and 4.8: what each image metric's choice is worth",
        "rig.experiments.metric_paths",
        "compare",
        draw="draw",
    ),
    "table-4.1": Item(
        "parameters and forward passes of the networks, on one core of this machine",
        "rig.experiments.forward_times",
        "measure",
    ),
    "table-5.1": Item(
        "single-parameter network, AE, AE+AG and three variants of Shin in static light",
        "rig.experiments.chapter5",
        "table_5_1",
    ),
    "table-5.2": Item(
        "single-parameter network, AE and Shin in tunnels", "rig.experiments.chapter5", "table_5_2"
    ),
    "fig-5.7": Item(
        "networks of four ways to make targets in static light",
        "rig.experiments.chapter5",
        "fig_5_7",
        draw="draw",
    ),
    "fig-5.8": Item(
        "networks of four ways to make targets in tunnels",
        "rig.experiments.chapter5",
        "fig_5_8",
        draw="draw",
    ),
    "table-5.3": Item(
        "dual-parameter network, AE+AG and Shin in static light",
        "rig.experiments.chapter5",
        "table_5_3",
    ),
    "table-5.4": Item(
        "dual-parameter network, AE+AG and Shin in tunnels", "rig.experiments.chapter5", "table_5_4"
    ),
    "table-5.5": Item(
        "frames that odometry used on whole routes, alpha 0.5 and 0.33",
        "rig.experiments.chapter5",
        "table_5_5",
    ),
    "fig-5.9": Item(
        "what four ways to make targets ask for along a drive through an underpass",
        "rig.experiments.target_profiles",
        "profiles",
        draw="draw",
    ),
    "fig-4.7": Item(
        "whether more features in a picture give a better pose",
        "rig.experiments.feature_count",
        "measure",
        draw="draw",
    ),
}
"""Every experiment under the name by which `rig reproduce --only` finds it."""


@dataclass(frozen=True, slots=True)
class Job:
    """What an experiment is given: a folder of its own, how much to do, and whom to tell.

    `folder` exists; what it holds from a run that was cut short may be used. `quick` asks for the
    smallest run that shows the same. `processes` None is one a core.
    """

    folder: Path
    quick: bool
    processes: int | None
    say: Callable[[str], None]
    advance: Callable[[int, int], None]


def find_item(name: str) -> Item:
    """Return an experiment; raises UsageError for a name that there is not."""
    if name in ITEMS:
        return ITEMS[name]
    close = get_close_matches(name, ITEMS, 1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    raise UsageError(f"no experiment is called {name!r}; {hint}known: {', '.join(ITEMS)}")


def run_item(name: str, job: Job) -> Outcome:
    """Run an experiment."""
    item = find_item(name)
    module = import_module(item.module)
    values: dict[str, Any] = getattr(module, item.run)(job)
    svg = getattr(module, item.draw)(values) if item.draw else ""
    return Outcome(values, getattr(module, item.words)(values), svg)
