"""`rival-tuning`: which values of its free parameters serve each rival best, on training worlds.

Every variant drives some training worlds alone, in heats, and the best of each rival then drive the
others. A variant's score is the geometric mean, over the worlds,
of sqrt(median / reference median x (min + 20) / (reference min + 20)): both figures count alike, a
factor in one is worth the same factor in the other, and a blind pair (under 20 inliers) is bad but
not infinitely so. The reference of a world is the constant setting of those tried there for which
that product is largest. The finalist with the largest score over all worlds is the rival's best.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rig.bulk import Workers, run_all
from rig.controllers.registry import make_controller
from rig.core.errors import RigError, UsageError
from rig.drivers.scenes.worlds import NAMES
from rig.evaluation.front_ends import FRONT_ENDS
from rig.experiments.reproduce import Job
from rig.experiments.rivals import CONSTANTS, QUICK, RIVALS, Variants
from rig.experiments.solo import Solo, run_solo, world_version

MATCHES_SPARED = 20
"""Added to a minimum: the inliers under which a pair is blind."""

CONSTANT = "constant"
"""The row of the settings that never change."""

VARIANTS_A_PIECE = 12
SECONDS_A_FRAME, SECONDS_A_VIEW = 0.03, 0.06
"""Processor time of a frame of one variant and of a view, 640x480, for the estimate."""
DRIVE_FRAMES = 120

Drive = tuple[str, int]
"""A world and a seed."""
Key = tuple[str, str, int, str, int | None]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is raced: rivals, training seeds of heats and finals, picture size and length."""

    rivals: Mapping[str, Variants]
    constants: Variants
    heats: Mapping[str, tuple[int, ...]]
    finals: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    finalists: int = 4
    size: str = "640x480"
    frames: int | None = None

    @property
    def rows(self) -> dict[str, Variants]:
        """Return the variants of every rival, and the constants as one more."""
        return {**self.rivals, CONSTANT: self.constants}

    @property
    def variants(self) -> Variants:
        """Return every specification once."""
        return _once(spec for specs in self.rows.values() for spec in specs)

    def key(self, spec: str, drive: Drive) -> Key:
        """Return what names one race of this plan."""
        return spec, *drive, self.size, self.frames


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
    """How one variant did on one drive: a line of the results file; `options` are all it had."""

    controller: str
    world: str
    seed: int
    size: str
    frames: int | None
    world_version: str
    median: float
    min: int
    blind_frames: int
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> Key:
        """Return what was raced."""
        return self.controller, self.world, self.seed, self.size, self.frames


FULL = Plan(
    RIVALS,
    CONSTANTS,
    heats={"tunnel": (0, 1), "road": (0,)},
    finals={"tunnel": (2, 3, 4), "road": (1, 2)},
)
SMALL = Plan(QUICK, CONSTANTS[5:10], heats={"tunnel": (0,)}, size="320x240", frames=40)


def tune(job: Job) -> dict[str, Any]:
    """Run what is not in the results file yet, and return the table as it is in JSON."""
    return tune_plan(SMALL if job.quick else FULL, job)


def tune_plan(plan: Plan, job: Job) -> dict[str, Any]:
    """Run a plan; raises UsageError for a world that there is not, RigError for damaged results."""
    heats, finals = drives(plan.heats), drives(plan.finals)
    _check_worlds((*heats, *finals))
    path = job.folder / "rival-tuning.jsonl"
    races = {race.key: race for race in _still_true(_read(path))}
    _race(plan, job, path, races, plan.variants, heats)
    _race(plan, job, path, races, finalists(plan, races), finals)
    return table(plan, races)


def drives(seeds: Mapping[str, tuple[int, ...]]) -> list[Drive]:
    """Return every world with every of its seeds."""
    return [(world, seed) for world, several in seeds.items() for seed in several]


