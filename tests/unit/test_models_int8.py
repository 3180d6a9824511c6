"""The file in 8-bit integers: smaller, drives, answers nearly as the other, or is not written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn

from rig.controllers.network import NetworkController
from rig.core.errors import ModelError
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.models.dataset import Batch
from rig.models.export import Parity, export_network, int8_file
from rig.models.int8 import moved
from rig.models.networks import make_network

FACTS = {"net": "dual-small", "training_sha256": "ab" * 32, "seed": 5}


def batch(seed: int, count: int = 6) -> Batch:
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 256, (count, 9, 224, 224), np.uint8)
    images[::2] //= 8
    settings = rng.uniform(0, 1, (count, 6)).astype(np.float32)
    return Batch(images, settings, np.zeros((count, 2), np.float32))


PROOF, CALIBRATION = batch(0), batch(1)


@pytest.fixture(scope="module")
def network() -> nn.Module:
    """Untrained, with batch statistics of a training set so that its answers vary."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = make_network("dual-small")
        for layer in network.modules():
            if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d):
                layer.momentum = None
        samples = batch(0, 16)
        with torch.inference_mode():
            network(
                torch.from_numpy(samples.images).float() / 255, torch.from_numpy(samples.settings)
            )
    return network.eval()


@pytest.fixture(scope="module")
def exported(network: nn.Module, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Parity]:
    out = tmp_path_factory.mktemp("int8") / "net.onnx"
    return out, export_network(network, out, PROOF, **FACTS, calibration=CALIBRATION)


def answers(path: Path) -> np.ndarray:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    images = PROOF.images.astype(np.float32) / 255
    return session.run(None, {"images": images, "settings": PROOF.settings})[0]


def test_the_measured_loss_is_that_of_the_written_files(exported: tuple[Path, Parity]) -> None:
    out, parity = exported
    assert parity.int8 is not None
    assert parity.int8 == moved(answers(out), answers(int8_file(out)), len(CALIBRATION.images))
    assert 0.0 < parity.int8.mean < parity.int8.largest < 0.1


def test_every_convolution_counts_in_integers_with_one_scale_a_channel(
    exported: tuple[Path, Parity],
) -> None:
    full, small = exported[0], int8_file(exported[0])
    assert small.stat().st_size < 0.3 * full.stat().st_size
    model = onnx.load(small)
    weights = {w.name: onnx.numpy_helper.to_array(w) for w in model.graph.initializer}
    made_by = {output: node for node in model.graph.node for output in node.output}
    convolutions = [node for node in model.graph.node if node.op_type == "Conv"]
    assert len(convolutions) == 4
    for convolution in convolutions:
        picture, weight = (made_by[name] for name in convolution.input[:2])
        assert picture.op_type == weight.op_type == "DequantizeLinear"
        kernels, scales = (weights[name] for name in weight.input[:2])
        assert kernels.dtype == np.int8 and np.abs(kernels.astype(int)).max() <= 64
        assert scales.shape == kernels.shape[:1]


def test_it_drives_as_the_other_file_does(exported: tuple[Path, Parity]) -> None:
    rng = np.random.default_rng(3)
    pictures = [rng.integers(0, top, (448, 448), np.uint8) for top in (30, 250, 90, 160)]
    told = []
    for path in (exported[0], int8_file(exported[0])):
        controller = NetworkController(path)
        controller.reset(THESIS_LIMITS)
        for picture in pictures:
            controller.step(Frame(picture, "bayer_rggb8", 0, 0, 0, Settings(2_000.0, 10.0)))
        told.append(list(controller.diagnostics().values()))
    assert told[0] != told[1]
    np.testing.assert_allclose(*told, atol=0.1)


def test_same_network_and_samples_same_bytes(
    network: nn.Module, exported: tuple[Path, Parity], tmp_path: Path
) -> None:
    again = tmp_path / "net.onnx"
    export_network(network, again, PROOF, **FACTS, calibration=CALIBRATION, half=True)
    assert int8_file(again).read_bytes() == int8_file(exported[0]).read_bytes()


def test_scales_that_do_not_fit_the_proof_are_refused_and_nothing_is_written(
    network: nn.Module, tmp_path: Path
) -> None:
    dark = CALIBRATION._replace(images=CALIBRATION.images // 250)
    with pytest.raises(ModelError, match=r"8-bit integers move answers by .*leave out --int8"):
        export_network(network, tmp_path / "net.onnx", PROOF, **FACTS, calibration=dark)
    assert list(tmp_path.iterdir()) == []


def test_a_loss_that_is_no_number_is_not_allowed() -> None:
    whole = np.zeros((2, 2), np.float32)
    assert moved(whole, whole + np.float32(0.015), 1).allowed
    assert not moved(whole, whole + np.float32(0.025), 1).allowed
    assert not moved(whole, whole + np.float32(np.nan), 1).allowed


def test_the_mean_is_that_of_the_setting_that_moved_more() -> None:
    whole = np.zeros((2, 2), np.float32)
    after = np.array([[0.0, 0.1], [0.0, -0.3]], np.float32)
    by = moved(whole, after, 1)
    assert (by.mean, by.largest) == pytest.approx((0.2, 0.3))
