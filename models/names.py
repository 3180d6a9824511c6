"""Names that the command line knows without loading torch."""

from __future__ import annotations

from collections.abc import Mapping

SCORE_MAPS: Mapping[str, int] = {"map-small": 1, "map-large": 2}
"""Networks that learn from path targets, and how wide they are; others learn from recordings."""
