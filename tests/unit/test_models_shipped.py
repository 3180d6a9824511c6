"""The shipped networks open, drive, answer to light, and have a card that says how to make them."""

from __future__ import annotations

import numpy as np
import onnx
import pytest

from rig.controllers.network import NetworkController
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.models.names import SCORE_MAPS
from rig.models.networks import NETWORKS
from rig.models.shipped import shipped_networks

SHIPPED = shipped_networks()


def test_the_networks_that_the_documents_name_are_there() -> None:
    assert {"ours", "ours-orb", "ours-viso2", "thesis", "thesis-single"} <= set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_network_follows_the_light_and_has_a_card(name: str) -> None:
    controller = NetworkController(SHIPPED[name])
    rng = np.random.default_rng(0)
    answers = []
    for brightness in (10, 240):
        controller.reset(THESIS_LIMITS)  # `used` stays: a camera that ignores what it was told
        picture = np.clip(rng.normal(brightness, 12, (480, 640)), 0, 255).astype(np.uint8)
        for sequence in range(4):
            used = Settings(2_000.0, 10.0)
            answer = controller.step(Frame(picture, "bayer_rggb8", sequence, 0, 0, used))
            assert isinstance(answer, Settings) and answer.clamp(THESIS_LIMITS) == answer
        answers.append(answer.exposure_us * 10 ** (answer.gain_db / 20))
    assert answers[0] > 1.5 * answers[1], "a dark picture asks for more light than a bright one"
    card = SHIPPED[name].with_suffix(".md").read_text(encoding="utf-8")
    assert card.startswith(f"# {name}\n") and "rig train" in card and "## Limits" in card


@pytest.mark.parametrize("name", SHIPPED)
def test_large_weights_are_stored_in_half_precision(name: str) -> None:
    model = onnx.load(SHIPPED[name])
    net = {entry.key: entry.value for entry in model.metadata_props}["net"]
    assert net in NETWORKS or net in SCORE_MAPS
    large = [w for w in model.graph.initializer if np.prod(w.dims) >= 1024]
    assert large and {w.data_type for w in large} <= {onnx.TensorProto.FLOAT16}
