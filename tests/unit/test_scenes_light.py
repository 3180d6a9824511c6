from __future__ import annotations

import math

import numpy as np
import pytest

from rig.core.types import Intrinsics
from rig.drivers.scenes.geometry import Assembly, Material, Surfaces, surfaces
from rig.drivers.scenes.light import Sunlight, bake
from rig.drivers.scenes.raster import FAR_M, render
from rig.drivers.scenes.textures import MACRO, Atlas, make_atlas
from rig.drivers.scenes.trajectories import Bend, Drive, Path

GREY = Material("grey", None)
BLACK = Material("black", None)
LENS = Intrinsics(64, 48, 56.0, 56.0, 31.5, 23.5)
PATH = Path((), 100.0)
STILL = Drive(PATH, 0.0, 0.0, 1.0, 0.0, (), (), (), (), ()).pose(0.0)
UP = np.array([0.0, 1.0, 0.0])
NO_SUN = Sunlight(UP, 0.0, 0.0, 0.0)


def atlas() -> Atlas:
    grey = np.full((4, 4), 0.5, np.float32)
    return make_atlas({MACRO: grey, "grey": grey, "black": np.zeros((4, 4), np.float32)})


def ground(material: Material = BLACK) -> Assembly:
    put = Assembly(np.random.default_rng(0))
    put.floor(PATH, (10.0, 30.0), (-10.0, 10.0), 0.0, material)
    return put


def lux(put: Assembly, sun: Sunlight, quad: int = 0) -> np.ndarray:
    model = surfaces(put.quads, atlas())
    offset, wide, high = model.light_table[quad]
    return bake(model, sun)[offset : offset + wide * high].reshape(high, wide)


def test_open_ground_receives_the_sun_by_its_height_and_all_of_the_sky() -> None:
    towards = np.array([0.6, 0.8, 0.0])
    light = lux(ground(), Sunlight(towards, 80_000.0, 3_000.0, 0.0))
    assert light == pytest.approx(0.8 * 80_000 + math.pi * 3_000, rel=1e-3)


def test_a_roof_takes_the_sun_and_most_of_the_sky() -> None:
    put = ground()
    put.floor(PATH, (0.0, 40.0), (-20.0, 20.0), 2.0, BLACK, underside=True)
    light = lux(put, Sunlight(UP, 80_000.0, 3_000.0, 0.0))
    assert light.max() < 0.1 * math.pi * 3_000


def test_roof_pieces_in_a_bend_leave_no_gap_for_the_sun() -> None:
    bent = Path((Bend(0.0, 60.0, 0.02),), 60.0)
    put = Assembly(np.random.default_rng(0))
    put.floor(bent, (20.0, 30.0), (-4.0, 4.0), 0.0, BLACK, 3.0)
    for start in np.arange(0.0, 60.0, 5.0):
        put.floor(bent, (start, start + 5.0), (-8.0, 8.0), 5.0, BLACK, underside=True)
    assert lux(put, Sunlight(UP, 80_000.0, 0.0, 0.0)).max() == 0.0


def test_a_lamp_obeys_the_inverse_square_of_its_distance() -> None:
    put = ground()
    put.floor(PATH, (20.4, 20.6), (0.4, 0.6), 4.0, GREY, underside=True, emitted_cd_m2=10_000.0)
    light = lux(put, NO_SUN)
    assert light.max() == pytest.approx(10_000 * 0.04 / 16, rel=0.03)


def test_light_bounces_off_bright_surfaces_only() -> None:
    sun = Sunlight(UP, 80_000.0, 0.0, 0.0)
    shade = {}
    for name, material in (("black", BLACK), ("grey", GREY)):
        put = ground(material)
        put.gate(PATH, 20.0, (-5.0, 5.0), (0.0, 3.0), BLACK)
        shade[name] = lux(put, sun, quad=1).mean()
    assert shade["black"] == 0.0
    assert shade["grey"] > 0.2 * 80_000 * 0.5 / 2


def picture(put: Assembly, model: Surfaces, light: np.ndarray, sky: np.ndarray) -> tuple:
    return render(model, atlas(), light, sky, LENS, STILL)


def test_a_surface_shines_with_albedo_times_light_over_pi_in_its_bayer_channel() -> None:
    put = Assembly(np.random.default_rng(0))
    put.gate(PATH, 10.0, (-20.0, 20.0), (-20.0, 20.0), Material("grey", None, (1.0, 0.5, 0.25)))
    model = surfaces(put.quads, atlas())
    light = np.full(int(model.light_table[0, 1:].prod()), 100 * math.pi, np.float32)
    radiance, _, depth_m = picture(put, model, light, np.zeros((3, 4, 4), np.float32))
    assert depth_m == pytest.approx(10.0, rel=1e-5)
    for (row, column), expected in {(0, 0): 50, (0, 1): 25, (1, 0): 25, (1, 1): 12.5}.items():
        assert radiance[row::2, column::2] == pytest.approx(expected, rel=1e-5)


def test_the_sky_is_far_and_the_nearer_surface_hides_the_farther() -> None:
    put = Assembly(np.random.default_rng(0))
    for s_m, half in ((10.0, 1.0), (20.0, 3.0)):
        put.gate(PATH, s_m, (-half, half), (1 - half, 1 + half), GREY)
    model = surfaces(put.quads, atlas())
    light = np.ones(int(model.light_table[:, 1:].prod(1).sum()), np.float32)
    sky = np.full((3, 4, 4), 7.0, np.float32)
    radiance, _, depth_m = picture(put, model, light, sky)
    assert depth_m[24, 32] == pytest.approx(10.0, rel=1e-5)
    assert depth_m[24, 32 + 7] == pytest.approx(20.0, rel=1e-5)
    assert depth_m[0, 0] == FAR_M
    assert radiance[0, 0] == pytest.approx(7.0)
