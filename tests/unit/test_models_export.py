from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from synthetic_run import SyntheticRun
from torch import nn

from rig.controllers.network import NetworkController
from rig.core.errors import ModelError
from rig.core.types import THESIS_LIMITS, Frame, Limits
from rig.models.dataset import Batch, scale_settings
from rig.models.export import Proof, export_network, to_onnx
from rig.models.measuring import stretches
from rig.models.metrics import METRICS
from rig.models.networks import ExposureNetwork, make_network

FACTS = {"net": "dual-small", "training_sha256": "ab" * 32, "seed": 5}


def _batch(count: int = 6) -> Batch:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (count, 9, 224, 224), np.uint8)
    images[::2] //= 8
    settings = rng.uniform(0, 1, (count, 6)).astype(np.float32)
    return Batch(images, settings, np.zeros((count, 2), np.float32))


@pytest.fixture(scope="module")
def network() -> ExposureNetwork:
    """Untrained, with batch statistics of a training set so that its answers vary."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = make_network("dual-small")
        batch = _batch(16)
        for layer in network.modules():
            if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d):
                layer.momentum = None
        with torch.inference_mode():
            network(torch.from_numpy(batch.images).float() / 255, torch.from_numpy(batch.settings))
    return network.eval()


@pytest.fixture(scope="module")
def folder(network: ExposureNetwork, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    limits = Limits((100.0, 20_000.0), (0.0, 24.0))
    full = export_network(network, folder / "full.onnx", _batch(), **FACTS, limits=limits)
    half = export_network(network, folder / "half.onnx", _batch(), **FACTS, half=True)
    assert full.difference == half.difference <= 1e-5
    assert full.half_difference == 0.0
    assert 0.0 < half.half_difference < 2e-3
    assert full.spread > 0.01
    return folder


def _answers(path: Path, batch: Batch) -> np.ndarray:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    images = batch.images.astype(np.float32) / 255
    return session.run(None, {"images": images, "settings": batch.settings})[0]


@pytest.mark.parametrize(("name", "tolerance"), [("full", 1e-5), ("half", 2e-3)])
def test_file_answers_as_the_network_at_every_batch_size(
    name: str, tolerance: float, network: ExposureNetwork, folder: Path
) -> None:
    for count in (1, 3):
        batch = _batch(count)
        images = torch.from_numpy(batch.images).float() / 255
        with torch.inference_mode():
            expected = network(images, torch.from_numpy(batch.settings)).numpy()
        answers = _answers(folder / f"{name}.onnx", batch)
        assert answers.shape == (count, 2)
        np.testing.assert_allclose(answers, expected, atol=tolerance, rtol=0)


def test_the_resnet_too_takes_any_number_of_samples() -> None:
    images, settings = (values.astype(np.float32) for values in _batch(2)[:2])
    model = to_onnx(make_network("resnet18"), Proof(images, settings))
    for described in (*model.graph.input, *model.graph.output):
        assert described.type.tensor_type.shape.dim[0].dim_param


def test_half_precision_halves_the_file(folder: Path) -> None:
    full, half = ((folder / f"{name}.onnx").stat().st_size for name in ("full", "half"))
    assert 5_900_000 < full < 7_000_000, "four bytes a weight, and zeros that fill whole vectors"
    assert half < 0.52 * full


def test_metadata_says_what_a_controller_needs(folder: Path) -> None:
    properties = {p.key: p.value for p in onnx.load(folder / "full.onnx").metadata_props}
    assert properties.pop("input").startswith("RGB 224x224 in 0..1, newest frame first")
    assert properties == {
        "schema": "rig.network/1",
        "net": "dual-small",
        "exposure_us_lo": "100.0",
        "exposure_us_hi": "20000.0",
        "gain_db_lo": "0.0",
        "gain_db_hi": "24.0",
        "frames": "3",
        "training_sha256": "ab" * 32,
        "seed": "5",
        "licence": "Apache-2.0",
    }


def test_interface_is_images_and_settings_to_next_settings(folder: Path) -> None:
    session = onnxruntime.InferenceSession(folder / "full.onnx")
    assert {i.name: i.shape[1:] for i in session.get_inputs()} == {
        "images": [9, 224, 224],
        "settings": [6],
    }
    assert [(o.name, o.shape[1:]) for o in session.get_outputs()] == [("next_settings", [2])]


def test_same_network_same_bytes_and_no_trace_of_this_computer(
    network: ExposureNetwork, folder: Path, tmp_path: Path
) -> None:
    export_network(network, tmp_path / "again.onnx", _batch(), **FACTS, half=True)
    again = (tmp_path / "again.onnx").read_bytes()
    assert again == (folder / "half.onnx").read_bytes()
    assert b".py" not in again


def test_controller_sees_while_driving_what_the_network_saw_in_training(
    network: ExposureNetwork, tmp_path: Path
) -> None:
    """Training pictures are rounded to 8 bits; any mix-up moves answers by far more than that."""
    export_network(network, tmp_path / "n.onnx", _batch(), **FACTS)
    controller = NetworkController(tmp_path / "n.onnx")
    controller.reset(THESIS_LIMITS)
    records = list(SyntheticRun(triggers=12).records())[3:8]
    (stretch,) = stretches(records, METRICS["feat"], SyntheticRun().header.intrinsics)
    for at, record in enumerate(records):
        frame = record.shot.primary
        assert isinstance(frame, Frame)
        controller.step(frame)
        told = controller.diagnostics()
        driving = np.array([told["exposure_answer"], told["gain_answer"]])
        seen = [max(at - back, 0) for back in range(3)]
        pictures = stretch.images[seen, 0].astype(np.float32) / 255
        used = stretch.drive.used[seen, 0]
        settings = scale_settings(used[:, 0], used[:, 1]).reshape(1, 6)
        assert np.abs(_asked(network, pictures, settings) - driving).max() < 0.006
    for mixed_up in (pictures[::-1], pictures[:, ::-1]):
        assert np.abs(_asked(network, mixed_up, settings) - driving).max() > 0.01
    assert np.abs(_asked(network, pictures, settings[:, ::-1]) - driving).max() > 0.01


def _asked(network: ExposureNetwork, pictures: np.ndarray, settings: np.ndarray) -> np.ndarray:
    images = torch.from_numpy(pictures.reshape(1, 9, 224, 224).copy())
    with torch.inference_mode():
        return network(images, torch.from_numpy(settings.copy())).numpy()[0]


def test_network_that_answers_all_alike_is_not_written(tmp_path: Path) -> None:
    network = make_network("dual-small")
    last = network.head[-1]
    assert isinstance(last, nn.Linear)
    nn.init.zeros_(last.weight)
    with pytest.raises(ModelError, match=r"n\.onnx: the network answers nearly the same"):
        export_network(network, tmp_path / "n.onnx", _batch(), **FACTS)
    assert list(tmp_path.iterdir()) == []


def test_network_that_answers_no_number_is_not_written(tmp_path: Path) -> None:
    network = make_network("dual-small")
    last = network.head[-1]
    assert isinstance(last, nn.Linear)
    nn.init.constant_(last.bias, float("nan"))
    with pytest.raises(ModelError, match="answers differently by nan"):
        export_network(network, tmp_path / "n.onnx", _batch(), **FACTS)
