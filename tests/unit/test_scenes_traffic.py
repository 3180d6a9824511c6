from __future__ import annotations

from pathlib import Path as File

import numba
import numpy as np
import pytest

from rig.drivers.scenes import route, worlds
from rig.drivers.scenes.traffic import Frame, MovingTraffic, Traffic
from rig.drivers.scenes.weather import world_rng
from rig.drivers.scenes.world import RenderedScene
from rig.drivers.scenes.worlds import open_world

BODY_TEXELS, SIDE_TEXELS = 20, 16
"""A body's last four texels are those of its lid."""
TIMES_S = np.arange(0.0, 76.0, 0.5)


def open_route(seed: int = 0, split: str = "test") -> RenderedScene:
    scene = open_world("route", seed=seed, split=split, width_px=160, height_px=120, speed_mps=13.9)
    assert isinstance(scene, RenderedScene)
    return scene


@pytest.fixture(scope="module")
def scene() -> RenderedScene:
    return open_route()


def moving(scene: RenderedScene) -> MovingTraffic:
    assert scene.world.moving is not None
    return scene.world.moving


def frame(traffic: Traffic, number: int, time_s: float) -> Frame:
    vehicle = traffic.vehicles[number]
    return traffic.lanes[vehicle.lane].frame(vehicle.driven_m(time_s))


def ahead_m(scene: RenderedScene, number: int, time_s: float) -> np.ndarray:
    """Return where a vehicle's middle is in the primary's optical frame."""
    pose = scene.pose("primary", time_s)
    place = frame(moving(scene).traffic, number, time_s).place + np.array([0.0, 0.8, 0.0])
    return np.asarray(pose.rotation @ (place - pose.centre))


def nearest_view_s(scene: RenderedScene, number: int) -> float:
    """Return when a vehicle is nearest before the driver, outside of walls that could hide it."""
    layout = route.draw_layout(world_rng("route", "test", 0, "layout"))
    timetable = scene.world.plan.drive.timetable
    assert timetable is not None

    def distance_m(time_s: float) -> float:
        x, _, z = ahead_m(scene, number, time_s)
        own_m = timetable.at(time_s)
        hidden = any(s.entrance_m - 40.0 < own_m < s.exit_m for s in layout.sides)
        return np.inf if hidden or z < 5 or abs(x) > 0.3 * z else float(z)

    return float(min(TIMES_S, key=distance_m))


@pytest.mark.parametrize("split", ["train", "test"])
def test_no_vehicle_of_a_route_meets_another_one(split: str) -> None:
    for seed in range(21):
        plan = worlds.WORLDS["route"](seed, split, 13.9)
        traffic = plan.traffic
        assert traffic is not None
        oncoming = [k for k, vehicle in enumerate(traffic.vehicles) if vehicle.lane == 1]
        assert 2 <= len(oncoming) <= 4
        assert len(traffic.vehicles) - len(oncoming) in (0, 1)
        for time_s in TIMES_S[::2]:
            places = [frame(traffic, k, time_s).place for k in range(len(traffic.vehicles))]
            places.append(plan.drive.pose(time_s).centre * [1.0, 0.0, 1.0])
            apart = [np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]]
            assert min(apart) > 3.0


@pytest.mark.parametrize("split", ["train", "test"])
def test_a_leading_vehicle_stays_ahead(split: str) -> None:
    leading = 0
    for seed in range(21):
        plan = worlds.WORLDS["route"](seed, split, 13.9)
        traffic, timetable = plan.traffic, plan.drive.timetable
        assert traffic is not None
        assert timetable is not None
        if traffic.vehicles[-1].lane != 0:
            continue
        leading += 1
        length_m = traffic.lanes[0].length_m
        driven_m = np.array([traffic.vehicles[-1].driven_m(t) for t in TIMES_S])
        own_m = np.array([timetable.at(t) for t in TIMES_S])
        gap_m = np.unwrap(driven_m - own_m, period=length_m)
        assert 15.0 < gap_m.min() < gap_m.max() < length_m - 20.0
    assert 6 <= leading <= 18