def finalists(plan: Plan, races: Mapping[Key, Race]) -> Variants:
    """Return the best variants of each rival, and the best constants, by the heats."""
    heats = drives(plan.heats)
    references = _references(plan, races, heats, plan.constants)
    return _once(
        spec
        for specs in plan.rows.values()
        for spec in sorted(specs, key=lambda s: -_score(plan, races, s, heats, references))[
            : plan.finalists
        ]
    )


def table(plan: Plan, races: Mapping[Key, Race]) -> dict[str, Any]:
    """Return the scores of all variants, by rival, and the best of each.

    A variant that is no finalist has a score of the heats only, and comes after those that are.
    """
    heats, finals = drives(plan.heats), drives(plan.finals)
    best = finalists(plan, races)
    references = {
        **_references(plan, races, heats, plan.constants),
        **_references(plan, races, finals, [spec for spec in plan.constants if spec in best]),
    }
    rows = {
        rival: [_row(plan, races, spec, references, final=spec in best) for spec in specs]
        for rival, specs in plan.rows.items()
    }
    for row in rows.values():
        row.sort(key=lambda each: (each["score"] is None, -(each["score"] or each["heats"])))
    return {
        "schema": "rig.rival-tuning/2",
        "size": plan.size,
        "drives": [
            {
                "world": world,
                "seed": seed,
                "split": "train",
                "stage": "heat" if (world, seed) in heats else "final",
                "world_version": race.world_version,
                "reference": race.controller,
                "median": race.median,
                "min": race.min,
            }
            for (world, seed), race in references.items()
        ],
        "rivals": rows,
        "best": {rival: variants[0]["controller"] for rival, variants in rows.items()},
    }


def words(values: Mapping[str, Any]) -> str:
    """Return the table as Markdown."""
    lines = [
        "| rival | variant | score | heats | median | min | blind |",
        "|---|---|---|---|---|---|---|",
    ]
    for rival, variants in values["rivals"].items():
        for place, row in enumerate(variants):
            mark = "**" if place == 0 else ""
            score = "" if row["score"] is None else f"{row['score']:.3f}"
            lines.append(
                f"| {rival if place == 0 else ''} | {mark}`{row['controller']}`{mark} "
                f"| {score} | {row['heats']:.3f} | {row['median']:.0f} | {row['min']:.0f} "
                f"| {row['blind']:.1f} |"
            )
    lines.append("")
    for drive in values["drives"]:
        lines.append(
            f"{drive['world_version']} train seed {drive['seed']}, {drive['stage']}: "
            f"reference `{drive['reference']}`, "
            f"median {drive['median']:.0f}, minimum {drive['min']}"
        )
    return "\n".join(lines)


def _race(
    plan: Plan,
    job: Job,
    path: Path,
    races: dict[Key, Race],
    variants: Variants,
    places: Sequence[Drive],
) -> None:
    """Drive what was not driven yet, and add it to `races` and to the file."""
    pieces = _pieces(plan, races, variants, places)
    workers = Workers(job.processes)
    job.say(_estimate(plan, pieces, variants, places, workers.count))
    with path.open("a", encoding="utf-8") as file:
        for done, batch in enumerate(run_all(_run, pieces, workers), start=1):
            for race in batch:
                file.write(json.dumps(asdict(race)) + "\n")
                races[race.key] = race
            file.flush()
            job.advance(done, len(pieces))
            job.say(f"{done} of {len(pieces)} pieces done")


def _references(
    plan: Plan, races: Mapping[Key, Race], places: Sequence[Drive], constants: Iterable[str]
) -> dict[Drive, Race]:
    """Return the best constant of each drive."""
    specs = list(constants)
    return {
        drive: max((races[plan.key(spec, drive)] for spec in specs), key=_worth) for drive in places
    }


def _score(
    plan: Plan,
    races: Mapping[Key, Race],
    spec: str,
    places: Sequence[Drive],
    references: Mapping[Drive, Race],
) -> float:
    ratios = [_worth(races[plan.key(spec, drive)]) / _worth(references[drive]) for drive in places]
    return math.prod(ratios) ** (1 / len(ratios))


