"""The networks that come with the rig."""

from __future__ import annotations

from pathlib import Path

WEIGHTS = Path(__file__).resolve().parent / "weights"


def shipped_networks() -> dict[str, Path]:
    """Return the ONNX file of each shipped network by the name that races it."""
    return {path.stem: path for path in sorted(WEIGHTS.glob("*.onnx"))}
