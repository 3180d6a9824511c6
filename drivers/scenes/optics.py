"""What stands between a world and the sensor: a windscreen, a lens, an aperture.

All of it is optional. The light that a scene sends is bent by the lens' distortion, dimmed towards
the corners, joined by what the windscreen mirrors, and let through by the aperture; as all four are
linear and stand still, they may act on a finished exposure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError
from rig.core.types import Intrinsics, Side, Truth
from rig.drivers.scenes.scene import DrivenScene, Scene, View
from rig.drivers.scenes.textures import noise

Floats = NDArray[np.float32]
Distortion = tuple[float, float, float, float, float]

STRAIGHT: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)

_DARKEST_CD_M2 = 1e-6
_MOST_WIDER = 0.5
_SCREEN_TRANSMITS = 0.8
"""Of light that crosses a laminated windscreen at about 60 degrees (70 % or more straight on is
what ECE R43 asks for; 0.8 is assumed)."""


@dataclass(frozen=True, slots=True)
class Optics:
    """The options of an address; the defaults change nothing.

    `distortion` is OpenCV's k1 k2 p1 p2 k3 (Brown 1966). `vignetting` is the power of the cosine
    law in units of its natural strength: 1 is cos^4 of the angle from the axis. `glare` is the
    share of the dashboard's light that the windscreen mirrors into the cameras, 0..1; 0 is no
    windscreen. `light` is what each aperture lets through, as a factor of the camera model's own.
    """

    distortion: Distortion = STRAIGHT
    vignetting: float = 0.0
    glare: float = 0.0
    light: Mapping[Side, float] = field(default_factory=lambda: {"primary": 1.0, "secondary": 1.0})


@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """Where the pixels of a distorting lens look in a larger picture of an ideal lens.

    `at` are places in that picture, `own` the nearest pixels of the same Bayer channel.
    """

    wide: Intrinsics
    at: tuple[Floats, Floats]
    own: tuple[NDArray[np.intp], NDArray[np.intp]]

    def light(self, view: View, light: Floats, grey: Floats) -> Floats:
        """Return `light`, each pixel in its channel, as the distorting lens sees it.

        `grey` is the view's own grey: its share of each channel stays what it is, while the grey
        picture is bent by bicubic interpolation.
        """
        share = view.radiance_cd_m2 / np.maximum(grey, np.float32(_DARKEST_CD_M2))
        whole = light / np.maximum(share, np.float32(_DARKEST_CD_M2))
        bent = cv2.remap(whole, *self.at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(np.maximum(bent, 0) * share[self.own], np.float32)

    def depth(self, depth_m: Floats) -> Floats:
        """Return the depth of the nearest pixels; between two surfaces there is no depth."""
        return np.asarray(cv2.remap(depth_m, *self.at, cv2.INTER_NEAREST), np.float32)


def make_warp(lens: Intrinsics) -> Warp:
    """Return the warp of a distorting lens; raises UsageError when it folds the picture."""
    y, x = np.mgrid[0 : lens.height_px, 0 : lens.width_px].astype(np.float64)
    pixels = np.stack([x, y], 2).reshape(-1, 1, 2)
    matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    ideal = cv2.undistortPoints(pixels, matrix, np.array(lens.distortion), criteria=enough)
    rays = np.concatenate([ideal.reshape(-1, 2), np.ones((ideal.shape[0], 1))], 1)
    none = np.zeros(3)
    again, _ = cv2.projectPoints(rays, none, none, matrix, np.array(lens.distortion))
    found = ideal.reshape(*x.shape, 2) * lens.fx_px + [lens.cx_px, lens.cy_px]
    beyond = max(-found.min(), *(found.max((0, 1)) - [lens.width_px - 1, lens.height_px - 1]), 0.0)
    if not np.abs(again - pixels).max() < 0.05 or beyond > _MOST_WIDER * lens.width_px:
        words = ",".join(f"{number:g}" for number in lens.distortion)
        raise UsageError(f"distortion {words} folds the picture's corners; take smaller numbers")
    margin = 2 * math.ceil(beyond / 2) + 2
    wide = replace(
        lens,
        width_px=lens.width_px + 2 * margin,
        height_px=lens.height_px + 2 * margin,
        cx_px=lens.cx_px + margin,
        cy_px=lens.cy_px + margin,
        distortion=STRAIGHT,
    )
    u, v = found[..., 0] + margin, found[..., 1] + margin
    own = (_nearest_alike(v, y), _nearest_alike(u, x))
    return Warp(wide, (u.astype(np.float32), v.astype(np.float32)), own)


def _nearest_alike(place: NDArray[np.float64], pixel: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the nearest whole number to a place that is even or odd like the pixel's own."""
    odd = pixel % 2
    return (2 * np.rint((place - odd) / 2) + odd).astype(np.intp)


def falloff(lens: Intrinsics, vignetting: float) -> Floats:
    """Return what each pixel of a lens gets of the light in its middle, H x W, 0..1."""
    y, x = np.mgrid[0 : lens.height_px, 0 : lens.width_px]
    tan2 = ((x - lens.cx_px) / lens.fx_px) ** 2 + ((y - lens.cy_px) / lens.fy_px) ** 2
    return np.asarray((1.0 + tan2) ** (-2.0 * vignetting), np.float32)


