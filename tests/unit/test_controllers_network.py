"""A network file is checked when it is opened, fed as it was trained, and doubted when it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from network_files import METADATA, SHAPES, constant, linear, write
from onnx import TensorProto, helper

from rig.controllers.network import NetworkController
from rig.controllers.policies import RacePolicy
from rig.controllers.registry import NamedController, make_controller
from rig.core.clock import VirtualClock
from rig.core.errors import ControllerError, ModelError
from rig.core.types import THESIS_LIMITS, Frame, Limits, Pair, Settings
from rig.vision.bayer import to_rgb224
from rig.vision.thumbnail import thumbnail


def probe(path: Path, feature: int) -> Path:
    """Write a network that answers with one of its 15 features, twice."""
    weights = np.zeros((15, 2), np.float32)
    weights[feature] = 1
    return linear(path, weights)


def frame(red: int, green: int, blue: int, used: Settings) -> Frame:
    image = np.full((448, 448), green, np.uint8)
    image[0::2, 0::2], image[1::2, 1::2] = red, blue
    return Frame(image, "bayer_rggb8", 0, 0, 0, used)


FRAMES = [
    frame(10, 60, 110, Settings(1_000.0, 3.0)),
    frame(20, 70, 120, Settings(5_000.0, 6.0)),
    frame(30, 80, 130, Settings(9_000.0, 9.0)),
    frame(40, 90, 140, Settings(13_000.0, 12.0)),
]


def expected(history: list[Frame], feature: int) -> float:
    """Return a feature of three frames, newest first, as thesis 4.2.5 lays them out."""
    if feature < 9:
        picture = to_rgb224(history[feature // 3].image, "bayer_rggb8")
        return float(picture[feature % 3].mean())
    used = history[(feature - 9) // 2].used
    return (used.exposure_us - 75) / 29_925 if (feature - 9) % 2 == 0 else used.gain_db / 30


@pytest.mark.parametrize("feature", range(15))
def test_every_input_is_in_its_place(tmp_path: Path, feature: int) -> None:
    controller = NetworkController(probe(tmp_path / "probe.onnx", feature))
    for _ in range(2):
        controller.reset(THESIS_LIMITS)
        first, second, third, fourth = FRAMES
        for history in (
            [first, first, first],
            [second, first, first],
            [third, second, first],
            [fourth, third, second],
        ):
            controller.step(history[0])
            answer = controller.diagnostics()["exposure_answer"]
            assert answer == pytest.approx(expected(history, feature), rel=1e-4)


@pytest.mark.parametrize("limits", [THESIS_LIMITS, Limits((75.0, 3_000.0), (0.0, 12.0))])
def test_a_network_may_be_told_its_last_command(tmp_path: Path, limits: Limits) -> None:
    weights = np.zeros((17, 2), np.float32)
    weights[15, 0] = weights[16, 1] = 1.0
    form = SHAPES | {"settings": ["N", 8]}
    path = linear(tmp_path / "told.onnx", weights, (0.1, 0.2), shapes=form)
    controller = NetworkController(path)
    for _ in range(2):
        asked = controller.reset(limits)
        for seen in FRAMES:
            exposure = (asked.exposure_us - 75) / 29_925 + 0.1
            gain = asked.gain_db / 30 + 0.2
            asked = controller.step(seen)
            told = [controller.diagnostics()[name] for name in ("exposure_answer", "gain_answer")]
            assert told == pytest.approx([exposure, gain], rel=1e-4)
    assert asked == Settings(limits.exposure_us[1], limits.gain_db[1]) or limits == THESIS_LIMITS


@pytest.mark.parametrize("channel", range(6))
def test_a_network_may_ask_for_thumbnails(tmp_path: Path, channel: int) -> None:
    weights = np.zeros((12, 2), np.float32)
    weights[channel] = 1
    path = linear(
        tmp_path / "small.onnx",
        weights,
        metadata=METADATA | {"picture": "thumbnail"},
        shapes=SHAPES | {"images": ["N", 6, 48, 64]},
    )
    controller = NetworkController(path)
    controller.reset(THESIS_LIMITS)
    for seen in FRAMES[:3]:
        controller.step(seen)
    shown = thumbnail(FRAMES[2 - channel // 2].image, "bayer_rggb8")[channel % 2]
    answer = controller.diagnostics()["exposure_answer"]
    assert answer == pytest.approx(shown.mean() / 255, rel=1e-4)


@pytest.mark.parametrize(
    ("answer", "settings"),
    [
        ((0.0, 0.0), Settings(75.0, 0.0)),
        ((1.0, 1.0), Settings(30_000.0, 30.0)),
        ((0.5, 0.25), Settings(15_037.5, 7.5)),
        ((-0.3, 1.7), Settings(75.0, 30.0)),
    ],
)
def test_the_answer_is_clamped_and_scaled(
    tmp_path: Path, answer: tuple[float, float], settings: Settings
) -> None:
    controller = NetworkController(constant(tmp_path / "constant.onnx", answer))
    controller.reset(THESIS_LIMITS)
    assert controller.step(FRAMES[0]) == settings
    told = {"exposure_answer": answer[0], "gain_answer": answer[1], "overruled": 0.0}
    assert controller.diagnostics() == pytest.approx(told)


def test_a_camera_with_narrower_limits_keeps_them(tmp_path: Path) -> None:
    controller = NetworkController(constant(tmp_path / "constant.onnx", (0.0, 1.0)))
    narrow = Limits((500.0, 9_000.0), (3.0, 12.0))
    assert controller.reset(narrow) == Settings(1_000.0, 3.0)
    assert controller.step(FRAMES[0]) == Settings(500.0, 12.0)


def not_a_number_when_dark(path: Path) -> Path:
    """Write a network that divides nothing by nothing on a black picture."""
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1, 2, 3], keepdims=0),
        helper.make_node("Div", ["mean", "mean"], ["one"]),
        helper.make_node("Unsqueeze", ["one", "axis"], ["column"]),
        helper.make_node("MatMul", ["column", "half"], ["next_settings"]),
    ]
    return write(
        path, nodes, {"axis": np.array([1], np.int64), "half": np.full((1, 2), 0.5, np.float32)}
    )


def test_an_answer_that_is_no_number_raises_and_the_policy_holds(tmp_path: Path) -> None:
    controller = NetworkController(not_a_number_when_dark(tmp_path / "dark.onnx"))
    controller.reset(THESIS_LIMITS)
    black = frame(0, 0, 0, Settings(1_000.0, 0.0))
    with pytest.raises(ControllerError, match=r"dark\.onnx answered \[nan, nan\]"):
        controller.step(black)

    named = NamedController("dark", controller, {})
    other = make_controller("fixed", seed=0, networks={})
    policy = RacePolicy(named, other, VirtualClock())
    policy.reset(Pair(THESIS_LIMITS, THESIS_LIMITS))
    good = policy.decide(Pair(FRAMES[0], FRAMES[0])).primary
    assert good.command == Settings(15_037.5, 15.0)
    for _ in range(3):
        held = policy.decide(Pair(black, black)).primary
    assert held.command == good.command
    assert held.diagnostics == {"held": "ControllerError: dark.onnx answered [nan, nan]"}
    assert policy.decide(Pair(FRAMES[0], FRAMES[0])).primary.diagnostics["gain_answer"] == 0.5


def test_the_registry_opens_files_and_shipped_names(tmp_path: Path) -> None:
    path = constant(tmp_path / "ours.onnx", (0.5, 0.5))
    for spec, networks in ((f"network:model={path}", {}), ("ours", {"ours": path})):
        named = make_controller(spec, seed=0, networks=networks)
        assert (named.name, named.model) == (spec, path)
        assert named.options == {"model": str(path)}
        assert isinstance(named.controller, NetworkController)


def without(key: str) -> dict[str, str]:
    return {name: value for name, value in METADATA.items() if name != key}


def constant_of_shape(
    path: Path,
    *,
    metadata: dict[str, str] = METADATA,
    shapes: dict[str, Sequence[int | str]] = SHAPES,
    kind: int = TensorProto.FLOAT,
) -> Path:
    """Write a network that ignores its inputs and answers half in the declared shape."""
    side = list(shapes.values())[-1]
    half = np.full([1 if isinstance(n, str) else n for n in side], 0.5, np.float32)
    value = half.astype(np.float64) if kind == TensorProto.DOUBLE else half
    nodes = [helper.make_node("Identity", ["half"], [list(shapes)[-1]])]
    return write(path, nodes, {"half": value}, metadata=metadata, shapes=shapes, kind=kind)


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({}, "schema is None, not 'rig.network/1'"),
        (METADATA | {"schema": "rig.network/2"}, "schema is 'rig.network/2'"),
        (METADATA | {"frames": "1"}, "frames is '1', not '3'"),
        (without("gain_db_hi"), "gain_db_hi is None, not a number"),
        (METADATA | {"exposure_us_lo": "short"}, "exposure_us_lo is 'short', not a number"),
        (METADATA | {"exposure_us_lo": "nan"}, "exposure_us_lo is 'nan', not a number"),
        (METADATA | {"gain_db_lo": "30"}, "gain_db_lo=30 is not below gain_db_hi=30"),
        (METADATA | {"picture": "hologram"}, "picture is 'hologram', which this version cannot"),
    ],
)
def test_wrong_metadata_is_refused(tmp_path: Path, metadata: dict[str, str], message: str) -> None:
    path = constant_of_shape(tmp_path / "net.onnx", metadata=metadata)
    with pytest.raises(ModelError) as refused:
        NetworkController(path)
    assert message in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (SHAPES | {"images": ["N", 3, 224, 224]}, "images is tensor(float) ['N', 3, 224, 224]"),
        (SHAPES | {"images": ["N", 9, 112, 112]}, "not tensor(float) ['N', 9, 224, 224]"),
        (SHAPES | {"images": [64, 9, 224, 224]}, "images is tensor(float) [64, 9, 224, 224]"),
        (SHAPES | {"settings": ["N", 3]}, "settings is tensor(float) ['N', 3]"),
        (
            SHAPES | {"next_settings": ["N", 1]},
            "next_settings is tensor(float) [1, 1], not tensor(float) ['N', 2]",
        ),
        (
            {"x": ["N", 9, 224, 224], "settings": ["N", 6], "next_settings": ["N", 2]},
            "inputs are ['settings', 'x'], not ['images', 'settings']",
        ),
        (
            {"images": ["N", 9, 224, 224], "settings": ["N", 6], "y": ["N", 2]},
            "outputs are ['y'], not ['next_settings']",
        ),
    ],
)
def test_another_interface_is_refused(
    tmp_path: Path, shapes: dict[str, Sequence[int | str]], message: str
) -> None:
    with pytest.raises(ModelError) as refused:
        NetworkController(constant_of_shape(tmp_path / "net.onnx", shapes=shapes))
    assert message in str(refused.value)


def test_another_number_type_is_refused(tmp_path: Path) -> None:
    path = constant_of_shape(tmp_path / "net.onnx", kind=TensorProto.DOUBLE)
    with pytest.raises(ModelError, match=r"is tensor\(double\)"):
        NetworkController(path)


def test_a_network_that_answers_no_number_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"answers a grey picture with \[nan, 0\.5\]"):
        NetworkController(constant(tmp_path / "nan.onnx", (float("nan"), 0.5)))


def test_what_is_no_network_is_refused_in_one_line(tmp_path: Path) -> None:
    text = tmp_path / "notes.onnx"
    text.write_text("not a network")
    for path, message in (
        (text, "is no ONNX file that can be run"),
        (tmp_path, "cannot read the network"),
        (tmp_path / "missing.onnx", "No such file or directory"),
    ):
        with pytest.raises(ModelError, match=message) as refused:
            NetworkController(path)
        assert "\n" not in str(refused.value)
