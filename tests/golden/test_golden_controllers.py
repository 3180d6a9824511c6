"""Every rival's defaults, and what they lead to, are those that were published.

A change of either voids published races. When it is meant, `python tools/freeze_controllers.py`
writes the new traces.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from golden_drive import rivals, trace

FROZEN = json.loads((Path(__file__).parent / "controllers.json").read_text(encoding="utf-8"))


def test_every_rival_is_frozen() -> None:
    assert sorted(FROZEN) == rivals()


@pytest.mark.parametrize("spec", sorted(FROZEN))
def test_defaults_and_decisions_are_those_published(spec: str) -> None:
    now = trace(spec)
    assert now["options"] == FROZEN[spec]["options"]
    assert now["used"] == FROZEN[spec]["used"]
