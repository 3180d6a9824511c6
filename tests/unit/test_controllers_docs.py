"""The page on controllers names every controller, every option and every default."""

from __future__ import annotations

from dataclasses import MISSING, fields
from importlib import import_module
from pathlib import Path

import pytest

from rig.controllers.registry import CONTROLLERS
from rig.controllers.shin import TOLERANCES
from rig.vision.metrics import SHIN_VARIANTS

PAGE = (Path(__file__).parents[2] / "docs" / "controllers.md").read_text(encoding="utf-8")


def section(name: str) -> str:
    return PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_option_is_on_the_page_with_its_default(name: str) -> None:
    assert f"| `{name}` |" in PAGE
    rows = [line for line in section(name).splitlines() if line.startswith("| `")]
    options = [
        option
        for option in fields(getattr(import_module(f"rig.controllers.{name}"), CONTROLLERS[name]))
        if option.init
    ]
    for option in options:
        (row,) = [row for row in rows if f"`{option.name}`" in row.split("|")[1]]
        default = option.default
        if default is not MISSING:
            written = f"{default:g}" if isinstance(default, float) else str(default)
            assert written in row.split("|")[2].strip().split(", ")


def test_the_numbers_of_shin_are_on_the_page() -> None:
    for tolerance, value in TOLERANCES.items():
        assert f"{tolerance} {value:g}" in section("shin")
    for variant in SHIN_VARIANTS:
        assert f"`{variant}`" in section("shin")
