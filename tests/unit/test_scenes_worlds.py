from __future__ import annotations

from pathlib import Path as File

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig.core.errors import UsageError
from rig.drivers.scenes import route, worlds
from rig.drivers.scenes.cache import cached
from rig.drivers.scenes.textures import make_atlas
from rig.drivers.scenes.tunnel import draw_layout
from rig.drivers.scenes.weather import draw_weather, world_rng
from rig.drivers.scenes.world import Plan, RenderedScene
from rig.drivers.scenes.worlds import open_world

PAIR_M = 1.39
USUAL_MPS = 13.9


def passed(plan: Plan, s_m: float) -> float:
    """Return the time in tenths of a second, pairs, at which a drive passes a place."""
    timetable = plan.drive.timetable
    assert timetable is not None
    return 10.0 * float(np.interp(s_m, timetable.s_m, timetable.time_s))


def tunnel(seed: int = 0, split: str = "test", width_px: int = 320) -> RenderedScene:
    scene = open_world(
        "tunnel",
        seed=seed,
        split=split,
        width_px=width_px,
        height_px=width_px * 3 // 4,
        speed_mps=13.9,
    )
    assert isinstance(scene, RenderedScene)
    return scene


@pytest.fixture(scope="module")
def scene() -> RenderedScene:
    return tunnel()


@pytest.mark.parametrize("split", ["train", "test"])
def test_every_tunnel_begins_and_ends_in_time(split: str) -> None:
    for seed in range(25):
        layout = draw_layout(world_rng("tunnel", split, seed, "layout"))
        plan = worlds.WORLDS["tunnel"](seed, split, USUAL_MPS)
        assert 25 <= passed(plan, layout.entrance_m) <= 35
        assert passed(plan, layout.exit_m) < 95


@pytest.mark.parametrize("split", ["train", "test"])
def test_every_route_drives_a_whole_block_and_stands_three_times(split: str) -> None:
    for seed in range(21):
        layout = route.draw_layout(world_rng("route", split, seed, "layout"))
        plan = worlds.WORLDS["route"](seed, split, USUAL_MPS)
        path = plan.drive.path
        assert path.at(layout.length_m) == pytest.approx([0.0, 0.0, 0.0], abs=0.05)
        assert round(10 * plan.drive_s) == 760
        assert passed(plan, layout.length_m) / 10 < 75.5
        turned = [
            path.heading_rad(side.end_m) - path.heading_rad(side.turn_m) for side in layout.sides
        ]
        assert turned == pytest.approx([0.5 * np.pi] * 4, abs=0.01)
        dead_m = [lighting.dark_to_m - lighting.dark_from_m for lighting in layout.lightings]
        assert dead_m == [0.0, pytest.approx(14.5, abs=0.5)]
        tubes = [side for side in layout.sides if np.isfinite(side.entrance_m)]
        assert [78 <= side.exit_m - side.entrance_m <= 82 for side in tubes] == [True, True]
        assert [stands(plan, passed(plan, stop.s_m) / 10) for stop in layout.stops] == [True] * 3


def stands(plan: Plan, time_s: float) -> bool:
    """Return whether the vehicle stands for a second before it leaves a place."""
    before, after = plan.drive.pose(time_s - 1.3), plan.drive.pose(time_s - 0.3)
    return np.array_equal(before.centre, after.centre) and np.array_equal(
        before.rotation, after.rotation
    )


def test_routes_differ_in_pace_and_shaking() -> None:
    plans = [worlds.WORLDS["route"](seed, "test", USUAL_MPS) for seed in range(8)]
    begun_m = [plan.drive.pose(1.0).centre[2] - plan.drive.pose(0.0).centre[2] for plan in plans]
    assert max(begun_m) > 1.06 * min(begun_m)
    weave_m = [plan.drive.right[0].amplitude for plan in plans]
    assert 1.1 * min(weave_m) < max(weave_m) <= 0.25


def test_haze_dims_sun_and_sky_alike_and_moves_neither() -> None:
    clear = draw_weather(np.random.default_rng(0), 0.0)
    hazy = clear.veiled(0.5)
    assert (hazy.sun_lux, hazy.sky_cd_m2) == (0.5 * clear.sun_lux, 0.5 * clear.sky_cd_m2)
    assert hazy._replace(sun_lux=clear.sun_lux, sky_cd_m2=clear.sky_cd_m2) == clear


