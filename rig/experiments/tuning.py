"""`rival-tuning`: which values of its free parameters serve each rival best, on training worlds.

Every variant drives every training world alone. Its score is the geometric mean, over the worlds,
of sqrt(median / reference median x (min + 20) / (reference min + 20)): both figures count alike, a
factor in one is worth the same factor in the other, and a blind pair (under 20 inliers) is bad but
not infinitely so. The reference of a world is the constant setting of those tried for which that
product is largest. The variant with the largest score is the rival's best.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rig.controllers.registry import make_controller
from rig.core.errors import RigError, UsageError
from rig.drivers.registry import open_source
from rig.drivers.scenes.worlds import NAMES
from rig.experiments.reproduce import Job
from rig.experiments.rivals import CONSTANTS, QUICK, RIVALS, Variants
from rig.experiments.solo import run_solo
from rig.models.workers import in_processes, process_count

MATCHES_SPARED = 20
"""Added to a minimum: the inliers under which a pair is blind."""

VARIANTS_A_PIECE = 24
SECONDS_A_FRAME, SECONDS_A_VIEW = 0.015, 0.06
"""Processor time of a frame of one variant and of a view, 640x480, for the estimate."""
DRIVE_FRAMES = 120


@dataclass(frozen=True, slots=True)
class Plan:
    """What is raced: rivals, worlds with their training seeds, picture size and length."""

    rivals: Mapping[str, Variants]
    constants: Variants
    seeds: Mapping[str, tuple[int, ...]]
    size: str = "640x480"
    frames: int | None = None

    @property
    def variants(self) -> Variants:
        """Return every specification once."""
        return tuple(
            dict.fromkeys((*self.constants, *(s for row in self.rivals.values() for s in row)))
        )

    @property
    def drives(self) -> list[tuple[str, int]]:
        """Return every world with every of its seeds."""
        return [(world, seed) for world, seeds in self.seeds.items() for seed in seeds]


@dataclass(frozen=True, slots=True)
class Piece:
    """Some variants on one drive."""

    world: str
    seed: int
    size: str
    frames: int | None
    specs: Variants


@dataclass(frozen=True, slots=True)
class Race:
    """How one variant did on one drive: a line of the results file."""

    controller: str
    world: str
    seed: int
    size: str
    frames: int | None
    world_version: str
    median: float
    min: int
    blind_frames: int

    @property
    def key(self) -> tuple[str, str, int, str, int | None]:
        """Return what was raced."""
        return self.controller, self.world, self.seed, self.size, self.frames


FULL = Plan(RIVALS, CONSTANTS, {"tunnel": (0, 1, 2, 3, 4), "road": (0, 1, 2)})
SMALL = Plan(QUICK, CONSTANTS[12:18], {"tunnel": (0,)}, size="320x240", frames=40)


def tune(job: Job) -> dict[str, Any]:
    """Run what is not in the results file yet, and return the table as it is in JSON."""
    return tune_plan(SMALL if job.quick else FULL, job)


def tune_plan(plan: Plan, job: Job) -> dict[str, Any]:
    """Run a plan; raises UsageError for a world that there is not, RigError for damaged results."""
    _check_worlds(plan)
    path = job.folder / "rival-tuning.jsonl"
    races = _still_true(_read(path))
    done = {race.key for race in races}
    pieces = _pieces(plan, done)
    processes = process_count(job.processes)
    job.say(_estimate(plan, pieces, len(done), processes))
    finished = 0
    with path.open("a", encoding="utf-8") as file:
        for batch in in_processes(_run, pieces, processes):
            for race in batch:
                file.write(json.dumps(asdict(race)) + "\n")
            file.flush()
            races += batch
            finished += 1
            job.advance(finished, len(pieces))
            job.say(f"{finished} of {len(pieces)} pieces done")
    return table(plan, races)


def table(plan: Plan, races: Iterable[Race]) -> dict[str, Any]:
    """Return the scores of all variants, by rival, and the best of each."""
    found = {race.key: race for race in races}
    by_spec = {
        spec: [found[(spec, world, seed, plan.size, plan.frames)] for world, seed in plan.drives]
        for spec in plan.variants
    }
    reference = [
        max((by_spec[spec][drive] for spec in plan.constants), key=_worth)
        for drive in range(len(plan.drives))
    ]
    rows = {
        rival: sorted(
            (_row(spec, by_spec[spec], reference) for spec in specs),
            key=lambda row: -row["score"],
        )
        for rival, specs in {**plan.rivals, "constant": plan.constants}.items()
    }
    return {
        "schema": "rig.rival-tuning/1",
        "size": plan.size,
        "drives": [
            {
                "world": world,
                "seed": seed,
                "split": "train",
                "world_version": race.world_version,
                "reference": race.controller,
                "median": race.median,
                "min": race.min,
            }
            for (world, seed), race in zip(plan.drives, reference, strict=True)
        ],
        "rivals": rows,
        "best": {rival: variants[0]["controller"] for rival, variants in rows.items()},
    }


def words(values: Mapping[str, Any]) -> str:
    """Return the table as Markdown."""
    lines = [
        "| rival | variant | score | median | min | blind |",
        "|---|---|---|---|---|---|",
    ]
    for rival, variants in values["rivals"].items():
        for place, row in enumerate(variants):
            mark = "**" if place == 0 else ""
            lines.append(
                f"| {rival if place == 0 else ''} | {mark}`{row['controller']}`{mark} "
                f"| {row['score']:.3f} | {row['median']:.0f} | {row['min']:.0f} "
                f"| {row['blind']:.1f} |"
            )
    lines.append("")
    for drive in values["drives"]:
        lines.append(
            f"{drive['world_version']} train seed {drive['seed']}: "
            f"reference `{drive['reference']}`, "
            f"median {drive['median']:.0f}, minimum {drive['min']}"
        )
    return "\n".join(lines)


def _row(spec: str, races: Sequence[Race], reference: Sequence[Race]) -> dict[str, Any]:
    ratios = [_worth(race) / _worth(best) for race, best in zip(races, reference, strict=True)]
    count = len(races)
    return {
        "controller": spec,
        "score": math.prod(ratios) ** (1 / count),
        "median": sum(race.median for race in races) / count,
        "min": sum(race.min for race in races) / count,
        "blind": sum(race.blind_frames for race in races) / count,
    }


def _worth(race: Race) -> float:
    """Return sqrt(median x (min + 20)); a median of 0 counts as 1."""
    return math.sqrt(max(race.median, 1.0) * (race.min + MATCHES_SPARED))


def _pieces(plan: Plan, done: set[tuple[str, str, int, str, int | None]]) -> list[Piece]:
    """Return the work that is left, a few variants of one drive at a time."""
    pieces = []
    for world, seed in plan.drives:
        left = [s for s in plan.variants if (s, world, seed, plan.size, plan.frames) not in done]
        for first in range(0, len(left), VARIANTS_A_PIECE):
            specs = tuple(left[first : first + VARIANTS_A_PIECE])
            pieces.append(Piece(world, seed, plan.size, plan.frames, specs))
    return pieces


def _run(piece: Piece) -> list[Race]:
    """Drive the variants of one piece."""
    controllers = [make_controller(spec, seed=0, networks={}) for spec in piece.specs]
    address = _address(piece.world, piece.seed, piece.size)
    return [
        Race(
            solo.controller,
            piece.world,
            piece.seed,
            piece.size,
            piece.frames,
            solo.world_version,
            solo.median,
            solo.min,
            solo.blind_frames,
        )
        for solo in run_solo(address, controllers, seed=piece.seed, frames=piece.frames)
    ]


def _address(world: str, seed: int, size: str) -> str:
    return f"sim:{world}?split=train&seed={seed}&size={size}"


def _read(path: Path) -> list[Race]:
    """Return the races of a results file; a last line that was cut off is left out."""
    if not path.exists():
        return []
    races = []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            races.append(Race(**json.loads(line)))
        except (ValueError, TypeError) as error:
            raise RigError(f"{path}: line {number} is no result; remove it ({error})") from error
    return races


def _check_worlds(plan: Plan) -> None:
    for world in plan.seeds:
        if world not in NAMES:
            known = ", ".join(NAMES)
            raise UsageError(f"rival-tuning needs the world {world!r}; this version has: {known}")


def _still_true(races: list[Race]) -> list[Race]:
    """Return the races in worlds that are still what they were."""
    versions: dict[str, str] = {}
    for race in races:
        if race.world not in versions:
            versions[race.world] = _world_version(race.world, race.seed)
    return [race for race in races if race.world_version == versions[race.world]]


def _world_version(world: str, seed: int) -> str:
    with closing(open_source(_address(world, seed, "320x240"), seed=seed)) as source:
        return source.world_version


def _estimate(plan: Plan, pieces: Sequence[Piece], done: int, processes: int) -> str:
    frames = plan.frames or DRIVE_FRAMES
    left = sum(len(piece.specs) for piece in pieces)
    width_px, height_px = (int(side) for side in plan.size.split("x"))
    scale = max(width_px * height_px / (640 * 480), 0.5)
    seconds = scale * frames * (left * SECONDS_A_FRAME + len(pieces) * SECONDS_A_VIEW) / processes
    return (
        f"SIMULATED: {len(plan.variants)} variants on {len(plan.drives)} training drives; "
        f"{done} done, {left} left, about {seconds / 60:.0f} min with {processes} processes"
    )
