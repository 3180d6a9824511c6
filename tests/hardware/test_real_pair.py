"""What only real cameras can prove. Point them at a lit scene with nothing moving, then

    RIG_CAMERAS=aravis:18284899,18284900 .venv/bin/python -m pytest -m hardware

Any address does, such as gige:sim:wall to try these tests themselves.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from rig.core.protocols import Source
from rig.core.types import Auto, Frame, Limits, Pair, Settings
from rig.drivers.registry import open_source
from rig.experiments.latency import measure
from rig.pair import CameraPair, both_frames

pytestmark = pytest.mark.hardware

TRIGGERS = 100
FARTHEST_APART_NS = 100_000
"""Opto-couplers take up to 36 us, the shortest trigger delay 8 us (vendor's tables)."""


@pytest.fixture
def source() -> Iterator[Source]:
    address = os.environ.get("RIG_CAMERAS")
    assert address, "name the cameras: RIG_CAMERAS=aravis:PRIMARY,SECONDARY"
    with closing(open_source(address, seed=0)) as opened:
        yield opened


def shoot(pair: CameraPair) -> Pair[Frame]:
    shot = pair.shoot()
    frames = both_frames(shot)
    assert frames is not None, shot.cause
    return frames


def test_every_command_reaches_the_next_frame(source: Source) -> None:
    pair = CameraPair(source)
    for k in range(TRIGGERS):
        asked = Pair(Settings(500.0 + 20 * k, k % 10), Settings(2_500.0 - 20 * k, (k + 5) % 10))
        applied = pair.apply(asked)
        for frame, command, wanted in zip(shoot(pair), applied, asked, strict=True):
            assert isinstance(command, Settings)
            assert abs(frame.used.exposure_us - command.exposure_us) <= 1.0
            assert abs(frame.used.gain_db - command.gain_db) <= 0.1
            assert abs(command.exposure_us - wanted.exposure_us) <= 10.0


def test_exposures_begin_together_whatever_the_settings(source: Source) -> None:
    pair, offsets_ns = CameraPair(source), []
    for k in range(TRIGGERS):
        pair.apply(Pair(*(Settings(us, 0.0) for us in (200.0 + 97 * k, 9_900.0 - 97 * k))))
        primary, secondary = shoot(pair)
        offsets_ns.append(secondary.device_time_ns - primary.device_time_ns)
    assert np.abs(offsets_ns).max() < FARTHEST_APART_NS


def test_pictures_change_when_the_camera_says_so(source: Source) -> None:
    *_, found = measure(source, 20)
    for camera in found:
        assert camera.frames == {0: 20}
        assert camera.disputed == 0


def test_the_cameras_own_exposure_control_works_under_trigger(source: Source) -> None:
    pair = CameraPair(source)
    limits = Limits((100.0, 20_000.0), (0.0, 10.0))
    auto = Auto(limits, target_dn=100.0, start=Settings(100.0, 0.0))
    pair.apply(Pair(auto, auto))
    used = [shoot(pair).primary.used for _ in range(40)]
    assert used[0].exposure_us <= 200.0
    assert used[-1].exposure_us > 2 * used[0].exposure_us
    assert all(limits.exposure_us[0] - 1 <= u.exposure_us <= 20_001.0 for u in used)