def test_a_slow_route_waits_as_long_and_moves_longer() -> None:
    usual, slow = (worlds.WORLDS["route"](3, "test", speed) for speed in (13.9, 13.9 / 2))
    layout = route.draw_layout(world_rng("route", "test", 3, "layout"))
    waits_s = sum(stop.wait_s for stop in layout.stops)
    assert slow.drive_s - waits_s == pytest.approx(2 * (usual.drive_s - waits_s))


def test_a_route_has_dark_and_bright_places_and_a_road_has_neither() -> None:
    light = {}
    for name in ("route", "road"):
        scene = open_world(
            name, seed=0, split="test", width_px=64, height_px=48, speed_mps=USUAL_MPS
        )
        moments = np.arange(0.5, scene.drive_s, 1.0)
        light[name] = [scene.truth(float(t)).light_cd_m2 for t in moments]
    assert max(light["route"]) > 20 * min(light["route"])
    assert max(light["road"]) < 1.5 * min(light["road"])


def test_roads_differ_in_speed_and_not_in_duration() -> None:
    plans = [worlds.WORLDS["road"](seed, "test", USUAL_MPS) for seed in range(6)]
    assert {plan.drive_s for plan in plans} == {12.0}
    shares = [plan.drive.speed_mps / USUAL_MPS for plan in plans]
    assert all(0.9 <= share <= 1.1 for share in shares)
    assert np.ptp(shares) > 0.05


def test_a_slower_drive_sees_the_same_places_later(scene: RenderedScene) -> None:
    slow = open_world(
        "tunnel", seed=0, split="test", width_px=64, height_px=48, speed_mps=0.5 * USUAL_MPS
    )
    assert slow.drive_s == pytest.approx(2 * scene.drive_s)
    for time_s in (1.0, 5.0, 10.0):
        there = slow.pose("primary", 2 * time_s).centre[[0, 2]]
        assert there == pytest.approx(scene.pose("primary", time_s).centre[[0, 2]], abs=0.5)


def test_no_two_worlds_are_alike() -> None:
    worlds = {
        draw_layout(world_rng("tunnel", split, seed, "layout"))
        for split in ("train", "test")
        for seed in range(100)
    }
    assert len(worlds) == 200