def _row(
    plan: Plan,
    races: Mapping[Key, Race],
    spec: str,
    references: Mapping[Drive, Race],
    *,
    final: bool,
) -> dict[str, Any]:
    heats = drives(plan.heats)
    places = [*heats, *drives(plan.finals)] if final else heats
    driven = [races[plan.key(spec, drive)] for drive in places]
    return {
        "controller": spec,
        "score": _score(plan, races, spec, places, references) if final else None,
        "heats": _score(plan, races, spec, heats, references),
        "median": sum(race.median for race in driven) / len(driven),
        "min": sum(race.min for race in driven) / len(driven),
        "blind": sum(race.blind_frames for race in driven) / len(driven),
    }


def _worth(race: Race) -> float:
    """Return sqrt(median x (min + 20)); a median of 0 counts as 1."""
    return math.sqrt(max(race.median, 1.0) * (race.min + MATCHES_SPARED))


def _pieces(
    plan: Plan, races: Mapping[Key, Race], variants: Variants, places: Sequence[Drive]
) -> list[Piece]:
    """Return the work that is left, a few variants of one drive at a time."""
    pieces = []
    for drive in places:
        left = [spec for spec in variants if plan.key(spec, drive) not in races]
        for first in range(0, len(left), VARIANTS_A_PIECE):
            specs = tuple(left[first : first + VARIANTS_A_PIECE])
            pieces.append(Piece(*drive, plan.size, plan.frames, specs))
    return pieces


def _once(specs: Iterable[str]) -> Variants:
    return tuple(dict.fromkeys(specs))


def _run(piece: Piece) -> list[Race]:
    """Drive the variants of one piece."""
    controllers = [make_controller(spec, seed=0, networks={}) for spec in piece.specs]
    address = _address(piece.world, piece.seed, piece.size)
    orb = {"orb": FRONT_ENDS["orb"]}
    solos = run_solo(address, controllers, seed=piece.seed, frames=piece.frames, front_ends=orb)
    return [_told(piece, solo) for solo in solos]


def _told(piece: Piece, solo: Solo) -> Race:
    statistics = solo.inliers["orb"]
    return Race(
        solo.controller,
        piece.world,
        piece.seed,
        piece.size,
        piece.frames,
        solo.world_version,
        statistics.median or 0.0,
        statistics.min or 0,
        statistics.blind_frames,
        _options(solo.controller),
    )


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


def _check_worlds(places: Iterable[Drive]) -> None:
    for world, _ in places:
        if world not in NAMES:
            known = ", ".join(NAMES)
            raise UsageError(f"rival-tuning needs the world {world!r}; this version has: {known}")


def _still_true(races: list[Race]) -> list[Race]:
    """Return the races in worlds, and of controllers, that are still what they were."""
    versions: dict[str, str] = {}
    for race in races:
        if race.world not in versions:
            versions[race.world] = _world_version(race.world, race.seed)
    return [
        race
        for race in races
        if race.world_version == versions[race.world] and race.options == _options(race.controller)
    ]


def _options(spec: str) -> dict[str, str]:
    return dict(make_controller(spec, seed=0, networks={}).options)


def _world_version(world: str, seed: int) -> str:
    return world_version(_address(world, seed, "320x240"))


def _estimate(
    plan: Plan,
    pieces: Sequence[Piece],
    variants: Variants,
    places: Sequence[Drive],
    processes: int,
) -> str:
    frames = plan.frames or DRIVE_FRAMES
    left = sum(len(piece.specs) for piece in pieces)
    width_px, height_px = (int(side) for side in plan.size.split("x"))
    scale = max(width_px * height_px / (640 * 480), 0.5)
    seconds = scale * frames * (left * SECONDS_A_FRAME + len(pieces) * SECONDS_A_VIEW) / processes
    return (
        f"SIMULATED: {len(variants)} variants on {len(places)} training drives; "
        f"{len(variants) * len(places) - left} done, {left} left, "
        f"about {seconds / 60:.0f} min with {processes} processes"
    )
