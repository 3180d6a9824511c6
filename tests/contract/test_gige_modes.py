"""The other ways to start frames, and the same race on either side of the network."""

from __future__ import annotations

import json
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from plane_scene import HEIGHT_PX, WIDTH_PX, PlaneScene
from served_pair import needs_aravis, plane_plan, plane_surroundings, served

from rig.cli.main import run
from rig.core.types import Frame, Pair, PairRecord, Settings
from rig.drivers.aravis.session import Mode, PairSpec
from rig.drivers.aravis.source import AravisSource, Surroundings, open_pair
from rig.drivers.registry import open_source
from rig.drivers.simulated.gige.server import Server
from rig.pair import CameraPair, PairShot
from rig.record.reader import open_recording

pytestmark = needs_aravis


def opened(server: Server, mode: Mode, rate_hz: float | None) -> AravisSource:
    spec = PairSpec(server.addresses, mode=mode, rate_hz=rate_hz)
    return open_pair(spec, Surroundings("gige:test"))


def shoot(pair: CameraPair, exposure_us: float) -> PairShot:
    pair.apply(Pair(Settings(exposure_us, 0.0), Settings(exposure_us, 1.0)))
    return pair.shoot()


def test_both_cameras_triggered_by_software_need_no_wire() -> None:
    with served(plane_plan()) as server:
        server.devices.primary.output_wires.clear()
        with closing(opened(server, "software", None)) as source:
            pair = CameraPair(source)
            for k in range(5):
                frames = shoot(pair, 1_000.0 + k).frames
                for frame in frames:
                    assert isinstance(frame, Frame)
                    assert (frame.sequence, frame.used.exposure_us) == (k, 1_000.0 + k)


def test_free_run_pairs_exposures_of_one_instant() -> None:
    with (
        served(plane_plan()) as server,
        closing(opened(server, "free-run", 20.0)) as source,
    ):
        pair = CameraPair(source)
        assert source.rate_hz is None
        assert source.cameras.primary.limits.exposure_us[1] == pytest.approx(49_500.0)
        shots = [shoot(pair, 2_000.0 + k) for k in range(6)]
        assert [shot.cause for shot in shots] == [""] * 6
        assert all(abs(shot.offset_ns or 0) < 50_000 for shot in shots)
        starts_ns = [shot.frames.primary.device_time_ns for shot in shots]
        periods = np.diff(starts_ns) / 50e6
        assert np.all(np.abs(periods - np.round(periods)) < 0.05)
        assert shots[-1].frames.primary.used.exposure_us >= 2_003.0


def test_truth_is_told_only_where_it_is_known() -> None:
    scene = PlaneScene(20.0)
    surroundings = plane_surroundings("gige:test", scene)
    with served(plane_plan()) as server:
        spec = PairSpec(server.addresses, rate_hz=None)
        with closing(open_pair(spec, surroundings)) as source:
            pair = CameraPair(source)
            shoot(pair, 1_000.0)
            assert source.truth(0) == scene.truth(0.0)
            server.devices.primary.faults.drop_control = True
            time.sleep(0.2)
            while source.segments.number == 1:
                shoot(pair, 1_000.0)
            assert source.truth(pair.triggers - 1) is None  # the pictures begin again


@pytest.mark.parametrize(
    ("options", "poses", "known"),
    [("stand=2@0.3", [0, 0, 1], True), ("mode=free-run", [0, 1, 2], False)],
)
def test_a_served_simulation_tells_what_it_knows(
    options: str, poses: list[int], known: bool
) -> None:
    with closing(open_source(f"gige:sim:wall?size=320x240&{options}", seed=0)) as source:
        assert [source.pose_index(trigger) for trigger in range(3)] == poses
        assert (source.truth(0) is not None) == known


def records(folder: Path) -> list[PairRecord]:
    return list(open_recording(folder).records())


def test_a_race_over_gige_is_the_race_in_process(tmp_path: Path) -> None:
    for scheme in ("sim", "gige:sim"):
        folder = tmp_path / scheme.replace(":", "-")
        address = f"{scheme}:tunnel?size=320x240&seed=3"
        race = ["race", "ours", "shin", "--frames", "6", "--cameras", address]
        assert run([*race, "--out", str(folder), "--quiet"]) == 0
    inside, outside = records(tmp_path / "sim"), records(tmp_path / "gige-sim")
    assert len(inside) == len(outside) == 6
    for one, other in zip(inside, outside, strict=True):
        assert one.asked == other.asked
        for here, there in zip(one.shot, other.shot, strict=True):
            assert isinstance(here, Frame) and isinstance(there, Frame)
            assert here.used == there.used
            assert np.array_equal(here.image, there.image)
    summaries = [
        json.loads((tmp_path / name / "summary.json").read_text()) for name in ("sim", "gige-sim")
    ]
    assert summaries[0]["left"].get("orb") == summaries[1]["left"].get("orb")
    assert summaries[0]["right"].get("orb") == summaries[1]["right"].get("orb")
    assert run(["verify", str(tmp_path / "gige-sim")]) == 0


def test_a_computer_that_is_too_slow_for_free_run_slows_the_cameras_down() -> None:
    def slowly(sequence: int, used: Settings) -> NDArray[np.uint8]:
        time.sleep(0.06)
        return np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)

    with (
        served(plane_plan(take_picture=Pair(slowly, slowly))) as server,
        closing(opened(server, "free-run", 50.0)) as source,
    ):
        pair = CameraPair(source)
        assert any(shoot(pair, 2_000.0 + k).cause == "" for k in range(6))
        assert source.segments.number == 1
