"""The control experiment: one controller on both cameras shows what the cameras themselves do."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig.cli.main import run

CONTROLLER = "mean:percent=50,exposure_us_max=8000"


@pytest.mark.heavy
@pytest.mark.parametrize("swap", [(), ("--swap",)])
def test_a_controller_is_even_with_itself(swap: tuple[str, ...], tmp_path: Path) -> None:
    arguments = ["race", CONTROLLER, CONTROLLER, "--seeds", "1-3", "-q", *swap]
    assert run([*arguments, "--out", str(tmp_path / "races")]) == 0
    runs = json.loads((tmp_path / "races" / "evaluation.json").read_text())["runs"]
    ratios = [run["left"]["orb"]["median"] / run["right"]["orb"]["median"] for run in runs]
    assert all(0.85 < ratio < 1.18 for ratio in ratios), ratios
    assert 0.93 < sum(ratios) / len(ratios) < 1.07, ratios
