"""A trained network as a controller: three pictures and their settings in, the next ones out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from rig.controllers.onnx_guard import check_model, read_model, try_model
from rig.controllers.reflex import startled
from rig.core.errors import ControllerError, ModelError
from rig.core.types import Auto, Command, Diagnostics, Frame, Limits, Settings
from rig.vision.bayer import NETWORK_PX, to_rgb224
from rig.vision.thumbnail import THUMBNAIL_PX, thumbnail

SCHEMA = "rig.network/1"
FRAMES = 3
TOLD = 2 * (FRAMES + 1)
"""Settings of every frame and those asked for last, exposure and gain each."""

_GREY = Frame(np.full((448, 448), 128, np.uint8), "bayer_rggb8", 0, 0, 0, Auto().start)


@dataclass(frozen=True, slots=True)
class Picture:
    """What a network sees of one frame: float32 in 0..1 of `shape` = (channels, rows, columns).

    `second_thought` gets the picture, the settings it was taken with, the network's answer to it
    and the limits, and returns what is asked for instead.
    """

    shape: tuple[int, int, int]
    make: Callable[[Frame], NDArray[np.float32]]
    second_thought: Callable[[NDArray[np.float32], Settings, Settings, Limits], Settings]


def _share(bytes_of_255: NDArray[np.uint8]) -> NDArray[np.float32]:
    return bytes_of_255.astype(np.float32) * np.float32(1 / 255)


PICTURES: Mapping[str, Picture] = {
    "rgb224": Picture(
        (3, NETWORK_PX, NETWORK_PX),
        lambda frame: to_rgb224(frame.image, frame.pixel_format),
        lambda _picture, _used, answer, _limits: answer,
    ),
    "thumbnail": Picture(
        (2, THUMBNAIL_PX[1], THUMBNAIL_PX[0]),
        lambda frame: _share(thumbnail(frame.image, frame.pixel_format)),
        startled,
    ),
}
"""The pictures that the metadata's `picture` may ask for; `rgb224` where it says nothing."""


@dataclass(slots=True)
class NetworkController:
    """Runs the ONNX file `model` on the last three frames and the settings they were taken with.

    Until three frames exist the oldest is repeated. Settings go in scaled to 0..1 of the limits in
    the file's metadata (thesis eq. 4.14), the answer is clamped to 0..1 and to the camera's limits.
    A network that takes a fourth pair of settings is told its last command too, which a slow
    camera has yet to use. A score map, which sees thumbnails, is overruled by `startled` in a
    picture that is all white or all dark.
    Raises ModelError when the file cannot be read, is no network of this interface, or answers a
    grey picture with something that is not a number.
    """

    model: Path
    _session: Any = field(init=False, repr=False)
    _picture: Picture = field(init=False, repr=False)
    _told: int = field(init=False)
    _model_limits: Limits = field(init=False)
    _limits: Limits = field(init=False)
    _images: NDArray[np.float32] = field(init=False, repr=False)
    _settings: NDArray[np.float32] = field(init=False, repr=False)
    _asked: Settings = field(init=False)
    _frames: int = field(init=False, default=0)
    _overruled: bool = field(init=False, default=False)
    _answer: NDArray[np.float32] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._session = _open(self.model)
        self._picture = _picture_of(self.model, self._session)
        self._told = _told(self._session)
        self._model_limits = _check(self.model, self._session, self._picture, self._told)
        self._limits = self._model_limits
        self._asked = Auto().start
        self._forget()
        self._remember(_GREY)
        if not np.isfinite(self._run()).all():
            raise ModelError(f"{self.model}: answers a grey picture with {self._answer.tolist()}")

    def reset(self, limits: Limits) -> Command:
        """Forget all frames and return the first settings: 1 ms and 0 dB, inside `limits`."""
        self._limits = limits
        self._forget()
        self._asked = Auto().start.clamp(limits)
        return self._asked

    def step(self, frame: Frame) -> Command:
        """Return the network's settings; raises ControllerError when it answers no number."""
        self._remember(frame)
        answer = self._run()
        if not np.isfinite(answer).all():
            raise ControllerError(f"{self.model.name} answered {answer.tolist()}")
        wanted = self._unscaled(np.clip(answer, 0.0, 1.0)).clamp(self._limits)
        newest = self._images[0, : self._picture.shape[0]]
        self._asked = self._picture.second_thought(newest, frame.used, wanted, self._limits)
        self._overruled = self._asked != wanted
        return self._asked

    def diagnostics(self) -> Diagnostics:
        """Return the answer, 0..1 of the network's limits before it was clamped, and its fate."""
        return {
            "overruled": float(self._overruled),
            "exposure_answer": float(self._answer[0]),
            "gain_answer": float(self._answer[1]),
        }

    def _forget(self) -> None:
        channels, rows, columns = self._picture.shape
        self._images = np.zeros((1, FRAMES * channels, rows, columns), np.float32)
        self._settings = np.zeros((1, self._told), np.float32)
        self._answer = np.zeros(2, np.float32)
        self._frames = 0
        self._overruled = False

    def _remember(self, frame: Frame) -> None:
        """Put the frame first and drop the oldest; the first frame ever fills all places."""
        picture, scaled = self._picture.make(frame), self._scaled(frame.used)
        images, channels = self._images[0], len(picture)
        settings, asked = np.split(self._settings[0], [2 * FRAMES])
        asked[:] = self._scaled(self._asked)[: len(asked)]
        if self._frames == 0:
            images[:], settings[:] = np.tile(picture, (FRAMES, 1, 1)), np.tile(scaled, FRAMES)
        images[channels:], settings[2:] = images[:-channels], settings[:-2]
        images[:channels], settings[:2] = picture, scaled
        self._frames += 1

    def _run(self) -> NDArray[np.float32]:
        inputs = {"images": self._images, "settings": self._settings}
        self._answer = np.asarray(self._session.run(["next_settings"], inputs)[0][0], np.float32)
        return self._answer

    def _scaled(self, used: Settings) -> NDArray[np.float32]:
        exposure_us, gain_db = self._model_limits.exposure_us, self._model_limits.gain_db
        return np.array(
            [
                (used.exposure_us - exposure_us[0]) / (exposure_us[1] - exposure_us[0]),
                (used.gain_db - gain_db[0]) / (gain_db[1] - gain_db[0]),
            ],
            np.float32,
        )

    def _unscaled(self, answer: NDArray[np.float32]) -> Settings:
        exposure_us, gain_db = self._model_limits.exposure_us, self._model_limits.gain_db
        exposure, gain = answer.tolist()
        return Settings(
            exposure_us[0] + exposure * (exposure_us[1] - exposure_us[0]),
            gain_db[0] + gain * (gain_db[1] - gain_db[0]),
        )


