"""The card of a score-map network."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rig.core.types import THESIS_LIMITS
from rig.models.export import LICENCE
from rig.models.scoremap.closed_loop import LIGHT_POSES
from rig.models.scoremap.fit import PathRecipe
from rig.models.scoremap.paths import DriveSource
from rig.models.scoremap.values import UTILITIES, Utility
from rig.vision.thumbnail import THUMBNAIL_PX

if TYPE_CHECKING:
    from rig.models.scoremap.closed_loop import Score
    from rig.models.scoremap.train import PathTrainingResult

_FOR = {
    "both": "ORB and viso2-style matching alike",
    "orb": "ORB alone",
    "viso2": "viso2-style matching alone",
}

LIMITS = """## Limits

Trained for one simulated camera model, one lens and one aperture: another aperture or sensor moves
the settings that are right (thesis 5.3). It has seen only the kinds of world and the speeds of its
drives. A camera that applies settings later than in the next frame costs it something.
The figures above count matches by ground truth, expect inliers, and interpolate between settings:
they choose between trainings, and only races say how good a network is."""


def write_path_card(result: PathTrainingResult) -> None:
    """Write the card beside the model."""
    sections = (
        _title(result),
        _data(result),
        _remake(result),
        _stages(result),
        _proof(result),
        LIMITS,
    )
    result.card.write_text("\n\n".join(sections) + "\n", encoding="utf-8")


def _title(result: PathTrainingResult) -> str:
    limits, (columns, rows) = THESIS_LIMITS, THUMBNAIL_PX
    return f"""# {result.model.stem}

{_kind(result)} ({result.parameters:,} parameters): three pictures of {columns} x {rows} \
cells, brightness and saturation, and their settings in; it scores a grid of settings and gives \
exposure time and gain of the next frame, for {_FOR[result.recipe.utility.front_end]}. \
Exposure {limits.exposure_us[0]:g} to {limits.exposure_us[1]:g} us, gain {limits.gain_db[0]:g} to \
{limits.gain_db[1]:g} dB.
Licence: {LICENCE}."""


def _kind(result: PathTrainingResult) -> str:
    count = len(result.members)
    if count == 1:
        return f"A `{result.net}` network"
    return f"{count} `{result.net}` networks whose probabilities are averaged"


def _data(result: PathTrainingResult) -> str:
    training = "\n".join(_described(source) for source in result.split.training)
    held_back = "\n".join(_described(source) for source in result.split.held_back)
    return f"""## Data

Every setting of a grid at every pose of:

{training}

The stage to keep was chosen on:

{held_back or "- nothing: there was only one world, so the last stage was kept"}
{_begun(result)}
Digest of the drives: `{result.training_sha256}`"""


def _begun(result: PathTrainingResult) -> str:
    begun = result.beginning
    if begun is None:
        return ""
    return f"""
It went on from the weights of `{begun.name}`, sha256 `{begun.sha256}`; what those were made from
is on the card of that file.
"""


def _described(source: DriveSource) -> str:
    test = "split=test" in source.cameras
    warning = " **A test world: results on test worlds prove nothing.**" if test else ""
    where = f"`{source.cameras}`, {source.world_version}, {_poses(source)}"
    return f"- {where}, sha256 `{source.sha256}`.{warning}"


def _remake(result: PathTrainingResult) -> str:
    recipe = result.recipe
    sources = [*result.split.training, *result.split.held_back]
    stretches = sorted({(each.first_pose, each.poses) for each in sources})
    files = [_file(*stretch) for stretch in stretches]
    targets = "\n".join(_targets(sources, *stretch) for stretch in stretches)
    held_back = "".join(f"--hold-back {shlex.quote(s.name)} " for s in result.split.held_back)
    options = "--half " if result.half else ""
    if result.beginning is not None:
        options += f"--begin-with {shlex.quote(result.beginning.name)} "
    if recipe.learning_rates[0] != PathRecipe().learning_rates[0]:
        options += f"--learning-rate {recipe.learning_rates[0]:g} "
    options += _utility_options(recipe.utility)
    if len(result.members) > 1:
        options += f"--members {len(result.members)} "
    steps = " ".join(f"--steps {number}" for number in recipe.steps)
    return f"""## Made with

```sh
{targets}
rig train --net {result.net} {" ".join(files)} --seed {recipe.seed} {steps} \
--batch-size {recipe.batch_size} {options}{held_back}--out {shlex.quote(result.model.name)}
```"""


def _utility_options(utility: Utility) -> str:
    usual = UTILITIES[utility.front_end]
    options = f"--front-end {utility.front_end} " if utility.front_end != "both" else ""
    if utility.discount != usual.discount:
        options += f"--discount {utility.discount:g} "
    if utility.lost_cost != usual.lost_cost:
        options += f"--lost-cost {utility.lost_cost:g} "
    return options


def _targets(sources: Sequence[DriveSource], first: int, poses: int) -> str:
    """Return the command that makes a file of all drives with these poses."""
    alike = [each for each in sources if (each.first_pose, each.poses) == (first, poses)]
    cameras = " ".join(shlex.quote(each.cameras) for each in alike)
    begin = f"--first {first} " if first else ""
    file = _file(first, poses)
    return f"rig targets {cameras} --metric path {begin}--frames {poses} --out {file}"


def _file(first: int, poses: int) -> str:
    return f"paths-{first}-{poses}.npz" if first else f"paths-{poses}.npz"


def _poses(source: DriveSource) -> str:
    begin = f" from {source.first_pose} on" if source.first_pose else ""
    return f"{source.poses} poses{begin}"


def _stages(result: PathTrainingResult) -> str:
    rows = [
        f"| {member.seed} | {number + 1}{' (kept)' if number == member.best_stage else ''} "
        f"| {stage.loss:.4f} | {_reached(stage.held_back)} | {_reached(stage.late)} |"
        for member in result.members
        for number, stage in enumerate(member.history)
    ]
    if len(result.members) > 1:
        rows.append(f"| all | together | - | {_reached(result.together)} | - |")
    table = "\n".join(rows)
    return f"""## Stages

The first learns from random behaviours, the others from the network's own drives as well.
{_trips(result)}

| seed | stage | loss | held back, in closed loop: median / minimum of ORB's matches \
(expected viso2-style inliers, and motions lost that another setting tells) of each drive | \
the same, {max(result.recipe.chances.latencies)} frames late |
|---|---|---|---|---|
{table}"""


def _trips(result: PathTrainingResult) -> str:
    chances = result.recipe.chances
    latencies = ", ".join(map(str, chances.latencies))
    return (
        f"Settings took effect {latencies} frames late, each as likely. In {100 * chances.relit:g} "
        f"% of the drives the light changed every {LIGHT_POSES} poses, by {chances.darkest} to "
        f"{chances.brightest} steps of exposure."
    )


def _reached(scores: Sequence[Score]) -> str:
    return (
        ", ".join(
            f"{one.median:.0f} / {one.min:.0f} ({one.other_median:.0f} / {one.other_min:.0f}, "
            f"{100 * one.lost:.1f} %)"
            for one in scores
        )
        or "-"
    )


def _proof(result: PathTrainingResult) -> str:
    parity = result.parity
    half = (
        f" Storing the weights in half precision moved answers by at most "
        f"{parity.half_difference:.1e}."
        if result.half
        else ""
    )
    return f"""## Proof of export

Largest difference from the trained network {parity.difference:.1e}, over samples whose answers
range over {parity.spread:.2f} of the limits.{half}"""