def test_the_same_world_gives_the_same_bytes_baked_again_and_on_one_thread(
    scene: RenderedScene, tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = scene.view("primary", 3.3)
    blurred = before.exposed(8_000.0)
    monkeypatch.setenv("RIG_CACHE_DIR", str(tmp_path))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        again = tunnel().view("primary", 3.3)
        assert again.radiance_cd_m2.tobytes() == before.radiance_cd_m2.tobytes()
        assert again.depth_m.tobytes() == before.depth_m.tobytes()
        assert again.exposed(8_000.0).tobytes() == blurred.tobytes()
    finally:
        numba.set_num_threads(threads)


def test_a_drive_lasts_120_triggers_and_knows_its_version(scene: RenderedScene) -> None:
    assert scene.drive_s == pytest.approx(12.0)
    assert scene.world_version == "tunnel/7"


def test_smaller_pictures_keep_the_field_of_view(scene: RenderedScene) -> None:
    lens = scene.intrinsics("primary")
    assert lens.fx_px / lens.width_px == pytest.approx(1806 / 2048)
    assert (lens.cx_px, lens.cy_px) == (159.5, 119.5)


def test_the_secondary_camera_sits_392_tenths_of_a_millimetre_to_the_right(
    scene: RenderedScene,
) -> None:
    for time_s in (0.0, 4.0, 9.0):
        primary, secondary = scene.pose("primary", time_s), scene.pose("secondary", time_s)
        offset = primary.rotation @ (secondary.centre - primary.centre)
        assert offset == pytest.approx([0.0392, 0.0, 0.0], abs=1e-12)


def test_truth_agrees_with_the_pose_and_the_picture(scene: RenderedScene) -> None:
    truth, pose = scene.truth(5.0), scene.pose("primary", 5.0)
    right, up, ahead = pose.centre
    assert truth.position_m == pytest.approx((ahead, -right, up))
    optical_axis = Rotation.from_quat(truth.orientation_xyzw).apply([0.0, 0.0, 1.0])
    seen = pose.rotation[2]
    assert optical_axis == pytest.approx([seen[2], -seen[0], seen[1]])
    assert truth.light_cd_m2 == pytest.approx(scene.view("primary", 5.0).radiance_cd_m2.mean())


def test_the_optical_axis_looks_along_the_drive(scene: RenderedScene) -> None:
    for time_s, step_m in ((1.0, PAIR_M), (5.0, 0.875 * PAIR_M)):
        before, after = scene.pose("primary", time_s), scene.pose("primary", time_s + 0.1)
        ahead = before.rotation @ (after.centre - before.centre)
        assert ahead[2] > 0.995 * np.linalg.norm(ahead)
        assert np.linalg.norm(ahead) == pytest.approx(step_m, rel=0.06)


def test_outside_is_far_brighter_than_inside(scene: RenderedScene) -> None:
    street, inside, plaza = (
        float(np.median(scene.view("primary", t).radiance_cd_m2)) for t in (0.5, 5.0, 10.0)
    )
    assert 400 < inside < 800
    assert street > 3 * inside
    assert plaza > 10 * inside


def test_a_vanishing_exposure_has_no_blur(scene: RenderedScene) -> None:
    view = scene.view("primary", 4.0)
    assert view.exposed(1e-3) == pytest.approx(view.radiance_cd_m2, rel=3e-3)


def test_flow_blur_agrees_with_rendering_every_moment(scene: RenderedScene) -> None:
    view = scene.view("primary", 4.0)
    moments = [scene.view("primary", 4.0 + 0.015 * (k + 0.5) / 24) for k in range(24)]
    exact = np.mean([moment.radiance_cd_m2 for moment in moments], axis=0)

    error = np.abs(np.log(view.exposed(15_000.0) / exact))
    still = np.abs(np.log(view.radiance_cd_m2 / exact))
    assert np.median(error) < 0.03
    assert np.median(error) < 0.6 * np.median(still)


def test_blur_keeps_the_colour_of_the_sky() -> None:
    scene = open_world(
        "road", seed=0, split="test", width_px=320, height_px=240, speed_mps=USUAL_MPS
    )
    view = scene.view("primary", 10.5)
    blurred = view.exposed(20_000.0)
    for row, column in ((0, 0), (0, 1), (1, 1)):
        part = (slice(row, 30, 2), slice(column, None, 2))
        assert blurred[part].mean() == pytest.approx(view.radiance_cd_m2[part].mean(), rel=0.02)


def test_the_wall_is_even_and_stands_still() -> None:
    wall = open_world(
        "wall",
        seed=0,
        split="test",
        width_px=64,
        height_px=48,
        speed_mps=13.9,
        aperture_offset_stops="0",
    )
    for side in ("primary", "secondary"):
        view = wall.view(side, 3.0)
        assert view.radiance_cd_m2 == pytest.approx(100.0, rel=1e-4)
        assert view.depth_m == pytest.approx(2.0, rel=1e-4)
    assert wall.view("primary", 1.0).exposed(30_000.0) == pytest.approx(100.0, rel=1e-4)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": "tunel"}, "did you mean tunnel"),
        ({"name": "moon"}, "known worlds: tunnel, route, road, "),
        ({"split": "dev"}, "split must be train or test, got 'dev'"),
        ({"seed": -1}, "seed must be 0 or more, got -1"),
        ({"speed_mps": 0.0}, "speed_mps must be above 0"),
        ({"width_px": 8}, "at least 16x16, got 8x48"),
        ({"weather": "fog"}, "no option 'weather'"),
    ],
)
def test_what_cannot_be_opened_says_why(changed: dict[str, object], message: str) -> None:
    asked = {
        "name": "tunnel",
        "seed": 0,
        "split": "test",
        "width_px": 64,
        "height_px": 48,
        "speed_mps": 13.9,
    }
    with pytest.raises(UsageError, match=message):
        open_world(**{**asked, **changed})  # type: ignore[arg-type]


def test_a_damaged_cache_file_is_made_again(
    tmp_path: File, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RIG_CACHE_DIR", str(tmp_path))
    made = []

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {"a": np.arange(3)}

    cached("things", "key", make)
    assert cached("things", "key", make)["a"].tolist() == [0, 1, 2]
    (stored,) = (tmp_path / "things").iterdir()
    stored.write_bytes(stored.read_bytes()[:-30])
    assert cached("things", "key", make)["a"].tolist() == [0, 1, 2]
    assert len(made) == 2


def test_mip_levels_keep_the_mean_and_odd_textures_are_refused() -> None:
    image = np.random.default_rng(0).random((8, 16)).astype(np.float32)
    atlas = make_atlas({"macro": image})
    assert atlas.texels[-2:].mean() == pytest.approx(image.mean(), rel=1e-5)
    with pytest.raises(ValueError, match="powers of two, got 10x8"):
        make_atlas({"odd": np.zeros((8, 10), np.float32)})
