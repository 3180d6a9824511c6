"""Addresses: what they open, and how a wrong one is answered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from rig.core.errors import ConfigError, RigError, UsageError
from rig.core.types import Intrinsics, Settings, Side
from rig.drivers.addresses import parse_address
from rig.drivers.registry import open_source
from rig.drivers.scenes import worlds


@dataclass
class StandIn:
    """Takes the place of a baked world and remembers how it was asked for."""

    asked: dict[str, Any]
    drive_s: float = 12.0
    world_version: str = "stand-in/1"

    def intrinsics(self, side: Side) -> Intrinsics:
        return Intrinsics(self.asked["width_px"], self.asked["height_px"], 1.0, 1.0, 0.0, 0.0)

    def view(self, side: Side, time_s: float) -> NoReturn:
        raise AssertionError("an address alone takes no picture")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return what the next opened world is asked for."""
    seen: dict[str, Any] = {}

    def open_world(name: str, **options: Any) -> StandIn:
        seen.update(options, name=name)
        return StandIn(seen)

    monkeypatch.setattr(worlds, "open_world", open_world)
    return seen


def test_defaults_are_written_out_in_order(asked: dict[str, Any]) -> None:
    source = open_source("sim:tunnel", seed=4)
    assert source.address == (
        "sim:tunnel?camera=blackfly-s-u3-31s4&decision_ms=0&latency_frames=0&rate_hz=10&seed=4"
        "&size=640x480&speed_mps=13.9&split=test"
    )
    assert asked == {
        "name": "tunnel",
        "seed": 4,
        "split": "test",
        "width_px": 640,
        "height_px": 480,
        "speed_mps": 13.9,
        "optics": None,
    }
    assert source.drive_triggers == 120


def test_options_reach_the_world_and_the_cameras(asked: dict[str, Any]) -> None:
    source = open_source(
        "sim:tunnel?speed_mps=5.25&size=320x240&split=train&seed=9&rate_hz=20&decision_ms=2.5"
        "&latency_frames=3",
        seed=1,
        split="test",
    )
    assert (asked["seed"], asked["split"], asked["speed_mps"]) == (9, "train", 5.25)
    assert (asked["width_px"], asked["height_px"]) == (320, 240)
    assert source.rate_hz == 20.0
    assert source.drive_triggers == 240
    assert source.decision_ms == 2.5


def test_a_resolved_address_opens_the_same_again(asked: dict[str, Any]) -> None:
    once = open_source("sim:tunnel?rate_hz=max&speed_mps=1e-3", seed=4, split="train")
    before = dict(asked)
    again = open_source(once.address, seed=7, split="test")
    assert again.address == once.address
    assert asked == before
    assert again.rate_hz is None


def test_a_camera_file_is_used_and_named_by_its_full_path(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from importlib import resources

    shipped = resources.files("rig") / "drivers/sensor/models/blackfly-s-u3-31s4.toml"
    (tmp_path / "my & cam.toml").write_text(shipped.read_text().replace("30e6", "5e6"))
    monkeypatch.chdir(tmp_path)
    source = open_source("sim:tunnel?camera=my %26 cam.toml", seed=0)
    assert source.cameras.primary.limits.exposure_us == (11.0, 5e6)
    again = open_source(source.address, seed=0)
    assert again.address == source.address
    assert parse_address(again.address).options["camera"] == str(tmp_path / "my & cam.toml")


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("tunnel", "Write it as sim:tunnel"),
        ("", "Write it as sim:tunnel"),
        ("gige:tunnel", "what kind of cameras"),
        ("gige:replay:run", "only simulated cameras are served; try gige:sim:tunnel"),
        ("gigr:sim:tunnel", "unknown scheme 'gigr'; did you mean gige?"),
        ("aravis:18284899", "name two different cameras, the primary first, as in aravis:1828"),
        ("aravis:18284899,18284899", "name two different cameras"),
        ("aravis:1,2?mode=fast", "mode must be next-frame, free-run, software, got 'fast'"),
        ("aravis:1,2?mode=free-run&rate_hz=max", "free-run needs a rate_hz that is a number"),
        ("aravis:1,2?rate_hz=-1", "rate_hz must be a number above 0, or max, got '-1'"),
        ("aravis:1,2?packet_bytes=x", "packet_bytes must be a whole number above 0, got 'x'"),
        ("aravis:1,2?seed=1", "unknown option 'seed'; known: link_bytes_per_s, mode"),
        ("simm:tunnel", "unknown scheme 'simm'; did you mean sim?"),
        ("sim:tunel", "unknown world 'tunel'; did you mean tunnel?"),
        ("sim:", "unknown world ''; known: .*tunnel"),
        ("sim:tunnel?sed=3", "sim:tunnel: unknown option 'sed'; did you mean seed?"),
        ("sim:tunnel?zzz=3", "sim:tunnel: unknown option 'zzz'; known: camera, decision_ms"),
        ("sim:tunnel?seed", "options are written NAME=VALUE"),
        ("sim:tunnel?seed=1&seed=2", "option 'seed' is given twice"),
        ("sim:tunnel?seed=-1", "seed must be a whole number, 0 or more, got '-1'"),
        ("sim:tunnel?seed=", "seed must be a whole number, 0 or more, got ''"),
        ("sim:tunnel?latency_frames=1.5", "latency_frames must be a whole number"),
        ("sim:tunnel?rate_hz=0", "rate_hz must be a number above 0, or max, got '0'"),
        ("sim:tunnel?rate_hz=nan", "rate_hz must be a number above 0, or max, got 'nan'"),
        ("sim:tunnel?rate_hz=fast", "rate_hz must be a number above 0, or max, got 'fast'"),
        ("sim:tunnel?speed_mps=-3", "speed_mps must be a number above 0, got '-3'"),
        ("sim:tunnel?decision_ms=inf", "decision_ms must be a number, 0 or more, got 'inf'"),
        ("sim:tunnel?split=dev", "split must be train or test, got 'dev'"),
        ("sim:tunnel?size=640", "size must be WIDTHxHEIGHT in pixels, such as 640x480, got '640'"),
        ("sim:tunnel?size=640x400", "size must be .* of the shape of 2048x1536 .* got 640x400"),
        ("sim:tunnel?size=4096x3072", "no larger, got 4096x3072"),
        ("sim:tunnel?size=4x3", "size must be even"),
    ],
)
def test_a_wrong_address_is_answered_in_one_line(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        open_source(address, seed=0)
    assert "\n" not in str(caught.value)


def test_an_unknown_camera_is_answered(asked: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="unknown camera model 'basler'"):
        open_source("sim:tunnel?camera=basler", seed=0)


def test_a_wrong_split_or_seed_of_the_caller_is_answered_too(asked: dict[str, Any]) -> None:
    with pytest.raises(RigError, match="split must be train or test"):
        open_source("sim:tunnel", seed=0, split="dev")
    with pytest.raises(RigError, match="seed must be a whole number"):
        open_source("sim:tunnel", seed=-1)


def test_the_tunnel_opens_and_shows_a_picture() -> None:
    source = open_source("sim:tunnel?size=320x240", seed=0)
    for camera in source.cameras:
        camera.apply(Settings(1_000.0, 0.0))
    source.cameras.primary.trigger()
    frames = [camera.grab(1.0) for camera in source.cameras]
    source.close()
    for frame in frames:
        assert frame.image.shape == (240, 320)
        assert frame.image.std() > 10
    assert not np.array_equal(frames[0].image, frames[1].image)
