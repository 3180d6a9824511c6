from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from rig.core.errors import UsageError
from rig.models.networks import NETWORKS, as_thesis_input, make_network


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(3)


def _inputs() -> tuple[Tensor, Tensor]:
    return torch.rand(3, 9, 224, 224), torch.rand(3, 6)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("dual-small", 1_546_498),
        ("dual-large", 6_150_322),
        ("single", 1_746_609),
        ("resnet18", 12_726_337),
    ],
)
def test_parameter_counts_are_those_of_table_4_1(name: str, count: int) -> None:
    network = make_network(name)
    assert sum(parameter.numel() for parameter in network.parameters()) == count
    assert NETWORKS[name].parameters == count


def test_thesis_input_has_colours_exposure_and_gain_of_each_frame() -> None:
    images, settings = _inputs()
    joined = as_thesis_input(images, settings)
    assert joined.shape == (3, 15, 224, 224)
    for frame in range(3):
        assert torch.equal(
            joined[:, 5 * frame : 5 * frame + 3], images[:, 3 * frame : 3 * frame + 3]
        )
        for which in range(2):
            plane = joined[:, 5 * frame + 3 + which]
            assert torch.equal(plane, settings[:, 2 * frame + which, None, None].expand_as(plane))


def test_folded_layer_answers_and_learns_as_the_plain_convolution() -> None:
    images, settings = _inputs()
    first = make_network("dual-small").first
    plain = nn.Conv2d(15, 30, 5)
    plain.load_state_dict({"weight": first.weight.detach(), "bias": first.bias.detach()})

    expected = nn.functional.max_pool2d(plain(as_thesis_input(images, settings)), 3)
    folded = first(images, settings)
    torch.testing.assert_close(folded, expected, atol=1e-5, rtol=0)

    expected.square().mean().backward()
    folded.square().mean().backward()
    assert plain.weight.grad is not None
    assert float(plain.weight.grad.abs().max()) > 0.01
    torch.testing.assert_close(first.weight.grad, plain.weight.grad, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(first.bias.grad, plain.bias.grad, atol=1e-5, rtol=1e-4)


def test_dual_small_is_the_layer_list_of_the_thesis() -> None:
    network = make_network("dual-small").eval()
    layers = [
        *_stage(15, 30, 5, 3), *_stage(30, 60, 3, 3), *_stage(60, 120, 3, 3),
        nn.Conv2d(120, 240, 7), nn.BatchNorm2d(240), nn.ReLU(), nn.Dropout2d(0.4),
        nn.Flatten(),
        nn.Linear(240, 128), nn.BatchNorm1d(128), nn.ReLU(), nn.Dropout(0.3),
        nn.Linear(128, 64), nn.BatchNorm1d(64), nn.ReLU(), nn.Dropout(0.2),
        nn.Linear(64, 32), nn.BatchNorm1d(32),
        nn.Linear(32, 2),
    ]  # fmt: skip
    plain = nn.Sequential(*layers).eval()
    weights = list(network.state_dict().values())
    plain.load_state_dict(dict(zip(plain.state_dict(), weights, strict=True)))
    images, settings = _inputs()
    with torch.inference_mode():
        expected = plain(as_thesis_input(images, settings))
        torch.testing.assert_close(network(images, settings), expected, atol=1e-5, rtol=0)


def _stage(inputs: int, outputs: int, kernel: int, pool: int) -> list[nn.Module]:
    return [
        nn.Conv2d(inputs, outputs, kernel),
        nn.MaxPool2d(pool),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
        nn.Dropout2d(0.4),
    ]


def test_each_setting_moves_the_answer() -> None:
    network = make_network("dual-small").eval()
    images, settings = _inputs()
    with torch.inference_mode():
        answer = network(images[:1], settings[:1])
        for which in range(6):
            other = settings[:1].clone()
            other[0, which] += 0.5
            assert not torch.equal(network(images[:1], other), answer)


def test_unknown_network_gets_a_suggestion() -> None:
    with pytest.raises(UsageError, match=r"'dual-smal'.*did you mean 'dual-small'"):
        make_network("dual-smal")
    with pytest.raises(UsageError, match="choose from dual-small, dual-large"):
        make_network("vgg")