def _open(model: Path) -> Any:
    """Return a session of one thread, so that two controllers do not fight for the cores.

    The file is read once and run from memory, so it cannot name other files, and only after it
    was checked: it may come from anybody.
    """
    try:
        content = read_model(model)
    except OSError as problem:
        raise ModelError(
            f"{model}: cannot read the network ({problem.strerror}); name an ONNX file that "
            "`rig train` wrote"
        ) from problem
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        check_model(content)
        try_model(content)
        return onnxruntime.InferenceSession(
            content, sess_options=options, providers=["CPUExecutionProvider"]
        )
    except Exception as problem:  # the library's errors share no base of their own
        reason = str(problem).splitlines()[0]
        raise ModelError(f"{model}: is no ONNX file that can be run ({reason})") from problem


def _picture_of(model: Path, session: Any) -> Picture:
    name = session.get_modelmeta().custom_metadata_map.get("picture", "rgb224")
    if name not in PICTURES:
        raise ModelError(
            f"{model}: metadata picture is {name!r}, which this version cannot make; known: "
            f"{', '.join(sorted(PICTURES))}"
        )
    return PICTURES[name]


def _told(session: Any) -> int:
    """Return how many numbers of settings the network takes: of its frames, and asked for last."""
    shapes = [node.shape for node in session.get_inputs() if node.name == "settings"]
    return TOLD if [shape[1:] for shape in shapes] == [[TOLD]] else 2 * FRAMES


def _check(model: Path, session: Any, picture: Picture, told: int) -> Limits:
    """Return the limits of a network that has the right interface."""
    metadata = session.get_modelmeta().custom_metadata_map
    if metadata.get("schema") != SCHEMA:
        raise ModelError(
            f"{model}: metadata schema is {metadata.get('schema')!r}, not {SCHEMA!r}; export it "
            "with `rig train`"
        )
    if metadata.get("frames") != str(FRAMES):
        raise ModelError(f"{model}: metadata frames is {metadata.get('frames')!r}, not '{FRAMES}'")
    inputs = {node.name: node for node in session.get_inputs()}
    outputs = {node.name: node for node in session.get_outputs()}
    for kind, nodes, names in (
        ("input", inputs, {"images", "settings"}),
        ("output", outputs, {"next_settings"}),
    ):
        if set(nodes) != names:
            raise ModelError(f"{model}: {kind}s are {sorted(nodes)}, not {sorted(names)}")
    shapes = {
        "images": (FRAMES * picture.shape[0], *picture.shape[1:]),
        "settings": (told,),
        "next_settings": (2,),
    }
    for name, node in {**inputs, **outputs}.items():
        one_at_a_time = node.shape[:1] == [1] or not isinstance(node.shape[0], int)
        shape = tuple(node.shape[1:])
        if node.type != "tensor(float)" or shape != shapes[name] or not one_at_a_time:
            wanted = ["N", *shapes[name]]
            raise ModelError(
                f"{model}: {name} is {node.type} {node.shape}, not tensor(float) {wanted}"
            )
    return Limits(
        _range(model, metadata, "exposure_us_lo", "exposure_us_hi"),
        _range(model, metadata, "gain_db_lo", "gain_db_hi"),
    )


def _range(
    model: Path, metadata: Mapping[str, str], low_key: str, high_key: str
) -> tuple[float, float]:
    low, high = _number(model, metadata, low_key), _number(model, metadata, high_key)
    if not low < high:
        raise ModelError(f"{model}: metadata {low_key}={low:g} is not below {high_key}={high:g}")
    return low, high


def _number(model: Path, metadata: Mapping[str, str], key: str) -> float:
    try:
        value = float(metadata[key])
    except (KeyError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise ModelError(f"{model}: metadata {key} is {metadata.get(key)!r}, not a number")
    return value
