"""Calibrations in the words of others: ROS camera_info YAML and Kalibr's camchain."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.calibration.intrinsics import CameraFit, RigFit, StereoFit
from rig.core.types import SIDES, Side


def ros_camera_info(fit: RigFit, side: Side) -> str:
    """Return one camera as ROS' camera_info YAML (plumb_bob), with the stereo rectification."""
    camera: CameraFit = getattr(fit.cameras, side)
    width_px, height_px = fit.size_px
    one, two = fit.cameras
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        one.matrix, one.distortion, two.matrix, two.distortion, fit.size_px,
        fit.stereo.rotation, fit.stereo.translation_m.reshape(3, 1),
    )  # fmt: skip
    turn, project = (r1, p1) if side == "primary" else (r2, p2)
    return (
        f"image_width: {width_px}\n"
        f"image_height: {height_px}\n"
        f"camera_name: {side}\n"
        f"camera_matrix:\n{_matrix(camera.matrix)}"
        "distortion_model: plumb_bob\n"
        f"distortion_coefficients:\n{_matrix(camera.distortion.reshape(1, 5))}"
        f"rectification_matrix:\n{_matrix(np.asarray(turn))}"
        f"projection_matrix:\n{_matrix(np.asarray(project))}"
    )


def kalibr_camchain(fit: RigFit) -> str:
    """Return both cameras as Kalibr's camchain.yaml (pinhole, radtan); cam0 is the primary."""
    parts = []
    for number, (side, camera) in enumerate(zip(SIDES, fit.cameras, strict=True)):
        k = camera.matrix
        lines = [
            f"cam{number}:",
            f"  cam_overlaps: [{1 - number}]",
            "  camera_model: pinhole",
            f"  distortion_coeffs: {_row(camera.distortion[:4])}",
            "  distortion_model: radtan",
            f"  intrinsics: {_row([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])}",
            f"  resolution: [{fit.size_px[0]}, {fit.size_px[1]}]",
            f"  rostopic: /{side}/image_raw",
        ]
        if number == 1:
            lines += ["  T_cn_cnm1:", *(f"  - {_row(row)}" for row in _transform(fit.stereo))]
        parts.append("\n".join(lines) + "\n")
    return "".join(parts)


def _transform(stereo: StereoFit) -> NDArray[np.float64]:
    whole = np.eye(4)
    whole[:3, :3] = stereo.rotation
    whole[:3, 3] = stereo.translation_m
    return whole


def _matrix(values: NDArray[np.float64]) -> str:
    rows, columns = values.shape
    return f"  rows: {rows}\n  cols: {columns}\n  data: {_row(values.ravel())}\n"


def _row(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{float(value):.12g}" for value in values) + "]"