def test_a_vehicle_comes_nearer_while_the_driver_waits(scene: RenderedScene) -> None:
    layout = route.draw_layout(world_rng("route", "test", 0, "layout"))
    timetable = scene.world.plan.drive.timetable
    assert timetable is not None
    left_s = float(np.interp(layout.stops[0].s_m, timetable.s_m, timetable.time_s))
    before, after = scene.pose("primary", left_s - 0.9), scene.pose("primary", left_s - 0.4)
    assert np.array_equal(before.centre, after.centre)
    traffic = moving(scene).traffic
    for number in range(len(traffic.vehicles)):
        then, now = (frame(traffic, number, left_s - s).place for s in (0.9, 0.4))
        assert 0.4 * 13.9 * 0.5 < np.linalg.norm(now - then) < 1.1 * 13.9 * 0.5


def test_a_vehicle_is_drawn_where_it_is(scene: RenderedScene) -> None:
    for number in range(len(moving(scene).traffic.vehicles)):
        time_s = nearest_view_s(scene, number)
        x, y, z = ahead_m(scene, number, time_s)
        lens = scene.intrinsics("primary")
        column = round(lens.fx_px * x / z + lens.cx_px)
        row = round(lens.fy_px * y / z + lens.cy_px)
        depth_m = scene.view("primary", time_s).depth_m[row, column]
        assert z - 2.8 < depth_m < z


def test_a_vehicle_has_darker_sides_in_an_underpass(scene: RenderedScene) -> None:
    layout = route.draw_layout(world_rng("route", "test", 0, "layout"))
    world, traffic = scene.world, moving(scene).traffic
    first = traffic.vehicles[0]
    side = layout.sides[0]
    inside, outside = [], []
    for time_s in np.arange(0.0, 70.0, 0.25):
        s_m = layout.length_m - first.driven_m(time_s)
        start = len(traffic.vehicles) * BODY_TEXELS
        lux = float(world.at(time_s)[1][-start:][:SIDE_TEXELS].mean())
        if side.entrance_m + 20 < s_m < side.exit_m - 20:
            inside.append(lux)
        elif side.exit_m + 10 < s_m < side.end_m:
            outside.append(lux)
    assert len(inside) > 5
    assert len(outside) > 5
    assert max(inside) < 0.5 * min(outside)


def test_the_ground_beneath_a_vehicle_is_dark_and_light_again_behind_it(
    scene: RenderedScene,
) -> None:
    traffic, world = moving(scene).traffic, scene.world
    still = world.light_lux[0]
    for time_s in (3.0, 20.0, 40.0):
        dimmed = np.flatnonzero(
            world.at(time_s)[1][: -BODY_TEXELS * len(traffic.vehicles)]
            < still[: moving(scene).light_lux.size]
        )
        rank = {int(texel): k for k, texel in enumerate(moving(scene).ground_texels)}
        places = moving(scene).ground.data[[rank[int(texel)] for texel in dimmed]]
        middles = np.stack([frame(traffic, k, time_s).place for k in range(len(traffic.vehicles))])
        away = np.linalg.norm(places[:, None] - middles, axis=2)
        assert away.min(1).max() < 6.5
        assert (away.min(0) < 1.0).all()


def test_moving_vehicles_leave_the_same_bytes_when_opened_again(
    scene: RenderedScene, tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    time_s = nearest_view_s(scene, 0)
    before = scene.view("secondary", time_s).radiance_cd_m2.tobytes()
    monkeypatch.setenv("RIG_CACHE_DIR", str(tmp_path))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert open_route().view("secondary", time_s).radiance_cd_m2.tobytes() == before
    finally:
        numba.set_num_threads(threads)


def test_splits_and_seeds_have_different_traffic() -> None:
    starts = set()
    for split in ("train", "test"):
        for seed in range(10):
            traffic = worlds.WORLDS["route"](seed, split, 13.9).traffic
            assert traffic is not None
            starts.add(traffic.vehicles[0].driven_m(0.0))
    assert len(starts) == 20
