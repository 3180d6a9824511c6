"""`fig-5.9`: what four ways to make targets ask for along a drive through an underpass.

A leader on the camera's own AE+AG and the four-quadrant perturbation are driven through a training
tunnel, as `rig collect` does; the targets of M_feat at the next pose, windowed M_feat, windowed
M_grid and their hybrid are made from the same recording. How much a profile jumps from pose to pose
is what the thesis calls oscillation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rig.controllers.perturb import make_perturbation
from rig.controllers.policies import CollectPolicy
from rig.controllers.registry import make_controller
from rig.core.clock import SystemClock
from rig.core.types import PairRecord
from rig.drivers.registry import open_source
from rig.experiments.reproduce import Job
from rig.loop import run_pair
from rig.models.measuring import stretches
from rig.models.metrics import METRICS, TargetMetric, Window
from rig.plot import Curve, Curves, svg

WAYS: Mapping[str, tuple[str, Window]] = {
    "feat": ("feat", Window(1)),
    "feat, windowed": ("feat", Window(4)),
    "grid, windowed": ("grid", Window(4)),
    "hybrid, windowed": ("hybrid", Window(4, 0.5)),
}
"""Fig. 5.9 a to d."""

SEED = 0
_DB_PER_STOP = float(20 * np.log10(2))


class _Kept:
    """Keeps records in memory."""

    def __init__(self) -> None:
        self.records: list[PairRecord] = []

    def write(self, record: PairRecord) -> None:
        self.records.append(record)

    def __enter__(self) -> _Kept:
        return self

    def __exit__(self, *_: object) -> None:
        return None


def profiles(job: Job) -> dict[str, Any]:
    """Drive once, 40 pairs of 320x240 when quick, and return each way's targets over the poses."""
    size, frames = ("320x240", 40) if job.quick else ("640x480", None)
    source = open_source(f"sim:tunnel?seed={SEED}&size={size}", seed=SEED, split="train")
    triggers = frames or source.drive_triggers or 0
    job.say(f"SIMULATED: {source.address}, {triggers} pairs")
    leader = make_controller("aeag", seed=SEED, networks={})
    policy = CollectPolicy(leader, make_perturbation("cycle", seed=SEED), SystemClock())
    kept = _Kept()

    def keep_going(done: int) -> bool:
        job.advance(done, triggers)
        return done < triggers

    run_pair(source, policy, kept, keep_going)
    needs = TargetMetric(METRICS["hybrid"].choose, needs_features=True, needs_inliers=True)
    (stretch,) = stretches(kept.records, needs, source.intrinsics)
    found = {name: METRICS[metric].choose(stretch.drive, w) for name, (metric, w) in WAYS.items()}
    return {
        "schema": "rig.target-profiles/1",
        "cameras": source.address,
        "world_version": source.world_version,
        "profiles": {
            name: {
                "exposure_us": targets[:, 0].tolist(),
                "gain_db": targets[:, 1].tolist(),
                "jump_ev": float(np.abs(np.diff(_ev(targets))).mean()),
            }
            for name, targets in found.items()
        },
    }


def words(values: Mapping[str, Any]) -> str:
    """Return how much each profile jumps, as Markdown; the profiles are in the JSON."""
    lines = [f"{values['world_version']}, {values['cameras']}", ""]
    lines += ["| targets | mean change of brightness from pose to pose, stops |", "|---|---|"]
    lines += [f"| {name} | {row['jump_ev']:.3f} |" for name, row in values["profiles"].items()]
    return "\n".join(lines)


def draw(values: Mapping[str, Any]) -> str:
    """Return the profiles of exposure and gain over the poses."""
    profiles = values["profiles"]

    def over_poses(key: str) -> list[Curve]:
        return [Curve(way, range(len(row[key])), row[key]) for way, row in profiles.items()]

    exposures = Curves("Exposure", over_poses("exposure_us"), "pose", "us", log_up=True)
    return svg([exposures, Curves("Gain", over_poses("gain_db"), "pose", "dB")], columns=1)


def _ev(targets: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Any:
    return np.log2(targets[:, 0]) + targets[:, 1] / _DB_PER_STOP
