"""What a person types becomes the controller that was meant, or one helpful line."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.controllers.aeag import AeagController
from rig.controllers.fixed import FixedController
from rig.controllers.registry import CONTROLLERS, make_controller
from rig.controllers.shin import ShinController
from rig.core.errors import ControllerError, ModelError, UsageError
from rig.core.types import THESIS_LIMITS, Auto, Limits, Settings


def test_a_specification_becomes_a_controller_with_all_options() -> None:
    named = make_controller("fixed:exposure_us=700,gain_db=3", seed=0, networks={})
    assert named.name == "fixed:exposure_us=700,gain_db=3"
    assert named.options == {"exposure_us": "700.0", "gain_db": "3.0"}
    assert named.model is None
    assert named.controller.reset(THESIS_LIMITS) == Settings(700.0, 3.0)


def test_defaults_are_resolved() -> None:
    named = make_controller("shin:tolerance=high", seed=0, networks={})
    assert isinstance(named.controller, ShinController)
    assert named.options == {
        "tolerance": "high",
        "variant": "authors",
        "cost_spread": "1e-05",
        "evaluations_max": "15",
        "rounds": "1",
    }


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("shinn", "unknown controller 'shinn'; did you mean 'shin'? known: ae, aeag, fixed,"),
        ("zebra", "unknown controller 'zebra'; known: ae, aeag, fixed,"),
        ("our", "did you mean 'ours'"),
        ("", "unknown controller ''"),
        ("aeag:target=90", "unknown option 'target'; did you mean 'target_dn'"),
        ("fixed:_settings=1", "unknown option '_settings'"),
        ("fixed:gain_db=loud", "gain_db must be a number, got 'loud'"),
        ("fixed:gain_db=-1", "gain_db must be finite and >= 0, got -1.0"),
        ("fixed:exposure_us=nan", "exposure_us must be finite and > 0, got nan"),
        ("shin:evaluations_max=2.5", "evaluations_max must be a number, got '2.5'"),
        ("shin:tolerance=medium", "tolerance must be low, mid, high or a number"),
        ("aeag:damping=1", "damping must be in [0, 1), got 1.0"),
        ("aeag:metering=matrix", "metering must be one of average, lower, partial, spot, got"),
        ("aeag:priority=iris", "priority must be one of gain, exposure, got 'iris'"),
        ("ae:metering=all", "metering must be one of average, lower, partial, spot, got 'all'"),
        ("aeag:exposure_us_max=0", "exposure_us_max must be > 0, got 0.0"),
        ("aeag:damping", "'damping' is no option; write key=value"),
        ("aeag:damping=", "'damping=' is no option"),
        ("aeag:damping=0,damping=0.1", "damping is given twice"),
        ("network", "network: model is missing; write model=VALUE"),
        ("ours:seed=1", "ours is a network file and takes no options"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(spec: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        make_controller(spec, seed=0, networks={"ours": Path("ours.onnx")})
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_network_file_that_is_missing_is_named() -> None:
    with pytest.raises(ModelError, match=r"nowhere\.onnx: cannot read the network \(No such file"):
        make_controller("network:model=nowhere.onnx", seed=0, networks={})
    with pytest.raises(ModelError, match=r"lost\.onnx"):
        make_controller("ours", seed=0, networks={"ours": Path("lost.onnx")})


def test_the_table_names_real_classes() -> None:
    for name in set(CONTROLLERS) - {"network"}:
        assert make_controller(name, seed=0, networks={}).name == name


def test_settings_outside_the_camera_are_refused_before_the_drive() -> None:
    narrow = Limits((500.0, 9_000.0), (3.0, 12.0))
    with pytest.raises(ControllerError, match=r"400 us and 3 dB are outside the camera's 500\.\."):
        FixedController(400.0, 3.0).reset(narrow)
    with pytest.raises(ControllerError, match="exposure_us_max=400 is below the camera's"):
        AeagController(exposure_us_max=400.0).reset(narrow)


def test_the_cap_and_the_start_reach_the_camera() -> None:
    controller = AeagController(exposure_us_max=5_000.0, start_us=8_000.0, target_dn=90.0)
    assert controller.reset(THESIS_LIMITS) == Auto(
        Limits((75.0, 5_000.0), (0.0, 30.0)), 90.0, 0.3, Settings(5_000.0, 0.0), "partial"
    )