def dashboard(seed: int, lens: Intrinsics) -> Floats:
    """Return the albedo, over pi, of the dashboard that a windscreen mirrors, H x W.

    Dark plastic with vents, seams, and a sheet of paper, out of focus, upside down and brightest
    low in the picture; what it is made of and where things lie is drawn from `seed`.
    """
    rng = np.random.default_rng([seed, 1903])
    high, wide = 192, 256
    board = 0.05 + 0.03 * noise(rng, 256, 256, 1.0)[:high]
    for _ in range(int(rng.integers(3, 6))):
        left, top = int(rng.integers(0, wide - 50)), int(rng.integers(high // 3, high - 20))
        for slat in range(5):
            cv2.line(board, (left, top + 4 * slat), (left + 40, top + 4 * slat), 0.015, 2)
    for row in rng.integers(high // 4, high, 3):
        cv2.line(board, (0, int(row)), (wide, int(row) + int(rng.integers(-12, 12))), 0.16, 2)
    paper = cv2.boxPoints(
        (
            (float(rng.uniform(30, 110)), float(rng.uniform(0.5, 0.85) * high)),
            (float(rng.uniform(45, 70)), float(rng.uniform(25, 45))),
            float(rng.uniform(-25, 25)),
        )
    )
    cv2.fillConvexPoly(board, paper.astype(np.int32), float(rng.uniform(0.5, 0.75)))
    seen = cv2.GaussianBlur(board, (0, 0), 2.2)
    fading = np.linspace(0.35, 1.0, high)[:, None]
    size = (lens.width_px, lens.height_px)
    large = cv2.resize(seen * fading, size, interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.maximum(large, 0) / math.pi, np.float32)


def wide_lens(lens: Intrinsics) -> Intrinsics:
    """Return the ideal lens that shows all that a distorting lens does."""
    return lens if lens.distortion == STRAIGHT else make_warp(lens).wide


def through_optics(scene: Scene, lens: Intrinsics, optics: Optics, seed: int) -> OpticalScene:
    """Return a scene, opened with `wide_lens(lens)`, behind its optics.

    Raises UsageError for a distortion or a windscreen before a scene that is not driven through.
    """
    warp = None if lens.distortion == STRAIGHT else make_warp(lens)
    mirrored = dashboard(seed, lens) * np.float32(optics.glare) if optics.glare else None
    if not (isinstance(scene, DrivenScene) or (warp is None and mirrored is None)):
        raise UsageError(
            f"{scene.world_version.partition('/')[0]}: distortion and glare need a world to drive "
            "through; try sim:tunnel"
        )
    shade = falloff(lens, optics.vignetting)
    passes = {side: shade * np.float32(factor) for side, factor in optics.light.items()}
    return OpticalScene(scene, lens, warp, mirrored, passes)


@dataclass(frozen=True, slots=True, eq=False)
class OpticalView:
    """What one camera sees through the optics of `scene`."""

    scene: OpticalScene
    view: View
    side: Side
    time_s: float

    @property
    def radiance_cd_m2(self) -> Floats:
        """Return the light, as a radiance before a perfect lens, H x W, cd/m2."""
        return self.scene.through(self.side, self.time_s, self.view, self.view.radiance_cd_m2)

    @property
    def depth_m(self) -> Floats:
        """Return the distance along the optical axis, H x W, metres."""
        warp = self.scene.warp
        return self.view.depth_m if warp is None else warp.depth(self.view.depth_m)

    def exposed(self, exposure_us: float) -> Floats:
        """Return the mean over an exposure that starts now, H x W, cd/m2."""
        return self.scene.through(self.side, self.time_s, self.view, self.view.exposed(exposure_us))


@dataclass(frozen=True, slots=True, eq=False)
class OpticalScene:
    """A scene behind `optics`; `mirrored` is what a windscreen shows of the dashboard.

    `passes` is what each side's lens and aperture let through, 1 x 1 or H x W. The truth's light
    stays that of the scene, in front of everything.
    """

    scene: Scene
    lens: Intrinsics
    warp: Warp | None
    mirrored: Floats | None
    passes: Mapping[Side, Floats]

    @property
    def world_version(self) -> str:
        """Return the version of the world."""
        return self.scene.world_version

    @property
    def drive_s(self) -> float:
        """Return how long the drive takes, seconds."""
        return self.scene.drive_s

    def intrinsics(self, side: Side) -> Intrinsics:
        """Return the intrinsics with the distortion; both cameras are alike."""
        return self.scene.intrinsics(side) if self.warp is None else self.lens

    def view(self, side: Side, time_s: float) -> OpticalView:
        """Return what one camera sees `time_s` seconds after the start of the drive."""
        return OpticalView(self, self.scene.view(side, time_s), side, time_s)

    def truth(self, time_s: float) -> Truth:
        """Return where the primary camera is and how bright the world before it is."""
        return self.scene.truth(time_s)

    def through(self, side: Side, time_s: float, view: View, light: Floats) -> Floats:
        """Return what is left of the light of a view behind the optics, H x W, cd/m2."""
        if self.warp is not None:
            light = self.warp.light(view, light, _driven(self.scene).grey_cd_m2(side, time_s))
        if self.mirrored is not None:
            lux = _driven(self.scene).ground_lux(time_s)
            light = light * np.float32(_SCREEN_TRANSMITS) + self.mirrored * np.float32(lux)
        return light * self.passes[side]


def _driven(scene: Scene) -> DrivenScene:
    assert isinstance(scene, DrivenScene)
    return scene
