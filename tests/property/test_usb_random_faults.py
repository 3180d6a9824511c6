"""Random faults in random order: every loss is named, and no pair is ever put together wrongly."""

from __future__ import annotations

import random
import struct
from collections import Counter
from contextlib import closing
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from plane_scene import HEIGHT_PX, WIDTH_PX
from served_pair import MODEL
from usb3.opening import needs_usb, plugged
from usb3.pair import UsbCamera, UsbPair, reach_in_step

from rig.core.types import Frame, Pair, Settings
from rig.drivers.aravis.session import PairSpec
from rig.drivers.aravis.source import Surroundings, open_pair
from rig.drivers.simulated.gige.server import PairPlan
from rig.pair import CameraPair, both_frames

pytestmark = needs_usb

TRIGGERS = 120
AWAY_TRIGGERS = 2
BACK_WITHIN_TRIGGERS = 4


def labelled(sequence: int, used: Settings) -> NDArray[np.uint8]:
    """Return a picture that says which trigger began it, and which exposure it has."""
    picture = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
    label = struct.pack("<II", sequence, round(used.exposure_us))
    picture[0, : len(label)] = np.frombuffer(label, np.uint8)
    return picture


def label_of(frame: Frame) -> tuple[int, int]:
    sequence, exposure_us = struct.unpack("<II", frame.image[0, :8].tobytes())
    return sequence, exposure_us


@dataclass
class Mischief:
    """Does something to a pair before some triggers; says what must be lost by it."""

    pair: UsbPair
    chance: random.Random
    away: UsbCamera | None = None
    returns_at: int = 0

    def before(self, trigger: int) -> bool:
        """Return whether this trigger must lose its pair."""
        if self.away is not None:
            return not self._is_back(trigger)
        if self.chance.random() > 0.3:
            return False
        primary, secondary = self.pair.cameras
        either = self.chance.choice([primary, secondary])
        kind = self.chance.choice(["edge", "ignored", "picture", "short", "cable"])
        if kind == "edge":
            secondary.faults.lose_edges = 1
        elif kind == "ignored":
            either.faults.ignore_triggers = 1
        elif kind == "picture":
            either.faults.lose_pictures = 1
        elif kind == "short":
            either.short_pictures = 1
        else:
            either.plug.pull()
            self.away, self.returns_at = either, trigger + AWAY_TRIGGERS
        return True

    def _is_back(self, trigger: int) -> bool:
        """Plug the camera in again when it is time; return whether it was."""
        assert self.away is not None
        if trigger < self.returns_at:
            return False
        self.away.wake_up()
        self.away.plug.push()
        self.away = None
        return True


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_pair_is_put_together_wrongly(seed: int) -> None:
    chance, causes = random.Random(seed), Counter[str]()
    plan = PairPlan(MODEL, WIDTH_PX, HEIGHT_PX, Pair(labelled, labelled))
    with plugged(plan) as pair:
        spec, reach = PairSpec(pair.labels, rate_hz=None), reach_in_step(pair)
        with closing(open_pair(spec, Surroundings("usb:test"), reach=reach)) as source:
            rig, mischief = CameraPair(source), Mischief(pair, chance)
            segments, may_be_late = source.segments.number, 0
            for trigger in range(TRIGGERS):
                was_away = mischief.away is not None
                must_lose = mischief.before(trigger)
                asked = Pair(*(Settings(chance.randint(200, 3_000), 0.0) for _ in range(2)))
                rig.apply(asked)
                shot = rig.shoot()
                frames = both_frames(shot)
                causes[shot.cause] += 1
                may_be_late = BACK_WITHIN_TRIGGERS if was_away else may_be_late - 1
                if frames is None:
                    assert must_lose or may_be_late > 0, shot.cause
                    continue
                assert not must_lose
                for frame, settings in zip(frames, asked, strict=True):
                    assert (frame.sequence, frame.used) == (trigger, settings)
                    assert label_of(frame)[1] == settings.exposure_us
                assert label_of(frames.primary)[0] == label_of(frames.secondary)[0]
            assert source.segments.number > segments
    assert sum(causes.values()) == rig.triggers == TRIGGERS
    assert causes[""] > TRIGGERS // 3
