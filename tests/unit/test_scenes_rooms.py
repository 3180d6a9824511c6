"""Buildings: each seed another one, with light that comes in where it is open."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from rig.core.errors import UsageError
from rig.core.types import Intrinsics
from rig.drivers.registry import open_source
from rig.drivers.scenes import door, doorway, photographs
from rig.drivers.scenes.indoor import PLACES
from rig.drivers.scenes.sky import mean_radiance_cd_m2
from rig.drivers.scenes.weather import world_rng
from rig.drivers.scenes.world import Plan, RenderedScene, bake_world
from rig.drivers.scenes.worlds import ROOMS

LENS = Intrinsics(64, 48, 56.4, 56.4, 31.5, 23.5)
FAMILIES = sorted(ROOMS)


def plan(name: str, seed: int = 0, split: str = "test", **options: str) -> Plan:
    return ROOMS[name](seed, split, 1.0, options)


def opened(name: str, seed: int = 0, **options: str) -> RenderedScene:
    """Return a world with its light gathered by few rays, small enough to be quick."""
    return RenderedScene(bake_world(replace(plan(name, seed, **options), rays=(6, 12))), LENS)


def light(scene: RenderedScene, time_s: float) -> float:
    return float(np.median(scene.view("primary", time_s).radiance_cd_m2))


@pytest.mark.parametrize("name", FAMILIES)
def test_no_two_worlds_are_alike(name: str) -> None:
    plans = [plan(name, seed, split) for split in ("train", "test") for seed in range(6)]
    assert len({p.key for p in plans}) == 12
    assert len({b"".join(q.corners.tobytes() for q in p.quads) for p in plans}) == 12
    assert len({p.drive.height_m for p in plans}) == 12


@pytest.mark.parametrize("name", FAMILIES)
def test_the_same_seed_gives_the_same_world(name: str) -> None:
    first, again = plan(name), plan(name)
    assert first.key == again.key
    corners = [np.stack([quad.corners for quad in each.quads]) for each in (first, again)]
    assert np.array_equal(*corners)
    assert first.drive.pose(3.3).rotation.tolist() == again.drive.pose(3.3).rotation.tolist()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_doorway_leads_from_dim_to_bright_and_back(seed: int) -> None:
    scene = RenderedScene(
        bake_world(replace(ROOMS["doorway"](seed, "test", 1.4, {}), rays=(6, 12))), LENS
    )
    lights = [light(scene, t) for t in np.arange(0.0, 12.0, 0.5)]
    brightest = int(np.argmax(lights))
    assert 2 <= brightest <= 20
    assert lights[brightest] > 8 * lights[0]
    assert lights[brightest] > 8 * lights[-1]


def test_a_door_lets_the_light_in_as_it_opens() -> None:
    scene = opened("door", 1)
    change = scene.world.plan.change
    assert change is not None
    shares = [change.share(t) for t in np.arange(0.0, 12.0, 0.25)]
    assert shares[0] == 0.0 and max(shares) == pytest.approx(1.0)
    opening = shares[: int(np.argmax(shares)) + 1]
    assert all(b >= a for a, b in pairwise(opening))
    closed, open_ = light(scene, 0.0), light(scene, 0.25 * int(np.argmax(shares)))
    assert open_ > 2 * closed
    assert scene.pose("primary", 0.0).centre == pytest.approx(scene.pose("primary", 9.0).centre)


def test_between_two_stages_the_light_is_mixed() -> None:
    world = opened("door", 1).world
    change = world.plan.change
    assert change is not None
    times = np.arange(0.0, 12.0, 0.01)
    shares = np.array([change.share(t) for t in times])
    moment = times[np.argmin(np.abs(shares - 1.5 / (change.stages - 1)))]
    _, mixed = world.at(float(moment))
    assert mixed == pytest.approx(0.5 * (world.light_lux[1] + world.light_lux[2]), rel=0.05, abs=2)


def test_a_closed_door_fills_its_opening() -> None:
    leaf = door._lobby(door.Builder(np.random.default_rng(3)))[1]
    front = leaf.quads(0.0)[0].corners
    assert np.ptp(front[:, 0]) == pytest.approx(leaf.hole.right_m - leaf.hole.left_m, abs=0.01)
    wide = leaf.quads(1.0)[0].corners
    assert np.ptp(wide[:, 2]) > 0.9 * np.ptp(front[:, 0]) * math.sin(leaf.open_rad)


@pytest.mark.parametrize(
    ("name", "options"),
    [("door", {}), ("doorway", {}), *(("indoor", {"place": place}) for place in PLACES)],
)
def test_nothing_stands_in_the_way(name: str, options: dict[str, str]) -> None:
    for seed in (0, 3):
        speed = {"door": 0.35, "doorway": 1.4, "indoor": 1.0}[name]
        world = bake_world(replace(ROOMS[name](seed, "test", speed, options), rays=(2,)))
        scene = RenderedScene(world, LENS)
        for time_s in np.arange(0.0, 12.0, 1.0):
            assert scene.view("primary", time_s).depth_m.min() > 0.25, (seed, time_s)


def test_a_robot_drives_turns_or_stands() -> None:
    drives = {m: plan("indoor", place="lab", motion=m).drive for m in ("linear", "rotating")}
    still = plan("indoor", place="lab", motion="stationary").drive
    gone = drives["linear"].pose(12.0).centre - drives["linear"].pose(0.0).centre
    assert 0.55 * 12 * 0.84 < gone[2] < 0.55 * 12 * 1.16
    axes = [drives["rotating"].pose(t).rotation[2] for t in np.arange(0.0, 12.0, 0.1)]
    assert np.ptp([math.atan2(axis[0], axis[2]) for axis in axes]) > math.radians(90)
    turning = [drives["rotating"].pose(t).centre for t in (0.0, 6.0)]
    assert turning[0] == pytest.approx(turning[1], abs=0.03)
    assert np.array_equal(still.pose(0.0).rotation, still.pose(7.3).rotation)


def test_doorways_have_walls_and_doors_that_fit() -> None:
    for seed in range(200):
        layout = doorway.draw_layout(world_rng("doorway", "train", seed, "layout"))
        for room, hole in ((layout.first, layout.exit), (layout.second, layout.entry)):
            assert 0 < hole.left_m < hole.right_m < room.width_m
            assert hole.high_m < room.high_m
        assert 0 < layout.start_m < layout.first.far_m < layout.second.near_m


def test_a_dome_is_as_bright_as_asked_and_the_sun_stands_where_it_shines() -> None:
    for turn in (0.0, 1.0, 4.0):
        found = photographs.dome("sunny", 4_000.0, turn)
        assert mean_radiance_cd_m2(found.sky) == pytest.approx(4_000.0, rel=1e-3)
        column = int((found.sun_azimuth_rad / (2 * math.pi) + 0.5) * 512) % 512
        row = int((0.5 - found.sun_elevation_rad / math.pi) * 256)
        assert found.sky[1, row, column] == pytest.approx(found.sky[1].max(), rel=1e-3)
        assert math.radians(40) < found.sun_elevation_rad < math.radians(55)


def test_photographed_ground_tiles_and_has_its_albedo() -> None:
    texture = photographs.ground("gravel", 0.3)
    assert texture.mean() == pytest.approx(0.3, rel=1e-3)
    assert np.array_equal(texture[:, 0], texture[:, -1])
    assert np.array_equal(texture[0], texture[-1])


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("sim:indoor?place=kitchen", "place must be hallway, lab, window, got 'kitchen'"),
        ("sim:indoor?motion=flying", "motion must be linear, rotating, stationary, got 'flying'"),
        ("sim:door?place=lab", "unknown option 'place'"),
        ("sim:doorway?mtion=linear", "did you mean motion"),
        ("sim:doorwy", "did you mean doorway"),
    ],
)
def test_what_cannot_be_meant_is_answered_in_one_line(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        open_source(address, seed=0)
