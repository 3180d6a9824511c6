"""A small recorded run in memory: a textured wall, a dark stretch, a quick and a slow camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.types import (
    Decision,
    Frame,
    Intrinsics,
    Lost,
    Pair,
    PairRecord,
    Settings,
    Truth,
)
from rig.record.header import RunHeader

WIDTH_PX, HEIGHT_PX = 320, 240
PERIOD_NS = 100_000_000
STEP_PX = 3
LAG_PAIRS = Pair(1, 6)


@dataclass
class SyntheticRun:
    """Implements what the evaluation needs of a recording.

    `lost` maps a trigger to why its secondary frame did not come.
    """

    triggers: int = 30
    names: Pair[str] = Pair("ours", "aeag")
    cameras: str = "sim:tunnel?split=test&seed=0"
    lost: Mapping[int, str] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)
    seed: int = 0

    @property
    def header(self) -> RunHeader:
        intrinsics = Intrinsics(WIDTH_PX, HEIGHT_PX, 282.0, 282.0, 160.0, 120.0)
        return RunHeader(
            command="rig race ours aeag",
            cameras=self.cameras,
            seed=self.seed,
            world_version="wall/1" if self.cameras.startswith("sim:") else "",
            versions={"rig": "0.1.0", "numpy": np.__version__},
            git="0123abc",
            serials=Pair("SIM-0", "SIM-1"),
            intrinsics=Pair(intrinsics, intrinsics),
            controllers=self.names,
            options=dict(self.options),
            models={"ours": "ab" * 32},
        )

    def records(self) -> Iterator[PairRecord]:
        wall = _wall(WIDTH_PX + STEP_PX * self.triggers + 8, HEIGHT_PX, self.seed)
        for trigger in range(self.triggers):
            yield self._record(trigger, wall)

    def _record(self, trigger: int, wall: NDArray[np.float32]) -> PairRecord:
        used = Pair(*(Settings(self._exposure_us(trigger - lag), 3.0 * lag) for lag in LAG_PAIRS))
        frames = Pair(*(self._frame(trigger, wall, settings, i) for i, settings in enumerate(used)))
        cause = self.lost.get(trigger, "")
        secondary = Lost(trigger, cause) if cause else frames.secondary
        return PairRecord(
            trigger=trigger,
            pose_index=trigger,
            asked=used,
            applied=used,
            shot=Pair(frames.primary, secondary),
            decisions=Pair(*(self._decision(trigger, i) for i in range(2))),
            offset_ns=None if cause else 1_500,
            cause=cause,
            truth=Truth((0.0, 0.0, 0.1 * trigger), (0.0, 0.0, 0.0, 1.0), self._light(trigger)),
        )

    def _light(self, trigger: int) -> float:
        dark = 0.4 * self.triggers <= trigger < 0.75 * self.triggers
        return 60.0 if dark else 3_000.0

    def _exposure_us(self, trigger: int) -> float:
        return min(1_000.0 * 3_000.0 / self._light(trigger), 20_000.0)

    def _frame(self, trigger: int, wall: NDArray[np.float32], used: Settings, side: int) -> Frame:
        rng = np.random.default_rng([self.seed, trigger, side])
        left = STEP_PX * trigger + 4 * side
        view = wall[:, left : left + WIDTH_PX]
        bright = self._light(trigger) * used.exposure_us / 3.0e6 * view
        noisy = bright + rng.normal(0.0, 2.0 + used.gain_db / 6.0, bright.shape)
        image = np.clip(noisy, 0, 255).astype(np.uint8)
        time_ns = trigger * PERIOD_NS + 1_500 * side
        return Frame(image, "bayer_rggb8", trigger, time_ns, time_ns, used)

    def _decision(self, trigger: int, side: int) -> Decision:
        command = Settings(self._exposure_us(trigger), 3.0 * LAG_PAIRS[side])
        phase = "search" if self._light(trigger) < 100.0 else "hold"
        thoughts = {"answer": trigger / 10 + side, "phase": phase}
        return Decision(self.names[side], command, 1.0 + side + trigger / 10, thoughts)


def _wall(width_px: int, height_px: int, seed: int) -> NDArray[np.float32]:
    """Return a mosaicked wall of coloured rectangles, float32 H x W in 8-bit values."""
    rng = np.random.default_rng(seed)
    wall = np.full((height_px, width_px, 3), 110, np.uint8)
    for _ in range(width_px * height_px // 120):
        x, y = int(rng.integers(width_px)), int(rng.integers(height_px))
        w, h = (int(v) for v in rng.integers(4, 22, 2))
        colour = tuple(int(v) for v in np.clip(rng.normal(110, 45) + rng.normal(0, 25, 3), 0, 230))
        cv2.rectangle(wall, (x, y), (x + w, y + h), colour, -1)
    mosaic = wall[:, :, 1].copy()
    mosaic[0::2, 0::2] = wall[0::2, 0::2, 2]
    mosaic[1::2, 1::2] = wall[1::2, 1::2, 0]
    return mosaic.astype(np.float32)
