"""Windscreen, lens and aperture: bent, dimmed, veiled and let through as their options say."""

from __future__ import annotations

import datetime

import cv2
import numpy as np
import pytest
from record_samples import HEADER, record

from rig.calibration.undistorted import undistorted
from rig.core.errors import UsageError
from rig.core.types import Intrinsics, Pair, PairRecord
from rig.drivers.registry import open_source
from rig.drivers.scenes.optics import Optics, make_warp
from rig.drivers.scenes.scene import Scene
from rig.drivers.scenes.worlds import open_world
from rig.drivers.simulated.source import SimulatedSource
from rig.record.header import from_parts, to_attachments, to_metadata
from rig.vision.undistort import Undistorter

BARREL = (-0.3, 0.1, 0.001, -0.001, 0.0)


def tunnel(optics: Optics | None = None) -> Scene:
    return open_world(
        "tunnel",
        seed=0,
        split="test",
        width_px=320,
        height_px=240,
        speed_mps=13.9,
        optics=optics,
    )


def opened(options: str) -> SimulatedSource:
    source = open_source(f"sim:tunnel?size=320x240{options}", seed=0)
    assert isinstance(source, SimulatedSource)
    return source


def light(scene: Scene, side: str = "primary", time_s: float = 1.0) -> np.ndarray:
    return scene.view(side, time_s).exposed(1_000.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("distortion", [BARREL, (0.2, 0.0, 0.0, 0.0, 0.0)])
def test_undistorting_the_bent_picture_gives_the_straight_one(
    distortion: tuple[float, float, float, float, float],
) -> None:
    bent, straight = tunnel(Optics(distortion=distortion)), tunnel()
    lens = bent.intrinsics("primary")
    assert lens.distortion == distortion
    pictures = []
    for scene in (bent, straight):
        mosaic = np.clip(255 * light(scene) / 4_000.0, 0, 255).astype(np.uint8)
        grey = cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2GRAY)
        pictures.append(Undistorter(lens, distortion).apply(grey) if scene is bent else grey)
    inside = np.s_[30:-30, 30:-30]
    again, true = (picture[inside].astype(float) for picture in pictures)
    assert np.corrcoef(again.ravel(), true.ravel())[0, 1] > 0.99
    assert np.median(np.abs(again - true)) < 0.03 * true.mean()


def test_a_pixel_looks_where_the_lens_model_says() -> None:
    lens = Intrinsics(320, 240, 282.0, 282.0, 159.5, 119.5, BARREL)
    warp = make_warp(lens)
    for x, y in ((0, 0), (319, 239), (160, 12)):
        ray = [
            (warp.at[0][y, x] - warp.wide.cx_px) / 282.0,
            (warp.at[1][y, x] - warp.wide.cy_px) / 282.0,
            1.0,
        ]
        matrix = np.array([[282.0, 0, 159.5], [0, 282.0, 119.5], [0, 0, 1.0]])
        seen, _ = cv2.projectPoints(
            np.array([ray]), np.zeros(3), np.zeros(3), matrix, np.array(BARREL)
        )
        assert seen.ravel() == pytest.approx([x, y], abs=0.01)


def test_the_colours_of_a_bent_picture_stay() -> None:
    """Each pixel keeps its own filter: the means of the four Bayer places are those before."""
    bent, straight = light(tunnel(Optics(distortion=BARREL))), light(tunnel())
    for row in (0, 1):
        for column in (0, 1):
            sky = np.s_[20 + row : 60 : 2, 100 + column : 220 : 2]
            assert bent[sky].mean() == pytest.approx(straight[sky].mean(), rel=0.05)


def test_vignetting_is_the_cosine_law() -> None:
    dim, plain = light(tunnel(Optics(vignetting=1.0))), light(tunnel())
    lens = tunnel().intrinsics("primary")
    angle = np.arctan(np.hypot(lens.cx_px / lens.fx_px, lens.cy_px / lens.fy_px))
    assert dim[0, 0] / plain[0, 0] == pytest.approx(np.cos(angle) ** 4, rel=1e-4)
    assert dim[120, 160] / plain[120, 160] == pytest.approx(1.0, rel=1e-4)


def test_each_aperture_lets_its_own_light_through() -> None:
    stopped, plain = opened("&f_number=8,11.313708").scene, opened("").scene
    assert light(stopped) == pytest.approx(light(plain), rel=1e-5)
    assert light(stopped, "secondary") == pytest.approx(0.5 * light(plain, "secondary"), rel=1e-5)
    assert stopped.truth(1.0) == plain.truth(1.0)


def test_the_dashboard_shows_most_where_the_view_is_darker_than_the_sky_above() -> None:
    """Thesis 5.2.1: glare grows on the way into the tunnel and hides what is behind it."""
    veiled, plain = tunnel(Optics(glare=0.1)), tunnel()
    share = []
    for time_s in (0.5, 2.7, 6.0):
        before, behind = light(plain, time_s=time_s), light(veiled, time_s=time_s)
        mirrored = behind - np.float32(0.8) * before
        assert mirrored.min() > -1e-2
        share.append(float(np.median(mirrored / before)))
    assert share[1] > 2 * share[0]


def test_an_address_names_the_optics_and_opens_the_same_again() -> None:
    source = opened("&distortion=-0.2,0.05&vignetting=0.5&glare=0.05&f_number=8,9")
    assert "&distortion=-0.2,0.05&f_number=8,9&glare=0.05&" in source.address
    assert "&vignetting=0.5" in source.address
    assert source.intrinsics.secondary.distortion == (-0.2, 0.05, 0.0, 0.0, 0.0)
    assert open_source(source.address, seed=0).address == source.address


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("sim:tunnel?distorsion=0.1", "did you mean distortion"),
        ("sim:tunnel?distortion=a", "distortion must be up to five numbers"),
        ("sim:tunnel?distortion=-0.9", "folds the picture"),
        ("sim:tunnel?vignetting=9", "vignetting must be a number from 0 to 4"),
        ("sim:tunnel?glare=2", "glare must be a number from 0 to 1"),
        ("sim:tunnel?f_number=1,2,3", "f_number must be an f-number from 0.7 to 64, or two"),
        ("sim:tunnel?f_number=0.1", "f_number must be"),
        ("sim:wall?glare=0.1&size=64x48", "wall: distortion and glare need a world"),
    ],
)
def test_what_cannot_be_meant_is_answered_in_one_line(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        open_source(address, seed=0)


def test_a_recording_keeps_the_distortion_and_can_be_undistorted_by_it() -> None:
    lens = Intrinsics(32, 24, 28.2, 28.2, 15.5, 11.5, BARREL)
    from dataclasses import replace

    header = replace(HEADER, intrinsics=Pair(lens, lens))
    assert from_parts(to_metadata(header), to_attachments(header)) == header
    records = [record(0)]

    class Recording:
        def __init__(self) -> None:
            self.header = header

        def records(self):  # type: ignore[no-untyped-def]
            yield from records

    flat = undistorted(Recording(), "run", datetime.date(2026, 1, 1))
    assert flat.header.intrinsics.primary.distortion == (0.0,) * 5
    (found,) = flat.records()
    assert isinstance(found, PairRecord)
    assert found.shot.primary.image.shape == (24, 32)  # type: ignore[union-attr]
    assert not np.array_equal(found.shot.primary.image, records[0].shot.primary.image)  # type: ignore[union-attr]


def test_a_header_without_distortion_is_as_it_always_was() -> None:
    assert "distortion" not in to_metadata(HEADER)["rig.camera.primary"]
