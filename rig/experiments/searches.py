"""How well searches find the best settings of a scene that stands still, and how fast all follow.

Quality: every search looks at still places of a training drive until it rests. Its own metric, as
its controller measures it, is then compared with the best of a dense grid over the settings that
the search may choose. Light step: every controller looks at the underpass while
its light grows tenfold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.bulk import Workers, run_all
from rig.controllers.registry import make_controller
from rig.controllers.split import brightness_us
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.drivers.registry import open_source
from rig.drivers.scenes.scene import View
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.program import ExposureProgram
from rig.drivers.simulated.source import SimulatedSource
from rig.experiments.reproduce import Job
from rig.vision.metrics import mean_dn

PLACES = {"street": 12, "underpass": 50, "plaza": 105}
"""Pairs of the training drive `tunnel` seed 0."""

FRAMES_MAX = 200
LOOKS = 5
"""Frames over which the metric at the place of rest is averaged: one has its own noise."""

CANDIDATES = 8


@dataclass(frozen=True, slots=True)
class Searcher:
    """A search, what it maximises, where it may look, and how many frames its authors take."""

    spec: str
    metric: str
    grid: Callable[[int, int], Iterable[Settings]]
    budget: int | None


def _rectangle(highest_db: float) -> Callable[[int, int], Iterable[Settings]]:
    def settings(exposures: int, gains: int) -> Iterable[Settings]:
        for exposure_us in np.geomspace(*THESIS_LIMITS.exposure_us, exposures):
            for gain_db in np.linspace(THESIS_LIMITS.gain_db[0], highest_db, gains):
                yield Settings(float(exposure_us), float(gain_db))

    return settings


def _line(exposures: int, gains: int) -> Iterable[Settings]:
    for share in np.linspace(0, 1, exposures * 4):
        shortest_us, longest_us = THESIS_LIMITS.exposure_us
        exposure_us = shortest_us * (longest_us / shortest_us) ** share
        yield Settings(float(exposure_us), float(share * THESIS_LIMITS.gain_db[1]))


SEARCHERS = (
    Searcher("shin", "score", _rectangle(30.0), 50),
    Searcher("shin:evaluations_max=50", "score", _rectangle(30.0), 50),
    Searcher("kim", "metric", _rectangle(12.0), 10),
    Searcher("kim:evaluations_max=15,alpha=10,length=2.5,ridge=3", "metric", _rectangle(12.0), 10),
    Searcher("lu", "entropy_bits", _line, None),
)


class StillCamera:
    """One simulated camera that looks from one place for ever."""

    def __init__(self, source: SimulatedSource, pair: int) -> None:
        lens = source.scene.intrinsics("primary")
        self._model = source.drive.model
        self._sensor = Sensor(self._model, (lens.height_px, lens.width_px), seed=0)
        self._view: View = source.scene.view("primary", source.drive.scene_time_s(pair))
        self._taken = 0

    def take(self, used: Settings, light: float = 1.0) -> Frame:
        """Return a frame taken with `used` in `light` times the light, with noise of its own."""
        radiance = self._view.exposed(used.exposure_us) * np.float32(light)
        image = self._sensor.develop(radiance, used, self._taken)
        self._taken += 1
        return Frame(image, self._model.picture.format, self._taken, 0, 0, used)

    def program(self) -> ExposureProgram:
        """Return how the camera rounds commands."""
        return ExposureProgram(self._model.controls, 0)


@dataclass(frozen=True, slots=True)
class Trial:
    """One search at one place."""

    searcher: int
    place: str
    size: str
    grid: tuple[int, int]


def search_quality(job: Job) -> dict[str, Any]:
    """Return how near each search comes at each place."""
    size, grid = ("320x240", (12, 5)) if job.quick else ("640x480", (40, 16))
    places = ["underpass"] if job.quick else list(PLACES)
    trials = [Trial(i, place, size, grid) for i in range(len(SEARCHERS)) for place in places]
    rows = []
    for row in run_all(try_search, trials, Workers(job.processes)):
        rows.append(row)
        job.advance(len(rows), len(trials))
    rows.sort(key=lambda row: (row["controller"], row["place"]))
    return {"schema": "rig.search-quality/1", "size": size, "grid": list(grid), "trials": rows}


def try_search(trial: Trial) -> dict[str, Any]:
    """Return what one search found at one place, beside the best of the grid."""
    searcher = SEARCHERS[trial.searcher]
    address = f"sim:tunnel?split=train&seed=0&size={trial.size}"
    with closing(open_source(address, seed=0)) as source:
        assert isinstance(source, SimulatedSource)
        camera = StillCamera(source, PLACES[trial.place])
        found, frames, held = _search(camera, searcher)
        measure = _measurer(searcher)
        reached = float(np.mean([measure(camera.take(found)) for _ in range(LOOKS)]))
        best, worst = _extremes(camera, measure, list(searcher.grid(*trial.grid)))
    return {
        "controller": searcher.spec,
        "place": trial.place,
        "held": held,
        "frames": frames,
        "budget": searcher.budget,
        "exposure_us": found.exposure_us,
        "gain_db": found.gain_db,
        "metric": reached,
        "best": best,
        "worst": worst,
        "miss": (best - reached) / (best - worst),
    }


def _extremes(
    camera: StillCamera, measure: Callable[[Frame], float], grid: list[Settings]
) -> tuple[float, float]:
    """Return the best and the worst metric on a grid.

    The best of many noisy numbers is a lucky one: the first few are measured again.
    """
    metrics = np.array([measure(camera.take(settings)) for settings in grid])
    first = np.argsort(-metrics)[:CANDIDATES]
    means = [np.mean([measure(camera.take(grid[i])) for _ in range(LOOKS)]) for i in first]
    return float(max(means)), float(metrics.min())


def _search(camera: StillCamera, searcher: Searcher) -> tuple[Settings, int, bool]:
    """Return where a search rests, after how many frames, and whether it rests at all."""
    controller = make_controller(searcher.spec, seed=0, networks={}).controller
    program = camera.program()
    program.ask(controller.reset(THESIS_LIMITS))
    for frames in range(1, FRAMES_MAX + 1):
        program.ask(controller.step(camera.take(program.next_exposure())))
        if controller.diagnostics()["phase"] == "hold":
            return program.next_exposure(), frames, True
    return program.next_exposure(), FRAMES_MAX, False


def _measurer(searcher: Searcher) -> Callable[[Frame], float]:
    """Return what measures a frame as the searching controller does."""

    def measure(frame: Frame) -> float:
        controller = make_controller(searcher.spec, seed=0, networks={}).controller
        controller.reset(THESIS_LIMITS)
        controller.step(frame)
        return float(controller.diagnostics()[searcher.metric])

    return measure


def words_of_quality(values: Mapping[str, Any]) -> str:
    """Return the trials as Markdown."""
    lines = [
        "| search | place | frames | authors' budget | rests at | metric | best of grid | miss |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in values["trials"]:
        budget = row["budget"] or "none published"
        rests = f"{row['exposure_us']:.0f} us, {row['gain_db']:.1f} dB"
        lines.append(
            f"| `{row['controller']}` | {row['place']} | {row['frames']} | {budget} | {rests} "
            f"| {row['metric']:.4g} | {row['best']:.4g} | {100 * row['miss']:.1f} % |"
        )
    return "\n".join(lines)


STEP_PLACE, STEP_FACTOR = "underpass", 10.0
STEP_PAIR, LATE_STEP_PAIR = 30, 250
"""The light grows early, as in `light_step=10@30`, and when even the slowest has settled."""

FRAMES_AFTER, QUICK_FRAMES_AFTER = 250, 90
STEADY_EV = 0.25
LAST_FRAMES = 10
FOLLOWERS = (
    "ae",
    "aeag",
    "aeag:preset=vendor",
    "mean-30",
    "mean-50",
    "mean-70",
    "geomean",
    "lu",
    "shim:version=2014",
    "shim:version=2018",
    "zhang",
    "kim",
    "shin",
)


def light_step(job: Job) -> dict[str, Any]:
    """Return how many frames each controller takes to follow tenfold light."""
    after = QUICK_FRAMES_AFTER if job.quick else FRAMES_AFTER
    pieces = [(spec, after) for spec in FOLLOWERS]
    rows = []
    for row in run_all(_follow, pieces, Workers(job.processes)):
        rows.append(row)
        job.advance(len(rows), len(pieces))
    rows.sort(key=lambda row: FOLLOWERS.index(row["controller"]))
    return {"schema": "rig.light-step/2", "factor": STEP_FACTOR, "controllers": rows}


def _follow(piece: tuple[str, int]) -> dict[str, Any]:
    """Return how one controller followed the light, early and late."""
    spec, after = piece
    with closing(open_source("sim:tunnel?split=train&seed=0&size=320x240", seed=0)) as source:
        assert isinstance(source, SimulatedSource)
        camera = StillCamera(source, PLACES[STEP_PLACE])
        early, _ = _watch(spec, camera, STEP_PAIR, STEP_PAIR + after)
        late, means = _watch(spec, camera, LATE_STEP_PAIR, LATE_STEP_PAIR + after)
    return {
        "controller": spec,
        "frames_to_converge": frames_to_converge(early, STEP_PAIR),
        "frames_once_settled": frames_to_converge(late, LATE_STEP_PAIR),
        "settles_before": frames_to_converge(late[:LATE_STEP_PAIR], 0) is not None,
        "mean_before_dn": means[LATE_STEP_PAIR - 1],
        "mean_after_dn": means[-1],
    }


def _watch(
    spec: str, camera: StillCamera, step: int, frames: int
) -> tuple[tuple[Settings, ...], list[float]]:
    """Return the settings used and the means seen, of a drive that the light changes at `step`."""
    controller = make_controller(spec, seed=0, networks={}).controller
    program = camera.program()
    program.ask(controller.reset(THESIS_LIMITS))
    used: list[Settings] = []
    means: list[float] = []
    for pair in range(frames):
        light = STEP_FACTOR if pair >= step else 1.0
        frame = camera.take(program.next_exposure(), light)
        used.append(frame.used)
        means.append(mean_dn(frame.image))
        program.saw(frame.image)
        program.ask(controller.step(frame))
    return tuple(used), means


def frames_to_converge(used: tuple[Settings, ...], step: int) -> int | None:
    """Return after how many frames from the step on brightness stays within a quarter stop.

    The settings of the last frame are where it went; None when the last ten still move.
    """
    stops = np.log2([brightness_us(settings) for settings in used])
    near = np.abs(stops - stops[-1]) <= STEADY_EV
    away = np.flatnonzero(~near)
    first = int(away[-1]) + 1 if away.size else 0
    if first > len(used) - LAST_FRAMES:
        return None
    return max(first - step, 0)


def words_of_steps(values: Mapping[str, Any]) -> str:
    """Return the followers as Markdown."""
    lines = [
        f"| controller | frames, light at pair {STEP_PAIR} | at pair {LATE_STEP_PAIR} "
        "| mean before | mean at the end |",
        "|---|---|---|---|---|",
    ]
    for row in values["controllers"]:
        early, late = (
            "does not settle" if row[key] is None else str(row[key])
            for key in ("frames_to_converge", "frames_once_settled")
        )
        unsettled = "" if row["settles_before"] else ", from motion"
        lines.append(
            f"| `{row['controller']}` | {early} | {late}{unsettled} "
            f"| {row['mean_before_dn']:.0f} | {row['mean_after_dn']:.0f} |"
        )
    return "\n".join(lines)
